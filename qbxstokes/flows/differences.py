"""Derivatives of a smooth vector field by extrapolated central differences.

Central differences have an error in even powers of the step; halving the step and extrapolating
to zero (Richardson; Ridders 1982, Adv. Eng. Software 4, 75) removes them one by one, and of the
whole table the entry that changed least is returned, point by point. With the largest step well
below the distance to the nearest singularity the relative errors are about 1e-12 (gradient),
1e-10 (Laplacian) and 1e-8 (curl of the Laplacian).
"""

from collections.abc import Callable

import numpy as np

from qbxstokes.typing import Array

LEVELS = 8

VectorField = Callable[[Array], Array]


def extrapolate(estimate: Callable[[Array], Array], step: Array, levels: int = LEVELS) -> Array:
    """Limit at step -> 0 of `estimate(step)`, whose error is a series in step^2.

    step: shape (...), the largest step at each point; `estimate` returns (..., m...) . levels: how
    often the step is halved, and one.
    """
    previous: list[Array] = []
    best: Array | None = None
    best_error: Array | None = None
    for level in range(levels):
        row = [estimate(step / 2.0**level)]
        for order in range(1, level + 1):
            row.append(row[-1] + (row[-1] - previous[order - 1]) / (4.0**order - 1.0))
        for order in range(1, level + 1):
            change = np.maximum(
                np.abs(row[order] - row[order - 1]), np.abs(row[order] - previous[order - 1])
            )
            change = change.reshape(*step.shape, -1).max(axis=-1)
            change = np.where(np.isnan(change), np.inf, change)
            if best is None or best_error is None:
                best, best_error = row[order], change
            else:
                better = change < best_error
                shape = better.shape + (1,) * (best.ndim - better.ndim)
                best = np.where(better.reshape(shape), row[order], best)
                best_error = np.minimum(change, best_error)
        previous = row
    assert best is not None
    return best


def gradient_of(field: VectorField, x: Array, step: Array, levels: int = LEVELS) -> Array:
    """Gradient (..., i, j) = df_i/dx_j of a vector field f: (..., 3) -> (..., 3)."""

    def estimate(h: Array) -> Array:
        offsets = h[..., None, None] * np.eye(3)
        forward = field(x[..., None, :] + offsets)
        backward = field(x[..., None, :] - offsets)
        return np.swapaxes((forward - backward) / (2.0 * h[..., None, None]), -1, -2)

    return extrapolate(estimate, step, levels)


def _laplacian_estimate(field: VectorField, x: Array, h: Array) -> Array:
    offsets = h[..., None, None] * np.concatenate([np.eye(3), -np.eye(3)])
    around = field(x[..., None, :] + offsets).sum(axis=-2)
    return np.asarray((around - 6.0 * field(x)) / h[..., None] ** 2)


def laplacian_of(field: VectorField, x: Array, step: Array) -> Array:
    """Laplacian (..., 3) of a vector field."""
    return extrapolate(lambda h: _laplacian_estimate(field, x, h), step)


def laplacian_gradient_of(field: VectorField, x: Array, step: Array, levels: int = LEVELS) -> Array:
    """Gradient (..., i, j) of the Laplacian of a vector field (third derivatives)."""

    def estimate(h: Array) -> Array:
        offsets = h[..., None, None] * np.eye(3)
        steps = np.broadcast_to(h[..., None], (*h.shape, 3))
        forward = _laplacian_estimate(field, x[..., None, :] + offsets, steps)
        backward = _laplacian_estimate(field, x[..., None, :] - offsets, steps)
        return np.swapaxes((forward - backward) / (2.0 * h[..., None, None]), -1, -2)

    return extrapolate(estimate, step, levels)


def curl(gradient: Array) -> Array:
    """Curl (..., 3) from the gradient A[..., i, j] = df_i/dx_j."""
    return np.stack(
        [
            gradient[..., 2, 1] - gradient[..., 1, 2],
            gradient[..., 0, 2] - gradient[..., 2, 0],
            gradient[..., 1, 0] - gradient[..., 0, 1],
        ],
        axis=-1,
    )


# Weights of the values at one, two and three steps: of a first derivative, those behind with the
# other sign, and of a second one, with that of the value between (Fornberg, Math. Comp. 51, 1988).
_FIRST = np.array([0.75, -0.15, 1.0 / 60.0])
_SECOND, _MIDDLE = np.array([1.5, -0.15, 1.0 / 90.0]), -49.0 / 18.0
_PAIRS = (0, 1), (0, 2), (1, 2)


def around(
    field: VectorField, x: Array, step: Array, degree: int
) -> tuple[Array, Array, Array | None]:
    """A field (n, 3) at x (n, 3), its gradient (n, 3, 3) and, for degree 2, (n, i, j, k).

    By differences of order 6 with the steps (n,), from one call of the field.
    """
    ways = list(np.eye(3))
    if degree > 1:
        ways += [ways[i] + sign * ways[j] for i, j in _PAIRS for sign in (1.0, -1.0)]
    offsets = np.multiply.outer([1.0, 2.0, 3.0, -1.0, -2.0, -3.0], np.array(ways)).reshape(-1, 3)
    places = np.concatenate([[[0.0, 0.0, 0.0]], offsets])
    values = field(x[:, None, :] + step[:, None, None] * places)
    middle, rest = values[:, 0], values[:, 1:].reshape(len(x), 2, 3, len(ways), 3)
    slopes = np.einsum("m,nmwi->nwi", _FIRST, rest[:, 0] - rest[:, 1])
    gradient = np.swapaxes(slopes[:, :3], 1, 2) / step[:, None, None]
    if degree < 2:
        return middle, gradient, None
    bends = np.einsum("m,nmwi->nwi", _SECOND, rest[:, 0] + rest[:, 1])
    bends = (bends + _MIDDLE * middle[:, None]) / step[:, None, None] ** 2
    second = np.empty((len(x), 3, 3, 3))
    for i in range(3):
        second[:, :, i, i] = bends[:, i]
    for place, (i, j) in enumerate(_PAIRS):
        mixed = 0.25 * (bends[:, 3 + 2 * place] - bends[:, 4 + 2 * place])
        second[:, :, i, j] = second[:, :, j, i] = mixed
    return middle, gradient, second
