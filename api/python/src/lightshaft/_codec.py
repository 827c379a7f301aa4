"""Between JSON and the dataclasses of `models`."""

from __future__ import annotations

import dataclasses
import functools
import types
import typing
from collections.abc import Mapping
from datetime import datetime
from typing import Any, TypeVar, Union, cast

T = TypeVar("T")


class MismatchError(ValueError):
    """An answer lacks a field, or has something else in its place."""


def decode(kind: type[T], value: Any, where: str = "") -> T:
    """Reads JSON as `kind`. Fields that the class does not know are passed over: a newer service may send them."""
    return cast(T, _decode(kind, value, where))


def _decode(kind: Any, value: Any, where: str) -> Any:
    if kind is Any:
        return value
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if origin in (Union, types.UnionType):
        if value is None and type(None) in arguments:
            return None
        candidates = [argument for argument in arguments if argument is not type(None)]
        # Of several forms none is ours to choose.
        return _decode(candidates[0], value, where) if len(candidates) == 1 else value
    if origin is typing.Literal:
        # A newer service may know more of them.
        return _expect(str, value, where)
    if origin is list:
        items = _expect(list, value, where)
        return [_decode(arguments[0], item, f"{where}/{index}") for index, item in enumerate(items)]
    if origin is dict:
        items = _expect(dict, value, where)
        return {key: _decode(arguments[1], item, f"{where}/{key}") for key, item in items.items()}
    if dataclasses.is_dataclass(kind):
        return _decode_class(cast(type, kind), _expect(dict, value, where), where)
    if kind is datetime:
        try:
            return datetime.fromisoformat(_expect(str, value, where))
        except ValueError as error:
            raise MismatchError(f"{where}: {error}") from error
    if kind is float:
        return float(_expect((int, float), value, where))
    return _expect(kind, value, where)


def _decode_class(kind: type, value: Mapping[str, Any], where: str) -> Any:
    fields: dict[str, Any] = {}
    for name, (field_kind, is_required) in _fields(kind).items():
        if name in value:
            fields[name] = _decode(field_kind, value[name], f"{where}/{name}")
        elif is_required:
            raise MismatchError(f"{where or '/'}: no field `{name}`")
    return kind(**fields)


@functools.cache
def _fields(kind: type) -> dict[str, tuple[Any, bool]]:
    hints = typing.get_type_hints(kind)
    fields = dataclasses.fields(kind)
    return {field.name: (hints[field.name], field.default is dataclasses.MISSING) for field in fields}


def _expect(kind: type | tuple[type, ...], value: Any, where: str) -> Any:
    # True is an int to Python, and no number in JSON.
    if isinstance(value, kind) and not (isinstance(value, bool) and kind is not bool):
        return value
    names = " or ".join(one.__name__ for one in (kind if isinstance(kind, tuple) else (kind,)))
    raise MismatchError(f"{where or '/'}: expected {names}, found {type(value).__name__}")


def encode(value: Any) -> Any:
    """What JSON can say of it. A field of a dataclass that is None was left to the service."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
        return {name: encode(inner) for name, inner in fields.items() if inner is not None}
    if isinstance(value, Mapping):
        return {key: encode(inner) for key, inner in value.items()}
    if isinstance(value, (list, tuple)):
        return [encode(inner) for inner in value]
    return value
