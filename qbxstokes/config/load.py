"""Case file -> validated `LoadedCase`; every fault is one line with file, line and key."""

from __future__ import annotations

import difflib
import types
import typing
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel, ValidationError

from qbxstokes.config.base import describe
from qbxstokes.config.document import Document, Key, parse, read_text
from qbxstokes.config.schema import Case
from qbxstokes.errors import CaseError, FlowError

if TYPE_CHECKING:
    from qbxstokes.flows import Flow

UNKNOWN = "unknown key"


@dataclass(frozen=True)
class LoadedCase:
    """A valid case with its flow and the document that messages refer to."""

    case: Case
    document: Document
    flow: Flow
    path: Path

    def error(self, key: Key | str, wrong: str, right: str = "") -> CaseError:
        """A CaseError that points at `key` in the file."""
        return self.document.error(key, wrong, right)

    def resolved(self) -> dict[str, Any]:
        """Every key with its value, defaults included, as plain data."""
        return self.case.model_dump(mode="json")


def load_case(path: str | Path, overrides: Sequence[str] = ()) -> LoadedCase:
    """Read, override and validate a case file; raises CaseError, writes nothing."""
    path = Path(path)
    document = parse(read_text(path), str(path))
    for assignment in overrides:
        document.override(assignment)
    return from_document(document, path)


def from_document(document: Document, path: Path) -> LoadedCase:
    """The case of a document that has been read already (by another rank, say)."""
    case = validate(document)
    return LoadedCase(case, document, _build_flow(case, document, path), path)


def validate(document: Document) -> Case:
    """The case held in `document`; raises CaseError for the first fault in the file's order."""
    data = {
        # A section whose keys are all commented out is a section of defaults.
        key: {} if value is None and section_at((key,)) else value
        for key, value in document.data.items()
    }
    try:
        return Case.model_validate(data)
    except ValidationError as error:
        faults = [_fault(document, dict(entry)) for entry in error.errors(include_url=False)]
    # A misspelt key comes first: it is the cause of the key that is then missing.
    faults.sort(key=lambda fault: (fault[1] != UNKNOWN, document.line(fault[0]), len(fault[0])))
    key, wrong, right = faults[0]
    more = len({fault[0] for fault in faults}) - 1
    if more:
        right += f" (and {more} more {'faults' if more > 1 else 'fault'} after it)"
    raise document.error(key, wrong, right) from None


def nearest(word: str, known: Sequence[str]) -> str | None:
    """The known word that `word` most resembles, if any does."""
    matches = difflib.get_close_matches(word.lower(), [name.lower() for name in known], 1, 0.6)
    return next((name for name in known if matches and name.lower() == matches[0]), None)


def section_at(key: Key) -> type[BaseModel] | None:
    """The section class that `key` leads to, or None where it leads to a plain value."""
    model: type[BaseModel] | None = Case
    for part in key:
        if model is None or part not in model.model_fields:
            return None
        model = section_of(model.model_fields[str(part)].annotation)
    return model


def section_of(annotation: Any) -> type[BaseModel] | None:
    """The section class in a field's annotation, looking through `| None`."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    if typing.get_origin(annotation) in (typing.Union, types.UnionType):
        found = (section_of(option) for option in typing.get_args(annotation))
        return next((model for model in found if model is not None), None)
    return None


def _known_key(document: Document, key: Key) -> Key:
    """`key` without the tags that validation of unions appends to it."""
    holder: Any = document.data
    for depth, part in enumerate(key):
        inside = (isinstance(holder, dict) and part in holder) or (
            isinstance(holder, list) and isinstance(part, int) and part < len(holder)
        )
        if not inside:
            return key[:depth]
        holder = holder[part]
    return key


def _fault(document: Document, entry: dict[str, Any]) -> tuple[Key, str, str]:
    """Key, what is wrong, and what would be right, of one entry of pydantic's list."""
    kind, key, context = entry["type"], tuple(entry["loc"]), entry.get("ctx", {})
    value = entry.get("input")
    if kind == "case":
        return (*_known_key(document, key), *context["key"]), context["wrong"], context["right"]
    if kind == "missing":
        parent = section_at(key[:-1])
        field = parent.model_fields[str(key[-1])] if parent else None
        right = (field.description or "") if field else ""
        inner = section_of(field.annotation) if field else None
        if inner:
            right += f", with the keys {', '.join(inner.model_fields)}"
        if field and field.examples:
            right += f"; for example {key[-1]}: {field.examples[0]}"
        return key, "is missing", right
    key = _known_key(document, key)
    section = section_at(key[:-1])
    if kind == "extra_forbidden":
        known = list(section.model_fields) if section else []
        close = nearest(str(key[-1]), known)
        right = f"did you mean {close}?" if close else f"known here: {', '.join(known)}"
        return key, UNKNOWN, right
    if kind == "literal_error":
        choices = context["expected"].replace("'", "").replace(" or ", ", ")
        close = nearest(value, choices.split(", ")) if isinstance(value, str) else None
        right = f"did you mean {close}? (one of {choices})" if close else f"one of {choices}"
        return key, f"{describe(value)} is not a choice", right
    if kind in ("model_type", "model_attributes_type", "dict_type"):
        model = section_at(key)
        keys = f": {', '.join(model.model_fields)}" if model else ""
        return key, f"is {describe(value)}", f"keys are expected below it{keys}"
    if kind in ("tuple_type", "list_type"):
        return key, f"is {describe(value)}", "a list is expected"
    for name, sign in {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}.items():
        if name in context:
            return key, f"is {describe(value)}", f"must be {sign} {context[name]:g}"
    return key, f"is {describe(value)}", entry["msg"]


def _build_flow(case: Case, document: Document, path: Path) -> Flow:
    """Build the flow from its section, with faults mapped back to the key."""
    from qbxstokes.flows import build_flow

    try:
        return build_flow(case.flow.spec(), path.parent)
    except FlowError as error:
        raise document.error(("flow", *error.key), str(error)) from None
