"""One body as its neighbours see it: boundary velocity -> exterior flow, force and torque.

The velocity v on the surface grid is matched by the Stokes single layer whose density is a sum of
spheroidal harmonics (`qbx.exterior`); outside it is B + grad(C - x . B) with B and C sums of
exterior spheroidal harmonics, from the surface to infinity. The map is small blocks per azimuthal
mode, shared by all bodies of one shape and unchanged when they move. Lengths in the polar
radius.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from qbxstokes.geometry.grid import SurfaceGrid
from qbxstokes.geometry.shape import Revolution
from qbxstokes.qbx.exterior import Harmonics, SurfaceToExterior

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True)
class Scatterer:
    """Exterior flows from velocities on n polar and 2 n azimuthal nodes, by exterior harmonics."""

    shape: Revolution
    n: int

    @cached_property
    def grid(self) -> SurfaceGrid:
        """The surface grid."""
        return SurfaceGrid(self.shape, self.n, 2 * self.n)

    @cached_property
    def _map(self) -> SurfaceToExterior:
        return SurfaceToExterior(self.grid, self.n - 2)

    @property
    def harmonics(self) -> Harmonics:
        """The exterior harmonics, orders 0..n and degrees up to n - 1."""
        return self._map.harmonics

    @cached_property
    def _blocks(self) -> tuple[Array, Array]:
        """Padded blocks: data -> (part, degree) of the density, and density -> C, by mode."""
        h, degree = self.harmonics, self._map.degree
        blocks = self._map.blocks
        size = degree + 1
        inverse = np.zeros((len(blocks), 3, size, 3 * self.n))
        moments = np.zeros((len(blocks), h.degree + 1, 3 * size))
        scale = np.tile(np.sqrt(self.grid.theta_weights * np.sin(self.grid.theta)), 3)
        for m, (block, moment) in enumerate(blocks):
            begin = 0
            for part, order in enumerate((m + 1, abs(m - 1), m)):
                here = slice(begin, begin + max(size - order, 0))
                inverse[m, part, order:] = block[here] * scale
                moments[m].reshape(-1, 3, size)[:, part, order:] = moment[here].T
                begin = here.stop
        return inverse.reshape(len(blocks), 3 * size, 3 * self.n), moments

    def coefficients(self, velocity: Array) -> ComplexArray:
        """Coefficients (4, orders, degree + 1) of B_x, B_y, B_z and C from velocity (N, 3)."""
        n, h = self.n, self.harmonics
        inverse, moments = self._blocks
        count, size = len(inverse), self._map.degree + 1
        modes = self._modes(velocity)[:count]
        density = np.matmul(inverse, modes[..., None])[..., 0]
        twice = np.where(np.arange(count) > 0, 2.0, 1.0)[:, None]
        c = np.zeros((4, n + 1, h.degree + 1), dtype=np.complex128)
        c[3, :count] = twice * np.matmul(moments, density[..., None])[..., 0]
        plus, minus, axial = np.moveaxis(density.reshape(count, 3, size), 1, 0)
        a = plus * h.gain[1 : count + 1, :size]
        c[0, 1 : count + 1, :size] += a
        c[1, 1 : count + 1, :size] -= 1j * a
        a = minus[1:] * h.gain[: count - 1, :size]
        c[0, : count - 1, :size] += a
        c[1, : count - 1, :size] += 1j * a
        c[2, :count, :size] += twice * axial * h.gain[:count, :size]
        return c

    @cached_property
    def _turn(self) -> tuple[Array, Array]:
        return np.cos(self.grid.phi), np.sin(self.grid.phi)

    def _modes(self, velocity: Array) -> ComplexArray:
        v = velocity.reshape(self.n, 2 * self.n, 3)
        c, s = self._turn
        data = np.empty((3, self.n, 2 * self.n))
        data[0], data[1] = c * v[..., 0] + s * v[..., 1], c * v[..., 1] - s * v[..., 0]
        data[2] = v[..., 2]
        modes = np.fft.rfft(data, axis=2) / (2 * self.n)
        modes[1] *= -1j
        return np.ascontiguousarray(np.moveaxis(modes, 2, 0)).reshape(self.n + 1, 3 * self.n)

    @cached_property
    def _moments(self) -> tuple[float, Array]:
        """Monopole (1/r) and dipole (x/r^3, by component) of the lowest harmonics far away."""
        h, k = self.harmonics, self.harmonics.ratio_of_axes
        q0 = h.ratio[0, 0]
        across = h.diagonal[1] * 2.0 * k / (3.0 * h.ratio[1, 1])
        along = np.sqrt(1.5) / (3.0 * q0 * h.ratio[0, 1])
        return float(np.sqrt(0.5) / q0), np.array([across, across, along])

    def first_moment(self, c: ComplexArray) -> Array:
        """Moment D (3, 3), D[i, j] = int y_i mu_j, of the single-layer density."""
        across, _, along = self._moments[1]
        low = c[:3, 1, 1]
        rows = [across * low.real, -across * low.imag, along * c[:3, 0, 1].real]
        return np.asarray(8.0 * np.pi * np.stack(rows))

    def force_torque(self, c: ComplexArray) -> Array:
        """Force and torque (6,) of the body ON the fluid, body frame."""
        d = self.first_moment(c)
        force = 8.0 * np.pi * self._moments[0] * c[:3, 0, 0].real
        return np.concatenate([force, [d[1, 2] - d[2, 1], d[2, 0] - d[0, 2], d[0, 1] - d[1, 0]]])

    @cached_property
    def rigid(self) -> Array:
        """The six rigid motions on the grid, (6, N, 3)."""
        x = self.grid.points
        unit = np.eye(3)
        return np.stack(
            [np.broadcast_to(e, x.shape) for e in unit] + [np.cross(e, x) for e in unit]
        )

    @cached_property
    def resistance(self) -> Array:
        """Resistance (6, 6) of the body alone: (force, torque) on the fluid per velocity."""
        columns = [self.force_torque(self.coefficients(v)) for v in self.rigid]
        return np.diag(np.diag(np.stack(columns, axis=1)))

    @cached_property
    def root_weights(self) -> Array:
        """Root (N, 1) of the weights of the parameter sphere, normalised to sum of squares 1."""
        w = np.repeat(self.grid.theta_weights * np.sin(self.grid.theta), 2 * self.n)
        return np.asarray(np.sqrt(w / w.sum())[:, None])

    def degree_for(self, points: Array, tolerance: float) -> int:
        """Degree beyond which harmonics are below tolerance at points (N, 3) of the body frame."""
        decay = self.shape.decay(points).max()
        top = self.harmonics.degree
        if decay >= 1.0:
            return top
        return int(min(max(3, np.ceil(np.log(tolerance) / np.log(decay)) + 2), top))

    def table(self, points: Array, degree: int, second: bool) -> Table:
        """The harmonics up to a degree at points (P, 3) of the body frame; second derivatives."""
        from qbxstokes.qbx.exterior_basis import tabulate

        h = self.harmonics
        orders = min(degree, self.n) + 1
        rows, columns = _triangle(orders, degree)
        values = np.empty((10 if second else 4, len(points), 2 * len(rows)))
        tabulate(
            np.ascontiguousarray(points),
            h.ratio_of_axes,
            degree,
            orders,
            1.0 / h.ratio,
            h.rise,
            h.fall,
            h.diagonal,
            second,
            values,
        )
        return Table(points, values, rows, columns)


@lru_cache(maxsize=256)
def _triangle(orders: int, degree: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    m, n = np.meshgrid(np.arange(orders), np.arange(degree + 1), indexing="ij")
    return m[n >= m], n[n >= m]


@dataclass(frozen=True)
class Table:
    """Values of the harmonics at points (P, 3); see `exterior_basis.tabulate`."""

    points: Array
    values: Array
    rows: NDArray[np.intp]
    columns: NDArray[np.intp]

    def _sums(self, c: ComplexArray) -> Array:
        flat = np.ascontiguousarray(c[:, self.rows, self.columns].T)
        real = np.stack([flat.real, flat.imag], axis=1).reshape(-1, 4)
        n, count = self.values.shape[:2]
        product: Array = self.values.reshape(n * count, -1) @ real
        return product.reshape(n, count, 4)

    def velocity(self, c: ComplexArray) -> Array:
        """Velocity (P, 3)."""
        return self._velocity(self._sums(c))

    def _velocity(self, s: Array) -> Array:
        first = s[1:4]
        return np.asarray(
            s[0, :, :3] + first[:, :, 3].T - np.einsum("ipj,pj->pi", first[:, :, :3], self.points)
        )

    def pressure(self, c: ComplexArray) -> Array:
        """Pressure (P,): -2 div B."""
        return np.asarray(-2.0 * np.einsum("ipi->p", self._sums(c)[1:4, :, :3]))

    def all(self, c: ComplexArray) -> tuple[Array, Array, Array, Array]:
        """u (P, 3), grad u (P, 3, 3) as d_i u_l, p (P,) and grad p (P, 3)."""
        s = self._sums(c)
        first = s[1:4]
        second = s[4:][_SECOND]  # (3, 3, P, 4)
        gradient = np.einsum("ipl->pil", first[:, :, :3]) + np.moveaxis(second[..., 3], 2, 0)
        gradient -= np.einsum("lpi->pil", first[:, :, :3])
        gradient -= np.einsum("ilpj,pj->pil", second[..., :3], self.points)
        pressure = -2.0 * np.einsum("ipi->p", first[:, :, :3])
        slope = -2.0 * np.einsum("ijpj->pi", second[..., :3])
        return self._velocity(s), gradient, pressure, slope


_SECOND = np.array([[0, 3, 4], [3, 1, 5], [4, 5, 2]])


@lru_cache(maxsize=64)
def scatterer(shape: Revolution, n: int) -> Scatterer:
    """The one scatterer of a shape and a number of polar nodes."""
    return Scatterer(shape, n)
