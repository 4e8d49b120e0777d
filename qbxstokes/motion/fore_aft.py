"""Kernels of a body of revolution with fore-aft symmetry, as scalar arithmetic (see `kernels`).

Its free velocity and angular velocity in a polynomial flow of degree <= 3 follow from the axis d
and the derivatives of the flow at the centre by few coefficients
(`bie.functional.FaxenCoefficients`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.motion.drag import accelerations, driven_motion
from qbxstokes.motion.frames import (
    body_axes,
    quaternion_rate_body,
    quaternion_rate_space,
    symmetry_axis,
)
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

if TYPE_CHECKING:
    from qbxstokes.bie.functional import BodyModel

# Numbers of a body, and how many of them the kernels of a degree read.
N_NUMBERS = 17
ROWS = {1: 7, 2: 12, 3: 17}


def pack_body(model: BodyModel, driven: bool) -> list[float]:
    """What the kernels need of a body, for `unpack_body`; its mobility is NaN unless driven."""
    law = model.faxen
    _, c1, c2, c3 = law.cubic
    drag = vars(model.resistance).values() if driven else (math.nan,) * 4
    j1, _, j3 = Spheroid(model.aspect_ratio).inertia.tolist()
    return [
        *(law.rest, law.linear),
        *(1.0 / value for value in drag),
        (j3 - j1) / j1,
        *law.quadratic,
        *(c1, law.rest_of_second, c3, 0.0 - 0.5 * abs(c2), c2),
    ]


def unpack_body(t: Any) -> Any:
    """The law, the mobility and the gyration: arguments of `massless` and `inertial`.

    law: (rest, linear) of `turning`, the five coefficients of second derivatives, and of third ones
    c1 with (rest, linear) for (d.grad)^2 A and for Lap A.
    """
    quadratic = (t[7], t[8], t[9], t[10], t[11])
    cubic = (t[12], (t[13], t[14]), (t[15], t[16]))
    return ((t[0], t[1]), quadratic, cubic), (t[2], t[3], t[4], t[5]), t[6]


def turning(
    d1: Scalar, d2: Scalar, d3: Scalar, gradient: Any, rest: Scalar, linear: Scalar
) -> Vector:
    """half * curl + linear * d x (E d) of a gradient A[i, j] given by rows, E = sym A.

    rest: half - |linear|/2. For a long body half and linear/2 are nearly equal, and for a flat one
    opposite, so that the two terms cancel wherever the axis lingers. With E d = A d - curl x d/2 =
    A^T d + curl x d/2 it is rest curl + linear d x (A d) + |linear|/2 d (d.curl), with A^T in the
    place of A for linear < 0, where nothing cancels (d is of unit length).
    """
    _, a12, a13, a21, _, a23, a31, a32, _ = gradient
    w1, w2, w3 = a32 - a23, a13 - a31, a21 - a12
    a11, a12, a13, a21, a22, a23, a31, a32, a33 = oriented(gradient, linear)
    along = 0.5 * abs(linear) * (d1 * w1 + d2 * w2 + d3 * w3)
    e1 = a11 * d1 + a12 * d2 + a13 * d3
    e2 = a21 * d1 + a22 * d2 + a23 * d3
    e3 = a31 * d1 + a32 * d2 + a33 * d3
    return (
        rest * w1 + linear * (d2 * e3 - d3 * e2) + along * d1,
        rest * w2 + linear * (d3 * e1 - d1 * e3) + along * d2,
        rest * w3 + linear * (d1 * e2 - d2 * e1) + along * d3,
    )


def oriented(gradient: Any, linear: Any) -> Any:
    """A gradient by rows, transposed where `linear` is negative."""
    if not isinstance(linear, np.ndarray):
        return oriented_by_number(gradient, linear)
    a11, a12, a13, a21, a22, a23, a31, a32, a33 = gradient
    flat = linear < 0.0
    return (
        a11,
        np.where(flat, a21, a12),
        np.where(flat, a31, a13),
        np.where(flat, a12, a21),
        a22,
        np.where(flat, a32, a23),
        np.where(flat, a13, a31),
        np.where(flat, a23, a32),
        a33,
    )


def oriented_by_number(gradient: Any, linear: float) -> Any:
    """`oriented` of one number, for the compiler: it makes selections of the branch."""
    a11, a12, a13, a21, a22, a23, a31, a32, a33 = gradient
    if linear < 0.0:
        a12, a13, a21, a23, a31, a32 = a21, a31, a12, a32, a13, a23
    return a11, a12, a13, a21, a22, a23, a31, a32, a33


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
    c1, of_second, of_laplacian = cubic
    t = contract(contract_third(third, d1, d2, d3), d1, d2, d3)
    lap = laplacian_gradient(third)
    o1, o2, o3 = turning(d1, d2, d3, t, *of_second)
    p1, p2, p3 = turning(d1, d2, d3, lap, *of_laplacian)
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
    o1, o2, o3 = turning(d1, d2, d3, flow[2], *law[0])
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
    o1, o2, o3 = turning(d1, d2, d3, gradient, *law[0])
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
    o1, o2, o3 = turning(d1, d2, d3, gradient, *law[0])
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
    law: as `unpack_body` gives it.
    """
    o1, o2, o3 = flow[5]
    return free_motion_about(x1 - o1, x2 - o2, x3 - o3, d1, d2, d3, flow, law)


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


def free(
    x1: Scalar,
    x2: Scalar,
    x3: Scalar,
    q0: Scalar,
    q1: Scalar,
    q2: Scalar,
    q3: Scalar,
    flow: Any,
    law: Any,
) -> Twist:
    """`free_motion` of a body at x and q."""
    d1, d2, d3 = symmetry_axis(q0, q1, q2, q3)
    return free_motion(x1, x2, x3, d1, d2, d3, flow, law)


def for_compiler(degree: int) -> dict[str, Callable[..., Any]]:
    """What takes the place of functions, by their names, for flows of one degree.

    A branch would keep the compiler from working on several lanes at once.
    """
    laws = {1: free_motion_linear, 2: free_motion_quadratic, 3: free_motion_cubic}
    return {"free_motion_about": laws[degree], "oriented": oriented_by_number}
