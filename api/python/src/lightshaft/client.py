"""The client that blocks."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from ._api.jobs import Settings
from ._download import OnReceived
from ._farm_client import FarmClient, documented_as
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


class Client(FarmClient):
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
        self._calls: Calls = Calls(SyncIo(connection), connection.url, retries)

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

    @documented_as(AsyncClient.upload_scene)
    def upload_scene(
        self, path: str | os.PathLike[str], *, name: str | None = None, on_sent: OnSent | None = None
    ) -> Scene:
        return run(self._calls.upload_scene(path, name=name, on_sent=on_sent))

    @documented_as(AsyncClient.validate_scene)
    def validate_scene(self, path: str | os.PathLike[str]) -> SceneSummary:
        return run(self._calls.validate_scene(path))

    @documented_as(AsyncClient.scene)
    def scene(self, scene: str) -> Scene:
        return run(self._calls.scene(scene))

    @documented_as(AsyncClient.scenes)
    def scenes(self, *, limit: int | None = None, cursor: str | None = None) -> Page[Scene]:
        return run(self._calls.scenes(limit=limit, cursor=cursor))

    @documented_as(AsyncClient.iterate_scenes)
    def iterate_scenes(self) -> Iterator[Scene]:
        return iterate(self._calls.iterate_scenes())

    @documented_as(AsyncClient.delete_scene)
    def delete_scene(self, scene: str) -> None:
        return run(self._calls.delete_scene(scene))

    @documented_as(AsyncClient.thumbnail)
    def thumbnail(self, scene: str) -> bytes:
        return run(self._calls.thumbnail(scene))

    # Jobs

    @documented_as(AsyncClient.submit)
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

    @documented_as(AsyncClient.validate_job)
    def validate_job(
        self, scene: str | Scene, settings: Settings | None = None, *, kind: JobKind | None = None
    ) -> dict[str, Any]:
        return run(self._calls.validate_job(scene, settings, kind=kind))

    @documented_as(AsyncClient.job)
    def job(self, job: str) -> Job:
        return run(self._calls.job(job))

    @documented_as(AsyncClient.jobs)
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

    @documented_as(AsyncClient.iterate_jobs)
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

    @documented_as(AsyncClient.wait)
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

    @documented_as(AsyncClient.events)
    def events(self, job: str | Job | None = None, *, last_event_id: int | None = None) -> Iterator[Event]:
        return iterate(self._calls.events(job, last_event_id=last_event_id))

    @documented_as(AsyncClient.cancel)
    def cancel(self, job: str | Job) -> Job:
        return run(self._calls.cancel(job))

    @documented_as(AsyncClient.retry)
    def retry(self, job: str | Job) -> Job:
        return run(self._calls.retry(job))

    @documented_as(AsyncClient.change_job)
    def change_job(self, job: str | Job, *, priority: int | None = None, paused: bool | None = None) -> Job:
        return run(self._calls.change_job(job, priority=priority, paused=paused))

    @documented_as(AsyncClient.delete_job)
    def delete_job(self, job: str | Job) -> None:
        return run(self._calls.delete_job(job))

    @documented_as(AsyncClient.log)
    def log(self, job: str | Job, *, attempt: str | None = None) -> str:
        return run(self._calls.log(job, attempt=attempt))

    @documented_as(AsyncClient.preview)
    def preview(self, job: str | Job) -> bytes:
        return run(self._calls.preview(job))

    # Artifacts

    @documented_as(AsyncClient.artifact)
    def artifact(self, job: str | Job, name: str = "image.png") -> bytes:
        return run(self._calls.artifact(job, name))

    @documented_as(AsyncClient.download)
    def download(
        self,
        job: str | Job,
        name: str = "image.png",
        path: str | os.PathLike[str] | None = None,
        *,
        on_received: OnReceived | None = None,
    ) -> Path:
        return run(self._calls.download(job, name, path, on_received=on_received))

    @documented_as(AsyncClient.download_all)
    def download_all(self, job: str | Job, folder: str | os.PathLike[str]) -> list[Path]:
        return run(self._calls.download_all(job, folder))

    @documented_as(AsyncClient.artifacts)
    def artifacts(self, job: str | Job) -> list[Artifact]:
        return run(self._calls.artifacts(job))

    @documented_as(AsyncClient.picture)
    def picture(self, job: str | Job, name: str = "image.exr", *, layer: str | None = None) -> Array:
        return run(self._calls.picture(job, name, layer=layer))

    @documented_as(AsyncClient.layers)
    def layers(self, job: str | Job, name: str = "image.exr") -> dict[str, Array]:
        return run(self._calls.layers(job, name))

    # Service

    @documented_as(AsyncClient.store_blob)
    def store_blob(self, path: str | os.PathLike[str], *, on_sent: OnSent | None = None) -> StoredBlob:
        return run(self._calls.store_blob(path, on_sent=on_sent))

    @documented_as(AsyncClient.mesh)
    def mesh(self, mesh: str) -> Mesh:
        return run(self._calls.mesh(mesh))

    @documented_as(AsyncClient.meshes)
    def meshes(self, *, limit: int | None = None, cursor: str | None = None) -> Page[Mesh]:
        return run(self._calls.meshes(limit=limit, cursor=cursor))

    @documented_as(AsyncClient.iterate_meshes)
    def iterate_meshes(self) -> Iterator[Mesh]:
        return iterate(self._calls.iterate_meshes())

    @documented_as(AsyncClient.workers)
    def workers(self) -> list[Worker]:
        return run(self._calls.workers())

    @documented_as(AsyncClient.worker)
    def worker(self, worker: str) -> Worker:
        return run(self._calls.worker(worker))

    @documented_as(AsyncClient.drain_worker)
    def drain_worker(self, worker: str) -> Worker:
        return run(self._calls.drain_worker(worker))

    @documented_as(AsyncClient.undrain_worker)
    def undrain_worker(self, worker: str) -> Worker:
        return run(self._calls.undrain_worker(worker))

    @documented_as(AsyncClient.status)
    def status(self) -> Status:
        return run(self._calls.status())
