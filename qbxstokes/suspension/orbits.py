"""Orientations without Brownian motion: transients and long-time means in a homogeneous flow.

The axis is p = y/|y| with y' = M y, M = W + lambda E (F. P. Bretherton 1962, J. Fluid Mech. 14,
284), so that p(t) = F p(0)/|F p(0)|, F = exp(M t). In a shear with |lambda| < 1 the axes go round
closed orbits with a phase that grows evenly in time (G. B. Jeffery 1922): a mean over time is one
over equal steps of it, which converges geometrically. Second and fourth moments <pp>, <pppp> are
arrays (..., 3, 3) and (..., 3, 3, 3, 3).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from qbxstokes.errors import ConvergenceError
from qbxstokes.suspension.distribution import AdvectedDensity
from qbxstokes.typing import Array

Moments = tuple[Array, Array]

# Real parts below this, relative to M, are rounding.
_ROUNDING = 1e-12
# Steps of a period: doubled from the first to the last.
_FIRST, _LAST = 32, 4096
# Step and reach of the integrals over the logarithm, which the trapezoid rule sums to 1e-16.
_STEP, _REACH = 0.4, 45.0
_NONE: Array = np.zeros(0)


@dataclass(frozen=True)
class Starts:
    """Axes (n, 3) with weights (n,) of sum 1; or isotropic orientations where axes is None."""

    axes: Array | None = None
    weights: Array | None = None

    @property
    def share(self) -> Array:
        """Weights (n,)."""
        assert self.axes is not None
        if self.weights is None:
            return np.full(len(self.axes), 1.0 / len(self.axes))
        return np.asarray(self.weights / self.weights.sum())


def moments_of(axes: Array, weights: Array) -> Moments:
    """Moments over the last axis but one of unit vectors (..., n, 3) with weights (n,)."""
    second = np.einsum("n,...ni,...nj->...ij", weights, axes, axes, optimize=True)
    pairs = (axes[..., :, None] * axes[..., None, :]).reshape(*axes.shape[:-1], 9)
    fourth = np.matmul((pairs * weights[:, None]).swapaxes(-1, -2), pairs)
    return second, fourth.reshape(*fourth.shape[:-2], 3, 3, 3, 3)


def transient(matrix: Array, strains: Array, starts: Starts) -> Moments:
    """Moments at the strains (T,): those of p = F p0/|F p0|, F = exp(M strain)."""
    from scipy.linalg import expm

    moved = expm(strains[:, None, None] * matrix)
    if starts.axes is None:
        return _isotropic(moved)
    p = np.einsum("tij,nj->tni", moved, starts.axes)
    p /= np.linalg.norm(p, axis=-1, keepdims=True)
    return moments_of(p, starts.share)


def _isotropic(moved: Array) -> Moments:
    """Moments of F s/|F s| over isotropic s, F (T, 3, 3).

    With F = U S V^T and normal variables g, <s_i^2 s_j^2 .../(S s)^4> follows from those of
    exp(-x (S g)^2) as a simple integral over x > 0.
    """
    left, singular, _ = np.linalg.svd(moved)
    square = singular**2 / np.prod(singular, axis=-1, keepdims=True) ** (2.0 / 3.0)
    spread = float(np.log(square.max() / square.min()))
    nodes = np.exp(np.arange(-_REACH - spread, _REACH + spread, _STEP))
    factor = square[:, None, :] / (1.0 + 2.0 * nodes[:, None] * square[:, None, :])
    root = np.sqrt(np.prod(1.0 + 2.0 * nodes[:, None] * square[:, None, :], axis=-1))
    one = _STEP * np.einsum("x,txi->ti", nodes, factor / root[..., None])
    two = _STEP * np.einsum("x,txi,txj->tij", nodes**2, factor / root[..., None], factor)
    index = np.arange(3)
    four = np.zeros((len(moved), 3, 3, 3, 3))
    for i in index:
        for j in index:
            for place in ((i, i, j, j), (i, j, i, j), (i, j, j, i)):
                four[(slice(None), *place)] = two[:, i, j] * (3.0 if i == j else 1.0)
    second = np.einsum("tia,ta,tja->tij", left, one, left)
    fourth = np.einsum("tia,tjb,tkc,tld,tabcd->tijkl", left, left, left, left, four, optimize=True)
    return second, fourth


def long_time(matrix: Array, starts: Starts, tolerance: float) -> tuple[Moments, float, Array]:
    """Means over a long time, the last change under refinement, and strains that they are over.

    On closed orbits over their periods; else of the state that the axes come to, without strains.
    Raises ConvergenceError where that is not one state for (almost) all of them.
    """
    size = float(np.linalg.norm(matrix))
    if size < _ROUNDING:
        return _initial(starts), 0.0, np.zeros(1)
    values, vectors = np.linalg.eig(matrix)
    pair = int(np.argmax(values.imag))
    if values[pair].imag <= 1e-8 * size:
        order = np.argsort(-values.real)
        first, second = values.real[order[:2]]
        if first - second <= 1e-8 * size:
            raise ConvergenceError(
                "without Brownian motion the axes come to no single orientation in this flow"
            )
        return moments_of(_unit(vectors.real[:, order[0]])[None], np.ones(1)), 0.0, _NONE
    lone = int(np.argmin(np.abs(values.imag)))
    growth = float(values[pair].real - values[lone].real)
    axis = _unit(vectors[:, lone].real)
    if growth < -_ROUNDING * size:
        return moments_of(axis[None], np.ones(1)), 0.0, _NONE
    if growth > _ROUNDING * size:  # they spiral into the plane of the pair
        starts = Starts(_unit(vectors[:, pair].real)[None])
    # One period in equal steps, which are equal steps of the phase.
    period, nodes = 2.0 * np.pi / float(values[pair].imag), _FIRST

    def strains() -> Array:
        return period / nodes * np.arange(nodes)

    def mean() -> Moments:
        second, fourth = transient(matrix, strains(), starts)
        return second.mean(axis=0), fourth.mean(axis=0)

    before = mean()
    while nodes < _LAST:
        nodes *= 2
        now = mean()
        change = max(float(np.max(np.abs(a - b))) for a, b in zip(now, before, strict=True))
        if change <= tolerance:
            return now, change, strains()
        before = now
    raise ConvergenceError(f"the mean over the orbits still changes by {change:.1e}")


def advected(matrix: Array, strains: Array) -> AdvectedDensity:
    """The mean density at the strains (T,) of axes that were isotropic at strain 0."""
    from scipy.linalg import expm

    return AdvectedDensity(expm(-strains[:, None, None] * matrix))


def _initial(starts: Starts) -> Moments:
    if starts.axes is not None:
        return moments_of(starts.axes, starts.share)
    second, fourth = _isotropic(np.eye(3)[None])
    return second[0], fourth[0]


def _unit(vector: Array) -> Array:
    return np.asarray(vector / np.linalg.norm(vector))
