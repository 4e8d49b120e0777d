"""Axes of bodies of revolution with inertia of rotation along paths with gradients of their own.

With the axis p, its rate v = dp/dt and the spin s about it the angular velocity is p x v + s p, and

    dv/dt = r (f - v) - g s v x p - |v|^2 p,   ds/dt = r' (w.p/2 - s),

f: the rate dp/dt of the massless body (Jeffery's), w: the vorticity; r, r' = R/(St J) across and
along the axis, g = J'/J (Euler's equations; the torques are those of drag). In an interval these
are met at the five nodes of Radau's quadrature (Radau IIA, order 9; Hairer & Wanner, Solving
Ordinary Differential Equations II, IV.5). The pull r v is solved for, since r is constant, and the
rest is iterated: as fast for stiff bodies as for lazy ones, since what is left contracts as the
turn within the interval. How fast the Legendre coefficients of v fall tells the error; an interval
that is too long for it, or for the iteration, is divided.

Compiled by numba, which is imported with this module; arrays of lanes have them last, as in
`paths`, and the time of an interval passes from 0 to 1.
"""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from qbxstokes.motion.path_statistics import LANES

inner = numba.njit(error_model="numpy", fastmath={"contract"})

STAGES = 5
# Iterations at most, times an interval is halved at most, and what rounding leaves of a rate.
_MOST, _HALVINGS, _ROUNDING = 20, 16, 2e-15


def _radau() -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Nodes, their matrix of integrals, and what makes Legendre coefficients of six values.

    The values are those at 0 and the nodes; the coefficients 5 and 4 of the polynomial through all
    of them, and 4 and 3 of that through the last five.
    """
    nodes = 0.5 * (np.sort(legendre.legroots([0.0] * (STAGES - 1) + [-1.0, 1.0])) + 1.0)
    nodes[-1] = 1.0
    powers = np.arange(STAGES)
    integrals = (
        nodes[:, None] ** (powers + 1) / (powers + 1) @ np.linalg.inv(nodes[:, None] ** powers)
    )
    values = legendre.legvander(2.0 * np.concatenate([[0.0], nodes]) - 1.0, STAGES)
    ends = np.zeros((4, STAGES + 1))
    ends[:2] = np.linalg.inv(values)[:-3:-1]
    ends[2:, 1:] = np.linalg.inv(values[1:, :-1])[:-3:-1]
    return nodes, integrals, ends


NODES, INTEGRALS, ENDS = _radau()


@inner
def relaxed(rate: float, out: Any) -> None:
    """(1 + rate A)^-1 (1 | A), (5, 6), of the matrix A of integrals, by elimination."""
    a = np.empty((STAGES, STAGES))
    for i in range(STAGES):
        out[i, 0] = 1.0
        for j in range(STAGES):
            a[i, j] = rate * INTEGRALS[i, j] + (1.0 if i == j else 0.0)
            out[i, j + 1] = INTEGRALS[i, j]
    for k in range(STAGES):
        best = k
        for i in range(k + 1, STAGES):
            if abs(a[i, k]) > abs(a[best, k]):
                best = i
        for j in range(STAGES):
            a[k, j], a[best, j] = a[best, j], a[k, j]
        for j in range(STAGES + 1):
            out[k, j], out[best, j] = out[best, j], out[k, j]
        for i in range(STAGES):
            if i != k:
                share = a[i, k] / a[k, k]
                for j in range(STAGES):
                    a[i, j] -= share * a[k, j]
                for j in range(STAGES + 1):
                    out[i, j] -= share * out[k, j]
    for i in range(STAGES):
        for j in range(STAGES + 1):
            out[i, j] /= a[i, i]


@inner
def at_nodes(m: Any, out: Any) -> None:
    """The polynomials m (degree + 1, 9, LANES) at the nodes, (5, 9, LANES)."""
    last = m.shape[0] - 1
    for stage in range(STAGES):
        s = NODES[stage]
        for i in range(9):
            for b in range(LANES):
                out[stage, i, b] = m[last, i, b]
            for k in range(last - 1, -1, -1):
                for b in range(LANES):
                    out[stage, i, b] = s * out[stage, i, b] + m[k, i, b]


@inner
def pulled(m: Any, p: Any, v: Any, spin: Any, pull: float, ratio: float, g: Any, turn: Any) -> None:
    """What changes the rates v at a node but for drag, g (3, LANES), and w.p/2, turn (LANES,)."""
    for b in range(LANES):
        x, y, z = p[0, b], p[1, b], p[2, b]
        one = m[0, b] * x + m[1, b] * y + m[2, b] * z
        two = m[3, b] * x + m[4, b] * y + m[5, b] * z
        three = m[6, b] * x + m[7, b] * y + m[8, b] * z
        u1, u2, u3 = v[0, b], v[1, b], v[2, b]
        along = pull * (one * x + two * y + three * z) + u1 * u1 + u2 * u2 + u3 * u3
        s = ratio * spin[b]
        g[0, b] = pull * one - along * x - s * (u2 * z - u3 * y)
        g[1, b] = pull * two - along * y - s * (u3 * x - u1 * z)
        g[2, b] = pull * three - along * z - s * (u1 * y - u2 * x)
        turn[b] = 0.5 * (
            (m[7, b] - m[5, b]) * x + (m[2, b] - m[6, b]) * y + (m[3, b] - m[1, b]) * z
        )


@inner
def sweep(w: Any, matrix: Any, factor: float, change: Any, fine: Any, out: Any, off: Any) -> None:
    """The rates out (LANES,) at a node from those at the start and what changes them, (5, LANES).

    Those of lanes that are fine stay; off: the largest change so far.
    """
    for b in range(LANES):
        value = 0.0
        for j in range(STAGES):
            value += matrix[j + 1] * change[j, b]
        value = matrix[0] * w[b] + factor * value
        off[b] = max(off[b], abs(value - out[b]))
        out[b] = out[b] if fine[b] else value


@inner
def places(p: Any, rate: Any, stage: int, place: Any) -> None:
    """Axes (3, LANES) at a node."""
    for i in range(3):
        for b in range(LANES):
            value = p[i, b]
            for j in range(STAGES):
                value += INTEGRALS[stage, j] * rate[j, i, b]
            place[i, b] = value


@inner
def left_out(five: float, four: float, last: float, before: float, pull: float) -> float:
    """Error of the integral of v, from the sizes of its Legendre coefficients (see `_radau`).

    The quadrature is right to degree 8, where the coefficients have fallen further. A start off
    what drag allows decays in 1/pull of the interval, unseen by the nodes.
    """
    fall = min(1.0, five / (four + 1e-300))
    settled = min(1.0, last / (before + 1e-300))
    return min(five * fall**2, last * settled**3 + 2.0 * five / (1.0 + pull))


@inner
def collocate(m: Any, body: Any, tolerance: float, p: Any, w: Any, work: Any) -> None:
    """Axes p (3, LANES) and rates w (4, LANES) at the end of an interval, in place.

    m: powers of L times the length; w: v and s times the length; body: r and r' times the length,
    g, and how many times the error of a rate counts. work: of `workroom`, in part. Lanes for which
    the interval is too long are not `fine` and left where they are.
    """
    nodes, place, rate, change, spin, turn, across, along, off, sizes, fine = work
    pull, spin_pull, ratio, weight = body
    relaxed(pull, across)
    relaxed(spin_pull, along)
    at_nodes(m, nodes)
    for stage in range(STAGES):
        for b in range(LANES):
            spin[stage, b] = w[3, b]
            for i in range(3):
                rate[stage, i, b] = w[i, b]
    for b in range(LANES):
        fine[b] = False
    for _ in range(_MOST):
        for stage in range(STAGES):
            places(p, rate, stage, place[stage])
            pulled(
                nodes[stage],
                place[stage],
                rate[stage],
                spin[stage],
                pull,
                ratio,
                change[stage],
                turn[stage],
            )
        for b in range(LANES):
            off[b] = 0.0
        for stage in range(STAGES):
            for i in range(3):
                sweep(w[i], across[stage], 1.0, change[:, i], fine, rate[stage, i], off)
            sweep(w[3], along[stage], spin_pull, turn, fine, spin[stage], off)
        left = 0
        for b in range(LANES):
            size = abs(w[0, b]) + abs(w[1, b]) + abs(w[2, b]) + abs(w[3, b])
            enough = max(0.1 * tolerance, _ROUNDING * (1.0 + weight * size))
            fine[b] = fine[b] or weight * off[b] <= enough
            left += not fine[b]
        if left == 0:
            break
    for b in range(LANES):
        for i in range(4):
            sizes[i, b] = 0.0
        size = 0.0
        for i in range(3):
            size += abs(w[i, b])
            for n in range(4):
                value = ENDS[n, 0] * w[i, b]
                for stage in range(STAGES):
                    value += ENDS[n, stage + 1] * rate[stage, i, b]
                sizes[n, b] += abs(value)
        error = left_out(sizes[0, b], sizes[1, b], sizes[2, b], sizes[3, b], pull)
        fine[b] = fine[b] and weight * error <= max(tolerance, _ROUNDING * (1.0 + weight * size))
    end = STAGES - 1
    places(p, rate, end, place[end])
    for b in range(LANES):
        if fine[b]:
            x, y, z = place[end, 0, b], place[end, 1, b], place[end, 2, b]
            length = 1.0 / math.sqrt(x * x + y * y + z * z)
            x, y, z = length * x, length * y, length * z
            u1, u2, u3 = rate[end, 0, b], rate[end, 1, b], rate[end, 2, b]
            drift = u1 * x + u2 * y + u3 * z
            p[0, b], p[1, b], p[2, b] = x, y, z
            w[0, b], w[1, b], w[2, b] = u1 - drift * x, u2 - drift * y, u3 - drift * z
            w[3, b] = spin[end, b]


@inner
def workroom(degrees: int) -> Any:
    """Arrays that `turn_inertial` and, from the sixth on, `collocate` work in."""
    return (
        np.zeros((degrees, 9, LANES)),
        np.zeros((3, LANES)),
        np.zeros((4, LANES)),
        np.zeros(LANES, np.bool_),
        np.zeros(LANES, np.bool_),
        np.zeros((STAGES, 9, LANES)),
        np.zeros((STAGES, 3, LANES)),
        np.zeros((STAGES, 3, LANES)),
        np.zeros((STAGES, 3, LANES)),
        np.zeros((STAGES, LANES)),
        np.zeros((STAGES, LANES)),
        np.zeros((STAGES, STAGES + 1)),
        np.zeros((STAGES, STAGES + 1)),
        np.zeros(LANES),
        np.zeros((4, LANES)),
        np.zeros(LANES, np.bool_),
    )


@inner
def part_of(m: Any, start: float, share: float, out: Any) -> None:
    """The powers on [start, start + share] of the interval, in its own time, times `share`."""
    degrees = m.shape[0]
    for i in range(9):
        for k in range(degrees):
            for b in range(LANES):
                out[k, i, b] = m[k, i, b]
        for k in range(degrees - 1):  # Horner's scheme, once for each derivative
            for j in range(degrees - 2, k - 1, -1):
                for b in range(LANES):
                    out[j, i, b] += start * out[j + 1, i, b]
        scale = share
        for k in range(degrees):
            for b in range(LANES):
                out[k, i, b] *= scale
            scale *= share


@inner
def turn_inertial(
    m: Any, relaxation: Any, length: float, span: float, tolerance: float, p: Any, w: Any, work: Any
) -> None:
    """Axes p (3, LANES) and rates w (4, LANES), v and s, at the end of the interval, in place.

    m: powers of L times the length; relaxation: r, r' and g; span: of all intervals, over which
    an error of a lazy body's rate goes on. Lanes that turn too far for the whole interval take it
    in as many parts as each of them needs.
    """
    part, q, u, done, good = work[:5]
    fine = work[-1]
    done[:] = False
    lasting = min(1.0 / relaxation[0], span) / length
    count = 1
    for _ in range(_HALVINGS):
        share = 1.0 / count
        for b in range(LANES):
            good[b] = True
            for i in range(3):
                q[i, b] = p[i, b]
            for i in range(4):
                u[i, b] = w[i, b] * length * share
        pulls = relaxation[0] * length * share, relaxation[1] * length * share
        body = pulls[0], pulls[1], relaxation[2], 1.0 + lasting * count
        for number in range(count):
            part_of(m, number * share, share, part)
            collocate(part, body, tolerance * share, q, u, work[5:])
            left = 0
            for b in range(LANES):
                good[b] = good[b] and fine[b]
                left += good[b] and not done[b]
            if left == 0:
                break
        left = 0
        for b in range(LANES):
            if good[b] and not done[b]:
                done[b] = True
                for i in range(3):
                    p[i, b] = q[i, b]
                for i in range(4):
                    w[i, b] = u[i, b] * count / length
            left += not done[b]
        if left == 0:
            return
        count *= 2
    for b in range(LANES):
        if not done[b]:
            p[0, b] = math.nan
