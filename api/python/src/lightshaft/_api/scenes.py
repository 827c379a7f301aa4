"""Scenes."""

from __future__ import annotations

import os
from collections.abc import AsyncGenerator
from pathlib import Path
from typing import Any

from .. import _upload
from .._calls import query, segment
from .._io import Request
from .._page import Page, every
from .._upload import OnSent
from ..models import Scene, SceneSummary
from .base import Base

#: A service may have other scenes to import before an uploaded one.
_IMPORT_PATIENCE_S = 600.0


class Scenes(Base):
    """Uploads, and what is known of scenes."""

    async def upload_scene(
        self, path: str | os.PathLike[str], *, name: str | None = None, on_sent: OnSent | None = None
    ) -> Scene:
        """Uploads a `.glb`, a `.zip`, or a `.gltf` with the files that it names. The same bytes give the same scene.

        `on_sent` hears of the bytes that are sent, and of all that there are.
        """
        path = Path(path)
        return await self._caller.json(Scene, await self._upload(path, on_sent, name=name or path.stem))

    async def validate_scene(self, path: str | os.PathLike[str]) -> SceneSummary:
        """Has a scene checked; nothing is kept. What is wrong with it is in the exception's `errors`."""
        return await self._caller.json(SceneSummary, await self._upload(Path(path), None, validate_only=True))

    async def _upload(self, path: Path, on_sent: OnSent | None, **parameters: Any) -> Request:
        upload = await self._io.blocking(lambda: _upload.of_scene(path))
        headers = {"Content-Type": upload.media_type, "Content-Length": str(upload.length)}
        pieces = upload.watched(on_sent)
        return Request(
            "POST",
            "v1/scenes",
            query(**parameters),
            headers,
            pieces=pieces,
            patience_s=_IMPORT_PATIENCE_S,
        )

    async def scene(self, scene: str) -> Scene:
        """A scene: meshes, instances, materials, cameras, lights, warnings."""
        return await self._caller.json(Scene, Request("GET", f"v1/scenes/{segment(scene)}"))

    async def scenes(self, *, limit: int | None = None, cursor: str | None = None) -> Page[Scene]:
        """One page of the scenes, newest first."""
        request = Request("GET", "v1/scenes", query(limit=limit, cursor=cursor))
        return await self._caller.page(Scene, request)

    def iterate_scenes(self) -> AsyncGenerator[Scene, None]:
        """All scenes, newest first."""
        return every(lambda cursor: self.scenes(cursor=cursor))

    async def delete_scene(self, scene: str) -> None:
        """Deletes a scene; refused while unfinished jobs use it."""
        await self._caller.content(Request("DELETE", f"v1/scenes/{segment(scene)}"))

    async def thumbnail(self, scene: str) -> bytes:
        """A small picture of a scene as PNG, once its automatic job has rendered it."""
        return await self._caller.content(Request("GET", f"v1/scenes/{segment(scene)}/thumbnail.png"))
