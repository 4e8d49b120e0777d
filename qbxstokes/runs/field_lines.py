"""Lines that follow the flow of a field: streamlines at an instant, tracers about the bodies.

About one body in an unbounded fluid streamlines are those of the velocity relative to it; among
several, or by a wall, of the velocity in space, until they come to a surface.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from qbxstokes.bie.field import FlowAround
from qbxstokes.case.field import FieldSection
from qbxstokes.errors import ConvergenceError
from qbxstokes.geometry import rotation
from qbxstokes.motion.layout import ORIENTATION, POSITION
from qbxstokes.runs.field_targets import in_space
from qbxstokes.simulation.flow_around import AroundBody, Instant
from qbxstokes.typing import Array


def _starts(lines: Any, instant: Instant) -> Array:
    """Starting points (N, 3) of lines in space."""
    if lines.points is not None:
        points = np.array(lines.points, dtype=float)
    else:
        share = np.linspace(0.0, 1.0, lines.number)[:, None]
        points = (1.0 - share) * np.array(lines.start) + share * np.array(lines.stop)
    return in_space(points, lines.frame, instant.position, instant.rotation)


def streamlines(around: Any, section: FieldSection, instant: Instant) -> Array:
    """Streamlines (lines, samples, 3) in space at the instant, of a FlowAround or FlowAmong."""
    from qbxstokes.bie.lines import lines_in_space, streamlines

    asked = section.streamlines
    assert asked is not None
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


def steady_tracers(around: Any, section: FieldSection, instant: Instant) -> dict[str, Array]:
    """Paths about a body that stays in its state, in space as seen from its centre.

    Among bodies that are held, in space.
    """
    from qbxstokes.bie.lines import integrate_lines, outer_axes

    asked = section.tracers
    assert asked is not None
    assert asked.duration is not None
    times = np.linspace(0.0, asked.duration, asked.samples)
    if not isinstance(around, FlowAround):
        starts = _starts(asked, instant)
        none = np.zeros((0, 1))
        return _carried(lambda t, y: (none, around), none, starts, times, asked.tolerance, 0.0)[0]
    paths = integrate_lines(
        lambda _, x: around.relative_velocity(x),
        around.to_body(_starts(asked, instant)),
        outer_axes(around.disturbance.grid.shape),
        times,
        asked.tolerance,
        unit_speed=False,
    )
    points = paths @ around.rotation.T + around.position
    return {"time": times, "points": np.moveaxis(points, 1, 0)}


def tracers_among(
    solution: Any,
    section: FieldSection,
    equations: Any,
    initial: Array,
    end: float,
    tolerance_of_motion: float,
) -> dict[str, Array]:
    """Paths while the bodies move: all are integrated together from time 0 on.

    solution: `AmongBodies`; equations: of the motion; initial: its states (N, n_state).
    """
    asked = section.tracers
    assert asked is not None
    times = np.linspace(0.0, asked.duration or end, asked.samples)
    q = rotation.normalize(initial[:, ORIENTATION])
    start = (
        Instant(0.0, initial[:, POSITION], q) if len(q) > 1 else Instant(0.0, initial[0, :3], q[0])
    )
    starts = _starts(asked, start)
    tolerance = tolerance_of_motion / equations.sensitivity(0.0, initial, float(times[-1]))
    found, states = _carried(
        lambda t, y: solution.moving(equations, t, y),
        initial,
        starts,
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
    n = initial.size
    good = ~moving(0.0, initial)[1].inside(starts)

    def rate(t: float, flat: Array) -> Array:
        slope, around = moving(t, flat[:n].reshape(initial.shape))
        carried = around.carrying(flat[n:].reshape(-1, 3))
        return np.concatenate([slope.ravel(), carried.ravel()])

    y = _followed(rate, initial, starts[good], times, tolerance_of_bodies, tolerance)
    points = np.full((len(times), len(starts), 3), np.nan)
    points[:, good] = y[n:].T.reshape(len(times), -1, 3)
    return {"time": times, "points": points}, y[:n].T.reshape(len(times), *initial.shape)


def _followed(
    rate: Callable[[float, Array], Array],
    bodies: Array,
    tracers: Array,
    times: Array,
    tolerance_of_bodies: float,
    tolerance: float,
) -> Array:
    """Numbers (n, T) of bodies and of the tracers with them, as `rate` moves both from time 0 on.

    Raises ConvergenceError.
    """
    from scipy.integrate import solve_ivp

    allowed = np.full(bodies.size + tracers.size, tolerance)
    allowed[: bodies.size] = tolerance_of_bodies
    allowed = np.maximum(allowed, 1e-13)
    found = solve_ivp(
        rate,
        (0.0, times[-1]),
        np.concatenate([bodies.ravel(), tracers.ravel()]),
        method="DOP853",
        t_eval=times,
        rtol=allowed,
        atol=allowed,
    )
    if not found.success:
        raise ConvergenceError(f"the paths of the tracers stopped: {found.message}")
    return np.asarray(found.y)


def moving_tracers(
    solution: AroundBody,
    section: FieldSection,
    equations: Any,
    initial: Array,
    end: float,
    tolerance_of_motion: float,
) -> dict[str, Array]:
    """Paths while the body moves: both are integrated together from time 0 on.

    equations: of the motion; initial: its state (1, n_state).
    """
    from qbxstokes.bie.lines import (
        N_STATE,
        MovingFlow,
        carried_rate,
        outer_axes,
        to_points,
        to_state,
    )

    asked, axes = section.tracers, outer_axes(solution.shape)
    assert asked is not None
    flow = MovingFlow(solution.operators.grid, solution.flow, solution.flow.degree)
    body = np.asarray(initial, float).reshape(-1)
    n_body = body.size
    position, turn = body[:3], rotation.matrix(rotation.normalize(body[3:7]))
    starts = _starts(asked, Instant(0.0, position, rotation.normalize(body[3:7])))
    states = to_state((starts - position) @ turn, axes)
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
        moved = carried_rate(carried, relative, axes, unit_speed=False)
        return np.concatenate([out[:, 0], moved.ravel()])

    # The body moves as accurately as in the motion itself, so that a tracer near its surface is
    # outside there, too.
    sensitivity = equations.sensitivity(0.0, body[None], float(times[-1]))
    allowed = min(asked.tolerance, tolerance_of_motion) / sensitivity
    y = _followed(rate, body, states[good], times, allowed, asked.tolerance)
    points = np.full((len(times), len(states), 3), np.nan)
    carried = np.moveaxis(y[n_body:].reshape(-1, N_STATE, len(times)), 2, 0)
    quaternions = rotation.normalize(y[3:7].T)
    relative = np.einsum("tij,tnj->tni", rotation.matrix(quaternions), to_points(carried, axes))
    points[:, good] = relative + y[:3].T[:, None]
    position = y[:3].T.copy()
    return {"time": times, "points": points, "position": position, "orientation": quaternions}
