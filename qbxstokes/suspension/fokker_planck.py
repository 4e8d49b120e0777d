"""Orientations of Brownian particles in a homogeneous flow, by spherical harmonics (Galerkin).

The density psi(p, t) of axes p on the unit sphere obeys

    d psi/dt = D lap psi - div(pdot psi),   pdot = (w/2) x p + lambda [E p - p (p.E.p)]

(L. G. Leal & E. J. Hinch 1971, J. Fluid Mech. 46, 685; H. Brenner 1974, Int. J. Multiphase Flow 1,
195). Time is measured by the flow's rate sqrt(2 E:E), so that D = 1/Pe. Every matrix element is
algebraic (`harmonics`); a steady density is one sparse LU, a transient an explicit Runge-Kutta
method of order eight (an implicit one where diffusion is stiff). The LU is SciPy's.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from qbxstokes.errors import ConvergenceError
from qbxstokes.suspension.distribution import Distribution
from qbxstokes.suspension.harmonics import Harmonics
from qbxstokes.suspension.particle import LinearFlow
from qbxstokes.typing import Array

# Truncation: never above this degree; grown by this factor until nothing changes.
_MOST, _GROWTH = 480, 1.25
# Parts of the flow below this are rounding.
_ROUNDING = 1e-13
# Time over the fastest decay from which an explicit method would crawl.
_STIFF = 1e5


@dataclass(frozen=True)
class Transport:
    """The flow of orientations in one homogeneous flow, without its diffusion.

    flow: whose gradient is taken over its rate. linear: lambda of the body.
    """

    flow: LinearFlow
    linear: float

    @cached_property
    def frame(self) -> tuple[Array, int]:
        """Axes (rows, (3, 3)) of the harmonics, polar axis last, and the step of their orders.

        With the polar axis along vorticity and a principal axis of strain, even orders suffice.
        """
        strain, spin = self.flow.strain, self.flow.spin
        speed = float(np.linalg.norm(spin))
        pole = spin / speed if speed > _ROUNDING else np.linalg.eigh(strain)[1][:, 2]
        stretched = strain @ pole
        if np.linalg.norm(stretched - (pole @ stretched) * pole) > _ROUNDING:
            return np.eye(3), 1
        first = np.eye(3)[int(np.argmin(np.abs(pole)))]
        first = first - (first @ pole) * pole
        first /= np.linalg.norm(first)
        return np.stack([first, np.cross(pole, first), pole]), 2

    @property
    def matrix(self) -> Array:
        """W + lambda E (3, 3), over the rate: y' = M y of an axis y/|y|."""
        g = self.flow.gradient / self.flow.rate
        return np.asarray(0.5 * (g - g.T) + self.linear * self.flow.strain)

    def first_degree(self, peclet: float, tolerance: float) -> int:
        """A truncation to begin with.

        About 4 Pe^(1/3), until the body's elongation limits it. Where axes are drawn to a direction
        or a plane at a rate g, Gaussian peaks of variance 1/(g Pe), whose harmonics fall as
        exp(-l^2/(2 g Pe)), and the error of the stress as their square.
        """
        nearly = max(1e-6, 1.0 - min(1.0, abs(self.linear)))
        elongation = np.sqrt((1.0 + abs(self.linear)) / nearly)
        smooth = 8 + 2 * int(min(2.0 * peclet ** (1.0 / 3.0), 4.0 * elongation))
        drawn = float(np.ptp(np.linalg.eigvals(self.matrix).real))
        peaked = 2 * int(0.5 * np.sqrt(-drawn * peclet * np.log(0.1 * tolerance)))
        return min(max(smooth, peaked), _MOST // 2)

    def operators(self, degree: int) -> tuple[Harmonics, Any, Array]:
        """The basis, the matrix of -div(pdot psi) in it, and the eigenvalues (n,) of lap."""
        axes, step = self.frame
        basis = Harmonics(degree, step)
        strain, spin = axes @ self.flow.strain @ axes.T, axes @ self.flow.spin
        if step == 2:  # what vanishes in exact arithmetic
            strain[2, :2] = strain[:2, 2] = 0.0
        moved = basis.rotation(spin) + self.linear * basis.drift(strain)
        degrees = basis.degrees.astype(np.float64)
        return basis, basis.real_matrix(moved).tocsr(), -degrees * (degrees + 1.0)

    def steady(self, diffusivity: float, degree: int) -> Distribution:
        """The steady density, truncated at a degree."""
        from scipy.sparse import diags_array
        from scipy.sparse.linalg import splu

        basis, moved, laplacian = self.operators(degree)
        matrix = (moved + diags_array(diffusivity * laplacian)).tocsc()
        coefficients = isotropic(basis)
        source = np.asarray((matrix[:, [0]] @ coefficients[:1])[1:])
        # The pattern is symmetric: with the diagonal as pivots the factors fill half as much as by
        # any other ordering, and one step of refinement makes up for what the pivots lose.
        options = {"permc_spec": "MMD_AT_PLUS_A", "options": {"SymmetricMode": True}}
        inner = matrix[1:, 1:]
        factors = splu(inner, diag_pivot_thresh=0.0, **options)
        found = factors.solve(-source)
        coefficients[1:] = found - factors.solve(inner @ found + source)
        return Distribution(basis, self.frame[0], coefficients)


def isotropic(basis: Harmonics) -> Array:
    """Coefficients (n,) of the density 1/(4 pi)."""
    found = np.zeros(basis.size)
    found[0] = 1.0 / np.sqrt(4.0 * np.pi)
    return found


def converged(
    compute: Callable[[int], tuple[Any, Array]], start: int, tolerance: float
) -> tuple[Any, Array, float]:
    """The result at a degree from which a finer truncation changes the values no more.

    compute: degree -> result and values (..., 3, 3). Returns both of the finest truncation and the
    last relative change, which exceeds the error that is left. Raises ConvergenceError.
    """
    degree = start
    _, coarse = compute(degree)
    while True:
        degree = degree + max(4, 2 * int(0.5 * (_GROWTH - 1.0) * degree))
        result, values = compute(degree)
        size = float(np.max(np.abs(values)))
        change = float(np.max(np.abs(values - coarse))) / size if size else 0.0
        if change <= tolerance:
            return result, values, change
        if degree * _GROWTH > _MOST:
            right = "take a smaller peclet_number"
            if change < 0.03:
                right += f" or a tolerance of {2.0 * change:.0e}"
            raise ConvergenceError(
                f"the distribution of orientations is too sharp: its stress still changes by "
                f"{change:.1e} at degree {degree}; {right}"
            )
        coarse = values


@dataclass(frozen=True)
class Evolution:
    """Transients at one degree: d c/dt = rate(t) M c + D lap c."""

    transport: Transport
    diffusivity: float
    degree: int
    tolerance: float

    @cached_property
    def operators(self) -> tuple[Harmonics, Any, Array]:
        """See `Transport.operators`."""
        return self.transport.operators(self.degree)

    def run(self, start: Array, times: Array, rate: Callable[[float], float]) -> Array:
        """Coefficients (n, T) at increasing times from 0; rate: of the flow, over its own."""
        from scipy.integrate import solve_ivp
        from scipy.sparse import diags_array

        _, moved, laplacian = self.operators
        spread = self.diffusivity * laplacian
        end = max(float(times[-1]), 1e-300)
        stiff = -float(spread.min()) * end > _STIFF

        def change(t: float, c: Array) -> Array:
            return np.asarray(rate(t) * (moved @ c) + (spread * c.T).T)

        more: dict[str, Any] = {"method": "DOP853"}
        if stiff:
            more = {
                "method": "Radau",
                "jac": lambda t, c: (rate(t) * moved + diags_array(spread)).tocsc(),
            }
        found = solve_ivp(
            change,
            (0.0, end),
            start,
            t_eval=times,
            rtol=max(0.1 * self.tolerance, 3e-14),
            atol=0.01 * self.tolerance,
            **more,
        )
        if not found.success:
            raise ConvergenceError(f"the orientations could not be followed: {found.message}")
        return np.asarray(found.y)

    def periodic(self, period: float, rate: Callable[[float], float]) -> Array:
        """Coefficients (n,) at the begin of a period of the state that repeats itself.

        The period's map is affine, c -> P c + b, and contracts: GMRES on (1 - P) c = b.
        """
        from scipy.sparse.linalg import LinearOperator, gmres

        basis = self.operators[0]
        rest, ends = isotropic(basis), np.array([period])
        # An error of one period adds up over as many as the slowest part, l = 2, lives.
        share = min(1.0, 6.0 * self.diffusivity * period)
        finer = replace(self, tolerance=self.tolerance * share)

        def after(c: Array) -> Array:
            return finer.run(c, ends, rate)[:, 0]

        source = after(rest) - rest

        def defect(c: Array) -> Array:
            # The density's integral is kept: the first coefficient has no part in it.
            return np.asarray(c - (after(rest + c) - rest - source))

        operator = LinearOperator((basis.size, basis.size), matvec=defect, dtype=np.float64)
        size = float(np.linalg.norm(source))
        limit = self.tolerance * share
        found, _ = gmres(operator, source, rtol=limit, atol=1e-15, restart=60, maxiter=3)
        residual = float(np.linalg.norm(defect(found) - source))
        if residual > 10.0 * limit * max(size, 0.1):
            raise ConvergenceError(
                f"the periodic state of the orientations was not found: residual {residual:.1e}"
            )
        return np.asarray(rest + found)
