"""Axes of bodies of revolution with inertia of rotation along paths with gradients of their own.

With the axis p, its rate v = dp/dt and the spin s about it the angular velocity is p x v + s p, and

    dv/dt = r (f - v) - g s v x p - |v|^2 p,   ds/dt = r' (w.p/2 - s),

f: the rate dp/dt of the massless body (Jeffery's), w: the vorticity; r, r' = R/(St J) across and
along the axis, g = J'/J (Euler's equations; the torques are those of drag). In an interval these
are met at the five nodes of Radau's quadrature (Radau IIA, order 9; Hairer & Wanner, Solving
Ordinary Differential Equations II, IV.5). The pull r v is solved for, since r is constant, and the
rest is iterated: as fast for stiff bodies as for lazy ones, since what is left contracts as the
turn within the interval. How fast the Legendre coefficients of v fall tells the error, and how well
the nodes know exp(-r t) what a start makes of it that is off what drag allows, as after a kink: the
integral of v is right then, but for what the axis feels meanwhile. An interval that is too long for
either, or for the iteration, is divided, for each path as it needs.

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
# Iterations at most, parts of an interval at most and the shortest one, what rounding leaves of a
# rate, and the part, in times of relaxation, that a start off what drag allows is tried in.
_MOST, _PARTS, _SHORTEST, _ROUNDING, _SUDDEN = 20, 200_000, 2.0**-44, 2e-15, 2.0


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
def left_out(sizes: Any, b: int, pull: float, across: Any, turn: float, enough: float) -> Any:
    """Errors of the integral of v and of v at the end, from its Legendre coefficients (`_radau`).

    The quadrature is right to degree 8, where the coefficients have fallen further. If that is not
    enough: a start that is off decays as exp(-pull t), of which the nodes make `across`. What is
    missing of it comes to its share in v over pull, and what the axis feels of it to the turn of
    that. Last: whether it is the start that is to blame.
    """
    fall = min(1.0, sizes[0, b] / (sizes[1, b] + 1e-300))
    smooth = sizes[0, b] * fall * fall
    if smooth <= enough:
        return smooth, 0.0, False
    settled = min(1.0, sizes[2, b] / (sizes[3, b] + 1e-300))
    felt, mean = 0.0, 0.0
    for i in range(STAGES):
        decayed = math.exp(-pull * NODES[i])
        felt = max(felt, abs(across[i, 0] - decayed))
        mean += INTEGRALS[STAGES - 1, i] * decayed
    start = sizes[0, b] / abs(ENDS[0, 0])
    end = start * abs(across[STAGES - 1, 0] - math.exp(-pull))
    sudden = end + start * turn * (felt + abs(mean + math.expm1(-pull) / pull))
    sudden, slow = 2.0 * sudden / pull, sizes[2, b] * settled**3
    return min(smooth, slow + sudden), end, sudden > slow


@inner
def collocate(
    m: Any, body: Any, tolerance: float, accepted: float, p: Any, w: Any, work: Any
) -> None:
    """Axes p (3, LANES) and rates w (4, LANES) at the end of an interval, in place.

    m: powers of L times the length; w: v and s times the length; body: r and r' times the length,
    g, and how many times the error of a rate counts. tolerance: of the axis; accepted: of rates,
    relative. work: of `workroom`, in part. Lanes for which the interval is too long are not `fine`
    and left where they are, `sudden` ones for the sake of their start.
    """
    nodes, place, rate, change, spin, turn, across, along, off, sizes, sudden, fine = work
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
    off[:] = 0.0
    for i in range(9):
        for b in range(LANES):
            off[b] += nodes[0, i, b] ** 2 + nodes[STAGES - 1, i, b] ** 2
    for b in range(LANES):
        for i in range(4):
            sizes[i, b] = 0.0
        size, turned = 0.0, math.sqrt(off[b])
        for i in range(3):
            size += abs(w[i, b])
            for n in range(4):
                value = ENDS[n, 0] * w[i, b]
                for stage in range(STAGES):
                    value += ENDS[n, stage + 1] * rate[stage, i, b]
                sizes[n, b] += abs(value)
        noise = _ROUNDING * (1.0 + weight * size)
        enough = max(tolerance, noise)
        error, end, sudden[b] = left_out(sizes, b, pull, across, turned, enough / weight)
        known = end <= max(enough, accepted * max(size, turned))
        sudden[b] = fine[b] and (sudden[b] or not known)
        fine[b] = fine[b] and known and weight * error <= enough
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
    """Arrays that `turn_inertial` and, from the seventh on, `collocate` work in."""
    return (
        np.zeros((degrees, 9, LANES)),
        np.zeros((3, LANES)),
        np.zeros((4, LANES)),
        np.zeros(LANES),
        np.zeros(LANES),
        np.zeros((2, LANES)),
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
        np.zeros(LANES, np.bool_),
    )


@inner
def part_of(m: Any, start: Any, share: Any, scale: Any, out: Any) -> None:
    """The powers on [start, start + share], (LANES,), of the interval in its own time, times share.

    Zero for lanes with a share of 0. scale (LANES,): to work in.
    """
    degrees, moved = m.shape[0], False
    for b in range(LANES):
        moved = moved or start[b] > 0.0
        scale[b] = share[b]
    for k in range(degrees):
        for i in range(9):
            for b in range(LANES):
                out[k, i, b] = m[k, i, b]
    for k in range(degrees):
        if moved:  # Horner's scheme, once for each derivative
            for j in range(degrees - 2, k - 1, -1):
                for i in range(9):
                    for b in range(LANES):
                        out[j, i, b] += start[b] * out[j + 1, i, b]
        for i in range(9):
            for b in range(LANES):
                out[k, i, b] *= scale[b]
        for b in range(LANES):
            scale[b] *= share[b]


@inner
def shorter(share: float, relaxation: float, sudden: bool) -> float:
    """Share of an interval to try next: half, or at once that in which a start's decay shows."""
    share *= 0.5
    while sudden and share * relaxation > 2.0 * _SUDDEN:
        share *= 0.5
    return share


@inner
def turn_inertial(
    m: Any, relaxation: Any, length: float, span: float, tolerance: float, p: Any, w: Any, work: Any
) -> None:
    """Axes p (3, LANES) and rates w (4, LANES), v and s, at the end of the interval, in place.

    m: powers of L times the length; relaxation: r, r' and g; span: of all intervals, over which
    an error of a lazy body's rate goes on. Lanes that turn too far for the whole interval, or that
    start off what drag allows, take it in parts of their own, halves of halves.
    """
    part, q, u, start, share, pair = work[:6]
    spare, taken = pair[0], pair[1]
    sudden, fine = work[-2:]
    lasting = min(1.0 / relaxation[0], span) / length
    start[:], share[:] = 0.0, 1.0
    for _ in range(_PARTS):
        now, first = 0.0, 1.0
        for b in range(LANES):
            if share[b] > 0.0 and (start[b] < first or (start[b] == first and share[b] > now)):
                now, first = share[b], start[b]
        if now == 0.0:
            return
        for b in range(LANES):
            taken[b] = now if share[b] == now else 0.0
            for i in range(3):
                q[i, b] = p[i, b]
            for i in range(4):
                u[i, b] = w[i, b] * length * taken[b]
        part_of(m, start, taken, spare, part)
        pulls = relaxation[0] * length * now, relaxation[1] * length * now
        body = pulls[0], pulls[1], relaxation[2], 1.0 + lasting / now
        collocate(part, body, tolerance * now, tolerance * span / length, q, u, work[6:])
        for b in range(LANES):
            if taken[b] == 0.0:
                continue
            if not fine[b]:
                share[b] = shorter(now, relaxation[0] * length, sudden[b])
                if share[b] < _SHORTEST:
                    p[0, b], share[b] = math.nan, 0.0
                continue
            for i in range(3):
                p[i, b] = q[i, b]
            for i in range(4):
                w[i, b] = u[i, b] / (length * now)
            start[b] += now
            if start[b] >= 1.0:
                share[b] = 0.0
            elif start[b] % (2.0 * now) == 0.0:
                share[b] = 2.0 * now
    for b in range(LANES):
        if share[b] > 0.0:
            p[0, b] = math.nan
