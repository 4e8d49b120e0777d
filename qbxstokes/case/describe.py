"""The schema told as a page and as JSON Schema."""

import inspect
import json
import textwrap
from collections.abc import Iterator
from typing import Any

from qbxstokes.case.document import plain
from qbxstokes.case.model import Key, Section
from qbxstokes.case.schema import Case, keys

SCHEMA_FILE = "case.schema.json"

# Of the page of keys: columns in all, and those that a key with its default has.
_WIDTH, _HEAD = 76, 36
_INTRODUCTION = """\
# Every key of a case file, with its default and its meaning

`body.aspect_ratio` is the key `aspect_ratio` in the section `body`. A key stands
with its default after the colon; one without a default is left out unless you
give it. A choice of words is shown as `one / another`. Numbers may be arithmetic
(`1/50`, `pi/2`, `sqrt(2)/2`), angles degrees (`90 deg`).

`python -m qbxstokes new` prints a case with every key in its place, and editors
check one that names the schema in its first line, as those in `cases/` do.
(`python -m qbxstokes schema --write` writes this page and the schema.)"""


def keys_page() -> str:
    """The page `keys`: all keys with default and meaning, then the flows with their keys."""
    rows: dict[str, list[str]] = {}
    for name, key in keys():
        default = default_of(key)
        shown = default if default is None or isinstance(default, str) else json.dumps(default)
        head = name if shown is None else f"{name}: {shown}"
        meaning = meaning_of(key) + (" (required)" if key.required else "")
        rows.setdefault(name.split(".")[0], []).append(_entry(head, meaning))
    lines = [*_INTRODUCTION.splitlines()]
    for section, entries in rows.items():
        lines += ["", f"## {section}", "", "```text", *entries, "```"]
    from qbxstokes.flows import REGISTRY

    lines += ["", "## The flows: what flow.type may be", ""]
    lines += ["Numbers of keys marked ~ may change in time, and the flow then has the keys"]
    lines += ["`longest_step` and `breaks` ([flows](flows.md)).", "", "```text"]
    for name, parameters, summary in flows():
        marks = {key: f"{key}~" for key in REGISTRY[name].linear_in}
        listed = "  ".join(
            marks.get(key, key)
            + ("" if default is inspect.Parameter.empty else f": {json.dumps(default)}")
            for key, default in parameters.items()
        )
        lines += textwrap.wrap(f"{name}  {listed}", _WIDTH, subsequent_indent="    ")
        lines += textwrap.wrap(summary, _WIDTH, initial_indent="    ", subsequent_indent="    ")
    return "\n".join([*lines, "```"]) + "\n"


def _entry(head: str, meaning: str) -> str:
    """A key and its default, and beside it, or below where it is long, what it means."""
    lines = textwrap.wrap(meaning, _WIDTH - _HEAD)
    rest = [" " * _HEAD + line for line in lines]
    if len(head) > _HEAD - 2:
        return "\n".join([head, *rest])
    return "\n".join([f"{head:{_HEAD}}{lines[0]}", *rest[1:]])


def flows() -> Iterator[tuple[str, dict[str, Any], str]]:
    """Each flow's name, its keys with their defaults, and its first line of description."""
    from qbxstokes.flows import REGISTRY

    for name, flow in REGISTRY.items():
        yield name, flow.keys(), _summary(flow)


def _summary(thing: Any) -> str:
    """The first paragraph of a docstring on one line."""
    return (inspect.getdoc(thing) or "").split("\n\n")[0].replace("\n", " ")


def default_of(key: Key) -> Any:
    """The default of a key, None where there is none or nothing to tell."""
    silent = key.required or isinstance(key.default, Section) or key.default in ("", {})
    return None if silent else key.default


def example_of(key: Key) -> Any:
    """What may be given for a key that has no default to show."""
    words = key.reader.words if key.default is None else ()
    return words[0] if words else key.example


def meaning_of(key: Key) -> str:
    """What a key means, the words that it is a choice of first."""
    words = key.reader.words
    return f"{' / '.join(words)}: {key.meaning}" if len(words) > 1 else key.meaning


# -- JSON Schema ----------------------------------------------------------------------------------


def json_schema() -> dict[str, Any]:
    """JSON Schema of a case file, for editors that complete and check YAML."""
    sections = {key.reader.section for _, key in keys() if key.reader.section}
    definitions = {model.__name__: _section_schema(model) for model in sections}
    flow = definitions["FlowSection"]["properties"]
    flow["type"]["enum"] = [name for name, _, _ in flows()]
    flow["position"] = {"description": "moves the whole flow to this point"}
    flow["rotation"] = {"description": "turns the whole flow: quaternion, {axis, angle} or matrix"}
    for name, parameters, _ in flows():
        for key in parameters:
            known = flow.setdefault(key, {"description": "key of"})
            known["description"] += f" {name}" if known["description"] == "key of" else f", {name}"
    schema = _section_schema(Case)
    alone = {
        "anyOf": [
            {"properties": {"task": {"const": "body"}}, "required": ["task"]},
            {"required": ["bodies"]},
            {"required": ["surroundings"]},
        ]
    }
    some_body = {"anyOf": [{"required": ["body"]}, {"required": ["bodies"]}]}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **schema,
        "required": [name for name in schema["required"] if name != "flow"],
        "allOf": [{"if": alone, "else": {"required": ["flow"]}}, some_body],
        "$defs": dict(sorted(definitions.items())),
        "title": "qbxstokes case",
    }


def _section_schema(model: type[Section]) -> dict[str, Any]:
    """The schema of a section; those of the sections in it are referred to by name."""
    return {
        "type": "object",
        "description": _summary(model),
        "properties": {name: _key_schema(key) for name, key in model.declared.items()},
        "required": [name for name, key in model.declared.items() if key.required],
        "additionalProperties": model.is_open,
    }


def _key_schema(key: Key) -> dict[str, Any]:
    """What may be written for a key, with its meaning, default and example."""
    schema = key.reader.json
    # A description stands beside a reference only where this is wrapped.
    schema = {"allOf": [schema]} if "$ref" in schema else dict(schema)
    schema["description"] = key.meaning
    if not key.required:
        schema["default"] = _written(key.default)
    if example_of(key) is not None:
        schema["examples"] = [example_of(key)]
    return schema


def _written(default: Any) -> Any:
    """A default as a user would write it: of a section, the keys it sets itself."""
    if isinstance(default, Section):
        return {name: _written(getattr(default, name)) for name in sorted(default.given_keys)}
    return plain(default)
