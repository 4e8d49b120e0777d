"""Rotary Brownian motion of single axes in a homogeneous flow: the other way to the same averages.

    dp = [(w/2) x p + lambda (E p - p (p.E.p))] dt + sqrt(2 D) (I - pp) dW   (Stratonovich)

A step is split: half of the flow, p -> F p/|F p| with F = exp(M h/2), which is exact; a turn by a
random angle about a random axis across p; the other half. A normal turn in the tangent plane of
variance s = 2 D h each way multiplies harmonics of degree l by 1 - l(l+1) s/2 + [l(l+1)]^2 s^2/8
- l(l+1) s^2/12 + ..., diffusion by exp(-l(l+1) s/2): with the variance s - s^2/6 they agree to s^2,
and the whole step is of weak order two (G. Strang 1968, SIAM J. Numer. Anal. 5, 506). p stays on
the sphere. Places move with x -> exp(G h/2) x and diffuse in between by the mean of what the axes
before and after the turn allow. Random numbers are counted, not drawn in turn: those of a
trajectory at a step are Philox's block of that key (J. K. Salmon et al. 2011, SC11), and averages
are taken in blocks of trajectories, so that any number of ranks gives the same bits.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from qbxstokes.geometry.symmetric import PAIRS, components, symmetric
from qbxstokes.motion.random_turns import MOST_VARIANCE, kicks, turned_axes, variance
from qbxstokes.motion.stress import stresslets
from qbxstokes.suspension.fokker_planck import Transport
from qbxstokes.suspension.particle import History, Particle
from qbxstokes.typing import Array

_START = 2**62  # the step whose numbers make the orientations at the start
BLOCK = 1024  # trajectories whose averages are taken together
# What the columns of `Sums` are: material functions, and components 11 22 33 12 13 23.
FUNCTIONS = (
    "intrinsic_viscosity",
    "first_normal_stress_difference",
    "second_normal_stress_difference",
)
TENSORS = (
    "particle_stress",
    "hydrodynamic_stress",
    "brownian_stress",
    "order_tensor",
    "mean_square_displacement",
)


@dataclass(frozen=True)
class Sums:
    """Means (T, columns) of `count` trajectories, sums of squares about them, axes (T, m, 3)."""

    count: int
    mean: Array
    squares: Array
    paths: Array

    @classmethod
    def of(cls, blocks: Iterable[Sums]) -> Sums:
        """All of them, in this order (T. F. Chan et al. 1983, Am. Stat. 37, 242)."""
        first, *others = blocks
        count, mean, squares = first.count, first.mean, first.squares
        for block in others:
            away, both = block.mean - mean, count + block.count
            squares = squares + block.squares + away**2 * (count * block.count / both)
            mean = mean + away * (block.count / both)
            count = both
        paths = np.concatenate([first.paths, *(block.paths for block in others)], axis=1)
        return cls(count, mean, squares, paths)

    def averages(self) -> dict[str, tuple[Array, Array]]:
        """Means and their standard errors by name: (T,) and (T, 3, 3)."""
        error = np.sqrt(self.squares / (self.count * (self.count - 1.0)))
        found = {
            name: (self.mean[:, place], error[:, place]) for place, name in enumerate(FUNCTIONS)
        }
        for name, first in zip(TENSORS, range(3, self.mean.shape[1], 6), strict=False):
            own = slice(first, first + 6)
            found[name] = symmetric(self.mean[:, own]), symmetric(error[:, own])
        return found


@dataclass(frozen=True)
class Ensemble:
    """Trajectories of axes through a history of the flow, averaged in blocks.

    starts: axes (m, 3) that they begin with in turn, None: isotropic ones. wait: time given before
    averages, strain: that a steady state is averaged over. kept: trajectories whose axes are kept.
    dispersion: diffusivities across and along the axis, None to leave places out.
    """

    transport: Transport
    particle: Particle
    diffusivity: float
    history: History
    trajectories: int
    seed: int
    step: float
    wait: float
    strain: float
    starts: Array | None = None
    kept: int = 0
    dispersion: tuple[float, float] | None = None

    @property
    def blocks(self) -> int:
        """How many `average` has."""
        return -(-self.trajectories // BLOCK)

    @cached_property
    def schedule(self) -> tuple[Array, NDArray[np.int64]]:
        """Ends of the steps (n + 1,), and the row (n + 1,) of averages each counts for, or -1."""
        lead = self.history.lead(self.wait)
        before = np.linspace(-lead, 0.0, 1 + round(lead / self.step) if lead else 1)
        instants = self.history.instants
        if instants is None:
            steps = max(1, round(self.strain / self.step))
            times = np.concatenate([before, self.step * np.arange(1, steps + 1)])
            rows = np.where(np.arange(len(times)) < len(before), -1, 0)
            return times, rows
        pieces, rows_of, last = [before], [np.full(len(before), -1)], 0.0
        for row, instant in enumerate(instants.tolist()):
            steps = int(np.ceil((instant - last) / self.step * (1.0 - 1e-12)))
            pieces.append(np.linspace(last, instant, steps + 1)[1:])
            rows_of.append(np.full(steps, -1))
            (rows_of[-1] if steps else rows_of[0])[-1] = row
            last = instant
        return np.concatenate(pieces), np.concatenate(rows_of)

    def average(self, number: int) -> Sums:
        """One block of trajectories."""
        times, rows = self.schedule
        first = number * BLOCK
        count = min(BLOCK, self.trajectories - first)
        durations, middle = np.diff(times), 0.5 * (times[1:] + times[:-1])
        ends, middles = self.history.strain(times), self.history.strain(middle)
        halves, flow = np.stack([middles - ends[:-1], ends[1:] - middles]), self.transport.flow
        turns = _exponentials(self.transport.matrix, halves)
        if self.dispersion is not None:
            shifts = _exponentials(flow.gradient / flow.rate, halves)
        found = np.zeros((int(rows.max()) + 1, 18, count))
        seen = np.bincount(rows[rows >= 0], minlength=len(found))
        kept = np.empty((len(found), max(0, min(self.kept - first, count)), 3))
        p, x = self._start(first, count), np.zeros((count, 3))
        rates = np.atleast_1d(self.history.rates)
        for step, row in enumerate(rows.tolist()):
            if step:
                spread = variance(self.diffusivity, durations[step - 1])
                before, after = turns[:, step - 1]
                q = _moved(p, before)
                p = turned_axes(q, spread, uniform(self.seed, first, count, step))
                if self.dispersion is not None:
                    one, two = shifts[:, step - 1]
                    sizes = np.sqrt(np.array(self.dispersion) * durations[step - 1])
                    for word, axes in ((1, q), (2, p)):
                        u = uniform(self.seed, first, count, step, word)
                        x = (x @ one if word == 1 else x) + kicks(axes, sizes, u)
                    x = x @ two
                p = _moved(p, after)
            if row >= 0:
                found[row] += self._values(p, x, float(rates[row]))
                kept[row] = p[: kept.shape[1]]
        return self._sums(found / seen[:, None, None], kept)

    def _start(self, first: int, count: int) -> Array:
        if self.starts is None:
            return isotropic_axes(self.seed, first, count)
        return np.asarray(self.starts[np.arange(first, first + count) % len(self.starts)])

    def _values(self, p: Array, x: Array, rate: float) -> Array:
        """Stresslets, products of the axes' and of the places' components, rows (18, n)."""
        strain = rate * components(self.transport.flow.strain)[:, None]
        products = [v[:, i] * v[:, j] for v in (p, x) for i, j in PAIRS]
        return np.concatenate([stresslets(self.particle.stresslet, p, strain), products])

    def _sums(self, rows: Array, kept: Array) -> Sums:
        """Of averages (T, 18, n) of each trajectory."""
        particle = self.particle
        stress, order, square = np.split(np.moveaxis(rows, 1, 2), 3, axis=2)
        flowing = symmetric(stress) / particle.volume
        brownian = particle.brownian_stress(symmetric(order), self.diffusivity)
        whole = flowing + brownian
        functions = self.transport.flow.material_functions(whole)
        parts = [components(whole), components(flowing), components(brownian), order]
        if self.dispersion is not None:
            parts.append(square)
        columns = [functions[name][..., None] for name in FUNCTIONS]
        values = np.concatenate([*columns, *parts], axis=2)
        mean = values.mean(axis=1)
        squares = np.sum((values - mean[:, None]) ** 2, axis=1)
        return Sums(rows.shape[2], mean, squares, kept)


def _exponentials(matrix: Array, strains: Array) -> Array:
    """exp of a flow's matrix over the strains (2, n) of the halves of all steps, transposed."""
    from scipy.linalg import expm

    # Equal but for the rounding of their times: one exponential.
    different, places = np.unique(np.round(strains, 14), return_inverse=True)
    found = expm(different[:, None, None] * matrix).swapaxes(1, 2)
    return np.asarray(found[places.reshape(strains.shape)])


def uniform(seed: int, first: int, count: int, step: int, word: int = 0) -> Array:
    """Numbers in (0, 1] of `count` trajectories from `first`, at a step: (count, 4)."""
    counter = np.array([first, step, word, 0], dtype=np.uint64)
    raw = np.random.Philox(counter=counter, key=seed).random_raw(4 * count)
    return ((raw >> np.uint64(11)).astype(np.float64) + 1.0).reshape(-1, 4) * 2.0**-53


def isotropic_axes(seed: int, first: int, count: int) -> Array:
    """Isotropic unit vectors (count, 3) of trajectories from `first`."""
    u = uniform(seed, first, count, _START)
    z, angle = 2.0 * u[:, 0] - 1.0, 2.0 * np.pi * u[:, 1]
    radius = np.sqrt((1.0 - z) * (1.0 + z))
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)


def _moved(p: Array, half: Array) -> Array:
    moved = p @ half
    return np.asarray(moved / np.sqrt(np.sum(moved * moved, axis=1))[:, None])


def longest_step(diffusivity: float) -> float:
    """The longest step for which the variance of a turn makes sense."""
    return MOST_VARIANCE / (2.0 * diffusivity)
