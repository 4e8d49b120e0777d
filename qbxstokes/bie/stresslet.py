"""The stresslet of a body in a flow: the third row of its law, beside free motion and resistance.

S = oint sym-traceless(x (sigma.n)) dS, traction on the body, in units of mu c^3/tau. From the
density of the mobility problem S = 16 pi sym-traceless(oint psi n dS), which is linear in the
background velocity: with q(E) = 16 pi w n.E for each of five strain rates E,

    S:E = W.u,   W = -A^-T q(E)

by three adjoint solves, one in each of the modes 0, 1 and 2 (see `StressletFunctional`). In a
linear flow the body's symmetry leaves three numbers: with p = D3, w = E p - p (p.E.p),

    S = S0 (3/2) (p.E.p) (pp - I/3) + S1 (p w + w p) + S2 [E_perp + (p.E.p) (I - pp)/2]

for a body free of torque. A hydrodynamic torque T across the axis (of a held, driven or inertial
body) adds (lambda/2) [p (T x p) + (T x p) p], by the reciprocal theorem (S. Kim & S. J. Karrila
1991, Microhydrodynamics, chapters 3 and 5, whose X^M, Y^M, Z^M are S0, S1 held and S2).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

import numpy as np

from qbxstokes.bie.accuracy import ROUNDING_FLOOR, RowFormer, parts_of, perturbed_rows, refined
from qbxstokes.bie.functional import ErrorParts, GridFunctional
from qbxstokes.bie.operators import DirectSolver, SolverFactory, mobility_blocks
from qbxstokes.bie.resolution import MOST_NODES
from qbxstokes.bie.rigid import rigid_modes
from qbxstokes.errors import ConvergenceError, FlowError
from qbxstokes.flows.base import Flow
from qbxstokes.geometry.grid import SurfaceGrid
from qbxstokes.geometry.rotation import matrix
from qbxstokes.geometry.shape import Revolution
from qbxstokes.qbx.modes import ModalOperator, from_modes, to_modes
from qbxstokes.qbx.operator import Scheme, blocks_from_rows, independent_rows, layer_rows
from qbxstokes.typing import Array

# Azimuthal nodes that hold the modes 0, 1 and 2 with none at half their number.
N_PHI = 5
_MODES = 3
# Strain rates of each mode: across and along the axis, oblique, and within the equator.
STRAINS: Array = np.array(
    [
        np.diag([-0.5, -0.5, 1.0]),
        [[0.0, 0.0, 1.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]],
        [[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]],
        np.diag([1.0, -1.0, 0.0]),
        [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]],
    ]
)
_NORMS: Array = np.einsum("aij,aij->a", STRAINS, STRAINS)
# Mode of each strain rate and the phase that turns the first one of its mode into it.
_ROWS = ((0, 1.0), (1, 1.0), (1, -1j), (2, 1.0), (2, -1j))


@dataclass(frozen=True)
class StressletFunctional:
    """Stresslet as a functional of the velocity's modes 0, 1 and 2.

    profiles: for each mode the coefficients of the smooth fields of `_smooth_basis` whose product
    with a flow, integrated over d cos(theta), is S:E. They serve any grid.

    The discrete adjoint solution is no such field as it stands. Nodes tell the polar profile of a
    component up to its parity across the poles, which in mode m lets fields pass that are singular
    there: a smooth one has v_rho + i v_phi ~ sin^(m+1), v_rho - i v_phi ~ sin^|m-1|, v_z ~ sin^m.
    On smooth flows the solution acts rightly, so that its projection on smooth fields is what is
    meant, and the only one that may be interpolated. Without it mode 2 errs by 3e-2 at six nodes.
    """

    grid: SurfaceGrid
    profiles: tuple[Array, Array, Array]

    def on_grid(self, n_phi: int, n_theta: int | None = None) -> GridFunctional:
        """S = einsum('anj,nj->a', weights, u) . STRAINS / (E:E): weights (5, N, 3) of S:E.

        n_phi >= 5 azimuthal and n_theta polar nodes.
        """
        grid = replace(self.grid, n_phi=n_phi, n_theta=n_theta or self.grid.n_theta)
        measure = grid.theta_weights * np.sin(grid.theta)
        rows = []
        for mode, phase in _ROWS:
            profile = self.profiles[mode]
            amplitude = np.tile(measure, 3) * (_smooth_basis(grid, mode, len(profile)) @ profile)
            modes = np.zeros((n_phi // 2 + 1, 3 * grid.n_theta), dtype=np.complex128)
            modes[mode] = phase * amplitude / n_phi
            rows.append(from_modes(modes, grid.n_theta, n_phi))
        return GridFunctional(grid.points, np.stack(rows))

    def numbers(self) -> Array:
        """S0, S1 and S2 (3,), by the linear flows E x."""
        found = []
        surface = self.on_grid(8)
        for row in (0, 1, 3):
            flow = surface.points @ STRAINS[row]
            found.append(float(np.sum(surface.weights[row] * flow)) / _NORMS[row])
        return np.array(found)


@dataclass(frozen=True)
class Stresslet:
    """Stresslet of a body in any flow, and its error in parts; numbers: S0, S1, S2 (3,)."""

    functional: StressletFunctional
    numbers: Array
    error_parts: ErrorParts

    @property
    def error_estimate(self) -> float:
        """Relative error to expect of each of the numbers."""
        return self.error_parts.total

    def to_arrays(self) -> dict[str, Array]:
        """Plain arrays that hold it, for storage; `from_arrays` restores it."""
        parts = np.array([getattr(self.error_parts, field.name) for field in fields(ErrorParts)])
        profiles = {f"profile_{mode}": c for mode, c in enumerate(self.functional.profiles)}
        return {"numbers": self.numbers, "error_parts": parts, **profiles}

    @classmethod
    def from_arrays(cls, grid: SurfaceGrid, arrays: Mapping[str, Array]) -> Stresslet:
        """The stresslet of the arrays that `to_arrays` made, of a body with this grid."""
        one, two, three = (np.asarray(arrays[f"profile_{mode}"]) for mode in range(_MODES))
        return cls(
            StressletFunctional(grid, (one, two, three)),
            np.asarray(arrays["numbers"]),
            ErrorParts(*arrays["error_parts"].tolist()),
        )


def accurate_stresslet(
    shape: Revolution,
    tolerance: float,
    scheme: Scheme,
    *,
    fixed: bool = False,
    strict: bool = True,
    solver: SolverFactory = DirectSolver,
    form_rows: RowFormer = layer_rows,
) -> Stresslet:
    """The stresslet to a relative tolerance, refined from a scheme until the estimate meets it.

    scheme: such as the one that served the body's motion; fixed: it is not to be refined. strict:
    raise ConvergenceError where rounding keeps the estimate above the tolerance.
    """

    def formed(trial: Scheme) -> tuple[Stresslet, ErrorParts]:
        found = _with_estimate(shape, trial, solver, form_rows)
        return found, found.error_parts

    found, parts = refined(formed, scheme, tolerance, fixed)
    if strict and not fixed and parts.total > tolerance:
        raise ConvergenceError(
            f"the estimated error {parts.total:.1e} of the stresslet exceeds the tolerance "
            f"{tolerance:.1e} for the {shape}; set "
            f"hydrodynamics.tolerance to {2.0 * parts.total:.0e} or more"
        )
    return found


def _with_estimate(
    shape: Revolution, scheme: Scheme, solver: SolverFactory, form_rows: RowFormer
) -> Stresslet:
    """The stresslet with its error, told as in `accuracy.estimate_error`: by refinement alone."""
    rows = stresslet_rows(shape, scheme, form_rows)
    functional = stresslet_functional(shape, scheme, solver, rows)

    def change(one: StressletFunctional, other: StressletFunctional) -> float:
        return float(np.max(np.abs(other.numbers() / one.numbers() - 1.0)))

    def formed(other: Scheme) -> StressletFunctional:
        return stresslet_functional(shape, other, form_rows=form_rows)

    direct = functional
    if solver is not DirectSolver:
        direct = stresslet_functional(shape, scheme, rows=rows)
    # That of the panels of a flat body moves all entries alike, which no perturbation shows.
    rounding = ROUNDING_FLOOR * max(1.0, 0.5 * shape.radius) + max(
        change(functional, stresslet_functional(shape, scheme, rows=moved))
        for moved in perturbed_rows(functional.grid, scheme, rows)
    )
    off = change(functional, direct)
    parts = parts_of(functional, scheme, formed, change, _tail, off, rounding)
    return Stresslet(functional, functional.numbers(), parts)


def _tail(functional: StressletFunctional) -> float:
    """Last two moments of each component of the weights relative to the largest one."""
    worst = 0.0
    for mode, profile in enumerate(functional.profiles):
        sizes = [max(0, functional.grid.n_theta - power) for power in _powers(mode)]
        moments = [
            np.abs(part / (np.arange(len(part)) + 0.5))
            for part in np.split(profile, np.cumsum(sizes)[:-1])
            if len(part)
        ]
        largest = max(float(part.max()) for part in moments)
        worst = max(worst, *(float(part[-2:].max()) / largest for part in moments))
    return worst


def stresslet_functional(
    shape: Revolution,
    scheme: Scheme,
    solver: SolverFactory = DirectSolver,
    rows: Array | None = None,
    form_rows: RowFormer = layer_rows,
) -> StressletFunctional:
    """The functional by three adjoint solves of the mobility problem.

    rows: of the double layer in three modes (`stresslet_rows`), where they were formed before.
    """
    grid = scheme.grid(shape, N_PHI)
    if rows is None:
        rows = stresslet_rows(shape, scheme, form_rows)
    rigid = rigid_modes(grid)
    blocks = mobility_blocks(blocks_from_rows(rows), rigid)
    operator = ModalOperator(blocks, grid.n_theta, N_PHI)
    solve = solver(operator, grid).solve_transpose
    weights = grid.theta_weights * shape.area_element(grid.theta)
    profiles = []
    for mode, strain in enumerate(_strain_amplitudes(grid)):
        circle = 2.0 * math.pi if mode == 0 else math.pi
        modes = np.zeros((_MODES, strain.size), dtype=np.complex128)
        modes[mode] = np.tile(weights, 3) * strain
        field = solve(from_modes(modes, grid.n_theta, N_PHI))
        raw = -16.0 * math.pi * circle * to_modes(field, grid.n_theta, N_PHI)[mode].real
        basis = _smooth_basis(grid, mode)
        measure = np.tile(grid.theta_weights * np.sin(grid.theta), 3)
        mass = basis.T @ (measure[:, None] * basis)
        profile = np.linalg.solve(mass, basis.T @ raw)
        # Rigid motions have no stresslet: what rounding gives them would cost four digits of the
        # small S1 of a slender body, whose flow E x is a rotation but for k^2.
        for motion in rigid.values():
            if motion.mode == mode:
                still = np.linalg.solve(mass, basis.T @ (measure * motion.amplitude))
                profile -= still * (profile @ mass @ still) / (still @ mass @ still)
        profiles.append(profile)
    return StressletFunctional(grid, (profiles[0], profiles[1], profiles[2]))


def stresslet_rows(shape: Revolution, scheme: Scheme, form_rows: RowFormer = layer_rows) -> Array:
    """Independent rows of the double layer in the modes 0, 1 and 2."""
    return form_rows(shape, scheme, _MODES, independent_rows(shape, scheme.n_theta), False)[0]


def stresslet_of(functional: GridFunctional, velocity: Array) -> Array:
    """Stresslets (..., 3, 3), body frame, free of torque, of a flow (..., N, 3) on the grid."""
    parts = np.tensordot(velocity, functional.weights, axes=((-2, -1), (1, 2)))
    return np.asarray(np.tensordot(parts / _NORMS, STRAINS, axes=1))


def _strain_amplitudes(grid: SurfaceGrid) -> tuple[Array, Array, Array]:
    """Amplitudes (3 n_theta,) of n.E for the first strain rate of each mode."""
    normal = grid.shape.normal(grid.theta, 0.0)
    across, along = normal[:, 0], normal[:, 2]
    nothing = np.zeros_like(along)
    return (
        np.concatenate([-0.5 * across, nothing, along]),
        np.concatenate([along, along, across]),
        np.concatenate([across, across, nothing]),
    )


def _powers(mode: int) -> tuple[int, int, int]:
    """Powers of sin(theta) in a + b, a - b and v_z of a smooth field of a mode."""
    return abs(mode - 1), mode + 1, mode


def _smooth_basis(grid: SurfaceGrid, mode: int, size: int | None = None) -> Array:
    """Amplitudes (3 n_theta, n) of smooth fields of a mode: polynomials of degree < n_nodes.

    In the components a, b (v_rho = a cos m phi, v_phi = -b sin m phi) v_x + i v_y is
    (a - b)/2 e^{i(m+1) phi} + (a + b)/2 e^{-i(m-1) phi}. size: the number of fields, where another
    grid's are asked for (all of them are polynomials of the degree that it belongs to).
    """
    degree, cosine, sine = grid.n_theta - 1, np.cos(grid.theta), np.sin(grid.theta)
    powers = _powers(mode)
    if size is not None:  # 3 degree + 3 less the sum of the powers
        degree = (size + sum(powers)) // 3 - 1
    zero = np.zeros_like(cosine)
    columns = []
    for kind, power in enumerate(powers):
        for order in range(degree + 1 - power):
            values = sine**power * np.polynomial.legendre.Legendre.basis(order)(cosine)
            parts = ([values, values, zero], [values, -values, zero], [zero, zero, values])[kind]
            columns.append(np.concatenate(parts))
    return np.stack(columns, axis=1)


class GridStress:
    """Stresslets of bodies in a flow of any kind, on grids that prove fine enough.

    As in `providers.MonitoredGridMotion` every body is computed on two grids, the coarser of two
    thirds of the nodes, and both grow by a quarter until the finer one, which errs by the power 3/2
    of what the coarser does, meets the tolerance.
    """

    def __init__(
        self,
        stresslet: Stresslet,
        flow: Flow,
        tolerance: float,
        start: tuple[int, int] = (12, 12),
    ) -> None:
        self._functional, self._flow = stresslet.functional, flow
        self._largest = float(np.max(np.abs(stresslet.numbers)))
        # A digit below the power of the tolerance: the rate is known up to a factor.
        self._least, self._start = 0.1 * tolerance ** (2.0 / 3.0), start
        self._levels: dict[tuple[int, int], GridFunctional] = {}

    def stresslet(self, t: float, x: Array, q: Array) -> Array:
        """S (n, 3, 3) in space, free of torque, at positions x (n, 3), orientations q (n, 4)."""
        rotation, found = matrix(q), np.full((len(x), 3, 3), np.nan)
        waiting, level = np.arange(len(x)), self._start
        while len(waiting):
            places, turns = x[waiting], rotation[waiting]
            polar, azimuthal = (max(6, 2 * nodes // 3) for nodes in level)
            rough, _ = self._at(t, places, turns, (polar, azimuthal))
            found[waiting], speed = self._at(t, places, turns, level)
            with np.errstate(invalid="ignore"):
                change = np.abs(found[waiting] - rough).max(axis=(1, 2))
                # What vanishes by symmetry is held against a strain that the flow might have.
                scale = np.abs(found[waiting]).max(axis=(1, 2))
                scale = np.maximum(scale, 0.01 * self._largest * speed)
                poor = np.isfinite(change) & (change > self._least * scale)
            if level[0] >= MOST_NODES and poor.any():
                where = ", ".join(f"{value:.6g}" for value in x[waiting[poor][0]])
                raise FlowError(
                    f"at t = {t:.6g}, body at ({where}): the flow varies too much over the body: "
                    f"its stresslet still changes by {np.max(change[poor]):.1e} between grids of "
                    f"up to {level[0]} x {level[1]} points"
                )
            waiting = waiting[poor]
            level = _finer(level[0]), _finer(level[1])
        return np.asarray(rotation @ found @ rotation.swapaxes(1, 2))

    def _at(
        self, t: float, x: Array, rotation: Array, level: tuple[int, int]
    ) -> tuple[Array, Array]:
        """Stresslets (n, 3, 3) in the body frame on one grid, and the flow's variation there."""
        if level not in self._levels:
            self._levels[level] = self._functional.on_grid(level[1], level[0])
        functional = self._levels[level]
        points = x[:, None, :] + functional.points @ rotation.swapaxes(1, 2)
        with np.errstate(invalid="ignore"):
            u = self._flow.velocity(points, t) @ rotation
            u = u - u.mean(axis=1, keepdims=True)
            speed = np.max(np.linalg.norm(u, axis=-1), axis=-1)
        return stresslet_of(functional, u), speed / self._functional.grid.shape.radius


def _finer(nodes: int) -> int:
    """A quarter more nodes, an even number."""
    return min(MOST_NODES, 2 * math.ceil(0.625 * nodes))
