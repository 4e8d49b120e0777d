"""Spheroid in the paraboloidal flow u = K (x2^2 + x3^2) e1.

A. T. Chwang 1975, J. Fluid Mech. 72, 17, as quoted by J. Bagge 2015 (Numerical simulation of an
inertial spheroidal particle in Stokes flow, KTH), eqs. 3.39-3.41. The centre is at x2 = eta,
x3 = 0; alpha is the angle from e1 to D3; lengths are in units of the polar semi-axis c, mu = 1.
Chwang's formulas are for prolate bodies, with eccentricity e^2 = 1 - k^2. They are analytic
functions of e^2 and hold for oblate ones, e^2 < 0, by continuation (L/e = 2 atan(|e|)/|e|).
"""

import math
from functools import lru_cache

_SERIES = tuple(range(1, 40))


@lru_cache(maxsize=64)
def _brackets(k: float) -> tuple[float, float]:
    """(-2e + (1+e^2) L)/e^3 and (2e + (3e^2-1) L)/e^3 with L = log[(1+e)/(1-e)].

    8/3 and 16/3 for a sphere; by the power series in e^2 where the terms cancel.
    """
    square = (1.0 - k) * (1.0 + k)
    if abs(square) < 0.25:
        axial = sum(
            2.0 * square ** (n - 1) * (1.0 / (2 * n + 1) + 1.0 / (2 * n - 1)) for n in _SERIES
        )
        transverse = sum(
            2.0 * square ** (n - 1) * (3.0 / (2 * n - 1) - 1.0 / (2 * n + 1)) for n in _SERIES
        )
        return axial, transverse
    root = math.sqrt(abs(square))
    # log[(1+e)/(1-e)] = 2 log[(1+e)/k] keeps its digits for a thin body, where e is nearly 1.
    ratio = (math.log((1.0 + root) / k) if square > 0.0 else math.atan(root)) * 2.0 / root
    axial = (-2.0 + (1.0 + square) * ratio) / square
    transverse = (2.0 + (3.0 * square - 1.0) * ratio) / square
    return axial, transverse


def free_velocity(k: float, curvature: float, eta: float, alpha: float) -> float:
    """Velocity along e1 of a free massless spheroid (Bagge 2015, eq. 3.39, undivided).

    K [eta^2 + (2 - e^2 - e^2 cos^2 alpha)/3], for any orientation with that alpha.
    """
    square = 1.0 - k * k
    return curvature * (eta**2 + (2.0 - square - square * math.cos(alpha) ** 2) / 3.0)


def fixed_force(
    k: float, curvature: float, eta: float, cosine: float, sine: float
) -> tuple[float, float]:
    """Force along D1 and D3 on a spheroid held at theta = pi/2, psi = 0 (Bagge 2015, eq. 3.40).

    cosine = e1.D3, sine = e1.D1; D3 component 16 pi e^3 K cos B/(-2e + (1+e^2) L), D1 component
    32 pi e^3 K sin B/(2e + (3e^2-1) L), B = eta^2 + (2 - e^2 - e^2 cos^2)/3.
    """
    axial, transverse = _brackets(k)
    square = 1.0 - k * k
    flow = curvature * (eta**2 + (2.0 - square - square * cosine**2) / 3.0)
    return 32.0 * math.pi * sine * flow / transverse, 16.0 * math.pi * cosine * flow / axial


def fixed_torque(k: float, curvature: float, eta: float, cosine: float) -> float:
    """Torque about D2 on a spheroid held at theta = pi/2, psi = 0 (Bagge 2015, eq. 3.41).

    -64 pi e^3 K eta (1 - e^2 cos^2)/(3 (-2e + (1+e^2) L)); cosine = e1.D3.
    """
    axial, _ = _brackets(k)
    square = 1.0 - k * k
    return -64.0 * math.pi * curvature * eta * (1.0 - square * cosine**2) / (3.0 * axial)
