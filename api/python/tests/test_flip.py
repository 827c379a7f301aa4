"""The FLIP figures of `lightshaft compare` against those of NVIDIA's own package."""

from __future__ import annotations

import importlib.util
import json
import subprocess
from pathlib import Path
from types import ModuleType

import flip_evaluator
import numpy as np
import OpenEXR
import pytest
from numpy.typing import NDArray
from PIL import Image

from .service import BINARY, REPOSITORY

TESTS = REPOSITORY / "worker" / "compare" / "tests"
#: Means agree at least to this.
TOLERANCE = 1e-3


@pytest.fixture(scope="module")
def pairs() -> ModuleType:
    """The pictures that the tests of the crate `compare` use."""
    spec = importlib.util.spec_from_file_location("nvidia_flip", TESTS / "nvidia_flip.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def compare(a: Path, b: Path, *options: str) -> dict[str, object]:
    made = subprocess.run([BINARY, "compare", a, b, "--json", *options], capture_output=True, check=True)
    found: dict[str, object] = json.loads(made.stdout)
    return found


def test_the_table_that_rust_is_tested_by_is_that_of_the_package(pairs: ModuleType) -> None:
    stored = (TESTS / "nvidia_flip.csv").read_text().splitlines()
    fresh = pairs.rows()
    assert stored[0] == fresh[0]
    for old, new in zip(stored[1:], fresh[1:], strict=True):
        (*names, mean, _, _, count), (*new_names, new_mean, _, _, new_count) = old.split(","), new.split(",")
        assert (names, count) == (new_names, new_count)
        assert float(mean) == pytest.approx(float(new_mean), abs=1e-5), names


@pytest.mark.parametrize("change", ["shift 5", "blur", "noise"])
def test_pngs_have_the_mean_of_ldr_flip(pairs: ModuleType, tmp_path: Path, change: str) -> None:
    pictures = [pairs.to_8_bits(pairs.ramp()), pairs.to_8_bits(pairs.CHANGES[change](pairs.ramp()))]
    paths = (tmp_path / "a.png", tmp_path / "b.png")
    for path, picture in zip(paths, pictures, strict=True):
        Image.fromarray(np.rint(picture * 255).astype(np.uint8)).save(path)
    _, mean, _ = flip_evaluator.evaluate(*pictures, "LDR", applyMagma=False)
    assert compare(*paths)["flip_mean"] == pytest.approx(mean, abs=TOLERANCE)


@pytest.mark.parametrize("change", ["shift 1", "brighter", "fireflies", "clipped"])
def test_exrs_have_the_mean_of_hdr_flip(pairs: ModuleType, tmp_path: Path, change: str) -> None:
    # OpenEXR writes memory as it lies.
    pictures: list[NDArray[np.float32]] = [
        np.ascontiguousarray(picture, dtype=np.float32)
        for picture in (pairs.room(), pairs.CHANGES[change](pairs.room()))
    ]
    paths = (tmp_path / "a.exr", tmp_path / "b.exr")
    for path, picture in zip(paths, pictures, strict=True):
        OpenEXR.File({}, {"RGB": picture}).write(str(path))
    _, mean, settings = flip_evaluator.evaluate(*pictures, "HDR", applyMagma=False, parameters={})
    found = compare(*paths, "--hdr")["hdr_flip"]
    assert isinstance(found, dict)
    assert found["mean"] == pytest.approx(mean, abs=TOLERANCE)
    assert found["exposures"] == settings["numExposures"]
    assert found["start_exposure"] == pytest.approx(settings["startExposure"], abs=1e-4)
