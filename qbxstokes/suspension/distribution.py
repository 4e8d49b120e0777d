"""A density of orientations on the unit sphere: moments, values, samples and tables."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.suspension.harmonics import Harmonics
from qbxstokes.typing import Array

# Proposals of the rejection sampling that are made at once, and the grid that bounds the density.
_CHUNK = 16_384
_MARGIN = 1.1


class Density:
    """What every density of axes p on the unit sphere can do, psi(-p) = psi(p), of integral 1."""

    # Nodes of a quarter turn that resolve it.
    resolution: int = 64

    def density(self, axes: ArrayLike) -> Array:
        """psi (...) at unit vectors (..., 3)."""
        raise NotImplementedError

    def table(self, n_theta: int = 91, n_phi: int = 180) -> dict[str, Array]:
        """theta (n_theta,), phi (n_phi,) in radians and the density (n_theta, n_phi) there.

        p = (sin theta cos phi, sin theta sin phi, cos theta), the poles included.
        """
        theta = np.linspace(0.0, np.pi, n_theta)
        phi = 2.0 * np.pi / n_phi * np.arange(n_phi)
        return {"theta": theta, "phi": phi, "density": self.density(directions(theta, phi))}

    def sample(self, count: int, seed: int = 0) -> Array:
        """Independent axes (count, 3), by rejection; the same ones for the same seed."""
        fine = 2 * self.resolution
        theta, phi = np.linspace(0.0, np.pi, fine), np.linspace(0.0, 2.0 * np.pi, 2 * fine)
        most = _MARGIN * float(self.density(directions(theta, phi)).max())
        kept: list[Array] = []
        have = number = 0
        while have < count:
            generator = np.random.Generator(np.random.Philox(key=[seed, number]))
            p = generator.standard_normal((_CHUNK, 3))
            p /= np.linalg.norm(p, axis=1, keepdims=True)
            taken = p[generator.random(_CHUNK) * most < self.density(p)]
            kept.append(taken)
            have, number = have + len(taken), number + 1
        return np.asarray(np.concatenate([np.empty((0, 3)), *kept])[:count])


@dataclass(frozen=True)
class AdvectedDensity(Density):
    """Axes that were isotropic and have moved with p = F p0/|F p0|, as a mean over several F.

    psi(p) = |F^-1 p|^-3/(4 pi) with det F = 1. inverse: F^-1 (T, 3, 3).
    """

    inverse: Array

    @property
    def resolution(self) -> int:  # type: ignore[override]
        """Nodes of a quarter turn that resolve it."""
        stretch = float(np.linalg.norm(self.inverse, 2, axis=(1, 2)).max())
        return int(min(512.0, 64.0 * max(1.0, stretch**1.5 / 4.0)))

    def density(self, axes: ArrayLike) -> Array:
        """psi (...) at unit vectors (..., 3)."""
        p = np.asarray(axes, dtype=np.float64)
        total = np.zeros(p.shape[:-1])
        for inverse in self.inverse:
            square = np.sum((p @ inverse.T) ** 2, axis=-1)
            total += 1.0 / (square * np.sqrt(square))
        return np.asarray(total / (4.0 * np.pi * len(self.inverse)))

    def sample(self, count: int, seed: int = 0) -> Array:
        """Independent axes (count, 3): isotropic ones, moved; the same ones for the same seed."""
        generator = np.random.Generator(np.random.Philox(key=[seed, 0]))
        p = generator.standard_normal((count, 3))
        chosen = generator.integers(len(self.inverse), size=count)
        moved = np.einsum("nij,nj->ni", np.linalg.inv(self.inverse)[chosen], p)
        return np.asarray(moved / np.linalg.norm(moved, axis=1, keepdims=True))


@dataclass(frozen=True)
class Distribution(Density):
    """Density psi(p) of axes p, psi(-p) = psi(p), of integral 1 over the unit sphere.

    basis, coefficients (n,): real spherical harmonics about the rows of `frame` (3, 3), polar axis
    last.

    >>> import numpy as np, qbxstokes as qs
    >>> found = qs.rheology(qs.Body(0.5), qs.flow("shear"), peclet_number=10.0)
    >>> np.round(np.trace(found.distribution.moments()[0]), 12)
    np.float64(1.0)
    """

    basis: Harmonics
    frame: Array
    coefficients: Array

    @property
    def resolution(self) -> int:  # type: ignore[override]
        """Nodes of a quarter turn that resolve it."""
        return max(32, 2 * self.basis.degree)

    def moments(self) -> tuple[Array, Array]:
        """<pp> (3, 3) and <pppp> (3, 3, 3, 3), space frame."""
        second, fourth = self.basis.moments(self.coefficients)
        turn = self.frame.T
        return (
            np.asarray(turn @ second @ turn.T),
            np.einsum("ai,bj,ck,dl,ijkl->abcd", turn, turn, turn, turn, fourth, optimize=True),
        )

    def density(self, axes: ArrayLike) -> Array:
        """psi (...) at unit vectors (..., 3)."""
        p = np.asarray(axes, dtype=np.float64) @ self.frame.T
        lead, p = p.shape[:-1], p.reshape(-1, 3)
        z, angle = p[:, 2], np.arctan2(p[:, 1], p[:, 0])
        sine = np.hypot(p[:, 0], p[:, 1])
        values = np.zeros(len(p))
        start = np.full(len(p), np.sqrt(1.0 / (4.0 * np.pi)))
        for m in range(self.basis.degree + 1):
            if m:  # P_mm from P_(m-1)(m-1), with the phase of Condon and Shortley
                start = -np.sqrt((2.0 * m + 1.0) / (2.0 * m)) * sine * start
            if m % self.basis.step:
                continue
            real, imaginary = self._sums(m, z, start)
            if m == 0:
                values += real
            else:
                values += 2.0 * (real * np.cos(m * angle) - imaginary * np.sin(m * angle))
        return values.reshape(lead)

    def _sums(self, m: int, z: Array, start: Array) -> tuple[Array, Array]:
        """Sums over l of Re c_lm P_lm and Im c_lm P_lm, normalised Legendre functions."""
        real, imaginary = np.zeros_like(z), np.zeros_like(z)
        before, here = np.zeros_like(z), start
        previous = 0.0
        for degree in range(m, self.basis.degree + 1):
            if degree % 2 == 0:
                place = np.array([degree], dtype=np.int64)
                order = np.array([m], dtype=np.int64)
                real += self.coefficients[self.basis.index(place, order)[0]] * here
                if m:
                    imaginary += self.coefficients[self.basis.index(place, -order)[0]] * here
            n = degree + 1.0
            factor = np.sqrt((4.0 * n * n - 1.0) / (n * n - m * m))
            before, here = here, factor * (z * here - previous * before)
            previous = 1.0 / factor
        return real, imaginary


def directions(theta: Array, phi: Array) -> Array:
    """Unit vectors (n_theta, n_phi, 3) at the angles."""
    sine = np.sin(theta)[:, None]
    parts = (sine * np.cos(phi), sine * np.sin(phi), np.cos(theta)[:, None] + 0.0 * phi)
    return np.stack(parts, axis=-1)
