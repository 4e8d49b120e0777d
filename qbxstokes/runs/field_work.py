"""The work of a field: what is to be evaluated at which instant, shared out to all ranks.

The work is cut into tasks: a piece of points of one set at one instant, the traction, the
streamlines, some points of the check. Every rank takes the next task as it becomes free; what is
finished is gathered (runs/sharing.py), made safe every half minute, and written by rank 0. Tasks
do not depend on the number of ranks, and neither does any number; a run that is resumed does those
that no part holds.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import astuple, dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from qbxstokes.bie.exterior import INSIDE, SOURCES
from qbxstokes.errors import ConvergenceError, QbxStokesError
from qbxstokes.io import field as store
from qbxstokes.io.store import Work, check_disk
from qbxstokes.io.writer import ResultWriter
from qbxstokes.runs.field_lines import streamlines
from qbxstokes.runs.field_targets import Targets, surface_angles, targets_of
from qbxstokes.runs.parallel import HandOut, agree, on_root
from qbxstokes.runs.sharing import Crew, Gathering, Item, notes, rows_by_all
from qbxstokes.simulation.flow_around import AroundBody, Instant
from qbxstokes.simulation.from_case import body_of
from qbxstokes.typing import Array, Integers

if TYPE_CHECKING:
    from qbxstokes.runs.command import Job


# Points of a piece: what a rank holds in memory besides the table. A set of few points is cut into
# so many pieces that some ranks find work.
PIECE, FEWEST_PIECES, SMALLEST_PIECE = 32_768, 16, 1024
# Points of the check that needs no grid, and those of one task.
FEW, CHECKED_AT_ONCE = 6, 2

# Parts of a field in a working folder, and bytes of them that a rank keeps in memory.
FIELD, MOST = "field", 256 * 2**20

Kind = Literal["check", "error map", "streamlines", "surface", "points"]
# Parts of the clock.
_PARTS: dict[Kind, str] = {
    "check": "check by QBX",
    "error map": "check by QBX",
    "streamlines": "streamlines",
    "surface": "surface",
    "points": "field",
}


@dataclass(frozen=True)
class Task:
    """Part of the work: of a kind, at an instant, of a set of points (by number), from-to."""

    kind: Kind
    instant: int
    target: int = 0
    begin: int = 0
    end: int = 0


@dataclass
class Found:
    """What a rank has to tell rank 0 besides arrays.

    slip: largest error on the surface, relative. difference: largest one between table and QBX.
    counts: points by source, first those inside. solves: iterations and true residual by instant.
    """

    slip: float = 0.0
    difference: float = 0.0
    counts: list[int] = field(default_factory=lambda: [0] * (len(SOURCES) + 1))
    solves: dict[str, tuple[int, float]] = field(default_factory=dict)

    def join(self, note: Mapping[str, Any]) -> None:
        """Add what another rank, or an earlier run, has told."""
        self.slip = max(self.slip, note["slip"])
        self.difference = max(self.difference, note["difference"])
        self.counts = [own + more for own, more in zip(self.counts, note["counts"], strict=True)]
        self.solves |= note["solves"]


class FieldWork:
    """Evaluates a field on all ranks of a communicator, for rank 0 to put into its file.

    comm: of those who share it. work: the working folder, held by rank 0. key: what tells this
    field from another one of the same run. solution: the flow around the body.
    """

    def __init__(
        self, job: Job, comm: Any, instants: list[Instant], work: Work, key: str = ""
    ) -> None:
        loaded = job.loaded
        section, interval = loaded.case.field, loaded.case.checkpoint.interval
        every = interval.number if interval.unit == "seconds" else 30.0
        self.comm, self.section, self.clock, self.instants = comm, section, job.clock, instants
        self._job, self._key = job, key
        self.solution: Any
        if loaded.case.coupled:
            from qbxstokes.simulation.flow_among import AmongBodies
            from qbxstokes.simulation.from_case import coupled_of

            given = {"tolerance": section.tolerance} if "tolerance" in section.given_keys else {}
            self.solution = AmongBodies(coupled_of(loaded), held=section.body == "held", **given)
        else:
            body = body_of(loaded)
            self.solution = AroundBody(body.shape, loaded.flow, body.settings, section.tolerance)
        several = () if loaded.case.bodies is None else loaded.case.bodies
        # Names of the surfaces in the file, in the order of the bodies.
        self.surfaces = [f"surface_{b + 1}" for b in range(len(several))] or ["surface"]
        self.surfaces += ["wall"] if loaded.case.wall is not None else []
        self.targets = targets_of(loaded, section)
        self.plane = next((t for t in self.targets if t.name == "plane"), None)
        self._gathering = Gathering(comm, work, FIELD, every=every, most=MOST)

    def write(self, writer: ResultWriter | None) -> dict[str, Any]:
        """Evaluate everything; writer: the open result file of rank 0, None on the others.

        Returns what the summary says: errors, points by source, iterations. An error is raised on
        all ranks.
        """
        with self.clock.part("set-up"):  # on a grid that resolves the flow at first
            self.solution.form(self.instants[0], partial(rows_by_all, self.comm))
        done = on_root(self.comm, self._finished)
        self._share_out(set(done))
        return self._gathering.concluded(lambda items: self._taken(writer, items))

    def around(self, instant: Instant) -> Any:
        """The `FlowAround` or `FlowAmong` of the instant; solved again only for another one."""
        with self.clock.part("integral equation"):
            return self.solution.at(instant)

    def _taken(self, writer: Any, items: Iterator[Item]) -> dict[str, Any]:
        """On rank 0: write what all ranks hold, and what only all of it can say; sum up."""
        whole, found, group = dict[tuple[str, int], Any](), Found(), self._lay_out(writer)
        with self.clock.part("output"):
            for arrays, note in items:
                if note["key"] != self._key:
                    continue
                found.join(note["found"])
                task = Task(*note["task"])
                if task.kind == "points":
                    name = self.targets[task.target].name
                    store.put_rows(group[name], task.instant, task.begin, arrays)
                elif arrays:
                    part: str = self.surfaces[task.target] if task.kind == "surface" else task.kind
                    whole[part, task.begin if task.kind == "error map" else task.instant] = arrays
        return self._conclude(group, whole, found)

    def _finished(self) -> list[int]:
        """Numbers of the tasks that parts of earlier runs hold; raises OutputError (disk)."""
        sizes = store.bytes_per_point(self.section.quantities)
        needed = 2.0 * sizes * sum(target.size for target in self.targets) * len(self.instants)
        right = "half of them while it runs; make room, or fewer points"
        check_disk(self._gathering.work.target, needed, "the field", right)
        kept = notes(self._gathering.work, FIELD)
        return [note["number"] for note in kept if note["key"] == self._key]

    def _lay_out(self, writer: ResultWriter) -> Any:
        """On rank 0: the group with room for all points."""
        times = np.array([instant.time for instant in self.instants])
        sets = {target.name: target.shape for target in self.targets}
        store.create(writer.file, times, sets, list(self.section.quantities))
        group = writer.file[store.GROUP]
        for target in self.targets:
            store.put_arrays(group, target.name, target.parameters, {"frame": target.frame})
        writer.claim()
        return group

    def tasks(self) -> list[Task]:
        """All tasks, at each instant the dear ones first."""
        tasks: list[Task] = []
        for index in range(len(self.instants)):
            if index == len(self.instants) - 1:
                counts: dict[Kind, int] = {"check": min(self.section.check, FEW)}
                if self.section.check > FEW and self.plane is not None:
                    counts["error map"] = len(self._mapped)
                for kind, count in counts.items():
                    cut = store.pieces(count, CHECKED_AT_ONCE)
                    tasks += [Task(kind, index, 0, *ends) for ends in cut]
            if self.section.streamlines is not None:
                tasks.append(Task("streamlines", index))
            if self.section.surface is not None:
                tasks += [Task("surface", index, number) for number in range(len(self.surfaces))]
            for number, target in enumerate(self.targets):
                share = max(SMALLEST_PIECE, -(-target.size // FEWEST_PIECES))
                cut = store.pieces(target.size, min(PIECE, share))
                tasks += [Task("points", index, number, *ends) for ends in cut]
        # Lines alone: the slip on the surface is wanted all the same.
        return tasks or [Task("check", len(self.instants) - 1)]

    @property
    def _mapped(self) -> Integers:
        """Numbers of the points of the plane at which table and QBX are compared."""
        assert self.plane is not None
        stride = np.sqrt(self.plane.size / self.section.check)
        # From edge to edge, so that the map fills the plane.
        first, second = (
            np.unique(np.linspace(0, n - 1, max(2, round(n / stride))).round().astype(np.int64))
            for n in self.plane.shape
        )
        return (first[:, None] * self.plane.shape[1] + second).ravel()

    # -- on every rank ------------------------------------------------------------------------

    def _share_out(self, done: set[int]) -> None:
        """Do tasks until none is left; an error of any rank ends the work of all."""
        tasks, failure = self.tasks(), None
        crew, told = Crew(self._job, self._gathering), set[int]()
        try:
            for number in crew.numbers(len(tasks)):
                if number in done:
                    continue
                found = Found()
                arrays = self._do(tasks[number], found, told)
                task = astuple(tasks[number])
                note = {"key": self._key, "number": number, "task": task, "found": vars(found)}
                self._gathering.add(arrays, note)
        except QbxStokesError as error:
            failure = error
            crew.counters.add(HandOut.NUMBERS, len(tasks))
        crew.end()
        agree(self.comm, failure)

    def _do(self, task: Task, found: Found, told: set[int]) -> dict[str, Array]:
        """The arrays of a task; told: instants whose solution this rank has told of."""
        around = self.around(self.instants[task.instant])
        if task.instant not in told:
            told.add(task.instant)
            with self.clock.part("table"):
                slip = around.slip
            if self.section.method == "table" and not slip <= self.section.tolerance:
                raise ConvergenceError(
                    f"the table of the flow misses the body's velocity by {slip:.1e}, more than "
                    f"field.tolerance {self.section.tolerance:g}; use method: auto, or more n_theta"
                )
            found.slip = slip
            found.solves[str(task.instant)] = self.solution.last_solve()
        with self.clock.part(_PARTS[task.kind]):
            if task.kind == "points":
                return self._evaluated(task, found)
            if task.kind == "surface":
                assert self.section.surface is not None
                angles = surface_angles(self.section.surface.shape)
                whose = () if isinstance(self.solution, AroundBody) else (task.target,)
                return dict(around.surface(*angles, *whose))
            if task.kind == "streamlines":
                assert self.section.streamlines is not None
                lines = streamlines(around, self.section.streamlines, self.instants[task.instant])
                return {"points": lines}
            if task.kind == "check":
                if task.begin < task.end:
                    points = around.check_points(min(self.section.check, FEW))
                    errors = around.differences(points[task.begin : task.end])
                    found.difference = float(errors.max())
                return {}
            assert self.plane is not None
            points = self._points(self.plane, 0, self.plane.size, task.instant)
            points = points[self._mapped[task.begin : task.end]]
            errors = around.differences(points)
            found.difference = float(np.nanmax(errors, initial=0.0))
            return {"points": points, "error": errors}

    def _points(self, target: Targets, begin: int, end: int, index: int) -> Array:
        instant = self.instants[index]
        return target.in_space(begin, end, instant.position, instant.rotation)

    def _evaluated(self, task: Task, found: Found) -> dict[str, Array]:
        """The quantities of a piece of points."""
        section, target = self.section, self.targets[task.target]
        points = self._points(target, task.begin, task.end, task.instant)
        values = self.around(self.instants[task.instant]).evaluate(
            points, section.quantities, section.tolerance, section.method
        )
        source = values["source"]
        found.counts = np.bincount(source + 1, minlength=len(found.counts)).tolist()
        kept: dict[str, Any] = {name: values[name] for name in section.quantities}
        return kept | {"points": points, "inside": source == INSIDE, "source": source}

    # -- on rank 0 ----------------------------------------------------------------------------

    def _conclude(
        self, group: Any, whole: Mapping[tuple[str, int], Any], found: Found
    ) -> dict[str, Any]:
        """Write what is there once an instant or less, and sum up."""

        def collected(name: str) -> list[Any]:
            return [whole[key] for key in sorted(key for key in whole if key[0] == name)]

        lines, errors = collected("streamlines"), collected("error map")
        if self.section.surface is not None:
            shape = self.section.surface.shape
            for name in self.surfaces:
                parts = collected(name)
                arrays = {
                    key: np.stack([part[key].reshape(shape[0] * shape[1], -1) for part in parts])
                    for key in parts[0]
                }
                arrays["pressure"] = arrays["pressure"][..., 0]
                store.put_arrays(group, name, arrays, {"shape": np.array(shape)})
        if lines:
            points = np.stack([part["points"] for part in lines])
            store.put_arrays(group, "streamlines", {"points": points}, {})
        if errors:
            arrays = {
                "index": self._mapped,
                **{n: np.concatenate([part[n] for part in errors]) for n in ("points", "error")},
            }
            store.put_arrays(group, "error", arrays, {})
        largest = {"no slip": found.slip}
        if self.section.check:
            largest[self.solution.check] = found.difference
        iterations, residuals = zip(*found.solves.values(), strict=True)
        return {
            "errors": largest,
            "points": dict(zip(("inside", *SOURCES), found.counts, strict=True)),
            "hydrodynamics": {
                **self.solution.facts(self.instants[-1]),
                "solves": len(found.solves),
                "iterations": sum(iterations),
                "true_residual": max(residuals),
            },
        }
