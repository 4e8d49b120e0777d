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

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from qbxstokes.geometry.grid import SurfaceGrid
from qbxstokes.geometry.shape import Revolution
from qbxstokes.qbx.modes import to_modes

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

# Slack of "outside" in the sum of squares that is 1 on the surface: rounding of coordinates.
SURFACE_MARGIN = 1e-12
# Singular values of the single layer below this are its null space (the normal's pressure).
_RANK_TOLERANCE = 1e-13


@dataclass(frozen=True)
class Harmonics:
    """Recurrence coefficients and surface values of the harmonics E_nm, m <= n <= degree.

    Arrays are (orders, degree + 1) with row m, column n; see `exterior_kernel`.
    """

    shape: Revolution
    orders: int
    degree: int

    @cached_property
    def ratio_of_axes(self) -> float:
        """k of semi-axes (k, k, 1). Raises ValueError for a shape without confocal coordinates."""
        axes = self.shape.semi_axes
        if axes is None or axes[2] != 1.0:
            raise ValueError(f"there are no exterior harmonics of a {self.shape}")
        return axes[0]

    @cached_property
    def rise(self) -> Array:
        """Factor of eta p_n in the recurrence of the orthonormal p_{n+1} (DLMF 14.10.3)."""
        m, n = np.arange(self.orders)[:, None], np.arange(self.degree + 1)
        squared = np.where(
            n >= m, (2.0 * n + 1) * (2 * n + 3) / ((n + 1.0) ** 2 - m * m + (n < m) * 1e9), 0.0
        )
        return np.asarray(np.sqrt(squared))

    @cached_property
    def fall(self) -> Array:
        """Factor of p_{n-1} in the same recurrence."""
        m, n = np.arange(self.orders)[:, None], np.arange(self.degree + 1)
        valid = n > m
        nn = np.where(valid, n, m + 1)
        squared = (2.0 * nn + 3) * (nn * nn - m * m) / ((2.0 * nn - 1) * ((nn + 1.0) ** 2 - m * m))
        return np.where(valid, np.sqrt(squared), 0.0)

    @cached_property
    def diagonal(self) -> Array:
        """p_m^m (orders,): the constant sqrt((2m + 1)/2 / (2m)!) (2m - 1)!!."""
        m = np.arange(1, self.orders)
        return np.asarray(
            np.sqrt(0.5 * np.cumprod(np.concatenate([[1.0], (2.0 * m + 1) / (2.0 * m)])))
        )

    @cached_property
    def ratio(self) -> Array:
        """Q_n^(m) / Q_{n-1}^(m) on the surface (1 where n < m)."""
        from qbxstokes.qbx.exterior_kernel import all_ratios

        k = self.ratio_of_axes
        table = np.ones((self.orders, self.degree + 2))
        all_ratios(self.orders, self.degree, 1.0, k, (1.0 - k) * (1.0 + k), table)
        return table[:, : self.degree + 1]

    @cached_property
    def gain(self) -> Array:
        """Laplace single layer of the density E_nm on the surface, in units of E_nm.

        4 pi (-1)^m (n - m)!/(n + m)! k^(2m) P_n^(m)(1) Q_n^(m)(1), built from ratios so that
        nothing overflows.
        """
        k = self.ratio_of_axes
        e2 = (1.0 - k) * (1.0 + k)
        gain = np.zeros((self.orders, self.degree + 1))
        for m in range(min(self.orders, self.degree + 1)):
            # n = m: P_m^(m) = (2m - 1)!!, Q_{m-1}^(m) = (-1)^m 2^(m-1) (m - 1)! / k^(2m).
            value = self.ratio[m, m] / max(2 * m, 1)
            p_ratio = 1.0
            for n in range(m, self.degree + 1):
                gain[m, n] = 4.0 * np.pi * value
                # P_{n+1}^(m) / P_n^(m) by the recurrence that Q obeys as well, run forwards.
                previous = (n + m) * e2 / p_ratio if n > m else 0.0
                p_ratio = ((2 * n + 1) - previous) / (n - m + 1)
                if n < self.degree:
                    value *= (n + 1 - m) / (n + 1 + m) * p_ratio * self.ratio[m, n + 1]
        return gain

    def polar(self, theta: Array) -> Array:
        """sin^m p_n^m at theta: orthonormal in cos(theta), shape (orders, degree + 1, n_theta)."""
        s, c = np.sin(theta), np.cos(theta)
        values = np.zeros((self.orders, self.degree + 1, theta.size))
        for m in range(min(self.orders, self.degree + 1)):
            last = np.zeros_like(c)
            now = self.diagonal[m] * s**m
            for n in range(m, self.degree + 1):
                values[m, n] = now
                last, now = now, self.rise[m, n] * c * now - self.fall[m, n] * last
        return values

    def surface(self, theta: Array) -> tuple[Array, Array, Array]:
        """E_nm at phi = 0 on the surface and its derivatives in rho and z.

        Each of shape (orders, degree + 1, n_theta).
        """
        k = self.ratio_of_axes
        s, c = np.sin(theta), np.cos(theta)
        values = self.polar(theta)
        m, n = np.arange(self.orders)[:, None, None], np.arange(self.degree + 1)[:, None]
        # Along gamma at fixed theta, where (rho / k)^m grows as alpha^m.
        d_gamma = values * (n - np.maximum(n + m, 1) / self.ratio[:, :, None]) / (k * k)
        factor = np.sqrt(np.maximum((2.0 * n + 1) / np.maximum(2 * n - 1, 1) * (n * n - m * m), 0))
        lower = np.concatenate([np.zeros_like(values[:, :1]), values[:, :-1]], axis=1)
        d_theta = (n * c * values - factor * lower) / s  # DLMF 14.10.5, normalised
        # z = gamma cos(theta), rho = alpha sin(theta).
        delta = s * s + k * k * c * c
        return (
            values,
            (d_gamma * (k * s) + d_theta * (k * c)) / delta,
            (d_gamma * (k * k * c) - d_theta * s) / delta,
        )


@dataclass(frozen=True)
class ExteriorFlow:
    """A Stokes flow outside the spheroid that decays at infinity, in the body frame.

    coefficients (orders, degree + 1, 4), complex: B_x, B_y, B_z and C of u = B + grad(C - x . B)
    (x held fixed under the gradient) as the real parts of sums of E_nm.
    """

    harmonics: Harmonics
    coefficients: ComplexArray

    @cached_property
    def amplitude(self) -> Array:
        """Bound (degree + 1,) of what each degree adds to the velocity on the surface."""
        k = self.harmonics.ratio_of_axes
        n = np.arange(self.harmonics.degree + 1)
        size = np.abs(self.coefficients).sum(axis=(0, 2))
        return np.asarray(size * np.sqrt(n + 0.5) * (n + 1.0) / min(k * k, 1.0))

    def trimmed(self, tolerance: float = 1e-15) -> ExteriorFlow:
        """The same flow without highest orders and degrees of relative amplitude <= tolerance."""
        size = np.abs(self.coefficients).max(axis=2)
        kept = np.argwhere(size > tolerance * size.max())
        if not len(kept):
            return self
        orders, degree = kept[:, 0].max() + 1, max(int(kept[:, 1].max()), 1)
        harmonics = Harmonics(self.harmonics.shape, int(orders), degree)
        return ExteriorFlow(harmonics, self.coefficients[:orders, : degree + 1])

    def evaluate(
        self, points: Array, with_stress: bool = True, tolerance: float = 0.0
    ) -> tuple[Array, Array, Array]:
        """Velocity (N, 3), pressure (N,) and stress (N, 6: xx, yy, zz, xy, xz, yz) at points.

        NaN inside the body. tolerance: absolute error of the velocity that may be made by leaving
        out high degrees far from the body; 0 leaves out none. The stress has length 0 unless asked
        for.
        """
        from qbxstokes.qbx.exterior_kernel import evaluate

        points = np.ascontiguousarray(points, dtype=float)
        n = len(points)
        h = self.harmonics
        velocity, pressure = np.empty((n, 3)), np.empty(n)
        stress = np.empty((n if with_stress else 0, 6))
        evaluate(
            points,
            h.ratio_of_axes,
            np.ascontiguousarray(self.coefficients.real),
            np.ascontiguousarray(self.coefficients.imag),
            1.0 / h.ratio,
            h.rise,
            h.fall,
            h.diagonal,
            self.amplitude,
            tolerance,
            SURFACE_MARGIN,
            with_stress,
            velocity,
            pressure,
            stress,
        )
        return velocity, pressure, stress


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
    def _scale(self) -> Array:
        return np.asarray(np.sqrt(self.grid.theta_weights * np.sin(self.grid.theta)))

    @cached_property
    def blocks(self) -> list[tuple[Array, Array]]:
        """Per mode: density from the velocity, and the coefficients of C from the density."""
        return [self._block(m) for m in range(self._n_modes)]

    def flow(self, velocity: Array) -> ExteriorFlow:
        """The exterior flow with the given velocity (N, 3) on the surface, without net flux."""
        grid, h = self.grid, self.harmonics
        modes = to_modes(velocity, grid.n_theta, grid.n_phi)
        coefficients = np.zeros((h.orders, h.degree + 1, 4), dtype=np.complex128)
        for m, (inverse, moments) in enumerate(self.blocks):
            data = (modes[m].reshape(3, -1) * self._scale).ravel()
            if not np.any(data):
                continue
            density = inverse @ data
            begin = 0
            for part, order in enumerate((m + 1, abs(m - 1), m)):
                size = max(self.degree + 1 - order, 0)
                a = density[begin : begin + size] * h.gain[order, order : self.degree + 1]
                begin += size
                here = coefficients[order, order : self.degree + 1]
                # B_x + i B_y of orders m + 1 and, from the conjugate modes, -(m - 1).
                if part == 0:
                    here[:, 0] += a
                    here[:, 1] -= 1j * a
                elif part == 1 and m > 0:
                    here[:, 0] += a
                    here[:, 1] += 1j * a
                elif part == 2:
                    here[:, 2] += min(m + 1, 2) * a
            coefficients[m, :, 3] += min(m + 1, 2) * (density @ moments)
        return ExteriorFlow(h, coefficients)

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
