"""Jobs and their events."""

from __future__ import annotations

import contextlib
import uuid
from collections.abc import AsyncGenerator, Mapping
from typing import Any

from .. import _events
from .._calls import is_transient, pause_s, query
from .._codec import encode
from .._io import Request
from .._page import Page, every
from .._wait import FINAL, OnEvent, OnProgress, Waiter
from ..errors import JobFailedError, LightshaftError
from ..models import (
    BenchmarkSettings,
    BuildSettings,
    CompareRequest,
    Event,
    Job,
    JobKind,
    JobState,
    JobSummary,
    RenderSettings,
    Scene,
    ValidatedJob,
)
from .base import Base, job_id, job_path

#: What a job shall do: with its types, or as the API writes it.
Settings = RenderSettings | BenchmarkSettings | BuildSettings | CompareRequest | Mapping[str, Any]


class Jobs(Base):
    """Submitting, following and changing jobs."""

    async def submit(
        self,
        scene: str | Scene | None,
        settings: Settings | None = None,
        *,
        kind: JobKind | None = None,
        priority: int = 0,
        labels: Mapping[str, str] | None = None,
        max_attempts: int | None = None,
        idempotency_key: str | None = None,
    ) -> Job:
        """Makes a job. The kind is that of the settings, `render` for a dictionary.

        A comparison needs no scene where one of its pictures is a job's.

        Within a day, the same key gives the same job, so that a call that is repeated makes no second one. Without
        a key each call has one of its own.
        """
        job = _new_job(scene, settings, kind) | {"priority": priority, "labels": dict(labels or {})}
        if max_attempts is not None:
            job["max_attempts"] = max_attempts
        headers = {"Idempotency-Key": idempotency_key or str(uuid.uuid4())}
        return await self._caller.json(Job, Request("POST", "v1/jobs", headers=headers, json=job))

    async def validate_job(
        self,
        scene: str | Scene | None,
        settings: Settings | None = None,
        *,
        kind: JobKind | None = None,
    ) -> dict[str, Any]:
        """Has a job checked and makes none: its settings as they would be, every default filled in."""
        job = _new_job(scene, settings, kind)
        request = Request("POST", "v1/jobs", query(validate_only=True), json=job)
        return (await self._caller.json(ValidatedJob, request)).job.settings

    async def job(self, job: str) -> Job:
        """A job with its tasks, attempts, artifacts and metrics."""
        return await self._caller.json(Job, Request("GET", job_path(job)))

    async def jobs(
        self,
        *,
        state: JobState | None = None,
        kind: JobKind | None = None,
        scene: str | None = None,
        q: str | None = None,
        automatic: bool | None = None,
        labels: Mapping[str, str] | None = None,
        limit: int | None = None,
        cursor: str | None = None,
    ) -> Page[JobSummary]:
        """One page of the jobs, newest first; `q` is part of the scene's name or of a label's value."""
        parameters = query(state=state, kind=kind, scene=scene, q=q, automatic=automatic)
        parameters += tuple((f"label.{key}", value) for key, value in (labels or {}).items())
        request = Request("GET", "v1/jobs", parameters + query(limit=limit, cursor=cursor))
        return await self._caller.page(JobSummary, request)

    def iterate_jobs(
        self,
        *,
        state: JobState | None = None,
        kind: JobKind | None = None,
        scene: str | None = None,
        q: str | None = None,
        automatic: bool | None = None,
        labels: Mapping[str, str] | None = None,
    ) -> AsyncGenerator[JobSummary, None]:
        """All jobs that fit, newest first."""
        return every(
            lambda cursor: self.jobs(
                state=state,
                kind=kind,
                scene=scene,
                q=q,
                automatic=automatic,
                labels=labels,
                limit=200,
                cursor=cursor,
            )
        )

    async def wait(
        self,
        job: str | Job,
        *,
        timeout_s: float | None = None,
        patience_s: float = 60.0,
        on_progress: OnProgress | None = None,
        on_event: OnEvent | None = None,
        check: bool = True,
    ) -> Job:
        """Waits for the end of a job, through restarts of the service of up to `patience_s`.

        Raises `JobFailedError` where it has not succeeded, unless `check` is false; `WaitTimeoutError` when the time
        is up.
        """
        waiter = Waiter(
            self._caller,
            job_id(job),
            timeout_s=timeout_s,
            patience_s=patience_s,
            on_progress=on_progress,
            on_event=on_event,
        )
        ended = await waiter.wait()
        if check and ended.state != "succeeded":
            raise JobFailedError(ended)
        return ended

    async def events(
        self, job: str | Job | None = None, *, last_event_id: int | None = None
    ) -> AsyncGenerator[Event, None]:
        """Events of a job from its beginning until its end, or of all jobs from now on, or after `last_event_id`.

        A connection that breaks is taken up again after the last event that came.
        """
        path = "v1/events" if job is None else f"{job_path(job)}/events"
        failures = 0
        while True:
            try:
                async with contextlib.aclosing(_events.stream(self._caller, path, last_event_id)) as events:
                    async for event in events:
                        failures = 0
                        if event is not None:
                            last_event_id = event.id if event.id is not None else last_event_id
                            yield event
                # A job's stream ends with the job, that of all jobs with the service.
                if job is not None and (await self.job(job_id(job))).state in FINAL:
                    return
                await self._io.sleep(1.0)
            except LightshaftError as error:
                failures += 1
                if failures > self._retries or not is_transient(error):
                    raise
                await self._io.sleep(pause_s(failures, error))

    async def cancel(self, job: str | Job) -> Job:
        """Cancels a job; one that runs ends within a tile."""
        return await self._caller.json(Job, Request("POST", f"{job_path(job)}/cancel"))

    async def retry(self, job: str | Job) -> Job:
        """Starts the failed and cancelled tasks of a job afresh; what succeeded stays."""
        request = Request("POST", f"{job_path(job)}/retry", is_repeatable=False)
        return await self._caller.json(Job, request)

    async def change_job(self, job: str | Job, *, priority: int | None = None, paused: bool | None = None) -> Job:
        """Changes a job's priority, or pauses it: only what is given."""
        changes = {"priority": priority, "paused": paused}
        patch = {name: value for name, value in changes.items() if value is not None}
        return await self._caller.json(Job, Request("PATCH", job_path(job), json=patch))

    async def delete_job(self, job: str | Job) -> None:
        """Deletes a finished job with what it left."""
        await self._caller.content(Request("DELETE", job_path(job)))

    async def log(self, job: str | Job, *, attempt: str | None = None) -> str:
        """What the workers logged: all attempts under headings, or one."""
        request = Request("GET", f"{job_path(job)}/log", query(attempt=attempt))
        return (await self._caller.content(request)).decode(errors="replace")

    async def preview(self, job: str | Job) -> bytes:
        """The picture so far as PNG."""
        return await self._caller.content(Request("GET", f"{job_path(job)}/preview.png"))


def _new_job(scene: str | Scene | None, settings: Settings | None, kind: JobKind | None) -> dict[str, Any]:
    if kind is None:
        of_settings = {BenchmarkSettings: "benchmark", BuildSettings: "build", CompareRequest: "compare"}
        kind_name: str = of_settings.get(type(settings), "render")
    else:
        kind_name = kind
    job = {"kind": kind_name, "settings": encode(settings if settings is not None else {})}
    if scene is not None:
        job["scene"] = scene if isinstance(scene, str) else scene.id
    return job
