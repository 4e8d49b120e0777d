"""Lines that follow the flow of a field: streamlines at an instant, tracers about the bodies.

About one body in an unbounded fluid streamlines are those of the velocity relative to it; among
several, or by a wall, of the velocity in space, until they come to a surface.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from qbxstokes.bie.field import FlowAround
from qbxstokes.case.field import Lines, Streamlines, Tracers
from qbxstokes.errors import ContactError, ConvergenceError, FlowError
from qbxstokes.geometry import rotation
from qbxstokes.motion.layout import ORIENTATION, POSITION
from qbxstokes.runs.field_targets import in_space
from qbxstokes.simulation.flow_around import AroundBody, Instant
from qbxstokes.typing import Array


def _starts(lines: Lines, instant: Instant) -> Array:
    """Starting points (N, 3) of lines in space."""
    if lines.points is not None:
        points = np.array(lines.points, dtype=float)
    else:
        share = np.linspace(0.0, 1.0, lines.number)[:, None]
        points = (1.0 - share) * np.array(lines.start) + share * np.array(lines.stop)
    return in_space(points, lines.frame, instant.position, instant.rotation)


def streamlines(around: Any, asked: Streamlines, instant: Instant) -> Array:
    """Streamlines (lines, samples, 3) in space at the instant, of a FlowAround or FlowAmong."""
    from qbxstokes.bie.lines import lines_in_space, streamlines

    starts = _starts(asked, instant)
    if isinstance(around, FlowAround):
        return streamlines(
            around, starts, asked.length, asked.samples, asked.tolerance, asked.both_ways
        )
    parameter = np.linspace(0.0, asked.length, asked.samples)

    def run(sign: float) -> Array:
        def velocity(x: Array) -> Array:
            return sign * around.carrying(x)

        return lines_in_space(velocity, around.inside, starts, parameter, asked.tolerance)

    if asked.both_ways:
        return np.concatenate([run(-1.0)[:, :0:-1], run(1.0)], axis=1)
    return run(1.0)


def steady_tracers(around: Any, asked: Tracers, instant: Instant) -> dict[str, Array]:
    """Paths about a body that stays in its state, in space as seen from its centre.

    Among bodies that are held, in space.
    """
    from qbxstokes.bie.lines import integrate_lines, outer_axes

    times, starts = np.linspace(0.0, asked.duration or 0.0, asked.samples), _starts(asked, instant)
    if not isinstance(around, FlowAround):
        none = np.zeros((0, 1))
        return _carried(lambda t, y: (none, around), none, starts, times, asked.tolerance, 0.0)[0]
    paths = integrate_lines(
        lambda _, x: around.relative_velocity(x),
        around.to_body(starts),
        outer_axes(around.disturbance.grid.shape),
        times,
        asked.tolerance,
        unit_speed=False,
    )
    points = paths @ around.rotation.T + around.position
    return {"time": times, "points": np.moveaxis(points, 1, 0)}


def tracers_among(
    solution: Any,
    asked: Tracers,
    equations: Any,
    initial: Array,
    end: float,
    tolerance_of_motion: float,
) -> dict[str, Array]:
    """Paths while the bodies move: all are integrated together from time 0 on.

    solution: `AmongBodies`; equations: of the motion; initial: its states (N, n_state).
    """
    times = np.linspace(0.0, asked.duration or end, asked.samples)
    q = rotation.normalize(initial[:, ORIENTATION])
    start = (
        Instant(0.0, initial[:, POSITION], q) if len(q) > 1 else Instant(0.0, initial[0, :3], q[0])
    )
    tolerance = tolerance_of_motion / equations.sensitivity(0.0, initial, float(times[-1]))
    found, states = _carried(
        lambda t, y: solution.moving(equations, t, y),
        initial,
        _starts(asked, start),
        times,
        asked.tolerance,
        min(asked.tolerance, tolerance),
    )
    position, turn = states[..., POSITION], rotation.normalize(states[..., ORIENTATION])
    return {**found, "position": position, "orientation": turn}


def _carried(
    moving: Callable[[float, Array], tuple[Array, Any]],
    initial: Array,
    starts: Array,
    times: Array,
    tolerance: float,
    tolerance_of_bodies: float,
) -> tuple[dict[str, Array], Array]:
    """Paths in space of tracers and of what carries them: moving(t, y) is dy/dt and the flow."""

    def rate(t: float, bodies: Array, tracers: Array) -> tuple[Array, Array]:
        slope, around = moving(t, bodies)
        return slope, around.carrying(tracers)

    good = ~moving(0.0, initial)[1].inside(starts)
    states, held = _followed(rate, initial, starts[good], times, tolerance_of_bodies, tolerance)
    points = np.full((len(times), len(starts), 3), np.nan)
    points[:, good] = held
    return {"time": times, "points": points}, states


def moving_tracers(
    solution: AroundBody,
    asked: Tracers,
    equations: Any,
    initial: Array,
    end: float,
    tolerance_of_motion: float,
) -> dict[str, Array]:
    """Paths while the body moves: both are integrated together from time 0 on.

    equations: of the motion; initial: its state (1, n_state).
    """
    from qbxstokes.bie.lines import MovingFlow, carried_rate, outer_axes, to_points, to_state

    axes, body = outer_axes(solution.shape), np.asarray(initial, float).reshape(-1)
    flow = MovingFlow(solution.operators.grid, solution.flow, solution.flow.degree)
    start = Instant(0.0, body[:3], rotation.normalize(body[3:7]))
    tracers = to_state((_starts(asked, start) - start.position) @ start.rotation, axes)
    good = ~np.isnan(tracers[:, 0])
    times = np.linspace(0.0, asked.duration or end, asked.samples)

    def rate(t: float, state: Array, carried: Array) -> tuple[Array, Array]:
        out = np.empty((len(body), 1))
        equations.rates(t, state[:, None], out)
        velocity, spin = equations.velocities(t, state[None])
        around = rotation.matrix(rotation.normalize(state[3:7]))

        def relative(x: Array) -> Array:
            return flow.relative_velocity(t, state[:3], around, velocity[0], spin[0], x)

        return out[:, 0], carried_rate(carried, relative, axes, unit_speed=False)

    # The body moves as accurately as in the motion itself, so that a tracer near its surface is
    # outside there, too.
    sensitivity = equations.sensitivity(0.0, body[None], float(times[-1]))
    allowed = min(asked.tolerance, tolerance_of_motion) / sensitivity
    states, held = _followed(rate, body, tracers[good], times, allowed, asked.tolerance)
    position, turn = states[:, :3].copy(), rotation.normalize(states[:, 3:7])
    points = np.full((len(times), len(tracers), 3), np.nan)
    relative = np.einsum("tij,tnj->tni", rotation.matrix(turn), to_points(held, axes))
    points[:, good] = relative + position[:, None]
    return {"time": times, "points": points, "position": position, "orientation": turn}


def _followed(
    rate: Callable[[float, Array, Array], tuple[Array, Array]],
    bodies: Array,
    tracers: Array,
    times: Array,
    tolerance_of_bodies: float,
    tolerance: float,
) -> tuple[Array, Array]:
    """States (T, ...) of bodies and of the tracers with them, as `rate` moves both from time 0 on.

    A step too long, inside which bodies touch or leave their flow, is taken again. Raises
    ConvergenceError.
    """
    from scipy.integrate import DOP853

    n, refusal = bodies.size, ""

    def flat_rate(t: float, y: Array) -> Array:
        nonlocal refusal
        try:
            if np.isfinite(y).all():
                parts = rate(t, y[:n].reshape(bodies.shape), y[n:].reshape(tracers.shape))
                return np.concatenate([part.ravel() for part in parts])
        except (ContactError, FlowError) as error:
            if t == 0.0:
                raise
            refusal = f"; {error}"
        return np.full(y.shape, np.nan)  # which no estimated error is below

    allowed = np.full(n + tracers.size, tolerance)
    allowed[:n] = tolerance_of_bodies
    last, allowed = float(times[-1]), np.maximum(allowed, 1e-13)

    def solver_from(t: float, y: Array, **settings: float) -> Any:
        return DOP853(flat_rate, t, y, last, rtol=allowed, atol=allowed, **settings)

    solver = solver_from(0.0, np.concatenate([bodies.ravel(), tracers.ravel()]))
    found = [solver.y]
    while len(found) < len(times):
        t, y = solver.t, solver.y
        message = solver.step()
        if solver.status == "failed":
            raise ConvergenceError(f"the paths of the tracers stopped: {message}{refusal}")
        asked = times[len(found) : np.searchsorted(times, solver.t, "right")]
        within = solver.dense_output()(asked).T if len(asked) else np.zeros(0)
        if np.isfinite(within).all():
            found += list(within)
        else:  # what interpolates goes further than the step
            solver = solver_from(t, y, first_step=0.5 * (solver.t - t))
    states, count = np.array(found), len(times)
    return states[:, :n].reshape(count, *bodies.shape), states[:, n:].reshape(count, *tracers.shape)
