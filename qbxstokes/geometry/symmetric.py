"""Symmetric tensors (..., 3, 3) by their six components, in the order 11 22 33 12 13 23."""

import numpy as np

from qbxstokes.typing import Array

PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
# Number (3, 3) of each component.
PLACES = np.array([[0, 3, 4], [3, 1, 5], [4, 5, 2]])


def symmetric(components: Array) -> Array:
    """Tensors (..., 3, 3) of components (..., 6)."""
    return np.asarray(components[..., PLACES])


def components(tensors: Array) -> Array:
    """Components (..., 6) of symmetric tensors (..., 3, 3)."""
    return np.stack([tensors[..., i, j] for i, j in PAIRS], axis=-1)


def turned(components: Array, rotation: Array) -> Array:
    """Components (N, 6) of R sigma R^T for one rotation R (3, 3)."""
    # One product with the 6 x 6 matrix of the rotation on symmetric tensors.
    matrix = np.empty((6, 6))
    for row, (i, j) in enumerate(PAIRS):
        for column, (a, b) in enumerate(PAIRS):
            value = rotation[i, a] * rotation[j, b]
            matrix[row, column] = value if a == b else value + rotation[i, b] * rotation[j, a]
    return np.asarray(components @ matrix.T)
