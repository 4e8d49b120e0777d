"""Exterior spheroidal harmonics E_nm: recurrences, values on the surface, far field, tables.

With the measure sin(theta) dtheta dphi (the weight of the support function) the Laplace single
layer of a spheroid is diagonal in them (Hobson 1931, sec. 245 f.). See `exterior_kernel` for their
definition and `exterior` for the Stokes flows that are made of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from qbxstokes.geometry.shape import Revolution
from qbxstokes.typing import Array, Integers


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
    def recurrence(self) -> tuple[Array, Array, Array, Array]:
        """What the compiled evaluations need: 1/ratio, rise, fall and diagonal."""
        return 1.0 / self.ratio, self.rise, self.fall, self.diagonal

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

    @cached_property
    def _moments(self) -> tuple[float, Array]:
        """Monopole (1/r) and dipole (x/r^3, by component) of the lowest harmonics far away."""
        k, q0 = self.ratio_of_axes, self.ratio[0, 0]
        across = self.diagonal[1] * 2.0 * k / (3.0 * self.ratio[1, 1])
        along = np.sqrt(1.5) / (3.0 * q0 * self.ratio[0, 1])
        return float(np.sqrt(0.5) / q0), np.array([across, across, along])

    def first_moment(self, flow: Array) -> Array:
        """D (3, 3) = int y_i mu_j of the single layer mu of a packed flow (4, 2 K)."""
        across, _, along = self._moments[1]
        rows = [across * flow[:3, 4], -across * flow[:3, 5], along * flow[:3, 2]]
        return np.asarray(8.0 * np.pi * np.stack(rows))

    def force_torque(self, flow: Array) -> Array:
        """Force and torque (6,) on the fluid of a packed flow (4, 2 K), body frame."""
        d = self.first_moment(flow)
        force = 8.0 * np.pi * self._moments[0] * flow[:3, 0]
        return np.concatenate([force, [d[1, 2] - d[2, 1], d[2, 0] - d[0, 2], d[0, 1] - d[1, 0]]])

    @cached_property
    def start(self) -> Integers:
        """Where the harmonics of each degree begin among those that are packed."""
        return triangle(self.orders, self.degree)[2]

    def columns(self, degree: int) -> int:
        """Packed numbers up to a degree."""
        return 2 * int(self.start[degree] + min(degree + 1, self.orders))


@lru_cache(maxsize=256)
def triangle(orders: int, degree: int) -> tuple[Integers, Integers, Integers]:
    """Orders and degrees (K,) of the harmonics of packed flows, and where degrees begin.

    A packed flow (4, 2 K) holds its coefficients degree by degree and in one by orders m <= n, so
    that lower degrees come first, their real and imaginary parts side by side.
    """
    n, m = np.meshgrid(np.arange(degree + 1), np.arange(orders), indexing="ij")
    start = np.cumsum([0, *np.minimum(np.arange(degree) + 1, orders)])
    return m[n >= m], n[n >= m], start
