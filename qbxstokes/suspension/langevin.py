"""Rotary Brownian motion of single axes in a homogeneous flow: the other way to the same averages.

    dp = [(w/2) x p + lambda (E p - p (p.E.p))] dt + sqrt(2 D) (I - pp) dW   (Stratonovich)

A step is split: half of the flow, p -> F p/|F p| with F = exp(M h/2), which is exact; a turn by a
random angle about a random axis across p; the other half. A normal turn in the tangent plane of
variance s = 2 D h each way multiplies harmonics of degree l by 1 - l(l+1) s/2 + [l(l+1)]^2 s^2/8
- l(l+1) s^2/12 + ..., diffusion by exp(-l(l+1) s/2): with the variance s - s^2/6 they agree to s^2,
and the whole step is of weak order two (G. Strang 1968, SIAM J. Numer. Anal. 5, 506). p stays on
the sphere. Random numbers are counted, not drawn in turn: those of a trajectory at a step are
Philox's block of that key (J. K. Salmon et al. 2011, SC11), the same on any number of ranks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from qbxstokes.motion.stress import stresslets
from qbxstokes.suspension.fokker_planck import Transport
from qbxstokes.suspension.particle import Particle

Array = NDArray[np.float64]

_START = 2**62  # the step whose numbers make the orientations at the start
_MOST_VARIANCE = 1.0


@dataclass(frozen=True)
class Averages:
    """Means over time of each trajectory: stress and order tensor (n, 6), 11 22 33 12 13 23."""

    stress: Array
    order: Array


def uniform(seed: int, first: int, count: int, step: int) -> Array:
    """Numbers in (0, 1] of `count` trajectories from `first`, at a step: (count, 4)."""
    counter = np.array([first, step, 0, 0], dtype=np.uint64)
    raw = np.random.Philox(counter=counter, key=seed).random_raw(4 * count)
    return ((raw >> np.uint64(11)).astype(np.float64) + 1.0).reshape(-1, 4) * 2.0**-53


def isotropic_axes(seed: int, first: int, count: int) -> Array:
    """Isotropic unit vectors (count, 3) of trajectories from `first`."""
    u = uniform(seed, first, count, _START)
    z, angle = 2.0 * u[:, 0] - 1.0, 2.0 * np.pi * u[:, 1]
    radius = np.sqrt((1.0 - z) * (1.0 + z))
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)


def variance(diffusivity: float, step: float) -> float:
    """Variance of the turn about either axis across p in a step: s - s^2/6, s = 2 D h."""
    s = 2.0 * diffusivity * step
    return s - s * s / 6.0


def turned(p: Array, spread: float, u: Array) -> Array:
    """Axes (n, 3) turned by normal angles of variance `spread` about both axes across them."""
    angle = np.sqrt(-2.0 * spread * np.log(u[:, 0]))
    around = 2.0 * np.pi * u[:, 1]
    # Two directions across p (T. Duff et al. 2017, J. Comput. Graph. Tech. 6, 1).
    sign = np.where(p[:, 2] < 0.0, -1.0, 1.0)
    a = -1.0 / (sign + p[:, 2])
    b = p[:, 0] * p[:, 1] * a
    first = np.stack([1.0 + sign * p[:, 0] ** 2 * a, sign * b, -sign * p[:, 0]], axis=1)
    second = np.stack([b, sign + p[:, 1] ** 2 * a, -p[:, 1]], axis=1)
    across = np.cos(around)[:, None] * first + np.sin(around)[:, None] * second
    return np.asarray(np.cos(angle)[:, None] * p + np.sin(angle)[:, None] * across)


def simulate(
    transport: Transport,
    particle: Particle,
    diffusivity: float,
    trajectories: range,
    step: float,
    steps: int,
    discard: int,
    seed: int,
) -> Averages:
    """Averages over `steps` steps after `discard` more, from isotropic orientations."""
    from scipy.linalg import expm

    half = expm(0.5 * step * transport.matrix).T
    strain = transport.flow.strain
    rows = np.stack([strain[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))])
    first, count = trajectories.start, len(trajectories)
    p = isotropic_axes(seed, first, count)
    spread = variance(diffusivity, step)
    stress, order = np.zeros((6, count)), np.zeros((6, count))
    for number in range(discard + steps):
        p = _moved(p, half)
        p = turned(p, spread, uniform(seed, first, count, number))
        p = _moved(p, half)
        if number >= discard:
            stress += stresslets(particle.stresslet, p, rows[:, None])
            for place, (i, j) in enumerate(((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))):
                order[place] += p[:, i] * p[:, j]
    order /= steps
    brownian = 3.0 * diffusivity * particle.resistance * particle.linear
    third = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])[:, None] / 3.0
    whole = (stress / steps + brownian * (order - third)) / particle.volume
    return Averages(whole.T, order.T)


def _moved(p: Array, half: Array) -> Array:
    moved = p @ half
    return np.asarray(moved / np.sqrt(np.sum(moved * moved, axis=1))[:, None])


def longest_step(diffusivity: float) -> float:
    """The longest step for which the variance of a turn makes sense."""
    return _MOST_VARIANCE / (2.0 * diffusivity)
