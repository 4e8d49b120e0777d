"""The operators of one body on one grid, and the body model they give."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from qbxstokes.bie.faxen import faxen_coefficients
from qbxstokes.bie.functional import BodyModel, ModalFunctional, adjoint_weights, resistance
from qbxstokes.bie.rigid import (
    Completion,
    RigidMode,
    force_scale,
    point_completion,
    resistance_blocks,
    rigid_modes,
    surface_completion,
)
from qbxstokes.geometry.grid import SurfaceGrid
from qbxstokes.geometry.shape import Revolution
from qbxstokes.qbx.modes import ModalOperator, to_modes
from qbxstokes.qbx.operator import Scheme, blocks_from_rows, independent_rows, layer_rows
from qbxstokes.typing import Array


class Solver(Protocol):
    """What solves the discrete integral equation: GMRES, or the blocks inverted directly."""

    def solve(self, rhs: Array) -> Array:
        """Solution (N, 3) of A x = rhs."""

    def solve_transpose(self, rhs: Array) -> Array:
        """Solution (N, 3) of A^T x = rhs."""


class DirectSolver:
    """Solves a modal operator by its inverse blocks."""

    def __init__(self, operator: ModalOperator, grid: SurfaceGrid) -> None:
        self._inverse = operator.inverse

    def solve(self, rhs: Array) -> Array:
        """Solution (N, 3) of A x = rhs."""
        return self._inverse.apply(rhs)

    def solve_transpose(self, rhs: Array) -> Array:
        """Solution (N, 3) of A^T x = rhs."""
        return self._inverse.apply_transpose(rhs)


SolverFactory = Callable[[ModalOperator, SurfaceGrid], Solver]


def mobility_blocks(double: Array, rigid: dict[str, RigidMode]) -> Array:
    """Blocks (n_modes, 3n, 3n) of the mobility operator from those of the double layer.

    Free motion of a body of given force and torque:

        -4 pi psi + D[psi] - U[psi] - Omega[psi] x (x - x_CM) = -V[F, M] - u_bg

    with U, Omega 4 pi times the L2 projections of psi on the rigid motions (Bagge 2015, eq. 4.13
    and 4.17-4.18, with the sign that moves the null space of -4 pi + D to -4 pi, on the side of the
    rest of its spectrum [-8 pi, 0]).
    """
    blocks = double - 4.0 * np.pi * np.eye(double.shape[-1])
    for motion in rigid.values():
        if motion.mode < len(blocks):
            blocks[motion.mode] -= 4.0 * np.pi * np.outer(motion.amplitude, motion.projector)
    return blocks


@dataclass(frozen=True)
class SurfaceOperators:
    """Double layer (n_modes, 3n, 3n) on a grid with n_phi // 2 + 1 modes, and what follows.

    completion_flows: amplitudes on the surface of the completion of unit force or torque; empty
    where only the mobility problem without force and torque is to be posed.
    """

    grid: SurfaceGrid
    double_layer: Array
    completion_flows: dict[str, Array]

    @cached_property
    def rigid(self) -> dict[str, RigidMode]:
        """Rigid motions of the surface as modes."""
        return rigid_modes(self.grid)

    @cached_property
    def mobility(self) -> ModalOperator:
        """Operator of the mobility problem."""
        blocks = mobility_blocks(self.double_layer, self.rigid)
        return ModalOperator(blocks, self.grid.n_theta, self.grid.n_phi)

    @cached_property
    def resistance(self) -> ModalOperator:
        """Operator of the resistance problem. Raises ValueError without a completion."""
        if not self.completion_flows:
            raise ValueError("the resistance problem needs operators with a completion")
        blocks = resistance_blocks(self.double_layer, self.rigid, self.completion_flows)
        return ModalOperator(blocks, self.grid.n_theta, self.grid.n_phi)

    def motion_of(self, density: Array) -> tuple[Array, Array]:
        """U and Omega (3,) of a mobility density (N, 3), body frame: 4 pi times projections."""
        c = {name: 4.0 * np.pi * value for name, value in self._projections(density).items()}
        return _vectors(c)

    def force_of(self, density: Array) -> tuple[Array, Array]:
        """Force and torque (3,) ON the body of a resistance density (N, 3), body frame."""
        c = {}
        for name, value in self._projections(density).items():
            motion = self.rigid[name]
            c[name] = -force_scale(motion, self.completion_flows[name]) * motion.circle * value
        return _vectors(c)

    def _projections(self, density: Array) -> dict[str, complex]:
        modes = to_modes(density, self.grid.n_theta, self.grid.n_phi)
        # The amplitude of a real mode-1 field is twice its Fourier coefficient.
        return {
            name: complex(motion.projector @ modes[motion.mode])
            * (1.0 + motion.mode)
            / motion.phase
            for name, motion in self.rigid.items()
        }


def _vectors(c: dict[str, complex]) -> tuple[Array, Array]:
    """Vectors of the complex amplitudes: U_x - i U_y and Omega_y + i Omega_x across the axis."""
    t, r = c["translation_transverse"], c["rotation_transverse"]
    return (
        np.array([t.real, -t.imag, c["translation_axial"].real]),
        np.array([r.imag, r.real, c["rotation_axial"].real]),
    )


def surface_operators(
    shape: Revolution,
    scheme: Scheme,
    n_phi: int = 3,
    completion: Completion | None = "surface",
    rows: tuple[Array, Array] | None = None,
) -> SurfaceOperators:
    """Operators on the grid of n_phi azimuthal nodes (3 suffices for the motion of the body).

    completion: None leaves out what force and torque need, the single layer above all. rows: the
    result of `layer_rows` for all independent rows, where these were formed elsewhere; with the
    spread completion it must hold the single layer.
    """
    grid = scheme.grid(shape, n_phi)
    n_modes = n_phi // 2 + 1
    if rows is None:
        wanted = independent_rows(shape, scheme.n_theta)
        rows = layer_rows(shape, scheme, n_modes, wanted, completion == "surface")
    double = blocks_from_rows(rows[0])
    flows = {}
    if completion == "surface":
        flows = surface_completion(grid, blocks_from_rows(rows[1]))
    elif completion == "point":
        flows = point_completion(grid)
    return SurfaceOperators(grid, double, flows)


def form_body_model(operators: SurfaceOperators, solver: SolverFactory = DirectSolver) -> BodyModel:
    """Body model by adjoint solves of the mobility problem.

    The grid functional is left out; `modal_functional` gives it for any number of azimuthal nodes.
    """
    return body_model(operators, modal_functional(operators, solver))


def body_model(operators: SurfaceOperators, functional: ModalFunctional) -> BodyModel:
    """Body model from the solutions of the adjoint problems."""
    coefficients, misfit = faxen_coefficients(functional)
    numbers = resistance(functional, operators.completion_flows)
    return BodyModel(operators.grid.shape, numbers, coefficients, None, misfit)


def modal_functional(
    operators: SurfaceOperators, solver: SolverFactory = DirectSolver
) -> ModalFunctional:
    """Free motion as a functional of the background velocity, by four adjoint solves."""
    solve = solver(operators.mobility, operators.grid).solve_transpose
    weights = adjoint_weights(operators.mobility, operators.rigid, solve)
    return ModalFunctional(operators.grid, weights)
