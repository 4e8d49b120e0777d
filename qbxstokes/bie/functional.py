"""The body model: everything the motion needs to know of the hydrodynamics.

Force, torque and free motion of a rigid body in a Stokes flow are linear functionals of the
background velocity. For a body of revolution with fore-aft symmetry the functional takes a closed
structure with few coefficients for polynomial flows (`FaxenCoefficients`, `Resistance`) and is a
weighted sum over the surface grid for any other flow (`GridFunctional`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Resistance:
    """Force and torque per unit velocity: F = -R V, M = -R Omega (body frame, mu = 1).

    Units: translation in mu c, rotation in mu c^3. Sphere of radius 1: 6 pi and 8 pi.
    """

    translation_transverse: float
    translation_axial: float
    rotation_transverse: float
    rotation_axial: float


@dataclass(frozen=True)
class FaxenCoefficients:
    """Coefficients of the free motion in a Stokes flow of polynomial degree <= 3.

    With d = D3, derivatives of the background flow u taken at the centre, w = curl u and
    E = sym grad u, the free velocity and angular velocity are (summation over repeated indices)

        U     = u + q0 Lap u + q1 (d.grad)^2 u + q2 d (d.Lap u)
                  + q3 d (d.(d.grad)^2 u) + q4 grad(d.(d.grad) u)
        Omega = w/2 + lambda d x (E d) + c0 (d.grad)^2 w + c1 d (d.(d.grad)^2 w)
                  + c2 d x ((Lap E) d) + c3 d x (((d.grad)^2 E) d)

    which is the most general law for this symmetry: a Stokes flow of degree 2 (3) holds three
    irreducible representations of the rotation group and the body's symmetry leaves five (four)
    free coefficients. `linear` is lambda, `quadratic` (5,) is q, `cubic` (4,) is c.
    """

    linear: float
    quadratic: Array
    cubic: Array


@dataclass(frozen=True)
class GridFunctional:
    """Free motion from the background velocity on the surface grid, in the body frame.

    points: (N, 3); weights: (6, N, 3). (U, Omega) = einsum('anj,nj->a', weights, u(points)).
    """

    points: Array
    weights: Array


@dataclass(frozen=True)
class BodyModel:
    """Hydrodynamics of one spheroid, formed once per aspect ratio and discretisation."""

    aspect_ratio: float
    resistance: Resistance
    faxen: FaxenCoefficients
    grid: GridFunctional | None
    error_estimate: float
