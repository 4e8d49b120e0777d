"""How much an error of a body's axis grows in a linear flow, along the motion itself.

The axis p of a body without inertia is q/|q| of q' = L q (`paths`). What a small error of it comes
to later is the same matrices' work on vectors across p, divided by the growth of q.
"""

from collections.abc import Sequence

import numpy as np

from qbxstokes.typing import Array

# Instants of a run from which errors are followed, and what they may be beside the worst ones.
_STARTS, _SURE = 12, 4.0


def growth(gradients: Array, law: Sequence[Array], axes: Array, step: float) -> Array:
    """How many times errors of axes (n, 3) may grow from any instant to a later one, (n,).

    In steps of a fifth, so that rounding has no say in it.

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
