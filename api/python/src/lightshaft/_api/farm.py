"""The regression farm: suites, runs, verdicts, baselines, decisions."""

from __future__ import annotations

import math
import os
import time
import uuid
from collections.abc import AsyncGenerator, Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from .. import errors
from .._calls import is_transient, pause_s, query, segment
from .._io import Request
from .._page import Page, every
from ..models import (
    Baseline,
    Calibration,
    Decision,
    DecisionKind,
    History,
    Run,
    RunKind,
    RunState,
    RunSummary,
    Scene,
    Schedule,
    Suite,
    SuiteSummary,
)
from .base import Base

#: Called whenever a run that is waited for has another look.
OnRun = Callable[[Run], None]

_POLL_S = 1.0


class Farm(Base):
    """Is the picture still right, and is it still as fast?"""

    async def add_suite(self, suite: str | os.PathLike[str] | Mapping[str, Any]) -> Suite:
        """Makes sure that the service has this version of a suite: a TOML file, or what it says as a dictionary."""
        if isinstance(suite, Mapping):
            return await self._caller.json(Suite, Request("POST", "v1/farm/suites", json=dict(suite)))
        content = await self._io.blocking(Path(suite).read_bytes)
        headers = {"Content-Type": "application/toml", "Content-Length": str(len(content))}
        request = Request("POST", "v1/farm/suites", headers=headers, pieces=lambda: iter([content]))
        return await self._caller.json(Suite, request)

    async def suite(self, suite: str) -> Suite:
        """A version of a suite: its cases with every default filled in."""
        return await self._caller.json(Suite, Request("GET", f"v1/farm/suites/{segment(suite)}"))

    async def suites(self, *, name: str | None = None, cursor: str | None = None) -> Page[SuiteSummary]:
        """One page of the versions of suites, newest first."""
        request = Request("GET", "v1/farm/suites", query(name=name, cursor=cursor))
        return await self._caller.page(SuiteSummary, request)

    async def start_run(
        self,
        suite: str | Suite,
        label: str,
        *,
        labels: Mapping[str, str] | None = None,
        baseline: str = "main",
        scenes: Mapping[str, str | Scene] | None = None,
        overrides: Mapping[str, Any] | None = None,
        cases: Sequence[str] = (),
        priority: int = 0,
        idempotency_key: str | None = None,
    ) -> Run:
        """Renders every case of a suite, or those that are named, and judges each against a baseline.

        `scenes` says which scene is meant by each name of the suite's. Calls with the same key give the same run.
        """
        run = _of_suite(suite, label, labels, scenes, overrides, cases, priority) | {"baseline": baseline}
        headers = {"Idempotency-Key": idempotency_key or str(uuid.uuid4())}
        return await self._caller.json(Run, Request("POST", "v1/farm/runs", headers=headers, json=run))

    async def run(self, run: str) -> Run:
        """A run with the verdict of every case."""
        return await self._caller.json(Run, Request("GET", _run_path(run)))

    async def runs(
        self,
        *,
        kind: RunKind | None = None,
        state: RunState | None = None,
        suite: str | None = None,
        label: str | None = None,
        baseline: str | None = None,
        ok: bool | None = None,
        limit: int | None = None,
        cursor: str | None = None,
    ) -> Page[RunSummary]:
        """One page of the runs, newest first; `suite` is a name."""
        parameters = query(kind=kind, state=state, suite=suite, label=label, baseline=baseline, ok=ok)
        request = Request("GET", "v1/farm/runs", parameters + query(limit=limit, cursor=cursor))
        return await self._caller.page(RunSummary, request)

    def iterate_runs(
        self,
        *,
        kind: RunKind | None = None,
        state: RunState | None = None,
        suite: str | None = None,
        label: str | None = None,
        baseline: str | None = None,
        ok: bool | None = None,
    ) -> AsyncGenerator[RunSummary, None]:
        """All runs that fit, newest first."""
        return every(
            lambda cursor: self.runs(
                kind=kind, state=state, suite=suite, label=label, baseline=baseline, ok=ok, cursor=cursor
            )
        )

    async def wait_for_run(
        self,
        run: str | Run,
        *,
        timeout_s: float | None = None,
        patience_s: float = 60.0,
        on_run: OnRun | None = None,
    ) -> Run:
        """Waits until every case has its verdict; whether all is well is in `ok`.

        Outlasts restarts of the service of up to `patience_s`. Raises `WaitTimeoutError` when the time is up.
        """
        run_id = run if isinstance(run, str) else run.id
        deadline = math.inf if timeout_s is None else time.monotonic() + timeout_s
        failures, away_since = 0, None
        while True:
            pause = _POLL_S
            try:
                found = await self.run(run_id)
                failures, away_since = 0, None
                if on_run:
                    on_run(found)
                if found.state != "running":
                    return found
            except errors.LightshaftError as error:
                failures += 1
                away_since = away_since or time.monotonic()
                if not is_transient(error) or time.monotonic() - away_since > patience_s:
                    raise
                pause = pause_s(failures, error)
            left_s = deadline - time.monotonic()
            if left_s <= 0:
                raise errors.WaitTimeoutError(f"run {run_id} did not end within {timeout_s:g} s")
            await self._io.sleep(min(pause, left_s))

    async def cancel_run(self, run: str | Run) -> Run:
        """Cancels a run and its jobs."""
        return await self._caller.json(Run, Request("POST", f"{_run_path(run)}/cancel"))

    async def approve(self, run: str | Run, cases: Sequence[str] = (), *, who: str, why: str = "") -> list[Decision]:
        """Accepts the pictures and times of cases; without names, of all that do not pass and are undecided."""
        return await self._decide(run, "approve", cases, who, why)

    async def reject(self, run: str | Run, cases: Sequence[str] = (), *, who: str, why: str = "") -> list[Decision]:
        """Says that cases are wrong: they stay red whatever their verdicts are."""
        return await self._decide(run, "reject", cases, who, why)

    async def _decide(self, run: str | Run, verb: str, cases: Sequence[str], who: str, why: str) -> list[Decision]:
        body = {"who": who, "why": why, "cases": list(cases)}
        request = Request("POST", f"{_run_path(run)}/{verb}", json=body, is_repeatable=False)
        return (await self._caller.page(Decision, request)).items

    async def case_artifact(self, run: str | Run, case: str, name: str = "image.png") -> bytes:
        """What a case left: `image.png`, `image.exr`, of a changed picture also `heat-map.png`, `difference.png`."""
        path = f"{_run_path(run)}/cases/{segment(case)}/artifacts/{segment(name)}"
        return await self._caller.content(Request("GET", path))

    async def decisions(
        self,
        *,
        kind: DecisionKind | None = None,
        suite: str | None = None,
        case: str | None = None,
        baseline: str | None = None,
        run: str | None = None,
        who: str | None = None,
        limit: int | None = None,
        cursor: str | None = None,
    ) -> Page[Decision]:
        """One page of what people decided, newest first."""
        parameters = query(kind=kind, suite=suite, case=case, baseline=baseline, run=run, who=who)
        request = Request("GET", "v1/farm/decisions", parameters + query(limit=limit, cursor=cursor))
        return await self._caller.page(Decision, request)

    async def baselines(self, suite: str, *, baseline: str = "main") -> list[Baseline]:
        """What is accepted for the cases of a suite, by its name."""
        request = Request("GET", f"v1/farm/baselines/{segment(baseline)}", query(suite=suite))
        return (await self._caller.page(Baseline, request)).items

    async def reset_baseline(
        self,
        suite: str,
        *,
        who: str,
        why: str,
        case: str | None = None,
        device_class: str | None = None,
        baseline: str = "main",
    ) -> Decision:
        """Takes back what is accepted for a case, or for a whole suite."""
        body = {"who": who, "why": why, "suite": suite, "case": case, "device_class": device_class}
        path = f"v1/farm/baselines/{segment(baseline)}/reset"
        return await self._caller.json(Decision, Request("POST", path, json=body, is_repeatable=False))

    async def history(
        self, suite: str, case: str, *, device_class: str | None = None, baseline: str | None = None
    ) -> History:
        """A case over its labels: times, change points, accepted pictures, decisions."""
        parameters = query(suite=suite, case=case, device_class=device_class, baseline=baseline)
        return await self._caller.json(History, Request("GET", "v1/farm/history", parameters))

    async def calibrate(
        self,
        suite: str | Suite,
        label: str,
        *,
        times: int = 10,
        labels: Mapping[str, str] | None = None,
        scenes: Mapping[str, str | Scene] | None = None,
        overrides: Mapping[str, Any] | None = None,
        cases: Sequence[str] = (),
        priority: int = 0,
    ) -> Calibration:
        """Repeats what is unchanged, to learn how far its times scatter. Its id is also that of a run to wait for."""
        body = _of_suite(suite, label, labels, scenes, overrides, cases, priority) | {"times": times}
        request = Request("POST", "v1/farm/calibrations", json=body, is_repeatable=False)
        return await self._caller.json(Calibration, request)

    async def calibration(self, calibration: str) -> Calibration:
        """The noise of each case, as far as it is known."""
        return await self._caller.json(Calibration, Request("GET", f"v1/farm/calibrations/{segment(calibration)}"))

    async def add_schedule(
        self,
        name: str,
        cron: str,
        suite: str | Suite,
        label: str,
        *,
        labels: Mapping[str, str] | None = None,
        baseline: str = "main",
        scenes: Mapping[str, str | Scene] | None = None,
        overrides: Mapping[str, Any] | None = None,
        cases: Sequence[str] = (),
        priority: int = 0,
        paused: bool = False,
    ) -> Schedule:
        """Begins a run by the clock: `cron` is minute, hour, day, month and day of the week, in UTC."""
        run = _of_suite(suite, label, labels, scenes, overrides, cases, priority) | {"baseline": baseline}
        body = {"name": name, "cron": cron, "run": run, "paused": paused}
        return await self._caller.json(Schedule, Request("POST", "v1/farm/schedules", json=body, is_repeatable=False))

    async def schedules(self) -> list[Schedule]:
        """All schedules by name."""
        return (await self._caller.page(Schedule, Request("GET", "v1/farm/schedules"))).items

    async def change_schedule(self, schedule: str | Schedule, *, paused: bool) -> Schedule:
        """Pauses a schedule, or resumes it from now on: times that passed meanwhile are skipped."""
        request = Request("PATCH", _schedule_path(schedule), json={"paused": paused})
        return await self._caller.json(Schedule, request)

    async def delete_schedule(self, schedule: str | Schedule) -> None:
        """Deletes a schedule; runs that it began stay."""
        await self._caller.content(Request("DELETE", _schedule_path(schedule)))


def _of_suite(
    suite: str | Suite,
    label: str,
    labels: Mapping[str, str] | None,
    scenes: Mapping[str, str | Scene] | None,
    overrides: Mapping[str, Any] | None,
    cases: Sequence[str],
    priority: int,
) -> dict[str, Any]:
    return {
        "suite": suite if isinstance(suite, str) else suite.id,
        "label": label,
        "labels": dict(labels or {}),
        "scenes": {name: scene if isinstance(scene, str) else scene.id for name, scene in (scenes or {}).items()},
        "overrides": dict(overrides or {}),
        "cases": list(cases),
        "priority": priority,
    }


def _schedule_path(schedule: str | Schedule) -> str:
    return f"v1/farm/schedules/{segment(schedule if isinstance(schedule, str) else schedule.id)}"


def _run_path(run: str | Run) -> str:
    return f"v1/farm/runs/{segment(run if isinstance(run, str) else run.id)}"
