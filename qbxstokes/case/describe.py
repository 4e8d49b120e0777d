"""The schema told: as a page, as JSON Schema, and as starter cases to begin with."""

import inspect
import json
import re
import textwrap
from collections.abc import Collection, Iterator
from typing import Any

from qbxstokes.case.document import parse, plain, printable
from qbxstokes.case.model import Key, Section
from qbxstokes.case.schema import FOREIGN, Case, keys
from qbxstokes.errors import CaseError

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


# -- starter cases ---------------------------------------------------------------------------------

Words = tuple[str, ...]
_COLUMNS = 80
_WORDS = re.compile(r"[A-Za-z][\w ./()*^+-]*")  # plain in YAML, and no number
_STARTERS = {
    "motion": """
        title: A spheroid in linear shear
        body:
          aspect_ratio: 0.5              # equatorial over polar radius: prolate < 1
          stokes_number: 0.0             # St, its inertia; 0 is massless
        flow:
          type: shear                    # u = rate (x2, 0, 0); others: help flows
          rate: 1.0
        start:
          orientation: {axis: [1.0, 1.0, 1.0]}
        time:
          periods: 3                     # Jeffery periods; or end: 50
          samples: 301""",
    "field": """
        title: The flow around a spheroid in linear shear
        body:
          aspect_ratio: 0.5              # equatorial over polar radius: prolate < 1
        flow:
          type: shear                    # u = rate (x2, 0, 0); others: help flows
          rate: 1.0
        start:
          orientation: {axis: [1.0, 1.0, 0.0]}
        field:
          plane:
            extent: [-3.0, 3.0, -2.0, 2.0]   # of x1 and x2 about the body
            shape: [151, 101]
          pictures: true""",
    "rheology": """
        title: A dilute suspension in shear
        body:
          aspect_ratio: 0.2              # equatorial over polar radius: prolate < 1
        flow:
          type: shear
          rate: 1.0
        rheology:
          peclet_number: [0.1, 1.0, 10.0, 100.0]   # rate over rotary diffusivity""",
    "body": """
        title: The hydrodynamics of a body
        body:
          aspect_ratio: 0.5              # equatorial over polar radius: prolate < 1""",
}


def starter(task: str = "motion", full: bool = False) -> str:
    """A case file that runs as it is: some lines, or in full with every key of its task.

    The optional ones are then commented out. Lines are at most 80 columns wide. Raises CaseError
    for a task that has no starter.
    """
    if task not in _STARTERS:
        raise CaseError(f"--task {printable(task)}: unknown; one of {', '.join(_STARTERS)}")
    if not full:
        head = f"# Run it: python -m qbxstokes FILE   (every key: new --full --task {task})"
        kind = "" if task == "motion" else f"task: {task}\n"
        return f"{head}\n{kind}{textwrap.dedent(_STARTERS[task]).strip()}\n"
    values = {"task": task, **parse(textwrap.dedent(_STARTERS[task]), "starter").data}
    lines = [
        "## Every key that this task takes, with its meaning. Keys behind a # show their",
        "## default, or an example where there is none. Run it with:",
        "##     python -m qbxstokes FILE",
    ]
    for name, key in Case.declared.items():
        if (name,) not in FOREIGN[task]:
            lines += ["", *_starter_lines((name,), key, values, FOREIGN[task], "")]
    return "\n".join(lines) + "\n"


def _starter_lines(
    path: Words, key: Key, values: dict[str, Any], foreign: Collection[Words], pad: str
) -> list[str]:
    """Lines of a key and of what is below it. pad: what stands before them, a "# " included."""
    name, section = path[-1], None if key.reader.listed else key.reader.section
    # One mark in front of a whole section that is commented out, none within it.
    pad += "" if name in values or "#" in pad else "# "
    comment = meaning_of(key)
    if path == ("flow", "type"):
        comment += f". Flows: {', '.join(flow for flow, _, _ in flows())}"
    if section is None:
        shown = values.get(name, example_of(key) if default_of(key) is None else key.default)
        text = "" if shown is None else f" {_yaml(shown)}"
        return _commented(pad, f"{name}:{text}", comment)
    lines, held = _commented(pad, f"{name}:", comment), values.get(name, {})
    for other, inner in section.declared.items():
        if (*path, other) not in foreign:
            lines += _starter_lines((*path, other), inner, held, foreign, f"{pad}  ")
    more = [other for other in held if other not in section.declared]
    return [*lines, *(f"{pad}  {other}: {_yaml(held[other])}" for other in more)]


def _commented(pad: str, line: str, comment: str) -> list[str]:
    """The line with its comment beside it, or above it where both are too wide for one."""
    whole, above = f"{pad}{line}  # {comment}", f"{pad.removesuffix('# ')}## "
    if len(whole) <= _COLUMNS:
        return [whole]
    wrapped = textwrap.wrap(comment, _COLUMNS, initial_indent=above, subsequent_indent=above)
    return [*wrapped, f"{pad}{line}"]


def _yaml(value: Any) -> str:
    """A value in the flow style of YAML, words without quotes where they need none."""
    if isinstance(value, dict):
        return f"{{{', '.join(f'{key}: {_yaml(entry)}' for key, entry in value.items())}}}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_yaml, value))}]"
    return value if isinstance(value, str) and _WORDS.fullmatch(value) else json.dumps(value)
