"""Axes of bodies of revolution along many paths, each with velocity gradients of its own.

The axis p of a body without inertia in the gradient A(t) is q/|q| of a linear equation, q' = L q
with L = rest (A - A^T) + lambda A for lambda >= 0 and rest (A - A^T) + lambda A^T for lambda < 0
(Bretherton, J. Fluid Mech. 14, 1962; Szeri, Phil. Trans. R. Soc. A 345, 1993; rest = 1/2 -
|lambda|/2, so that nothing cancels for thin and flat bodies). Between two samples A is a
polynomial, and q has a power series with a recurrence of its own, which is summed to as many terms
as the tolerance takes: a majorant of the series tells how many. An interval in which the body turns
too far is divided. Every interval ends at a sample, so that kinks there cost nothing.

Paths pass through lanes of fixed number, on several of which the compiler works at once; arrays of
lanes have them last. No number of a path depends on the paths beside it.

Compiled by numba, which is imported with this module.
"""

import hashlib
import inspect
import math
from pathlib import Path
from typing import Any

import numba
import numpy as np

from qbxstokes.folders import compiled_are_kept
from qbxstokes.motion import inertial_paths, path_statistics, random_turns
from qbxstokes.motion.inertial_paths import part_of, turn_inertial, workroom
from qbxstokes.motion.path_statistics import (
    LANES,
    add_stresses,
    begin_tile,
    correlate,
    flow_rates,
    follow_flow,
    look_at,
    move_sums,
    note,
)


def compiled(function: Any) -> Any:
    """The function compiled, and kept: numba watches this file alone, so its name tells the rest.

    The rest are the modules that the loops call.
    """
    digest = hashlib.blake2b(digest_size=6)
    for module in (inertial_paths, path_statistics, random_turns):
        digest.update(Path(inspect.getfile(module)).read_bytes())
    function.__qualname__ += f"_{digest.hexdigest()}"
    options = {"error_model": "numpy", "fastmath": {"contract"}}
    return numba.njit(cache=compiled_are_kept(), **options)(function)


inner = numba.njit(error_model="numpy", fastmath={"contract"})

philox = inner(random_turns.philox)
variance = inner(random_turns.variance)
turned = inner(random_turns.turned)

# Most terms of a series, and how far a body may turn in one: |L| times its time.
TERMS, REACH = 40, 1.0


@inner
def spread(samples: Any, window: Any) -> None:
    """Samples (lanes, T, 9) of a few paths by lane, (T, 9, LANES)."""
    lanes, count, _ = samples.shape
    for t in range(count):
        for b in range(lanes):
            for i in range(9):
                window[t, i, b] = samples[b, t, i]


@inner
def powers(window: Any, first: int, weights: Any, c: Any) -> None:
    """A in an interval as powers c (degree + 1, 9, LANES) of its time, 0 to 1."""
    degrees, count = weights.shape
    for k in range(degrees):
        for i in range(9):
            w = weights[k, 0]
            for b in range(LANES):
                c[k, i, b] = w * window[first, i, b]
            for j in range(1, count):
                w = weights[k, j]
                for b in range(LANES):
                    c[k, i, b] += w * window[first + j, i, b]


@inner
def turning(c: Any, length: float, linear: float, rest: float, m: Any) -> None:
    """L of the powers of A, times the length of the interval."""
    size, skew = linear * length, rest * length
    if linear < 0.0:
        skew = -skew
    for k in range(c.shape[0]):
        for i in range(3):
            for j in range(3):
                one, other = 3 * i + j, 3 * j + i
                if linear < 0.0:
                    one, other = other, one
                for b in range(LANES):
                    m[k, 3 * i + j, b] = (
                        skew * (c[k, one, b] - c[k, other, b]) + size * c[k, one, b]
                    )


@inner
def terms_of(m: Any, work: Any, terms: Any, tolerance: float) -> bool:
    """Terms (LANES,) after which each series leaves out less than the tolerance.

    The majorant is exp of the integral of sum |L_k| s^k. Zero terms, and True at the end, where the
    turn is too far.
    """
    degrees = m.shape[0]
    sizes, whole, found, majorant = (
        work[:degrees],
        work[degrees],
        work[degrees + 1],
        work[degrees + 2 :],
    )
    for b in range(LANES):
        whole[b] = 0.0
    for k in range(degrees):
        for b in range(LANES):
            sizes[k, b] = 0.0
        for i in range(9):
            for b in range(LANES):
                sizes[k, b] += m[k, i, b] * m[k, i, b]
        share = 1.0 / (k + 1)
        for b in range(LANES):
            sizes[k, b] = math.sqrt(sizes[k, b])
            whole[b] += sizes[k, b] * share
    far, left = False, 0
    for b in range(LANES):
        terms[b] = TERMS
        if not whole[b] <= REACH:
            terms[b], far = 0, True
        whole[b] = math.exp(min(whole[b], REACH)) - tolerance
        found[b] = 1.0
        majorant[0, b] = 1.0
    for n in range(TERMS - 1):
        left = 0
        for b in range(LANES):
            if terms[b] == TERMS:
                if whole[b] <= found[b]:
                    terms[b] = n + 1
                else:
                    left += 1
        if left == 0:
            break
        for b in range(LANES):
            majorant[n + 1, b] = 0.0
        for j in range(min(n + 1, degrees)):
            for b in range(LANES):
                majorant[n + 1, b] += sizes[j, b] * majorant[n - j, b]
        share = 1.0 / (n + 1)
        for b in range(LANES):
            majorant[n + 1, b] *= share
            found[b] += majorant[n + 1, b]
    return far


@inner
def turn(m: Any, terms: Any, series: Any, p: Any) -> None:
    """Axes p (3, LANES) at the end of the interval, in place, by so many terms of their series."""
    degrees, most = m.shape[0], 0
    for b in range(LANES):
        most = max(most, terms[b])
    for i in range(3):
        for b in range(LANES):
            series[0, i, b] = p[i, b]
    for n in range(most - 1):
        for i in range(3):
            for b in range(LANES):
                series[n + 1, i, b] = 0.0
        for j in range(min(n + 1, degrees)):
            for i in range(3):
                for b in range(LANES):
                    series[n + 1, i, b] += (
                        m[j, 3 * i, b] * series[n - j, 0, b]
                        + m[j, 3 * i + 1, b] * series[n - j, 1, b]
                        + m[j, 3 * i + 2, b] * series[n - j, 2, b]
                    )
        share = 1.0 / (n + 1)
        for i in range(3):
            for b in range(LANES):
                series[n + 1, i, b] *= share
                p[i, b] += series[n + 1, i, b] if n + 1 < terms[b] else 0.0
    for b in range(LANES):
        length = 1.0 / math.sqrt(p[0, b] * p[0, b] + p[1, b] * p[1, b] + p[2, b] * p[2, b])
        p[0, b] *= length
        p[1, b] *= length
        p[2, b] *= length


@compiled
def far_lane(m: Any, lane: int, tolerance: float, p: Any) -> None:
    """The axis of a lane that turns too far for one series, in as many parts as it takes."""
    degrees = m.shape[0]
    part, q = np.zeros((degrees, 9, LANES)), np.zeros((3, LANES))
    start, share, scale = np.zeros(LANES), np.zeros(LANES), np.empty(LANES)
    work, series = np.empty((degrees + 2 + TERMS, LANES)), np.empty((TERMS, 3, LANES))
    terms = np.empty(LANES, np.int64)
    size = 0.0
    for k in range(degrees):
        square = 0.0
        for i in range(9):
            square += m[k, i, lane] * m[k, i, lane]
        size += math.sqrt(square)
    parts = int(size / REACH) + 1
    q[2] = 1.0
    for i in range(3):
        q[i, lane] = p[i, lane]
    for place in range(parts):
        start[lane], share[lane] = place / parts, 1.0 / parts
        part_of(m, start, share, scale, part)
        terms_of(part, work, terms, tolerance / parts)
        turn(part, terms, series, q)
    for i in range(3):
        p[i, lane] = q[i, lane]


@inner
def kick(p: Any, turns: Any, length: float, place: Any, lanes: int, later: bool) -> None:
    """Turn the axes p (3, LANES) at random, as in half of an interval.

    place: path of the first lane, interval, body.
    """
    spread = variance(turns.diffusivity, 0.5 * length)
    for b in range(lanes):
        n0, n1, n2, n3 = philox(turns.seed, place[0] + b, place[1], place[2])
        if later:
            n0, n1 = n2, n3
        one, two = (float(n0) + 1.0) * random_turns.SHARE, float(n1) * random_turns.SHARE
        p[0, b], p[1, b], p[2, b] = turned(p[0, b], p[1, b], p[2, b], spread, one, two)


@compiled
def follow_axes(
    samples: Any,
    grid: Any,
    laws: Any,
    tolerances: Any,
    axes: Any,
    spins: Any,
    wanted: Any,
    sums: Any,
    kept: Any,
    turns: Any,
) -> None:
    """Axes (P, B, 3) of B bodies along P paths, in place, and what is wanted of them on the way.

    spins (P, B, 4): of inertial bodies the rates of their axes and their spins about them, in
    place.

    samples (P, T, 9) of the instants of a tile, traceless; grid: (first, weights, lengths) of its
    intervals, as `flows.interpolation.power_weights` gives them, and the span of the whole series;
    laws (B, 5): lambda and rest, and of inertial bodies r, r' and g of `inertial_paths`, else 0;
    tolerances (B,): errors per unit of time. wanted, sums: of `path_statistics`. kept (K,
    intervals, B, 3): axes at the start of each interval of the first K paths.
    turns: at random, before and after the flow of each interval (`random_turns`).
    """
    first, weights, lengths, span = grid
    paths, bodies = axes.shape[0], axes.shape[1]
    intervals, degrees, _ = weights.shape
    window = np.zeros((samples.shape[1], 9, LANES))
    c, m = np.empty((degrees, 9, LANES)), np.empty((degrees, 9, LANES))
    work, series = np.empty((degrees + 2 + TERMS, LANES)), np.empty((TERMS, 3, LANES))
    terms, p = np.empty(LANES, np.int64), np.zeros((bodies, 3, LANES))
    w, room = np.zeros((bodies, 4, LANES)), workroom(degrees)
    p[:, 2] = 1.0
    tile, rates, found = begin_tile(bodies, sums)
    for start in range(0, paths, LANES):
        lanes = min(LANES, paths - start)
        spread(samples[start : start + lanes], window)
        for body in range(bodies):
            for b in range(lanes):
                for i in range(3):
                    p[body, i, b] = axes[start + b, body, i]
                for i in range(4):
                    w[body, i, b] = spins[start + b, body, i]
        move_sums(start, lanes, tile, rates, sums, False)
        for number in range(intervals):
            powers(window, first[number], weights[number], c)
            look = wanted.places[number]
            if look >= 0:
                flow_rates(c[0], wanted.quantities > 3, rates, found)
            for body in range(bodies):
                for b in range(lanes):
                    if start + b < kept.shape[0]:
                        for i in range(3):
                            kept[start + b, number, body, i] = p[body, i, b]
                turning(c, lengths[number], laws[body, 0], laws[body, 1], m)
                inertial = laws[body, 2] > 0.0
                if look >= 0:
                    if not inertial:
                        follow_flow(m[0], p[body], lengths[number], w[body])
                    look_at(c[0], p[body], w[body], wanted.quantities, found)
                    note(found, wanted, number, lanes, body, tile, sums)
                    correlate(p[body], wanted, look, start, lanes, body, sums)
                    if wanted.stresses.shape[0] > 0:
                        numbers = wanted.stresses[body]
                        add_stresses(c[0], p[body], numbers, start, lanes, sums.stresses[:, body])
                place = (turns.path + start, turns.step + number, body)
                if turns.diffusivity > 0.0:
                    kick(p[body], turns, lengths[number], place, lanes, False)
                tolerance = tolerances[body] * lengths[number]
                if inertial:
                    relaxation = laws[body, 2:]
                    turn_inertial(
                        m, relaxation, lengths[number], span, tolerance, p[body], w[body], room
                    )
                    continue
                far = terms_of(m, work, terms, tolerance)
                turn(m, terms, series, p[body])
                if far:
                    for b in range(lanes):
                        if terms[b] == 0:
                            far_lane(m, b, tolerance, p[body])
                if turns.diffusivity > 0.0:
                    kick(p[body], turns, lengths[number], place, lanes, True)
        move_sums(start, lanes, tile, rates, sums, True)
        for body in range(bodies):
            for b in range(lanes):
                for i in range(3):
                    axes[start + b, body, i] = p[body, i, b]
                for i in range(4):
                    spins[start + b, body, i] = w[body, i, b]
