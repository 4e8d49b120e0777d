"""Drag of a body of revolution with fore-aft symmetry, as scalar arithmetic (see `kernels`).

It acts along and across the axis, on translation and rotation apart.
"""

from __future__ import annotations

from typing import Any

from qbxstokes.motion.taylor import Matrix, Scalar, Twist


def driven_motion(motion: Twist, axes: Matrix, mobility: Any, loads: Any) -> Twist:
    """Motion at which the hydrodynamic force balances the loads: U + R^-1 F, Omega + R^-1 M.

    mobility: the inverse resistances (translation transverse, axial, rotation transverse, axial).
    loads: force fixed in space, force fixed in the body, torque fixed in space, torque fixed in
    the body (12 numbers). The drag is linear, so that a body with inertia relaxes towards this
    motion and not towards the free one: the loads enter nowhere else.
    """
    u1, u2, u3, o1, o2, o3 = motion
    a1, a2, a3, b1, b2, b3, d1, d2, d3 = axes
    f1, f2, f3, g1, g2, g3, m1, m2, m3, n1, n2, n3 = loads
    mt, ma, nt, na = mobility
    f1 = f1 + a1 * g1 + b1 * g2 + d1 * g3
    f2 = f2 + a2 * g1 + b2 * g2 + d2 * g3
    f3 = f3 + a3 * g1 + b3 * g2 + d3 * g3
    m1 = m1 + a1 * n1 + b1 * n2 + d1 * n3
    m2 = m2 + a2 * n1 + b2 * n2 + d2 * n3
    m3 = m3 + a3 * n1 + b3 * n2 + d3 * n3
    f = (ma - mt) * (f1 * d1 + f2 * d2 + f3 * d3)
    m = (na - nt) * (m1 * d1 + m2 * d2 + m3 * d3)
    return (
        u1 + mt * f1 + f * d1,
        u2 + mt * f2 + f * d2,
        u3 + mt * f3 + f * d3,
        o1 + nt * m1 + m * d1,
        o2 + nt * m2 + m * d2,
        o3 + nt * m3 + m * d3,
    )


def accelerations(
    v1: Scalar,
    v2: Scalar,
    v3: Scalar,
    w1: Scalar,
    w2: Scalar,
    w3: Scalar,
    motion: Twist,
    axes: Matrix,
    rates: Any,
    gyration: float,
) -> Twist:
    """dV/dt (space) and dW/dt (body) of a body that drag pulls towards `motion`.

    dV/dt = R_t (U - V)/(St Theta); dW/dt = J^-1 (R_r (R^T Omega - W)/St - W x (J W)).
    rates: R_t/(St Theta) transverse and axial, R_r/(St J) transverse and axial.
    gyration: (J3 - J1)/J1, which is (k^2 - 1)/(k^2 + 1) for a uniform spheroid.
    """
    u1, u2, u3, o1, o2, o3 = motion
    a1, a2, a3, b1, b2, b3, d1, d2, d3 = axes
    at, aa, bt, ba = rates
    e1, e2, e3 = u1 - v1, u2 - v2, u3 - v3
    along = (aa - at) * (e1 * d1 + e2 * d2 + e3 * d3)
    spin = gyration * w3
    return (
        at * e1 + along * d1,
        at * e2 + along * d2,
        at * e3 + along * d3,
        bt * (a1 * o1 + a2 * o2 + a3 * o3 - w1) - spin * w2,
        bt * (b1 * o1 + b2 * o2 + b3 * o3 - w2) + spin * w1,
        ba * (d1 * o1 + d2 * o2 + d3 * o3 - w3),
    )
