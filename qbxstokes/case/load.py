"""Case file -> validated `LoadedCase`; every fault is one line with file, line and key."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from qbxstokes.case.base import describe
from qbxstokes.case.document import Document, Key, document_of, parse, read_text
from qbxstokes.case.model import Fault, Invalid, section_of
from qbxstokes.case.schema import FOREIGN, Case, keys, section_at
from qbxstokes.case.space import SweepSpace, parse_key
from qbxstokes.case.sweep import TABLE, Sweep, SweepFault, build_space
from qbxstokes.errors import CaseError, FlowError

if TYPE_CHECKING:
    from qbxstokes.flows import Flow

UNKNOWN = "unknown key"
MAX_FAULTS = 100  # looked at one by one; a file with more of them is no case at all


@dataclass(frozen=True)
class LoadedCase:
    """A valid case with its flow and the document that messages refer to.

    With a sweep, `case` and `flow` are those of the first trajectory and `space` holds the axes. A
    case without a flow has the fluid at rest.
    """

    case: Case
    document: Document
    flow: Flow
    path: Path
    space: SweepSpace | None = None

    def error(self, key: Key | str, wrong: str, right: str = "") -> CaseError:
        """A CaseError that points at `key` in the file."""
        return self.document.error(key, wrong, right)

    def resolved(self) -> dict[str, Any]:
        """Every section that the task takes with all its keys, defaults included, as plain data."""
        unused = {key[0] for key in FOREIGN[self.case.task] if len(key) == 1}
        return self.case.model_dump(exclude=unused)


def load_case(path: str | Path, overrides: Sequence[str] = ()) -> LoadedCase:
    """Read, override and validate a case file; raises CaseError, writes nothing."""
    path = Path(path)
    document = parse(read_text(path), str(path))
    for assignment in overrides:
        document.override(assignment)
    return checked(document, path)


def case_of(keys: Mapping[str, Any], name: str = "case") -> LoadedCase:
    """The case of a dictionary of its keys; files that it names are in the working folder."""
    return checked(document_of(keys, name), Path(f"{name}.yaml"))


def checked(document: Document, path: Path) -> LoadedCase:
    """The case of a document that has just been read, valid at every point of its sweep."""
    loaded = from_document(document, path)
    if loaded.space is not None:
        _check_points(loaded.document, loaded.space)
    return loaded


def from_document(document: Document, path: Path, space: SweepSpace | None = None) -> LoadedCase:
    """The case of a document that has been read already (by another rank, with its `space`)."""
    if isinstance(document.data.get("sweep"), dict):
        space = space or _space(document, path.parent)
        document = _first_point(document, space)
    case = validate(document)
    return LoadedCase(case, document, _build_flow(case, document, path), path, space)


def _space(document: Document, folder: Path) -> SweepSpace:
    """The axes of the sweep, checked key by key before the case as a whole."""
    given = document.data["sweep"]
    try:
        section = Sweep.model_validate(given)
        for number, axis in enumerate(section.axes):
            for name in axis:
                known = name == TABLE or parse_key(name)[0] == "petsc"
                if not known and section_at(parse_key(name)[:1]) is None:
                    close = nearest(name, [key for key, _ in keys()])
                    right = f"did you mean {close}?" if close else "a key such as body.aspect_ratio"
                    where = ("sweep", "axes", number, name)
                    raise document.error(where, "unknown key", right)
        alone = section.measure is not None or document.data.get("task") == "body"
        return build_space(section.axes, folder, alone)
    except Invalid as invalid:
        first = replace(invalid.faults[0], key=("sweep", *invalid.faults[0].key))
        raise document.error(*_told(first)) from None
    except SweepFault as fault:
        raise document.error(fault.key, fault.wrong, fault.right) from None


def _first_point(document: Document, space: SweepSpace) -> Document:
    """The document with the first value of every swept key in its place, and its line."""
    data = space.assign(document.data, [0] * len(space.axes))
    data["sweep"] = document.data["sweep"]
    lines = dict(document.lines)
    for _, column in space.columns:
        lines[column.key] = document.line(column.where)
    return replace(document, data=data, lines=lines)


def _check_points(document: Document, space: SweepSpace) -> None:
    """Validate the case at the values of each axis, the other axes at their first point."""
    for number, axis in enumerate(space.axes):
        points = sorted({point for column in axis.columns for point in column.extremes()})
        for point in points:
            place = [point if other == number else 0 for other in range(len(space.axes))]
            try:
                Case.model_validate(space.assign(document.data, place))
            except Invalid as invalid:
                key, wrong, right = _told(invalid.faults[0])
                of = f"value {point + 1} of the axis"
                raise document.error(key, f"{wrong} ({of})", right) from None


def validate(document: Document) -> Case:
    """The case held in `document`; raises CaseError for the first fault in the file's order."""
    data = {
        # A section whose keys are all commented out is a section of defaults; one that may be
        # left out as a whole is left out.
        key: {} if value is None and section_at((key,)) and not _optional(key) else value
        for key, value in document.data.items()
    }
    try:
        return Case.model_validate(data)
    except Invalid as invalid:
        entries = invalid.faults
    # A misspelt key comes first: it is the cause of the key that is then missing.
    entries.sort(key=lambda entry: entry.kind != "unknown")
    faults = [_told(entry) for entry in entries[:MAX_FAULTS]]
    faults.sort(key=lambda fault: (fault[1] != UNKNOWN, document.line(fault[0]), len(fault[0])))
    key, wrong, right = faults[0]
    more = len({fault[0] for fault in faults}) - 1 + max(0, len(entries) - MAX_FAULTS)
    if more:
        right += f" (and {more} more {'faults' if more > 1 else 'fault'} after it)"
    raise document.error(key, wrong, right) from None


def _optional(section: str) -> bool:
    return Case.model_fields[section].default is None


def nearest(word: str, known: Sequence[str]) -> str | None:
    """The known word that `word` most resembles, if any does."""
    import difflib

    matches = difflib.get_close_matches(word.lower(), [name.lower() for name in known], 1, 0.6)
    return next((name for name in known if matches and name.lower() == matches[0]), None)


def _told(fault: Fault) -> tuple[Key, str, str]:
    """Key, what is wrong, and what would be right."""
    key, value, right = fault.key, fault.value, fault.right
    section = section_at(key[:-1])
    if fault.kind == "missing":
        field = section.model_fields[str(key[-1])] if section else None
        right = field.description if field else ""
        inner = section_of(field.annotation) if field else None
        if inner:
            right += f", with the keys {', '.join(inner.model_fields)}"
        if field and field.examples:
            right += f"; for example {key[-1]}: {field.examples[0]}"
        return key, "is missing", right
    if fault.kind == "unknown":
        known = list(section.model_fields) if section else []
        close = nearest(str(key[-1]), known)
        right = f"did you mean {close}?" if close else f"known here: {', '.join(known)}"
        return key, UNKNOWN, right
    if fault.kind == "choice":
        choices = ", ".join(fault.choices)
        close = nearest(value, fault.choices) if isinstance(value, str) else None
        right = f"did you mean {close}? (one of {choices})" if close else f"one of {choices}"
        return key, f"{describe(value)} is not a choice", right
    if fault.kind == "section":
        model = section_at(key)
        names = f": {', '.join(model.model_fields)}" if model else ""
        right = f"keys are expected below it{names}"
        if key == ("flow",) and isinstance(value, str):
            right = f"write flow: {{type: {value}}}"
        elif isinstance(value, str) and re.match(r"\w+:\S", value):
            right += "; put a space after the colon"
        elif key == ("start", "orientation") and isinstance(value, list) and len(value) in (3, 4):
            form = "axis" if len(value) == 3 else "quaternion"
            right = f"write orientation: {{{form}: [...]}}"
        return key, f"is {describe(value)}", right
    if fault.kind == "list":
        return key, f"is {describe(value)}", right or "a list is expected"
    return key, fault.wrong or f"is {describe(value)}", right


def _build_flow(case: Case, document: Document, path: Path) -> Flow:
    """Build the flow from its section, with faults mapped back to the key."""
    from qbxstokes.flows import build_flow

    try:
        at_rest = {"type": "uniform", "velocity": [0.0, 0.0, 0.0]}
        return build_flow(at_rest if case.flow is None else case.flow.spec(), path.parent)
    except FlowError as error:
        raise document.error(("flow", *error.key), str(error)) from None
