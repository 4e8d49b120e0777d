"""Where a flow is known: inside surfaces that no body may cross, such as the walls of a channel.

A body is told by its centre x (..., 3) and by the matrix C (..., 3, 3) of an ellipsoid, whose
support function is h(e) = sqrt(e . C e): C = k^2 I + (1 - k^2) d d^T for a spheroid with axis d.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.typing import Array

# Newton's method doubles the digits from a first guess that has one in the worst case.
_NEWTON = 12


@dataclass(frozen=True, eq=False)
class Plane:
    """A plane through `point` (3,); the flow is on the side to which `inward` (3,) points."""

    point: Array
    inward: Array

    def room(self, centre: Array) -> Array:
        """Distance (...) of points (..., 3) from the plane, negative beyond it."""
        return np.asarray((centre - self.point) @ self.inward)

    def gap(self, centre: Array, extent: Array) -> Array:
        """Distance (...) of bodies from the plane, negative where they pass it."""
        n = self.inward
        return np.asarray(self.room(centre) - np.sqrt(np.einsum("i,...ij,j->...", n, extent, n)))

    def moved(self, turn: Array, displacement: Array) -> Plane:
        """The plane turned about the space origin, then moved."""
        return Plane(turn @ self.point + displacement, turn @ self.inward)

    def __str__(self) -> str:
        return f"the wall {_equation(self.inward, float(self.inward @ self.point))}"


@dataclass(frozen=True, eq=False)
class Cylinder:
    """A tube about the line through `point` along `axis` (unit); the flow is inside `radius`."""

    point: Array
    axis: Array
    radius: float

    def room(self, centre: Array) -> Array:
        """Radius less the distance of points from the axis."""
        across = np.cross(centre - self.point, self.axis)
        return np.asarray(self.radius - np.linalg.norm(across, axis=-1))

    def gap(self, centre: Array, extent: Array) -> Array:
        """Radius less the largest distance of the body from the axis.

        Of the body's shadow along the axis, an ellipse c + M u with |u| <= 1 and M M^T of
        eigenvalues a >= b, the largest |c + M u|^2 is the least over m >= a of
        m + c_a^2 m/(m - a) + c_b^2 m/(m - b) (the dual of a trust-region problem, which has no gap:
        Conn, Gould and Toint 2000, Trust-region methods, sec. 7.2-7.3). Its stationary point is
        found by Newton's method for 1/sqrt(f) = 1, f = a c_a^2/(m - a)^2 + b c_b^2/(m - b)^2.
        """
        first, second = _across(self.axis)
        away = centre - self.point
        x, y = away @ first, away @ second
        one, two, mixed = (
            np.einsum("i,...ij,j->...", e, extent, f)
            for e, f in ((first, first), (second, second), (first, second))
        )
        turn = 0.5 * np.arctan2(2.0 * mixed, one - two)
        mean, half = 0.5 * (one + two), np.hypot(0.5 * (one - two), mixed)
        a, b = mean + half, np.maximum(mean - half, 0.0)
        ca = (np.cos(turn) * x + np.sin(turn) * y) ** 2
        cb = (np.cos(turn) * y - np.sin(turn) * x) ** 2
        least = 1e-14 * a
        s = np.maximum(np.maximum(np.sqrt(a * ca), np.sqrt(b * cb) - 2.0 * half), least)
        for _ in range(_NEWTON):
            p, q = a * ca / s**2, b * cb / (s + 2.0 * half) ** 2
            f, slope = p + q, p / s + q / (s + 2.0 * half)
            far = f > 1.0  # else the largest distance is at the edge of the interval: m = a
            s = np.where(far, s - f * (1.0 - np.sqrt(f)) / np.where(far, slope, 1.0), s)
        m = a + s
        return np.asarray(self.radius - np.sqrt(m + ca * m / s + cb * m / (s + 2.0 * half)))

    def moved(self, turn: Array, displacement: Array) -> Cylinder:
        """The tube turned about the space origin, then moved."""
        return Cylinder(turn @ self.point + displacement, turn @ self.axis, self.radius)

    def __str__(self) -> str:
        return f"the wall of the tube of radius {self.radius:g}"


Edge = Plane | Cylinder  # a surface that ends a flow
Domain = tuple[Edge, ...]


def moved(domain: Domain, turn: ArrayLike, displacement: ArrayLike) -> Domain:
    """All surfaces of a domain turned about the space origin, then moved."""
    rotation, way = np.asarray(turn, dtype=float), np.asarray(displacement, dtype=float)
    return tuple(edge.moved(rotation, way) for edge in domain)


def channel(half_width: float) -> Domain:
    """Between plates at x2 = +-half_width."""
    up = np.array([0.0, 1.0, 0.0])
    return Plane(half_width * up, -up), Plane(-half_width * up, up)


def tube(radius: float) -> Domain:
    """Inside a tube along e1."""
    return (Cylinder(np.zeros(3), np.array([1.0, 0.0, 0.0]), radius),)


class Outline(Protocol):
    """The part of a shape that a flow and its domain are checked against."""

    def clearance(self, points: ArrayLike, centre: ArrayLike, axis: ArrayLike) -> Array:
        """Signed distance (..., m) of points (m, 3), for centres and axes (..., 3)."""

    def interior_balls(self) -> tuple[Array, Array]:
        """Centres (n, 3) and radii (n,) of balls inside, the axis the third coordinate."""

    def extent(self, axis: ArrayLike) -> Array:
        """The matrix C (..., 3, 3) of an ellipsoid around bodies with these axes (..., 3)."""


def outside(domain: Domain, centre: ArrayLike, axis: ArrayLike, shape: Outline) -> dict[int, str]:
    """Which of n bodies, centres and axes (n, 3), are not inside a domain, and why."""
    x, body = np.asarray(centre, dtype=float), shape.extent(axis)
    found: dict[int, str] = {}
    for edge in domain:
        gap = edge.gap(x, body)
        for lane in np.flatnonzero(~(gap > 0.0)).tolist():
            how = f"the body's surface passes {edge}, where the flow ends, by {-gap[lane]:.3g}"
            found.setdefault(lane, how)
    return found


def _across(axis: Array) -> tuple[Array, Array]:
    first = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    first /= np.linalg.norm(first)
    return first, np.cross(axis, first)


def _equation(normal: Array, offset: float) -> str:
    """x2 = 5, or n . x = 5 of a plane that lies askew."""
    place: Any = np.flatnonzero(np.abs(normal) > 1.0 - 1e-12)
    if len(place):
        sign = float(np.sign(normal[place[0]]))
        return f"x{place[0] + 1} = {sign * offset + 0.0:g}"
    return f"({', '.join(f'{value:.4g}' for value in normal)}) . x = {offset + 0.0:g}"
