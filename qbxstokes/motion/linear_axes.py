"""Axes of bodies that lie in one linear flow: power series of what turns them all.

The axis is q/|q| of q' = L q, with L of the body's law and the gradient (`paths`), a polynomial in
each piece of time (`flows.signals`). With x from 0 to 1 over a step and h L = sum_j m_j x^j the
solution is sum_k q_k x^k, (k + 1) q_(k+1) = sum_j m_j q_(k-j); a majorant, of |m_j| in their place,
tells how many terms are needed. Steps end where pieces do, at the instants that are asked for, and
where the body would turn too far.

Compiled by numba, which is imported with this module.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from qbxstokes.folders import compiled_are_kept

# Most terms of a series; how far a body may turn in a step; growth at which axes begin anew; steps.
_TERMS, _REACH, _GROWTH, _STEPS = 60, 1.0, 1e3, 2_000_000


@njit(cache=compiled_are_kept(), error_model="numpy")
def follow(pieces, law, instants, tolerance, found):  # type: ignore[no-untyped-def]
    """Fill found (T, 3, n), of which [0] holds the axes at time 0, at rising instants (T,).

    pieces: edges (m + 1), origins, scales, and the gradients' coefficients (m, degree + 1, 3, 3).
    law: (linear, rest). More than three axes are turned by one matrix. tolerance: of the axes, per
    time. Returns the last of the instants, or the time after which no number of steps will do.
    """
    edges, origins, scales, gradients = pieces
    linear, rest = law
    count, degree, n = len(instants), gradients.shape[1] - 1, found.shape[2]
    p = found[0].copy()
    single = n <= 3
    columns = n if single else 3
    q, terms = np.empty((_TERMS + 1, 3, columns)), np.empty(_TERMS + 1)
    m, sizes = np.empty((degree + 1, 3, 3)), np.empty(degree + 1)
    flat = m.reshape(degree + 1, 9)
    q[0] = p if single else np.eye(3)
    t, place, piece = 0.0, 0, 0
    while place < count and instants[place] <= 0.0:
        place += 1
    for _ in range(_STEPS):
        if place == count:
            break
        while edges[piece + 1] <= t:
            piece += 1
        # L in powers of (time - origin) scale, then of the time since t.
        for k in range(degree + 1):
            a = gradients[piece, k]
            for i in range(3):
                for j in range(3):
                    along = a[j, i] if linear < 0.0 else a[i, j]
                    m[k, i, j] = rest * (a[i, j] - a[j, i]) + linear * along
        start, length = (t - origins[piece]) * scales[piece], 1.0 / scales[piece]
        for k in range(degree):
            for j in range(degree - 1, k - 1, -1):
                for i in range(9):
                    flat[j, i] += start * flat[j + 1, i]
        end = min(edges[piece + 1], instants[place])
        step, size = end - t, 0.0
        while True:
            size, factor = 0.0, step
            for k in range(degree + 1):
                sizes[k] = 0.0
                for i in range(3):
                    row = abs(m[k, i, 0]) + abs(m[k, i, 1]) + abs(m[k, i, 2])
                    sizes[k] = max(sizes[k], factor * row)
                size += sizes[k]
                factor *= step / length
            if size <= _REACH:
                break
            step *= max(0.1, 0.9 * _REACH / size)
            if not t + step > t:
                return t
        end = end if t + step >= end else t + step
        factor, least = step, max(tolerance * step, 1e-17)
        last = 0
        for k in range(degree + 1):
            for i in range(9):
                flat[k, i] *= factor
            factor *= step / length
            if sizes[k] > 0.1 * least:
                last = k
        terms[0], small, k = 1.0, 0, 0
        while k < _TERMS and small <= last:
            terms[k + 1] = 0.0
            for j in range(min(k, last) + 1):
                terms[k + 1] += sizes[j] * terms[k - j] / (k + 1.0)
            for i in range(3):
                for c in range(columns):
                    value = 0.0
                    for j in range(min(k, last) + 1):
                        one = q[k - j]
                        value += m[j, i, 0] * one[0, c] + m[j, i, 1] * one[1, c]
                        value += m[j, i, 2] * one[2, c]
                    q[k + 1, i, c] = value / (k + 1.0)
            k += 1
            small = small + 1 if terms[k] <= 0.1 * least else 0
        grown = 0.0
        for i in range(3):
            for c in range(columns):
                value = 0.0
                for other in range(k, -1, -1):
                    value += q[other, i, c]
                q[0, i, c] = value
                grown = max(grown, abs(value))
        t = end
        wanted = t == instants[place]
        if wanted or grown > _GROWTH:
            if not single:
                p = q[0] @ p
                q[0] = np.eye(3)
            x = q[0] if single else p
            for i in range(n):
                size = np.sqrt(x[0, i] ** 2 + x[1, i] ** 2 + x[2, i] ** 2)
                for j in range(3):
                    x[j, i] /= size
        if wanted:
            found[place] = q[0] if single else p
            place += 1
    return t if place < count else instants[count - 1]
