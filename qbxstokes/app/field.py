"""`task: field`, and the section `field` of a motion: the flow around the body, to a file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qbxstokes.app.clock import Clock
from qbxstokes.app.field_targets import (
    Targets,
    chosen_instants,
    surface_angles,
    targets_of,
)
from qbxstokes.app.plan import check_flow, result_path, start_quaternion
from qbxstokes.bie.field import (
    INSIDE,
    SOURCES,
    Disturbance,
    FlowAround,
    mobility_disturbance,
    resistance_disturbance,
    resolving_grid,
)
from qbxstokes.config.field import FieldSection
from qbxstokes.config.load import LoadedCase
from qbxstokes.errors import ConvergenceError
from qbxstokes.geometry import rotation
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.io import field as store
from qbxstokes.io.results import ResultWriter, check_writable, free_name

Array = NDArray[np.float64]

# Points a rank evaluates and sends at once: what is in memory besides the table.
BLOCK = 32_768
# Points of the check that needs no grid.
_FEW = 6


@dataclass(frozen=True)
class FieldPlan:
    """The work of a field: where the body is, which points, where the result goes."""

    position: Array
    quaternion: Array
    output: Path
    points: int
    needs: tuple[str, ...]
    skips: tuple[str, ...] = ()


@dataclass(frozen=True)
class Instant:
    """The body at one instant, in space; velocities None where the body is free."""

    time: float
    position: Array
    quaternion: Array
    velocity: Array | None = None
    angular_velocity: Array | None = None
    force: Array = field(default_factory=lambda: np.zeros(3))
    torque: Array = field(default_factory=lambda: np.zeros(3))


class Alone:
    """Stands for the communicator of a single rank."""

    rank, size = 0, 1


def plan_field(loaded: LoadedCase, overwrite: bool) -> FieldPlan:
    """Plan of `task: field`; raises CaseError for what the schema alone cannot see."""
    case = loaded.case
    assert case.field is not None  # the schema requires it for this task
    output = result_path(loaded)
    overwrite = overwrite or case.output.overwrite
    check_writable(output, overwrite)
    if not overwrite:
        output = free_name(output)
    position, quaternion = np.array(case.start.position), start_quaternion(case)
    check_flow(loaded, position, quaternion)
    targets = targets_of(loaded, case.field)
    points = sum(target.size for target in targets)
    needs = [f"integral equation of a body that is {case.field.body}"]
    if points:
        parts = ", ".join(f"{target.name} {target.size}" for target in targets)
        needs.append(f"fields at {points} points ({parts})")
    for name in ("surface", "streamlines"):
        if getattr(case.field, name) is not None:
            needs.append({"surface": "traction on the body"}.get(name, name))
    skips = []
    if "stress" not in case.field.quantities and case.field.surface is None:
        skips.append("stress: not asked for")
    if case.field.tracers is not None and case.task == "field":
        needs.append("paths of tracers around a body that stays in this state")
    return FieldPlan(position, quaternion, output, points, tuple(needs), tuple(skips))


def run_field(
    comm: Any,
    loaded: LoadedCase,
    plan: FieldPlan,
    clock: Clock,
    provenance: Mapping[str, Any],
    overwrite: bool,
) -> dict[str, Any]:
    """Compute the field on all ranks; rank 0 writes the file. Returns the summary."""
    case = loaded.case
    section = case.field
    assert section is not None
    given = section.body != "free"
    instant = Instant(
        0.0,
        plan.position,
        plan.quaternion,
        np.array(section.velocity) if given else None,
        np.array(section.angular_velocity) if given else None,
        np.array(section.force),
        np.array(section.torque),
    )
    evaluation = FieldEvaluation(loaded, section, clock)
    if comm.rank != 0:
        evaluation.write(comm, None, [instant])
        return {}
    replace = overwrite or case.output.overwrite
    with ResultWriter(plan.output, case.task, provenance, replace) as writer:
        facts = evaluation.write(comm, writer.file, [instant])
        around = evaluation.arounds[-1]
        disturbance = around.disturbance
        velocity = around.rotation @ disturbance.velocity
        spin = around.rotation @ disturbance.angular_velocity
        # On the body, hence opposite to those on the fluid; without negative zeros.
        force, torque = (
            0.0 - around.rotation @ vector for vector in (disturbance.force, disturbance.torque)
        )
        writer.append(
            {
                "time": np.zeros(1),
                "position": plan.position[None],
                "orientation": plan.quaternion[None],
                "axis": rotation.axis(plan.quaternion)[None],
                "velocity": velocity[None],
                "angular_velocity": spin[None],
                "force": force[None],
                "torque": torque[None],
            }
        )
        if section.tracers is not None:
            store.put_arrays(
                writer.file[store.GROUP], "tracers", evaluation.steady_tracers(around, instant), {}
            )
        errors = facts.pop("errors")
        summary: dict[str, Any] = {
            "case": str(loaded.path),
            "title": case.title,
            "task": case.task,
            **facts,
            "velocity": velocity,
            "angular_velocity": spin,
            "force": force,
            "torque": torque,
            "errors": errors,
            "largest_error": max(errors.values()),
            "wall_times": dict(clock.parts),
        }
        summary["files"] = export_field(loaded, clock, writer.file, plan.output)
        summary["result"] = str(writer.finish(summary))
    summary["files"] += draw_pictures(loaded, clock, Path(summary["result"]))
    summary["wall_times"] = {**clock.parts, "total": clock.total}
    return summary


def field_of_motion(
    loaded: LoadedCase,
    times: Array,
    samples: Mapping[str, Array],
    clock: Clock,
    file: Any,
    equations: Any,
    initial: Array,
) -> dict[str, Any]:
    """The field at the chosen instants of a motion, into its open result file.

    samples: what `app.motion.quantities` gives at the times (T,).
    """
    section = loaded.case.field
    assert section is not None
    instants = [
        Instant(
            float(times[index]),
            samples["position"][index],
            samples["orientation"][index],
            samples["velocity"][index],
            samples["angular_velocity"][index],
        )
        for index in chosen_instants(loaded, times)
    ]
    evaluation = FieldEvaluation(loaded, section, clock)
    facts = evaluation.write(Alone(), file, instants)
    if section.tracers is not None:
        paths = evaluation.moving_tracers(equations, initial, float(times[-1]))
        store.put_arrays(file[store.GROUP], "tracers", paths, {})
    return facts


def export_field(loaded: LoadedCase, clock: Clock, file: Any, output: Path) -> list[str]:
    """Write the file for ParaView, if asked for; the names of what was written."""
    section = loaded.case.field
    if section is None or not section.vtk:
        return []
    from qbxstokes.io.vtkhdf import export

    with clock.part("export"):
        return [str(export(file, output.with_suffix(".vtkhdf")))]


def draw_pictures(loaded: LoadedCase, clock: Clock, result: Path) -> list[str]:
    """Draw the pictures of a field, if asked for; the names of what was written."""
    section = loaded.case.field
    if section is None or not section.pictures:
        return []
    from qbxstokes.io.results import load
    from qbxstokes.plots.field import draw_field

    with clock.part("pictures"):
        return [str(name) for name in draw_field(load(result), result.with_suffix(""))]


class FieldEvaluation:
    """Operators formed once, and the flow around the body at any number of instants."""

    def __init__(self, loaded: LoadedCase, section: FieldSection, clock: Clock) -> None:
        self.loaded, self.section, self.clock = loaded, section, clock
        self.flow = loaded.flow
        self.spheroid = Spheroid(loaded.case.body.aspect_ratio)
        self.targets = targets_of(loaded, section)
        self.operators: Any = None
        self.solvers: dict[str, Any] = {}
        self.arounds: list[FlowAround] = []

    def around(self, instant: Instant) -> FlowAround:
        """The flow around the body at the instant."""
        turn = rotation.matrix(instant.quaternion)
        flow, time = self.flow, instant.time

        def background(points: Array) -> Array:
            space = points @ turn.T + instant.position
            return np.asarray(flow.velocity(space, time) @ turn)

        if self.operators is None:
            with self.clock.part("set-up"):
                self.operators = self._form(background)
        with self.clock.part("integral equation"):
            disturbance: Disturbance
            if instant.velocity is None or instant.angular_velocity is None:
                disturbance = mobility_disturbance(
                    self.operators,
                    background,
                    turn.T @ instant.force,
                    turn.T @ instant.torque,
                    self._solver,
                    flow.degree,
                )
            else:
                disturbance = resistance_disturbance(
                    self.operators,
                    background,
                    turn.T @ instant.velocity,
                    turn.T @ instant.angular_velocity,
                    self._solver,
                    flow.degree,
                )
        return FlowAround(disturbance, flow, instant.position, turn, time)

    def _form(self, background: Any) -> Any:
        """Operators on a grid that resolves the background flow, with the spread completion."""
        from dataclasses import replace

        from qbxstokes.app.body import explicit_scheme, side_of
        from qbxstokes.bie.accuracy import choose_scheme
        from qbxstokes.bie.operators import surface_operators

        section, degree = self.loaded.case.hydrodynamics, self.flow.degree
        scheme: Any = explicit_scheme(section)
        tolerance = min(section.tolerance, self.section.tolerance)
        if degree is not None:
            n_theta, n_phi = max(8, degree + 5), 2 * degree + 4
        else:
            n_theta, n_phi = resolving_grid(self.spheroid, background, 0.1 * tolerance)
        if scheme is None:
            scheme = choose_scheme(tolerance, n_theta, side=side_of(section))
        elif section.n_theta is None:
            scheme = replace(scheme, n_theta=max(scheme.n_theta, n_theta))
        return surface_operators(self.spheroid, scheme, section.n_phi or n_phi, "surface")

    def _solver(self, operator: Any, grid: Any) -> Any:
        from qbxstokes.app.body import solver_tolerance
        from qbxstokes.petsc.gmres import GmresSolver

        kind = "mobility" if operator is self.operators.mobility else "resistance"
        if kind not in self.solvers:
            section = self.loaded.case.hydrodynamics
            self.solvers[kind] = GmresSolver(
                operator, grid, solver_tolerance(section), section.preconditioner
            )
        return self.solvers[kind]

    def write(self, comm: Any, file: Any, instants: list[Instant]) -> dict[str, Any]:
        """Evaluate everything at the instants; rank 0 writes it to the open result file.

        Returns on rank 0 what the summary says: errors, points by source, iterations.
        """
        section = self.section
        names: list[str] = list(section.quantities)
        group = None
        if comm.rank == 0:
            times = np.array([instant.time for instant in instants])
            sets = {target.name: target.shape for target in self.targets}
            group = store.create(file, times, sets, names)
            for target in self.targets:
                store.put_arrays(group, target.name, target.parameters, {"frame": target.frame})
        counts = np.zeros(len(SOURCES) + 1, dtype=np.int64)
        errors = {"no slip": 0.0}
        surfaces, lines = [], []
        for index, instant in enumerate(instants):
            around = self.around(instant)
            with self.clock.part("table"):
                scale = around.disturbance.scale or 1.0
                error = around.disturbance.boundary_error / scale
            self._require(error)
            errors["no slip"] = max(errors["no slip"], error)
            with self.clock.part("field"):
                for target in self.targets:
                    for begin, block in self._blocks(comm, target, around, names):
                        counts += np.bincount(block["source"] + 1, minlength=len(counts))
                        store.put(group, target.name, index, begin, block)
            if comm.rank == 0:
                if section.surface is not None:
                    with self.clock.part("surface"):
                        angles = surface_angles(section.surface.shape)
                        surfaces.append(around.surface(*angles))
                if section.streamlines is not None:
                    with self.clock.part("streamlines"):
                        lines.append(self._streamlines(around, instant))
                if index == len(instants) - 1 and section.check:
                    with self.clock.part("check by QBX"):
                        errors["table against QBX"] = self._check(group, around)
            self.arounds = [around]
        if comm.rank == 0:
            self._put_whole(group, surfaces, lines)
        records = [record for solver in self.solvers.values() for record in solver.records]
        grid = self.operators.grid
        return {
            "errors": errors,
            "points": dict(zip(("inside", *SOURCES), counts.tolist(), strict=True)),
            "hydrodynamics": {
                "n_theta": grid.n_theta,
                "n_phi": grid.n_phi,
                "degree_of_table": self.arounds[-1].disturbance.table.harmonics.degree,
                "solves": len(records),
                "iterations": sum(record.iterations for record in records),
                "true_residual": max((record.true_residual for record in records), default=0.0),
            },
        }

    def _check(self, group: Any, around: FlowAround) -> float:
        """Largest relative difference between the table and QBX; over the plane, stored."""
        count = self.section.check
        largest = around.disturbance.check(min(count, _FEW))
        plane = next((target for target in self.targets if target.name == "plane"), None)
        if count <= _FEW or plane is None:
            return largest
        stride = max(1, int(np.ceil(np.sqrt(plane.size / count))))
        index = np.arange(plane.size).reshape(plane.shape)[::stride, ::stride].ravel()
        points = plane.in_space(0, plane.size, around.position, around.rotation)[index]
        body = around.to_body(points)
        table = around.disturbance.evaluate(body, 1e-13, "table", with_stress=False)[0]
        direct = around.disturbance.evaluate(body, 1e-13, "quadrature")[0]
        error = np.linalg.norm(table - direct, axis=-1) / (around.disturbance.scale or 1.0)
        arrays = {"index": index, "points": points, "error": error}
        store.put_arrays(group, "error", arrays, {})
        return max(largest, float(np.nanmax(error)))

    def _require(self, error: float) -> None:
        """Refuse a table that misses the tolerance where nothing else may replace it."""
        section = self.section
        if section.method == "table" and not error <= section.tolerance:
            raise ConvergenceError(
                f"the table of the flow misses the body's velocity by {error:.1e}, more than "
                f"field.tolerance {section.tolerance:g}; use method: auto, or more n_theta"
            )

    def _blocks(
        self, comm: Any, target: Targets, around: FlowAround, names: list[str]
    ) -> Iterator[tuple[int, dict[str, Any]]]:
        """Blocks of a set of points, evaluated by all ranks; rank 0 gets them all.

        Rank 0 hands out blocks, two ahead to each of the others so that none of them waits, and
        evaluates one itself whenever no result has arrived.
        """
        whole = list(store.blocks(target.size, min(BLOCK, -(-target.size // (4 * comm.size)))))

        def evaluate(number: int) -> tuple[int, dict[str, Any]]:
            begin, end = whole[number]
            points = target.in_space(begin, end, around.position, around.rotation)
            values = around.evaluate(
                points, self.section.tolerance, self.section.method, "stress" in names
            )
            source = values["source"]
            kept = {name: values[name] for name in names}
            kept |= {"points": points, "inside": source == INSIDE}
            return begin, {**kept, "source": source.astype(np.int8)}

        if comm.rank != 0:
            while (number := comm.recv(source=0)) is not None:
                comm.send(evaluate(number), dest=0)
            return
        left, ahead = iter(range(len(whole))), dict.fromkeys(range(1, comm.size), 0)
        for rank in [*ahead, *ahead]:
            number = next(left, None)
            if number is not None:
                comm.send(number, dest=rank)
                ahead[rank] += 1
        while True:
            arrived = [rank for rank, count in ahead.items() if count and comm.iprobe(source=rank)]
            for rank in arrived:
                part = comm.recv(source=rank)
                number = next(left, None)
                if number is None:
                    ahead[rank] -= 1
                else:
                    comm.send(number, dest=rank)
                yield part
            if not arrived:
                number = next(left, None)
                if number is not None:
                    yield evaluate(number)
                elif not any(ahead.values()):
                    break
        for rank in ahead:
            comm.send(None, dest=rank)

    def _starts(self, lines: Any, instant: Instant) -> Array:
        """Starting points (N, 3) of lines in space."""
        if lines.points is not None:
            points = np.array(lines.points, dtype=float)
        else:
            share = np.linspace(0.0, 1.0, lines.number)[:, None]
            points = (1.0 - share) * np.array(lines.start) + share * np.array(lines.stop)
        turn = rotation.matrix(instant.quaternion)
        return Targets(
            "lines", lines.frame, (len(points),), lambda begin, end: points[begin:end], {}
        ).in_space(0, len(points), instant.position, turn)

    def _streamlines(self, around: FlowAround, instant: Instant) -> Array:
        from qbxstokes.bie.lines import streamlines

        asked = self.section.streamlines
        assert asked is not None
        starts = self._starts(asked, instant)
        return streamlines(
            around, starts, asked.length, asked.samples, asked.tolerance, asked.both_ways
        )

    def _put_whole(self, group: Any, surfaces: list[dict[str, Array]], lines: list[Array]) -> None:
        """Write surfaces and streamlines, collected over the instants."""
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

    def steady_tracers(self, around: FlowAround, instant: Instant) -> dict[str, Array]:
        """Paths about a body that stays in its state, in space as seen from its centre."""
        from qbxstokes.bie.lines import integrate_lines

        asked = self.section.tracers
        assert asked is not None
        assert asked.duration is not None
        times = np.linspace(0.0, asked.duration, asked.samples)
        with self.clock.part("tracers"):
            paths = integrate_lines(
                lambda _, x: around.relative_velocity(x),
                around.to_body(self._starts(asked, instant)),
                self.spheroid.aspect_ratio,
                times,
                asked.tolerance,
                unit_speed=False,
            )
        points = paths @ around.rotation.T + around.position
        return {"time": times, "points": np.moveaxis(points, 1, 0)}

    def moving_tracers(self, equations: Any, initial: Array, end: float) -> dict[str, Array]:
        """Paths while the body moves: both are integrated together from time 0 on.

        equations: of the motion; initial: its state (1, n_state).
        """
        from scipy.integrate import solve_ivp

        from qbxstokes.bie.lines import N_STATE, MovingFlow, carried_rate, to_points, to_state

        asked, k = self.section.tracers, self.spheroid.aspect_ratio
        assert asked is not None
        flow = MovingFlow(self.operators.grid, self.flow, self.flow.degree)
        body = np.asarray(initial, float).reshape(-1)
        n_body = body.size
        position, turn = body[:3], rotation.matrix(rotation.normalize(body[3:7]))
        starts = self._starts(asked, Instant(0.0, position, rotation.normalize(body[3:7])))
        states = to_state((starts - position) @ turn, k)
        good = ~np.isnan(states[:, 0])
        times = np.linspace(0.0, asked.duration or end, asked.samples)

        def rate(t: float, flat: Array) -> Array:
            state = flat[:n_body]
            out = np.empty((n_body, 1))
            equations.rates(t, state[:, None], out)
            velocity, spin = equations.velocities(t, state[None])
            around = rotation.matrix(rotation.normalize(state[3:7]))

            def relative(x: Array) -> Array:
                return flow.relative_velocity(t, state[:3], around, velocity[0], spin[0], x)

            carried = flat[n_body:].reshape(-1, N_STATE)
            moved = carried_rate(carried, relative, k, unit_speed=False)
            return np.concatenate([out[:, 0], moved.ravel()])

        with self.clock.part("tracers"):
            solution = solve_ivp(
                rate,
                (0.0, times[-1]),
                np.concatenate([body, states[good].ravel()]),
                method="DOP853",
                t_eval=times,
                rtol=max(asked.tolerance, 1e-13),
                atol=asked.tolerance,
            )
        if not solution.success:
            raise ConvergenceError(f"the paths of the tracers stopped: {solution.message}")
        points = np.full((len(times), len(states), 3), np.nan)
        carried = np.moveaxis(solution.y[n_body:].reshape(-1, N_STATE, len(times)), 2, 0)
        turns = rotation.matrix(rotation.normalize(solution.y[3:7].T))
        relative = np.einsum("tij,tnj->tni", turns, to_points(carried, k))
        points[:, good] = relative + solution.y[:3].T[:, None]
        return {"time": times, "points": points, "position": solution.y[:3].T.copy()}
