"""The surface grid that carries densities: polar times azimuthal nodes on a body of revolution."""

from dataclasses import dataclass
from functools import cache, cached_property
from typing import Literal

import numpy as np

from qbxstokes.geometry.shape import Revolution
from qbxstokes.typing import Array

PolarNodes = Literal["cosine", "theta"]


@cache
def gauss_legendre(n: int) -> tuple[Array, Array]:
    """Nodes and weights (n,) of the Gauss-Legendre rule on [-1, 1]; not to be changed."""
    x, w = np.polynomial.legendre.leggauss(n)
    return np.asarray(x), np.asarray(w)


def polar_rule(n: int, nodes: PolarNodes) -> tuple[Array, Array]:
    """theta and weights (n,) of d theta: Gauss-Legendre in cos(theta), or in theta on [0, pi]."""
    x, w = gauss_legendre(n)
    if nodes == "theta":
        return np.pi * (x + 1.0) / 2.0, np.pi / 2.0 * w
    # arctan2 keeps the nodes symmetric and accurate near the poles.
    s = np.sqrt((1.0 - x) * (1.0 + x))
    return np.arctan2(s, -x), w / s


@dataclass(frozen=True)
class SurfaceGrid:
    """Polar nodes times equispaced azimuthal nodes; point index i_theta * n_phi + j_phi.

    The polar nodes are Gauss-Legendre in cos(theta), which with interpolation in cos(theta) holds
    polynomial densities exactly, or Gauss-Legendre in theta on [0, pi] (Bagge 2015, sec. 5.1).
    """

    shape: Revolution
    n_theta: int
    n_phi: int
    nodes: PolarNodes = "cosine"

    @cached_property
    def theta(self) -> Array:
        """Polar nodes (n_theta,), increasing."""
        return polar_rule(self.n_theta, self.nodes)[0]

    @cached_property
    def theta_weights(self) -> Array:
        """Weights (n_theta,) of the polar nodes with respect to d theta."""
        return polar_rule(self.n_theta, self.nodes)[1]

    @cached_property
    def barycentric(self) -> Array:
        """Barycentric interpolation weights (n_theta,) of the polar nodes."""
        x, w = gauss_legendre(self.n_theta)
        return np.asarray((-1.0) ** np.arange(self.n_theta) * np.sqrt((1.0 - x * x) * w))

    @cached_property
    def phi(self) -> Array:
        """Azimuthal nodes (n_phi,), starting at 0."""
        return 2.0 * np.pi * np.arange(self.n_phi) / self.n_phi

    @cached_property
    def points(self) -> Array:
        """Grid points (N, 3)."""
        return self.shape.surface(self.theta[:, None], self.phi).reshape(-1, 3)

    @cached_property
    def normals(self) -> Array:
        """Outward unit normals (N, 3)."""
        return self.shape.normal(self.theta[:, None], self.phi).reshape(-1, 3)

    @cached_property
    def weights(self) -> Array:
        """Quadrature weights (N,): sum(f * weights) approximates the surface integral of f."""
        w = self.theta_weights * self.shape.area_element(self.theta) * (2 * np.pi / self.n_phi)
        return np.repeat(w, self.n_phi)
