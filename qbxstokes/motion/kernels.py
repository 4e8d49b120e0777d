"""The equations of motion, once, as scalar arithmetic.

Every function down to the loops at the end takes and returns plain numbers and uses +, -, *, /
alone. The same source therefore runs in many ways: on Python floats, on NumPy rows (one entry per
body), recorded and written out for the constants of a scene (tracing.py: one body, nothing to
load), compiled by numba over a block (compiled.py), and on complex numbers, which makes the
Jacobian exact to rounding: Im f(y + i h e)/h has no subtraction, so that h may be 1e-100 (Squire &
Trapp, SIAM Rev. 40, 1998).

The state of a body is x (centre, space), q (quaternion) and, for St > 0, V (velocity, space) and
W (angular velocity, body). Flow derivatives come packed, symmetric indices once:
velocity u_i, gradient A_ij by rows, second = (d_j d_k u_i for jk = 11 22 33 12 13 23, by i),
third = (d_j d_k d_l u_i for 111 112 113 122 123 133 222 223 233 333, by i), at the flow's origin.

The right-hand side does not see the length of q: R(q) is divided by |q|^2, so that f is homogeneous
in q, a Runge-Kutta step commutes with scaling q, and q may be scaled to unit length at any time
without any effect on the orbit.
"""

from __future__ import annotations

from typing import Any

import numpy as np

# float, complex or a NumPy row of either; numba infers its own types.
Scalar = Any
Vector = tuple[Scalar, Scalar, Scalar]
Matrix = tuple[Scalar, Scalar, Scalar, Scalar, Scalar, Scalar, Scalar, Scalar, Scalar]
Twist = tuple[Scalar, Scalar, Scalar, Scalar, Scalar, Scalar]


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


def turning(
    d1: Scalar, d2: Scalar, d3: Scalar, gradient: Any, half: Scalar, linear: Scalar
) -> Vector:
    """half * curl + linear * d x (E d) of a gradient A[i, j] given by rows, E = sym A.

    For a long body half and linear/2 are nearly equal, and for a flat one opposite, so that the two
    terms cancel wherever the axis lingers. With E d = A d - curl x d/2 = A^T d + curl x d/2 it is
    (half - linear/2) curl + linear (d x (A d) + d (d.curl)/2), or the same with A^T and the other
    signs, where nothing cancels (d is of unit length).
    """
    a11, a12, a13, a21, a22, a23, a31, a32, a33 = gradient
    w1, w2, w3 = a32 - a23, a13 - a31, a21 - a12
    if linear < 0.0:
        a12, a13, a21, a23, a31, a32 = a21, a31, a12, a32, a13, a23
        rest, along = half + 0.5 * linear, -0.5 * linear * (d1 * w1 + d2 * w2 + d3 * w3)
    else:
        rest, along = half - 0.5 * linear, 0.5 * linear * (d1 * w1 + d2 * w2 + d3 * w3)
    e1 = a11 * d1 + a12 * d2 + a13 * d3
    e2 = a21 * d1 + a22 * d2 + a23 * d3
    e3 = a31 * d1 + a32 * d2 + a33 * d3
    return (
        rest * w1 + linear * (d2 * e3 - d3 * e2) + along * d1,
        rest * w2 + linear * (d3 * e1 - d1 * e3) + along * d2,
        rest * w3 + linear * (d1 * e2 - d2 * e1) + along * d3,
    )


def contract(second: Any, x1: Scalar, x2: Scalar, x3: Scalar) -> Matrix:
    """B_ijk x_k of packed second derivatives, by rows."""
    (b11, b12, b13, b14, b15, b16, b21, b22, b23, b24, b25, b26, b31, b32, b33, b34, b35, b36) = (
        second
    )
    return (
        b11 * x1 + b14 * x2 + b15 * x3,
        b14 * x1 + b12 * x2 + b16 * x3,
        b15 * x1 + b16 * x2 + b13 * x3,
        b21 * x1 + b24 * x2 + b25 * x3,
        b24 * x1 + b22 * x2 + b26 * x3,
        b25 * x1 + b26 * x2 + b23 * x3,
        b31 * x1 + b34 * x2 + b35 * x3,
        b34 * x1 + b32 * x2 + b36 * x3,
        b35 * x1 + b36 * x2 + b33 * x3,
    )


def contract_row(row: Any, x1: Scalar, x2: Scalar, x3: Scalar) -> Twist:
    """C_ijkl x_l of one component's packed third derivatives, as packed second derivatives."""
    c111, c112, c113, c122, c123, c133, c222, c223, c233, c333 = row
    return (
        c111 * x1 + c112 * x2 + c113 * x3,
        c122 * x1 + c222 * x2 + c223 * x3,
        c133 * x1 + c233 * x2 + c333 * x3,
        c112 * x1 + c122 * x2 + c123 * x3,
        c113 * x1 + c123 * x2 + c133 * x3,
        c123 * x1 + c223 * x2 + c233 * x3,
    )


def contract_third(third: Any, x1: Scalar, x2: Scalar, x3: Scalar) -> Any:
    """C_ijkl x_l of packed third derivatives, as packed second derivatives (18 numbers)."""
    return (
        contract_row(third[0:10], x1, x2, x3)
        + contract_row(third[10:20], x1, x2, x3)
        + contract_row(third[20:30], x1, x2, x3)
    )


def laplacian(second: Any) -> Vector:
    """Lap u_i = B_ijj of packed second derivatives."""
    (b11, b12, b13, _, _, _, b21, b22, b23, _, _, _, b31, b32, b33, _, _, _) = second
    return b11 + b12 + b13, b21 + b22 + b23, b31 + b32 + b33


def laplacian_gradient(third: Any) -> Matrix:
    """Lap A_ij = C_ijkk of packed third derivatives, by rows."""
    c, e, g = third[0:10], third[10:20], third[20:30]
    return (
        c[0] + c[3] + c[5],
        c[1] + c[6] + c[8],
        c[2] + c[7] + c[9],
        e[0] + e[3] + e[5],
        e[1] + e[6] + e[8],
        e[2] + e[7] + e[9],
        g[0] + g[3] + g[5],
        g[1] + g[6] + g[8],
        g[2] + g[7] + g[9],
    )


def velocity_correction(d1: Scalar, d2: Scalar, d3: Scalar, second: Any, quadratic: Any) -> Vector:
    """The terms of the free velocity that second derivatives cause.

    q0 Lap u + q1 P + q2 d (d.Lap u) + q3 d (d.P) + q4 v with the matrix M_ij = B_ijk d_k,
    P = (d.grad)^2 u = M d and v = grad(d.(d.grad) u) = M^T d.
    """
    c0, c1, c2, c3, c4 = quadratic
    l1, l2, l3 = laplacian(second)
    m11, m12, m13, m21, m22, m23, m31, m32, m33 = contract(second, d1, d2, d3)
    p1 = m11 * d1 + m12 * d2 + m13 * d3
    p2 = m21 * d1 + m22 * d2 + m23 * d3
    p3 = m31 * d1 + m32 * d2 + m33 * d3
    along = c2 * (d1 * l1 + d2 * l2 + d3 * l3) + c3 * (d1 * p1 + d2 * p2 + d3 * p3)
    return (
        c0 * l1 + c1 * p1 + along * d1 + c4 * (m11 * d1 + m21 * d2 + m31 * d3),
        c0 * l2 + c1 * p2 + along * d2 + c4 * (m12 * d1 + m22 * d2 + m32 * d3),
        c0 * l3 + c1 * p3 + along * d3 + c4 * (m13 * d1 + m23 * d2 + m33 * d3),
    )


def free_motion_linear(
    x1: Scalar,
    x2: Scalar,
    x3: Scalar,
    d1: Scalar,
    d2: Scalar,
    d3: Scalar,
    flow: Any,
    law: Any,
) -> Twist:
    """Free velocity and angular velocity (space frame) in a flow of degree <= 1.

    U = u, Omega = w/2 + lambda d x (E d) (Jeffery, Proc. R. Soc. A 102, 1922, eq. 37 with
    lambda = (1 - k^2)/(1 + k^2); Bretherton, J. Fluid Mech. 14, 1962).
    """
    u1, u2, u3 = flow[1]
    a11, a12, a13, a21, a22, a23, a31, a32, a33 = flow[2]
    o1, o2, o3 = turning(d1, d2, d3, flow[2], 0.5, law[0])
    return (
        u1 + a11 * x1 + a12 * x2 + a13 * x3,
        u2 + a21 * x1 + a22 * x2 + a23 * x3,
        u3 + a31 * x1 + a32 * x2 + a33 * x3,
        o1,
        o2,
        o3,
    )


def velocity_and_gradient(x1: Scalar, x2: Scalar, x3: Scalar, flow: Any, m: Matrix) -> Any:
    """u (3) and A by rows (9) at x, from M = B x: u = v + (A0 + M/2) x, A = A0 + M."""
    u1, u2, u3 = flow[1]
    a11, a12, a13, a21, a22, a23, a31, a32, a33 = flow[2]
    m11, m12, m13, m21, m22, m23, m31, m32, m33 = m
    velocity = (
        u1 + (a11 + 0.5 * m11) * x1 + (a12 + 0.5 * m12) * x2 + (a13 + 0.5 * m13) * x3,
        u2 + (a21 + 0.5 * m21) * x1 + (a22 + 0.5 * m22) * x2 + (a23 + 0.5 * m23) * x3,
        u3 + (a31 + 0.5 * m31) * x1 + (a32 + 0.5 * m32) * x2 + (a33 + 0.5 * m33) * x3,
    )
    gradient = (
        a11 + m11,
        a12 + m12,
        a13 + m13,
        a21 + m21,
        a22 + m22,
        a23 + m23,
        a31 + m31,
        a32 + m32,
        a33 + m33,
    )
    return velocity, gradient


def add_third(
    x1: Scalar, x2: Scalar, x3: Scalar, velocity: Any, gradient: Any, second: Any, n: Any
) -> Any:
    """u, A and B at x from those of degree 2 and N = C x: they gain Nxx/6, Nx/2 and N."""
    u1, u2, u3 = velocity
    a11, a12, a13, a21, a22, a23, a31, a32, a33 = gradient
    b11, b12, b13, b14, b15, b16, b21, b22, b23, b24, b25, b26, b31, b32, b33, b34, b35, b36 = (
        second
    )
    n11, n12, n13, n14, n15, n16, n21, n22, n23, n24, n25, n26, n31, n32, n33, n34, n35, n36 = n
    m11, m12, m13, m21, m22, m23, m31, m32, m33 = contract(n, x1, x2, x3)
    c = 1.0 / 6.0
    velocity = (
        u1 + c * (m11 * x1 + m12 * x2 + m13 * x3),
        u2 + c * (m21 * x1 + m22 * x2 + m23 * x3),
        u3 + c * (m31 * x1 + m32 * x2 + m33 * x3),
    )
    gradient = (
        a11 + 0.5 * m11,
        a12 + 0.5 * m12,
        a13 + 0.5 * m13,
        a21 + 0.5 * m21,
        a22 + 0.5 * m22,
        a23 + 0.5 * m23,
        a31 + 0.5 * m31,
        a32 + 0.5 * m32,
        a33 + 0.5 * m33,
    )
    second = (
        b11 + n11,
        b12 + n12,
        b13 + n13,
        b14 + n14,
        b15 + n15,
        b16 + n16,
        b21 + n21,
        b22 + n22,
        b23 + n23,
        b24 + n24,
        b25 + n25,
        b26 + n26,
        b31 + n31,
        b32 + n32,
        b33 + n33,
        b34 + n34,
        b35 + n35,
        b36 + n36,
    )
    return velocity, gradient, second


def free_motion_quadratic(
    x1: Scalar,
    x2: Scalar,
    x3: Scalar,
    d1: Scalar,
    d2: Scalar,
    d3: Scalar,
    flow: Any,
    law: Any,
) -> Twist:
    """Free velocity and angular velocity (space frame) in a flow of degree 2.

    The law of `free_motion_linear` with u and A taken at the centre, plus `velocity_correction`
    (ellipsoid: Brenner, Chem. Eng. Sci. 19, 1964; Kim & Karrila, Microhydrodynamics, 1991, ch. 3;
    spheroid in a paraboloidal flow: Chwang, J. Fluid Mech. 72, 1975).
    """
    second = flow[3]
    m = contract(second, x1, x2, x3)
    (u1, u2, u3), gradient = velocity_and_gradient(x1, x2, x3, flow, m)
    v1, v2, v3 = velocity_correction(d1, d2, d3, second, law[1])
    o1, o2, o3 = turning(d1, d2, d3, gradient, 0.5, law[0])
    return u1 + v1, u2 + v2, u3 + v3, o1, o2, o3


def turning_correction(d1: Scalar, d2: Scalar, d3: Scalar, third: Any, cubic: Any) -> Vector:
    """The terms of the free angular velocity that third derivatives cause.

    c0 (d.grad)^2 w + c1 d (d.(d.grad)^2 w) + c2 d x ((Lap E) d) + c3 d x (((d.grad)^2 E) d), with
    the gradients T = (d.grad)^2 A and L = Lap A in the place of A.
    """
    c0, c1, c2, c3 = cubic
    t = contract(contract_third(third, d1, d2, d3), d1, d2, d3)
    lap = laplacian_gradient(third)
    o1, o2, o3 = turning(d1, d2, d3, t, c0, c3)
    p1, p2, p3 = turning(d1, d2, d3, lap, 0.0, c2)
    along = c1 * (d1 * (t[7] - t[5]) + d2 * (t[2] - t[6]) + d3 * (t[3] - t[1]))
    return o1 + p1 + along * d1, o2 + p2 + along * d2, o3 + p3 + along * d3


def free_motion_cubic(
    x1: Scalar,
    x2: Scalar,
    x3: Scalar,
    d1: Scalar,
    d2: Scalar,
    d3: Scalar,
    flow: Any,
    law: Any,
) -> Twist:
    """Free velocity and angular velocity (space frame) in a flow of degree 3.

    The law of `free_motion_quadratic` with B taken at the centre, plus `turning_correction`.
    """
    _, _, _, second0, third, _ = flow
    m, n = contract(second0, x1, x2, x3), contract_third(third, x1, x2, x3)
    velocity, gradient0 = velocity_and_gradient(x1, x2, x3, flow, m)
    (u1, u2, u3), gradient, second = add_third(x1, x2, x3, velocity, gradient0, second0, n)
    v1, v2, v3 = velocity_correction(d1, d2, d3, second, law[1])
    o1, o2, o3 = turning(d1, d2, d3, gradient, 0.5, law[0])
    p1, p2, p3 = turning_correction(d1, d2, d3, third, law[2])
    return u1 + v1, u2 + v2, u3 + v3, o1 + p1, o2 + p2, o3 + p3


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


def free_motion(
    x1: Scalar,
    x2: Scalar,
    x3: Scalar,
    d1: Scalar,
    d2: Scalar,
    d3: Scalar,
    flow: Any,
    law: Any,
) -> Twist:
    """Free velocity and angular velocity (space frame) in a polynomial flow.

    flow: (degree, velocity, gradient, second, third, origin), the derivatives taken at the origin;
    law: (linear, quadratic, cubic) Faxen coefficients.
    """
    o1, o2, o3 = flow[5]
    return free_motion_about(x1 - o1, x2 - o2, x3 - o3, d1, d2, d3, flow, law)


def free_motion_about(
    x1: Scalar,
    x2: Scalar,
    x3: Scalar,
    d1: Scalar,
    d2: Scalar,
    d3: Scalar,
    flow: Any,
    law: Any,
) -> Twist:
    """`free_motion` with x relative to the flow's origin: the law of its degree."""
    if flow[0] <= 1:
        return free_motion_linear(x1, x2, x3, d1, d2, d3, flow, law)
    if flow[0] == 2:
        return free_motion_quadratic(x1, x2, x3, d1, d2, d3, flow, law)
    return free_motion_cubic(x1, x2, x3, d1, d2, d3, flow, law)


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


# Loops over the bodies of a block, to be compiled (compiled.py). y and dydt: (n_state, n_bodies);
# table: (74,), the flow and the law as `tables` orders them; mobility: (4,); loads: (12, n_bodies)
# or None; rates: (4, n_bodies); jacobian: (n_bodies, n_state, n_state); follow: as in `inertial`.
# still: None, or centres (3, n_bodies) that stay at rest; y and dydt then hold q, and W, alone.
# The bodies pass through tiles of fixed size, whose rows the compiler knows not to overlap: it then
# works on several bodies at once. It may not reorder arithmetic, so that the numbers are those of
# the plain functions.

STEP = 1e-100
TILE = 64


def tables(table: Any) -> Any:
    """The flow and the law as `free_motion` takes them.

    Entry by entry, since the compiler makes no tuple of a slice.
    """
    t = table
    velocity = (t[1], t[2], t[3])
    gradient = (t[4], t[5], t[6], t[7], t[8], t[9], t[10], t[11], t[12])
    second = (
        t[13],
        t[14],
        t[15],
        t[16],
        t[17],
        t[18],
        t[19],
        t[20],
        t[21],
        t[22],
        t[23],
        t[24],
        t[25],
        t[26],
        t[27],
        t[28],
        t[29],
        t[30],
    )
    third = (
        t[31],
        t[32],
        t[33],
        t[34],
        t[35],
        t[36],
        t[37],
        t[38],
        t[39],
        t[40],
        t[41],
        t[42],
        t[43],
        t[44],
        t[45],
        t[46],
        t[47],
        t[48],
        t[49],
        t[50],
        t[51],
        t[52],
        t[53],
        t[54],
        t[55],
        t[56],
        t[57],
        t[58],
        t[59],
        t[60],
    )
    quadratic = (t[62], t[63], t[64], t[65], t[66])
    cubic = (t[67], t[68], t[69], t[70])
    origin = (t[71], t[72], t[73])
    return (int(t[0]), velocity, gradient, second, third, origin), (t[61], quadratic, cubic)


def copy_tile(source: Any, start: int, tile: Any, count: int) -> None:
    """Columns start to start + count of an array into a tile."""
    for i in range(source.shape[0]):
        for b in range(count):
            tile[i, b] = source[i, start + b]


def copy_back(tile: Any, target: Any, start: int, count: int) -> None:
    """A tile into columns start to start + count of an array."""
    for i in range(target.shape[0]):
        for b in range(count):
            target[i, start + b] = tile[i, b]


def column_of_loads(loads: Any, b: int) -> Any:
    """The loads of body b."""
    return (
        loads[0, b],
        loads[1, b],
        loads[2, b],
        loads[3, b],
        loads[4, b],
        loads[5, b],
        loads[6, b],
        loads[7, b],
        loads[8, b],
        loads[9, b],
        loads[10, b],
        loads[11, b],
    )


def massless_block(
    y: Any,
    dydt: Any,
    table: Any,
    mobility: Any,
    loads: Any,
    still: Any,
) -> None:
    """`massless` for every body of a block."""
    flow, law = tables(table)
    s, r, f = np.empty((7, TILE)), np.empty((7, TILE)), np.empty((12, TILE))
    first = 0 if still is None else 3
    for start in range(0, y.shape[1], TILE):
        count = min(TILE, y.shape[1] - start)
        if still is not None:
            copy_tile(still, start, s, count)
        copy_tile(y, start, s[first:], count)
        if loads is not None:
            copy_tile(loads, start, f, count)

        for b in range(count):
            rate = massless(
                s[0, b],
                s[1, b],
                s[2, b],
                s[3, b],
                s[4, b],
                s[5, b],
                s[6, b],
                flow,
                law,
                mobility,
                None if loads is None else column_of_loads(f, b),
            )
            for i in range(len(rate)):
                r[i, b] = rate[i]
        copy_back(r[first:], dydt, start, count)


def massless_jacobian_block(
    y: Any,
    jacobian: Any,
    table: Any,
    mobility: Any,
    loads: Any,
) -> None:
    """d`massless`/dy for every body of a block, one complex step per column."""
    flow, law = tables(table)
    s, r, f = np.empty((7, TILE)), np.empty((7, TILE)), np.empty((12, TILE))
    for start in range(0, y.shape[1], TILE):
        count = min(TILE, y.shape[1] - start)
        copy_tile(y, start, s, count)
        if loads is not None:
            copy_tile(loads, start, f, count)

        for j in range(7):
            for b in range(count):
                rate = massless(
                    complex(s[0, b], STEP if j == 0 else 0.0),
                    complex(s[1, b], STEP if j == 1 else 0.0),
                    complex(s[2, b], STEP if j == 2 else 0.0),
                    complex(s[3, b], STEP if j == 3 else 0.0),
                    complex(s[4, b], STEP if j == 4 else 0.0),
                    complex(s[5, b], STEP if j == 5 else 0.0),
                    complex(s[6, b], STEP if j == 6 else 0.0),
                    flow,
                    law,
                    mobility,
                    None if loads is None else column_of_loads(f, b),
                )
                for i in range(len(rate)):
                    r[i, b] = rate[i].imag / STEP
            for i in range(7):
                for b in range(count):
                    jacobian[start + b, i, j] = r[i, b]


def inertial_block(
    y: Any,
    dydt: Any,
    table: Any,
    mobility: Any,
    loads: Any,
    rates: Any,
    gyration: float,
    follow: Any,
    still: Any,
) -> None:
    """`inertial` for every body of a block."""
    flow, law = tables(table)
    s, r, f, p = (
        np.zeros((13, TILE)),
        np.empty((13, TILE)),
        np.empty((12, TILE)),
        np.empty((4, TILE)),
    )
    for start in range(0, y.shape[1], TILE):
        count = min(TILE, y.shape[1] - start)
        if still is None:
            copy_tile(y, start, s, count)
        else:
            copy_tile(still, start, s, count)
            copy_tile(y[:4], start, s[3:], count)
            copy_tile(y[4:], start, s[10:], count)
        if loads is not None:
            copy_tile(loads, start, f, count)
        copy_tile(rates, start, p, count)
        for b in range(count):
            rate = inertial(
                s[0, b],
                s[1, b],
                s[2, b],
                s[3, b],
                s[4, b],
                s[5, b],
                s[6, b],
                s[7, b],
                s[8, b],
                s[9, b],
                s[10, b],
                s[11, b],
                s[12, b],
                flow,
                law,
                mobility,
                None if loads is None else column_of_loads(f, b),
                (p[0, b], p[1, b], p[2, b], p[3, b]),
                gyration,
                follow,
            )
            for i in range(len(rate)):
                r[i, b] = rate[i]
        if still is None:
            copy_back(r, dydt, start, count)
        else:
            copy_back(r[3:7], dydt[:4], start, count)
            copy_back(r[10:], dydt[4:], start, count)


def inertial_jacobian_block(
    y: Any,
    jacobian: Any,
    table: Any,
    mobility: Any,
    loads: Any,
    rates: Any,
    gyration: float,
    follow: Any,
) -> None:
    """d`inertial`/dy for every body of a block, one complex step per column."""
    flow, law = tables(table)
    s, r, f, p = (
        np.empty((13, TILE)),
        np.empty((13, TILE)),
        np.empty((12, TILE)),
        np.empty((4, TILE)),
    )
    for start in range(0, y.shape[1], TILE):
        count = min(TILE, y.shape[1] - start)
        copy_tile(y, start, s, count)
        if loads is not None:
            copy_tile(loads, start, f, count)
        copy_tile(rates, start, p, count)
        for j in range(13):
            for b in range(count):
                rate = inertial(
                    complex(s[0, b], STEP if j == 0 else 0.0),
                    complex(s[1, b], STEP if j == 1 else 0.0),
                    complex(s[2, b], STEP if j == 2 else 0.0),
                    complex(s[3, b], STEP if j == 3 else 0.0),
                    complex(s[4, b], STEP if j == 4 else 0.0),
                    complex(s[5, b], STEP if j == 5 else 0.0),
                    complex(s[6, b], STEP if j == 6 else 0.0),
                    complex(s[7, b], STEP if j == 7 else 0.0),
                    complex(s[8, b], STEP if j == 8 else 0.0),
                    complex(s[9, b], STEP if j == 9 else 0.0),
                    complex(s[10, b], STEP if j == 10 else 0.0),
                    complex(s[11, b], STEP if j == 11 else 0.0),
                    complex(s[12, b], STEP if j == 12 else 0.0),
                    flow,
                    law,
                    mobility,
                    None if loads is None else column_of_loads(f, b),
                    (p[0, b], p[1, b], p[2, b], p[3, b]),
                    gyration,
                    follow,
                )
                for i in range(len(rate)):
                    r[i, b] = rate[i].imag / STEP
            for i in range(13):
                for b in range(count):
                    jacobian[start + b, i, j] = r[i, b]
