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
def sampled(
    point: Any, t: float, x: Any, rotation: Any, points: Any, weights: Any, out: Any, sizes: Any
) -> None:
    """Free motions (n, 6) in the body frame and `resolution.flow_sizes` (2, n)."""
    u, mean = np.empty((len(points), 3)), np.empty(3)
    for b in range(len(x)):
        on_grid(point, t, x[b], rotation[b], points, weights, u, out[b])
        largest, variation = 0.0, 0.0
        for j in range(3):
            mean[j] = np.mean(u[:, j])
        for i in range(len(points)):
            speed, off = 0.0, 0.0
            for j in range(3):
                speed += u[i, j] ** 2
                off += (u[i, j] - mean[j]) ** 2
            largest, variation = max(largest, speed), max(variation, off)
        sizes[0, b], sizes[1, b] = math.sqrt(largest), math.sqrt(variation)


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
def massless_rates(point: Any, t: float, y: Any, points: Any, weights: Any, out: Any) -> bool:
    """dy/dt (7, n) of massless bodies (7, n); whether all are numbers."""
    r, u, motion = np.empty((3, 3)), np.empty((len(points), 3)), np.empty(6)
    x, q, good = np.empty(3), np.empty(4), True
    for b in range(y.shape[1]):
        for j in range(3):
            x[j] = y[j, b]
        for j in range(4):
            q[j] = y[3 + j, b]
        turn_of(q, r)
        on_grid(point, t, x, r, points, weights, u, motion)
        v1, v2, v3 = motion[0], motion[1], motion[2]
        w1, w2, w3 = 0.5 * motion[3], 0.5 * motion[4], 0.5 * motion[5]
        for j in range(3):
            out[j, b] = r[j, 0] * v1 + r[j, 1] * v2 + r[j, 2] * v3
        out[3, b] = -(w1 * q[1] + w2 * q[2] + w3 * q[3])
        out[4, b] = w1 * q[0] + w3 * q[2] - w2 * q[3]
        out[5, b] = w2 * q[0] + w1 * q[3] - w3 * q[1]
        out[6, b] = w3 * q[0] + w2 * q[1] - w1 * q[2]
        good = good and math.isfinite(v1 + v2 + v3 + w1 + w2 + w3)
    return good


@cache
def _sampled_in(point: Any) -> Any:
    """`sampled` in one flow, which numba need not be told at every call."""

    @inner
    def run(t: float, x: Any, r: Any, points: Any, weights: Any, out: Any, sizes: Any) -> None:
        sampled(point, t, x, r, points, weights, out, sizes)

    return run


class CompiledMotion(MonitoredGridMotion):
    """`MonitoredGridMotion` in a flow with a compiled `point_function`."""

    @property
    def flow(self) -> Any:
        """The flow."""
        return self._flow

    @property
    def grid(self) -> tuple[Array, Array] | None:
        """Points and weights of the grid of a run, None outside of one."""
        return None if self._rung is None else self._on_rung(self._rung).grid

    def _sampled(self, grid: Any, t: float, x: Array, rotation: Array) -> tuple[Array, Array]:
        flow: Any = self._flow
        motion, sizes = np.empty((len(x), 6)), np.empty((2, len(x)))
        run, now = _sampled_in(flow.point_function), flow.before_break(t)
        run(now, x, rotation, *grid.grid, motion, sizes)
        return motion, sizes
