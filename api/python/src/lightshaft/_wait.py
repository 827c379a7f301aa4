"""
Waiting for a job: by its events, which are taken up again where they broke off, or by asking where no events get
through (some proxies keep a stream back until it ends).
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable
from dataclasses import dataclass

from . import _events, errors
from ._calls import Caller, is_transient, pause_s, segment
from ._io import Request
from .models import Event, Job

#: Streams that may break off without an event before the job is asked instead.
_VAIN_STREAMS = 2
_POLL_S = 1.0
FINAL = frozenset({"succeeded", "failed", "cancelled"})


@dataclass(frozen=True)
class Progress:
    """How far a job is."""

    job: str
    #: 0 to 1 over all tasks.
    fraction: float
    #: What the worker that told last is at: `fetch`, `import`, `structures`, `prepare`, `render` or `output`.
    phase: str | None = None
    #: Samples per pixel that are done, where the worker says.
    spp: int | None = None


OnProgress = Callable[[Progress], None]
OnEvent = Callable[[Event], None]


class Waiter:
    """One wait for one job."""

    def __init__(
        self,
        caller: Caller,
        job: str,
        *,
        timeout_s: float | None,
        patience_s: float,
        on_progress: OnProgress | None,
        on_event: OnEvent | None,
    ) -> None:
        self._caller = caller
        self._job = job
        self._path = f"v1/jobs/{segment(job)}"
        self._deadline = None if timeout_s is None else time.monotonic() + timeout_s
        self._timeout_s = timeout_s
        self._patience_s = patience_s
        self._on_progress = on_progress
        self._on_event = on_event
        self._last_event: int | None = None
        self._vain_streams = 0
        self._told: Progress | None = None

    async def wait(self) -> Job:
        """The job when it has ended, however it has."""
        failures, away_since = 0, None
        while True:
            try:
                while await self._follow():
                    pass
                # Whether it has ended, the job itself says: it may have been retried since its last event.
                job = await self._caller.json(Job, Request("GET", self._path))
                if job.state in FINAL or self._is_deaf:
                    self._tell(Progress(self._job, job.progress))
                if job.state in FINAL:
                    return job
                failures, away_since = 0, None
                self._check_time()
            except errors.LightshaftError as error:
                if not is_transient(error):
                    raise
                failures += 1
                away_since = away_since or time.monotonic()
                if time.monotonic() - away_since > self._patience_s:
                    raise
                self._check_time()
                await self._sleep(pause_s(failures, error))

    @property
    def _is_deaf(self) -> bool:
        return self._vain_streams >= _VAIN_STREAMS

    async def _follow(self) -> bool:
        """Until it is worth to look at the job; or true, to go on with a connection of less patience."""
        if self._is_deaf:
            await self._sleep(_POLL_S)
            return False
        self._vain_streams += 1
        patience_s = min(_events.PATIENCE_S, self._left_s())
        try:
            events = _events.stream(self._caller, f"{self._path}/events", self._last_event, patience_s)
            async with contextlib.aclosing(events):
                async for event in events:
                    self._vain_streams = 0
                    if event is not None:
                        self._hear(event)
                        if event.kind in _events.ENDS:
                            return False
                    self._check_time()
                    # Silence from here on must end with the caller's time, or shortly after.
                    if patience_s - self._left_s() > max(1.0, self._left_s()):
                        return True
        except errors.LightshaftError as error:
            # A proxy may refuse streams alone: whether the service itself is away, the next look at the job says.
            if not is_transient(error) and not isinstance(error, errors.UnexpectedAnswerError):
                raise
            await self._sleep(pause_s(1, error))
        return False

    def _hear(self, event: Event) -> None:
        self._last_event = event.id if event.id is not None else self._last_event
        if self._on_event:
            self._on_event(event)
        if event.kind == "job.progress" and isinstance(event.data, dict):
            data = event.data
            self._tell(Progress(self._job, float(data.get("job_progress", 0)), data.get("phase"), data.get("spp")))

    def _tell(self, progress: Progress) -> None:
        if self._on_progress and progress != self._told:
            self._on_progress(progress)
        self._told = progress

    async def _sleep(self, seconds: float) -> None:
        await self._caller.io.sleep(max(0.0, min(seconds, self._left_s())))

    def _left_s(self) -> float:
        return math.inf if self._deadline is None else self._deadline - time.monotonic()

    def _check_time(self) -> None:
        if self._left_s() <= 0.0:
            raise errors.WaitTimeoutError(f"job {self._job} did not end within {self._timeout_s:g} s")
