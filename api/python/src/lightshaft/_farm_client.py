"""The farm's calls of the client that blocks."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, TypeVar

from ._api.farm import Farm, OnRun
from ._io import iterate
from ._io import run as run_to_end
from ._page import Page
from .models import (
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
    Suite,
    SuiteSummary,
)

F = TypeVar("F", bound=Callable[..., Any])


def documented_as(original: Callable[..., Any]) -> Callable[[F], F]:
    """Documents a call as the other client's of the same name."""

    def documented(call: F) -> F:
        call.__doc__ = original.__doc__
        return call

    return documented


class FarmClient:
    """The regression farm; every call is that of `AsyncClient`."""

    _calls: Farm

    @documented_as(Farm.add_suite)
    def add_suite(self, suite: str | os.PathLike[str] | Mapping[str, Any]) -> Suite:
        return run_to_end(self._calls.add_suite(suite))

    @documented_as(Farm.suite)
    def suite(self, suite: str) -> Suite:
        return run_to_end(self._calls.suite(suite))

    @documented_as(Farm.suites)
    def suites(self, *, name: str | None = None, cursor: str | None = None) -> Page[SuiteSummary]:
        return run_to_end(self._calls.suites(name=name, cursor=cursor))

    @documented_as(Farm.start_run)
    def start_run(
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
    ) -> Run:
        return run_to_end(
            self._calls.start_run(
                suite,
                label,
                labels=labels,
                baseline=baseline,
                scenes=scenes,
                overrides=overrides,
                cases=cases,
                priority=priority,
            )
        )

    @documented_as(Farm.run)
    def run(self, run: str) -> Run:
        return run_to_end(self._calls.run(run))

    @documented_as(Farm.runs)
    def runs(
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
        return run_to_end(
            self._calls.runs(
                kind=kind, state=state, suite=suite, label=label, baseline=baseline, ok=ok, limit=limit, cursor=cursor
            )
        )

    @documented_as(Farm.iterate_runs)
    def iterate_runs(
        self,
        *,
        kind: RunKind | None = None,
        state: RunState | None = None,
        suite: str | None = None,
        label: str | None = None,
        baseline: str | None = None,
        ok: bool | None = None,
    ) -> Iterator[RunSummary]:
        return iterate(
            self._calls.iterate_runs(kind=kind, state=state, suite=suite, label=label, baseline=baseline, ok=ok)
        )

    @documented_as(Farm.wait_for_run)
    def wait_for_run(
        self, run: str | Run, *, timeout_s: float | None = None, patience_s: float = 60.0, on_run: OnRun | None = None
    ) -> Run:
        return run_to_end(self._calls.wait_for_run(run, timeout_s=timeout_s, patience_s=patience_s, on_run=on_run))

    @documented_as(Farm.cancel_run)
    def cancel_run(self, run: str | Run) -> Run:
        return run_to_end(self._calls.cancel_run(run))

    @documented_as(Farm.approve)
    def approve(self, run: str | Run, cases: Sequence[str] = (), *, who: str, why: str = "") -> list[Decision]:
        return run_to_end(self._calls.approve(run, cases, who=who, why=why))

    @documented_as(Farm.reject)
    def reject(self, run: str | Run, cases: Sequence[str] = (), *, who: str, why: str = "") -> list[Decision]:
        return run_to_end(self._calls.reject(run, cases, who=who, why=why))

    @documented_as(Farm.case_artifact)
    def case_artifact(self, run: str | Run, case: str, name: str = "image.png") -> bytes:
        return run_to_end(self._calls.case_artifact(run, case, name))

    @documented_as(Farm.decisions)
    def decisions(
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
        return run_to_end(
            self._calls.decisions(
                kind=kind, suite=suite, case=case, baseline=baseline, run=run, who=who, limit=limit, cursor=cursor
            )
        )

    @documented_as(Farm.baselines)
    def baselines(self, suite: str, *, baseline: str = "main") -> list[Baseline]:
        return run_to_end(self._calls.baselines(suite, baseline=baseline))

    @documented_as(Farm.reset_baseline)
    def reset_baseline(
        self,
        suite: str,
        *,
        who: str,
        why: str,
        case: str | None = None,
        device_class: str | None = None,
        baseline: str = "main",
    ) -> Decision:
        return run_to_end(
            self._calls.reset_baseline(suite, who=who, why=why, case=case, device_class=device_class, baseline=baseline)
        )

    @documented_as(Farm.history)
    def history(
        self, suite: str, case: str, *, device_class: str | None = None, baseline: str | None = None
    ) -> History:
        return run_to_end(self._calls.history(suite, case, device_class=device_class, baseline=baseline))

    @documented_as(Farm.calibrate)
    def calibrate(
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
        return run_to_end(
            self._calls.calibrate(
                suite,
                label,
                times=times,
                labels=labels,
                scenes=scenes,
                overrides=overrides,
                cases=cases,
                priority=priority,
            )
        )

    @documented_as(Farm.calibration)
    def calibration(self, calibration: str) -> Calibration:
        return run_to_end(self._calls.calibration(calibration))
