"""YAML text -> plain Python data that remembers the line of every key.

The tree is built here from the parser's events rather than by PyYAML's constructors, so that

- scalars follow YAML 1.2: `1e-6` is a number, `on` and `no` are strings, `1:30` is not 90;
- a key given twice is an error, and so are tags, since loading a case must not run code;
- depth, size and the expansion of aliases are bounded before anything is expanded;
- every value keeps its line for messages of the form `file:line: key: what is wrong`.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from qbxstokes.errors import CaseError, escaped

MAX_BYTES = 8 * 2**20
MAX_DEPTH = 24
MAX_NODES = 100_000

Key = tuple[str | int, ...]

_INT = re.compile(r"[-+]?[0-9]+\Z")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?\Z")
_NOT_FINITE = re.compile(r"(?i)([-+]?\.inf|\.nan)\Z")
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


@dataclass
class _Node:
    """A value, its line, and for containers the children in `value` and their expanded count."""

    value: Any
    line: int
    size: int = 1
    key_lines: dict[str, int] = field(default_factory=dict)


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
        target, equals, text = assignment.partition("=")
        key: Key = tuple(
            int(part) if re.fullmatch("[0-9]{1,9}", part) else part
            for part in re.sub(r"\[([0-9]+)\]", r".\1", target.strip()).split(".")
        )
        if not equals or not all(part != "" for part in key):
            raise CaseError(
                f"--set {printable(assignment)}: not an assignment; "
                "write --set section.key=value, for example --set body.aspect_ratio=0.2"
            )
        origin = f"--set {printable(assignment)}"
        value = _plain(_compose(text, origin), (), {})
        holder: Any = self.data
        for depth, part in enumerate(key):
            last = depth == len(key) - 1
            if isinstance(holder, list):
                if not isinstance(part, int) or part >= len(holder):
                    raise CaseError(
                        f"{origin}: {key_text(key[:depth])} is a list of {len(holder)} entries; "
                        f"use an index from 0 to {len(holder) - 1}"
                    )
            elif isinstance(holder, dict):
                part = str(part)
            else:
                raise CaseError(
                    f"{origin}: {key_text(key[:depth])} is not a section; "
                    f"set it as a whole: --set {key_text(key[:depth])}=..."
                )
            if last:
                holder[part] = value
            elif isinstance(holder, dict) and holder.get(part) is None:
                holder[part] = {}
            holder = holder[part]
        self.overrides[key] = assignment


def read_text(path: Path) -> str:
    """The text of a case file; every way that reading can go wrong is a CaseError."""
    name = printable(str(path), 400)
    try:
        if path.is_dir():
            raise CaseError(f"{name}: is a directory; name a case file (.yaml)")
        if path.exists() and not path.is_file():  # reading a pipe might wait for ever
            raise CaseError(f"{name}: is a pipe or device; name a case file (.yaml)")
        with path.open("rb") as stream:
            raw = stream.read(MAX_BYTES + 1)
    except FileNotFoundError:
        raise CaseError(f"{name}: no such file; name an existing case file (.yaml)") from None
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
    root = _compose(text, name)
    if root.value is None:
        raise CaseError(f"{name}:1: is empty; a case needs at least body, flow and time")
    if not isinstance(root.value, dict):
        raise CaseError(
            f"{name}:{root.line}: the case is not a set of keys; write sections such as `body:`"
        )
    lines: dict[Key, int] = {(): root.line}
    return Document(name=name, text=text, data=_plain(root, (), lines), lines=lines)


def _plain(node: _Node, key: Key, lines: dict[Key, int]) -> Any:
    """Plain data under `node`, entering the line of each key in `lines`."""
    if isinstance(node.value, dict):
        for name in node.value:
            lines[(*key, name)] = node.key_lines[name]
        return {name: _plain(child, (*key, name), lines) for name, child in node.value.items()}
    if isinstance(node.value, list):
        for index, child in enumerate(node.value):
            lines[(*key, index)] = child.line
        return [_plain(child, (*key, index), lines) for index, child in enumerate(node.value)]
    return node.value


def _events(text: str, name: str) -> Iterator[Any]:
    import yaml

    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    try:
        yield from yaml.parse(text, Loader=loader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = mark.line + 1 if mark else 1
        problem = printable(str(error.problem or error.context or error), 160)
        if any("\t" in there for there in text.splitlines()[line - 1 : line]):
            problem += "; indent with spaces, not with tabs"
        raise CaseError(f"{name}:{line}: is not valid YAML: {problem}") from None
    except yaml.YAMLError as error:
        problem = printable(" ".join(str(error).split()), 160)
        raise CaseError(f"{name}: is not valid YAML: {problem}") from None


def _compose(text: str, name: str) -> _Node:
    """Build the tree from the parser's events, bounded in depth and expanded size."""
    import yaml

    name = printable(name, 400)
    root: _Node | None = None
    stack: list[tuple[_Node, str | None]] = []  # open containers, each with its anchor
    keys: list[tuple[str, int] | None] = []  # the key that waits for its value, per container
    anchors: dict[str, _Node | None] = {}

    def fail(line: int, what: str) -> CaseError:
        return CaseError(f"{name}:{line}: {what}")

    def attach(node: _Node, is_key_text: str | None = None) -> None:
        nonlocal root
        if not stack:
            root = node
            return
        holder = stack[-1][0]
        if isinstance(holder.value, list):
            holder.value.append(node)
        elif keys[-1] is None:
            if is_key_text is None:
                raise fail(node.line, "a key must be a single word, not a list or a mapping")
            label = printable(is_key_text, 60)
            if is_key_text in holder.value:
                first = holder.key_lines[is_key_text]
                raise fail(node.line, f"{label}: given twice; it is already on line {first}")
            keys[-1] = (is_key_text, node.line)
            holder.value[is_key_text] = _Node(None, node.line)
            holder.key_lines[is_key_text] = node.line
            return
        else:
            holder.value[keys[-1][0]] = node
            keys[-1] = None
        holder.size += node.size
        if holder.size > MAX_NODES:
            raise fail(node.line, f"holds more than {MAX_NODES} values; use a file for large data")

    documents = 0
    for event in _events(text, name):
        mark = event.start_mark
        line = mark.line + 1 if mark else 1
        if isinstance(event, yaml.DocumentStartEvent):
            documents += 1
            if documents > 1:
                raise fail(line, "a second document starts (---); keep one case in a file")
        elif isinstance(event, yaml.AliasEvent):
            target = anchors.get(event.anchor)
            label = printable(event.anchor, 60)
            if event.anchor not in anchors:
                raise fail(line, f"*{label} names no anchor; define &{label} before it")
            if target is None:
                raise fail(line, f"*{label} stands within &{label} itself; write the value out")
            attach(target)
        elif isinstance(event, yaml.ScalarEvent):
            if event.tag not in (None, "!"):
                raise fail(line, f"tag {printable(event.tag, 60)} is not allowed; leave it out")
            plain = event.implicit[0] and not event.style
            value = _scalar(event.value) if plain else event.value
            node = _Node(value, line)
            attach(node, event.value)
            if event.anchor:
                anchors[event.anchor] = node
        elif isinstance(event, (yaml.MappingStartEvent, yaml.SequenceStartEvent)):
            if event.tag not in (None, "!"):
                raise fail(line, f"tag {printable(event.tag, 60)} is not allowed; leave it out")
            if len(stack) >= MAX_DEPTH:
                raise fail(line, f"nested more than {MAX_DEPTH} deep; no case needs that")
            is_mapping = isinstance(event, yaml.MappingStartEvent)
            if stack and isinstance(stack[-1][0].value, dict) and keys[-1] is None:
                raise fail(line, "a key must be a single word, not a list or a mapping")
            stack.append((_Node({} if is_mapping else [], line), event.anchor))
            keys.append(None)
            if event.anchor:
                anchors[event.anchor] = None
        elif isinstance(event, (yaml.MappingEndEvent, yaml.SequenceEndEvent)):
            node, anchor = stack.pop()
            keys.pop()
            attach(node)
            if anchor:
                anchors[anchor] = node
    return root or _Node(None, 1)


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
    """`value` with arrays and NumPy numbers as what JSON knows; infinities as text."""
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


def document_of(keys: Mapping[str, Any], name: str = "case") -> Document:
    """The document of a case given by its keys, in which arrays may stand for lists.

    name: what messages call it.
    """
    return replace(parse(json.dumps(plain(keys), indent=1), name), is_file=False)


def written(keys: Mapping[str, Any]) -> str:
    """The text of a case file with these keys."""
    return str(yaml.safe_dump(plain(keys), sort_keys=False, default_flow_style=None, width=100))
