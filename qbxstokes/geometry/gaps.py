"""Gaps between spheroids and planes, and the rates of decay that the resolution depends on.

A spheroid has the support function h(m) = L sqrt(k^2 + (1 - k^2)(m.d)^2) in the unit direction m, L
its polar radius and d its axis. Two convex bodies are apart by the largest value over m of
m.(x_2 - x_1) - h_1(m) - h_2(m), which is concave; a negative one says how deep they overlap.
"""

from dataclasses import dataclass

import numpy as np

from qbxstokes.typing import Array, Integers


@dataclass(frozen=True)
class Gaps:
    """Gap (P,) of every pair (scene units) and unit direction (P, 3) from the first to the second.

    pairs (P, 2): a body and an earlier one, or -1, the wall. rates (P, 2): per body, log of the
    decay per degree of the harmonics of its neighbour's images: of the spheres osculating the
    bodies at the gap they pile up at the limiting points of bispherical coordinates, whose confocal
    coordinate on the body is the rate. For equal spheres it is acosh(1 + gap/(2 R)), by a wall
    acosh(1 + gap/R).
    """

    pairs: Integers
    gap: Array
    direction: Array
    rates: Array


def gaps_between(
    centres: Array,
    axes: Array,
    ratios: Array,
    sizes: Array,
    normal: Array | None = None,
    heights: Array | None = None,
    known: Gaps | None = None,
) -> Gaps:
    """All gaps of spheroids with centres and axes (N, 3), k (N,) and polar radii (N,).

    normal (3,), heights (N,): of a wall, and of the centres above it. known: the result, where
    another rank has found it.
    """
    wall = (np.zeros(3), np.zeros(0)) if normal is None or heights is None else (normal, heights)
    given = [np.ascontiguousarray(some, float) for some in (centres, axes, ratios, sizes, *wall)]
    key = tuple(some.tobytes() for some in given)
    if key not in _LATEST:
        _LATEST[key] = _found(given) if known is None else known
        if len(_LATEST) > _KEPT:
            del _LATEST[next(iter(_LATEST))]
    return _LATEST[key]


# What watches bodies, what chooses grids and what deals them ask alike.
_KEPT = 4
_LATEST: dict[tuple[bytes, ...], Gaps] = {}


def _found(given: list[Array]) -> Gaps:
    """The gaps, by the arrays of what `gaps_between` is given; not to be written to."""
    from qbxstokes.geometry.gap_kernel import fill

    n, walls = len(given[2]), len(given[5])
    count = n * (n - 1) // 2 + walls
    pairs, found = np.empty((count, 2), dtype=np.int64), np.empty((count, 6))
    fill(*given, pairs, found)
    pairs.flags.writeable = found.flags.writeable = False
    return Gaps(pairs, found[:, 0], found[:, 1:4], found[:, 4:])


def contact_point(direction: Array, axis: Array, aspect_ratio: float, size: float) -> Array:
    """Point of the surface, from the centre, whose outward normal is a unit direction."""
    k2, along = aspect_ratio**2, direction @ axis
    h = size * np.sqrt(k2 + (1.0 - k2) * along**2)
    return np.asarray(size**2 * (k2 * direction + (1.0 - k2) * along * axis) / h)
