"""The flow around a translating ellipsoid of revolution, exactly.

Oberbeck 1876; Lamb, Hydrodynamics (1932), art. 339; with the elliptic integrals of the confocal
spheroid through each point in Carlson's form (DLMF 19.16), so that every aspect ratio is exact.
"""

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import elliprd, elliprf

from qbxstokes.typing import Array


def translating_flow(k: float, points: ArrayLike, velocity: ArrayLike) -> tuple[Array, Array]:
    """Velocity (N, 3) and pressure (N,) at points (N, 3) outside a body of the given velocity (3,).

    Semi-axes a = (k, k, 1) along the coordinates, fluid at rest far away, mu = 1. With
    chi = int dl / Delta and alpha_i = int dl / ((a_i^2 + l) Delta) over [lambda, inf), lambda the
    confocal parameter and size_i = V_i / (chi_0 + a_i^2 alpha_i0),

        u = sum_i size_i (e_i (chi + a_i^2 alpha_i) - x_i grad chi + a_i^2 x_i grad alpha_i),
        p = -2 sum_i size_i d chi / dx_i.
    """
    x, speed = np.asarray(points, dtype=float), np.asarray(velocity, dtype=float)
    squares = np.array([k * k, k * k, 1.0])
    rho2, z2 = x[:, 0] ** 2 + x[:, 1] ** 2, x[:, 2] ** 2
    half = 0.5 * (rho2 + z2 - k * k - 1.0)
    lam = np.maximum(half + np.sqrt(half * half + rho2 + k * k * z2 - k * k), 0.0)
    p, q = k * k + lam, 1.0 + lam
    chi, chi_0 = 2.0 * elliprf(p, p, q), 2.0 * elliprf(k * k, k * k, 1.0)
    across, along = 2.0 / 3.0 * elliprd(p, q, p), 2.0 / 3.0 * elliprd(p, p, q)
    across_0 = 2.0 / 3.0 * elliprd(k * k, 1.0, k * k)
    along_0 = 2.0 / 3.0 * elliprd(k * k, k * k, 1.0)
    scaled = x / (squares + lam[:, None])
    slope = 2.0 * scaled / np.sum(scaled**2, axis=1)[:, None]  # grad lambda
    fall = -slope / (p * np.sqrt(q))[:, None]  # grad chi
    u, pressure = np.zeros_like(x), np.zeros(len(x))
    for i, (alpha, alpha_0) in enumerate(((across, across_0),) * 2 + ((along, along_0),)):
        size = speed[i] / (chi_0 + squares[i] * alpha_0)
        u[:, i] += size * (chi + squares[i] * alpha)
        u -= size * x[:, [i]] * fall * (1.0 - squares[i] / (squares[i] + lam[:, None]))
        pressure -= 2.0 * size * fall[:, i]
    return u, pressure
