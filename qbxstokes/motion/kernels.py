"""The equations of motion, once, as scalar arithmetic.

Every function here, in `law` and in `taylor` takes and returns plain numbers and uses +, -, *, /
alone. The same source therefore runs in many ways: on Python floats, on NumPy rows (one entry per
lane), recorded and written out for the constants of a scene (tracing.py: one body, nothing to
load), compiled by numba over a block (loops.py, compiled.py), and on complex numbers, which makes
the Jacobian exact to rounding: Im f(y + i h e)/h has no subtraction, so that h may be 1e-100
(Squire & Trapp, SIAM Rev. 40, 1998).

The state of a body is that of `layout`: x, q and, for St > 0, V and W. The right-hand side does not
see the length of q: R(q) is divided by |q|^2, so that f is homogeneous in q, a Runge-Kutta step
commutes with scaling q, and q may be scaled to unit length at any time without any effect on the
orbit.
"""

from __future__ import annotations

from typing import Any

from qbxstokes.motion.law import free_motion
from qbxstokes.motion.taylor import Matrix, Scalar, Twist, Vector

STEP = 1e-100  # h of the complex steps


def body_axes(q0: Scalar, q1: Scalar, q2: Scalar, q3: Scalar) -> Matrix:
    """Columns D1, D2, D3 of R(q), in this order, for a quaternion of any length."""
    a, b, c, d = q0 * q0, q1 * q1, q2 * q2, q3 * q3
    s = 1.0 / (a + b + c + d)
    t = s + s
    q01, q02, q03, q12, q13, q23 = q0 * q1, q0 * q2, q0 * q3, q1 * q2, q1 * q3, q2 * q3
    return (
        s * (a + b - c - d),
        t * (q12 + q03),
        t * (q13 - q02),
        t * (q12 - q03),
        s * (a - b + c - d),
        t * (q23 + q01),
        t * (q13 + q02),
        t * (q23 - q01),
        s * (a - b - c + d),
    )


def symmetry_axis(q0: Scalar, q1: Scalar, q2: Scalar, q3: Scalar) -> Vector:
    """D3 alone, for a quaternion of any length."""
    a, b, c, d = q0 * q0, q1 * q1, q2 * q2, q3 * q3
    s = 1.0 / (a + b + c + d)
    t = s + s
    return t * (q1 * q3 + q0 * q2), t * (q2 * q3 - q0 * q1), s * (a - b - c + d)


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


def quaternion_rate_space(
    q0: Scalar, q1: Scalar, q2: Scalar, q3: Scalar, o1: Scalar, o2: Scalar, o3: Scalar
) -> tuple[Scalar, Scalar, Scalar, Scalar]:
    """dq/dt = (0, Omega) * q / 2 with Omega in the space frame."""
    return (
        -0.5 * (o1 * q1 + o2 * q2 + o3 * q3),
        0.5 * (o1 * q0 + o2 * q3 - o3 * q2),
        0.5 * (o2 * q0 + o3 * q1 - o1 * q3),
        0.5 * (o3 * q0 + o1 * q2 - o2 * q1),
    )


def quaternion_rate_body(
    q0: Scalar, q1: Scalar, q2: Scalar, q3: Scalar, w1: Scalar, w2: Scalar, w3: Scalar
) -> tuple[Scalar, Scalar, Scalar, Scalar]:
    """dq/dt = q * (0, W) / 2 with W in the body frame."""
    return (
        -0.5 * (q1 * w1 + q2 * w2 + q3 * w3),
        0.5 * (q0 * w1 + q2 * w3 - q3 * w2),
        0.5 * (q0 * w2 + q3 * w1 - q1 * w3),
        0.5 * (q0 * w3 + q1 * w2 - q2 * w1),
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


def massless(
    x1: Scalar,
    x2: Scalar,
    x3: Scalar,
    q0: Scalar,
    q1: Scalar,
    q2: Scalar,
    q3: Scalar,
    flow: Any,
    law: Any,
    mobility: Any,
    loads: Any,
) -> Any:
    """dy/dt of a body without inertia, y = (x, q): drag balances the loads at every instant.

    loads: as in `driven_motion`, or None for none.
    """
    if loads is not None:
        axes = body_axes(q0, q1, q2, q3)
        motion = free_motion(x1, x2, x3, axes[6], axes[7], axes[8], flow, law)
        u1, u2, u3, o1, o2, o3 = driven_motion(motion, axes, mobility, loads)
    else:
        d1, d2, d3 = symmetry_axis(q0, q1, q2, q3)
        u1, u2, u3, o1, o2, o3 = free_motion(x1, x2, x3, d1, d2, d3, flow, law)
    r0, r1, r2, r3 = quaternion_rate_space(q0, q1, q2, q3, o1, o2, o3)
    return u1, u2, u3, r0, r1, r2, r3


def inertial(
    x1: Scalar,
    x2: Scalar,
    x3: Scalar,
    q0: Scalar,
    q1: Scalar,
    q2: Scalar,
    q3: Scalar,
    v1: Scalar,
    v2: Scalar,
    v3: Scalar,
    w1: Scalar,
    w2: Scalar,
    w3: Scalar,
    flow: Any,
    law: Any,
    mobility: Any,
    loads: Any,
    rates: Any,
    gyration: float,
    follow: Any,
) -> Any:
    """dy/dt of a body with inertia, y = (x, q, V, W): see `accelerations`.

    loads: as in `driven_motion`, or None for none. follow: None, or two factors, 1 for a
    translation (rotation) without inertia: it moves with `motion` at every instant, and its part
    of the state, with its `rates`, is zero.
    """
    axes = body_axes(q0, q1, q2, q3)
    motion = free_motion(x1, x2, x3, axes[6], axes[7], axes[8], flow, law)
    if loads is not None:
        motion = driven_motion(motion, axes, mobility, loads)
    r0, r1, r2, r3 = quaternion_rate_body(q0, q1, q2, q3, w1, w2, w3)
    p1, p2, p3, s1, s2, s3 = accelerations(v1, v2, v3, w1, w2, w3, motion, axes, rates, gyration)
    if follow is not None:
        u1, u2, u3, o1, o2, o3 = motion
        move, turn = follow
        g0, g1, g2, g3 = quaternion_rate_space(q0, q1, q2, q3, o1, o2, o3)
        v1, v2, v3 = v1 + move * (u1 - v1), v2 + move * (u2 - v2), v3 + move * (u3 - v3)
        r0, r1 = r0 + turn * (g0 - r0), r1 + turn * (g1 - r1)
        r2, r3 = r2 + turn * (g2 - r2), r3 + turn * (g3 - r3)
    return v1, v2, v3, r0, r1, r2, r3, p1, p2, p3, s1, s2, s3
