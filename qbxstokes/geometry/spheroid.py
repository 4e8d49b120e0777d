"""Spheroids of semi-axes (k, k, 1), by closed forms.

Lengths are in units of the polar radius c; k = a/c is the aspect ratio.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.errors import SceneError
from qbxstokes.geometry.shape import MOST_BALLS, Revolution, Symmetry
from qbxstokes.typing import Array


@dataclass(frozen=True)
class Spheroid(Revolution):
    """Surface x = (k sin(theta) cos(phi), k sin(theta) sin(phi), cos(theta)).

    Prolate for k < 1, a sphere for k = 1, oblate for k > 1 (Bagge 2015, eq. 2.2, 5.1).
    Raises SceneError unless 0 < k < inf.
    """

    name: ClassVar[str] = "spheroid"

    aspect_ratio: float

    def __post_init__(self) -> None:
        if not (self.aspect_ratio > 0 and math.isfinite(self.aspect_ratio)):
            wrong = f"is {self.aspect_ratio}"
            raise SceneError("aspect_ratio", wrong, "it must be positive and finite")

    @property
    def symmetry(self) -> Symmetry:
        """That of a sphere for k = 1."""
        return "sphere" if self.aspect_ratio == 1.0 else "fore-aft revolution"

    @property
    def semi_axes(self) -> tuple[float, float, float]:  # type: ignore[override]
        """(k, k, 1)."""
        return self.aspect_ratio, self.aspect_ratio, 1.0

    @property
    def effective_ratio(self) -> float:  # type: ignore[override]
        """k."""
        return self.aspect_ratio

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
        """Principal moments (3,), unit density (Bagge 2015, eq. 3.19)."""
        k2 = self.aspect_ratio**2
        return 4.0 * math.pi / 15.0 * k2 * np.array([k2 + 1.0, k2 + 1.0, 2.0 * k2])

    @property
    def radius(self) -> float:
        """The longer semi-axis."""
        return max(1.0, self.aspect_ratio)

    @property
    def torque_density(self) -> Array:
        """b (3,) for unit torques: 4 pi (1 + k^2)/3 across the axis, 8 pi k^2/3 about it."""
        k = self.aspect_ratio
        across = 3.0 / (4.0 * np.pi * (1.0 + k * k))
        return np.array([across, across, 3.0 / (8.0 * np.pi * k * k)])

    def meridian(self, theta: Array) -> tuple[Array, Array]:
        """rho and z at theta."""
        return self.aspect_ratio * np.sin(theta), np.cos(theta)

    def tangent(self, theta: Array) -> tuple[Array, Array]:
        """d rho/d theta and dz/d theta."""
        return self.aspect_ratio * np.cos(theta), -np.sin(theta)

    def difference(self, theta: Array, at: float) -> tuple[Array, Array]:
        """rho and z at theta less those at one place, exact to rounding however close they are."""
        half = np.sin(0.5 * (theta - at))
        middle = 0.5 * (theta + at)
        return 2.0 * self.aspect_ratio * np.cos(middle) * half, -2.0 * np.sin(middle) * half

    def area_vector(self, theta: Array) -> tuple[Array, Array]:
        """Normal times dS / (dtheta dphi) = k sin(theta) (sin(theta), k cos(theta))."""
        k, s, c = self.aspect_ratio, np.sin(theta), np.cos(theta)
        return k * s * s, k * k * s * c

    def admissible_radius(self, theta: ArrayLike) -> Array:
        """Largest radius of a ball that touches the surface at theta alone, either side.

        The inscribed ball has radius min(k q, q / k) with q = |dx/dtheta|, the radii of curvature
        are k q and q^3 / k; the least of the three bounds both inner and outer expansions.
        """
        q, k = self.speed(theta), self.aspect_ratio
        return np.minimum(np.minimum(k * q, q / k), q**3 / k)

    @property
    def least_radius(self) -> float:
        """k^2 of a prolate body, at its poles, and 1/k of an oblate one (Bagge 2015, 5.3.3)."""
        k = self.aspect_ratio
        return k * k if k <= 1.0 else 1.0 / k

    def level(self, points: Array) -> Array:
        """(x^2 + y^2)/k^2 + z^2."""
        k = self.aspect_ratio
        return np.asarray(
            (points[..., 0] ** 2 + points[..., 1] ** 2) / (k * k) + points[..., 2] ** 2
        )

    def nearest(self, rho: ArrayLike, z: ArrayLike) -> tuple[Array, Array]:
        """theta of the nearest point of the surface, and the distance, negative inside.

        The nearest point of an ellipse is found from the one root t of
        (a y/(t+a^2))^2 + (b z/(t+b^2))^2 = 1 above -min(a, b)^2 by bisection (D. Eberly, Distance
        from a point to an ellipse, 2013).
        """
        k, width, height = self.aspect_ratio, np.asarray(rho, float), np.abs(z)
        low = np.maximum(k * (width - k), height - 1.0)
        high = np.hypot(k * width, height) - min(k, 1.0) ** 2
        tiny = np.finfo(float).tiny
        for _ in range(64):
            t = 0.5 * (low + high)
            across = k * width / np.maximum(t + k * k, tiny)
            along = height / np.maximum(t + 1.0, tiny)
            outside = across**2 + along**2 > 1.0
            low, high = np.where(outside, t, low), np.where(outside, high, t)
        across = np.minimum(k * width / np.maximum(high + k * k, tiny), 1.0)
        along = np.minimum(height / np.maximum(high + 1.0, tiny), 1.0)
        # On the focal segment or disc the coordinate along the shorter semi-axis is 0/0 there and
        # follows from the ellipse.
        if k < 1.0:
            across = np.where(high + k * k < 1e-14, np.sqrt(1.0 - along**2), across)
        else:
            along = np.where(high + 1.0 < 1e-14, np.sqrt(1.0 - across**2), along)
        distance = np.hypot(width - k * across, height - along)
        inside = (width / k) ** 2 + height**2 < 1.0
        theta = np.arctan2(across, np.copysign(along, z))
        return theta, np.where(inside, -distance, distance)

    def extent(self, axis: ArrayLike) -> Array:
        """Matrices C (..., 3, 3) of the bodies with these axes D3 (..., 3): n.C n = h^2."""
        d, square = np.asarray(axis, dtype=float), self.aspect_ratio * self.aspect_ratio
        return np.asarray(square * np.eye(3) + (1.0 - square) * d[..., :, None] * d[..., None, :])

    def interior_balls(self) -> tuple[Array, Array]:
        """Centres (n, 3) and radii (n,) of balls along the focal segment or over the focal disc.

        A disc of more than `MOST_BALLS` of them is filled at as many places, spread at random.
        """
        k, rings, place = self.aspect_ratio, [], 0.0
        while True:
            point = (0.0, place) if k <= 1.0 else (place, 0.0)
            radius = -0.9 * float(self.nearest(*point)[1])
            if radius < 0.2 * min(k, 1.0):
                break
            rings.append((place, radius))
            place += 0.6 * radius
        if k <= 1.0:
            z = np.array([sign * place for place, _ in rings for sign in (1.0, -1.0)])
            return np.stack([0.0 * z, 0.0 * z, z], axis=-1), np.repeat([r for _, r in rings], 2)
        counts = [max(1, int(np.ceil(2.0 * np.pi * place / (0.6 * r)))) for place, r in rings]
        phi = np.concatenate([2.0 * np.pi * np.arange(count) / count for count in counts])
        rho = np.repeat([place for place, _ in rings], counts)
        centres = np.stack([rho * np.cos(phi), rho * np.sin(phi), 0.0 * rho], axis=-1)
        chosen = np.random.default_rng(0).permutation(len(rho))[:MOST_BALLS]
        return centres[chosen], np.repeat([r for _, r in rings], counts)[chosen]

    def decay(self, points: ArrayLike) -> Array:
        """Factor (...) per degree by which surface harmonics decay from the surface to points.

        points (..., 3) in the body frame. With the confocal spheroid through the point having
        semi-axes (a', a', c'), it is (k + 1)/(a' + c'): the ratio of the confocal coordinates
        xi + sqrt(xi^2 - 1) in the expansion of 1/|x - y| (Hobson 1931, chapter X). It is 1 on the
        surface and not below it, and for a sphere the ratio of the distances.
        """
        k, s = float(self.aspect_ratio), self._confocal(points)
        return np.asarray((k + 1.0) / (np.sqrt(k * k + s) + np.sqrt(1.0 + s)))

    def flow_decay(self, points: ArrayLike) -> Array:
        """The same of harmonics of every order m, as a flow that is singular at the points has.

        Below `decay` in a flat body's plane alone, where those of m near the degree n decay as the
        distance from its axis. With coordinates a' = f cosh t, c' = f sinh t and latitude b, where
        f^2 = k^2 - 1, it is exp(-E), E the least over q = m/n of the exponents along t, of
        sqrt(1 - q^2/cosh^2 t), and along b, of sqrt(q^2/cos^2 b - 1) beyond cos b = q (Liouville
        and Green's form of the associated Legendre functions).
        """
        k = float(self.aspect_ratio)
        if k <= 1.0:
            return self.decay(points)
        s = self._confocal(points)[..., None]
        q = np.linspace(0.0, 1.0 - 1e-6, 101)
        p, far = np.sqrt(1.0 - q * q), np.sqrt((1.0 + s) / (k * k - 1.0))

        def along(t: Array) -> Array:
            return np.asarray(np.arcsinh(t / p) - q * np.arctanh(q * t / np.hypot(t, p)))

        sine = np.minimum(np.abs(np.asarray(points, float)[..., 2:]) / np.sqrt(1.0 + s), 1.0)
        x = np.maximum(sine, p)
        share = np.sqrt(x * x - p * p) / np.maximum(q * x, 1e-300)
        across = q * np.arctanh(np.minimum(share, 1.0 - 1e-15)) - np.arccosh(x / p)
        exponent = along(far) - along(np.sqrt(1.0 / (k * k - 1.0))) + across
        return np.asarray(np.exp(-exponent.min(axis=-1)))

    def _confocal(self, points: ArrayLike) -> Array:
        """s >= 0 (...) of the confocal spheroid of squares of semi-axes k^2 + s, 1 + s."""
        k, x = float(self.aspect_ratio), np.asarray(points, dtype=float)
        z2 = x[..., 2] ** 2
        r2 = x[..., 0] ** 2 + x[..., 1] ** 2
        # r^2/(k^2 + s) + z^2/(1 + s) = 1 for the parameter s of the confocal family.
        b = k * k + 1.0 - r2 - z2
        c = k * k - r2 - z2 * k * k
        root = np.sqrt(np.maximum(b * b - 4.0 * c, 0.0))
        # The larger root, without cancellation whatever the sign of b.
        with np.errstate(divide="ignore", invalid="ignore"):
            s = np.where(b > 0.0, -2.0 * c / (b + root), 0.5 * (root - b))
        return np.asarray(np.maximum(s, 0.0))
