"""The client that blocks."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self, TypeVar

from ._api.jobs import Settings
from ._download import OnReceived
from ._io import Connection, SyncIo, iterate, run
from ._page import Page
from ._upload import OnSent
from ._wait import OnEvent, OnProgress
from .async_client import AsyncClient, Calls
from .models import (
    Artifact,
    Event,
    Job,
    JobKind,
    JobState,
    JobSummary,
    Mesh,
    Scene,
    SceneSummary,
    Status,
    StoredBlob,
    Worker,
)

if TYPE_CHECKING:
    from ._pictures import Array

F = TypeVar("F", bound=Callable[..., Any])


def _as(original: Callable[..., Any]) -> Callable[[F], F]:
    """Documents a call as the other client's of the same name."""

    def documented(call: F) -> F:
        call.__doc__ = original.__doc__
        return call

    return documented


class Client:
    """A Lightshaft service at one address. Connections are kept; `with` closes them. Threads may share a client."""

    def __init__(
        self,
        url: str | None = None,
        *,
        timeout_s: float = 60.0,
        retries: int = 4,
        headers: Mapping[str, str] | None = None,
    ) -> None:
        """Connect to `url`, such as `http://127.0.0.1:8080`; from LIGHTSHAFT_SERVER where it is left out.

        `timeout_s` is the longest pause within an answer, and until it begins. `retries` says how often a call
        that failed for a passing reason is repeated; only those that do nothing twice are.
        """
        connection = Connection.to(url, timeout_s, headers)
        self._calls = Calls(SyncIo(connection), connection.url, retries)

    @property
    def url(self) -> str:
        """The service's address."""
        return self._calls.url

    def close(self) -> None:
        """Close all connections."""
        run(self._calls.close())

    def __enter__(self) -> Self:
        """Give the client itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close all connections."""
        self.close()

    # Scenes

    @_as(AsyncClient.upload_scene)
    def upload_scene(
        self, path: str | os.PathLike[str], *, name: str | None = None, on_sent: OnSent | None = None
    ) -> Scene:
        return run(self._calls.upload_scene(path, name=name, on_sent=on_sent))

    @_as(AsyncClient.validate_scene)
    def validate_scene(self, path: str | os.PathLike[str]) -> SceneSummary:
        return run(self._calls.validate_scene(path))

    @_as(AsyncClient.scene)
    def scene(self, scene: str) -> Scene:
        return run(self._calls.scene(scene))

    @_as(AsyncClient.scenes)
    def scenes(self, *, limit: int | None = None, cursor: str | None = None) -> Page[Scene]:
        return run(self._calls.scenes(limit=limit, cursor=cursor))

    @_as(AsyncClient.iterate_scenes)
    def iterate_scenes(self) -> Iterator[Scene]:
        return iterate(self._calls.iterate_scenes())

    @_as(AsyncClient.delete_scene)
    def delete_scene(self, scene: str) -> None:
        return run(self._calls.delete_scene(scene))

    @_as(AsyncClient.thumbnail)
    def thumbnail(self, scene: str) -> bytes:
        return run(self._calls.thumbnail(scene))

    # Jobs

    @_as(AsyncClient.submit)
    def submit(
        self,
        scene: str | Scene,
        settings: Settings | None = None,
        *,
        kind: JobKind | None = None,
        priority: int = 0,
        labels: Mapping[str, str] | None = None,
        max_attempts: int | None = None,
        idempotency_key: str | None = None,
    ) -> Job:
        return run(
            self._calls.submit(
                scene,
                settings,
                kind=kind,
                priority=priority,
                labels=labels,
                max_attempts=max_attempts,
                idempotency_key=idempotency_key,
            )
        )

    @_as(AsyncClient.validate_job)
    def validate_job(
        self, scene: str | Scene, settings: Settings | None = None, *, kind: JobKind | None = None
    ) -> dict[str, Any]:
        return run(self._calls.validate_job(scene, settings, kind=kind))

    @_as(AsyncClient.job)
    def job(self, job: str) -> Job:
        return run(self._calls.job(job))

    @_as(AsyncClient.jobs)
    def jobs(
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
        return run(
            self._calls.jobs(
                state=state,
                kind=kind,
                scene=scene,
                q=q,
                automatic=automatic,
                labels=labels,
                limit=limit,
                cursor=cursor,
            )
        )

    @_as(AsyncClient.iterate_jobs)
    def iterate_jobs(
        self,
        *,
        state: JobState | None = None,
        kind: JobKind | None = None,
        scene: str | None = None,
        q: str | None = None,
        automatic: bool | None = None,
        labels: Mapping[str, str] | None = None,
    ) -> Iterator[JobSummary]:
        return iterate(
            self._calls.iterate_jobs(state=state, kind=kind, scene=scene, q=q, automatic=automatic, labels=labels)
        )

    @_as(AsyncClient.wait)
    def wait(
        self,
        job: str | Job,
        *,
        timeout_s: float | None = None,
        patience_s: float = 60.0,
        on_progress: OnProgress | None = None,
        on_event: OnEvent | None = None,
        check: bool = True,
    ) -> Job:
        return run(
            self._calls.wait(
                job,
                timeout_s=timeout_s,
                patience_s=patience_s,
                on_progress=on_progress,
                on_event=on_event,
                check=check,
            )
        )

    @_as(AsyncClient.events)
    def events(self, job: str | Job | None = None, *, last_event_id: int | None = None) -> Iterator[Event]:
        return iterate(self._calls.events(job, last_event_id=last_event_id))

    @_as(AsyncClient.cancel)
    def cancel(self, job: str | Job) -> Job:
        return run(self._calls.cancel(job))

    @_as(AsyncClient.retry)
    def retry(self, job: str | Job) -> Job:
        return run(self._calls.retry(job))

    @_as(AsyncClient.change_job)
    def change_job(self, job: str | Job, *, priority: int | None = None, paused: bool | None = None) -> Job:
        return run(self._calls.change_job(job, priority=priority, paused=paused))

    @_as(AsyncClient.delete_job)
    def delete_job(self, job: str | Job) -> None:
        return run(self._calls.delete_job(job))

    @_as(AsyncClient.log)
    def log(self, job: str | Job, *, attempt: str | None = None) -> str:
        return run(self._calls.log(job, attempt=attempt))

    @_as(AsyncClient.preview)
    def preview(self, job: str | Job) -> bytes:
        return run(self._calls.preview(job))

    # Artifacts

    @_as(AsyncClient.artifact)
    def artifact(self, job: str | Job, name: str = "image.png") -> bytes:
        return run(self._calls.artifact(job, name))

    @_as(AsyncClient.download)
    def download(
        self,
        job: str | Job,
        name: str = "image.png",
        path: str | os.PathLike[str] | None = None,
        *,
        on_received: OnReceived | None = None,
    ) -> Path:
        return run(self._calls.download(job, name, path, on_received=on_received))

    @_as(AsyncClient.download_all)
    def download_all(self, job: str | Job, folder: str | os.PathLike[str]) -> list[Path]:
        return run(self._calls.download_all(job, folder))

    @_as(AsyncClient.artifacts)
    def artifacts(self, job: str | Job) -> list[Artifact]:
        return run(self._calls.artifacts(job))

    @_as(AsyncClient.picture)
    def picture(self, job: str | Job, name: str = "image.exr", *, layer: str | None = None) -> Array:
        return run(self._calls.picture(job, name, layer=layer))

    @_as(AsyncClient.layers)
    def layers(self, job: str | Job, name: str = "image.exr") -> dict[str, Array]:
        return run(self._calls.layers(job, name))

    # Service

    @_as(AsyncClient.store_blob)
    def store_blob(self, path: str | os.PathLike[str], *, on_sent: OnSent | None = None) -> StoredBlob:
        return run(self._calls.store_blob(path, on_sent=on_sent))

    @_as(AsyncClient.mesh)
    def mesh(self, mesh: str) -> Mesh:
        return run(self._calls.mesh(mesh))

    @_as(AsyncClient.meshes)
    def meshes(self, *, limit: int | None = None, cursor: str | None = None) -> Page[Mesh]:
        return run(self._calls.meshes(limit=limit, cursor=cursor))

    @_as(AsyncClient.iterate_meshes)
    def iterate_meshes(self) -> Iterator[Mesh]:
        return iterate(self._calls.iterate_meshes())

    @_as(AsyncClient.workers)
    def workers(self) -> list[Worker]:
        return run(self._calls.workers())

    @_as(AsyncClient.worker)
    def worker(self, worker: str) -> Worker:
        return run(self._calls.worker(worker))

    @_as(AsyncClient.drain_worker)
    def drain_worker(self, worker: str) -> Worker:
        return run(self._calls.drain_worker(worker))

    @_as(AsyncClient.undrain_worker)
    def undrain_worker(self, worker: str) -> Worker:
        return run(self._calls.undrain_worker(worker))

    @_as(AsyncClient.status)
    def status(self) -> Status:
        return run(self._calls.status())
