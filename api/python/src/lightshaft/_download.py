"""Files, whole or not at all: written beside their place and moved there; a cut connection is taken up again."""

from __future__ import annotations

import os
import re
import uuid
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

from . import errors
from ._calls import Caller, is_transient, pause_s
from ._io import Answer, Request

#: Called with the bytes that have come, and all that there are, where the service says that.
OnReceived = Callable[[int, int | None], None]


async def to_path(caller: Caller, href: str, path: Path, retries: int, on_received: OnReceived | None) -> Path:
    """Streams what is at `href` into a file that appears at `path` when it is whole."""
    part = path.with_name(f".{path.name}.{uuid.uuid4().hex[:12]}.part")
    try:
        file = await caller.io.blocking(lambda: part.open("xb"))
        try:
            await _Download(caller, href, file, on_received).run(retries)
            await caller.io.blocking(lambda: _flush(file))
        finally:
            file.close()
        await caller.io.blocking(lambda: part.replace(path))
    finally:
        part.unlink(missing_ok=True)
    return path


def _flush(file: BinaryIO) -> None:
    file.flush()
    os.fsync(file.fileno())


class _Download:
    def __init__(self, caller: Caller, href: str, file: BinaryIO, on_received: OnReceived | None) -> None:
        self._caller = caller
        self._href = href
        self._file = file
        self._on_received = on_received
        self._received = 0
        self._etag: str | None = None

    async def run(self, retries: int) -> None:
        """Until the file is whole. Tries count from the last byte that came."""
        failures = 0
        while True:
            before = self._received
            try:
                await self._go_on()
                return
            except errors.LightshaftError as error:
                failures = 1 if self._received > before else failures + 1
                if failures > retries or not is_transient(error):
                    raise
                await self._caller.io.sleep(pause_s(failures, error))

    async def _go_on(self) -> None:
        headers = {"Accept-Encoding": "identity"}
        if self._received and self._etag:
            # If it has changed meanwhile, the answer is the whole of the new one (RFC 9110, section 13.1.5).
            headers |= {"Range": f"bytes={self._received}-", "If-Range": self._etag}
        async with self._caller.open(Request("GET", self._href, headers=headers)) as answer:
            total = self._begin(answer)
            async for piece in answer.pieces():
                # Pieces are small: a thread for each would cost more than the write.
                self._file.write(piece)
                self._received += len(piece)
                if self._on_received:
                    self._on_received(self._received, total)
            if total is not None and self._received != total:
                detail = f"{self._received} of {total} bytes came"
                raise errors.UnreachableError(answer.url, detail)

    def _begin(self, answer: Answer) -> int | None:
        """Puts the file where the answer begins; how long the whole is."""
        if answer.status == 206:
            place = re.fullmatch(r"bytes (\d+)-\d+/(\d+)", answer.headers.get("content-range", ""))
            if place is None or int(place[1]) != self._received:
                raise errors.UnexpectedAnswerError(answer.url, 206, "another range than was asked for")
            return int(place[2])
        self._received = 0
        self._file.seek(0)
        self._file.truncate()
        self._etag = answer.headers.get("etag")
        length = answer.headers.get("content-length", "")
        return int(length) if length.isdecimal() else None
