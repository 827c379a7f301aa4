"""Calls that wait as calls that block: each is described once, and typed for both clients."""

from __future__ import annotations

import inspect
from collections.abc import AsyncGenerator, Callable, Coroutine, Iterator
from functools import wraps
from typing import Any, Concatenate, ParamSpec, TypeVar

from ._io import iterate, run

P = ParamSpec("P")
T = TypeVar("T")


def blocking(call: Callable[Concatenate[Any, P], Coroutine[Any, Any, T]]) -> Callable[Concatenate[Any, P], T]:
    """Make a method that runs a coroutine of `self._calls` to its end."""

    @wraps(call)
    def method(self: Any, /, *args: P.args, **options: P.kwargs) -> T:
        return run(call(self._calls, *args, **options))

    return method


def iterating(
    call: Callable[Concatenate[Any, P], AsyncGenerator[T, None]],
) -> Callable[Concatenate[Any, P], Iterator[T]]:
    """Make a method that gives what an asynchronous generator of `self._calls` gives."""

    @wraps(call)
    def method(self: Any, /, *args: P.args, **options: P.kwargs) -> Iterator[T]:
        return iterate(call(self._calls, *args, **options))

    # For people who read help(): annotations are text.
    signature = inspect.signature(call)
    item = signature.return_annotation.removeprefix("AsyncGenerator[").removesuffix(", None]")
    method.__signature__ = signature.replace(return_annotation=f"Iterator[{item}]")  # type: ignore[attr-defined]
    return method
