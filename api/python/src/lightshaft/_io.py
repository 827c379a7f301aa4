"""
Everything that waits: requests, files, the clock. Twice, once for each kind of client.

What the client does is written once, as coroutines over the protocol `Io`. `AsyncIo` really waits; the coroutines of
`SyncIo` block instead of waiting, so that whatever is built of them runs to its end at its first step (`run`).
"""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol, Self, TypeVar

import anyio
import anyio.to_thread
import httpx

T = TypeVar("T")

DEFAULT_URL = "http://127.0.0.1:8080"

#: A body of any size: its pieces, from the beginning each time that it is called.
Pieces = Callable[[], Iterator[bytes]]


@dataclass(frozen=True)
class Request:
    """One request, without the address of the service."""

    method: str
    path: str
    query: tuple[tuple[str, str], ...] = ()
    headers: Mapping[str, str] = field(default_factory=dict)
    json: Any = None
    pieces: Pieces | None = None
    #: Whether it may be sent again without doing anything twice.
    is_repeatable: bool = True
    #: Longest pause within the answer, and until it begins; the client's own when None.
    patience_s: float | None = None


class Answer(Protocol):
    """An answer whose head has come, and whose body comes in pieces."""

    @property
    def status(self) -> int: ...
    @property
    def headers(self) -> Mapping[str, str]: ...
    @property
    def url(self) -> str: ...
    def pieces(self) -> AsyncIterator[bytes]: ...
    async def read(self) -> bytes: ...


class Io(Protocol):
    """What the client needs of the world."""

    def open(self, request: Request) -> contextlib.AbstractAsyncContextManager[Answer]: ...
    async def sleep(self, seconds: float) -> None: ...
    async def blocking(self, function: Callable[[], T]) -> T: ...
    async def close(self) -> None: ...


@dataclass(frozen=True)
class Connection:
    """How a service is reached."""

    #: Its address; a path in it is kept as a prefix.
    url: str
    #: Longest pause within an answer, and until it begins.
    timeout_s: float
    headers: Mapping[str, str]

    @classmethod
    def to(cls, url: str | None, timeout_s: float, headers: Mapping[str, str] | None) -> Self:
        """From what a caller says of it, which may be nothing."""
        url = (url or os.environ.get("LIGHTSHAFT_SERVER") or DEFAULT_URL).rstrip("/")
        try:
            parsed = httpx.URL(url)
        except httpx.InvalidURL as error:
            raise ValueError(f"{url!r} is no address of a service: {error}") from error
        if parsed.scheme not in ("http", "https") or not parsed.host:
            raise ValueError(f"{url!r} is no address of a service: expected something like {DEFAULT_URL}")
        return cls(url, timeout_s, {"User-Agent": "lightshaft-python", **(headers or {})})

    def options(self) -> dict[str, Any]:
        """What both clients of httpx are made with."""
        # Environment variables of proxies are obeyed, as by curl.
        return {
            "base_url": self.url,
            "headers": dict(self.headers),
            "timeout": httpx.Timeout(self.timeout_s, connect=min(10.0, self.timeout_s)),
            "limits": httpx.Limits(max_connections=32, keepalive_expiry=30.0),
        }

    def timeout(self, request: Request) -> httpx.Timeout:
        """The client's, or what this request needs."""
        patience_s = request.patience_s if request.patience_s is not None else self.timeout_s
        return httpx.Timeout(self.timeout_s, connect=min(10.0, self.timeout_s), read=patience_s)


def _described(request: Request) -> dict[str, Any]:
    described: dict[str, Any] = {"params": list(request.query), "headers": dict(request.headers)}
    if request.json is not None:
        described["json"] = request.json
    return described


class _SyncAnswer:
    def __init__(self, response: httpx.Response) -> None:
        self._response = response
        self.status = response.status_code
        self.headers: Mapping[str, str] = response.headers
        self.url = str(response.url)

    async def pieces(self) -> AsyncIterator[bytes]:
        for piece in self._response.iter_bytes():
            yield piece

    async def read(self) -> bytes:
        return self._response.read()


class SyncIo:
    """Blocks."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._http = httpx.Client(**connection.options())

    @contextlib.asynccontextmanager
    async def open(self, request: Request) -> AsyncIterator[Answer]:
        content = request.pieces() if request.pieces else None
        timeout = self._connection.timeout(request)
        described = _described(request)
        with self._http.stream(request.method, request.path, content=content, timeout=timeout, **described) as response:
            yield _SyncAnswer(response)

    async def sleep(self, seconds: float) -> None:
        time.sleep(seconds)  # noqa: ASYNC251

    async def blocking(self, function: Callable[[], T]) -> T:
        return function()

    async def close(self) -> None:
        self._http.close()


class _AsyncAnswer:
    def __init__(self, response: httpx.Response) -> None:
        self._response = response
        self.status = response.status_code
        self.headers: Mapping[str, str] = response.headers
        self.url = str(response.url)

    def pieces(self) -> AsyncIterator[bytes]:
        return self._response.aiter_bytes()

    async def read(self) -> bytes:
        return await self._response.aread()


class AsyncIo:
    """Waits; files are read and written in threads."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._http = httpx.AsyncClient(**connection.options())

    @contextlib.asynccontextmanager
    async def open(self, request: Request) -> AsyncIterator[Answer]:
        content = self._in_threads(request.pieces()) if request.pieces else None
        timeout = self._connection.timeout(request)
        described = _described(request)
        async with self._http.stream(
            request.method, request.path, content=content, timeout=timeout, **described
        ) as response:
            yield _AsyncAnswer(response)

    async def _in_threads(self, pieces: Iterator[bytes]) -> AsyncIterator[bytes]:
        while (piece := await self.blocking(lambda: next(pieces, None))) is not None:
            yield piece

    async def sleep(self, seconds: float) -> None:
        await anyio.sleep(seconds)

    async def blocking(self, function: Callable[[], T]) -> T:
        return await anyio.to_thread.run_sync(function)

    async def close(self) -> None:
        await self._http.aclose()


def run(steps: Coroutine[Any, Any, T]) -> T:
    """The result of a coroutine over `SyncIo`, which never waits."""
    try:
        steps.send(None)
    except StopIteration as end:
        return end.value  # type: ignore[no-any-return]
    steps.close()
    raise RuntimeError("a coroutine of the blocking client has waited")


def iterate(items: AsyncIterator[T]) -> Iterator[T]:
    """The items of an asynchronous generator over `SyncIo`."""

    async def following() -> tuple[T, ...]:
        try:
            return (await anext(items),)
        except StopAsyncIteration:
            return ()

    async def close() -> None:
        if hasattr(items, "aclose"):
            await items.aclose()

    try:
        while item := run(following()):
            yield item[0]
    finally:
        run(close())
