"""Spheroid in a linear flow: torque, free rotation and orbits.

G. B. Jeffery 1922, Proc. R. Soc. A 102, 161; J. Bagge 2015, Numerical simulation of an inertial
spheroidal particle in Stokes flow, KTH, chapter 3.

Body frame quantities carry D3, the axis of symmetry, as third coordinate. The shear flow of the
orbits is u = rate (x2, 0, 0); the axis is D3 = (sin theta sin phi, -sin theta cos phi, cos theta)
for Euler angles (phi, theta, psi) with R = R3(phi) R1(theta) R3(psi).
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.reference.lamb import alpha0, gamma0
from qbxstokes.typing import Array


def rotation_resistance(k: float) -> tuple[float, float]:
    """(transverse, axial) resistance R in M = -R Omega, units mu c^3; 8 pi for a sphere.

    `torque` with the undisturbed flow at rest.
    """
    transverse = 16.0 * np.pi / 3.0 * (k * k + 1.0) / (k * k * alpha0(k) + gamma0(k))
    return transverse, 16.0 * np.pi / (3.0 * alpha0(k))


def free_angular_velocity(k: float, gradient: ArrayLike) -> Array:
    """Angular velocity (..., 3) of a free spheroid in the linear flow u = A x, body frame.

    Omega1 = (k^2 A32 - A23)/(1+k^2), Omega2 = (A13 - k^2 A31)/(1+k^2), Omega3 = (A21 - A12)/2
    (the zero of `torque`). gradient: A (..., 3, 3) in the body frame.
    """
    a = np.asarray(gradient, dtype=float)
    off = (a[..., i, j] for i, j in ((0, 1), (1, 0), (0, 2), (2, 0), (1, 2), (2, 1)))
    return np.stack(free_rates(k, *off), axis=-1)


def free_rates(
    k: float, a12: Any, a21: Any, a13: Any, a31: Any, a23: Any, a32: Any
) -> tuple[Any, Any, Any]:
    """The three components of `free_angular_velocity`, of numbers or arrays alike."""
    square = k * k
    return (
        (square * a32 - a23) / (1.0 + square),
        (a13 - square * a31) / (1.0 + square),
        0.5 * (a21 - a12),
    )


def torque(k: float, gradient: ArrayLike, angular_velocity: ArrayLike) -> Array:
    """Torque (..., 3) on a spheroid turning with Omega in the linear flow u = A x, body frame.

    M = (16 pi/3) ( [(k^2-1) D23 - (k^2+1)(V23 + Omega1)]/(k^2 alpha0 + gamma0),
                    [(1-k^2) D13 - (k^2+1)(Omega2 - V13)]/(k^2 alpha0 + gamma0),
                    -(V12 + Omega3)/alpha0 )
    with D and V the symmetric and antisymmetric parts of A (Jeffery 1922; Bagge 2015, eq. 3.33).
    """
    a = np.asarray(gradient, dtype=float)
    omega = np.asarray(angular_velocity, dtype=float)
    strain = 0.5 * (a + np.swapaxes(a, -1, -2))
    spin = 0.5 * (a - np.swapaxes(a, -1, -2))
    square = k * k
    alpha = alpha0(k)
    across = square * alpha + gamma0(k)
    first = (square - 1.0) * strain[..., 1, 2] - (square + 1.0) * (spin[..., 1, 2] + omega[..., 0])
    second = (1.0 - square) * strain[..., 0, 2] - (square + 1.0) * (omega[..., 1] - spin[..., 0, 2])
    third = -(spin[..., 0, 1] + omega[..., 2])
    parts = np.broadcast_arrays(first / across, second / across, third / alpha)
    return np.asarray(16.0 * np.pi / 3.0 * np.stack(parts, axis=-1))


def period(k: float, rate: float = 1.0) -> float:
    """Period 2 pi (k + 1/k)/|rate| of an orbit in shear of the given rate (Jeffery 1922)."""
    return 2.0 * np.pi * (k + 1.0 / k) / abs(rate)


def orbit_constant(k: float, axis: ArrayLike) -> Array:
    """Orbit constant C = tan(theta) sqrt(cos^2 phi + k^2 sin^2 phi)/k, shape (...).

    Written with the axis (..., 3) as sqrt(d2^2 + k^2 d1^2)/(k |d3|): 0 for log-rolling, infinity
    for tumbling in the plane of shear. Conserved for a free massless spheroid.
    """
    d = np.asarray(axis, dtype=float)
    with np.errstate(divide="ignore"):
        result: Array = np.hypot(d[..., 1], k * d[..., 0]) / (k * np.abs(d[..., 2]))
    return result


def axis_at(t: ArrayLike, k: float, axis: ArrayLike, rate: float = 1.0) -> Array:
    """Axis of symmetry (..., 3) at times t (...) of a free spheroid starting with `axis` (3,).

    d' = (W + lambda E) d - d (d.E d) is the linear equation e' = (W + lambda E) e projected on
    the unit sphere (Bretherton 1962, J. Fluid Mech. 14, 284); in shear its solution is a rotation
    of (k e1, e2) with angle omega t, omega = rate k/(1+k^2). Regular for every orientation.
    """
    times = np.asarray(t, dtype=float)
    first, second, third = np.asarray(axis, dtype=float)
    angle = rate * k / (1.0 + k * k) * times
    cosine, sine = np.cos(angle), np.sin(angle)
    stretched = np.stack(
        [
            cosine * first + sine * second / k,
            cosine * second - sine * first * k,
            np.full_like(times, third),
        ],
        axis=-1,
    )
    return np.asarray(stretched / np.linalg.norm(stretched, axis=-1, keepdims=True))


def axis_in_linear_flow(t: float, k: float, gradient: ArrayLike, axis: ArrayLike) -> Array:
    """Axis (3,) at time t of a free spheroid in any steady linear flow u = A x.

    expm(t (W + lambda E)) axis, normalised, lambda = (1-k^2)/(1+k^2) (Bretherton 1962).
    """
    from scipy.linalg import expm

    a = np.asarray(gradient, dtype=float)
    shape = (1.0 - k * k) / (1.0 + k * k)
    moved = expm(t * (0.5 * (a - a.T) + shape * 0.5 * (a + a.T))) @ np.asarray(axis, dtype=float)
    return np.asarray(moved / np.linalg.norm(moved))
