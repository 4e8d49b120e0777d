"""The flow around the body: background, double layer and completion, from the solved density.

    u = u_bg + D[psi] + V,   V = S[mu],  mu dS = (a + b x y) sin(theta) dtheta dphi

(Bagge 2015, eq. 4.13; V carries the force and torque that the body exerts on the fluid). The
disturbance D[psi] + V is held in the body frame and vanishes at infinity with its pressure.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from qbxstokes.bie.operators import DirectSolver, SolverFactory, SurfaceOperators
from qbxstokes.errors import FlowError
from qbxstokes.geometry.grid import SurfaceGrid
from qbxstokes.geometry.shape import Revolution
from qbxstokes.qbx.exterior import ExteriorFlow, SurfaceToExterior
from qbxstokes.qbx.modes import ModalOperator, from_modes, to_modes
from qbxstokes.qbx.volume import METHODS, LayerPotentials

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]
Background = Callable[[Array], Array]
Method = Literal["auto", "table", "quadrature"]

# What gave a target its value, as reported: the body's inside, the table, or one of METHODS.
INSIDE, TABLE = -1, len(METHODS)
SOURCES = (*METHODS, "table")
# Polar nodes beyond which a flow is given up as too close to singular.
MOST_NODES = 96
# Targets per block: what is in memory at once.
_BLOCK = 65_536


class FlowField(Protocol):
    """The part of a background flow that its field needs."""

    def velocity(self, x: Array, t: float = 0.0) -> Array:
        """Velocity (..., 3)."""

    def pressure(self, x: Array, t: float = 0.0) -> Array:
        """Pressure (...)."""

    def gradient(self, x: Array, t: float = 0.0) -> Array:
        """Velocity gradient (..., 3, 3)."""


@dataclass(frozen=True)
class Disturbance:
    """Disturbance of one body: density psi, and what the completion carries, in the body frame.

    density: (N, 3) on the grid of the operators, whose completion must be the spread one.
    force, torque: ON the fluid, (3,). velocity, angular_velocity: motion of the body, (3,).
    background: velocity (N, 3) of the background flow on the grid. degree: its polynomial degree,
    None if it has none; the table then holds no degree that could only be rounding.
    """

    operators: SurfaceOperators
    density: Array
    force: Array
    torque: Array
    velocity: Array
    angular_velocity: Array
    background: Background = field(repr=False)
    degree: int | None = None

    @property
    def grid(self) -> SurfaceGrid:
        """The surface grid."""
        return self.operators.grid

    @cached_property
    def potentials(self) -> LayerPotentials:
        """The layer potentials, to be summed at single targets."""
        weight = completion_weight(self.grid, self.force, self.torque)
        return LayerPotentials(self.grid, self.density, weight)

    @cached_property
    def surface_velocity(self) -> Array:
        """Outer limit (N, 3) of the disturbance on the grid: D[psi] - 4 pi psi + V."""
        grid = self.grid
        double = ModalOperator(self.operators.double_layer, grid.n_theta, grid.n_phi)
        limit = double.apply(self.density) - 4.0 * np.pi * self.density
        return limit + completion_velocity(self.operators, self.force, self.torque)

    @cached_property
    def table(self) -> ExteriorFlow:
        """The disturbance as exterior spheroidal harmonics, from its values on the surface."""
        return surface_map(self.grid, self.degree).flow(self.surface_velocity).trimmed()

    def rigid(self, points: Array) -> Array:
        """Velocity (..., 3) of the rigid motion at points (..., 3) of the body frame."""
        return self.velocity + np.cross(self.angular_velocity, points)

    @cached_property
    def scale(self) -> float:
        """Largest speed of the disturbance on the surface: what errors are relative to."""
        points = self.grid.points
        return float(np.linalg.norm(self.rigid(points) - self.background(points), axis=-1).max())

    @cached_property
    def boundary_error(self) -> float:
        """Largest error of the table on the surface, between the nodes of the grid, absolute.

        There the disturbance is known: rigid motion minus background. The error is itself an
        exterior Stokes flow, so that its largest value on the surface bounds it everywhere (up to
        the constant of the maximum modulus theorem, which is near 1).
        """
        grid = self.grid
        n_theta, n_phi = 2 * grid.n_theta + 1, 2 * grid.n_phi + 1
        theta = np.pi * (np.arange(n_theta) + 0.5) / n_theta
        phi = 2.0 * np.pi * (np.arange(n_phi) + 0.25) / n_phi
        points = grid.shape.surface(theta[:, None], phi).reshape(-1, 3)
        exact = self.rigid(points) - self.background(points)
        return float(np.abs(self.table.evaluate(points, with_stress=False)[0] - exact).max())

    def evaluate(
        self,
        points: Array,
        tolerance: float = 1e-8,
        method: Method = "auto",
        with_stress: bool = True,
    ) -> tuple[Array, Array, Array, IntArray]:
        """Disturbance at points (N, 3) of the body frame, each in the way its tolerance asks for.

        Returns velocity (N, 3), pressure (N,), stress (N, 6: xx, yy, zz, xy, xz, yz; length 0
        unless asked for) and the source of each value: index into SOURCES, or INSIDE, where the
        values are NaN. tolerance: error of the velocity relative to its largest value.

        The table serves every target for which its error, which decays away from the surface, is
        within the tolerance; the others get QBX near the surface and quadrature away from it.
        """
        if method == "quadrature":
            return self.potentials.evaluate(points, tolerance)
        limit = tolerance * self.scale
        velocity, pressure, stress = self.table.evaluate(points, with_stress, 0.1 * limit)
        sources = np.where(np.isnan(pressure), INSIDE, TABLE)
        if method == "auto" and self.boundary_error > limit:
            poor = (sources == TABLE) & (self.boundary_error * self._decay(points) > limit)
            u, p, s, used = self.potentials.evaluate(points[poor], tolerance)
            velocity[poor], pressure[poor], sources[poor] = u, p, used
            if with_stress:
                stress[poor] = s
        return velocity, pressure, stress, sources

    def _decay(self, points: Array) -> Array:
        """Decay (N,) of the highest degree of the table from the surface to the points, or more."""
        return np.asarray(self.grid.shape.decay(points) ** (self.table.harmonics.degree + 1))

    def check_points(self, count: int = 12, seed: int = 0) -> Array:
        """Random targets (count, 3) on the surface and from 1e-6 to ten body lengths away."""
        rng = np.random.default_rng(seed)
        shape = self.grid.shape
        theta, phi = np.arccos(rng.uniform(-1, 1, count)), rng.uniform(0, 2 * np.pi, count)
        distance = shape.radius * 10.0 ** np.linspace(-6, 1.3, count)
        distance[0] = 0.0
        return shape.surface(theta, phi) + distance[:, None] * shape.normal(theta, phi)

    def differences(self, points: Array) -> Array:
        """Difference (N,) of the velocity by table and by QBX at (N, 3), relative to `scale`.

        Two evaluations of one field that share nothing but the density. NaN in the body.
        """
        table = self.evaluate(points, 1e-13, "table", with_stress=False)[0]
        direct = self.evaluate(points, 1e-13, "quadrature")[0]
        return np.asarray(np.linalg.norm(table - direct, axis=-1) / (self.scale or 1.0))

    def check(self, count: int = 12, seed: int = 0) -> float:
        """Largest of the differences over random targets."""
        return float(self.differences(self.check_points(count, seed)).max())


@dataclass(frozen=True)
class FlowAround:
    """The whole flow around a body in the space frame, at one instant.

    position (3,) of the centre, rotation (3, 3) from body to space, the disturbance in the body
    frame and the background flow in space.
    """

    disturbance: Disturbance
    flow: FlowField
    position: Array
    rotation: Array
    time: float = 0.0

    def to_body(self, points: Array) -> Array:
        """Points (N, 3) of space in the body frame."""
        return np.asarray((points - self.position) @ self.rotation)

    def evaluate(
        self,
        points: Array,
        tolerance: float = 1e-8,
        method: Method = "auto",
        with_stress: bool = True,
    ) -> dict[str, NDArray[Any]]:
        """Fields at points (N, 3) of space: velocity, disturbance_velocity, pressure, stress.

        stress: (N, 6) of xx, yy, zz, xy, xz, yz, if asked for. source: index into SOURCES, or
        INSIDE (-1) for points in the body, whose values are NaN. Works block by block, so that
        memory beyond the result stays bounded.
        """
        n = len(points)
        result: dict[str, NDArray[Any]] = {
            "velocity": np.empty((n, 3)),
            "disturbance_velocity": np.empty((n, 3)),
            "pressure": np.empty(n),
            "source": np.empty(n, dtype=np.int64),
        }
        if with_stress:
            result["stress"] = np.empty((n, 6))
        for begin in range(0, n, _BLOCK):
            part = slice(begin, begin + _BLOCK)
            x = points[part]
            u, p, s, source = self.disturbance.evaluate(
                self.to_body(x), tolerance, method, with_stress
            )
            inside = source == INSIDE
            disturbance = u @ self.rotation.T
            result["disturbance_velocity"][part] = disturbance
            result["velocity"][part] = disturbance + self.flow.velocity(x, self.time)
            background = np.where(inside, np.nan, self.flow.pressure(x, self.time))
            result["pressure"][part] = p + background
            result["source"][part] = source
            if with_stress:
                gradient = self.flow.gradient(x, self.time)
                total = turned_stress(s, self.rotation)
                for index, (i, j) in enumerate(_PAIRS):
                    total[:, index] += gradient[:, i, j] + gradient[:, j, i]
                    if i == j:
                        total[:, index] -= background
                result["stress"][part] = total
        return result

    def surface(self, theta: Array, phi: Array) -> dict[str, Array]:
        """Points, normals and traction (n_theta, n_phi, 3) of the surface, in space.

        The traction sigma.n is the force of the fluid on the body per area. The velocity is the
        rigid one, exactly.
        """
        shape = self.disturbance.grid.shape
        body = shape.surface(theta[:, None], phi)
        normals = shape.normal(theta[:, None], phi) @ self.rotation.T
        points = body @ self.rotation.T + self.position
        # A hair outside, so that rounding does not put the points inside the body.
        values = self.evaluate(points.reshape(-1, 3))
        stress = full_stress(values["stress"]).reshape(*points.shape, 3)
        return {
            "points": points,
            "normals": normals,
            "traction": np.einsum("...ij,...j->...i", stress, normals),
            "pressure": values["pressure"].reshape(points.shape[:-1]),
            "velocity": self.disturbance.rigid(body) @ self.rotation.T,
        }

    def relative_velocity(self, body_points: Array) -> Array:
        """Velocity (N, 3) relative to the body at points of the body frame, in the body frame.

        It vanishes on the surface and has no component through it, so that its path lines do not
        cross it.
        """
        u = self.disturbance.evaluate(body_points, 1e-10, "table", with_stress=False)[0]
        space = body_points @ self.rotation.T + self.position
        background = self.flow.velocity(space, self.time) @ self.rotation
        return u + background - self.disturbance.rigid(body_points)


_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


def full_stress(stress: Array) -> Array:
    """Matrices (N, 3, 3) of the components (N, 6)."""
    full = np.empty((len(stress), 3, 3))
    for index, (i, j) in enumerate(_PAIRS):
        full[:, i, j] = full[:, j, i] = stress[:, index]
    return full


def turned_stress(stress: Array, rotation: Array) -> Array:
    """Components (N, 6) of R sigma R^T."""
    # One product with the 6 x 6 matrix of the rotation on symmetric tensors.
    matrix = np.empty((6, 6))
    for row, (i, j) in enumerate(_PAIRS):
        for column, (a, b) in enumerate(_PAIRS):
            value = rotation[i, a] * rotation[j, b]
            matrix[row, column] = value if a == b else value + rotation[i, b] * rotation[j, a]
    return np.asarray(stress @ matrix.T)


def resolving_grid(shape: Revolution, background: Background, tolerance: float) -> tuple[int, int]:
    """Polar and azimuthal nodes whose table holds a background flow to a relative tolerance.

    Raises FlowError where MOST_NODES do not suffice.
    """
    fine = SurfaceGrid(shape, MOST_NODES, 2 * MOST_NODES)
    modes = to_modes(background(fine.points), fine.n_theta, fine.n_phi)
    size = np.abs(modes).max(axis=1)
    # What all higher modes hold together, from each mode on.
    rest = np.cumsum(size[::-1])[::-1] / size.max()
    small = np.flatnonzero(rest < tolerance)
    n_phi = max(2 * int(small[0] if small.size else MOST_NODES), 4)
    n_theta = 8
    while True:
        grid = SurfaceGrid(shape, n_theta, n_phi)
        table = surface_map(grid, None).flow(background(grid.points))
        probe = SurfaceGrid(shape, 2 * n_theta + 1, 7)
        exact = background(probe.points)
        outside = probe.points * (1.0 + 1e-15)
        error = float(np.abs(table.evaluate(outside, with_stress=False)[0] - exact).max())
        if error <= tolerance * float(np.abs(exact).max()):
            return n_theta, n_phi
        n_theta = (5 * n_theta + 3) // 4
        if n_theta > MOST_NODES or not small.size:
            raise FlowError(
                f"the flow varies too much over the body: {MOST_NODES} x {2 * MOST_NODES} points "
                f"of the surface leave an error of {error:.1e}, more than {tolerance:.0e}"
            )


def surface_map(grid: SurfaceGrid, degree: int | None) -> SurfaceToExterior:
    """The map from surface velocities to exterior flows, for background flows of a degree."""
    return SurfaceToExterior(grid, grid.n_theta - 2 if degree is None else max(degree, 1))


def completion_weight(grid: SurfaceGrid, force: Array, torque: Array) -> Array:
    """Coefficients (6,) of the density a + b x y of the spread completion (see `resistance`)."""
    spin = np.asarray(torque) * grid.shape.torque_density
    return np.concatenate([np.asarray(force) / (4.0 * np.pi), spin])


def completion_velocity(operators: SurfaceOperators, force: Array, torque: Array) -> Array:
    """Completion flow (N, 3) on the surface, of force and torque (3,) on the fluid."""
    grid, flows = operators.grid, operators.completion_flows
    modes = np.zeros((grid.n_phi // 2 + 1, 3 * grid.n_theta), dtype=np.complex128)
    # A real field of mode 1 has half its amplitude as Fourier coefficient.
    modes[1] += 0.5 * (force[0] - 1j * force[1]) * flows["translation_transverse"]
    modes[1] += 0.5 * (torque[1] + 1j * torque[0]) * flows["rotation_transverse"]
    modes[0] += force[2] * flows["translation_axial"]
    modes[0] += 1j * torque[2] * flows["rotation_axial"]
    return from_modes(modes, grid.n_theta, grid.n_phi)


def resistance_disturbance(
    operators: SurfaceOperators,
    background: Background,
    velocity: Array,
    angular_velocity: Array,
    solver: SolverFactory = DirectSolver,
    degree: int | None = None,
) -> Disturbance:
    """Disturbance of a body of given motion in the background flow (body frame)."""
    points = operators.grid.points
    velocity, spin = np.asarray(velocity, float), np.asarray(angular_velocity, float)
    data = velocity + np.cross(spin, points) - background(points)
    density = solver(operators.resistance, operators.grid).solve(data)
    force, torque = operators.force_of(density)
    return Disturbance(operators, density, -force, -torque, velocity, spin, background, degree)


def mobility_disturbance(
    operators: SurfaceOperators,
    background: Background,
    force: Array | None = None,
    torque: Array | None = None,
    solver: SolverFactory = DirectSolver,
    degree: int | None = None,
) -> Disturbance:
    """Disturbance of a free body, pushed by an outer force and torque (3,), body frame."""
    zero = np.zeros(3)
    force = zero if force is None else np.asarray(force, float)
    torque = zero if torque is None else np.asarray(torque, float)
    data = -background(operators.grid.points) - completion_velocity(operators, force, torque)
    density = solver(operators.mobility, operators.grid).solve(data)
    velocity, spin = operators.motion_of(density)
    return Disturbance(operators, density, force, torque, velocity, spin, background, degree)
