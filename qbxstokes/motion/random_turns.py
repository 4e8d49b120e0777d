"""Random turns of axes, by numbers that are counted and not drawn in turn.

A normal turn in the tangent plane, of variance v each way, multiplies harmonics of degree l by
1 - l(l+1) v/2 + [l(l+1)]^2 v^2/8 - l(l+1) v^2/12 + ..., diffusion over a time h by
exp(-l(l+1) D h): with v = s - s^2/6, s = 2 D h, they agree to s^2. Half a turn before and half a
turn after each stretch of the flow are of weak order two (G. Strang 1968, SIAM J. Numer. Anal. 5,
506). The numbers of a trajectory at a step are those of Philox 4x32-10 (J. K. Salmon et al. 2011,
SC11) at this place, so that no division of the trajectories changes a bit.

The functions take numbers or arrays; `paths` compiles them.
"""

from typing import Any, NamedTuple

import numpy as np

from qbxstokes.typing import Array

_LOW = np.uint64(0xFFFFFFFF)
_HALF = np.uint64(32)
_FACTORS = np.uint64(0xD2511F53), np.uint64(0xCD9E8D57)
_WEYL = np.uint64(0x9E3779B9), np.uint64(0xBB67AE85)
_ROUNDS = 10
SHARE = 2.0**-32  # of a whole number of `philox` in the range of all
MOST_VARIANCE = 1.0  # of a turn over a whole step, 2 D h


class Turns(NamedTuple):
    """Rotary diffusion: diffusivity (0: none), the numbers' seed, the first path and step."""

    diffusivity: float
    seed: int
    path: int
    step: int


def philox(seed: Any, path: Any, step: Any, word: Any) -> Any:
    """Four whole numbers below 2^32 of a trajectory at a step; word: which of several."""
    key0, key1 = np.uint64(seed) & _LOW, np.uint64(seed) >> _HALF
    c0, c1, c2, c3 = np.uint64(path), np.uint64(step), np.uint64(word), np.uint64(0)
    for _ in range(_ROUNDS):
        one, two = _FACTORS[0] * c0, _FACTORS[1] * c2
        c0, c1, c2, c3 = (
            (two >> _HALF) ^ c1 ^ key0,
            two & _LOW,
            (one >> _HALF) ^ c3 ^ key1,
            one & _LOW,
        )
        key0, key1 = (key0 + _WEYL[0]) & _LOW, (key1 + _WEYL[1]) & _LOW
    return c0, c1, c2, c3


def variance(diffusivity: Any, step: float) -> Any:
    """Of the turn about either axis across p in a step: s - s^2/6, s = 2 D h."""
    s = 2.0 * diffusivity * step
    return s - s * s / 6.0


def turned(x: Any, y: Any, z: Any, spread: float, one: Any, two: Any) -> Any:
    """The axis (x, y, z) after a normal turn of variance `spread`; one > 0, two: random up to 1."""
    angle, around = np.sqrt(-2.0 * spread * np.log(one)), 2.0 * np.pi * two
    # Two directions across p (T. Duff et al. 2017, J. Comput. Graph. Tech. 6, 1).
    sign = 1.0 - 2.0 * (z < 0.0)
    a = -1.0 / (sign + z)
    b = x * y * a
    cosine, sine = np.cos(around), np.sin(around)
    u = cosine * (1.0 + sign * x * x * a) + sine * b
    v = cosine * sign * b + sine * (sign + y * y * a)
    w = -cosine * sign * x - sine * y
    c, s = np.cos(angle), np.sin(angle)
    return c * x + s * u, c * y + s * v, c * z + s * w


def turned_axes(p: Array, spread: float, u: Array) -> Array:
    """Axes (n, 3) turned by normal angles of variance `spread` about both axes across them."""
    x, y, z = p.T
    return np.stack(turned(x, y, z, spread, u[:, 0], u[:, 1]), axis=1)


def kicks(p: Array, sizes: Array, u: Array) -> Array:
    """Normal displacements (n, 3) of axes p (n, 3), of sizes (2,) across and along them."""
    radius, angle = np.sqrt(-2.0 * np.log(u[:, ::2])), 2.0 * np.pi * u[:, 1::2]
    normal = np.stack([*(radius * np.cos(angle)).T, (radius * np.sin(angle))[:, 0]], axis=1)
    lengthwise = np.sum(normal * p, axis=1)[:, None] * p
    return np.asarray(sizes[0] * normal + (sizes[1] - sizes[0]) * lengthwise)
