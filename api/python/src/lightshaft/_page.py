"""Lists come in pages."""

from __future__ import annotations

from collections.abc import AsyncGenerator, Awaitable, Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

T = TypeVar("T")


@dataclass(frozen=True)
class Page(Generic[T]):
    """A part of a list."""

    items: list[T]
    #: Gets the next page; None on the last one.
    next_cursor: str | None = None


async def every(page: Callable[[str | None], Awaitable[Page[T]]]) -> AsyncGenerator[T, None]:
    """The items of all pages, each page asked for when it is needed."""
    cursor = None
    while True:
        one = await page(cursor)
        for item in one.items:
            yield item
        cursor = one.next_cursor
        if cursor is None:
            return
