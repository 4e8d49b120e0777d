"""What is read off the axis of a body: orbit constant, period, and how much errors of it grow.

The axis D3 is described by its components (a, b, n) along stream, gradient and vorticity of the
shear: the rows of `frame` (3, 3), the axes of space for the flow (x2, 0, 0). Jeffery (Proc. R. Soc.
A 102, 1922, eqs. 48-50): on a free orbit in shear C is constant and the phase falls by 2 pi in
every period T = 2 pi (k + 1/k)/rate.
"""

import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.typing import Array

# Instants of a run from which errors are followed, and what they may be beside the worst ones.
_STARTS, _SURE = 12, 4.0

T = TypeVar("T")


def of_matrix(function: Callable[..., T]) -> Callable[..., T]:
    """The function of a matrix (3, 3) and of numbers, which remembers what it found last."""

    @lru_cache
    def known(numbers: bytes, *more: float) -> T:
        return function(np.frombuffer(numbers).reshape(3, 3), *more)

    return lambda matrix, *more: known(np.asarray(matrix, dtype=np.float64).tobytes(), *more)


def orbit_constant(
    axis: ArrayLike, effective_ratio: float | Array, frame: ArrayLike | None = None
) -> Array:
    """C = sqrt(b^2 + k^2 a^2)/(k |n|), (..., 3) -> (...): 0 log-rolling, infinite tumbling."""
    d = np.asarray(axis, dtype=np.float64)
    if frame is not None:
        d = d @ np.asarray(frame, dtype=np.float64).T
    a, b, n = d[..., 0], d[..., 1], d[..., 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.hypot(b, effective_ratio * a) / (effective_ratio * np.abs(n)))


def orbit_axis(effective_ratio: ArrayLike, constant: ArrayLike, phase: ArrayLike) -> Array:
    """Axis (..., 3) on the Jeffery orbit C in the shear (x2, 0, 0), any length but zero.

    (C cos p, -C k sin p, 1), and its limit (cos p, -k sin p, 0) for infinite C; the phase p of a
    massless body grows by 2 pi in a period (Jeffery 1922, eqs. 48 f.).
    """
    k, c, p = (np.asarray(value, dtype=float) for value in (effective_ratio, constant, phase))
    # Both divided by 1 + C, so that tumbling needs no case of its own but the number itself.
    part = np.where(np.isinf(c), 1.0, c / (1.0 + np.where(np.isinf(c), 0.0, c)))
    return np.stack(np.broadcast_arrays(part * np.cos(p), -k * part * np.sin(p), 1.0 - part), -1)


@of_matrix
def jeffery_period(gradient: Array, effective_ratio: float) -> float | None:
    """Period of a free spheroid's axis in a linear flow, None where it comes to rest.

    The axis follows the linear system dd/dt = (W + lambda E) d up to its length, with
    lambda = (1 - k^2)/(1 + k^2) (Bretherton 1962, J. Fluid Mech. 14, eq. 15 f.); a complex pair of
    eigenvalues +-i omega + sigma makes it turn with period 2 pi/omega. In a shear of rate 1 this
    is Jeffery's 2 pi (k + 1/k).
    """
    k = effective_ratio
    shape = (1.0 - k * k) / (1.0 + k * k)
    largest = float(np.abs(gradient).max())
    if not largest > 0.0:
        return None
    gradient = gradient / largest  # so that no rate is too large or too small for its square
    strain, spin = 0.5 * (gradient + gradient.T), 0.5 * (gradient - gradient.T)
    if not np.any(spin):
        return None
    # omega^2 = -(1/2) tr (W + lambda E)^2 when the third eigenvalue vanishes, which is exact for
    # plane flows where thin bodies make the eigenvalue problem ill-conditioned.
    system = spin + shape * strain
    if abs(np.linalg.det(system)) <= 1e-14 * np.abs(system).max() ** 3:
        squared = 0.5 * float(np.sum(spin * spin) - shape**2 * np.sum(strain * strain))
        omega = math.sqrt(max(0.0, squared))
    else:
        omega = float(np.abs(np.linalg.eigvals(system).imag).max())
    return 2.0 * math.pi / omega / largest if omega > 0.0 else None


def growth(gradients: Array, law: Sequence[Array], axes: Array, step: float) -> Array:
    """How many times errors of axes (n, 3) may grow from any instant to a later one, (n,).

    The axis p of a body without inertia is q/|q| of q' = L q (`paths`). What a small error of it
    comes to later is the same matrices' work on vectors across p, over the growth of q. In steps of
    a fifth, so that rounding has no say in it.

    gradients (T, n, 3, 3): in the middle of T steps of time, short beside the turns of the flow;
    law: lambda and rest of `paths`, (n,) each.
    """
    linear, rest = (np.asarray(value)[..., None, None] for value in law)
    turned = np.swapaxes(gradients, -1, -2)
    stretched = linear * np.where(linear < 0.0, turned, gradients)
    half = 0.5 * step * (rest * (gradients - turned) + stretched)
    steps = np.linalg.solve(np.eye(3) - half, np.eye(3) + half)  # Cayley's approximation of exp
    count, n = len(steps), len(axes)
    found, now = np.empty((count, n, 3, 1 + 2 * _STARTS)), np.zeros((n, 3, 1 + 2 * _STARTS))
    now[..., 0] = axes
    starts = {count * j // _STARTS: 1 + 2 * j for j in range(_STARTS)}
    for place, matrix in enumerate(steps):
        if place in starts:
            p, column = now[..., 0], starts[place]
            aside = np.eye(3)[np.argmin(np.abs(p), axis=1)]
            first = np.cross(p, aside)
            first /= np.linalg.norm(first, axis=1, keepdims=True)
            now[..., column], now[..., column + 1] = first, np.cross(p, first)
        now = matrix @ now
        now /= np.sqrt(np.einsum("ni,ni->n", now[..., 0], now[..., 0]))[:, None, None]
        found[place] = now
    p, errors = found[..., :1], found[..., 1:]
    errors = errors - p * np.sum(p * errors, axis=2, keepdims=True)
    one, two = errors[..., 0::2], errors[..., 1::2]
    a, b, c = (np.sum(u * v, axis=2) for u, v in ((one, one), (two, two), (one, two)))
    largest = 0.5 * (a + b) + np.sqrt(0.25 * (a - b) ** 2 + c * c)  # singular value, squared
    grown = _SURE * np.sqrt(np.max(largest, axis=(0, 2), initial=1.0))
    return np.asarray(2.0 ** (np.ceil(4.0 * np.log2(grown)) / 4.0))
