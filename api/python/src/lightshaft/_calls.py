"""How requests are sent: repeated where that is safe, and answers outside 2xx turned into exceptions."""

from __future__ import annotations

import contextlib
import json
import random
from collections.abc import AsyncIterator, Callable, Mapping
from typing import Any, TypeVar
from urllib.parse import quote

import httpx

from . import errors
from ._codec import decode
from ._io import Answer, Io, Request
from ._page import Page

T = TypeVar("T")

#: Longest that a `Retry-After` is obeyed.
_LONGEST_PAUSE_S = 60.0


def segment(text: str) -> str:
    """One segment of a path: ids and names come from users and files."""
    return "%2E" * len(text) if text.strip(".") == "" else quote(text, safe="")


def is_transient(error: errors.LightshaftError) -> bool:
    """Whether the same request may well succeed a little later."""
    if isinstance(error, (errors.ProblemError, errors.UnexpectedAnswerError)):
        return error.status in (408, 429) or error.status >= 500
    return isinstance(error, errors.UnreachableError)


def pause_s(failures: int, error: errors.LightshaftError) -> float:
    """Until the next try, after so many: doubling to five seconds, at random so that clients do not march in step."""
    asked = error.retry_after_s if isinstance(error, errors.ProblemError) else None
    doubled: float = min(5.0, 0.2 * 2.0 ** (failures - 1))
    return min(_LONGEST_PAUSE_S, max(asked or 0.0, doubled * random.uniform(0.8, 1.2)))  # noqa: S311


class Caller:
    """Sends requests through one `Io`."""

    def __init__(self, io: Io, url: str, retries: int) -> None:
        self.io = io
        self.url = url
        self._retries = retries

    async def json(self, kind: type[T], request: Request) -> T:
        """The answer, read as `kind`."""
        return await self._read(request, lambda document: decode(kind, document))

    async def page(self, kind: type[T], request: Request) -> Page[T]:
        """A list of `kind`, or a part of one."""

        def page(document: Any) -> Page[T]:
            envelope = decode(dict[str, Any], document)
            items = decode(list[Any], envelope.get("items"), "/items")
            cursor = envelope.get("next_cursor")
            return Page([decode(kind, item, f"/items/{index}") for index, item in enumerate(items)], cursor)

        return await self._read(request, page)

    async def _read(self, request: Request, read: Callable[[Any], T]) -> T:
        body, url, status = await self._body(request)
        try:
            return read(json.loads(body))
        except ValueError as error:
            raise errors.UnexpectedAnswerError(url, status, str(error)) from error

    async def content(self, request: Request) -> bytes:
        """The whole body of the answer."""
        body, _, _ = await self._body(request)
        return body

    async def _body(self, request: Request) -> tuple[bytes, str, int]:
        failures = 0
        while True:
            try:
                async with self.open(request) as answer:
                    return await answer.read(), answer.url, answer.status
            except errors.NotFoundError:
                # The answer to the first try was lost, and what it deleted is gone.
                if request.method == "DELETE" and failures > 0:
                    return b"", self.url, 204
                raise
            except errors.LightshaftError as error:
                failures += 1
                if failures > self._retries or not _may_repeat(request, error):
                    raise
                await self.io.sleep(pause_s(failures, error))

    @contextlib.asynccontextmanager
    async def open(self, request: Request) -> AsyncIterator[Answer]:
        """One try. Errors of the connection while the body is read are turned into ours too."""
        url = f"{self.url}/{request.path}"
        try:
            async with self.io.open(request) as answer:
                if not 200 <= answer.status < 300:
                    raise _refusal(answer, await answer.read())
                yield answer
        except httpx.RequestError as error:
            raise errors.UnreachableError(url, _reason(error)) from error


def _may_repeat(request: Request, error: errors.LightshaftError) -> bool:
    if not is_transient(error):
        return False
    # What never reached the service has done nothing.
    never_sent = isinstance(error, errors.UnreachableError) and isinstance(
        error.__cause__, (httpx.ConnectError, httpx.ConnectTimeout)
    )
    return request.is_repeatable or never_sent


def _reason(error: httpx.RequestError) -> str:
    return str(error) or type(error).__name__


def _refusal(answer: Answer, body: bytes) -> errors.LightshaftError:
    if answer.headers.get("content-type", "").startswith("application/problem+json"):
        with contextlib.suppress(ValueError):
            document = json.loads(body)
            if isinstance(document, dict) and document.get("status") == answer.status:
                return errors.problem(document, _retry_after_s(answer.headers))
    start = body[:200].decode(errors="replace")
    return errors.UnexpectedAnswerError(answer.url, answer.status, start)


def _retry_after_s(headers: Mapping[str, str]) -> float | None:
    """In seconds (RFC 9110, section 10.2.3); its other form, a date, would need the clocks to agree."""
    text = headers.get("retry-after", "").strip()
    return float(text) if text.isdecimal() else None


def query(**parameters: Any) -> tuple[tuple[str, str], ...]:
    """Those that are given, as the API writes them."""
    return tuple(
        (name, str(value).lower() if isinstance(value, bool) else str(value))
        for name, value in parameters.items()
        if value is not None
    )
