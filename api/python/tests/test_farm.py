"""The regression farm: from the first run of a suite to its decisions."""

from __future__ import annotations

from pathlib import Path

import pytest

from lightshaft import Client, InvalidRequestError, NotFoundError, Scene, WaitTimeoutError
from lightshaft.models import Run, Suite

SUITE = """
name = "{name}"
[defaults]
device = "cpu"
repeat = 1
time = "off"
settings = {{ width = 24, height = 24, spp = 2 }}
[[case]]
name = "path"
scene = "box"
[[case]]
name = "ao"
scene = "box"
settings = {{ width = 24, height = 24, spp = 1, integrator = "ao", ao_samples = 2 }}
"""


@pytest.fixture
def suite(client: Client, flavour: str, tmp_path: Path) -> Suite:
    """A suite that no other test's decisions touch."""
    path = tmp_path / "suite.toml"
    path.write_text(SUITE.format(name=f"{tmp_path.name} {flavour}"))
    return client.add_suite(path)


def _run(client: Client, suite: Suite, scene: Scene, label: str, **options: object) -> Run:
    run = client.start_run(suite, label, scenes={"box": scene}, **options)  # type: ignore[arg-type]
    return client.wait_for_run(run, timeout_s=60)


def test_a_suite_is_known_by_its_content(client: Client, suite: Suite, tmp_path: Path) -> None:
    assert [case.name for case in suite.cases] == ["path", "ao"]
    assert suite.cases[1].settings["integrator"] == "ao"
    assert (suite.cases[0].image, suite.cases[0].time) == ("identical", "off")
    assert client.suite(suite.id).hash == suite.hash
    assert client.add_suite(tmp_path / "suite.toml").id == suite.id
    assert [known.id for known in client.suites(name=suite.name).items] == [suite.id]
    other = client.add_suite({"name": suite.name, "case": [{"name": "path", "scene": "box"}]})
    assert other.id != suite.id
    assert len(client.suites(name=suite.name).items) == 2


def test_a_run_is_judged_approved_and_green(client: Client, suite: Suite, scene: Scene) -> None:
    seen: list[str] = []
    started = client.start_run(suite, "base", scenes={"box": scene}, labels={"driver": "none"})
    first = client.wait_for_run(started, timeout_s=60, on_run=lambda run: seen.append(run.state))
    assert seen[-1] == "finished"
    assert (first.ok, first.counts.missing, first.labels) == (False, 2, {"driver": "none"})
    decisions = client.approve(first, who="Ada", why="looked at")
    assert {(decision.case, decision.kind, decision.who) for decision in decisions} == {
        ("path", "approved", "Ada"),
        ("ao", "approved", "Ada"),
    }
    again = _run(client, suite, scene, "again")
    assert again.ok
    assert {case.image.verdict for case in again.cases if case.image} == {"identical"}
    brighter = _run(client, suite, scene, "brighter", overrides={"environment": 3}, cases=["path"])
    [case] = brighter.cases
    assert brighter.ok is False
    assert case.image is not None
    assert case.image.verdict == "changed"
    assert case.image.figures is not None
    assert case.image.figures.differing_pixels > 0
    for name in ("image.png", "heat-map.png"):
        assert client.case_artifact(brighter, "path", name).startswith(b"\x89PNG")
    [rejected] = client.reject(brighter, ["path"], who="Ada", why="too bright")
    assert rejected.kind == "rejected"
    mine = client.decisions(suite=suite.name)
    assert [decision.kind for decision in mine.items] == ["rejected", "approved", "approved"]
    assert [run.label for run in client.iterate_runs(suite=suite.name)] == ["brighter", "again", "base"]
    assert [run.label for run in client.runs(suite=suite.name, ok=True).items] == ["again", "base"], "approved"
    assert [run.label for run in client.runs(suite=suite.name, ok=False).items] == ["brighter"]


def test_what_is_accepted_can_be_looked_at_and_taken_back(client: Client, suite: Suite, scene: Scene) -> None:
    client.approve(_run(client, suite, scene, "base"), ["path"], who="Ada")
    [baseline] = client.baselines(suite.name)
    assert (baseline.case, len(baseline.pictures)) == ("path", 1)
    history = client.history(suite.name, "path")
    assert [point.label for point in history.points] == ["base"]
    assert [decision.who for decision in history.decisions] == ["Ada"]
    reset = client.reset_baseline(suite.name, who="Bob", why="another machine", case="path")
    assert (reset.kind, reset.why) == ("reset", "another machine")
    after = _run(client, suite, scene, "after", cases=["path"])
    assert after.counts.missing == 1


def test_noise_is_learnt_by_repeating(client: Client, suite: Suite, scene: Scene) -> None:
    calibration = client.calibrate(suite, "base", times=3, scenes={"box": scene}, cases=["path"])
    client.wait_for_run(calibration.id, timeout_s=60)
    [case] = client.calibration(calibration.id).cases
    assert len(case.medians_s) == 3
    assert case.steady is True
    assert case.noise_floor is not None
    assert case.noise_floor >= 0


def test_what_is_wrong_is_named(client: Client, suite: Suite, scene: Scene, tmp_path: Path) -> None:
    (tmp_path / "wrong.toml").write_text(SUITE.format(name="x").replace("spp = 1", "spp = 0"))
    with pytest.raises(InvalidRequestError) as refused:
        client.add_suite(tmp_path / "wrong.toml")
    assert [error.pointer for error in refused.value.errors] == ["/case/1/settings/spp"]
    with pytest.raises(InvalidRequestError, match="box"):
        client.start_run(suite, "base")
    with pytest.raises(NotFoundError):
        client.wait_for_run("no-such-run")
    slow = client.start_run(suite, "slow", scenes={"box": scene}, overrides={"spp": 1 << 20})
    with pytest.raises(WaitTimeoutError, match=slow.id):
        client.wait_for_run(slow, timeout_s=0.2)
    assert client.cancel_run(slow).state == "cancelled"


def test_a_key_begins_one_run(client: Client, suite: Suite, scene: Scene) -> None:
    key = suite.id
    first = client.start_run(suite, "one", scenes={"box": scene}, idempotency_key=key)
    assert client.start_run(suite, "one", scenes={"box": scene}, idempotency_key=key).id == first.id
    with pytest.raises(InvalidRequestError):
        client.start_run(suite, "two", scenes={"box": scene}, idempotency_key=key)
    client.cancel_run(first)


def test_schedules_are_added_and_deleted(client: Client, suite: Suite, scene: Scene, flavour: str) -> None:
    schedule = client.add_schedule(f"nightly {flavour}", "30 2 * * 1-5", suite, "nightly", scenes={"box": scene})
    assert (schedule.next_at is not None, schedule.run.suite) == (True, suite.id)
    assert schedule in client.schedules()
    paused = client.change_schedule(schedule, paused=True)
    assert (paused.paused, paused.next_at) == (True, None)
    assert client.change_schedule(schedule.id, paused=False) == schedule
    client.delete_schedule(schedule)
    assert schedule not in client.schedules()


def test_webhooks_are_told_of_what_they_asked_for(client: Client, suite: Suite, scene: Scene) -> None:
    secret = "correct horse battery staple"
    with pytest.raises(InvalidRequestError, match="/url"):
        client.add_webhook("http://127.0.0.1:9/", secret=secret)
    # Nobody can have this name (RFC 6761).
    webhook = client.add_webhook("https://nobody.invalid/", secret=secret, events=["run.finished"], suite=suite.name)
    assert webhook in client.webhooks()
    run = _run(client, suite, scene, "told")
    (delivery,) = client.deliveries(webhook.id).items
    assert (delivery.state, delivery.message.type) == ("waiting", "run.finished")
    assert isinstance(delivery.message.data, dict)
    assert delivery.message.data["id"] == run.id
    assert client.webhook(webhook.id).waiting == 1
    again = client.resend_delivery(webhook.id, delivery.id)
    assert (again.id, again.state, again.message) == (delivery.id, "waiting", delivery.message)
    with pytest.raises(NotFoundError):
        client.resend_delivery(webhook.id, "no-such-message")
    client.delete_webhook(webhook.id)
    with pytest.raises(NotFoundError):
        client.deliveries(webhook.id)
