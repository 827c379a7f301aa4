"""
Writes src/lightshaft/models.py from api/openapi.json: the types of what the service takes and answers.

Run it after the document has changed. A test compares its result with the file, so that the two cannot drift apart.

What the service answers becomes frozen dataclasses whose fields are all there. What it takes becomes dataclasses whose
optional fields are None for "not said": the service has the defaults, and they are repeated nowhere.
"""

from __future__ import annotations

import json
import keyword
import re
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
DOCUMENT = HERE.parent / "openapi.json"
TARGET = HERE / "src" / "lightshaft" / "models.py"

#: What the client sends as a whole; with everything that these name.
INPUTS = ["BenchmarkSettings", "BuildSettings", "CompareRequest", "RenderSettings"]
#: What the client reads; with everything that these name.
OUTPUTS = [
    "Baseline",
    "Calibration",
    "Compared",
    "Decision",
    "Event",
    "FieldError",
    "History",
    "Job",
    "JobSummary",
    "Mesh",
    "Run",
    "RunSummary",
    "Scene",
    "Schedule",
    "Status",
    "StoredBlob",
    "Suite",
    "SuiteSummary",
    "ValidatedJob",
    "Webhook",
    "WebhookDelivery",
    "Worker",
]

Schema = dict[str, Any]

HEAD = '''"""What the service takes and answers. Written by generate.py from api/openapi.json: do not edit."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Any, Literal, TypeAlias
'''


def main() -> None:
    TARGET.write_text(generated(), encoding="utf-8")
    print(TARGET)


def generated() -> str:
    """The whole module as text."""
    schemas = SCHEMAS
    inputs, outputs = reachable(schemas, INPUTS), reachable(schemas, OUTPUTS)
    names = sorted(inputs | outputs, key=lambda name: order(schemas, name))
    return "\n".join([HEAD, *(definition(name, schemas[name], name in inputs, inputs) for name in names)])


def order(schemas: dict[str, Schema], name: str) -> tuple[int, str]:
    """Aliases before classes, bases before what inherits from them."""
    schema = schemas[name]
    return (0 if is_alias(schema) else 2 if "allOf" in schema else 1, name)


def reachable(schemas: dict[str, Schema], roots: list[str]) -> set[str]:
    found: set[str] = set()
    waiting = list(roots)
    while waiting:
        name = waiting.pop()
        if name not in found:
            found.add(name)
            if name != "JobSettings":
                waiting.extend(references(schemas[name]))
    return found - {"JobSettings"}


def references(value: Any) -> Iterator[str]:
    if isinstance(value, dict):
        if "$ref" in value:
            yield value["$ref"].rsplit("/", 1)[-1]
        for inner in value.values():
            yield from references(inner)
    elif isinstance(value, list):
        for inner in value:
            yield from references(inner)


def is_alias(schema: Schema) -> bool:
    return "enum" in schema or "oneOf" in schema or not ("allOf" in schema or "properties" in schema)


def definition(name: str, schema: Schema, is_input: bool, inputs: set[str]) -> str:
    if is_alias(schema):
        return comment(schema, "") + alias(name, schema, inputs if is_input else set())
    base, fields, required = "", schema, schema.get("required", [])
    if "allOf" in schema:
        [parent, fields] = schema["allOf"]
        base, required = f"({next(references(parent))})", fields.get("required", [])
    frozen = "kw_only=True" if is_input else "frozen=True, kw_only=True"
    lines = ["", f"@dataclass({frozen})", f"class {name}{base}:"]
    if "description" in schema:
        lines.append(docstring(schema["description"]))
    for field, inner in fields["properties"].items():
        if keyword.iskeyword(field):
            sys.exit(f"{name}.{field} is a keyword of Python")
        kind = annotation(inner, inputs if is_input else set())
        is_null = kind.endswith("| None")
        if is_input and field not in required:
            kind = kind if is_null else f"{kind} | None"
            is_null = True
        default = " = None" if is_null and (is_input or field not in required) else ""
        lines.append(comment(inner, "    ") + f"    {field}: {kind}{default}")
    return "\n".join(lines) + "\n"


def alias(name: str, schema: Schema, inputs: set[str]) -> str:
    kind = annotation({key: value for key, value in schema.items() if key != "description"}, inputs)
    if "enum" not in schema:
        if not inputs:
            # Told apart by its form alone: read as it is.
            classes = "|".join(SCHEMAS.keys() - ALIASES)
            kind = " | ".join(dict.fromkeys(re.sub(rf"\b({classes})\b", "dict[str, Any]", kind).split(" | ")))
        # In quotes: it may name classes that come later.
        return f"{name}: TypeAlias = {quoted(kind)}\n"
    if len(kind) > 80:
        values = "".join(f"    {json.dumps(value)},\n" for value in schema["enum"])
        return f"{name} = Literal[\n{values}]\n"
    return f"{name} = {kind}\n"


def annotation(schema: Schema, inputs: set[str]) -> str:
    """The type as Python writes it. Objects that are told apart by their form only are plain dictionaries."""
    if "$ref" in schema:
        name = schema["$ref"].rsplit("/", 1)[-1]
        if name == "JobSettings" or (not inputs and name in SENT):
            # As it was sent, with every default.
            return "dict[str, Any]"
        return f"{name} | dict[str, Any]" if name in inputs and name not in ALIASES else name
    if "oneOf" in schema:
        kinds = [annotation(one, inputs) for one in schema["oneOf"]]
        # Apart at the top level only, not within brackets.
        flat = list(dict.fromkeys(kind for joined in kinds for kind in re.split(r" \| (?![^\[]*\])", joined)))
        literals = [kind[8:-1] for kind in flat if kind.startswith("Literal[")]
        others = [kind for kind in flat if not kind.startswith("Literal[") and kind != "None"]
        joined = ([f"Literal[{', '.join(literals)}]"] if literals else []) + others
        return " | ".join(joined + (["None"] if "None" in flat else []))
    if "enum" in schema:
        return f"Literal[{', '.join(json.dumps(value) for value in schema['enum'])}]"
    kind = schema.get("type")
    if isinstance(kind, list):
        [one] = [one for one in kind if one != "null"]
        return annotation({**schema, "type": one}, inputs) + " | None"
    if kind == "array":
        return f"list[{annotation(schema['items'], inputs)}]"
    if kind == "object":
        values = schema.get("additionalProperties")
        return f"dict[str, {annotation(values, inputs)}]" if isinstance(values, dict) else "dict[str, Any]"
    if kind == "string":
        return "datetime" if schema.get("format") == "date-time" else "str"
    return {"integer": "int", "number": "float", "boolean": "bool", "null": "None", None: "Any"}[kind]


def quoted(kind: str) -> str:
    return f"'{kind}'" if '"' in kind else f'"{kind}"'


def plain(text: str) -> str:
    """One line, without links into the documentation of Rust."""
    return re.sub(r"\s+", " ", re.sub(r"\[(`\w+`)\]\(crate::[^)]*\)", r"\1", text)).strip()


def comment(schema: Schema, indent: str) -> str:
    text = schema.get("description") or next(
        (one["description"] for one in schema.get("oneOf", []) if "$ref" in one and "description" in one), ""
    )
    lines = textwrap.wrap(plain(text), width=116 - len(indent))
    return "".join(f"{indent}#: {line}\n" for line in lines)


def docstring(text: str) -> str:
    lines = textwrap.wrap(plain(text), width=108)
    body = "\n    ".join(lines)
    return f'    """{body}"""\n' if len(lines) == 1 else f'    """{body}\n    """\n'


SCHEMAS: dict[str, Schema] = json.loads(DOCUMENT.read_text(encoding="utf-8"))["components"]["schemas"]
ALIASES = {name for name, schema in SCHEMAS.items() if is_alias(schema)}
#: Classes of what is sent, of which every field is optional.
SENT = reachable(SCHEMAS, INPUTS) - ALIASES

if __name__ == "__main__":
    main()
