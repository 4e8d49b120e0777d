"""The gaps between all spheroids of a scene, compiled; the direction of each is a concave problem
on the sphere.

Imported only when bodies share a fluid; see `gaps` for what is meant.
"""

import math

import numpy as np
from numba import njit

from qbxstokes.folders import compiled_are_kept

_ITERATIONS = 200


@njit(cache=compiled_are_kept())
def _half_width(m, axis, k, size):  # type: ignore[no-untyped-def]
    along = m[0] * axis[0] + m[1] * axis[1] + m[2] * axis[2]
    return size * math.sqrt(k * k + (1.0 - k * k) * along * along)


@njit(cache=compiled_are_kept())
def value(m, apart, axes, ratios, sizes):  # type: ignore[no-untyped-def]
    """m.apart less the half widths of both bodies along m."""
    total = 0.0
    for i in range(3):
        total += m[i] * apart[i]
    for body in range(2):
        total -= _half_width(m, axes[body], ratios[body], sizes[body])
    return total


@njit(cache=compiled_are_kept())
def _slopes(m, apart, axes, ratios, sizes, slope, hessian):  # type: ignore[no-untyped-def]
    """Fill the gradient (3,), the vector between the points of contact, and Hessian (3, 3)."""
    slope[:] = apart
    hessian[:] = 0.0
    for body in range(2):
        k2, scale, along = ratios[body] ** 2, sizes[body] ** 2, 0.0
        for i in range(3):
            along += m[i] * axes[body, i]
        h = sizes[body] * math.sqrt(k2 + (1.0 - k2) * along * along)
        for i in range(3):
            p = scale * (k2 * m[i] + (1.0 - k2) * along * axes[body, i])
            slope[i] -= p / h
            for j in range(3):
                q = scale * (k2 * m[j] + (1.0 - k2) * along * axes[body, j])
                part = scale * (1.0 - k2) * axes[body, i] * axes[body, j]
                part += scale * k2 if i == j else 0.0
                hessian[i, j] -= part / h - p * q / h**3


@njit(cache=compiled_are_kept())
def direction(apart, axes, ratios, sizes, m):  # type: ignore[no-untyped-def]
    """Make m (3,) the unit direction of the largest value, which is returned.

    Newton's step on the sphere, made an ascent where the problem is flat, and halved until it
    climbs. apart (3,): second centre less first; axes (2, 3), ratios (2,), sizes (2,).
    """
    slope, hessian, new = np.empty(3), np.empty((3, 3)), np.empty(3)
    e, f, trial = np.empty(3), np.empty(3), 0.0
    length = math.sqrt(np.sum(apart * apart))
    m[:] = apart / length if length > 0.0 else axes[0]
    best = value(m, apart, axes, ratios, sizes)
    if length == 0.0:  # in each other: how deep in some direction says enough
        return best
    for _ in range(_ITERATIONS):
        _slopes(m, apart, axes, ratios, sizes, slope, hessian)
        radial = np.sum(slope * m)
        # Two unit vectors across m.
        least = 0
        for i in range(3):
            if abs(m[i]) < abs(m[least]):
                least = i
        e[:] = -m[least] * m
        e[least] += 1.0
        e /= math.sqrt(np.sum(e * e))
        f[0] = m[1] * e[2] - m[2] * e[1]
        f[1] = m[2] * e[0] - m[0] * e[2]
        f[2] = m[0] * e[1] - m[1] * e[0]
        a, b = np.sum(slope * e), np.sum(slope * f)
        if math.sqrt(a * a + b * b) < 1e-13 * length:
            break
        # On the sphere the curvature of the constraint adds -(slope.m) in the tangent plane.
        ee, ef, ff = -radial, 0.0, -radial
        for i in range(3):
            for j in range(3):
                ee += e[i] * hessian[i, j] * e[j]
                ef += e[i] * hessian[i, j] * f[j]
                ff += f[i] * hessian[i, j] * f[j]
        top = 0.5 * (ee + ff) + math.sqrt(0.25 * (ee - ff) ** 2 + ef * ef)
        scale = max(abs(ee), abs(ef), abs(ff))
        if top > -1e-3 * scale:
            ee -= top + 0.1 * scale
            ff -= top + 0.1 * scale
        det = ee * ff - ef * ef
        step_e, step_f = -(ff * a - ef * b) / det, -(ee * b - ef * a) / det
        part = 1.0
        while part > 1e-9:
            new[:] = m + part * (step_e * e + step_f * f)
            new /= math.sqrt(np.sum(new * new))
            trial = value(new, apart, axes, ratios, sizes)
            if trial >= best - 1e-15:
                break
            part *= 0.5
        if part <= 1e-9:
            break
        m[:], best = new, trial
    return best


@njit(cache=compiled_are_kept())
def _radius(k, size, h):  # type: ignore[no-untyped-def]
    """Least radius of curvature where the half width is h."""
    q = k * size / h  # |dx/dtheta| of the unit body
    return size * min(q**3 / k, k * q)


@njit(cache=compiled_are_kept())
def _rate(gap, m, axis, k, size, h, other):  # type: ignore[no-untyped-def]
    """Log of the decay per degree on a body, h half wide, whose neighbour's least radius is other.

    m: the outward normal at the contact.
    """
    if gap <= 0.0:
        return 0.0
    own = _radius(k, size, h)
    d = own + other + gap
    z = (d * d + own * own - other * other) / (2.0 * d)
    c = math.sqrt((z - own) * (z + own))
    reach = gap + c - (d - z) + other
    along, squared, height = m[0] * axis[0] + m[1] * axis[1] + m[2] * axis[2], 0.0, 0.0
    for i in range(3):
        x = size * (k * k * m[i] + (1.0 - k * k) * along * axis[i]) / h + reach / size * m[i]
        squared += x * x
        height += x * axis[i]
    e2 = (1.0 - k) * (1.0 + k)
    rho2 = squared - height * height
    s = squared - e2
    alpha2 = 0.5 * (s + math.sqrt(s * s + 4.0 * e2 * rho2))
    return math.log((math.sqrt(alpha2) + math.sqrt(alpha2 + e2)) / (1.0 + k))


@njit(cache=compiled_are_kept())
def fill(centres, axes, ratios, sizes, normal, heights, pairs, found):  # type: ignore[no-untyped-def]
    """Fill the pairs (P, 2) and found (P, 6): gap, direction (3), rates of both bodies.

    heights: of the centres above the wall with the normal (3,); empty where there is none.
    """
    row = 0
    both, ks, lengths = np.empty((2, 3)), np.empty(2), np.empty(2)
    for b in range(len(centres)):
        for c in range(b):
            both[0], both[1] = axes[b], axes[c]
            ks[0], ks[1] = ratios[b], ratios[c]
            lengths[0], lengths[1] = sizes[b], sizes[c]
            m = found[row, 1:4]
            gap = direction(centres[c] - centres[b], both, ks, lengths, m)
            pairs[row, 0], pairs[row, 1], found[row, 0] = b, c, gap
            h, w = (
                _half_width(m, axes[b], ratios[b], sizes[b]),
                _half_width(m, axes[c], ratios[c], sizes[c]),
            )
            own, other = _radius(ratios[b], sizes[b], h), _radius(ratios[c], sizes[c], w)
            found[row, 4] = _rate(gap, m, axes[b], ratios[b], sizes[b], h, other)
            found[row, 5] = _rate(gap, -m, axes[c], ratios[c], sizes[c], w, own)
            row += 1
        if len(heights):
            h = _half_width(normal, axes[b], ratios[b], sizes[b])
            gap, own = heights[b] - h, _radius(ratios[b], sizes[b], h)
            pairs[row, 0], pairs[row, 1], found[row, 0] = b, -1, gap
            found[row, 1:4] = -normal
            found[row, 4] = _rate(2.0 * gap, -normal, axes[b], ratios[b], sizes[b], h, own)
            found[row, 5] = np.inf
            row += 1
