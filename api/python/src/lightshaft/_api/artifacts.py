"""What jobs leave: files and pictures."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from .. import _download, _pictures
from .._calls import segment
from .._download import OnReceived
from .._io import Request
from ..models import Artifact, Compared, Job
from .base import Base, job_id, job_path

if TYPE_CHECKING:
    from .._pictures import Array

T = TypeVar("T")


class Artifacts(Base):
    """Into memory, into files, into arrays."""

    async def artifact(self, job: str | Job, name: str = "image.png") -> bytes:
        """An artifact in memory."""
        return await self._caller.content(Request("GET", _path(job, name)))

    async def compare(
        self,
        a: str | Job,
        b: str | Job,
        *,
        artifact: str | None = None,
        layer: str | None = None,
        tolerance: float = 0.0,
        hdr: bool = False,
        max_rmse: float | None = None,
        max_flip: float | None = None,
        max_hdr_flip: float | None = None,
    ) -> Compared:
        """How far the picture of job `b` is from that of the reference `a`, and whether it keeps the limits.

        Of the EXR where there is one. `hdr` asks for HDR-FLIP, too: differences at the exposure that shows them best.
        """
        body = {
            "a": {"job": job_id(a), "artifact": artifact, "layer": layer},
            "b": {"job": job_id(b), "artifact": artifact, "layer": layer},
            "tolerance": tolerance,
            "hdr": hdr,
            "max_rmse": max_rmse,
            "max_flip": max_flip,
            "max_hdr_flip": max_hdr_flip,
        }
        return await self._caller.json(Compared, Request("POST", "v1/compare", json=body))

    async def download(
        self,
        job: str | Job,
        name: str = "image.png",
        path: str | os.PathLike[str] | None = None,
        *,
        on_received: OnReceived | None = None,
    ) -> Path:
        """Streams an artifact into a file: whole or not at all, and going on where a connection broke.

        `path` may be a folder; without one the file goes to the working directory, under its own name. `on_received`
        hears of the bytes that have come, and of all that there are.
        """
        target = Path(path or ".")
        if await self._io.blocking(target.is_dir):
            target = target / Path(name).name
        href = _path(job, name)
        return await _download.to_path(self._caller, href, target, self._retries, on_received)

    async def download_all(self, job: str | Job, folder: str | os.PathLike[str]) -> list[Path]:
        """Every artifact of a job, into a folder that is made where it is not there."""
        target = Path(folder)
        await self._io.blocking(lambda: target.mkdir(parents=True, exist_ok=True))
        return [await self.download(job, artifact.name, target) for artifact in await self.artifacts(job)]

    async def artifacts(self, job: str | Job) -> list[Artifact]:
        """What a job left: pictures, metrics."""
        request = Request("GET", f"{job_path(job)}/artifacts")
        return (await self._caller.page(Artifact, request)).items

    async def picture(self, job: str | Job, name: str = "image.exr", *, layer: str | None = None) -> Array:
        """A picture as a numpy array, height x width x channels: an EXR's colour or another layer, or a PNG's bytes.

        Needs the extra `pictures`.
        """
        return await self._read_picture(job, name, lambda path: _pictures.read(path, layer))

    async def layers(self, job: str | Job, name: str = "image.exr") -> dict[str, Array]:
        """Every layer of an EXR as a numpy array, by its name; the colour is `color`. Needs the extra `pictures`."""
        return await self._read_picture(job, name, _pictures.read_layers)

    async def _read_picture(self, job: str | Job, name: str, read: Callable[[Path], T]) -> T:
        folder = await self._io.blocking(lambda: tempfile.TemporaryDirectory(prefix="lightshaft-"))
        try:
            path = await self.download(job, name, folder.name)
            return await self._io.blocking(lambda: read(path))
        finally:
            folder.cleanup()


def _path(job: str | Job, name: str) -> str:
    return f"{job_path(job)}/artifacts/{segment(name)}"
