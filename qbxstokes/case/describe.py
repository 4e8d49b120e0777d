"""The schema told in three ways: Markdown table, JSON Schema, commented starter case."""

from __future__ import annotations

import inspect
import json
import re
import textwrap
import types
import typing
from collections.abc import Collection, Iterator
from typing import Any, Literal

from qbxstokes.case.document import printable
from qbxstokes.case.model import MISSING, Convert, FieldInfo, Section, section_of
from qbxstokes.case.schema import FOREIGN, Case, keys
from qbxstokes.errors import CaseError

SCHEMA_FILE = "case.schema.json"


def default_text(field: FieldInfo) -> str:
    """The default as written in a case; 'required' where there is none."""
    if field.default is MISSING:
        return "required"
    value = field.default
    if value is None or value in ("", {}) or isinstance(value, Section):
        return ""
    return json.dumps(value) if not isinstance(value, str) else value


def markdown_table() -> str:
    """All keys as a Markdown table: key, default, meaning; then the flows with their keys."""
    rows = ["| key | default | meaning |", "|---|---|---|"]
    for name, field in keys():
        default = default_text(field)
        rows.append(
            f"| `{name}` | {f'`{default}`' if default not in ('', 'required') else default} "
            f"| {_choices(field)}{field.description} |"
        )
    rows += ["", "| `flow.type` | its keys, with defaults | flow |", "|---|---|---|"]
    for name, parameters, summary in flows():
        listed = ", ".join(
            f"`{key}`" if default is inspect.Parameter.empty else f"`{key}: {json.dumps(default)}`"
            for key, default in parameters.items()
        )
        rows.append(f"| `{name}` | {listed} | {summary} |")
    return "\n".join(rows)


def flows() -> Iterator[tuple[str, dict[str, Any], str]]:
    """Each flow's name, its keys with their defaults, and its first line of description."""
    from qbxstokes.flows import REGISTRY

    for name, flow in REGISTRY.items():
        yield name, flow.keys(), (inspect.getdoc(flow) or "").split("\n\n")[0].replace("\n", " ")


def json_schema() -> dict[str, Any]:
    """JSON Schema of a case file, for editors that complete and check YAML."""
    definitions: dict[str, Any] = {}
    schema = _section_schema(Case, definitions)
    flow = definitions["FlowSection"]
    flow["properties"]["type"]["enum"] = [name for name, _, _ in flows()]
    flow["properties"]["position"] = {"description": "moves the whole flow to this point"}
    flow["properties"]["rotation"] = {
        "description": "turns the whole flow: quaternion, {axis, angle} or matrix"
    }
    for name, parameters, _ in flows():
        for key in parameters:
            known = flow["properties"].setdefault(key, {"description": "key of"})
            known["description"] += f" {name}" if known["description"] == "key of" else f", {name}"
    alone = {"properties": {"task": {"const": "body"}}, "required": ["task"]}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **schema,
        "required": [name for name in schema["required"] if name != "flow"],
        "allOf": [{"if": alone, "else": {"required": ["flow"]}}],
        "$defs": definitions,
        "title": "qbxstokes case",
    }


def _section_schema(model: type[Section], definitions: dict[str, Any]) -> dict[str, Any]:
    """The schema of a section; those of the sections in it go to `definitions` by name."""
    properties = {}
    for name, field in model.model_fields.items():
        entry = _type_schema(field.hint, definitions)
        if "$ref" in entry:
            entry = {"allOf": [entry]}  # so that the description stands beside the reference
        entry["description"] = field.description
        if field.default is not MISSING:
            entry["default"] = _written(field.default)
        if field.examples:
            entry["examples"] = list(field.examples)
        properties[name] = entry
    return {
        "type": "object",
        "description": (inspect.getdoc(model) or "").split("\n\n")[0].replace("\n", " "),
        "properties": properties,
        "required": [
            name for name, field in model.model_fields.items() if field.default is MISSING
        ],
        "additionalProperties": model.model_open,
    }


def _written(default: Any) -> Any:
    """A default as a user would write it: of a section, the keys it sets itself."""
    if isinstance(default, Section):
        return {name: _written(getattr(default, name)) for name in default.model_fields_set}
    return list(default) if isinstance(default, tuple) else default


_PLAIN = {
    bool: "boolean",
    int: "integer",
    float: "number",
    str: "string",
    type(None): "null",
}
_BOUNDS = {"gt": "exclusiveMinimum", "ge": "minimum", "lt": "exclusiveMaximum", "le": "maximum"}


def _type_schema(hint: Any, definitions: dict[str, Any]) -> dict[str, Any]:
    """The schema of what may be written for an annotation."""
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if hint is Any:
        return {}
    if hint in _PLAIN:
        return {"type": _PLAIN[hint]}
    if isinstance(hint, type) and issubclass(hint, Section):
        if hint.__name__ not in definitions:
            definitions[hint.__name__] = {}  # stands for it where it holds itself
            definitions[hint.__name__] = _section_schema(hint, definitions)
        return {"$ref": f"#/$defs/{hint.__name__}"}
    if origin is typing.Annotated:
        written = next((m.json for m in arguments if isinstance(m, Convert) and m.json), None)
        schema = _type_schema(written or arguments[0], definitions)
        for mark in arguments[1:]:
            if isinstance(mark, FieldInfo):
                _bound(schema, mark)
        return schema
    if origin in (typing.Union, types.UnionType):
        return {"anyOf": [_type_schema(option, definitions) for option in arguments]}
    if origin is Literal:
        return {"enum": list(arguments)}
    if origin in (tuple, list):
        return {"type": "array", "items": _type_schema(arguments[0], definitions)}
    return {"type": "object", "additionalProperties": _type_schema(arguments[1], definitions)}


def _bound(schema: dict[str, Any], field: FieldInfo) -> None:
    """Bounds on the type that they mean: numbers among what may be written, texts, lists."""
    for option in schema.get("anyOf", [schema]):
        kind = option.get("type")
        if kind in ("number", "integer"):
            bounds = {word: getattr(field, name) for name, word in _BOUNDS.items()}
        elif kind in ("string", "array"):
            what = "Length" if kind == "string" else "Items"
            bounds = {f"min{what}": field.min_length, f"max{what}": field.max_length}
        else:
            continue
        option |= {word: bound for word, bound in bounds.items() if bound is not None}


_WIDTH = 80
_WORDS = re.compile(r"[A-Za-z][\w ./()*^+-]*")  # plain in YAML, and no number
_STARTERS: dict[str, dict[str, Any]] = {
    "motion": {
        "task": "motion",
        "title": "A spheroid in linear shear",
        "body": {"aspect_ratio": 0.5, "stokes_number": 0.0},
        "flow": {"type": "shear", "rate": 1.0},
        "start": {"orientation": {"axis": [1.0, 1.0, 1.0]}},
        "time": {"periods": 3, "samples": 301},
    },
    "field": {
        "task": "field",
        "title": "The flow around a spheroid in linear shear",
        "body": {"aspect_ratio": 0.5},
        "flow": {"type": "shear", "rate": 1.0},
        "start": {"orientation": {"axis": [1.0, 1.0, 0.0]}},
        "field": {
            "plane": {"extent": [-3.0, 3.0, -2.0, 2.0], "shape": [151, 101]},
            "pictures": True,
        },
    },
    "body": {"task": "body", "title": "The hydrodynamics of a body", "body": {"aspect_ratio": 0.5}},
}


def starter(task: str = "motion") -> str:
    """A case file that runs as it is, with every key of its task: the optional ones commented out.

    Lines are at most 80 columns wide. Raises CaseError for a task that has no starter.
    """
    if task not in _STARTERS:
        raise CaseError(f"--task {printable(task)}: unknown; one of {', '.join(_STARTERS)}")
    values = _STARTERS[task]
    lines = [
        "## Every key that this task takes, with its meaning. Keys behind a # show their",
        "## default, or an example where there is none. Run it with:",
        "##     python -m qbxstokes FILE",
    ]
    for name, field in Case.model_fields.items():
        if (name,) not in FOREIGN[task]:
            lines += ["", *_starter_lines((name,), field, values, FOREIGN[task], "")]
    return "\n".join(lines) + "\n"


def _starter_lines(
    key: tuple[str, ...],
    field: FieldInfo,
    values: dict[str, Any],
    foreign: Collection[tuple[str, ...]],
    pad: str,
) -> list[str]:
    """Lines of a key and of what is below it. pad: what stands before them, a "# " included."""
    name, inner = key[-1], section_of(field.annotation)
    given = name in values
    # One mark in front of a whole section that is commented out, none within it.
    mark = "" if given or "#" in pad else "# "
    comment = f"{_choices(field)}{field.description}"
    if key == ("flow", "type"):
        comment = f"{comment}. Flows: {', '.join(flow for flow, _, _ in flows())}"
    if inner:
        lines = _commented(pad, f"{pad}{mark}{name}:", comment)
        held = values.get(name, {})
        below = f"{pad}{mark}  "
        for other, subfield in inner.model_fields.items():
            if (*key, other) not in foreign:
                lines += _starter_lines((*key, other), subfield, held, foreign, below)
        extra = set(held) - set(inner.model_fields)
        return lines + [f"{below}{other}: {_yaml(held[other])}" for other in held if other in extra]
    if given:
        return _commented(pad, f"{pad}{name}: {_yaml(values[name])}", comment)
    shown = field.default
    if shown in (None, "", {}) or shown is MISSING:
        shown = field.examples[0] if field.examples else None
    text = "" if shown is None else f" {_yaml(shown)}"
    return _commented(pad, f"{pad}{mark}{name}:{text}", comment)


def _commented(pad: str, line: str, comment: str) -> list[str]:
    """The line with its comment beside it, or above it where both are too wide for one."""
    whole = f"{line}  # {comment}"
    if len(whole) <= _WIDTH:
        return [whole]
    above = f"{pad}## "
    return [*textwrap.wrap(comment, _WIDTH, initial_indent=above, subsequent_indent=above), line]


def _yaml(value: Any) -> str:
    """A value in the flow style of YAML, words without quotes where they need none."""
    if isinstance(value, dict):
        return f"{{{', '.join(f'{key}: {_yaml(entry)}' for key, entry in value.items())}}}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_yaml, value))}]"
    if isinstance(value, str) and _WORDS.fullmatch(value):
        return value
    return json.dumps(value)


def _choices(field: FieldInfo) -> str:
    """'a | b: ' for a choice of words, else ''."""
    words = getattr(field.annotation, "__args__", ())
    if words and all(isinstance(word, str) for word in words) and len(words) > 1:
        return f"{' / '.join(words)}: "
    return ""
