"""The body model: everything the motion needs to know of the hydrodynamics.

Force, torque and free motion of a rigid body in a Stokes flow are linear functionals of the
background velocity. For a body of revolution with fore-aft symmetry the functional takes a closed
structure with few coefficients for polynomial flows (`FaxenCoefficients`, `Resistance`) and is a
weighted sum over the surface grid for any other flow (`GridFunctional`).
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from typing import ClassVar

import numpy as np

from qbxstokes.bie.rigid import RigidMode
from qbxstokes.geometry.grid import SurfaceGrid
from qbxstokes.geometry.registry import build_shape
from qbxstokes.geometry.shape import Shape
from qbxstokes.qbx.modes import ModalOperator, from_modes, to_modes
from qbxstokes.typing import Array


@dataclass(frozen=True)
class Resistance:
    """Force and torque per unit velocity: F = -R V, M = -R Omega (body frame, mu = 1).

    Units: translation in mu c, rotation in mu c^3. Sphere of radius 1: 6 pi and 8 pi.
    """

    translation_transverse: float
    translation_axial: float
    rotation_transverse: float
    rotation_axial: float

    @property
    def matrix(self) -> Array:
        """R (6, 6) about the centre, body frame: (force, torque) ON the body = -R (V, Omega)."""
        across, about = self.translation_transverse, self.rotation_transverse
        return np.diag([across, across, self.translation_axial, about, about, self.rotation_axial])

    @property
    def mobility(self) -> Array:
        """M (6, 6) = R^-1: (V, Omega) = M (force, torque) from outside."""
        return np.diag(1.0 / np.diag(self.matrix))


@dataclass(frozen=True)
class FaxenCoefficients:
    """Coefficients of the free motion in a Stokes flow of polynomial degree <= 3.

    With d = D3, derivatives of the background flow u taken at the centre, w = curl u and
    E = sym grad u, the free velocity and angular velocity are (summation over repeated indices)

        U     = u + q0 Lap u + q1 (d.grad)^2 u + q2 d (d.Lap u)
                  + q3 d (d.(d.grad)^2 u) + q4 grad(d.(d.grad) u)
        Omega = w/2 + lambda d x (E d) + c0 (d.grad)^2 w + c1 d (d.(d.grad)^2 w)
                  + c2 d x ((Lap E) d) + c3 d x (((d.grad)^2 E) d)

    which is the most general law for this symmetry: a Stokes flow of degree 2 (3) holds three
    irreducible representations of the rotation group and the body's symmetry leaves five (four)
    free coefficients. `linear` is lambda, `quadratic` (5,) is q, `cubic` (4,) is c.

    The motion is computed from lambda and 1/2 - |lambda|/2, for a spheroid k^2/(1 + k^2) (k < 1) or
    1/(1 + k^2), and likewise from c3 and c0 - |c3|/2: `small` and `small_of_second` are these
    differences where they are known to more digits than subtraction leaves.
    """

    # The class of laws, which tells the kernels of the motion.
    symmetry: ClassVar[str] = "fore-aft revolution"

    linear: float
    quadratic: Array
    cubic: Array
    small: float | None = None
    small_of_second: float | None = None

    @property
    def rest(self) -> float:
        """1/2 - |lambda|/2."""
        return 0.5 - 0.5 * abs(self.linear) if self.small is None else self.small

    @property
    def rest_of_second(self) -> float:
        """c0 - |c3|/2."""
        if self.small_of_second is not None:
            return self.small_of_second
        return float(self.cubic[0] - 0.5 * abs(self.cubic[3]))


# Numbers of the law that may be missing.
_SMALL = ("small", "small_of_second")


@dataclass(frozen=True)
class GridFunctional:
    """Free motion from the background velocity on the surface grid, in the body frame.

    points: (N, 3); weights: (6, N, 3). (U, Omega) = einsum('anj,nj->a', weights, u(points)).
    """

    points: Array
    weights: Array


@dataclass(frozen=True)
class ErrorParts:
    """Estimated relative errors of the body model by cause, from `accuracy.estimate_error`.

    quadrature: the source panels. truncation: the order of the expansions. resolution: the nodes
    that carry the density. solver: the tolerance of the linear solves. rounding: the arithmetic,
    magnified by the condition number.
    """

    quadrature: float
    truncation: float
    resolution: float
    solver: float
    rounding: float

    @property
    def total(self) -> float:
        """Sum of the parts."""
        return float(sum(getattr(self, field.name) for field in fields(self)))


@dataclass(frozen=True)
class BodyModel:
    """Hydrodynamics of one body, formed once per shape and discretisation.

    formed_resistance: None where it was left out, for bodies on which no force acts.
    error_estimate: relative error of resistance and free motion; without error_parts only the
    misfit of the law for polynomial flows.
    """

    shape: Shape
    formed_resistance: Resistance | None
    faxen: FaxenCoefficients
    grid: GridFunctional | None
    error_estimate: float
    error_parts: ErrorParts | None = None

    @property
    def effective_ratio(self) -> float:
        """k of the spheroid whose axis moves alike in every linear flow; NaN where none does.

        lambda = (1 - k^2)/(1 + k^2) (Bretherton 1962, J. Fluid Mech. 14, eq. 15 f.), from the shape
        where it knows it without rounding.
        """
        if self.shape.effective_ratio is not None:
            return self.shape.effective_ratio
        rest = self.faxen.rest
        squared = rest / (1.0 - rest) if self.faxen.linear >= 0.0 else (1.0 - rest) / rest
        return math.sqrt(squared) if squared > 0.0 else math.nan

    @property
    def resistance(self) -> Resistance:
        """The resistance. Raises ValueError where it was not formed."""
        if self.formed_resistance is None:
            raise ValueError("this body model was formed without the resistance")
        return self.formed_resistance

    def to_arrays(self) -> dict[str, Array]:
        """Plain arrays that hold the model, for storage; `from_arrays` restores it."""
        f = self.faxen
        arrays = {
            "shape": np.array(json.dumps(self.shape.spec())),
            "linear": np.array(f.linear),
            "quadratic": f.quadratic,
            "cubic": f.cubic,
            "error_estimate": np.array(self.error_estimate),
        }
        for name in _SMALL:
            if getattr(f, name) is not None:
                arrays[name] = np.array(getattr(f, name))
        if self.formed_resistance is not None:
            arrays["resistance"] = np.array(list(vars(self.resistance).values()))
        if self.grid is not None:
            arrays |= {"points": self.grid.points, "weights": self.grid.weights}
        if self.error_parts is not None:
            parts = [getattr(self.error_parts, field.name) for field in fields(ErrorParts)]
            arrays["error_parts"] = np.array(parts)
        return arrays

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Array]) -> BodyModel:
        """Model of the arrays that `to_arrays` made."""
        grid = GridFunctional(arrays["points"], arrays["weights"]) if "points" in arrays else None
        return cls(
            build_shape(shape=json.loads(str(arrays["shape"]))),
            Resistance(*arrays["resistance"].tolist()) if "resistance" in arrays else None,
            FaxenCoefficients(
                float(arrays["linear"]),
                np.asarray(arrays["quadratic"]),
                np.asarray(arrays["cubic"]),
                **{name: float(arrays[name]) for name in _SMALL if name in arrays},
            ),
            grid,
            float(arrays["error_estimate"]),
            ErrorParts(*arrays["error_parts"].tolist()) if "error_parts" in arrays else None,
        )


@dataclass(frozen=True)
class ModalFunctional:
    """Free motion as a functional of the velocity's modes 0 and 1, by kind of rigid motion.

    weights: name of a rigid motion (see `rigid_modes`) -> amplitude (3 n_theta,). One set serves
    every azimuthal resolution and every flow, since no other mode moves the body.
    """

    grid: SurfaceGrid
    weights: dict[str, Array]

    def profiles(self) -> dict[str, Array]:
        """Legendre coefficients (3, n_theta) of the smooth factor of each weight, by component.

        weight = quadrature weight * P(cos theta), times sin(theta) for the components that are odd
        across the pole. The decay of the coefficients shows whether the nodes resolve the adjoint
        density. For nodes in cos(theta) alone.
        """
        vander, _ = _legendre(self.grid)
        norms = np.arange(self.grid.n_theta) + 0.5
        return {
            name: (weight.reshape(3, -1) / _parity(self.grid, name)) @ vander * norms
            for name, weight in self.weights.items()
        }

    def prolonged(self, n_theta: int) -> ModalFunctional:
        """The same functional on n_theta nodes, by interpolation of the smooth factors.

        Gauss weights make it exact for every flow whose polar profile the new nodes resolve, which
        takes half as many nodes as resolving the density in that flow.
        """
        grid = replace(self.grid, n_theta=n_theta)
        if grid == self.grid:
            return self
        vander, measure = _legendre(grid)
        degrees = min(n_theta, self.grid.n_theta)
        weights = {
            name: (measure * _parity(grid, name) * (c[:, :degrees] @ vander[:, :degrees].T)).ravel()
            for name, c in self.profiles().items()
        }
        return ModalFunctional(grid, weights)

    def on_grid(self, n_phi: int, n_theta: int | None = None) -> GridFunctional:
        """The functional on the surface grid with n_phi >= 3 azimuthal nodes.

        n_theta: polar nodes, if not those on which the functional was formed (`prolonged`).
        """
        if n_theta is not None and n_theta != self.grid.n_theta:
            return self.prolonged(n_theta).on_grid(n_phi)
        grid = replace(self.grid, n_phi=n_phi)
        rows = []
        for name, factors in (
            ("translation_transverse", (1.0, -1j)),
            ("translation_axial", (1.0,)),
            ("rotation_transverse", (1j, 1.0)),
            ("rotation_axial", (1j,)),
        ):
            for factor in factors:
                modes = np.zeros((n_phi // 2 + 1, 3 * grid.n_theta), dtype=np.complex128)
                mode = 0 if name.endswith("axial") else 1
                modes[mode] = factor * self.weights[name] / n_phi
                rows.append(from_modes(modes, grid.n_theta, n_phi))
        return GridFunctional(grid.points, np.stack(rows))


def _legendre(grid: SurfaceGrid) -> tuple[Array, Array]:
    """P_l at the nodes in cos(theta), (n_theta, n_theta), and the weights of d cos(theta)."""
    if grid.nodes != "cosine":
        raise ValueError("Legendre coefficients need nodes in cos(theta)")
    values = np.polynomial.legendre.legvander(np.cos(grid.theta), grid.n_theta - 1)
    return values, grid.theta_weights * np.sin(grid.theta)


def _parity(grid: SurfaceGrid, name: str) -> Array:
    """Factor (3, n_theta) of the components of a weight that are odd across the pole."""
    sine, one = np.sin(grid.theta), np.ones(grid.n_theta)
    return np.stack([sine, sine, one] if name.endswith("axial") else [one, one, sine])


def adjoint_weights(
    operator: ModalOperator,
    rigid: dict[str, RigidMode],
    solve_transpose: Callable[[Array], Array] | None = None,
) -> dict[str, Array]:
    """Weights of the free motion: -4 pi A^-T projector for each kind of rigid motion.

    operator: the mobility operator on a grid with n_phi >= 3. solve_transpose maps a grid field
    (N, 3) to the solution of the transposed system; without it the blocks are inverted directly.
    Transverse motions along y follow from those along x by rotation: four solves, not six.
    """
    solve = solve_transpose or operator.inverse.apply_transpose
    weights = {}
    for name, motion in rigid.items():
        modes = np.zeros((operator.n_phi // 2 + 1, motion.projector.size), dtype=np.complex128)
        modes[motion.mode] = motion.phase * motion.projector
        field = solve(from_modes(modes, operator.n_theta, operator.n_phi))
        solution = to_modes(field, operator.n_theta, operator.n_phi)[motion.mode]
        weights[name] = -4.0 * np.pi * (solution / motion.phase).real
    return weights


def resistance(functional: ModalFunctional, completion: dict[str, Array]) -> Resistance | None:
    """Resistance from the free motion of the body pushed by a completion of unit force or torque.

    The mobility problem with that force has the completion flow as its data: U = R^-1 F. None
    without a completion. A sphere has one resistance for every direction, the mean.
    """
    if not completion:
        return None
    weights = functional.weights
    pushed = {name: float(weights[name] @ completion[name]) for name in weights}
    # A scheme without accuracy may not move the body at all.
    numbers = {name: 1.0 / speed if speed else math.inf for name, speed in pushed.items()}
    if functional.grid.shape.symmetry == "sphere":
        for kind in ("translation", "rotation"):
            across, along = f"{kind}_transverse", f"{kind}_axial"
            mean = (2.0 * numbers[across] + numbers[along]) / 3.0
            numbers |= {across: mean, along: mean}
    return Resistance(**numbers)
