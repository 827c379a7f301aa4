"""What a path on this machine is as the body of an upload, in pieces, so that no file is read into memory."""

from __future__ import annotations

import json
import mimetypes
import secrets
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import unquote

from ._io import Pieces

#: Called with the bytes that are sent, and all that there are.
OnSent = Callable[[int, int], None]

_PIECE_BYTES = 256 << 10


@dataclass(frozen=True)
class Upload:
    """A body whose length is known before it is read."""

    media_type: str
    length: int
    pieces: Pieces

    def watched(self, on_sent: OnSent | None) -> Pieces:
        """The same body; `on_sent` hears of every piece that was taken."""
        if on_sent is None:
            return self.pieces

        def watched() -> Iterator[bytes]:
            sent = 0
            for piece in self.pieces():
                yield piece
                sent += len(piece)
                on_sent(sent, self.length)

        return watched


def of_file(path: Path) -> Upload:
    """One file as it is."""
    return Upload("application/octet-stream", path.stat().st_size, lambda: _read(path))


def of_scene(path: Path) -> Upload:
    """A `.glb` or `.zip` as it is, a `.gltf` with the files that it names."""
    ending = path.suffix.lower()
    if ending == ".gltf":
        return _multipart(_gltf_files(path))
    media_type = "application/zip" if ending == ".zip" else "model/gltf-binary"
    return Upload(media_type, path.stat().st_size, lambda: _read(path))


def _read(path: Path) -> Iterator[bytes]:
    with path.open("rb") as file:
        while piece := file.read(_PIECE_BYTES):
            yield piece


def _multipart(files: dict[str, Path]) -> Upload:
    """A form (RFC 7578) with a part for each file, named by its path in the glTF."""
    boundary = secrets.token_hex(16)
    heads = {name: _part_head(boundary, name) for name in files}
    tail = f"--{boundary}--\r\n".encode()
    length = sum(len(heads[name]) + path.stat().st_size + 2 for name, path in files.items()) + len(tail)

    def pieces() -> Iterator[bytes]:
        for name, path in files.items():
            yield heads[name]
            yield from _read(path)
            yield b"\r\n"
        yield tail

    return Upload(f"multipart/form-data; boundary={boundary}", length, pieces)


def _part_head(boundary: str, name: str) -> bytes:
    # Escaped as browsers do (WHATWG HTML, section 4.10.21.8).
    escaped = name.replace('"', "%22").replace("\r", "%0D").replace("\n", "%0A")
    media_type = mimetypes.guess_type(name)[0] or "application/octet-stream"
    disposition = f'Content-Disposition: form-data; name="file"; filename="{escaped}"'
    return f"--{boundary}\r\n{disposition}\r\nContent-Type: {media_type}\r\n\r\n".encode()


def _gltf_files(path: Path) -> dict[str, Path]:
    """The .gltf itself and every file below its folder that it names, by the names that it gives them."""
    try:
        document = json.loads(path.read_bytes())
    except ValueError as error:
        raise ValueError(f"{path}: not a glTF document: {error}") from error
    files = {path.name: path}
    for name in _named_files(document):
        on_disk = path.parent / name
        # One that is missing is the service's to report, in the same words as for every other upload.
        if on_disk.is_file():
            files.setdefault(name, on_disk)
    return files


def _named_files(document: Any) -> Iterator[str]:
    for key in ("buffers", "images"):
        for entry in document.get(key, []) if isinstance(document, dict) else []:
            uri = entry.get("uri") if isinstance(entry, dict) else None
            if not isinstance(uri, str) or uri[:5].lower() == "data:":
                continue
            name = unquote(uri).replace("\\", "/").removeprefix("./")
            # A path that leaves the folder is refused by the service; nothing outside is read for it.
            if not name.startswith("/") and ".." not in PurePosixPath(name).parts:
                yield name
