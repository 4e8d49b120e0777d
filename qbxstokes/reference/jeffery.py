"""Spheroid in a linear flow: torque, free rotation and orbits.

G. B. Jeffery 1922, Proc. R. Soc. A 102, 161; J. Bagge 2015, Numerical simulation of an inertial
spheroidal particle in Stokes flow, KTH, chapter 3.

Body frame quantities carry D3, the axis of symmetry, as third coordinate. The shear flow of the
orbits is u = rate (x2, 0, 0); the axis is D3 = (sin theta sin phi, -sin theta cos phi, cos theta)
for Euler angles (phi, theta, psi) with R = R3(phi) R1(theta) R3(psi).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qbxstokes.reference.integrals import alpha0, gamma0

Array = NDArray[np.float64]


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
    result: Array = 16.0 * np.pi / 3.0 * np.stack(parts, axis=-1)
    return result


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
    result: Array = stretched / np.linalg.norm(stretched, axis=-1, keepdims=True)
    return result


def axis_in_linear_flow(t: float, k: float, gradient: ArrayLike, axis: ArrayLike) -> Array:
    """Axis (3,) at time t of a free spheroid in any steady linear flow u = A x.

    expm(t (W + lambda E)) axis, normalised, lambda = (1-k^2)/(1+k^2) (Bretherton 1962).
    """
    from scipy.linalg import expm

    a = np.asarray(gradient, dtype=float)
    shape = (1.0 - k * k) / (1.0 + k * k)
    moved = expm(t * (0.5 * (a - a.T) + shape * 0.5 * (a + a.T))) @ np.asarray(axis, dtype=float)
    result: Array = moved / np.linalg.norm(moved)
    return result


def euler_angles_at(
    t: ArrayLike, k: float, phi: float, theta: float, psi: float = 0.0, rate: float = 1.0
) -> Array:
    """Euler angles (..., [phi, theta, psi]) at times t (...), from given ones at t = 0.

    tan phi = tan(chi)/k with chi = chi(0) - rate t k/(1+k^2), tan theta proportional to
    1/sqrt(g), g = cos^2 phi + k^2 sin^2 phi (Bagge 2015, eqs. 3.35-3.36), and
    psi' = (lambda/2) rate cos(theta) cos(2 phi), integrated in closed form. phi and psi are
    continuous in time (not wrapped). No orientation is special: at theta = 0 and pi, where only
    phi +- psi has a meaning, and at theta = pi/2 the formulas hold as they stand.
    """
    times = np.asarray(t, dtype=float)
    start = _reduced_angle(phi, k)
    angle = _reduced_angle(start - rate * k / (1.0 + k * k) * times, 1.0 / k)
    square = k * k
    weight = np.cos(angle) ** 2 + square * np.sin(angle) ** 2
    initial = np.cos(phi) ** 2 + square * np.sin(phi) ** 2
    polar = np.arctan2(np.sqrt(initial) * np.sin(theta), np.sqrt(weight) * np.cos(theta))
    spin = _spin_integral(angle, k, theta, initial) - _spin_integral(
        np.asarray(phi, dtype=float), k, theta, initial
    )
    return np.stack([angle, polar, psi + spin], axis=-1)


def _reduced_angle(angle: ArrayLike, k: float) -> Array:
    """Continuous chi with tan chi = k tan angle, equal to angle at multiples of pi/2."""
    a = np.asarray(angle, dtype=float)
    sine, cosine = np.sin(a), np.cos(a)
    result: Array = a + np.arctan2((k - 1.0) * sine * cosine, cosine**2 + k * sine**2)
    return result


def _spin_integral(angle: Array, k: float, theta: float, initial: float) -> Array:
    """Integral from 0 to phi of dpsi/dphi on the orbit through (theta, g = initial).

    dpsi/dphi = -(1-k^2)/2 cos(theta0) cos(2 phi)/sqrt(g (g cos^2 theta0 + g0 sin^2 theta0)).
    With x = tan phi this is an elliptic integral of the first and third kind; in Carlson's form
    (DLMF 19.16, 19.29) homogeneous in sin and cos of phi, hence regular at phi = pi/2.
    """
    from scipy.special import elliprf, elliprj

    square = k * k
    cos2, sin2 = np.cos(theta) ** 2, np.sin(theta) ** 2
    head = cos2 + initial * sin2
    tail = square * cos2 + initial * sin2
    scale = -0.5 * (1.0 - square) * np.cos(theta) / np.sqrt(head)

    def within(a: Array) -> Array:
        s, c = np.sin(a), np.cos(a)
        x, y, z = c * c, c * c + square * s * s, c * c + tail / head * s * s
        result: Array = s * elliprf(x, y, z) - 2.0 / 3.0 * s**3 * elliprj(x, y, z, 1.0)
        return result

    turns = np.round(angle / np.pi)
    quarter = within(np.asarray(0.5 * np.pi))
    result: Array = scale * (2.0 * turns * quarter + within(angle - np.pi * turns))
    return result
