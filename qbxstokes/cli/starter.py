"""Starter cases: some lines to begin with, or every key of a task with its meaning."""

import json
import re
import textwrap
from collections.abc import Collection
from textwrap import dedent
from typing import Any

from qbxstokes.case.describe import default_of, example_of, flows, meaning_of
from qbxstokes.case.document import parse, printable
from qbxstokes.case.model import Key
from qbxstokes.case.schema import FOREIGN, Case
from qbxstokes.errors import CaseError

Path = tuple[str, ...]

_WIDTH = 80
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
        return f"{head}\n{kind}{dedent(_STARTERS[task]).strip()}\n"
    values = {"task": task, **parse(dedent(_STARTERS[task]), "starter").data}
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
    path: Path, key: Key, values: dict[str, Any], foreign: Collection[Path], pad: str
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
    if len(whole) <= _WIDTH:
        return [whole]
    wrapped = textwrap.wrap(comment, _WIDTH, initial_indent=above, subsequent_indent=above)
    return [*wrapped, f"{pad}{line}"]


def _yaml(value: Any) -> str:
    """A value in the flow style of YAML, words without quotes where they need none."""
    if isinstance(value, dict):
        return f"{{{', '.join(f'{key}: {_yaml(entry)}' for key, entry in value.items())}}}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_yaml, value))}]"
    return value if isinstance(value, str) and _WORDS.fullmatch(value) else json.dumps(value)
