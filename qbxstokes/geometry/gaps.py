"""Gaps between spheroids and planes, and the rates of decay that the resolution depends on.

A spheroid has the support function h(m) = L sqrt(k^2 + (1 - k^2)(m.d)^2) in the unit direction m, L
its polar radius and d its axis. Two convex bodies are apart by the largest value over m of
m.(x_2 - x_1) - h_1(m) - h_2(m), which is concave; a negative one says how deep they overlap.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
_ITERATIONS = 200


@dataclass(frozen=True)
class Gap:
    """The least gap (scene units) and the unit direction there from the first to the second.

    rates: per body, log of the decay per degree of the harmonics of its neighbour's images: of the
    spheres osculating the bodies at the gap they pile up at the limiting points of bispherical
    coordinates, whose confocal coordinate on the body is the rate. For equal spheres it is
    acosh(1 + gap/(2 R)), by a wall acosh(1 + gap/R).
    """

    gap: float
    direction: Array
    rates: tuple[float, float]


def support(direction: Array, axis: Array, aspect_ratio: float, size: float) -> float:
    """Half width of a spheroid along a unit direction."""
    k2 = aspect_ratio**2
    return size * float(np.sqrt(k2 + (1.0 - k2) * (direction @ axis) ** 2))


def contact_point(direction: Array, axis: Array, aspect_ratio: float, size: float) -> Array:
    """Point of the surface, from the centre, whose outward normal is a unit direction."""
    k2 = aspect_ratio**2
    along = (direction @ axis) * axis
    h = support(direction, axis, aspect_ratio, size)
    return np.asarray(size**2 * (k2 * direction + (1.0 - k2) * along) / h)


def _radius(direction: Array, axis: Array, k: float, size: float) -> float:
    """Least radius of curvature at a contact."""
    q = k * size / support(direction, axis, k, size)  # |dx/dtheta| of the unit body
    return size * min(q**3 / k, k * q)


def _rate(gap: float, direction: Array, axis: Array, k: float, size: float, other: float) -> float:
    """Log of the decay per degree on a body whose neighbour's least radius is `other`."""
    if gap <= 0.0:
        return 0.0
    own = _radius(direction, axis, k, size)
    d = own + other + gap
    z = (d * d + own * own - other * other) / (2.0 * d)
    c = np.sqrt((z - own) * (z + own))
    depth = c - (d - z) + other
    x = contact_point(direction, axis, k, size) + (gap + depth) * direction
    height = x @ axis / size
    rho2 = x @ x / size**2 - height**2
    e2 = (1.0 - k) * (1.0 + k)
    s = rho2 + height**2 - e2
    alpha2 = 0.5 * (s + np.sqrt(s * s + 4.0 * e2 * rho2))
    return float(np.log((np.sqrt(alpha2) + np.sqrt(alpha2 + e2)) / (1.0 + k)))


def wall_gap(height: float, normal: Array, axis: Array, k: float, size: float) -> Gap:
    """Gap between a body whose centre is `height` above a plane and the plane."""
    gap = height - support(normal, axis, k, size)
    radius = _radius(normal, axis, k, size)
    return Gap(gap, -normal, (_rate(2.0 * gap, -normal, axis, k, size, radius), np.inf))


def pair_gap(
    apart: Array,
    axes: tuple[Array, Array],
    ratios: tuple[float, float],
    sizes: tuple[float, float],
) -> Gap:
    """Gap between two spheroids whose centres are `apart` (second less first)."""

    def objective(m: Array) -> float:
        return float(m @ apart) - sum(map(support, (m, m), axes, ratios, sizes))

    def ascent(m: Array) -> Array:
        points = map(contact_point, (m, m), axes, ratios, sizes)
        return np.asarray(apart - sum(points))

    distance = np.linalg.norm(apart)
    if distance == 0.0:  # one within the other
        m = np.eye(3)[0]
        return Gap(objective(m), m, (0.0, 0.0))
    m = apart / distance
    value = objective(m)
    for _ in range(_ITERATIONS):
        # The gradient is the vector between the two points of contact: parallel to m at the best.
        slope = ascent(m)
        across = slope - (slope @ m) * m
        if np.linalg.norm(across) < 1e-13 * distance:
            break
        step = _newton(m, across, slope, axes, ratios, sizes)
        length = 1.0
        while length > 1e-9:
            new = m + length * step
            new /= np.linalg.norm(new)
            trial = objective(new)
            if trial >= value - 1e-15:
                break
            length *= 0.5
        if length <= 1e-9:
            break
        m, value = new, trial
    both = list(zip((m, -m), axes, ratios, sizes, strict=True))
    rates = [
        _rate(value, *one, _radius(*other)) for one, other in zip(both, both[::-1], strict=True)
    ]
    return Gap(value, m, (rates[0], rates[1]))


def _newton(
    m: Array,
    across: Array,
    slope: Array,
    axes: tuple[Array, Array],
    ratios: tuple[float, float],
    sizes: tuple[float, float],
) -> Array:
    """Newton's step on the sphere (tangential, 3), or steepest ascent where it does not ascend."""
    hessian = np.zeros((3, 3))
    for axis, k, size in zip(axes, ratios, sizes, strict=True):
        matrix = size**2 * (k * k * np.eye(3) + (1.0 - k * k) * np.outer(axis, axis))
        h = support(m, axis, k, size)
        hessian -= matrix / h - np.outer(matrix @ m, matrix @ m) / h**3
    # On the sphere the curvature of the constraint adds -(slope.m) in the tangent plane.
    tangent = np.linalg.svd(m[None, :])[2][1:]
    reduced = tangent @ hessian @ tangent.T - (slope @ m) * np.eye(2)
    top = float(np.linalg.eigvalsh(reduced)[-1])
    scale = float(np.abs(reduced).max())
    if top > -1e-3 * scale:
        reduced -= (top + 0.1 * scale) * np.eye(2)
    return np.asarray(-tangent.T @ np.linalg.solve(reduced, tangent @ across))
