"""One body over a wall, compiled: velocities from a table in gap and tilt, and dy/dt of them.

The table and its units are those of `simulation.wall_table`, which makes it cell by cell.
"""

import math

import numpy as np
from numba import njit

from qbxstokes.folders import compiled_are_kept


@njit(cache=compiled_are_kept())
def rate(y, load, plane, k, size, terms, first, cells, pieces, out):  # type: ignore[no-untyped-def]
    """Fill dy/dt (7,) of a massless body in the state y (7,); returns what `evaluate` does."""
    x, d, loads, motion = np.empty((1, 3)), np.empty((1, 3)), np.empty((1, 6)), np.empty((1, 6))
    a, b, c, e = y[3], y[4], y[5], y[6]
    x[0] = y[:3]
    loads[0] = load
    # The axis by |q|^2, a length that `evaluate` takes out.
    d[0, 0], d[0, 1], d[0, 2] = 2.0 * (b * e + a * c), 2.0 * (c * e - a * b), 0.0
    d[0, 2] = a * a - b * b - c * c + e * e
    where = evaluate(x, d, loads, plane, k, size, terms, first, cells, pieces, motion)
    if where != -1:
        return where
    u, v, w = 0.5 * motion[0, 3], 0.5 * motion[0, 4], 0.5 * motion[0, 5]
    out[:3] = motion[0, :3]
    out[3] = -u * b - v * c - w * e
    out[4] = u * a + v * e - w * c
    out[5] = v * a + w * b - u * e
    out[6] = w * a + u * c - v * b
    return where


@njit(cache=compiled_are_kept(), fastmath=True)
def evaluate(  # type: ignore[no-untyped-def]
    x, d, loads, plane, k, size, terms, first, cells, pieces, out
):
    """Fill velocities (N, 6); -1, or 1000 + the first cell that is not there, or -2: contact."""
    most = pieces.shape[2]
    in_gap, in_tilt, weights, value = np.empty(most), np.empty(most), np.empty(most), np.empty(42)
    n, point, own = plane[0], plane[1], plane[2]
    e1, e2, even, odd = np.empty(3), np.empty(3), np.empty(7), np.empty(7)
    got = np.empty(6)
    for i in range(x.shape[0]):
        height, up, squared = 0.0, 0.0, 0.0
        for j in range(3):
            height += (x[i, j] - point[j]) * n[j]
            up += d[i, j] * n[j]
            squared += d[i, j] ** 2
        up /= math.sqrt(squared)
        sign = 1.0 if up >= 0.0 else -1.0
        across = math.sqrt(max(1.0 - up * up, 0.0))
        gap = height / size - math.sqrt(k * k * across * across + up * up)
        if not gap > 0.0:
            return -2
        place = math.log2(gap)
        cell = math.floor(place)
        if cell < first or cell - first >= len(cells) or cells[cell - first, 3] == 0:
            return 1000 + cell
        # e1 along the axis in the wall, e2 = N x e1.
        if across > 1e-8:
            for j in range(3):
                e1[j] = sign * (d[i, j] / math.sqrt(squared) - up * n[j]) / across
        else:
            least = 0
            for j in range(3):
                if abs(n[j]) < abs(n[least]):
                    least = j
            norm = math.sqrt(1.0 - n[least] ** 2)
            for j in range(3):
                e1[j] = ((1.0 if j == least else 0.0) - n[least] * n[j]) / norm
        e2[0] = n[1] * e1[2] - n[2] * e1[1]
        e2[1] = n[2] * e1[0] - n[0] * e1[2]
        e2[2] = n[0] * e1[1] - n[1] * e1[0]
        sigma = math.atan2(math.sqrt(k) * across, abs(up))
        row = cells[cell - first]
        begin, in_gaps, in_tilts = int(row[0]), int(row[1]), int(row[2])
        gaps, tilts = int(row[3]), int(row[4])
        at_gap, at_tilt = (place - cell) * in_gaps, sigma / (0.5 * math.pi) * in_tilts
        a_piece = min(int(at_gap), in_gaps - 1)
        b_piece = min(int(at_tilt), in_tilts - 1)
        _chebyshev(2.0 * (at_gap - a_piece) - 1.0, gaps, in_gap)
        _chebyshev(2.0 * (at_tilt - b_piece) - 1.0, tilts, in_tilt)
        for p in range(gaps):
            for q in range(tilts):
                weights[p * tilts + q] = in_gap[p] * in_tilt[q]
        piece = pieces[begin + a_piece * in_tilts + b_piece]
        for f in range(42):
            total = 0.0
            for p in range(gaps * tilts):
                total += weights[p] * piece[f, p]
            value[f] = total
        even[:], odd[:] = 0.0, 0.0
        for j in range(3):
            fall, turn = loads[i, j] / size**2, loads[i, 3 + j] / size**3
            even[0] += fall * e1[j]
            even[1] += fall * n[j]
            even[2] += turn * e2[j]
            odd[0] += fall * e2[j]
            odd[1] += turn * e1[j]
            odd[2] += turn * n[j]
            a = terms[0, j]
            along, aside = 0.0, 0.0
            for c in range(3):
                away = x[i, c] - point[c] - height * n[c]
                a += terms[1 + j, c] * away
                along += terms[1 + j, c] * e1[c]
                aside += terms[1 + j, c] * e2[c]
            even[3] += a * e1[j]
            even[4] += size * along * e1[j]
            even[5] += size * aside * e2[j]
            even[6] += size * terms[4, j] * e1[j]
            odd[3] += a * e2[j]
            odd[4] += size * aside * e1[j]
            odd[5] += size * along * e2[j]
            odd[6] += size * terms[4, j] * e2[j]
        for row in range(3):
            up_, side = 0.0, 0.0
            for c in range(3):
                up_ += value[3 * row + c] * even[c]
                side += value[9 + 3 * row + c] * odd[c]
            for c in range(4):
                up_ += value[18 + 4 * row + c] * even[3 + c]
                side += value[30 + 4 * row + c] * odd[3 + c]
            got[row], got[3 + row] = up_, side
        for j in range(3):
            out[i, j] = size * (got[0] * e1[j] + got[1] * n[j] + got[3] * e2[j]) + own[j]
            out[i, 3 + j] = got[2] * e2[j] + got[4] * e1[j] + got[5] * n[j]
    return -1


@njit(cache=compiled_are_kept(), fastmath=True)
def _chebyshev(s, count, out):  # type: ignore[no-untyped-def]
    out[0] = 1.0
    if count > 1:
        out[1] = s
    for j in range(2, count):
        out[j] = 2.0 * s * out[j - 1] - out[j - 2]
