"""What a person reads: summaries, plans and descriptions of results, 80 columns wide."""

from __future__ import annotations

import inspect
import json
import textwrap
from collections.abc import Iterable, Mapping
from typing import Any

from qbxstokes.case.document import plain
from qbxstokes.case.load import LoadedCase
from qbxstokes.geometry.shape import Shape
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.io.listing import holds, units_of, unknown
from qbxstokes.io.results import Result

WIDTH = 80
_LABEL = 22  # width of the column of labels, unless one of them is wider
_WIDEST = 44
_ROUNDING = 1e-13  # components below this share of the largest are rounding

Rows = Iterable[tuple[str, str]]


def section(heading: str, rows: Rows) -> str:
    """A heading and its rows: label, then text wrapped beside it; nothing if there are no rows."""
    rows = list(rows)
    column = min(_WIDEST, max([_LABEL, *(len(label) + 2 for label, _ in rows)]))
    lines = []
    for label, text in rows:
        head, indent = (f"  {label:{column - 2}}  ", 2 + column) if label else ("  ", 4)
        lines += beside(head, text, indent)
    return "\n".join([heading, *lines]) if lines else ""


def beside(head: str, text: str, indent: int) -> list[str]:
    """Lines of a text that begins after a head and goes on with an indentation."""
    return textwrap.wrap(
        text,
        WIDTH,
        initial_indent=head,
        subsequent_indent=" " * indent,
        break_long_words=False,
        break_on_hyphens=False,
    )


def render(title: str, name: str, sections: Mapping[str, Rows]) -> str:
    """A title with the file's name at the right edge, or below it where both do not fit; sections.

    Those that hold nothing are left out.
    """
    gap = WIDTH - len(title) - len(name)
    headline = f"{title}{' ' * gap}{name}" if gap >= 2 else f"{title}\n{name}"
    parts = [section(heading, rows) for heading, rows in sections.items()]
    return "\n".join([headline, *(part for part in parts if part)])


def quantity(value: float) -> str:
    """A number as people read it."""
    return f"{value:.6g}"


def shape_text(shape: Shape) -> str:
    """The body's shape and its numbers."""
    if not isinstance(shape, Spheroid):
        return str(shape)
    k = shape.aspect_ratio
    if k == 1:
        return "sphere, k = 1"
    kind = "prolate" if k < 1 else "oblate"
    return f"{kind} spheroid, k = {quantity(k)} (L/D = {quantity(1.0 / k)})"


def vector(values: Iterable[float], scale: float = 0.0) -> str:
    """Components as people read them; those that are rounding are 0.

    scale: size of what the components were computed from, if it exceeds their own.
    """
    parts = [float(value) for value in values]
    least = _ROUNDING * max([scale, *map(abs, parts)])
    return ", ".join(quantity(part if abs(part) > least else 0.0) for part in parts)


def listed(lines: Iterable[str]) -> Rows:
    """Rows without labels, one for each line."""
    return (("", f"- {line}") for line in lines)


def error_text(value: float) -> str:
    """An error: two digits and an exponent, or 0."""
    return f"{value:.1e}" if value else "0"


def counted(count: float, noun: str, plural: str = "") -> str:
    """'1 rank', '2 ranks', '0.5 periods'; the plural ends in s unless given."""
    number = str(count) if isinstance(count, int) else quantity(count)
    return f"{number} {noun if number == '1' else plural or noun + 's'}"


def duration(seconds: float) -> str:
    """A time span in ms, s, min or h."""
    for limit, scale, unit in ((1.0, 1e-3, "ms"), (120.0, 1.0, "s"), (7200.0, 60.0, "min")):
        if seconds < limit:
            return f"{seconds / scale:.3g} {unit}"
    return f"{seconds / 3600.0:.3g} h"


def size(count: float) -> str:
    """A number of bytes."""
    for limit, scale, unit in ((1e3, 1.0, "B"), (1e6, 1e3, "kB"), (1e9, 1e6, "MB")):
        if count < limit:
            return f"{count / scale:.3g} {unit}"
    return f"{count / 1e9:.3g} GB"


def flow_text(loaded: LoadedCase) -> str:
    """The flow's name, its keys with their values, given or not, and its degree."""
    from qbxstokes.flows import REGISTRY

    given = loaded.case.flow.spec()
    name = given.pop("type")
    unsaid = (None, True, False, inspect.Parameter.empty)
    said = {k: v for k, v in REGISTRY[name].keys().items() if not any(v is u for u in unsaid)}
    said |= given
    texts = ((key, _text(value)) for key, value in said.items())
    parts = [f"{key} {text if len(text) <= 48 else text[:45] + '...'}" for key, text in texts]
    degree = loaded.flow.degree
    return ", ".join([name, *parts]) + (
        "" if degree is None else f"; polynomial of degree {degree}"
    )


def _text(value: Any) -> str:
    """A value as in a case file, numbers alike whether or not they were written with a point."""
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(_text, value))}]"
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{key}: {_text(entry)}' for key, entry in value.items())}}}"
    return quantity(value) if isinstance(value, float) else str(value)


def to_json(result: Result) -> str:
    """Everything about a result but its arrays."""
    return json.dumps(
        {
            "file": str(result.path),
            "task": result.task,
            "format_version": result.format_version,
            "datasets": {
                name: {"shape": list(shape), **plain(result.attributes[name])}
                for name, shape in result.shapes.items()
            },
            "events": {name: list(held) for name, held in result.events.items()},
            "fields": {name: list(held) for name, held in result.sets.items()},
            "summary": plain(result.summary),
            "provenance": plain(result.provenance),
        },
        indent=2,
    )


def describe_result(result: Result) -> str:
    """What a result file holds and how it was made."""
    made = result.provenance
    simple = (str, int, float)
    sections: dict[str, Rows] = {
        **holds(result),
        "Sampling": _sampling(result),
        "Not known": listed(unknown(result.arrays["table"])) if "table" in result.shapes else [],
        "Scales": list(_leaves(result.scales)),
        "Summary": [
            (name, f"{text} {units}".rstrip())
            for name, text in _leaves(result.summary)
            for units in [units_of(name)]
        ],
        "Made by": [
            (key, str(value))
            for key, value in made.items()
            if isinstance(value, simple) and "\n" not in str(value) and len(str(value)) < 300
        ],
    }
    text = render(made.get("title") or f"Result of task {result.task}", str(result.path), sections)
    if "case" in made:
        text += "\nCase\n" + textwrap.indent(str(made["case"]).rstrip(), "  ")
    return text


def _sampling(result: Result) -> Rows:
    from qbxstokes.plots.source import TURN_LIMIT, turn_between

    turn = turn_between(result)
    if turn > 1e-9:  # less is rounding
        few = "; too few to draw" if turn > TURN_LIMIT else ""
        yield "samples per turn", f"{6.2832 / turn:.3g} where the axis turns fastest{few}"


def _leaves(tree: Mapping[str, Any], prefix: str = "") -> Iterable[tuple[str, str]]:
    """Dotted name and text of every value in nested dictionaries."""
    for key, value in tree.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{prefix}{key}.")
        elif isinstance(value, float):
            yield prefix + key, quantity(value)
        elif isinstance(value, list):
            yield prefix + key, "; ".join(map(str, value)) or "none"
        elif value is not None:
            yield prefix + key, str(value)


def near_edge(gap: float, t: float | None = None) -> str:
    """What to say of a body that has come within a body length of an edge of its flow."""
    when = "" if t is None else f" at t = {t:.6g}"
    return (
        f"the body's surface came within {max(gap, 0.0):.3g} of a wall of the flow{when}, less "
        "than a body length: the wall's own influence on the body is not in the equations"
    )
