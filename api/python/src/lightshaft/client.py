"""The client that blocks."""

from __future__ import annotations

from collections.abc import Mapping
from types import TracebackType
from typing import Self

from ._blocking import blocking, iterating
from ._io import Connection, SyncIo, run
from .async_client import Calls


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

    upload_scene = blocking(Calls.upload_scene)
    validate_scene = blocking(Calls.validate_scene)
    scene = blocking(Calls.scene)
    scenes = blocking(Calls.scenes)
    iterate_scenes = iterating(Calls.iterate_scenes)
    delete_scene = blocking(Calls.delete_scene)
    thumbnail = blocking(Calls.thumbnail)

    # Jobs

    submit = blocking(Calls.submit)
    validate_job = blocking(Calls.validate_job)
    job = blocking(Calls.job)
    jobs = blocking(Calls.jobs)
    iterate_jobs = iterating(Calls.iterate_jobs)
    wait = blocking(Calls.wait)
    events = iterating(Calls.events)
    cancel = blocking(Calls.cancel)
    retry = blocking(Calls.retry)
    change_job = blocking(Calls.change_job)
    delete_job = blocking(Calls.delete_job)
    log = blocking(Calls.log)
    preview = blocking(Calls.preview)

    # Artifacts

    artifact = blocking(Calls.artifact)
    download = blocking(Calls.download)
    download_all = blocking(Calls.download_all)
    artifacts = blocking(Calls.artifacts)
    picture = blocking(Calls.picture)
    layers = blocking(Calls.layers)
    compare = blocking(Calls.compare)

    # Service

    store_blob = blocking(Calls.store_blob)
    mesh = blocking(Calls.mesh)
    meshes = blocking(Calls.meshes)
    iterate_meshes = iterating(Calls.iterate_meshes)
    workers = blocking(Calls.workers)
    worker = blocking(Calls.worker)
    drain_worker = blocking(Calls.drain_worker)
    undrain_worker = blocking(Calls.undrain_worker)
    status = blocking(Calls.status)

    # Farm

    add_suite = blocking(Calls.add_suite)
    suite = blocking(Calls.suite)
    suites = blocking(Calls.suites)
    start_run = blocking(Calls.start_run)
    run = blocking(Calls.run)
    runs = blocking(Calls.runs)
    iterate_runs = iterating(Calls.iterate_runs)
    wait_for_run = blocking(Calls.wait_for_run)
    cancel_run = blocking(Calls.cancel_run)
    approve = blocking(Calls.approve)
    reject = blocking(Calls.reject)
    case_artifact = blocking(Calls.case_artifact)
    decisions = blocking(Calls.decisions)
    baselines = blocking(Calls.baselines)
    reset_baseline = blocking(Calls.reset_baseline)
    history = blocking(Calls.history)
    calibrate = blocking(Calls.calibrate)
    calibration = blocking(Calls.calibration)
    add_schedule = blocking(Calls.add_schedule)
    schedules = blocking(Calls.schedules)
    change_schedule = blocking(Calls.change_schedule)
    delete_schedule = blocking(Calls.delete_schedule)
    add_webhook = blocking(Calls.add_webhook)
    webhooks = blocking(Calls.webhooks)
    webhook = blocking(Calls.webhook)
    delete_webhook = blocking(Calls.delete_webhook)
    deliveries = blocking(Calls.deliveries)
    resend_delivery = blocking(Calls.resend_delivery)
