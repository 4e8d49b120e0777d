"""Free motion by the grid functional in a flow whose velocity is compiled, all in one loop.

Imported where such a flow is there: numba comes with it, and compiles once for each flow.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numba
import numpy as np

from qbxstokes.bie.providers import MonitoredGridMotion
from qbxstokes.typing import Array

inner = numba.njit(error_model="numpy", fastmath={"contract"})


@inner
def on_grid(
    point: Any, t: float, x: Any, r: Any, points: Any, weights: Any, u: Any, out: Any
) -> Any:
    """Free motion out (6,) of a body at x, turned by r, body frame; the two sizes of the flow."""
    n = len(points)
    mean = np.zeros(3)
    largest = 0.0
    out[:] = 0.0
    for i in range(n):
        p, q, s = points[i, 0], points[i, 1], points[i, 2]
        v1, v2, v3 = point(
            x[0] + r[0, 0] * p + r[0, 1] * q + r[0, 2] * s,
            x[1] + r[1, 0] * p + r[1, 1] * q + r[1, 2] * s,
            x[2] + r[2, 0] * p + r[2, 1] * q + r[2, 2] * s,
            t,
        )
        for j in range(3):
            u[i, j] = r[0, j] * v1 + r[1, j] * v2 + r[2, j] * v3
            mean[j] += u[i, j] / n
        largest = max(largest, v1 * v1 + v2 * v2 + v3 * v3)
        for j in range(3):
            for a in range(6):
                out[a] += weights[i, j, a] * u[i, j]
    variation = 0.0
    for i in range(n):
        off = 0.0
        for j in range(3):
            off += (u[i, j] - mean[j]) ** 2
        variation = max(variation, off)
    return math.sqrt(largest), math.sqrt(variation)


@inner
def change_of(fine: Any, coarse: Any, first: int, least: float, rounding: float) -> float:
    """As `resolution.motion_change`, of three of the six numbers."""
    size, off = 0.0, 0.0
    for j in range(first, first + 3):
        size += fine[j] * fine[j]
        off += (fine[j] - coarse[j]) ** 2
    scale = max(math.sqrt(size), least)
    change = max(0.0, math.sqrt(off) - rounding)
    return change / scale if scale > 0.0 else change


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
def monitored(
    point: Any,
    t: float,
    x: Any,
    q: Any,
    fine: Any,
    coarse: Any,
    radius: float,
    motion: Any,
    change: Any,
) -> None:
    """Free motions (n, 6) in space of bodies at x (n, 3), q (n, 4), and their change (n,).

    fine, coarse: points and weights of the two grids.
    """
    r, u = np.empty((3, 3)), np.empty((len(fine[0]), 3))
    one, two = np.empty(6), np.empty(6)
    for b in range(len(x)):
        turn_of(q[b], r)
        largest, variation = on_grid(point, t, x[b], r, fine[0], fine[1], u, one)
        on_grid(point, t, x[b], r, coarse[0], coarse[1], u, two)
        rounding = 1e4 * 0.01 * largest * 2.0**-52
        change[b] = max(
            change_of(one, two, 0, 0.01 * largest, rounding),
            change_of(one, two, 3, 0.01 * variation / radius, rounding),
        )
        for j in range(3):
            motion[b, j] = r[j, 0] * one[0] + r[j, 1] * one[1] + r[j, 2] * one[2]
            motion[b, 3 + j] = r[j, 0] * one[3] + r[j, 1] * one[4] + r[j, 2] * one[5]


@inner
def massless_rates(y: Any, u: Any, omega: Any, out: Any) -> None:
    """dy/dt (7, n) of massless bodies (n, 7) from their free motion, each (n, 3)."""
    for b in range(len(y)):
        q0, q1, q2, q3 = y[b, 3], y[b, 4], y[b, 5], y[b, 6]
        o1, o2, o3 = omega[b, 0], omega[b, 1], omega[b, 2]
        for j in range(3):
            out[j, b] = u[b, j]
        out[3, b] = -0.5 * (o1 * q1 + o2 * q2 + o3 * q3)
        out[4, b] = 0.5 * (o1 * q0 + o2 * q3 - o3 * q2)
        out[5, b] = 0.5 * (o2 * q0 + o3 * q1 - o1 * q3)
        out[6, b] = 0.5 * (o3 * q0 + o1 * q2 - o2 * q1)


@cache
def monitored_in(point: Any) -> Any:
    """`monitored` in one flow, which numba need not be told at every call."""

    @inner
    def run(
        t: float, x: Any, q: Any, fine: Any, coarse: Any, radius: float, out: Any, change: Any
    ) -> None:
        monitored(point, t, x, q, fine, coarse, radius, out, change)

    return run


class CompiledMotion(MonitoredGridMotion):
    """`MonitoredGridMotion` in a flow with a compiled `point_function`."""

    def _on_level(
        self, level: tuple[int, int], t: float, x: Array, q: Array
    ) -> tuple[Array, Array]:
        flow: Any = self._flow
        run, t = monitored_in(flow.point_function), flow.before_break(t)
        coarse, fine = self._pair(level)
        motion, change = np.empty((len(x), 6)), np.empty(len(x))
        radius = float(self._functional.grid.shape.radius)
        run(t, x, q, fine.grid, coarse.grid, radius, motion, change)
        return motion, change

    def rates(self, t: float, y: Array, out: Array) -> None:
        """dy/dt of massless bodies on which nothing else acts, (7, n)."""
        states = np.ascontiguousarray(y.T)
        u, omega = self.free_motion(t, states[:, :3], states[:, 3:])
        massless_rates(states, u, omega, out)
