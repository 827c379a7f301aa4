"""What holds of the package itself."""

from __future__ import annotations

import dataclasses
import importlib.metadata
import inspect
import json
import typing

import pytest

import generate
import lightshaft
from lightshaft import AsyncClient, Client, RenderSettings, models
from lightshaft._codec import MismatchError, decode, encode
from lightshaft._events import Parser

from .service import REPOSITORY


def test_the_types_are_those_of_the_document() -> None:
    assert generate.TARGET.read_text() == generate.generated(), "run api/python/generate.py"


def test_both_clients_have_the_same_calls() -> None:
    def calls(client: type) -> dict[str, inspect.Signature]:
        methods = inspect.getmembers(client, inspect.isfunction)
        return {name: inspect.signature(method) for name, method in methods if not name.startswith("_")}

    blocking, waiting = calls(Client), calls(AsyncClient)
    assert blocking.keys() == waiting.keys()
    for name, signature in blocking.items():
        other = waiting[name]
        assert signature.parameters == other.parameters, name
        returned = str(other.return_annotation).replace("AsyncGenerator[", "Iterator[").replace(", None]", "]")
        assert signature.return_annotation == returned, name
        if name != "close":
            assert getattr(Client, name).__doc__, name


def test_every_setting_has_its_field() -> None:
    schemas = json.loads((REPOSITORY / "api" / "openapi.json").read_text())["components"]["schemas"]
    fields = {field.name for field in dataclasses.fields(RenderSettings)}
    assert fields == set(schemas["RenderSettings"]["properties"])
    assert set(typing.get_args(models.Integrator)) == set(schemas["Integrator"]["enum"])


def test_what_is_left_out_is_left_to_the_service() -> None:
    settings = RenderSettings(width=3, lights=[models.Light(kind="point", position=[0, 1, 2])])
    assert encode(settings) == {"width": 3, "lights": [{"kind": "point", "position": [0, 1, 2]}]}


def test_answers_are_read_strictly_and_what_is_new_is_passed_over() -> None:
    assert decode(models.StoredBlob, {"hash": "h", "bytes": 3, "new": 1}).bytes == 3
    with pytest.raises(MismatchError, match="no field `hash`"):
        decode(models.StoredBlob, {"bytes": 3})
    with pytest.raises(MismatchError, match="/bytes: expected int, found str"):
        decode(models.StoredBlob, {"hash": "h", "bytes": "3"})
    with pytest.raises(MismatchError, match="/bytes: expected int, found bool"):
        decode(models.StoredBlob, {"hash": "h", "bytes": True})
    event = {"at": "2026-11-23T01:02:03.123456789Z", "job": "j", "kind": "job.of_tomorrow", "data": None}
    assert decode(models.Event, event).at.microsecond == 123456
    with pytest.raises(MismatchError, match="/at: "):
        decode(models.Event, {**event, "at": "yesterday"})


@pytest.mark.parametrize("step", range(1, 40))
def test_events_may_be_cut_anywhere(step: int) -> None:
    text = ': keep-alive\n\nid: 7\nevent: job.created\ndata: {"ä":1}\n\ndata: x\r\ndata: y\r\n\r\n'.encode()
    parser = Parser()
    pieces = [text[start : start + step] for start in range(0, len(text), step)]
    assert [data for piece in pieces for data in parser.push(piece)] == ['{"ä":1}', "x\ny"]


def test_what_the_package_names_is_there() -> None:
    assert all(hasattr(lightshaft, name) for name in lightshaft.__all__)
    assert importlib.metadata.version("lightshaft")
