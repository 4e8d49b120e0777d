"""Layer potentials at single targets: plain, graded or by expansion, whichever is cheapest.

Three ways give a target its value to the tolerance asked for:

- "plain": Gauss-Legendre in cos(theta) times trapezoid on as many nodes as the target's distance
  requires. On the confocal spheroid of the target with semi-axes alpha, gamma the kernel's part of
  degree l has decayed by t^l, t = (1 + k)/(alpha + gamma), so n nodes leave an error of t^(2n).
- "graded": panels graded to the target, the plain kernel; any distance but 0.
- "expansion": QBX about a centre outside the foot of the target, down to and on the surface.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from qbxstokes.geometry.grid import SurfaceGrid
from qbxstokes.geometry.symmetric import components, symmetric
from qbxstokes.qbx.exterior import SURFACE_MARGIN, values_of
from qbxstokes.qbx.kernel import density_parts, interpolation
from qbxstokes.qbx.modes import to_modes
from qbxstokes.qbx.operator import GradedScheme
from qbxstokes.qbx.panels import Rule, uniform_rule
from qbxstokes.typing import Array, ComplexArray, Integers

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
    expansion_order, radius_factor: as in `operator.GradedScheme`.
    """

    grid: SurfaceGrid
    density: Array
    weight: Array
    expansion_order: int = 20
    radius_factor: float = 0.1

    def evaluate(
        self, points: Array, tolerance: float = 1e-10, method: str | None = None
    ) -> tuple[dict[str, Array], Integers]:
        """All of `exterior.WHAT` at points (N, 3), and the index into METHODS used (N,).

        NaN and -1 inside the body. method: use this one for all targets instead of choosing.
        tolerance: relative to the size of the density.
        """
        points = np.atleast_2d(np.asarray(points, dtype=float))
        shape = self.grid.shape
        out = np.full((len(points), 16), np.nan)
        used = np.full(len(points), -1, dtype=np.int64)
        feet, distances = self._feet(points)
        outside = shape.level(points) >= 1.0 - SURFACE_MARGIN
        for i in np.flatnonzero(outside).tolist():
            theta, distance = float(feet[i]), max(0.0, float(distances[i]))
            radius = self._scheme.radius(shape, theta)
            nodes = self.plain_nodes(points[i], tolerance)
            near = "expansion" if distance < _EXPANSION_REACH * radius else "graded"
            chosen = method or ("plain" if math.prod(nodes) <= _GRADED_NODES else near)
            used[i] = METHODS.index(chosen)
            if chosen == "plain":
                rule = uniform_rule(*nodes, "cosine")
            else:
                away = radius if chosen == "expansion" else distance
                rule = self._scheme.rule(shape, theta, 1, len(self._modes), away)
            order = self.expansion_order if chosen == "expansion" else -1
            out[i] = self._sum(points[i], theta, distance, radius, order, rule)
        return values_of(out), used

    def by_rule(self, points: Array, rule: Rule) -> Array:
        """Velocity (N, 3) at points outside by the plain kernel on one source rule for all."""
        found = [
            self._sum(point, theta, distance, 0.0, -1, rule)
            for point, theta, distance in zip(points, *self._feet(points), strict=True)
        ]
        return np.array(found)[:, :3]

    @cached_property
    def _scheme(self) -> GradedScheme:
        return GradedScheme(self.grid.n_theta, self.expansion_order, self.radius_factor)

    def _feet(self, points: Array) -> tuple[Array, Array]:
        return self.grid.shape.nearest(np.hypot(points[:, 0], points[:, 1]), points[:, 2])

    @cached_property
    def _modes(self) -> ComplexArray:
        """Modes (n_modes, 3, n_theta) whose real part is the density."""
        grid = self.grid
        modes = to_modes(self.density, grid.n_theta, grid.n_phi).reshape(-1, 3, grid.n_theta)
        modes = modes[: (grid.n_phi + 1) // 2].copy()
        modes[1:] *= 2.0
        return modes

    def _sum(
        self, point: Array, theta: float, distance: float, radius: float, order: int, rule: Rule
    ) -> Array:
        """`volume_kernel.potentials` (16,) at a point above its foot at theta."""
        from qbxstokes.qbx.volume_kernel import potentials

        shape, at = self.grid.shape, np.asarray(theta)
        phi = math.atan2(point[1], point[0])
        # About the axis, so that the target comes to lie at phi = 0, and back.
        c, s = math.cos(phi), math.sin(phi)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        nodes, weights, *azimuths = rule
        (d_rho, d_z), speed = shape.tangent(at), shape.speed(at)
        sources = *shape.meridian(nodes), *shape.area_vector(nodes), *shape.difference(nodes, theta)
        result = np.zeros(16)
        potentials(
            np.array([float(shape.meridian(at)[0]), -d_z / speed, d_rho / speed]),
            distance,
            radius,
            order,
            np.stack([*sources, 0.5 * weights, np.sin(nodes) / (8.0 * np.pi)], axis=-1),
            self._density_at(nodes, phi),
            *azimuths,
            np.concatenate([self.weight[:3] @ turn, self.weight[3:] @ turn]),
            result,
        )
        tensor = turn @ symmetric(result[4:10]) @ turn.T
        parts = turn @ result[:3], result[3:4], components(tensor), turn @ result[10:13]
        return np.concatenate([*parts, turn @ result[13:]])

    def _density_at(self, theta: Array, phi: float) -> ComplexArray:
        """Amplitudes (n, n_modes, 3) of the density (rho, phi, z) at theta, by azimuth from phi."""
        grid = self.grid
        even, odd = interpolation(theta, grid.theta, grid.barycentric, grid.nodes == "cosine")
        found = np.empty((len(theta), len(self._modes), 3), dtype=np.complex128)
        for m, mode in enumerate(self._modes):
            rho, around, z = mode * np.exp(1j * m * phi)
            along, same, other = density_parts(m, theta, grid, even, odd)
            found[:, m, 0] = same @ rho + other @ around
            found[:, m, 1] = 1j * (same @ around + other @ rho)
            found[:, m, 2] = along @ z
        return found

    def plain_nodes(self, point: Array, tolerance: float) -> tuple[int, int]:
        """Nodes in theta and phi that plain quadrature needs at a target (3,).

        Degrees above 2n - n_theta are aliased; derivatives of the kernel add a few powers.
        """
        rate = -math.log(float(self.grid.shape.decay(point)))
        if rate < 1e-3:
            return 10**6, 10**6
        # t^l l^3 = tolerance, with the margin that thin bodies were measured to need.
        thin = -2.0 * math.log(self.grid.shape.least_radius / self.grid.shape.radius)
        digits = _PLAIN_MARGIN + thin - math.log(tolerance)
        degree = digits / rate
        for _ in range(4):
            degree = (digits + 3.0 * math.log(max(degree, 1.0))) / rate
        n_phi = math.ceil(degree + len(self._modes)) + 1
        return math.ceil(0.5 * (degree + self.grid.n_theta)), n_phi
