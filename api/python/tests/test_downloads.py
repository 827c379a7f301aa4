"""Files come whole or not at all."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from lightshaft import Client, Job, MissingExtraError, NotFoundError, Scene, UnreachableError

from .conftest import Connect
from .service import Cut, Proxy, Service


@pytest.fixture(scope="session")
def rendered(service: Service, scene: Scene) -> Job:
    settings = {"width": 96, "height": 64, "spp": 1, "device": "cpu", "aovs": ["depth", "albedo", "instance_id"]}
    with Client(service.url) as client:
        return client.wait(client.submit(scene, settings), timeout_s=60)


def test_a_connection_that_breaks_is_taken_up_where_it_broke(
    connect: Connect, service: Service, proxy: Callable[[str, Cut], Proxy], rendered: Job, tmp_path: Path
) -> None:
    broken = proxy(service.url, lambda _: 12000)
    whole = connect(service.url).artifact(rendered, "image.exr")
    received: list[tuple[int, int | None]] = []
    client = connect(broken.url, retries=1)
    path = client.download(
        rendered, "image.exr", tmp_path / "a.exr", on_received=lambda done, total: received.append((done, total))
    )
    assert path.read_bytes() == whole
    assert received[-1] == (len(whole), len(whole))
    starts = [int(start[1]) for head in broken.requests if (start := re.search(r"(?i)\nrange: bytes=(\d+)-", head))]
    assert len(starts) >= len(whole) // 12000
    assert starts == sorted(set(starts)), "each goes on further"
    assert all("if-range" in head.lower() for head in broken.requests[1:])


def test_a_download_that_fails_leaves_what_was_there(
    connect: Connect, service: Service, proxy: Callable[[str, Cut], Proxy], rendered: Job, tmp_path: Path
) -> None:
    path = tmp_path / "a.exr"
    path.write_text("old")
    served = iter([5000, *[0] * 100])
    client = connect(proxy(service.url, lambda _: next(served)).url, retries=1)
    with pytest.raises(UnreachableError):
        client.download(rendered, "image.exr", path)
    with pytest.raises(NotFoundError):
        connect(service.url).download(rendered, "no.exr", path)
    assert path.read_text() == "old"
    assert [file.name for file in tmp_path.iterdir()] == ["a.exr"], "nothing is left beside it"


def test_pictures_are_arrays(client: Client, rendered: Job) -> None:
    png = client.picture(rendered, "image.png")
    assert png.shape == (64, 96, 3)
    assert png.dtype == np.uint8
    color = client.picture(rendered)
    assert color.shape == (64, 96, 3)
    assert color.dtype == np.float32
    assert np.isfinite(color).all()
    assert color.max() > 0
    # The brightest quarter of one is bright in the other: same order of rows, columns and channels.
    bright = color.sum(axis=-1) >= np.quantile(color.sum(axis=-1), 0.75)
    assert png[bright].mean() > png[~bright].mean() + 20
    layers = client.layers(rendered)
    assert set(layers) == {"color", "depth", "albedo", "instance_id"}
    assert layers["depth"].shape == (64, 96)
    assert layers["instance_id"].dtype == np.uint32
    assert np.array_equal(client.picture(rendered, layer="albedo"), layers["albedo"])
    with pytest.raises(KeyError, match="it has albedo, color, depth, instance_id"):
        client.picture(rendered, layer="normal")
    with pytest.raises(ValueError, match="only an EXR has layers"):
        client.picture(rendered, "image.png", layer="albedo")


def test_without_its_packages_a_picture_says_what_to_install(
    client: Client, rendered: Job, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "OpenEXR", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'lightshaft\[pictures\]'") as missing:
        client.picture(rendered)
    assert missing.value.extra == "pictures"


def test_pictures_of_jobs_are_compared(client: Client, scene: Scene) -> None:
    settings = {"width": 24, "height": 24, "spp": 1, "seed": 1}
    jobs = [client.wait(client.submit(scene, settings | {"seed": seed})) for seed in (1, 2)]
    same = client.compare(jobs[0], jobs[0], max_rmse=0.0)
    assert (same.passed, same.flip_mean, same.hdr_flip) == (True, 0.0, None)
    other = client.compare(jobs[0], jobs[1].id, hdr=True, max_flip=0.0)
    assert other.hdr_flip is not None
    assert (other.passed, other.hdr_flip.mean > 0) == (False, True)
