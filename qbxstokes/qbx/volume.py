"""Layer potentials at single targets: plain, graded or by expansion, whichever is cheapest.

Three ways give a target its value to the tolerance asked for:

- "plain": Gauss-Legendre in cos(theta) times trapezoid on as many nodes as the target's distance
  requires. On the confocal spheroid of the target with semi-axes alpha, gamma the kernel's part of
  degree l has decayed by t^l, t = (1 + k)/(alpha + gamma), so n nodes leave an error of t^(2n).
- "graded": panels graded to the target, the plain kernel; any distance but 0.
- "expansion": QBX about a centre outside the foot of the target, down to and on the surface.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qbxstokes.geometry.grid import SurfaceGrid
from qbxstokes.geometry.symmetric import symmetric
from qbxstokes.qbx.exterior import SURFACE_MARGIN, WHAT
from qbxstokes.qbx.modes import to_modes
from qbxstokes.typing import Array

IntArray = NDArray[np.int64]

METHODS = ("plain", "graded", "expansion")
# Nodes of the graded rules a target costs at least; plain quadrature is taken below as many.
_GRADED_NODES = 12_000
# Logarithm of the safety factor on the tolerance of plain quadrature.
_PLAIN_MARGIN = 3.0
# An expansion is taken below this share of its radius; above it the panels are as coarse.
_EXPANSION_REACH = 0.5


@dataclass(frozen=True)
class LayerPotentials:
    """Double layer of a density plus single layer (force + torque-like vector x y) h.

    density: (N, 3) on the grid. weight: (6,), see `volume_kernel.potentials`.
    expansion_order, radius_factor, panel_order, panel_ratio: as in `operator.GradedScheme`.
    """

    grid: SurfaceGrid
    density: Array
    weight: Array
    expansion_order: int = 20
    radius_factor: float = 0.1
    panel_order: int = 18
    panel_ratio: float = 0.7

    def evaluate(
        self, points: Array, tolerance: float = 1e-10, method: str | None = None
    ) -> tuple[dict[str, Array], IntArray]:
        """All of `exterior.WHAT` at points (N, 3), and the index into METHODS used (N,).

        NaN and -1 inside the body. method: use this one for all targets instead of choosing.
        tolerance: relative to the size of the density.
        """
        points = np.atleast_2d(np.asarray(points, dtype=float))
        shape, modes = self.grid.shape, self._modes
        out = np.full((len(points), 16), np.nan)
        used = np.full(len(points), -1, dtype=np.int64)
        rho, heights = np.hypot(points[:, 0], points[:, 1]), points[:, 2]
        feet, distances = shape.nearest(rho, heights)
        outside = shape.level(points) >= 1.0 - SURFACE_MARGIN
        for i in np.flatnonzero(outside).tolist():
            r, z, point = float(rho[i]), float(heights[i]), points[i]
            theta, distance = float(feet[i]), max(0.0, float(distances[i]))
            radius = self.radius_factor * shape.admissible_radius(theta).item()
            chosen = method or self._choose(r, z, distance, radius, tolerance, len(modes))
            used[i] = METHODS.index(chosen)
            rule, order = self._rule(chosen, r, z, theta, distance, radius, tolerance, len(modes))
            out[i] = self._sum(point, (theta, distance), radius, order, rule)
        stress, spin = out[:, 4:10], out[:, 10:13]
        # grad u is half of stress + p I and of what turns with the vorticity: u_i,j - u_j,i.
        gradient = 0.5 * (symmetric(stress) - np.cross(spin[:, None], np.eye(3)))
        gradient += 0.5 * out[:, 3, None, None] * np.eye(3)
        values = out[:, :3], gradient, out[:, 3], out[:, 13:], stress
        return dict(zip(WHAT, values, strict=True)), used

    def by_rule(self, points: Array, rule: tuple[NDArray[Any], ...]) -> Array:
        """Velocity (N, 3) at points outside by the plain kernel on one source rule for all."""
        out = np.empty((len(points), 16))
        feet, distances = self.grid.shape.nearest(
            np.hypot(points[:, 0], points[:, 1]), points[:, 2]
        )
        for i, foot in enumerate(zip(feet.tolist(), distances.tolist(), strict=True)):
            out[i] = self._sum(points[i], foot, 0.0, -1, rule)
        return out[:, :3]

    @cached_property
    def _modes(self) -> NDArray[np.complex128]:
        """Modes (n_modes, 3, n_theta) whose real part is the density."""
        grid = self.grid
        modes = to_modes(self.density, grid.n_theta, grid.n_phi).reshape(-1, 3, grid.n_theta)
        modes = modes[: (grid.n_phi + 1) // 2].copy()
        modes[1:] *= 2.0
        return modes

    def _sum(
        self,
        point: Array,
        foot: tuple[float, float],
        radius: float,
        order: int,
        rule: tuple[NDArray[Any], ...],
    ) -> Array:
        """`volume_kernel.potentials` (16,) at a point whose foot is (theta, distance)."""
        from qbxstokes.qbx.volume_kernel import potentials

        grid, (theta, distance) = self.grid, foot
        shape = grid.shape
        phi = math.atan2(point[1], point[0])
        c, s = math.cos(phi), math.sin(phi)
        turn = np.exp(1j * np.arange(len(self._modes)) * phi)
        a = self.weight
        weight = np.array(
            [
                *(c * a[0] + s * a[1], c * a[1] - s * a[0], a[2]),
                *(c * a[3] + s * a[4], c * a[4] - s * a[3], a[5]),
            ]
        )
        at = np.asarray(theta)
        (d_rho, d_z), speed = shape.tangent(at), shape.speed(at)
        nodes, *rest = rule
        sources = *shape.meridian(nodes), *shape.area_vector(nodes), *shape.difference(nodes, theta)
        result = np.zeros(16)
        potentials(
            np.array([float(shape.meridian(at)[0]), -d_z / speed, d_rho / speed]),
            distance,
            radius,
            order,
            nodes,
            np.ascontiguousarray(np.stack(sources, axis=-1)),
            *rest,
            grid.theta,
            grid.barycentric,
            grid.nodes == "cosine",
            self._modes * turn[:, None, None],
            weight,
            result,
        )
        return _turn(result, c, s)

    def plain_nodes(self, rho: float, z: float, tolerance: float, n_modes: int) -> tuple[int, int]:
        """Nodes in theta and phi that plain quadrature needs at a target (rho, z).

        Degrees above 2n - n_theta are aliased; derivatives of the kernel add a few powers.
        """
        rate = -math.log(float(self.grid.shape.decay([rho, 0.0, z])))
        if rate < 1e-3:
            return 10**6, 10**6
        # t^l l^3 = tolerance, with the margin that thin bodies were measured to need.
        thin = -2.0 * math.log(self.grid.shape.least_radius / self.grid.shape.radius)
        digits = _PLAIN_MARGIN + thin - math.log(tolerance)
        degree = digits / rate
        for _ in range(4):
            degree = (digits + 3.0 * math.log(max(degree, 1.0))) / rate
        return math.ceil(0.5 * (degree + self.grid.n_theta)), math.ceil(degree + n_modes) + 1

    def _choose(
        self, rho: float, z: float, distance: float, radius: float, tolerance: float, n_modes: int
    ) -> str:
        n_theta, n_phi = self.plain_nodes(rho, z, tolerance, n_modes)
        if n_theta * n_phi <= _GRADED_NODES:
            return "plain"
        return "expansion" if distance < _EXPANSION_REACH * radius else "graded"

    def _rule(
        self,
        method: str,
        rho: float,
        z: float,
        theta: float,
        distance: float,
        radius: float,
        tolerance: float,
        n_modes: int,
    ) -> tuple[tuple[NDArray[Any], ...], int]:
        """Source rule of a target, and the order of the expansion (-1: the plain kernel)."""
        from qbxstokes.qbx.panels import graded_rule

        if method == "plain":
            n_theta, n_phi = self.plain_nodes(rho, z, tolerance, n_modes)
            return plain_rule(n_theta, n_phi), -1
        x, w = np.polynomial.legendre.leggauss(self.panel_order)
        away = radius if method == "expansion" else distance
        rule: tuple[NDArray[Any], ...] = graded_rule(
            self.grid.shape,
            theta,
            1,
            away,
            self.panel_ratio,
            np.pi * self.panel_order / (self.grid.n_theta + 8),
            np.pi * self.panel_order / (2 * (n_modes + 3)),
            x,
            w,
        )
        return rule, self.expansion_order if method == "expansion" else -1


def plain_rule(n_theta: int, n_phi: int) -> tuple[NDArray[Any], ...]:
    """Gauss-Legendre in cos(theta) and trapezoid in phi, folded onto [0, pi] (see `panels`)."""
    x, w = np.polynomial.legendre.leggauss(n_theta)
    s = np.sqrt((1.0 - x) * (1.0 + x))
    j = np.arange(n_phi // 2 + 1)
    weights = np.full(j.size, 4.0 * np.pi / n_phi)
    weights[0] /= 2.0
    if n_phi % 2 == 0:
        weights[-1] /= 2.0
    start = np.zeros(n_theta, np.int64)
    stop = np.full(n_theta, j.size, np.int64)
    return np.arctan2(s, -x), w / s, start, stop, 2.0 * np.pi * j / n_phi, weights


def _turn(result: Array, c: float, s: float) -> Array:
    """Turn the numbers (16,) about the axis by the angle with cosine c and sine s."""
    ux, uy, uz, p, xx, yy, zz, xy, xz, yz, wx, wy, wz, gx, gy, gz = result
    return np.array(
        [
            c * ux - s * uy,
            s * ux + c * uy,
            uz,
            p,
            c * c * xx + s * s * yy - 2.0 * c * s * xy,
            s * s * xx + c * c * yy + 2.0 * c * s * xy,
            zz,
            c * s * (xx - yy) + (c * c - s * s) * xy,
            c * xz - s * yz,
            s * xz + c * yz,
            *(c * wx - s * wy, s * wx + c * wy, wz),
            *(c * gx - s * gy, s * gx + c * gy, gz),
        ]
    )
