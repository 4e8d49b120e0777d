"""Free motion by the grid functional in a flow whose velocity is compiled, all in one loop.

Imported where such a flow is there: numba comes with it, and compiles once for each flow.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import Any

import numba
import numpy as np

from qbxstokes.bie.providers import MonitoredGridMotion
from qbxstokes.typing import Array

Function = Callable[[float, Array, Array], None]

inner = numba.njit(error_model="numpy", fastmath={"contract"})
_STEP = 1e-5  # of differences, in lengths of the body and parts of a quaternion


@inner
def on_grid(
    point: Any, t: float, x: Any, r: Any, points: Any, weights: Any, u: Any, out: Any
) -> None:
    """Free motion out (6,) of a body at x, turned by r, and the flow u (N, 3), body frame."""
    out[:] = 0.0
    for i in range(len(points)):
        p, q, s = points[i, 0], points[i, 1], points[i, 2]
        v1, v2, v3 = point(
            x[0] + r[0, 0] * p + r[0, 1] * q + r[0, 2] * s,
            x[1] + r[1, 0] * p + r[1, 1] * q + r[1, 2] * s,
            x[2] + r[2, 0] * p + r[2, 1] * q + r[2, 2] * s,
            t,
        )
        for j in range(3):
            u[i, j] = r[0, j] * v1 + r[1, j] * v2 + r[2, j] * v3
            for a in range(6):
                out[a] += weights[i, j, a] * u[i, j]


@inner
def sizes_of(u: Any) -> Any:
    """`resolution.flow_sizes` of a flow (N, 3)."""
    mean, largest, variation = np.zeros(3), 0.0, 0.0
    for i in range(len(u)):
        for j in range(3):
            mean[j] += u[i, j] / len(u)
    for i in range(len(u)):
        speed, off = 0.0, 0.0
        for j in range(3):
            speed += u[i, j] ** 2
            off += (u[i, j] - mean[j]) ** 2
        largest, variation = max(largest, speed), max(variation, off)
    return math.sqrt(largest), math.sqrt(variation)


@inner
def turn_of(q: Any, r: Any) -> None:
    """The rotation r (3, 3) of a quaternion of any length."""
    a, b, c, d = q[0], q[1], q[2], q[3]
    s = 1.0 / (a * a + b * b + c * c + d * d)
    r[0, 0] = s * (a * a + b * b - c * c - d * d)
    r[1, 1] = s * (a * a - b * b + c * c - d * d)
    r[2, 2] = s * (a * a - b * b - c * c + d * d)
    r[0, 1], r[1, 0] = 2.0 * s * (b * c - a * d), 2.0 * s * (b * c + a * d)
    r[0, 2], r[2, 0] = 2.0 * s * (b * d + a * c), 2.0 * s * (b * d - a * c)
    r[1, 2], r[2, 1] = 2.0 * s * (c * d - a * b), 2.0 * s * (c * d + a * b)


@inner
def excess_of(
    point: Any, t: float, x: Any, q: Any, fine: Any, coarse: Any, radius: float, limits: Any
) -> Any:
    """`MonitoredGridMotion._excess` of bodies at x (n, 3), q (n, 4) on two grids.

    limits: what U and Omega may miss, and how much of their sizes.
    """
    r, u, worst, place = np.empty((3, 3)), np.empty((len(fine[0]), 3)), 0.0, 0
    good, rough = np.empty(6), np.empty(6)
    for b in range(len(x)):
        turn_of(q[b], r)
        on_grid(point, t, x[b], r, coarse[0], coarse[1], u, rough)
        on_grid(point, t, x[b], r, fine[0], fine[1], u, good)
        largest, variation = sizes_of(u)
        least = 0.01 * largest, 0.01 * variation / radius
        for part in range(2):
            size, off = 0.0, 0.0
            for j in range(3 * part, 3 * part + 3):
                size += good[j] ** 2
                off += (good[j] - rough[j]) ** 2
            size = max(math.sqrt(size), least[part])
            off = max(0.0, math.sqrt(off) - 1e4 * least[0] * 2.0**-52)
            allowed = max(limits[part], limits[2] * size)
            if off > worst * allowed:
                worst, place = off / allowed if allowed > 0.0 else off, b
    return worst, place


@inner
def rates_of(
    point: Any, t: float, y: Any, points: Any, weights: Any, body: Any, inertial: bool, out: Any
) -> bool:
    """dy/dt of bodies in states y (7 or 13, n); whether all are numbers.

    body (21, n): see `RigidBodyEquations.function_rows`.
    """
    r, u, motion = np.empty((3, 3)), np.empty((len(points), 3)), np.empty(6)
    x, q, good = np.empty(3), np.empty(4), True
    for b in range(y.shape[1]):
        for j in range(3):
            x[j] = y[j, b]
        for j in range(4):
            q[j] = y[3 + j, b]
        turn_of(q, r)
        on_grid(point, t, x, r, points, weights, u, motion)
        for j in range(6):  # force or torque, in space and in the body, over the resistance
            first, along = (0, j) if j < 3 else (6, j - 3)
            push = body[9 + first + 3 + along, b]
            for i in range(3):
                push += r[i, along] * body[9 + first + i, b]
            motion[j] += body[4 + first // 3 + along // 2, b] * push
        if inertial:
            w1, w2, w3 = y[10, b], y[11, b], y[12, b]
            for j in range(3):
                slip = motion[j]
                for i in range(3):
                    slip -= r[i, j] * y[7 + i, b]
                motion[j] = body[j // 2, b] * slip
            for j in range(3):
                out[j, b] = y[7 + j, b]
                out[7 + j, b] = r[j, 0] * motion[0] + r[j, 1] * motion[1] + r[j, 2] * motion[2]
            spin = body[8, b] * w3
            out[10, b] = body[2, b] * (motion[3] - w1) - spin * w2
            out[11, b] = body[2, b] * (motion[4] - w2) + spin * w1
            out[12, b] = body[3, b] * (motion[5] - w3)
        else:
            w1, w2, w3 = motion[3], motion[4], motion[5]
            for j in range(3):
                out[j, b] = r[j, 0] * motion[0] + r[j, 1] * motion[1] + r[j, 2] * motion[2]
        out[3, b] = -0.5 * (w1 * q[1] + w2 * q[2] + w3 * q[3])
        out[4, b] = 0.5 * (w1 * q[0] + w3 * q[2] - w2 * q[3])
        out[5, b] = 0.5 * (w2 * q[0] + w1 * q[3] - w3 * q[1])
        out[6, b] = 0.5 * (w3 * q[0] + w2 * q[1] - w1 * q[2])
        good = good and math.isfinite(np.sum(motion))
    return good


@inner
def slopes_of(
    point: Any, t: float, y: Any, points: Any, weights: Any, body: Any, inertial: bool, out: Any
) -> None:
    """d(dy/dt)/dy (n, s, s) of bodies in states y (s, n), by central differences."""
    size = len(y)
    state, own, two = np.empty((size, 1)), np.empty((21, 1)), np.empty((2, size, 1))
    for b in range(y.shape[1]):
        for i in range(21):
            own[i, 0] = body[i, b]
        for i in range(size):
            state[i, 0] = y[i, b]
        for j in range(size):
            step = _STEP * max(1.0, abs(y[j, b]) if j > 6 else 0.0)
            for side in range(2):
                state[j, 0] = y[j, b] + (1.0 - 2.0 * side) * step
                rates_of(point, t, state, points, weights, own, inertial, two[side])
            state[j, 0] = y[j, b]
            for i in range(size):
                out[b, i, j] = 0.5 * (two[0, i, 0] - two[1, i, 0]) / step


@cache
def _of_bodies(point: Any) -> Any:
    """`rates_of` and `slopes_of` in one flow."""

    @inner
    def rates(t: float, y: Any, points: Any, weights: Any, body: Any, out: Any) -> None:
        rates_of(point, t, y, points, weights, body, len(y) > 7, out)

    @inner
    def slopes(t: float, y: Any, points: Any, weights: Any, body: Any, out: Any) -> None:
        slopes_of(point, t, y, points, weights, body, len(y) > 7, out)

    return rates, slopes


@cache
def _in_flow(point: Any) -> Any:
    """`excess_of` in one flow, which numba need not be told at every call."""

    @inner
    def excess(t: float, x: Any, q: Any, fine: Any, coarse: Any, r: float, limits: Any) -> Any:
        return excess_of(point, t, x, q, fine, coarse, r, limits)

    return excess


class CompiledMotion(MonitoredGridMotion):
    """`MonitoredGridMotion` in a flow with a compiled `point_function`."""

    _flow: Any

    @property
    def flow(self) -> Any:
        """The flow."""
        return self._flow

    @property
    def grid_of_run(self) -> tuple[Array, Array] | None:
        """Points and weights of the grid of a run, None outside of one."""
        return None if self._rung is None else self._on_rung(self._rung).grid

    def rates_of_run(self, body: Array) -> Function:
        """The function (t, y, out) that writes dy/dt (s, n); body: as of `rates_of`."""
        return self._on_states(_of_bodies(self._flow.point_function)[0], body)

    def slopes_of_run(self, body: Array) -> Function:
        """The function (t, y, out) that writes the Jacobians (n, s, s)."""
        return self._on_states(_of_bodies(self._flow.point_function)[1], body)

    def _on_states(self, run: Any, body: Array) -> Function:
        def function(t: float, y: Array, out: Array) -> None:
            assert self.grid_of_run is not None
            now = self._flow.between(t)
            run(now, np.array(y, order="C"), *self.grid_of_run, body, out)

        return function

    def _excess(self, rung: int, t: float, x: Array, q: Array) -> tuple[float, int]:
        run = _in_flow(self._flow.point_function)
        limits = *self._allowed, self._tolerance
        grids = self._on_rung(rung + 2).grid, self._on_rung(rung).grid
        found: tuple[float, int] = run(
            self._flow.between(t), x, q, *grids, self._functional.grid.shape.radius, limits
        )
        return found
