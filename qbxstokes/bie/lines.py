"""Lines along the flow: relative to a body, whose surface they never cross, or in space.

Points outside an ellipsoid of semi-axes a are written as x_i = sqrt(1 + L) a_i y_i with |y| = 1 and
L > 0; the state is (log L, y). The relative velocity vanishes on the surface with its normal
gradient, so that log L changes at a bounded rate there, and no step of an integrator, however
large, leaves the outside.
"""

from collections.abc import Callable

import numpy as np

from qbxstokes.bie.exterior import ExteriorField
from qbxstokes.bie.field import FlowAround
from qbxstokes.errors import CaseError
from qbxstokes.flows.base import Flow
from qbxstokes.geometry.grid import SurfaceGrid
from qbxstokes.geometry.shape import Shape
from qbxstokes.typing import Array, Booleans

Velocity = Callable[[float, Array], Array]

Axes = tuple[float, float, float]

N_STATE = 4
_FLOOR = float(np.log(1e-5))


def outer_axes(shape: Shape) -> Axes:
    """Semi-axes of the coordinates outside a body. Raises CaseError for one that has none."""
    if shape.semi_axes is None:
        raise CaseError(f"lines are followed around ellipsoids alone, not around a {shape}")
    return shape.semi_axes


def to_state(points: Array, axes: Axes) -> Array:
    """State (N, 4) of points (N, 3) of the body frame; NaN for points in or on the body."""
    scaled = points / axes
    radius = np.linalg.norm(scaled, axis=-1, keepdims=True)
    level = (radius - 1.0) * (radius + 1.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        state = np.concatenate([np.log(level), scaled / radius], axis=-1)
    state[~(level[:, 0] > 0.0)] = np.nan
    return np.asarray(state)


def to_points(state: Array, axes: Axes) -> Array:
    """Points (..., 3) of the body frame of states (..., 4)."""
    unit = state[..., 1:] / np.linalg.norm(state[..., 1:], axis=-1, keepdims=True)
    radius = np.sqrt(1.0 + np.exp(state[..., :1]))
    return np.asarray(radius * unit * axes)


def state_rate(state: Array, velocity: Array, axes: Axes) -> Array:
    """Rate of change (N, 4) of states (N, 4) carried by velocities (N, 3)."""
    unit = state[:, 1:] / np.linalg.norm(state[:, 1:], axis=-1, keepdims=True)
    level = np.exp(state[:, :1])
    radius = np.sqrt(1.0 + level)
    scaled = velocity / axes
    along = np.einsum("ni,ni->n", unit, scaled)[:, None]
    return np.concatenate([2.0 * radius * along / level, (scaled - along * unit) / radius], axis=-1)


def carried_rate(
    state: Array, velocity: Callable[[Array], Array], axes: Axes, unit_speed: bool
) -> Array:
    """Rate (N, 4) of states (N, 4) in a relative velocity, or in its direction (`unit_speed`).

    Closer to the surface than the level of `_FLOOR`, where the normal velocity, which falls as the
    square of the distance, drowns in rounding, the rates are those at that level: with the distance
    the tangential velocity falls linearly, so that log L and y change in proportion to it.
    """
    level = state[:, :1]
    raised = np.concatenate([np.maximum(level, _FLOOR), state[:, 1:]], axis=-1)
    u = velocity(to_points(raised, axes))
    if unit_speed:
        speed = np.linalg.norm(u, axis=-1, keepdims=True)
        return state_rate(raised, u / np.where(speed > 0.0, speed, 1.0), axes)
    slower = np.exp(np.minimum(level - _FLOOR, 0.0))
    return np.asarray(state_rate(raised, u, axes) * slower)


def integrate_lines(
    velocity: Velocity,
    points: Array,
    axes: Axes,
    parameter: Array,
    tolerance: float,
    unit_speed: bool,
) -> Array:
    """Lines (N, P, 3) in the body frame from points (N, 3), at the parameters (P,) from 0 on.

    velocity(t, points) is relative to the body. unit_speed: the parameter is arc length, else
    time. All lines share the steps of an explicit method of order 8 (Hairer, Norsett & Wanner
    1993, DOP853) with the given relative and absolute tolerance. Lines from inside are NaN.
    """
    from scipy.integrate import solve_ivp

    start = to_state(np.asarray(points, float), axes)
    good = ~np.isnan(start[:, 0])
    lines = np.full((len(start), len(parameter), 3), np.nan)
    if not good.any():
        return lines

    def rate(t: float, flat: Array) -> Array:
        state = flat.reshape(-1, N_STATE)
        return carried_rate(state, lambda x: velocity(t, x), axes, unit_speed=unit_speed).ravel()

    solution = solve_ivp(
        rate,
        (float(parameter[0]), float(parameter[-1])),
        start[good].ravel(),
        method="DOP853",
        t_eval=parameter,
        rtol=max(tolerance, 1e-13),
        atol=tolerance,
    )
    states = np.moveaxis(solution.y.reshape(int(good.sum()), N_STATE, -1), 2, 1)
    lines[good, : states.shape[1]] = to_points(states, axes)
    return lines


def streamlines(
    around: FlowAround, points: Array, length: float, samples: int, tolerance: float, both: bool
) -> Array:
    """Streamlines (N, P, 3) in space of the velocity relative to the body, at one instant.

    points: (N, 3) in space. length: of each line, and upstream as much if both is set; then P is
    2 samples - 1.
    """
    axes = outer_axes(around.disturbance.grid.shape)
    body = around.to_body(points)
    parameter = np.linspace(0.0, length, samples)

    def run(sign: float) -> Array:
        return integrate_lines(
            lambda _, x: sign * around.relative_velocity(x), body, axes, parameter, tolerance, True
        )

    lines = run(1.0)
    if both:
        lines = np.concatenate([run(-1.0)[:, :0:-1], lines], axis=1)
    return np.asarray(lines @ around.rotation.T + around.position)


def lines_in_space(
    velocity: Callable[[Array], Array],
    inside: Callable[[Array], Booleans],
    points: Array,
    parameter: Array,
    tolerance: float,
) -> Array:
    """Lines (N, P, 3) along a velocity of space, by arc length, until they are inside a body.

    velocity: of points (N, 3), with the motion of the bodies inside them. Steps as in
    `integrate_lines`; NaN once a line has come inside, where it began or where it can go no
    further.
    """
    from scipy.integrate import DOP853

    free = ~inside(points)
    lines = np.full((len(points), len(parameter), 3), np.nan)
    lines[free, 0] = points[free]

    def rate(_: float, flat: Array) -> Array:
        u = np.zeros((len(points), 3))
        u[free] = velocity(flat.reshape(-1, 3)[free])
        speed = np.linalg.norm(u, axis=-1, keepdims=True)
        return np.ravel(u / np.where(speed > 0.0, speed, 1.0))

    first, last, at = float(parameter[0]), float(parameter[-1]), 1
    solver = DOP853(rate, first, np.ravel(points), last, rtol=max(tolerance, 1e-13), atol=tolerance)
    while solver.status == "running" and free.any():
        solver.step()
        if solver.status == "failed":
            break
        within, ended = solver.dense_output(), free.copy()
        while at < len(parameter) and parameter[at] <= solver.t:
            x = within(parameter[at]).reshape(-1, 3)
            free &= ~inside(x)
            lines[free, at] = x[free]
            at += 1
        free &= ~inside(solver.y.reshape(-1, 3))
        if (free != ended).any():  # these stay where they are from now on
            solver.f = rate(solver.t, solver.y)
    return lines


class MovingFlow:
    """Velocity relative to a body in any state of motion, from the velocity on its surface.

    What the integral equation says of the disturbance on the surface is that it equals the rigid
    motion minus the background; its table follows from that by one product per azimuthal mode.
    """

    def __init__(self, grid: SurfaceGrid, flow: Flow, degree: int | None) -> None:
        self.grid, self.flow, self.degree = grid, flow, degree

    def relative_velocity(
        self, t: float, position: Array, rotation: Array, velocity: Array, spin: Array, x: Array
    ) -> Array:
        """Relative velocity (N, 3) in the body frame at its points x (N, 3).

        position, velocity and angular velocity spin (3,) of the body in space, rotation (3, 3).
        """
        u, w = velocity @ rotation, spin @ rotation

        def slip(points: Array) -> Array:
            space = points @ rotation.T + position
            return np.asarray(u + np.cross(w, points) - self.flow.velocity(space, t) @ rotation)

        own = ExteriorField(self.grid, slip(self.grid.points), self.degree)
        return np.asarray(own.evaluate(x, tolerance=0.0, method="table")["velocity"] - slip(x))
