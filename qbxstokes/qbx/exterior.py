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

from qbxstokes.geometry.spheroid import Spheroid, SurfaceGrid
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

    spheroid: Spheroid
    orders: int
    degree: int

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

        k = self.spheroid.aspect_ratio
        table = np.ones((self.orders, self.degree + 2))
        all_ratios(self.orders, self.degree, 1.0, k, (1.0 - k) * (1.0 + k), table)
        return table[:, : self.degree + 1]

    @cached_property
    def gain(self) -> Array:
        """Laplace single layer of the density E_nm on the surface, in units of E_nm.

        4 pi (-1)^m (n - m)!/(n + m)! k^(2m) P_n^(m)(1) Q_n^(m)(1), built from ratios so that
        nothing overflows.
        """
        k = self.spheroid.aspect_ratio
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
        k = self.spheroid.aspect_ratio
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
        k = self.harmonics.spheroid.aspect_ratio
        n = np.arange(self.harmonics.degree + 1)
        size = np.abs(self.coefficients).sum(axis=(0, 2))
        return np.asarray(size * np.sqrt(n + 0.5) * (n + 1.0) / min(k * k, 1.0))

    @cached_property
    def tail(self) -> float:
        """Truncation error of the velocity on the surface, estimated from the last degrees.

        Two degrees of each parity decide, since a symmetric flow leaves every other one empty.
        """
        size = np.abs(self.coefficients[:, :-1, :3]).sum(axis=(0, 2))
        return float(size[-4:].max()) if size.size > 4 else float(size.max())

    def trimmed(self, tolerance: float = 1e-15) -> ExteriorFlow:
        """The same flow without highest orders and degrees of relative amplitude <= tolerance."""
        size = np.abs(self.coefficients).max(axis=2)
        kept = np.argwhere(size > tolerance * size.max())
        if not len(kept):
            return self
        orders, degree = kept[:, 0].max() + 1, max(int(kept[:, 1].max()), 1)
        harmonics = Harmonics(self.harmonics.spheroid, int(orders), degree)
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
            h.spheroid.aspect_ratio,
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


def exterior_flow(grid: SurfaceGrid, velocity: Array, degree: int | None = None) -> ExteriorFlow:
    """The exterior flow with the given velocity (N, 3) on the surface, without net flux.

    degree: of the spheroidal harmonics of the single-layer density; by default n_theta - 2, as far
    as the grid resolves them. The modes of `velocity` beyond those of the grid must vanish.
    """
    modes = to_modes(velocity, grid.n_theta, grid.n_phi)
    # The highest mode of an even grid stands for two and is left out.
    n_modes = (grid.n_phi + 1) // 2
    top = grid.n_theta - 2 if degree is None else degree
    harmonics = Harmonics(grid.spheroid, n_modes + 1, top + 1)
    fine = np.arccos(np.polynomial.legendre.leggauss(top + 3)[0])[::-1].copy()
    layer = _SingleLayer(harmonics, grid.theta, fine)
    coefficients = np.zeros((n_modes + 1, top + 2, 4), dtype=np.complex128)
    scale = np.sqrt(grid.theta_weights * np.sin(grid.theta))
    for m in range(n_modes):
        data = (modes[m].reshape(3, -1) * scale).ravel()
        if not np.any(data):
            continue
        layer.add_mode(m, data, scale, coefficients)
    return ExteriorFlow(harmonics, coefficients)


class _SingleLayer:
    """The Stokes single layer on spheroidal harmonics, mode by mode, and its inverse."""

    def __init__(self, harmonics: Harmonics, theta: Array, fine: Array) -> None:
        self.harmonics = harmonics
        self.theta = theta
        self.surface = harmonics.surface(theta)
        self.fine = fine
        self.on_fine = harmonics.polar(fine)
        w = np.polynomial.legendre.leggauss(fine.size)[1]
        self.fine_weights = w

    def add_mode(self, m: int, data: Array, scale: Array, coefficients: ComplexArray) -> None:
        """Solve for the density of mode m and add its potentials to the coefficients.

        data: amplitudes (3 n_theta,) of (u_rho, u_phi / i, u_z), times scale.
        """
        h = self.harmonics
        k = h.spheroid.aspect_ratio
        top = h.degree - 1
        plus, minus = m + 1, abs(m - 1)
        sizes = [max(top + 1 - order, 0) for order in (plus, minus, m)]
        columns, moments = [], []
        rho, z = k * np.sin(self.theta), np.cos(self.theta)
        fine_rho, fine_z = k * np.sin(self.fine), np.cos(self.fine)
        v, v_rho, v_z = self.surface
        c_value, c_rho, c_z = v[m], v_rho[m], v_z[m]
        for part, order in enumerate((plus, minus, m)):
            for n in range(order, top + 1):
                g = h.gain[order, n]
                e, e_rho, e_z = g * v[order, n], g * v_rho[order, n], g * v_z[order, n]
                factor = fine_z if part == 2 else 0.5 * fine_rho
                moment = self.on_fine[m] @ (self.fine_weights * factor * self.on_fine[order, n])
                c = h.gain[m] * moment
                moments.append(c)
                u = np.stack([c @ c_rho, (m / rho) * (c @ c_value), c @ c_z])
                if part == 2:
                    u += np.stack([-z * e_rho, -(m * z / rho) * e, e - z * e_z])
                else:
                    sign = 1.0 if part == 0 else -1.0
                    signed = m + sign
                    u += 0.5 * np.stack([e - rho * e_rho, -sign * e - signed * e, -rho * e_z])
                columns.append((u * scale).ravel())
        matrix = np.stack(columns, axis=1)
        unknowns = np.linalg.lstsq(matrix, data, rcond=_RANK_TOLERANCE)[0]
        begin = 0
        for part, order in enumerate((plus, minus, m)):
            a = unknowns[begin : begin + sizes[part]] * h.gain[order, order : top + 1]
            begin += sizes[part]
            here = coefficients[order, order : top + 1]
            if part == 2:
                here[:, 2] += (1.0 if m == 0 else 2.0) * a
            elif part == 0:
                here[:, 0] += a
                here[:, 1] += -1j * a
            elif m > 0:
                here[:, 0] += a
                here[:, 1] += 1j * a
        coefficients[m, :, 3] += (1.0 if m == 0 else 2.0) * (unknowns @ np.stack(moments))
