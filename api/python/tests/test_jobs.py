"""From submitting to the picture, and the ways in which that does not come."""

from __future__ import annotations

import json
import time
from pathlib import Path

import pytest

from lightshaft import (
    Acceleration,
    BuildSettings,
    Client,
    CompareRequest,
    ConflictError,
    InvalidRequestError,
    JobFailedError,
    NotFoundError,
    PictureChoice,
    ProblemError,
    Progress,
    RenderSettings,
    Scene,
    WaitTimeoutError,
)
from lightshaft.models import CustomCamera, Event

SMALL = {"width": 32, "height": 24, "spp": 2, "device": "cpu"}
#: More than a worker renders while a test looks at it.
LONG = {"width": 512, "height": 512, "spp": 1 << 20, "device": "cpu"}


def test_a_picture_is_rendered_and_fetched(client: Client, scene: Scene, tmp_path: Path) -> None:
    progress: list[Progress] = []
    events: list[Event] = []
    job = client.submit(scene, SMALL, labels={"commit": "abc"}, priority=3)
    assert (job.state, job.priority, job.labels) == ("queued", 3, {"commit": "abc"})
    done = client.wait(job, timeout_s=60, on_progress=progress.append, on_event=events.append)
    assert done.state == "succeeded"
    assert done.metrics is not None
    assert done.metrics.rays.primary == 32 * 24 * 2
    assert done.metrics.device_kind == "cpu"
    assert done.settings["width"] == 32
    assert done.finished_at is not None
    assert done.finished_at.tzinfo is not None
    assert progress[-1].fraction == 1.0
    assert [event.kind for event in events if event.id is not None][-1] == "job.succeeded"
    names = {artifact.name for artifact in client.artifacts(job)}
    assert {"image.png", "image.exr", "metrics.json"} <= names
    path = client.download(job, "image.png", tmp_path)
    assert path == tmp_path / "image.png"
    assert path.read_bytes() == client.artifact(job, "image.png") == client.preview(job)
    assert {path.name for path in client.download_all(job.id, tmp_path / "new" / "folder")} == names
    assert "===" in client.log(job) or client.log(job)


def test_typed_settings_are_the_same_as_a_dictionary(client: Client, scene: Scene) -> None:
    typed = RenderSettings(
        integrator="ao",
        width=32,
        height=24,
        camera=CustomCamera(position=[0, 0, 5], target=[0, 0, 0]),
        acceleration=Acceleration(structure="grid", resolution=8),
    )
    plain = {
        "integrator": "ao",
        "width": 32,
        "height": 24,
        "camera": {"position": [0, 0, 5], "target": [0, 0, 0]},
        "acceleration": {"structure": "grid", "resolution": 8},
    }
    checked = client.validate_job(scene, typed)
    assert checked == client.validate_job(scene, plain)
    assert (checked["integrator"], checked["seed"]) == ("ao", 1), "with every default"
    assert checked["acceleration"]["resolution"] == 8


def test_the_kind_is_that_of_the_settings(client: Client, scene: Scene) -> None:
    build = client.submit(scene, BuildSettings(acceleration={"quality": "fast"}))
    assert build.kind == "build"
    assert client.submit(scene, {"acceleration": {"quality": "fast"}}, kind="build").kind == "build"
    assert client.wait(build, timeout_s=60).metrics is not None
    mesh = client.mesh(scene.meshes[0].hash)
    assert mesh.structures
    assert mesh.triangles == scene.meshes[0].triangles


def test_pictures_are_compared_by_a_job(client: Client, scene: Scene) -> None:
    small = {"width": 24, "height": 16, "spp": 1}
    a, b = (client.wait(client.submit(scene, small | {"seed": seed}), timeout_s=60) for seed in (1, 2))
    request = CompareRequest(a=PictureChoice(job=a.id), b=PictureChoice(job=b.id), max_flip=1.0)
    job = client.wait(client.submit(None, request), timeout_s=60)
    assert (job.kind, job.scene) == ("compare", scene.id)
    found = json.loads(client.artifact(job, "comparison.json"))
    assert found["passed"] is True
    assert found["differing_pixels"] > 0
    assert client.artifact(job, "heatmap.png").startswith(b"\x89PNG")


def test_a_wrong_setting_is_named(client: Client, scene: Scene) -> None:
    for settings, pointers in [
        ({"width": 0, "spp": 0}, {"/settings/width", "/settings/spp"}),
        ({"spp": -1, "heigth": 3}, {"/settings/spp", "/settings/heigth"}),
    ]:
        with pytest.raises(InvalidRequestError, match=f"{min(pointers)}: ") as refused:
            client.submit(scene, settings)
        assert (refused.value.status, refused.value.code) == (422, "invalid-fields")
        assert {wrong.pointer for wrong in refused.value.errors} == pointers
        assert all(wrong.detail for wrong in refused.value.errors)
    with pytest.raises(InvalidRequestError) as refused:
        client.submit("no-such-scene", SMALL)
    assert refused.value.errors[0].pointer == "/scene"


def test_a_key_gives_one_job(client: Client, scene: Scene, flavour: str) -> None:
    key = f"one job for {flavour}".replace(" ", "-")
    first = client.submit(scene, SMALL, idempotency_key=key)
    assert client.submit(scene, SMALL, idempotency_key=key).id == first.id
    assert client.submit(scene, SMALL).id != first.id
    with pytest.raises(ProblemError, match="key") as refused:
        client.submit(scene, {**SMALL, "spp": 3}, idempotency_key=key)
    assert refused.value.code == "idempotency-key-reused"


def test_a_job_is_cancelled_retried_changed_and_deleted(client: Client, scene: Scene) -> None:
    job = client.submit(scene, LONG)
    client.change_job(job, priority=-7)
    assert client.change_job(job, paused=True).priority == -7
    with pytest.raises(ConflictError) as refused:
        client.retry(job)
    assert refused.value.code == "wrong-state"
    client.cancel(job)
    with pytest.raises(JobFailedError, match="was cancelled") as failed:
        client.wait(job, timeout_s=60)
    assert failed.value.job.state == "cancelled"
    assert client.wait(job, check=False).state == "cancelled"
    assert client.retry(job).state in ("queued", "running")
    client.cancel(job)
    client.wait(job, timeout_s=60, check=False)
    client.delete_job(job)
    with pytest.raises(NotFoundError):
        client.job(job.id)


def test_waiting_ends_with_the_time_that_it_was_given(client: Client, scene: Scene) -> None:
    job = client.submit(scene, LONG)
    try:
        began = time.monotonic()
        with pytest.raises(WaitTimeoutError, match=job.id):
            client.wait(job, timeout_s=1.5)
        assert 1.4 < time.monotonic() - began < 6
        assert isinstance(WaitTimeoutError("x"), TimeoutError)
    finally:
        client.cancel(job)
        client.wait(job, timeout_s=60, check=False)


def test_jobs_are_listed_by_what_they_are(client: Client, scene: Scene, flavour: str) -> None:
    labels = {"list": flavour}
    ids = {client.wait(client.submit(scene, SMALL, labels=labels), timeout_s=60).id for _ in range(3)}
    first = client.jobs(labels=labels, limit=2)
    assert len(first.items) == 2
    assert len(client.jobs(labels=labels, limit=2, cursor=first.next_cursor).items) == 1
    assert {job.id for job in client.iterate_jobs(labels=labels, state="succeeded", kind="render")} == ids
    assert list(client.iterate_jobs(labels=labels, state="failed")) == []
    assert list(client.iterate_jobs(labels=labels, automatic=True)) == []
    assert client.jobs(scene=scene.id, q=flavour, limit=1).items


def test_events_go_on_after_the_last_that_was_seen(client: Client, scene: Scene) -> None:
    job = client.wait(client.submit(scene, SMALL), timeout_s=60)
    all_of_it = list(client.events(job))
    kept = [event.id for event in all_of_it if event.id is not None]
    assert kept == sorted(kept)
    assert all_of_it[0].kind == "job.created"
    assert all_of_it[-1].kind == "job.succeeded"
    rest = client.events(job, last_event_id=kept[1])
    assert [event.id for event in rest] == kept[2:]


def test_workers_and_service_tell_of_themselves(client: Client, scene: Scene) -> None:
    [worker] = client.workers()
    assert client.worker(worker.id).name == worker.name
    assert worker.devices[0].kind == "cpu"
    assert client.drain_worker(worker.id).draining
    assert not client.undrain_worker(worker.id).draining
    status = client.status()
    assert status.scenes >= 1
    assert status.workers.gone == 0
