"""Azimuthal modes: vector fields on the surface grid as blocks of cylindrical components.

A real field v(theta, phi) on the grid is written in cylindrical components (rho, phi, z) and
v = sum_m v_m(theta) exp(i m phi). Rotational symmetry makes every surface operator block-diagonal
in m, and the mirror symmetry in phi makes the blocks real once the phi component is divided by i.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from qbxstokes.errors import ConvergenceError
from qbxstokes.typing import Array, ComplexArray


def to_modes(field: Array, n_theta: int, n_phi: int) -> ComplexArray:
    """Modes (n_phi // 2 + 1, 3 n_theta) of a real Cartesian field (N, 3) or (N * 3,).

    Rows of a block are ordered component by component (rho, phi / i, z), theta fastest.
    """
    v = np.reshape(field, (n_theta, n_phi, 3))
    phi = 2.0 * np.pi * np.arange(n_phi) / n_phi
    c, s = np.cos(phi), np.sin(phi)
    cylindrical = np.stack(
        [c * v[..., 0] + s * v[..., 1], c * v[..., 1] - s * v[..., 0], v[..., 2]]
    )
    modes = np.fft.rfft(cylindrical, axis=2) / n_phi
    modes[1] *= -1j
    return np.ascontiguousarray(np.moveaxis(modes, 2, 0)).reshape(-1, 3 * n_theta)


def from_modes(modes: ComplexArray, n_theta: int, n_phi: int) -> Array:
    """Real Cartesian field (N, 3) of modes (n_phi // 2 + 1, 3 n_theta); inverse of `to_modes`."""
    m = np.moveaxis(modes.reshape(-1, 3, n_theta), 0, 2).copy()
    m[1] *= 1j
    v = np.fft.irfft(m, n=n_phi, axis=2) * n_phi
    phi = 2.0 * np.pi * np.arange(n_phi) / n_phi
    c, s = np.cos(phi), np.sin(phi)
    field = np.stack([c * v[0] - s * v[1], s * v[0] + c * v[1], v[2]], axis=-1)
    return np.asarray(field.reshape(-1, 3))


@dataclass(frozen=True)
class ModalOperator:
    """A real linear operator on Cartesian grid fields given by its blocks (n_modes, 3n, 3n).

    Acts on fields (N, 3); `apply_transpose` is the transpose in the Euclidean product of R^(3N).
    """

    blocks: Array
    n_theta: int
    n_phi: int

    def _map(self, field: Array, blocks: Array) -> Array:
        modes = to_modes(field, self.n_theta, self.n_phi)
        return from_modes(np.matmul(blocks, modes[..., None])[..., 0], self.n_theta, self.n_phi)

    def apply(self, field: Array) -> Array:
        """Operator times field, shape (N, 3)."""
        return self._map(field, self.blocks)

    def apply_transpose(self, field: Array) -> Array:
        """Transposed operator times field, shape (N, 3)."""
        return self._map(field, np.swapaxes(self.blocks, 1, 2))

    def balanced(self, scale: Array) -> ModalOperator:
        """The similar operator S A S^-1 with S = diag(scale) over theta, scale (n_theta,)."""
        s = np.tile(scale, 3)
        return ModalOperator(self.blocks * (s[:, None] / s), self.n_theta, self.n_phi)

    @cached_property
    def inverse(self) -> ModalOperator:
        """The inverse operator, mode by mode: an exact preconditioner.

        Raises ConvergenceError where the discrete operator has none, as with order 0.
        """
        try:
            blocks = np.linalg.inv(self.blocks)
        except np.linalg.LinAlgError:
            blocks = np.full_like(self.blocks, np.nan)
        if not np.all(np.isfinite(blocks)):
            raise ConvergenceError(
                "the discrete integral equation is singular: its nodes are too few; raise "
                "hydrodynamics.expansion_order, or leave the numbers out and give a tolerance"
            )
        return ModalOperator(blocks, self.n_theta, self.n_phi)

    @cached_property
    def norm(self) -> float:
        """Spectral norm of the operator on densities with the modes that it holds."""
        return float(np.max(np.linalg.norm(self.blocks, 2, axis=(1, 2))))
