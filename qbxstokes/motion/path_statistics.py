"""What is wanted of many paths: moments, distributions, means over paths, correlations.

Functions of the loops in `paths`, compiled by numba and imported with it. Nothing is kept but sums,
so that memory grows neither with time nor with the number of paths.
"""

import math
from typing import Any, NamedTuple

import numba
import numpy as np

from qbxstokes.typing import Array, Integers

inner = numba.njit(error_model="numpy", fastmath={"contract"})

# Paths that pass through the loops side by side.
LANES = 8
# What is found of an axis at an instant, in this order: the squares of the rates at which it
# tumbles and spins, and |cos| of its angles with vorticity and strain axes, the most stretching
# first.
QUANTITIES = (
    "tumbling",
    "spinning",
    "cos_vorticity",
    "cos_strain_1",
    "cos_strain_2",
    "cos_strain_3",
)
_RATES, _COSINES = 2, 3  # how many are rates, and those before the strain axes
MOMENTS = 4
_TINY = 1e-300


class Wanted(NamedTuple):
    """What is looked at, and when.

    places (intervals,): the number of the look that is taken at the start of each interval of a
    tile, or -1. quantities: how many, 3 or 6. floor, scale: the first edge and the inverse width of
    the bins of log10 of the rates. lags (longest + 1,): place of each lag in the sums, or -1.
    stresses (B, 4): S0, S1, S2 and 3 kT lambda over the volume, or (0, 4).
    """

    places: Integers
    quantities: int
    floor: float
    scale: float
    lags: Integers
    stresses: Array


class Sums(NamedTuple):
    """Sums over what is seen of B bodies along P paths.

    moments (P, B, Q, 4): powers 1 to 4, of each path. rates (P, 2): E:E and vorticity squared.
    counts (B, Q, bins + 2): below, in and beyond the bins. instants (intervals, B, Q, 2): powers 1
    and 2, over paths. origins (P, B, 3): axes from which lags count. products (B, lags, 2): sums of
    p(t).p(t + lag), and their number. stresses (P, B, 13): components 11 22 33 12 13 23 of S/V and
    of pp, and the power of the stress.
    """

    moments: Array
    rates: Array
    counts: Integers
    instants: Array
    origins: Array
    products: Array
    stresses: Array


@inner
def begin_tile(bodies: int, sums: Any) -> Any:
    """Sums of the lanes at hand, (B, Q, 4, LANES) and (2, LANES), and what is found, by rows."""
    return (
        np.zeros((bodies, sums.moments.shape[2], MOMENTS, LANES)),
        np.zeros((2, LANES)),
        np.zeros((len(QUANTITIES) + 3, LANES)),
    )


@inner
def move_sums(start: int, lanes: int, tile: Any, rates: Any, sums: Any, out: bool) -> None:
    """The sums of the paths at hand into those of the lanes, or out of them."""
    for b in range(lanes):
        for i in range(2):
            if out:
                sums.rates[start + b, i] = rates[i, b]
            else:
                rates[i, b] = sums.rates[start + b, i]
        moments = sums.moments[start + b]
        for body in range(tile.shape[0]):
            for quantity in range(tile.shape[1]):
                for power in range(MOMENTS):
                    if out:
                        moments[body, quantity, power] = tile[body, quantity, power, b]
                    else:
                        tile[body, quantity, power, b] = moments[body, quantity, power]


@inner
def strain_of(a: Any, b: int) -> Any:
    """The six numbers of the strain of lane b: 11, 22, 33, 12, 13, 23."""
    return (
        a[0, b],
        a[4, b],
        a[8, b],
        0.5 * (a[1, b] + a[3, b]),
        0.5 * (a[2, b] + a[6, b]),
        0.5 * (a[5, b] + a[7, b]),
    )


@inner
def flow_rates(a: Any, axes: bool, rates: Any, found: Any) -> None:
    """Add E:E and the square of the vorticity; with `axes` find the principal strains, rows 0-2."""
    for b in range(LANES):
        e11, e22, e33, e12, e13, e23 = strain_of(a, b)
        w1, w2, w3 = a[7, b] - a[5, b], a[2, b] - a[6, b], a[3, b] - a[1, b]
        strain = e11 * e11 + e22 * e22 + e33 * e33 + 2.0 * (e12 * e12 + e13 * e13 + e23 * e23)
        rates[0, b] += strain
        rates[1, b] += w1 * w1 + w2 * w2 + w3 * w3
        if axes:
            size = math.sqrt(strain / 6.0)
            third = e11 * (e22 * e33 - e23 * e23) - e12 * (e12 * e33 - e23 * e13)
            third += e13 * (e12 * e23 - e22 * e13)
            cosine = third / (2.0 * size * size * size + _TINY)
            angle = math.acos(min(1.0, max(-1.0, cosine))) / 3.0
            found[0, b] = 2.0 * size * math.cos(angle)
            found[2, b] = 2.0 * size * math.cos(angle + 2.0 * math.pi / 3.0)
            found[1, b] = -found[0, b] - found[2, b]


@inner
def share_of(one: float, two: float, three: float, square: float, form: float) -> float:
    """|cos| of the angle with the axis of strain `one`, from |E p|^2 and p.E p."""
    gap = (one - two) * (one - three)
    if gap == 0.0:
        return 0.0
    return math.sqrt(min(1.0, max(0.0, (square - (two + three) * form + two * three) / gap)))


@inner
def follow_flow(m: Any, p: Any, length: float, w: Any) -> None:
    """The rates w (4, LANES) of massless bodies: dp/dt, and the spin about p; m: L times `length`.

    L - L^T is A - A^T, for every law.
    """
    rate = 1.0 / length
    for b in range(LANES):
        x, y, z = p[0, b], p[1, b], p[2, b]
        u = rate * (m[0, b] * x + m[1, b] * y + m[2, b] * z)
        v = rate * (m[3, b] * x + m[4, b] * y + m[5, b] * z)
        s = rate * (m[6, b] * x + m[7, b] * y + m[8, b] * z)
        along = u * x + v * y + s * z
        w[0, b], w[1, b], w[2, b] = u - along * x, v - along * y, s - along * z
        spin = (m[7, b] - m[5, b]) * x + (m[2, b] - m[6, b]) * y + (m[3, b] - m[1, b]) * z
        w[3, b] = 0.5 * rate * spin


@inner
def look_at(a: Any, p: Any, w: Any, count: int, found: Any) -> None:
    """The quantities of the axes p with rates w (4, LANES) in the gradients a, rows 3 and on."""
    for b in range(LANES):
        x, y, z = p[0, b], p[1, b], p[2, b]
        w1, w2, w3 = a[7, b] - a[5, b], a[2, b] - a[6, b], a[3, b] - a[1, b]
        scale = 1.0 / (max(abs(w1), abs(w2), abs(w3)) + _TINY)  # squares may be too small
        w1, w2, w3 = scale * w1, scale * w2, scale * w3
        along = abs(w1 * x + w2 * y + w3 * z)
        found[3, b] = w[0, b] * w[0, b] + w[1, b] * w[1, b] + w[2, b] * w[2, b]
        found[4, b] = w[3, b] * w[3, b]
        found[5, b] = min(1.0, along / (math.sqrt(w1 * w1 + w2 * w2 + w3 * w3) + _TINY))
    if count > _COSINES:
        for b in range(LANES):
            x, y, z = p[0, b], p[1, b], p[2, b]
            e11, e22, e33, e12, e13, e23 = strain_of(a, b)
            u, v, w = (
                e11 * x + e12 * y + e13 * z,
                e12 * x + e22 * y + e23 * z,
                e13 * x + e23 * y + e33 * z,
            )
            square, form = u * u + v * v + w * w, u * x + v * y + w * z
            one, two, three = found[0, b], found[1, b], found[2, b]
            found[6, b] = share_of(one, two, three, square, form)
            found[7, b] = share_of(two, one, three, square, form)
            found[8, b] = share_of(three, one, two, square, form)


@inner
def note(found: Any, wanted: Any, number: int, lanes: int, body: int, tile: Any, sums: Any) -> None:
    """Add what was found of a body to the sums."""
    bins = sums.counts.shape[2] - 2
    for quantity in range(wanted.quantities):
        row = found[3 + quantity]
        for b in range(LANES):
            square = row[b] * row[b]
            tile[body, quantity, 0, b] += row[b]
            tile[body, quantity, 1, b] += square
            tile[body, quantity, 2, b] += square * row[b]
            tile[body, quantity, 3, b] += square * square
        for b in range(lanes):
            sums.instants[number, body, quantity, 0] += row[b]
            sums.instants[number, body, quantity, 1] += row[b] * row[b]
            if quantity < _RATES:
                place = (math.log10(row[b] + _TINY) - wanted.floor) * wanted.scale
            else:
                place = row[b] * bins
            last = bins if quantity < _RATES else bins - 1  # a cosine of 1 is in the last bin
            sums.counts[body, quantity, int(min(max(math.floor(place), -1.0), last)) + 1] += 1


@inner
def correlate(p: Any, wanted: Any, look: int, start: int, lanes: int, body: int, sums: Any) -> None:
    """Add p(t).p(t + lag) from the last origin, which moves on after the longest lag."""
    lag = look % wanted.lags.shape[0]
    place = wanted.lags[lag]
    for b in range(lanes):
        origin = sums.origins[start + b, body]
        if lag == 0:
            for i in range(3):
                origin[i] = p[i, b]
        if place >= 0:
            value = origin[0] * p[0, b] + origin[1] * p[1, b] + origin[2] * p[2, b]
            sums.products[body, place, 0] += value
            sums.products[body, place, 1] += 1.0


@inner
def add_stresses(a: Any, p: Any, numbers: Any, start: int, lanes: int, sums: Any) -> None:
    """Add S/V (`suspension.particle`), pp and (S/V + 3 kT lambda pp/V):E to sums (P, 13)."""
    s0, s1, s2, brownian = numbers
    for b in range(lanes):
        x, y, z = p[0, b], p[1, b], p[2, b]
        e = strain_of(a, b)
        u = e[0] * x + e[3] * y + e[4] * z
        v = e[3] * x + e[1] * y + e[5] * z
        w = e[4] * x + e[5] * y + e[2] * z
        form = u * x + v * y + w * z
        products = (x * x, y * y, z * z, x * y, x * z, y * z)
        mixed = (2.0 * u * x, 2.0 * v * y, 2.0 * w * z, u * y + v * x, u * z + w * x, v * z + w * y)
        total, power = sums[start + b], brownian * form
        for i in range(6):
            s = (1.5 * s0 - 2.0 * s1 + 0.5 * s2) * form * products[i]
            s += (s1 - s2) * mixed[i] + s2 * e[i]
            s += 0.5 * (s2 - s0) * form if i < 3 else 0.0
            total[i] += s
            total[6 + i] += products[i]
            power += s * e[i] * (1.0 if i < 3 else 2.0)
        total[12] += power
