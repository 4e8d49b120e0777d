"""The flow around the body at the instants of a field: operators, solutions, lines."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qbxstokes.bie.field import (
    Disturbance,
    FlowAround,
    mobility_disturbance,
    resistance_disturbance,
    resolving_grid,
)
from qbxstokes.case.field import FieldSection
from qbxstokes.case.load import LoadedCase
from qbxstokes.errors import ConvergenceError
from qbxstokes.geometry import rotation
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.runs.clock import Clock
from qbxstokes.runs.field_targets import Targets, targets_of
from qbxstokes.runs.rows import rows_by_all

Array = NDArray[np.float64]


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

    @property
    def rotation(self) -> Array:
        """Matrix (3, 3) from body to space."""
        return rotation.matrix(self.quaternion)


class FieldFlow:
    """Operators formed once, and the flow around the body at any number of instants."""

    def __init__(self, comm: Any, loaded: LoadedCase, section: FieldSection, clock: Clock) -> None:
        self.comm, self.loaded, self.section, self.clock = comm, loaded, section, clock
        self.flow = loaded.flow
        self.spheroid = Spheroid(loaded.case.body.aspect_ratio)
        self.targets = targets_of(loaded, section)
        self.operators: Any = None
        self.solvers: dict[str, Any] = {}
        self._latest: tuple[Instant, FlowAround] | None = None

    def form(self, first: Instant) -> None:
        """Form the operators on a grid that resolves the flow at the first instant, by all ranks.

        Their completion is the spread one.
        """
        from dataclasses import replace

        from qbxstokes.bie.accuracy import choose_scheme
        from qbxstokes.bie.operators import surface_operators
        from qbxstokes.qbx.operator import independent_rows
        from qbxstokes.simulation.hydrodynamics import explicit_scheme, side_of

        section, degree = self.loaded.case.hydrodynamics, self.flow.degree
        scheme: Any = explicit_scheme(section)
        tolerance = min(section.tolerance, self.section.tolerance)
        with self.clock.part("set-up"):
            if degree is not None:
                n_theta, n_phi = max(8, degree + 5), 2 * degree + 4
            else:
                background = self._background(first)
                n_theta, n_phi = resolving_grid(self.spheroid, background, 0.1 * tolerance)
            if scheme is None:
                scheme = choose_scheme(tolerance, n_theta, side=side_of(section))
            elif section.n_theta is None:
                scheme = replace(scheme, n_theta=max(scheme.n_theta, n_theta))
            n_phi = section.n_phi or n_phi
            wanted = independent_rows(scheme.n_theta)
            rows = rows_by_all(self.comm, self.spheroid, scheme, n_phi // 2 + 1, wanted, True)
            self.operators = surface_operators(self.spheroid, scheme, n_phi, "surface", rows)

    def _background(self, instant: Instant) -> Any:
        """Velocity of the background flow at points of the body frame, in the body frame."""
        turn, flow = instant.rotation, self.flow

        def background(points: Array) -> Array:
            space = points @ turn.T + instant.position
            return np.asarray(flow.velocity(space, instant.time) @ turn)

        return background

    def around(self, instant: Instant) -> FlowAround:
        """The flow around the body at the instant; solved again only for another one."""
        if self._latest is not None and self._latest[0] is instant:
            return self._latest[1]
        turn, flow = instant.rotation, self.flow
        with self.clock.part("integral equation"):
            disturbance: Disturbance
            if instant.velocity is None or instant.angular_velocity is None:
                disturbance = mobility_disturbance(
                    self.operators,
                    self._background(instant),
                    turn.T @ instant.force,
                    turn.T @ instant.torque,
                    self._solver,
                    flow.degree,
                )
            else:
                disturbance = resistance_disturbance(
                    self.operators,
                    self._background(instant),
                    turn.T @ instant.velocity,
                    turn.T @ instant.angular_velocity,
                    self._solver,
                    flow.degree,
                )
        around = FlowAround(disturbance, flow, instant.position, turn, instant.time)
        self._latest = instant, around
        return around

    def _solver(self, operator: Any, grid: Any) -> Any:
        from qbxstokes.petsc.gmres import GmresSolver
        from qbxstokes.simulation.hydrodynamics import solver_tolerance

        kind = "mobility" if operator is self.operators.mobility else "resistance"
        if kind not in self.solvers:
            section = self.loaded.case.hydrodynamics
            self.solvers[kind] = GmresSolver(
                operator, grid, solver_tolerance(section), section.preconditioner
            )
        return self.solvers[kind]

    def last_solve(self) -> tuple[int, float]:
        """Iterations and true residual of the latest solution."""
        (solver,) = self.solvers.values()
        record = solver.records[-1]
        return record.iterations, record.true_residual

    def _starts(self, lines: Any, instant: Instant) -> Array:
        """Starting points (N, 3) of lines in space."""
        if lines.points is not None:
            points = np.array(lines.points, dtype=float)
        else:
            share = np.linspace(0.0, 1.0, lines.number)[:, None]
            points = (1.0 - share) * np.array(lines.start) + share * np.array(lines.stop)
        return Targets(
            "lines", lines.frame, (len(points),), lambda begin, end: points[begin:end], {}
        ).in_space(0, len(points), instant.position, instant.rotation)

    def streamlines(self, instant: Instant) -> Array:
        """Streamlines (lines, samples, 3) in space at the instant."""
        from qbxstokes.bie.lines import streamlines

        asked = self.section.streamlines
        assert asked is not None
        starts = self._starts(asked, instant)
        return streamlines(
            self.around(instant),
            starts,
            asked.length,
            asked.samples,
            asked.tolerance,
            asked.both_ways,
        )

    def steady_tracers(self, instant: Instant) -> dict[str, Array]:
        """Paths about a body that stays in its state, in space as seen from its centre."""
        from qbxstokes.bie.lines import integrate_lines

        asked, around = self.section.tracers, self.around(instant)
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

        # The body moves as accurately as in the motion itself, so that a tracer near its surface is
        # outside there, too.
        assert self.loaded.case.time is not None
        sensitivity = equations.sensitivity(0.0, body[None], float(times[-1]))
        tolerance = np.full(n_body + N_STATE * int(good.sum()), asked.tolerance)
        tolerance[:n_body] = min(asked.tolerance, self.loaded.case.time.tolerance) / sensitivity
        tolerance = np.maximum(tolerance, 1e-13)
        with self.clock.part("tracers"):
            solution = solve_ivp(
                rate,
                (0.0, times[-1]),
                np.concatenate([body, states[good].ravel()]),
                method="DOP853",
                t_eval=times,
                rtol=tolerance,
                atol=tolerance,
            )
        if not solution.success:
            raise ConvergenceError(f"the paths of the tracers stopped: {solution.message}")
        points = np.full((len(times), len(states), 3), np.nan)
        carried = np.moveaxis(solution.y[n_body:].reshape(-1, N_STATE, len(times)), 2, 0)
        quaternions = rotation.normalize(solution.y[3:7].T)
        relative = np.einsum("tij,tnj->tni", rotation.matrix(quaternions), to_points(carried, k))
        points[:, good] = relative + solution.y[:3].T[:, None]
        position = solution.y[:3].T.copy()
        return {"time": times, "points": points, "position": position, "orientation": quaternions}
