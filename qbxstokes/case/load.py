"""Case file -> validated `LoadedCase`; every fault is one line with file, line and key."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from qbxstokes.case.bodies import expanded
from qbxstokes.case.document import Document, document_of, parse, parse_key, plain, read_text
from qbxstokes.case.schema import FOREIGN, Case, keys
from qbxstokes.case.sweep import TABLE, TRAJECTORY, Sweep, SweepSpace, build_space
from qbxstokes.case.values import Key, Problem, at, meant
from qbxstokes.errors import CaseError, FlowError, SinglePrecisionWarning

if TYPE_CHECKING:
    from qbxstokes.flows import Flow


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
    remarks: tuple[str, ...] = ()

    def error(self, key: Key | str, wrong: str, right: str = "") -> CaseError:
        """A CaseError that points at `key` in the file."""
        return self.document.error(key, wrong, right)

    def at(self, points: Sequence[int]) -> LoadedCase:
        """The case at one point of every axis of its sweep."""
        assert self.space is not None
        data = self.space.assign(self.document.data, points)
        return from_document(replace(self.document, data=data), self.path)

    def resolved(self) -> dict[str, Any]:
        """Every section that the task takes with all its keys, defaults included, as plain data."""
        unused = {key[0] for key in FOREIGN[self.case.task] if len(key) == 1}
        return {name: value for name, value in plain(self.case).items() if name not in unused}


def load_case(path: str | Path, overrides: Sequence[str] = ()) -> LoadedCase:
    """Read, override and validate a case file; raises CaseError, writes nothing."""
    path = Path(path)
    document = parse(read_text(path), str(path))
    for assignment in overrides:
        document.override(assignment)
    return checked(document, path)


def case_of(keys: Mapping[str, Any]) -> LoadedCase:
    """The case of a dictionary of its keys; files that it names are in the working folder."""
    return checked(document_of(keys), Path("case.yaml"))


def checked(document: Document, path: Path) -> LoadedCase:
    """The case of a document that has just been read, valid at every point of its sweep."""
    sweep = document.data.get("sweep")
    kept = isinstance(sweep, dict) and sweep.get("store") == "statistics"
    if document.data.get("statistics") is not None and not kept:
        wrong = "has no meaning without sweep.store: statistics"
        raise document.error("statistics", wrong, "store: statistics, with flow.trajectory: all")
    if document.data.get("brownian") is not None:
        _check_brownian(document)
    loaded = from_document(document, path)
    document, space = loaded.document, loaded.space or SweepSpace(())
    for number, columns in enumerate(space.axes):
        # The values of each axis, the other axes at their first point.
        for point in sorted({point for column in columns for point in column.extremes()}):
            told = f" ({columns[0].told(point)})"
            place = [point if other == number else 0 for other in range(len(space.axes))]
            with _told(document, told):
                Case.read(space.assign(document.data, place))
    return loaded


def _check_brownian(document: Document) -> None:
    """Raise CaseError for motions that cannot be random."""
    sweep = document.data.get("sweep")
    if not isinstance(sweep, dict):
        right = (
            "sweep: {axes: [start.orientation: {random: axes, count: 100}]} or, of one axis, "
            "[start.orientation: [[1, 0, 0]]]"
        )
        raise document.error("brownian", "has no meaning for a single motion", right)
    given = {**document.data, "sweep.measure": sweep.get("measure") or None}
    for name in ("bodies", "surroundings", "field", "sweep.measure"):
        if given.get(name) is not None:
            raise document.error("brownian", f"has no meaning with {name}", "leave one of them out")


def from_document(document: Document, path: Path, space: SweepSpace | None = None) -> LoadedCase:
    """The case of a document that has been read already (by another rank, with its `space`)."""
    if isinstance(document.data.get("bodies"), dict):
        with _told(document), at("bodies"):
            many = expanded(document.data["bodies"], path.parent)
        document = replace(document, data={**document.data, "bodies": many})
    if isinstance(document.data.get("sweep"), dict):
        with _told(document):
            space = space or _space(document.data, path.parent)
            # The first value of every swept key in its place, and its line.
            data = space.assign(document.data, [0] * len(space.axes))
            data["sweep"] = document.data["sweep"]
            lines = {column.key: document.line(column.where) for _, column in space.columns}
            document = replace(document, data=data, lines=document.lines | lines)
    case = validate(document)
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always", SinglePrecisionWarning)
        flow = _build_flow(case, document, path)
    remarks = dict.fromkeys(f"flow: {warning.message}" for warning in found)
    return LoadedCase(case, document, flow, path, space, tuple(remarks))


def _space(data: dict[str, Any], folder: Path) -> SweepSpace:
    """The axes of the sweep, checked key by key before the case as a whole."""
    with at("sweep"):
        section = Sweep.read(data["sweep"])
        known = {TABLE, "petsc", *(name for name, k in Case.declared.items() if k.reader.section)}
        for number, axis in enumerate(section.axes):
            for name in axis:
                if parse_key(name)[0] == "units":
                    wrong, instead = "are those of all trajectories", "sweep what follows from them"
                    raise Problem(wrong, instead, ("axes", number, name))
                if parse_key(name)[0] not in known:
                    right = meant(name, dict(keys()), "a key such as body.aspect_ratio")
                    raise Problem("unknown key", right, ("axes", number, name))
        alone = section.measure is not None or data.get("task") == "body"
        axes = [
            {name: _paths(data, name, value, folder) for name, value in axis.items()}
            for axis in section.axes
        ]
        return build_space(axes, folder, alone)


def _paths(data: dict[str, Any], name: str, value: Any, folder: Path) -> Any:
    """The values of an entry of an axis, where flow.trajectory: all are those of the series."""
    if parse_key(name) != TRAJECTORY or value != "all":
        return value
    from qbxstokes.flows.series import series_of_case

    try:
        count = len(series_of_case(data.get("flow") or {}, folder))
    except FlowError as error:
        where = ".".join(map(str, ("flow", *error.key)))
        raise Problem(
            f"{where}: {error}", "all takes every path of a linear flow's series"
        ) from None
    return {"linspace": [0, max(count - 1, 1)], "count": count}


def validate(document: Document) -> Case:
    """The case held in `document`; raises CaseError."""
    with _told(document):
        return Case.read(document.data)


@contextmanager
def _told(document: Document, note: str = "") -> Iterator[None]:
    """Raise CaseError for the first problem in the file's order.

    A misspelt key comes first: it is the cause of the key that is then missing.
    """
    try:
        yield
    except Problem as problem:
        faults = problem.faults
        first = min(faults, key=lambda f: (not f.unknown, document.line(f.key), len(f.key)))
        more, right = len({fault.key for fault in faults}) - 1, first.right
        if more:
            right += f" (and {more} more {'faults' if more > 1 else 'fault'} after it)"
        raise document.error(first.key, first.wrong + note, right) from None


def _build_flow(case: Case, document: Document, path: Path) -> Flow:
    """Build the flow from its section, with faults mapped back to the key."""
    from qbxstokes.flows import build_flow

    try:
        at_rest = {"type": "uniform", "velocity": [0.0, 0.0, 0.0]}
        return build_flow(at_rest if case.flow is None else case.flow.spec(), path.parent)
    except FlowError as error:
        raise document.error(("flow", *error.key), str(error)) from None
