"""The free motion of a body of revolution with fore-aft symmetry, as scalar arithmetic.

Free velocity and angular velocity in a polynomial flow of degree <= 3 follow from the axis d and
the derivatives of the flow at the centre by few coefficients (see `bie.functional`). The functions
take and return plain numbers, as all of `kernels`.
"""

from __future__ import annotations

from typing import Any

from qbxstokes.motion.taylor import (
    Scalar,
    Twist,
    Vector,
    add_third,
    contract,
    contract_third,
    laplacian,
    laplacian_gradient,
    velocity_and_gradient,
)


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
