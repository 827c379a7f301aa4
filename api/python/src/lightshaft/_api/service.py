"""The service itself: its workers, the meshes that it knows, the blobs that it keeps."""

from __future__ import annotations

import os
from collections.abc import AsyncGenerator
from pathlib import Path

from .. import _upload
from .._calls import query, segment
from .._io import Request
from .._page import Page, every
from .._upload import OnSent
from ..models import Mesh, Status, StoredBlob, Worker
from .base import Base


class Service(Base):
    """What is not one job's or one scene's."""

    async def store_blob(self, path: str | os.PathLike[str], *, on_sent: OnSent | None = None) -> StoredBlob:
        """Stores a file, such as an environment map, and answers its hash."""
        source = Path(path)
        upload = await self._io.blocking(lambda: _upload.of_file(source))
        headers = {"Content-Type": upload.media_type, "Content-Length": str(upload.length)}
        pieces = upload.watched(on_sent)
        return await self._caller.json(StoredBlob, Request("POST", "v1/blobs", headers=headers, pieces=pieces))

    async def mesh(self, mesh: str) -> Mesh:
        """A mesh and the structures that exist for it."""
        return await self._caller.json(Mesh, Request("GET", f"v1/meshes/{segment(mesh)}"))

    async def meshes(self, *, limit: int | None = None, cursor: str | None = None) -> Page[Mesh]:
        """One page of the meshes, in order of their hash."""
        request = Request("GET", "v1/meshes", query(limit=limit, cursor=cursor))
        return await self._caller.page(Mesh, request)

    def iterate_meshes(self) -> AsyncGenerator[Mesh, None]:
        """All meshes."""
        return every(lambda cursor: self.meshes(cursor=cursor))

    async def workers(self) -> list[Worker]:
        """All workers by name."""
        return (await self._caller.page(Worker, Request("GET", "v1/workers"))).items

    async def worker(self, worker: str) -> Worker:
        """A worker: devices, work in hand, cache."""
        return await self._caller.json(Worker, Request("GET", f"v1/workers/{segment(worker)}"))

    async def drain_worker(self, worker: str) -> Worker:
        """Lets a worker finish what it has, and gives it nothing more."""
        return await self._caller.json(Worker, Request("POST", f"v1/workers/{segment(worker)}/drain"))

    async def undrain_worker(self, worker: str) -> Worker:
        """Gives a drained worker tasks again."""
        return await self._caller.json(Worker, Request("POST", f"v1/workers/{segment(worker)}/undrain"))

    async def status(self) -> Status:
        """The state of the whole service, in numbers."""
        return await self._caller.json(Status, Request("GET", "v1/status"))
