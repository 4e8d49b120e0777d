"""YAML text -> plain Python data that remembers the line of every key.

The data are made here from PyYAML's nodes rather than by its constructors, so that

- scalars follow YAML 1.2: `1e-6` is a number, `on` and `no` are strings, `1:30` is not 90;
- a key given twice is an error, and so are tags, since loading a case must not run code;
- depth, size and the expansion of aliases are bounded before anything is expanded;
- every value keeps its line for messages of the form `file:line: key: what is wrong`.
"""

import json
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from qbxstokes.case.model import Section
from qbxstokes.case.values import Key, Problem
from qbxstokes.errors import CaseError, escaped
from qbxstokes.folders import unreadable

MAX_BYTES = 8 * 2**20
MAX_DEPTH = 24
MAX_NODES = 100_000

_INT = re.compile(r"[-+]?[0-9]+\Z")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?\Z")
_NOT_FINITE = re.compile(r"(?i)([-+]?\.inf|\.nan)\Z")
ORIENTATION: Key = ("start", "orientation")
# Keys of a section that say one thing: `--set` of one replaces the others.
_ALTERNATIVES = (
    ("end", "periods", "at"),
    ("at", "samples"),
    ("aspect_ratio", "length_over_diameter", "shape"),
)
_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_CONSTANTS = {"true": True, "True": True, "TRUE": True}
_CONSTANTS |= {"false": False, "False": False, "FALSE": False}
_CONSTANTS |= dict.fromkeys(("", "~", "null", "Null", "NULL"))  # type: ignore[arg-type]


def printable(text: str, limit: int = 80) -> str:
    """`text` on one line, control characters escaped and the middle of a long one left out."""
    safe = escaped(text)
    if len(safe) > limit:
        half = (limit - 3) // 2
        safe = f"{safe[:half]}...{safe[-half:]}"
    return safe


def key_text(key: Key) -> str:
    """('start', 'position', 1) -> 'start.position[1]'."""
    text = ""
    for part in key:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else part
    return printable(text, 120)


def parse_key(text: str) -> Key:
    """'start.position[1]' or 'start.position.1' -> ('start', 'position', 1)."""
    parts = text.strip().replace("[", ".").replace("]", "").split(".")
    return tuple(int(part) if re.fullmatch("[0-9]{1,9}", part) else part for part in parts)


def assigned(data: Any, key: Key, value: Any, path: Key = (), *, replacing: bool = False) -> Any:
    """A copy of nested plain data with `key` set; what is not on the way is shared.

    path: of the data, for messages. replacing: the alternatives of `key`. Raises Problem where the
    key leads nowhere.
    """
    if not key:
        return value
    part, rest, below = key[0], key[1:], (*path, key[0])
    if data is None and isinstance(part, int):
        if path[-1:] == ("quaternion",):
            wrong = "is not given as a whole"
            raise Problem(wrong, "give all of quaternion[0] to quaternion[3]", path)
        data = [0.0] * 3
    if isinstance(data, list):
        if not isinstance(part, int) or part >= len(data):
            right = f"use an index from 0 to {len(data) - 1}"
            raise Problem(f"is a list of {len(data)} entries", right, path)
        entry = assigned(data[part], rest, value, below, replacing=replacing)
        return [*data[:part], entry, *data[part + 1 :]]
    if not isinstance(data, dict | None):
        raise Problem("is not a section", "set it as a whole", path)
    copied, part = dict(data or {}), str(part)
    inner = copied.get(part)
    if part == ORIENTATION[-1] and rest and isinstance(inner, dict):
        # The forms of an orientation exclude each other: the swept one replaces the case's.
        inner = {form: entry for form, entry in inner.items() if form == rest[0]}
    if replacing and not rest and value is not None:
        others = {name for names in _ALTERNATIVES if part in names for name in names} - {part}
        copied = {name: entry for name, entry in copied.items() if name not in others}
    copied[part] = assigned(inner, rest, value, below, replacing=replacing)
    return copied


@dataclass
class Document:
    """The data of one case and where each key of it stands; `is_file` if in a file with lines."""

    name: str
    text: str
    data: dict[str, Any]
    lines: dict[Key, int]
    overrides: dict[Key, str] = field(default_factory=dict)
    is_file: bool = True

    def where(self, key: Key) -> str:
        """`file:line`, or the override that set the key."""
        for changed, assignment in self.overrides.items():
            made_here = key not in self.lines and changed[: len(key)] == key
            if made_here or key[: len(changed)] == changed:
                return f"--set {printable(assignment)}"
        name = printable(self.name, 400)
        return f"{name}:{self.line(key)}" if self.is_file else name

    def line(self, key: Key) -> int:
        """Line of `key`, or of the closest section around it that is in the file."""
        for end in range(len(key), -1, -1):
            if key[:end] in self.lines:
                return self.lines[key[:end]]
        return 1

    def error(self, key: Key | str, wrong: str, right: str = "") -> CaseError:
        """The error to raise for `key`: one line that says where, what, and what would be right."""
        path = tuple(key.split(".")) if isinstance(key, str) else key
        label = f" {key_text(path)}:" if path else ""
        message = f"{self.where(path)}:{label} {wrong}" + (f"; {right}" if right else "")
        return CaseError(printable(message, 2000))

    def override(self, assignment: str) -> None:
        """Apply one `--set section.key=value`; the value is read as YAML."""
        # A terminal without UTF-8 hands its letters over as bytes.
        assignment = os.fsencode(assignment).decode("utf-8", "backslashreplace")
        target, equals, text = assignment.partition("=")
        origin, key = f"--set {printable(assignment)}", parse_key(target)
        if not equals or "" in key:
            right = "write --set section.key=value, for example --set body.aspect_ratio=0.2"
            raise CaseError(f"{origin}: not an assignment; {right}")
        try:
            self.data = assigned(self.data, key, _read(text, origin)[0], replacing=True)
        except Problem as problem:
            raise CaseError(f"{origin}: {key_text(problem.key)} {problem}") from None
        self.overrides[key] = assignment


def read_text(path: Path) -> str:
    """The text of a case file; every way that reading can go wrong is a CaseError."""
    name = printable(str(path), 400)
    if wrong := unreadable(path, "a case file (.yaml)"):
        raise CaseError(f"{name}: {wrong}")
    try:
        with path.open("rb") as stream:
            raw = stream.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise CaseError(f"{name}: cannot be read ({printable(reason)})") from None
    if len(raw) > MAX_BYTES:
        raise CaseError(f"{name}: longer than {MAX_BYTES // 2**20} MiB; this is not a case file")
    if raw[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise CaseError(f"{name}:1: is UTF-16 text; save it as UTF-8")
    if raw[:8] == b"\x89HDF\r\n\x1a\n":
        raise CaseError(f"{name}: is an HDF5 file; `qbxstokes info` describes results")
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        raise CaseError(
            f"{name}:{line}: byte 0x{raw[error.start]:02x} is not UTF-8; save the file as UTF-8"
        ) from None
    if "\0" in text:
        line = text.count("\n", 0, text.index("\0")) + 1
        raise CaseError(f"{name}:{line}: holds zero bytes, so it is not text; name a YAML file")
    return text


def parse(text: str, name: str) -> Document:
    """The document of one case; raises CaseError with file and line."""
    data, lines = _read(text, name)
    if data is None:
        raise CaseError(f"{name}:1: is empty; a case needs at least body, flow and time")
    if not isinstance(data, dict):
        what = "the case is not a set of keys; write sections such as `body:`"
        raise CaseError(f"{name}:{lines[()]}: {what}")
    return Document(name=name, text=text, data=data, lines=lines)


def _read(text: str, name: str) -> tuple[Any, dict[Key, int]]:
    """Plain data and the line of each key in them."""
    name = printable(name, 400)
    lines: dict[Key, int] = {}
    try:
        _check_events(text, name)
        node = yaml.compose(text, Loader=_LOADER)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = mark.line + 1 if mark else 1
        problem = printable(str(error.problem or error.context or error), 160)
        if any("\t" in there for there in text.splitlines()[line - 1 : line]):
            problem += "; indent with spaces, not with tabs"
        elif "unexpected ':'" in problem:
            problem += "; put a space after the colon"
        raise CaseError(f"{name}:{line}: is not valid YAML: {problem}") from None
    except yaml.YAMLError as error:
        problem = printable(" ".join(str(error).split()), 160)
        raise CaseError(f"{name}: is not valid YAML: {problem}") from None
    return (None if node is None else _plain(node, (), lines, name)), lines


def _check_events(text: str, name: str) -> None:
    """Refuse what must not be expanded, before a tree is made."""
    holders: list[str | None] = []  # anchors of the containers that are open
    size = documents = 0
    for event in yaml.parse(text, Loader=_LOADER):
        anchor, tag, wrong = getattr(event, "anchor", None), getattr(event, "tag", None), ""
        size += isinstance(event, yaml.NodeEvent)
        documents += isinstance(event, yaml.DocumentStartEvent)
        if isinstance(event, yaml.CollectionStartEvent):
            holders.append(anchor)
        elif isinstance(event, yaml.CollectionEndEvent):
            holders.pop()
        elif isinstance(event, yaml.AliasEvent) and anchor in holders:
            label = printable(str(anchor), 60)
            wrong = f"*{label} stands within &{label} itself; write the value out"
        if documents > 1:
            wrong = "a second document starts (---); keep one case in a file"
        elif tag not in (None, "!"):
            wrong = f"tag {printable(str(tag), 60)} is not allowed; leave it out"
        _refuse(event, name, wrong, size, len(holders))


def _refuse(place: Any, name: str, wrong: str, size: int, depth: int) -> None:
    """Raise CaseError for what is wrong or too large at an event or node."""
    if depth > MAX_DEPTH:
        wrong = f"nested more than {MAX_DEPTH} deep; no case needs that"
    elif size > MAX_NODES:
        wrong = f"holds more than {MAX_NODES} values; use a file for large data"
    if wrong:
        raise CaseError(f"{name}:{_line(place)}: {wrong}")


def _plain(node: Any, key: Key, lines: dict[Key, int], name: str) -> Any:
    """Plain data under `node`, aliases expanded; enters the line of each key in `lines`."""
    lines.setdefault(key, _line(node))  # that of its name, in a mapping
    _refuse(node, name, "", len(lines), len(key))
    if isinstance(node, yaml.ScalarNode):
        return node.value if node.style else _scalar(node.value)
    if isinstance(node, yaml.SequenceNode):
        return [_plain(inner, (*key, i), lines, name) for i, inner in enumerate(node.value)]
    data: dict[str, Any] = {}
    for word, inner in node.value:
        path, wrong = (*key, word.value), ""
        if not isinstance(word, yaml.ScalarNode):
            wrong = "a key must be a single word, not a list or a mapping"
        elif word.value in data:
            wrong = f"{printable(word.value, 60)}: given twice; it is already on line {lines[path]}"
        elif ":" in word.value and isinstance(inner, yaml.ScalarNode) and not inner.value:
            wrong = f"{printable(word.value, 60)}: has no value; put a space after the colon"
        _refuse(word, name, wrong, 0, 0)
        lines[path] = _line(word)
        data[word.value] = _plain(inner, path, lines, name)
    return data


def _line(place: Any) -> int:
    return int(place.start_mark.line) + 1 if place.start_mark else 1


def _scalar(text: str) -> Any:
    """A plain scalar by the rules of YAML 1.2, with `1e-6` and `.5` as numbers."""
    if text in _CONSTANTS:
        return _CONSTANTS[text]
    if _INT.match(text) and len(text) < 300:
        return int(text)
    if _FLOAT.match(text) and len(text) < 300:
        return float(text)
    if _NOT_FINITE.match(text):
        return float(text.replace(".", "", 1))
    return text


def plain(value: Any) -> Any:
    """`value` with sections, arrays and NumPy numbers as what JSON knows; infinities as text."""
    if isinstance(value, Section):
        value = {name: getattr(value, name) for name in value.declared} | dict(value.extra)
    if isinstance(value, Mapping):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(entry) for entry in value]
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float) and not np.isfinite(value):
        return str(value)
    return value


def given(value: Any, name: str, key: Key = ()) -> Any:
    """What a program gives in a case `name`, as a file has it.

    Arrays and ranges become lists, paths text, flows and shapes their keys, functions and series
    of gradients names (`flows.user.hand_over`). Raises CaseError, by its key, for anything else.
    """
    if isinstance(value, Mapping):
        return {
            str(inner): given(entry, name, (*key, str(inner))) for inner, entry in value.items()
        }
    if isinstance(value, np.ndarray | np.generic | range):
        value = list(value) if isinstance(value, range) else value.tolist()
    if isinstance(value, list | tuple):
        return [given(entry, name, (*key, number)) for number, entry in enumerate(value)]
    if hasattr(value, "spec"):
        return given(value.spec(), name, key)
    if callable(value):
        from qbxstokes.flows.user import hand_over

        return hand_over(value)
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if value is None or isinstance(value, str | int | float | Section):
        return plain(value)
    wrong = f"is {printable(repr(value), 60)}, of type {type(value).__name__}"
    right = "numbers, text, lists and mappings of them, flows and functions stand in a case"
    raise CaseError(f"{name}: {key_text(key)}: {wrong}; {right}")


def document_of(keys: Mapping[str, Any], name: str = "case") -> Document:
    """The document of a case given by its keys (see `given`).

    name: what messages call it.
    """
    text = json.dumps(given(keys, name), indent=1)
    return replace(parse(text, name), is_file=False)


def written(keys: Mapping[str, Any]) -> str:
    """The text of a case file with these keys."""
    return str(yaml.safe_dump(plain(keys), sort_keys=False, default_flow_style=None, width=100))
