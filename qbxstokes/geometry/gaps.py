"""Gaps between spheroids and planes, and the rates of decay that the resolution depends on.

A spheroid has the support function h(m) = L sqrt(k^2 + (1 - k^2)(m.d)^2) in the unit direction m, L
its polar radius and d its axis. Two convex bodies are apart by the largest value over m of
m.(x_2 - x_1) - h_1(m) - h_2(m), which is concave; a negative one says how deep they overlap.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from qbxstokes.typing import Array


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

    from qbxstokes.geometry.gap_kernel import direction

    m = np.empty(3)
    value = direction(apart, np.stack(axes), np.array(ratios), np.array(sizes), m)
    both = list(zip((m, -m), axes, ratios, sizes, strict=True))
    rates = [
        _rate(value, *one, _radius(*other)) for one, other in zip(both, both[::-1], strict=True)
    ]
    return Gap(float(value), m, (rates[0], rates[1]))
