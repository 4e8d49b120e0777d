"""The flow around the body at the instants of a field: operators, solutions, lines."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qbxstokes.bie.field import FlowAround
from qbxstokes.case.load import LoadedCase
from qbxstokes.errors import ConvergenceError
from qbxstokes.geometry import rotation
from qbxstokes.runs.field_targets import in_space, targets_of
from qbxstokes.runs.progress import Clock
from qbxstokes.runs.rows import rows_by_all
from qbxstokes.simulation.around import AroundBody, Instant
from qbxstokes.simulation.from_case import body_of

Array = NDArray[np.float64]


class FieldFlow:
    """The flow around the body of a case, formed by all ranks, and the lines that follow it."""

    def __init__(self, comm: Any, loaded: LoadedCase, clock: Clock) -> None:
        section, body = loaded.case.field, body_of(loaded)
        assert section is not None
        self.comm, self.loaded, self.section, self.clock = comm, loaded, section, clock
        self.flow, self.spheroid = loaded.flow, body.shape
        self.targets = targets_of(loaded, section)
        self.solution = AroundBody(body.shape, loaded.flow, body.settings, section.tolerance)

    def form(self, first: Instant) -> None:
        """Form the operators by all ranks, on a grid that resolves the flow at first."""
        with self.clock.part("set-up"):
            self.solution.form(first, partial(rows_by_all, self.comm))

    def around(self, instant: Instant) -> FlowAround:
        """The flow around the body at the instant; solved again only for another one."""
        with self.clock.part("integral equation"):
            return self.solution.at(instant)

    def last_solve(self) -> tuple[int, float]:
        """Iterations and true residual of the latest solution."""
        return self.solution.last_solve()

    def _starts(self, lines: Any, instant: Instant) -> Array:
        """Starting points (N, 3) of lines in space."""
        if lines.points is not None:
            points = np.array(lines.points, dtype=float)
        else:
            share = np.linspace(0.0, 1.0, lines.number)[:, None]
            points = (1.0 - share) * np.array(lines.start) + share * np.array(lines.stop)
        return in_space(points, lines.frame, instant.position, instant.rotation)

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
        flow = MovingFlow(self.solution.operators.grid, self.flow, self.flow.degree)
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
