"""Jeffery's orbits in Euler angles, in closed form: what rotations and pictures are checked by."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import elliprf, elliprj

Array = NDArray[np.float64]


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
