"""The work of a field: what is to be evaluated at which instant, shared out to all ranks.

The work is cut into tasks: a piece of points of one set at one instant, the traction, the
streamlines, some points of the check. Every rank takes the next task as it becomes free and writes
pieces of points straight into the file (io/places.py), so that none of them passes through another
rank; only what is small is sent to rank 0. Tasks do not depend on the number of ranks, and neither
does any number.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from qbxstokes.bie.field import INSIDE, SOURCES
from qbxstokes.errors import ConvergenceError, OutputError, QbxStokesError
from qbxstokes.io import field as store
from qbxstokes.io.writer import ResultWriter
from qbxstokes.runs import handout
from qbxstokes.runs.field_flow import FieldFlow
from qbxstokes.runs.field_targets import Targets, surface_angles
from qbxstokes.runs.handout import HandOut
from qbxstokes.runs.parallel import agree, on_root
from qbxstokes.simulation.around import Instant

Array = NDArray[np.float64]

# Points of a piece: what a rank holds in memory besides the table. A set of few points is cut into
# so many pieces that some ranks find work.
PIECE, FEWEST_PIECES, SMALLEST_PIECE = 32_768, 16, 1024
# Points of the check that needs no grid, and those of one task.
FEW, CHECKED_AT_ONCE = 6, 2

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
    """What a rank has to tell rank 0.

    slip: largest error on the surface, relative. difference: largest one between table and QBX.
    counts: points by source, first those inside. solves: iterations and true residual by instant.
    whole: arrays by kind and place in the whole. failure: what stopped the rank.
    """

    slip: float = 0.0
    difference: float = 0.0
    counts: NDArray[np.int64] = field(
        default_factory=lambda: np.zeros(len(SOURCES) + 1, dtype=np.int64)
    )
    solves: dict[int, tuple[int, float]] = field(default_factory=dict)
    whole: dict[tuple[Kind, int], Any] = field(default_factory=dict)
    failure: QbxStokesError | None = None


class FieldWork:
    """Evaluates a field on all ranks of a communicator and puts it into the file of rank 0."""

    def __init__(self, comm: Any, flow: FieldFlow, instants: list[Instant]) -> None:
        self.comm, self.flow, self.instants = comm, flow, instants
        self.section, self.clock = flow.section, flow.clock
        self.plane = next((t for t in flow.targets if t.name == "plane"), None)

    def write(self, writer: ResultWriter | None) -> dict[str, Any]:
        """Evaluate everything; writer: the open result file of rank 0, None on the others.

        Returns on rank 0 what the summary says: errors, points by source, iterations. An error is
        raised on all ranks.
        """
        self.flow.form(self.instants[0])
        found = self._share_out(*on_root(self.comm, lambda: self._lay_out(writer)))
        everything = [found] if self.comm.size == 1 else self.comm.gather(found)
        if writer is None:
            return {}
        return self._conclude(writer.file[store.GROUP], everything)

    def _lay_out(self, writer: ResultWriter | None) -> tuple[Path, Path, dict[str, int]]:
        """On rank 0: the group with room for all points; the result, its file, and places in it."""
        assert writer is not None
        times = np.array([instant.time for instant in self.instants])
        sets = {target.name: target.shape for target in self.flow.targets}
        places = store.create(writer.file, times, sets, list(self.section.quantities))
        group = writer.file[store.GROUP]
        for target in self.flow.targets:
            store.put_arrays(group, target.name, target.parameters, {"frame": target.frame})
        writer.claim()
        return writer.path, writer.temporary.resolve(), places

    def tasks(self) -> list[Task]:
        """All tasks, at each instant the dear ones first."""
        tasks: list[Task] = []
        for index in range(len(self.instants)):
            if index == len(self.instants) - 1:
                tasks += self._checks(index)
            if self.section.streamlines is not None:
                tasks.append(Task("streamlines", index))
            if self.section.surface is not None:
                tasks.append(Task("surface", index))
            for number, target in enumerate(self.flow.targets):
                share = max(SMALLEST_PIECE, -(-target.size // FEWEST_PIECES))
                tasks += [
                    Task("points", index, number, begin, end)
                    for begin, end in store.pieces(target.size, min(PIECE, share))
                ]
        # Lines alone: the slip on the surface is wanted all the same.
        return tasks or [Task("check", len(self.instants) - 1)]

    def _checks(self, index: int) -> list[Task]:
        def cut(kind: Kind, size: int) -> list[Task]:
            pieces = store.pieces(size, CHECKED_AT_ONCE)
            return [Task(kind, index, 0, begin, end) for begin, end in pieces]

        tasks = cut("check", min(self.section.check, FEW))
        if self.section.check > FEW and self.plane is not None:
            tasks += cut("error map", len(self._mapped))
        return tasks

    @property
    def _mapped(self) -> NDArray[np.int64]:
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

    def _share_out(self, result: Path, path: Path, places: Mapping[str, int]) -> Found:
        """Do tasks until none is left; an error of any rank ends the work of all."""
        found, tasks = Found(), self.tasks()
        counters = HandOut(self.comm)
        try:
            sizes = {target.name: target.size for target in self.flow.targets}
            rows = store.FieldRows(path, places, sizes)
            while (number := counters.next(handout.BLOCKS)) < len(tasks):
                self._do(tasks[number], rows, found)
            rows.close()
        except QbxStokesError as error:
            found.failure = error
        except OSError as error:
            reason = error.strerror or str(error)
            found.failure = OutputError(f"{result}: cannot be written ({reason})")
        if found.failure is not None:
            counters.add(handout.BLOCKS, len(tasks))
        with self.clock.part("waiting"):
            counters.wait()
        counters.close()
        agree(self.comm, found.failure)
        return found

    def _do(self, task: Task, rows: store.FieldRows, found: Found) -> None:
        around = self.flow.around(self.instants[task.instant])
        disturbance = around.disturbance
        if task.instant not in found.solves:
            with self.clock.part("table"):
                slip = disturbance.boundary_error / (disturbance.scale or 1.0)
            self._require(slip)
            found.slip = max(found.slip, slip)
            found.solves[task.instant] = self.flow.last_solve()
        with self.clock.part(_PARTS[task.kind]):
            if task.kind == "points":
                self._put_points(task, rows, found)
            elif task.kind == "surface":
                assert self.section.surface is not None
                angles = surface_angles(self.section.surface.shape)
                found.whole["surface", task.instant] = around.surface(*angles)
            elif task.kind == "streamlines":
                lines = self.flow.streamlines(self.instants[task.instant])
                found.whole["streamlines", task.instant] = lines
            elif task.kind == "check":
                if task.begin < task.end:
                    points = disturbance.check_points(min(self.section.check, FEW))
                    errors = disturbance.differences(points[task.begin : task.end])
                    found.difference = max(found.difference, float(errors.max()))
            else:
                assert self.plane is not None
                points = self._points(self.plane, 0, self.plane.size, task.instant)
                points = points[self._mapped[task.begin : task.end]]
                errors = disturbance.differences(around.to_body(points))
                found.whole["error map", task.begin] = points, errors
                found.difference = max(found.difference, float(np.nanmax(errors, initial=0.0)))

    def _points(self, target: Targets, begin: int, end: int, index: int) -> Array:
        instant = self.instants[index]
        return target.in_space(begin, end, instant.position, instant.rotation)

    def _put_points(self, task: Task, rows: store.FieldRows, found: Found) -> None:
        """Evaluate a piece of points and write it."""
        section, target = self.section, self.flow.targets[task.target]
        points = self._points(target, task.begin, task.end, task.instant)
        with_stress = "stress" in section.quantities
        values = self.flow.around(self.instants[task.instant]).evaluate(
            points, section.tolerance, section.method, with_stress
        )
        source = values["source"]
        found.counts += np.bincount(source + 1, minlength=len(found.counts))
        kept: dict[str, Any] = {name: values[name] for name in section.quantities}
        kept |= {"points": points, "inside": source == INSIDE, "source": source}
        rows.put(target.name, task.instant, task.begin, kept)

    def _require(self, error: float) -> None:
        """Refuse a table that misses the tolerance where nothing else may replace it."""
        section = self.section
        if section.method == "table" and not error <= section.tolerance:
            raise ConvergenceError(
                f"the table of the flow misses the body's velocity by {error:.1e}, more than "
                f"field.tolerance {section.tolerance:g}; use method: auto, or more n_theta"
            )

    # -- on rank 0 ----------------------------------------------------------------------------

    def _conclude(self, group: Any, everything: list[Found]) -> dict[str, Any]:
        """Write what was sent, and sum up."""
        whole: dict[tuple[Kind, int], Any] = {}
        solves: dict[int, tuple[int, float]] = {}
        for found in everything:
            whole |= found.whole
            solves |= found.solves

        def collected(kind: Kind) -> list[Any]:
            return [whole[key] for key in sorted(key for key in whole if key[0] == kind)]

        surfaces, lines = collected("surface"), collected("streamlines")
        errors = collected("error map")
        if surfaces:
            assert self.section.surface is not None
            shape = self.section.surface.shape
            arrays = {
                name: np.stack([part[name].reshape(shape[0] * shape[1], -1) for part in surfaces])
                for name in surfaces[0]
            }
            arrays["pressure"] = arrays["pressure"][..., 0]
            store.put_arrays(group, "surface", arrays, {"shape": np.array(shape)})
        if lines:
            store.put_arrays(group, "streamlines", {"points": np.stack(lines)}, {})
        if errors:
            points, differences = (np.concatenate(part) for part in zip(*errors, strict=True))
            arrays = {"index": self._mapped, "points": points, "error": differences}
            store.put_arrays(group, "error", arrays, {})
        counts = sum(found.counts for found in everything)
        largest = {"no slip": max(found.slip for found in everything)}
        if self.section.check:
            largest["table against QBX"] = max(found.difference for found in everything)
        iterations, residuals = zip(*solves.values(), strict=True)
        grid = self.flow.solution.operators.grid
        last = self.flow.around(self.instants[-1]).disturbance
        return {
            "errors": largest,
            "points": dict(zip(("inside", *SOURCES), np.asarray(counts).tolist(), strict=True)),
            "hydrodynamics": {
                "n_theta": grid.n_theta,
                "n_phi": grid.n_phi,
                "degree_of_table": last.table.harmonics.degree,
                "solves": len(solves),
                "iterations": sum(iterations),
                "true_residual": max(residuals),
            },
        }
