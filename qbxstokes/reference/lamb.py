"""Drag on a translating spheroid with semi-axes (k, k, 1), and its elliptic integrals, to rounding.

Drag: Lamb, Hydrodynamics, 6th ed., art. 339; Oberbeck 1876.

alpha0 = int_0^inf dl (k^2+l)^-2 (1+l)^(-1/2)   = 2/3 R_D(1, k^2, k^2)
gamma0 = int_0^inf dl (k^2+l)^-1 (1+l)^(-3/2)   = 2/3 R_D(k^2, k^2, 1)
chi0   = int_0^inf dl (k^2+l)^-1 (1+l)^(-1/2)   = 2 R_F(k^2, k^2, 1)

Definitions: Jeffery 1922, Proc. R. Soc. A 102, 161; Carlson's symmetric integrals: NIST DLMF,
section 19.16; computed by duplication (B. C. Carlson 1995, Numer. Algorithms 10, 13), which takes a
microsecond per step where importing a library of special functions takes a third of a second.
"""

from math import sqrt

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.typing import Array


def translation_resistance(k: float) -> tuple[float, float]:
    """(transverse, axial) resistance R in F = -R V, units mu c; 6 pi for a sphere.

    R = 16 pi/(chi0 + k^2 alpha0) across the axis and 16 pi/(chi0 + gamma0) along it.
    """
    chi = chi0(k)
    return 16.0 * np.pi / (chi + k * k * alpha0(k)), 16.0 * np.pi / (chi + gamma0(k))


def drag(k: float, velocity: ArrayLike) -> Array:
    """Force (..., 3) on a spheroid translating with `velocity` (..., 3), both in the body frame."""
    transverse, axial = translation_resistance(k)
    result: Array = -np.array([transverse, transverse, axial]) * np.asarray(velocity, dtype=float)
    return result


def alpha0(k: float) -> float:
    """alpha0 of aspect ratio k (weight of a transverse semi-axis)."""
    return 2.0 / 3.0 * carlson_rd(1.0, k * k, k * k)


def gamma0(k: float) -> float:
    """gamma0 of aspect ratio k (weight of the polar semi-axis)."""
    return 2.0 / 3.0 * carlson_rd(k * k, k * k, 1.0)


def chi0(k: float) -> float:
    """chi0 of aspect ratio k."""
    return 2.0 * carlson_rf(k * k, k * k, 1.0)


# Relative distance of the arguments at which the series below are exact to rounding.
_NEAR = 1e-3


def carlson_rf(x: float, y: float, z: float) -> float:
    """R_F(x, y, z) of positive numbers (DLMF 19.16.1; Carlson 1995, eqs. 2.2-2.7)."""
    while True:
        mean = (x + y + z) / 3.0
        a, b, c = (mean - x) / mean, (mean - y) / mean, (mean - z) / mean
        if max(abs(a), abs(b), abs(c)) < _NEAR:
            break
        shift = sqrt(x * y) + sqrt(x * z) + sqrt(y * z)
        x, y, z = 0.25 * (x + shift), 0.25 * (y + shift), 0.25 * (z + shift)
    e2, e3 = a * b - c * c, a * b * c
    series = 1.0 - e2 / 10.0 + e3 / 14.0 + e2 * e2 / 24.0 - 3.0 * e2 * e3 / 44.0
    return series / sqrt(mean)


def carlson_rd(x: float, y: float, z: float) -> float:
    """R_D(x, y, z) of positive numbers (DLMF 19.16.5; Carlson 1995, eqs. 2.28-2.34)."""
    total, scale = 0.0, 1.0
    while True:
        mean = 0.2 * (x + y + 3.0 * z)
        a, b = (mean - x) / mean, (mean - y) / mean
        c = -(a + b) / 3.0
        if max(abs(a), abs(b), abs(c)) < _NEAR:
            break
        shift = sqrt(x * y) + sqrt(x * z) + sqrt(y * z)
        total += scale / (sqrt(z) * (z + shift))
        scale *= 0.25
        x, y, z = 0.25 * (x + shift), 0.25 * (y + shift), 0.25 * (z + shift)
    ab, cc = a * b, c * c
    e2, e3 = ab - 6.0 * cc, (3.0 * ab - 8.0 * cc) * c
    e4, e5 = 3.0 * (ab - cc) * cc, ab * cc * c
    series = 1.0 - 3.0 * e2 / 14.0 + e3 / 6.0 + 9.0 * e2 * e2 / 88.0 - 3.0 * e4 / 22.0
    series += -9.0 * e2 * e3 / 52.0 + 3.0 * e5 / 26.0
    return scale * series / (mean * sqrt(mean)) + 3.0 * total
