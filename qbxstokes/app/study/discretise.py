"""What the studies of QBX share: a body by one discretisation, its true error, its time."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qbxstokes.bie.functional import BodyModel
from qbxstokes.bie.operators import SurfaceOperators, form_body_model, surface_operators
from qbxstokes.bie.resistance import Completion
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.qbx.operator import GradedScheme, Scheme, UniformScheme

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Resolved(GradedScheme):
    """The expansions of a uniform scheme, at its radius, with quadrature that is all but exact.

    What is left of the uniform scheme's error is its truncation.
    """

    expansion_radius: float = field(default=0.1, kw_only=True)

    @classmethod
    def of(cls, scheme: UniformScheme, spheroid: Spheroid) -> Resolved:
        """The same expansions with graded panels."""
        return cls(
            scheme.n_theta,
            scheme.expansion_order,
            1.0,
            16,
            0.7,
            scheme.side,
            False,
            expansion_radius=scheme.radius(spheroid, 0.0),
        )

    def radius(self, spheroid: Spheroid, theta: float) -> float:
        """The global radius."""
        return self.expansion_radius

    def grid(self, spheroid: Spheroid, n_phi: int) -> Any:
        """The grid of the uniform scheme."""
        return UniformScheme(self.n_theta, 3, 0, 1e-6, 1).grid(spheroid, n_phi)


def uniform(
    k: float,
    n_theta: int,
    order: int,
    r_over_h: float,
    upsampling: int,
    coefficients: bool = False,
) -> UniformScheme:
    """The thesis's scheme with its n_phi = k n_theta, at least enough for the modes in use."""
    n_phi = max(8, 2 * round(0.5 * k * n_theta))
    return UniformScheme(
        n_theta, n_phi, order, r_over_h, upsampling, "average", coefficients=coefficients
    )


def largest_ratio(k: float, n_theta: int) -> float:
    """The largest admissible r/h: k^2 n_theta/(2 pi), or n_theta/(2 pi k) for k > 1."""
    return min(k * k, 1.0 / k) * n_theta / (2.0 * np.pi)


def cost(scheme: UniformScheme) -> float:
    """Work of the uniform scheme: source nodes times targets times order."""
    sources = scheme.upsampling**2 * scheme.n_theta * scheme.n_phi / 2
    return sources * scheme.n_theta * (scheme.expansion_order + 1)


def formed(
    k: float, scheme: Scheme, completion: Completion = "surface", n_phi: int = 3
) -> tuple[SurfaceOperators, BodyModel, float]:
    """Operators, body model, and the wall time of both."""
    begin = time.perf_counter()
    operators = surface_operators(Spheroid(k), scheme, n_phi, completion)
    model = form_body_model(operators)
    return operators, model, time.perf_counter() - begin
