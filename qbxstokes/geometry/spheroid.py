"""Spheroid with semi-axes (k, k, 1) in its body frame, and the surface grid on it.

Lengths are in units of the polar radius c; k = a/c is the aspect ratio.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qbxstokes.errors import CaseError

Array = NDArray[np.float64]
PolarNodes = Literal["cosine", "theta"]


@dataclass(frozen=True)
class Spheroid:
    """Surface x = (k sin(theta) cos(phi), k sin(theta) sin(phi), cos(theta)).

    Prolate for k < 1, a sphere for k = 1, oblate for k > 1 (Bagge 2015, eq. 2.2, 5.1).
    Raises CaseError unless 0 < k < inf.
    """

    aspect_ratio: float

    def __post_init__(self) -> None:
        if not (self.aspect_ratio > 0 and math.isfinite(self.aspect_ratio)):
            raise CaseError(f"aspect_ratio is {self.aspect_ratio}; it must be positive and finite")

    @property
    def volume(self) -> float:
        """Volume 4 pi k^2 / 3, in c^3 (Bagge 2015, eq. 2.3)."""
        return 4.0 * math.pi * self.aspect_ratio**2 / 3.0

    @property
    def surface_area(self) -> float:
        """Surface area, in c^2: 2 pi k (k + arcsin(e)/e), and its continuation for k > 1."""
        k = self.aspect_ratio
        s = (1.0 - k) * (1.0 + k)
        if s > 0:
            e = math.sqrt(s)
            arc = math.asin(e) / e
        elif s < 0:
            e = math.sqrt(-s)
            arc = math.asinh(e) / e
        else:
            arc = 1.0
        return 2.0 * math.pi * k * (k + arc)

    @property
    def inertia(self) -> Array:
        """Diagonal (3,) of the inertia tensor in the body frame, unit density (eq. 3.19)."""
        k2 = self.aspect_ratio**2
        return 4.0 * math.pi / 15.0 * k2 * np.array([k2 + 1.0, k2 + 1.0, 2.0 * k2])

    def q(self, theta: ArrayLike) -> Array:
        """Length |dx/dtheta| = sqrt(sin^2 + k^2 cos^2), shape of theta."""
        theta = np.asarray(theta, dtype=float)
        return np.asarray(np.hypot(np.sin(theta), self.aspect_ratio * np.cos(theta)))

    def surface(self, theta: ArrayLike, phi: ArrayLike) -> Array:
        """Points (..., 3) of the surface at the broadcast angles."""
        theta, phi = np.broadcast_arrays(np.asarray(theta, float), np.asarray(phi, float))
        radius = self.aspect_ratio * np.sin(theta)
        return np.stack([radius * np.cos(phi), radius * np.sin(phi), np.cos(theta)], axis=-1)

    def normal(self, theta: ArrayLike, phi: ArrayLike) -> Array:
        """Outward unit normals (..., 3) at the broadcast angles."""
        theta, phi = np.broadcast_arrays(np.asarray(theta, float), np.asarray(phi, float))
        s = np.sin(theta)
        n = np.stack([s * np.cos(phi), s * np.sin(phi), self.aspect_ratio * np.cos(theta)], axis=-1)
        return np.asarray(n / self.q(theta)[..., None])

    def area_element(self, theta: ArrayLike) -> Array:
        """W with dS = W dtheta dphi: k sin(theta) q(theta) (Bagge 2015, eq. 5.7)."""
        return np.asarray(self.aspect_ratio * np.sin(np.asarray(theta, float)) * self.q(theta))

    def admissible_radius(self, theta: ArrayLike) -> Array:
        """Largest radius of a ball that touches the surface at theta alone, either side.

        The inscribed ball has radius min(k q, q / k), the radii of curvature are k q and
        q^3 / k; the least of the three bounds both inner and outer expansions.
        """
        q = self.q(theta)
        k = self.aspect_ratio
        return np.minimum(np.minimum(k * q, q / k), q**3 / k)


@cache
def gauss_legendre(n: int) -> tuple[Array, Array]:
    """Nodes and weights (n,) of the Gauss-Legendre rule on [-1, 1]; not to be changed."""
    x, w = np.polynomial.legendre.leggauss(n)
    return np.asarray(x), np.asarray(w)


@dataclass(frozen=True)
class SurfaceGrid:
    """Polar nodes times equispaced azimuthal nodes; point index i_theta * n_phi + j_phi.

    The polar nodes are Gauss-Legendre in cos(theta), which with interpolation in cos(theta) holds
    polynomial densities exactly, or Gauss-Legendre in theta on [0, pi] (Bagge 2015, sec. 5.1).
    """

    spheroid: Spheroid
    n_theta: int
    n_phi: int
    nodes: PolarNodes = "cosine"

    @cached_property
    def _gauss(self) -> tuple[Array, Array, Array]:
        x, w = gauss_legendre(self.n_theta)
        barycentric = (-1.0) ** np.arange(self.n_theta) * np.sqrt((1.0 - x * x) * w)
        if self.nodes == "cosine":
            # arctan2 keeps the nodes symmetric and accurate near the poles.
            s = np.sqrt((1.0 - x) * (1.0 + x))
            return np.arctan2(s, -x), w / s, barycentric
        return np.pi * (x + 1.0) / 2.0, np.pi / 2.0 * w, barycentric

    @property
    def theta(self) -> Array:
        """Polar nodes (n_theta,), increasing."""
        return self._gauss[0]

    @property
    def theta_weights(self) -> Array:
        """Weights (n_theta,) of the polar nodes with respect to d theta."""
        return self._gauss[1]

    @property
    def barycentric(self) -> Array:
        """Barycentric interpolation weights (n_theta,) of the polar nodes."""
        return self._gauss[2]

    @cached_property
    def phi(self) -> Array:
        """Azimuthal nodes (n_phi,), starting at 0."""
        return 2.0 * np.pi * np.arange(self.n_phi) / self.n_phi

    @cached_property
    def points(self) -> Array:
        """Grid points (N, 3)."""
        return self.spheroid.surface(self.theta[:, None], self.phi).reshape(-1, 3)

    @cached_property
    def normals(self) -> Array:
        """Outward unit normals (N, 3)."""
        return self.spheroid.normal(self.theta[:, None], self.phi).reshape(-1, 3)

    @cached_property
    def weights(self) -> Array:
        """Quadrature weights (N,): sum(f * weights) approximates the surface integral of f."""
        w = self.theta_weights * self.spheroid.area_element(self.theta) * (2 * np.pi / self.n_phi)
        return np.repeat(w, self.n_phi)
