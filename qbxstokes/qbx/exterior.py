"""Exterior Stokes flows of a spheroid as sums of exterior spheroidal harmonics.

The layer potentials of a rigid body are Stokes flows outside it, and every such flow without net
flux is a single layer of some density on the surface. With the measure sin(theta) dtheta dphi (the
weight of the support function) the Laplace single layer is diagonal in spheroidal harmonics
(Hobson 1931, sec. 245 f.), so that the Stokes single layer

    S_i[mu] = (1/8 pi) (P_i - x_j d_i P_j + d_i R),   P_j = int mu_j / r,  R = int y_j mu_j / r

is four short sums, finite where the density is a polynomial: a table of the flow that holds from
the surface to infinity. It is tabulated from what the integral equation gives on the surface.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from qbxstokes.geometry.grid import SurfaceGrid
from qbxstokes.geometry.symmetric import symmetric
from qbxstokes.qbx.confocal import Harmonics, triangle
from qbxstokes.typing import Array, Integers

# What a Stokes flow is asked for at points, and the shape of it at each: d u_i / d x_j is
# gradient[i, j], stress the components xx, yy, zz, xy, xz, yz.
WHAT: dict[str, tuple[int, ...]] = {
    "velocity": (3,),
    "gradient": (3, 3),
    "pressure": (),
    "pressure_gradient": (3,),
    "stress": (6,),
}
# Slack of "outside" in the sum of squares that is 1 on the surface: rounding of coordinates.
SURFACE_MARGIN = 1e-12
# Singular values of the single layer below this are its null space (the normal's pressure).
_RANK_TOLERANCE = 1e-13


def values_of(numbers: Array, what: Collection[str] = tuple(WHAT)) -> dict[str, Array]:
    """Some of WHAT from rows of u, p, stress, vorticity and the pressure's gradient, (N, 16)."""
    places: dict[str, Any] = {
        "velocity": slice(3),
        "pressure": 3,
        "stress": slice(4, 10),
        "pressure_gradient": slice(13, 16),
    }
    found = {
        name: np.ascontiguousarray(numbers[:, place])
        for name, place in places.items()
        if name in what
    }
    stress, spin, pressure = numbers[:, 4:10], numbers[:, 10:13], numbers[:, 3, None, None]
    if "gradient" in what:  # half of stress + p I, and what turns with the vorticity
        turning = np.cross(spin[:, None], np.eye(3))
        found["gradient"] = 0.5 * (symmetric(stress) - turning + pressure * np.eye(3))
    return found


@dataclass(frozen=True)
class ExteriorFlow:
    """A Stokes flow outside the spheroid that decays at infinity, in the body frame.

    coefficients (4, 2 K): B_x, B_y, B_z and C of u = B + grad(C - x . B) (x held fixed under the
    gradient), the real parts of sums of c_nm E_nm, packed (`confocal.triangle`).
    """

    harmonics: Harmonics
    coefficients: Array

    @cached_property
    def _places(self) -> tuple[Array, Integers, Integers]:
        """Sizes (4, K) of the coefficients, orders and degrees (K,)."""
        orders, degrees, _ = triangle(self.harmonics.orders, self.harmonics.degree)
        return np.abs(self.coefficients.view(np.complex128)), orders, degrees

    @cached_property
    def amplitude(self) -> Array:
        """Bound (degree + 1,) of what each degree adds to the velocity on the surface."""
        k, (sizes, _, degrees) = self.harmonics.ratio_of_axes, self._places
        n = np.arange(self.harmonics.degree + 1)
        size = np.bincount(degrees, sizes.sum(axis=0), len(n))
        return np.asarray(size * np.sqrt(n + 0.5) * (n + 1.0) / min(k * k, 1.0))

    def trimmed(self) -> ExteriorFlow:
        """The same flow without highest orders and degrees of relative amplitude <= 1e-15."""
        sizes, orders, degrees = self._places
        kept = sizes.max(axis=0) > 1e-15 * sizes.max()
        if not kept.any():
            return self
        order, degree = max(int(orders[kept].max()), 1), max(int(degrees[kept].max()), 1)
        inside = np.repeat((orders <= order) & (degrees <= degree), 2)
        harmonics = Harmonics(self.harmonics.shape, order + 1, degree)
        return ExteriorFlow(harmonics, np.ascontiguousarray(self.coefficients[:, inside]))

    def evaluate(
        self, points: Array, what: Collection[str] = ("velocity",), tolerance: float = 0.0
    ) -> dict[str, Array]:
        """Velocity, pressure and what else of WHAT is asked for, at points (N, 3).

        NaN inside the body. tolerance: absolute error of the velocity that may be made by leaving
        out high degrees far from the body; 0 leaves out none.
        """
        from qbxstokes.qbx.exterior_sums import evaluate

        h, size = self.harmonics, self.amplitude
        if {"gradient", "pressure_gradient"} & set(what):
            size = size * (np.arange(len(size)) + 1.0)
        out = np.empty((len(points), 16 if set(what) - {"velocity", "pressure"} else 4))
        evaluate(
            np.ascontiguousarray(points, dtype=float),
            h.ratio_of_axes,
            self.coefficients,
            h.orders,
            h.start,
            h.recurrence,
            size,
            tolerance,
            SURFACE_MARGIN,
            out,
        )
        return values_of(out, {"velocity", "pressure", *what})


@dataclass(frozen=True)
class SurfaceToExterior:
    """The linear map from a velocity on the surface grid to the exterior flow it belongs to.

    degree: of the spheroidal harmonics of the single-layer density; n_theta - 2 is as far as the
    grid resolves them, and the degree of a polynomial velocity is enough for it.
    """

    grid: SurfaceGrid
    degree: int

    @cached_property
    def harmonics(self) -> Harmonics:
        """Harmonics of the exterior flow: those of the density and one order and degree more."""
        return Harmonics(self.grid.shape, self._n_modes + 1, self.degree + 1)

    @property
    def _n_modes(self) -> int:
        # The highest mode of an even grid stands for two and is left out.
        return (self.grid.n_phi + 1) // 2

    @cached_property
    def shape_of_flows(self) -> tuple[int, int]:
        """Shape of the packed coefficients of a flow."""
        return 4, 2 * len(triangle(self.harmonics.orders, self.harmonics.degree)[0])

    @cached_property
    def _scale(self) -> Array:
        return np.asarray(np.sqrt(self.grid.theta_weights * np.sin(self.grid.theta)))

    @cached_property
    def _blocks(self) -> tuple[Array, Array]:
        """Padded blocks: data -> (part, degree) of the density, and density -> C, by mode."""
        h, n_theta, size = self.harmonics, self.grid.n_theta, self.degree + 1
        inverse = np.zeros((self._n_modes, 3, size, 3 * n_theta))
        moments = np.zeros((self._n_modes, h.degree + 1, 3 * size))
        scale = np.tile(self._scale, 3)
        for m in range(self._n_modes):
            begin, (block, moment) = 0, self._block(m)
            for part, order in enumerate((m + 1, abs(m - 1), m)):
                here = slice(begin, begin + max(size - order, 0))
                inverse[m, part, order:] = block[here] * scale
                moments[m].reshape(-1, 3, size)[:, part, order:] = moment[here].T
                begin = here.stop
        return inverse.reshape(self._n_modes, 3 * size, 3 * n_theta), moments

    def packed(self, velocity: Array, inverse: Array) -> Array:
        """The packed coefficients from velocities on some of the circles, inverse those of them."""
        from qbxstokes.qbx.exterior_kernel import exterior

        h = self.harmonics
        start, flow = triangle(h.orders, h.degree)[2], np.zeros(self.shape_of_flows)
        velocity = np.ascontiguousarray(velocity).reshape(-1, self.grid.n_phi, 3)
        exterior(velocity, inverse, self._blocks[1], h.gain, start, flow)
        return flow

    @property
    def inverse(self) -> Array:
        """The part of the map that acts on velocities."""
        return self._blocks[0]

    def inverse_on(self, circles: Integers) -> Array:
        """What of it acts on velocities on some circles of the grid."""
        whole = self.inverse
        if len(circles) == self.grid.n_theta:
            return whole
        parts = whole.reshape(*whole.shape[:2], 3, -1)[..., circles]
        return np.ascontiguousarray(parts).reshape(*whole.shape[:2], -1)

    def flow(self, velocity: Array) -> ExteriorFlow:
        """The exterior flow with the given velocity (N, 3) on the surface, without net flux."""
        return ExteriorFlow(self.harmonics, self.packed(velocity, self.inverse))

    def _block(self, m: int) -> tuple[Array, Array]:
        """Density from the velocity of mode m, and the coefficients of C from the density.

        The density has the parts mu_x + i mu_y, mu_x - i mu_y and mu_z of orders m + 1, m - 1 and
        m; the velocity is (u_rho, u_phi / i, u_z) with weights that make the fit one in L2.
        """
        h = self.harmonics
        values, d_rho, d_z = self._surface
        fine, weights, on_fine = self._fine
        theta = self.grid.theta
        rho, z = self.grid.shape.meridian(theta)
        columns, moments = [], []
        for part, order in enumerate((m + 1, abs(m - 1), m)):
            factor = np.cos(fine) if part == 2 else 0.5 * self.grid.shape.meridian(fine)[0]
            for n in range(order, self.degree + 1):
                g = h.gain[order, n]
                e, e_rho, e_z = g * values[order, n], g * d_rho[order, n], g * d_z[order, n]
                c = h.gain[m] * (on_fine[m] @ (weights * factor * on_fine[order, n]))
                u = np.stack([c @ d_rho[m], (m / rho) * (c @ values[m]), c @ d_z[m]])
                if part == 2:
                    u += np.stack([-z * e_rho, -(m * z / rho) * e, e - z * e_z])
                else:
                    sign = 1.0 if part == 0 else -1.0
                    u += 0.5 * np.stack([e - rho * e_rho, -(m + 2.0 * sign) * e, -rho * e_z])
                columns.append((u * self._scale).ravel())
                moments.append(c)
        if not columns:
            return np.zeros((0, 3 * theta.size)), np.zeros((0, h.degree + 1))
        matrix = np.stack(columns, axis=1)
        return np.linalg.pinv(matrix, rcond=_RANK_TOLERANCE), np.stack(moments)

    @cached_property
    def _surface(self) -> tuple[Array, Array, Array]:
        return self.harmonics.surface(self.grid.theta)

    @cached_property
    def _fine(self) -> tuple[Array, Array, Array]:
        """Nodes, weights and harmonics that multiply a density by the position exactly."""
        x, w = np.polynomial.legendre.leggauss(self.degree + 3)
        theta = np.arccos(-x)
        return theta, w, self.harmonics.polar(theta)
