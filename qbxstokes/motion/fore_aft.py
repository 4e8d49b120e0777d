"""Kernels of a body of revolution with fore-aft symmetry, as scalar arithmetic (see `taylor`).

Its free velocity and angular velocity in a polynomial flow of degree <= 3 follow from the axis d
and the derivatives of the flow at the centre by few coefficients
(`bie.functional.FaxenCoefficients`). Drag acts along and across the axis, on translation and
rotation apart.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from qbxstokes.bie.functional import BodyModel
from qbxstokes.motion.taylor import (
    Matrix,
    Scalar,
    Twist,
    Vector,
    add,
    add_third,
    body_axes,
    contract,
    contract_third,
    curl,
    dot,
    laplacian,
    laplacian_gradient,
    linear_velocity,
    product,
    quaternion_rate_body,
    quaternion_rate_space,
    symmetry_axis,
    transposed,
    velocity_and_gradient,
)

# Numbers of a body, and how many of them the kernels of a degree read.
N_NUMBERS = 17
ROWS = {1: 7, 2: 12, 3: 17}


def pack_body(model: BodyModel, driven: bool) -> list[float]:
    """What the kernels need of a body, for `unpack_body`; its mobility is NaN unless driven."""
    law = model.faxen
    _, c1, c2, c3 = law.cubic
    drag = vars(model.resistance).values() if driven else (math.nan,) * 4
    j1, _, j3 = model.shape.inertia.tolist()
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


def turning(d: Any, gradient: Any, rest: Scalar, linear: Scalar) -> Vector:
    """half * curl + linear * d x (E d) of a gradient A[i, j] given by rows, E = sym A.

    rest: half - |linear|/2. For a long body half and linear/2 are nearly equal, and for a flat one
    opposite, so that the two terms cancel wherever the axis lingers. With E d = A d - curl x d/2 =
    A^T d + curl x d/2 it is rest curl + linear d x (A d) + |linear|/2 d (d.curl), with A^T in the
    place of A for linear < 0, where nothing cancels (d is of unit length).
    """
    d1, d2, d3 = d
    w1, w2, w3 = curl(gradient)
    along = 0.5 * abs(linear) * (d1 * w1 + d2 * w2 + d3 * w3)
    e1, e2, e3 = product(oriented(gradient, linear), d)
    return (
        rest * w1 + linear * (d2 * e3 - d3 * e2) + along * d1,
        rest * w2 + linear * (d3 * e1 - d1 * e3) + along * d2,
        rest * w3 + linear * (d1 * e2 - d2 * e1) + along * d3,
    )


def oriented(gradient: Any, linear: Any) -> Any:
    """A gradient by rows, transposed where `linear` is negative."""
    if not isinstance(linear, np.ndarray):
        return oriented_by_number(gradient, linear)
    pairs = zip(transposed(gradient), gradient, strict=True)
    return tuple(np.where(linear < 0.0, one, other) for one, other in pairs)


def oriented_by_number(gradient: Any, linear: float) -> Any:
    """`oriented` of one number, for the compiler: it makes selections of the branch."""
    return transposed(gradient) if linear < 0.0 else gradient


def velocity_correction(d: Any, second: Any, quadratic: Any) -> Vector:
    """The terms of the free velocity that second derivatives cause.

    q0 Lap u + q1 P + q2 d (d.Lap u) + q3 d (d.P) + q4 v with the matrix M_ij = B_ijk d_k,
    P = (d.grad)^2 u = M d and v = grad(d.(d.grad) u) = M^T d.
    """
    c0, c1, c2, c3, c4 = quadratic
    d1, d2, d3 = d
    l1, l2, l3 = laplacian(second)
    m = contract(second, d)
    p1, p2, p3 = product(m, d)
    v1, v2, v3 = product(transposed(m), d)
    along = c2 * (d1 * l1 + d2 * l2 + d3 * l3) + c3 * (d1 * p1 + d2 * p2 + d3 * p3)
    return (
        c0 * l1 + c1 * p1 + along * d1 + c4 * v1,
        c0 * l2 + c1 * p2 + along * d2 + c4 * v2,
        c0 * l3 + c1 * p3 + along * d3 + c4 * v3,
    )


def turning_correction(d: Any, third: Any, cubic: Any) -> Vector:
    """The terms of the free angular velocity that third derivatives cause.

    c0 (d.grad)^2 w + c1 d (d.(d.grad)^2 w) + c2 d x ((Lap E) d) + c3 d x (((d.grad)^2 E) d), with
    the gradients T = (d.grad)^2 A and L = Lap A in the place of A.
    """
    c1, of_second, of_laplacian = cubic
    d1, d2, d3 = d
    t = contract(contract_third(third, d), d)
    o1, o2, o3 = turning(d, t, *of_second)
    p1, p2, p3 = turning(d, laplacian_gradient(third), *of_laplacian)
    along = c1 * dot(d, curl(t))
    return o1 + p1 + along * d1, o2 + p2 + along * d2, o3 + p3 + along * d3


def free_motion_linear(x: Any, d: Any, flow: Any, law: Any) -> Twist:
    """Free velocity and angular velocity (space frame) in a flow of degree <= 1.

    U = u, Omega = w/2 + lambda d x (E d) (Jeffery, Proc. R. Soc. A 102, 1922, eq. 37 with
    lambda = (1 - k^2)/(1 + k^2); Bretherton, J. Fluid Mech. 14, 1962).
    """
    return linear_velocity(flow[1], flow[2], x) + turning(d, flow[2], *law[0])


def free_motion_quadratic(x: Any, d: Any, flow: Any, law: Any) -> Twist:
    """Free velocity and angular velocity (space frame) in a flow of degree 2.

    The law of `free_motion_linear` with u and A taken at the centre, plus `velocity_correction`
    (ellipsoid: Brenner, Chem. Eng. Sci. 19, 1964; Kim & Karrila, Microhydrodynamics, 1991, ch. 3;
    spheroid in a paraboloidal flow: Chwang, J. Fluid Mech. 72, 1975).
    """
    second = flow[3]
    velocity, gradient = velocity_and_gradient(x, flow, contract(second, x))
    corrected = add(velocity, velocity_correction(d, second, law[1]), 1.0)
    return corrected + turning(d, gradient, *law[0])


def free_motion_cubic(x: Any, d: Any, flow: Any, law: Any) -> Twist:
    """Free velocity and angular velocity (space frame) in a flow of degree 3.

    The law of `free_motion_quadratic` with B taken at the centre, plus `turning_correction`.
    """
    _, _, _, second0, third, _ = flow
    velocity0, gradient0 = velocity_and_gradient(x, flow, contract(second0, x))
    n = contract_third(third, x)
    velocity, gradient, second = add_third(x, velocity0, gradient0, second0, n)
    corrected = add(velocity, velocity_correction(d, second, law[1]), 1.0)
    turns = turning(d, gradient, *law[0])
    return corrected + add(turns, turning_correction(d, third, law[2]), 1.0)


def free_motion_about(x: Any, d: Any, flow: Any, law: Any) -> Twist:
    """`free_motion` with x relative to the flow's origin: the law of its degree."""
    if flow[0] <= 1:
        return free_motion_linear(x, d, flow, law)
    if flow[0] == 2:
        return free_motion_quadratic(x, d, flow, law)
    return free_motion_cubic(x, d, flow, law)


def free_motion(x: Any, d: Any, flow: Any, law: Any) -> Twist:
    """Free velocity and angular velocity (space frame) in a polynomial flow.

    flow: (degree, velocity, gradient, second, third, origin), the derivatives taken at the origin;
    law: as `unpack_body` gives it.
    """
    x1, x2, x3 = x
    o1, o2, o3 = flow[5]
    return free_motion_about((x1 - o1, x2 - o2, x3 - o3), d, flow, law)


def free(y: Any, flow: Any, law: Any) -> Twist:
    """`free_motion` of a body in the state y."""
    return free_motion(y[0:3], symmetry_axis(y[3:7]), flow, law)


def pushed(u: Any, space: Any, body: Any, axes: Matrix, transverse: Any, axial: Any) -> Vector:
    """u + R^-1 (F + G) of a force fixed in space and one fixed in the body."""
    u1, u2, u3 = u
    f1, f2, f3 = space
    g1, g2, g3 = body
    a1, a2, a3, b1, b2, b3, d1, d2, d3 = axes
    f1 = f1 + a1 * g1 + b1 * g2 + d1 * g3
    f2 = f2 + a2 * g1 + b2 * g2 + d2 * g3
    f3 = f3 + a3 * g1 + b3 * g2 + d3 * g3
    f = (axial - transverse) * (f1 * d1 + f2 * d2 + f3 * d3)
    return (
        u1 + transverse * f1 + f * d1,
        u2 + transverse * f2 + f * d2,
        u3 + transverse * f3 + f * d3,
    )


def driven_motion(motion: Twist, axes: Matrix, mobility: Any, loads: Any) -> Twist:
    """Motion at which the hydrodynamic force balances the loads: U + R^-1 F, Omega + R^-1 M.

    mobility: the inverse resistances (translation transverse, axial, rotation transverse, axial).
    loads: force fixed in space, force fixed in the body, torque fixed in space, torque fixed in
    the body (12 numbers). The drag is linear, so that a body with inertia relaxes towards this
    motion and not towards the free one: the loads enter nowhere else.
    """
    f1, f2, f3, g1, g2, g3, m1, m2, m3, n1, n2, n3 = loads
    mt, ma, nt, na = mobility
    move = pushed(motion[0:3], (f1, f2, f3), (g1, g2, g3), axes, mt, ma)
    return move + pushed(motion[3:6], (m1, m2, m3), (n1, n2, n3), axes, nt, na)


def accelerations(
    v: Any, w: Any, motion: Twist, axes: Matrix, rates: Any, gyration: float
) -> Twist:
    """dV/dt (space) and dW/dt (body) of a body that drag pulls towards `motion`.

    dV/dt = R_t (U - V)/(St Theta); dW/dt = J^-1 (R_r (R^T Omega - W)/St - W x (J W)).
    rates: R_t/(St Theta) transverse and axial, R_r/(St J) transverse and axial.
    gyration: (J3 - J1)/J1, which is (k^2 - 1)/(k^2 + 1) for a uniform spheroid.
    """
    w1, w2, w3 = w
    omega = motion[3:6]
    d1, d2, d3 = axes[6:9]
    at, aa, bt, ba = rates
    e1, e2, e3 = motion[0] - v[0], motion[1] - v[1], motion[2] - v[2]
    along = (aa - at) * (e1 * d1 + e2 * d2 + e3 * d3)
    spin = gyration * w3
    return (
        at * e1 + along * d1,
        at * e2 + along * d2,
        at * e3 + along * d3,
        bt * (dot(axes[0:3], omega) - w1) - spin * w2,
        bt * (dot(axes[3:6], omega) - w2) + spin * w1,
        ba * (dot(axes[6:9], omega) - w3),
    )


def massless(y: Any, flow: Any, law: Any, mobility: Any, loads: Any) -> Any:
    """dy/dt of a body without inertia, y = (x, q): drag balances the loads at every instant.

    loads: as in `driven_motion`, or None for none.
    """
    x, q = y[0:3], y[3:7]
    if loads is not None:
        axes = body_axes(q)
        motion = driven_motion(free_motion(x, axes[6:9], flow, law), axes, mobility, loads)
    else:
        motion = free_motion(x, symmetry_axis(q), flow, law)
    return motion[0:3] + quaternion_rate_space(q, motion[3:6])


def inertial(
    y: Any, flow: Any, law: Any, mobility: Any, loads: Any, rates: Any, gyration: float, follow: Any
) -> Any:
    """dy/dt of a body with inertia, y = (x, q, V, W): see `accelerations`.

    loads: as in `driven_motion`, or None for none. follow: None, or two factors, 1 for a
    translation (rotation) without inertia: it moves with `motion` at every instant, and its part
    of the state, with its `rates`, is zero.
    """
    q, w = y[3:7], y[10:13]
    v1, v2, v3 = y[7:10]
    axes = body_axes(q)
    motion = free_motion(y[0:3], axes[6:9], flow, law)
    if loads is not None:
        motion = driven_motion(motion, axes, mobility, loads)
    r0, r1, r2, r3 = quaternion_rate_body(q, w)
    pull = accelerations(y[7:10], w, motion, axes, rates, gyration)
    if follow is not None:
        u1, u2, u3, _, _, _ = motion
        move, turn = follow
        g0, g1, g2, g3 = quaternion_rate_space(q, motion[3:6])
        v1, v2, v3 = v1 + move * (u1 - v1), v2 + move * (u2 - v2), v3 + move * (u3 - v3)
        r0, r1 = r0 + turn * (g0 - r0), r1 + turn * (g1 - r1)
        r2, r3 = r2 + turn * (g2 - r2), r3 + turn * (g3 - r3)
    moves, turns = (v1, v2, v3), (r0, r1, r2, r3)
    return moves + turns + pull


def for_compiler(degree: int) -> dict[str, Callable[..., Any]]:
    """What takes the place of functions, by their names, for flows of one degree.

    A branch would keep the compiler from working on several lanes at once.
    """
    laws = {1: free_motion_linear, 2: free_motion_quadratic, 3: free_motion_cubic}
    return {"free_motion_about": laws[degree], "oriented": oriented_by_number}
