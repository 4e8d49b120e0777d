"""Rotations: unit quaternions, rotation matrices, Euler angles.

Quaternions are arrays (..., 4) in the order (q0, q1, q2, q3), scalar first. They rotate the body
frame into the space frame: v_space = R(q) v_body, and the columns of R are the body's axes
D1, D2, D3 seen in space. All functions broadcast over leading axes.
"""

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.typing import Array

# Below this sine of the half angle from a pole only phi + psi (or phi - psi) has meaning.
_POLE = 4.0 * float(np.finfo(np.float64).eps)


def multiply(p: ArrayLike, q: ArrayLike) -> Array:
    """Hamilton product p * q; R(p * q) = R(p) R(q). Shapes (..., 4)."""
    p0, p1, p2, p3 = np.moveaxis(np.asarray(p, dtype=np.float64), -1, 0)
    q0, q1, q2, q3 = np.moveaxis(np.asarray(q, dtype=np.float64), -1, 0)
    return np.stack(
        [
            p0 * q0 - p1 * q1 - p2 * q2 - p3 * q3,
            p0 * q1 + p1 * q0 + p2 * q3 - p3 * q2,
            p0 * q2 - p1 * q3 + p2 * q0 + p3 * q1,
            p0 * q3 + p1 * q2 - p2 * q1 + p3 * q0,
        ],
        axis=-1,
    )


def conjugate(q: ArrayLike) -> Array:
    """Conjugate quaternion, the inverse rotation for unit q. Shape (..., 4)."""
    return np.asarray(np.asarray(q, dtype=np.float64) * [1.0, -1.0, -1.0, -1.0])


def normalize(q: ArrayLike) -> Array:
    """Scale to unit length. Raises ValueError for a zero or non-finite quaternion."""
    array = np.asarray(q, dtype=np.float64)
    largest = np.max(np.abs(array), axis=-1, keepdims=True)
    if not np.all(np.isfinite(largest) & (largest > 0.0)):
        raise ValueError("a zero or non-finite quaternion is no rotation")
    scaled = array / largest  # so that tiny and huge quaternions neither underflow nor overflow
    return np.asarray(scaled / np.sqrt(np.add.reduce(scaled * scaled, axis=-1, keepdims=True)))


def matrix(q: ArrayLike) -> Array:
    """Rotation matrix R(q), body to space, of a unit quaternion. (..., 4) -> (..., 3, 3)."""
    q0, q1, q2, q3 = np.moveaxis(np.asarray(q, dtype=np.float64), -1, 0)
    rows = [
        [
            q0 * q0 + q1 * q1 - q2 * q2 - q3 * q3,
            2.0 * (q1 * q2 - q0 * q3),
            2.0 * (q1 * q3 + q0 * q2),
        ],
        [
            2.0 * (q1 * q2 + q0 * q3),
            q0 * q0 - q1 * q1 + q2 * q2 - q3 * q3,
            2.0 * (q2 * q3 - q0 * q1),
        ],
        [
            2.0 * (q1 * q3 - q0 * q2),
            2.0 * (q2 * q3 + q0 * q1),
            q0 * q0 - q1 * q1 - q2 * q2 + q3 * q3,
        ],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def axis(q: ArrayLike) -> Array:
    """Symmetry axis D3 in space, the third column of R(q). (..., 4) -> (..., 3)."""
    given = np.asarray(q, dtype=np.float64)
    q0, q1, q2, q3 = (given[..., i] for i in range(4))
    found = np.empty((*given.shape[:-1], 3))
    found[..., 0] = 2.0 * (q1 * q3 + q0 * q2)
    found[..., 1] = 2.0 * (q2 * q3 - q0 * q1)
    found[..., 2] = q0 * q0 - q1 * q1 - q2 * q2 + q3 * q3
    return found


def to_space(q: ArrayLike, vector: ArrayLike) -> Array:
    """Components in space of a vector given in the body frame: R(q) v. Shapes (..., 3)."""
    return np.asarray(np.einsum("...ij,...j->...i", matrix(q), np.asarray(vector, np.float64)))


def to_body(q: ArrayLike, vector: ArrayLike) -> Array:
    """Components in the body frame of a vector given in space: R(q)^T v. Shapes (..., 3)."""
    return np.asarray(np.einsum("...ji,...j->...i", matrix(q), np.asarray(vector, np.float64)))


def from_euler(phi: ArrayLike, theta: ArrayLike, psi: ArrayLike) -> Array:
    """Quaternion of R = R3(phi) R1(theta) R3(psi), angles in radians. (...,) -> (..., 4)."""
    half = 0.5 * np.asarray(theta, dtype=np.float64)
    total = 0.5 * (np.asarray(phi, dtype=np.float64) + np.asarray(psi, dtype=np.float64))
    difference = 0.5 * (np.asarray(phi, dtype=np.float64) - np.asarray(psi, dtype=np.float64))
    cosine, sine = np.cos(half), np.sin(half)
    found = np.empty((*np.broadcast_shapes(half.shape, total.shape), 4))
    found[..., 0], found[..., 3] = cosine * np.cos(total), cosine * np.sin(total)
    found[..., 1], found[..., 2] = sine * np.cos(difference), sine * np.sin(difference)
    return found


def to_euler(q: ArrayLike, pole: float = _POLE) -> Array:
    """Euler angles (phi, theta, psi) of R = R3(phi) R1(theta) R3(psi). (..., 4) -> (..., 3).

    theta is in [0, pi] and accurate at both ends; phi and psi are in (-pi, pi]. At the poles,
    where only phi + psi or phi - psi is defined, psi is 0: where the sine of half the angle from
    there is at most `pole`.
    """
    q0, q1, q2, q3 = _components(q)
    cosine, sine = np.hypot(q0, q3), np.hypot(q1, q2)
    size = np.hypot(cosine, sine)
    total, difference = np.arctan2(q3, q0), np.arctan2(q2, q1)
    total, difference = (
        np.where(cosine <= pole * size, difference, total),
        np.where(sine <= pole * size, total, difference),
    )
    found = np.empty((*np.shape(total), 3))
    found[..., 0], found[..., 2] = _wrap(np.array([total + difference, total - difference]))
    found[..., 1] = 2.0 * np.arctan2(sine, cosine)
    return found


def _components(vectors: ArrayLike) -> Array:
    """The components of vectors, each in memory of its own.

    NumPy computes arctan2 of strided views by one of two ways, last bits apart, which it chooses by
    where the arrays happen to lie: contiguous ones always give the same bits.
    """
    return np.array(np.moveaxis(np.asarray(vectors, dtype=np.float64), -1, 0), order="C")


def _wrap(angle: Array) -> Array:
    """The same angle in (-pi, pi]; values already there are returned unchanged."""
    turns = np.where((angle > np.pi) | (angle <= -np.pi), np.ceil(angle / (2 * np.pi) - 0.5), 0.0)
    return np.asarray(angle - 2.0 * np.pi * turns)


def from_axis(direction: ArrayLike) -> Array:
    """A quaternion whose axis D3 is `direction` (any length but zero), with psi = 0.

    (..., 3) -> (..., 4). Raises ValueError for a zero or non-finite direction.
    """
    array = np.asarray(direction, dtype=np.float64)
    length = np.max(np.abs(array), axis=-1, keepdims=True)
    if not np.all(np.isfinite(length) & (length > 0.0)):
        raise ValueError("a zero or non-finite vector is no direction")
    d1, d2, d3 = _components(array / length)
    # 0 - d2 and not -d2: the negative zero would turn the pole by pi.
    return from_euler(np.arctan2(d1, 0.0 - d2), np.arctan2(np.hypot(d1, d2), d3), 0.0)


def random_quaternions(n: int, rng: np.random.Generator) -> Array:
    """n rotations, uniform on the rotation group (Haar measure). Shape (n, 4)."""
    return normalize(rng.standard_normal((n, 4)))


def random_axes(n: int, rng: np.random.Generator) -> Array:
    """n directions, uniform on the sphere. Shape (n, 3)."""
    vectors = rng.standard_normal((n, 3))
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))
