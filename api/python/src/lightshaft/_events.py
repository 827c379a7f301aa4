"""Server-sent events (WHATWG HTML, section 9.2): as much of the format as the service writes."""

from __future__ import annotations

import json
from collections.abc import AsyncGenerator

from ._calls import Caller
from ._codec import decode
from ._io import Request
from .errors import UnexpectedAnswerError
from .models import Event

#: The service sends something every 15 s.
PATIENCE_S = 60.0

#: Events after which nothing happens to a job, unless it is retried.
ENDS = frozenset({"job.succeeded", "job.failed", "job.cancelled"})


class Parser:
    """Bytes in, the `data` of whole events out. Lines may be cut anywhere."""

    def __init__(self) -> None:
        self._rest = b""
        self._data: list[str] = []

    def push(self, piece: bytes) -> list[str]:
        """The events that this piece completes."""
        whole: list[str] = []
        *lines, self._rest = (self._rest + piece).split(b"\n")
        for line in lines:
            text = line.decode(errors="replace").rstrip("\r")
            if text.startswith("data:"):
                self._data.append(text[5:].removeprefix(" "))
            elif not text and self._data:
                whole.append("\n".join(self._data))
                self._data = []
        return whole


async def stream(
    caller: Caller, path: str, last_event_id: int | None, patience_s: float = PATIENCE_S
) -> AsyncGenerator[Event | None, None]:
    """The events of one connection, which ends with a job, with the service, or by accident.

    None is a sign of life between events.
    """
    headers = {"Accept": "text/event-stream", "Cache-Control": "no-store"}
    if last_event_id is not None:
        headers["Last-Event-ID"] = str(last_event_id)
    request = Request("GET", path, headers=headers, patience_s=patience_s)
    async with caller.open(request) as answer:
        if not answer.headers.get("content-type", "").startswith("text/event-stream"):
            raise UnexpectedAnswerError(answer.url, answer.status, "not a stream of events")
        parser = Parser()
        async for piece in answer.pieces():
            events = parser.push(piece)
            if not events:
                yield None
            for data in events:
                try:
                    yield decode(Event, json.loads(data))
                except ValueError as error:
                    raise UnexpectedAnswerError(answer.url, answer.status, str(error)) from error
