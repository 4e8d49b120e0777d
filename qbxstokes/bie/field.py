"""The flow around the body: background, double layer and completion, from the solved density.

    u = u_bg + D[psi] + V,   V = S[mu],  mu dS = (a + b x y) sin(theta) dtheta dphi

(Bagge 2015, eq. 4.13; V carries the force and torque that the body exerts on the fluid). All here
is in the body frame; the pressure of the disturbance vanishes at infinity.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from qbxstokes.bie.operators import DirectSolver, SolverFactory, SurfaceOperators
from qbxstokes.geometry.spheroid import SurfaceGrid
from qbxstokes.qbx.exterior import ExteriorFlow, exterior_flow
from qbxstokes.qbx.modes import ModalOperator, from_modes
from qbxstokes.qbx.volume import LayerPotentials

Array = NDArray[np.float64]
Background = Callable[[Array], Array]


@dataclass(frozen=True)
class Disturbance:
    """Disturbance of one body: density psi, and what the completion carries, in the body frame.

    density: (N, 3) on the grid of the operators. force, torque: ON the fluid, (3,).
    velocity, angular_velocity: rigid motion of the body, (3,).
    degree: polynomial degree of the background flow, None if it is none or not known; the table
    then holds no degree that can only be rounding.
    """

    operators: SurfaceOperators
    density: Array
    force: Array
    torque: Array
    velocity: Array
    angular_velocity: Array
    degree: int | None = None

    @property
    def grid(self) -> SurfaceGrid:
        """The surface grid."""
        return self.operators.grid

    @cached_property
    def potentials(self) -> LayerPotentials:
        """The layer potentials, to be summed at single targets."""
        return LayerPotentials(
            self.grid, self.density, completion_weight(self.grid, self.force, self.torque)
        )

    @cached_property
    def surface_velocity(self) -> Array:
        """Outer limit (N, 3) of the disturbance on the grid: D[psi] - 4 pi psi + V."""
        grid = self.grid
        double = ModalOperator(self.operators.double_layer, grid.n_theta, grid.n_phi)
        limit = double.apply(self.density) - 4.0 * np.pi * self.density
        return limit + completion_velocity(self.operators, self.force, self.torque)

    @cached_property
    def exterior(self) -> ExteriorFlow:
        """The table of the disturbance: exterior spheroidal harmonics from its surface values."""
        degree = None if self.degree is None else max(self.degree, 1)
        return exterior_flow(self.grid, self.surface_velocity, degree).trimmed()

    def rigid(self, points: Array) -> Array:
        """Velocity of the rigid motion at points (..., 3)."""
        return self.velocity + np.cross(self.angular_velocity, points)

    def check(self, count: int = 12, seed: int = 0) -> float:
        """Largest difference between table and QBX over random targets, relative to the largest.

        Targets lie on the surface and at distances down to 1e-6 and up to ten body lengths; the
        difference is that of the velocity, relative to its maximum over the targets.
        """
        rng = np.random.default_rng(seed)
        k = self.grid.spheroid.aspect_ratio
        theta, phi = np.arccos(rng.uniform(-1, 1, count)), rng.uniform(0, 2 * np.pi, count)
        distance = max(k, 1.0) * 10.0 ** np.linspace(-6, 1.3, count)
        distance[0] = 0.0
        spheroid = self.grid.spheroid
        points = spheroid.surface(theta, phi) + distance[:, None] * spheroid.normal(theta, phi)
        table = self.exterior.evaluate(points, with_stress=False)[0]
        direct = self.potentials.evaluate(points, 1e-13)[0]
        scale = float(np.abs(direct).max())
        return float(np.abs(table - direct).max()) / scale if scale else 0.0


def completion_weight(grid: SurfaceGrid, force: Array, torque: Array) -> Array:
    """Coefficients (6,) of the density a + b x y of the spread completion (see `resistance`)."""
    k2 = grid.spheroid.aspect_ratio**2
    across, about = 3.0 / (4.0 * np.pi * (1.0 + k2)), 3.0 / (8.0 * np.pi * k2)
    spin = np.asarray(torque) * [across, across, about]
    return np.concatenate([np.asarray(force) / (4.0 * np.pi), spin])


def completion_velocity(operators: SurfaceOperators, force: Array, torque: Array) -> Array:
    """Completion flow (N, 3) on the surface, of force and torque (3,) on the fluid."""
    grid, flows = operators.grid, operators.completion_flows
    modes = np.zeros((grid.n_phi // 2 + 1, 3 * grid.n_theta), dtype=np.complex128)
    half = 0.5
    # A real field of mode 1 has half its amplitude as Fourier coefficient.
    modes[1] += half * (force[0] - 1j * force[1]) * flows["translation_transverse"]
    modes[1] += half * (torque[1] + 1j * torque[0]) * flows["rotation_transverse"]
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
    return Disturbance(operators, density, -force, -torque, velocity, spin, degree)


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
    return Disturbance(operators, density, force, torque, velocity, spin, degree)
