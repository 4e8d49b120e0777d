"""The equations of motion as scalar arithmetic: a polynomial flow at a point, frames that turn.

Every function here and of the modules that `lanes.KERNELS` lists takes and returns plain numbers
and uses +, -, *, / alone. The same source therefore runs in many ways: on Python floats, on NumPy
rows (one entry per lane), recorded and written out for the constants of a scene (tracing.py:
one body, nothing to load), compiled by numba over a block (loops.py, compiled.py), and on complex
numbers, which makes the Jacobian exact to rounding: Im f(y + i h e)/h has no subtraction, so that h
may be 1e-100 (Squire & Trapp, SIAM Rev. 40, 1998).

The state of a body is that of `layout`: x, q and, for St > 0, V and W. The right-hand side does not
see the length of q: R(q) is divided by |q|^2, so that f is homogeneous in q, a Runge-Kutta step
commutes with scaling q, and q may be scaled to unit length at any time without any effect on the
orbit.

Derivatives come packed, symmetric indices once: velocity u_i, gradient A_ij by rows, second =
(d_j d_k u_i for jk = 11 22 33 12 13 23, by i), third = (d_j d_k d_l u_i for 111 112 113 122 123 133
222 223 233 333, by i), at the flow's origin.
"""

from typing import Any

import numpy as np

from qbxstokes.flows.changing import ChangingFlow
from qbxstokes.flows.polynomial import PolynomialFlow
from qbxstokes.flows.recognition import PAIRS, TRIPLES
from qbxstokes.typing import Array

# float, complex or a NumPy row of either; numba infers its own types.
Scalar = Any
Vector = tuple[Scalar, Scalar, Scalar]
Matrix = tuple[Scalar, Scalar, Scalar, Scalar, Scalar, Scalar, Scalar, Scalar, Scalar]
Quaternion = tuple[Scalar, Scalar, Scalar, Scalar]
Twist = tuple[Scalar, Scalar, Scalar, Scalar, Scalar, Scalar]

STEP = 1e-100  # h of the complex steps
# Numbers of a flow, and how many of them the kernels of a degree read.
N_FLOW = 64
ROWS = {1: 16, 2: 34, 3: 64}


def three(t: Any, i: int) -> Vector:
    """Numbers i to i + 3, for the compiler, which makes no tuple of a slice of an array."""
    return t[i], t[i + 1], t[i + 2]


def six(t: Any, i: int) -> Twist:
    """Numbers i to i + 6."""
    return t[i], t[i + 1], t[i + 2], t[i + 3], t[i + 4], t[i + 5]


def dot(a: Any, b: Any) -> Scalar:
    """a.b"""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def product(m: Matrix, x: Any) -> Vector:
    """M x."""
    return dot(m[0:3], x), dot(m[3:6], x), dot(m[6:9], x)


def transposed(m: Matrix) -> Matrix:
    """M^T."""
    return m[0], m[3], m[6], m[1], m[4], m[7], m[2], m[5], m[8]


def curl(gradient: Matrix) -> Vector:
    """Curl of a vector with this gradient."""
    _, a12, a13, a21, _, a23, a31, a32, _ = gradient
    return a32 - a23, a13 - a31, a21 - a12


def add(a: Any, b: Any, c: float) -> Vector:
    """a + c b of vectors."""
    return a[0] + c * b[0], a[1] + c * b[1], a[2] + c * b[2]


def add_matrix(a: Any, b: Any, c: float) -> Matrix:
    """a + c b of matrices."""
    return add(a[0:3], b[0:3], c) + add(a[3:6], b[3:6], c) + add(a[6:9], b[6:9], c)


def linear_velocity(u: Any, a: Matrix, x: Any) -> Vector:
    """u + A x."""
    x1, x2, x3 = x
    return (
        u[0] + a[0] * x1 + a[1] * x2 + a[2] * x3,
        u[1] + a[3] * x1 + a[4] * x2 + a[5] * x3,
        u[2] + a[6] * x1 + a[7] * x2 + a[8] * x3,
    )


def contract_row(row: Any, x: Any) -> Vector:
    """B_jk x_k of one component's packed second derivatives."""
    b11, b22, b33, b12, b13, b23 = row
    return dot((b11, b12, b13), x), dot((b12, b22, b23), x), dot((b13, b23, b33), x)


def contract(second: Any, x: Any) -> Matrix:
    """B_ijk x_k of packed second derivatives, by rows."""
    return (
        contract_row(second[0:6], x)
        + contract_row(second[6:12], x)
        + contract_row(second[12:18], x)
    )


def contract_third_row(row: Any, x: Any) -> Twist:
    """C_jkl x_l of one component's packed third derivatives, as packed second derivatives."""
    c111, c112, c113, c122, c123, c133, c222, c223, c233, c333 = row
    return (
        dot((c111, c112, c113), x),
        dot((c122, c222, c223), x),
        dot((c133, c233, c333), x),
        dot((c112, c122, c123), x),
        dot((c113, c123, c133), x),
        dot((c123, c223, c233), x),
    )


def contract_third(third: Any, x: Any) -> Any:
    """C_ijkl x_l of packed third derivatives, as packed second derivatives (18 numbers)."""
    return (
        contract_third_row(third[0:10], x)
        + contract_third_row(third[10:20], x)
        + contract_third_row(third[20:30], x)
    )


def laplacian(b: Any) -> Vector:
    """Lap u_i = B_ijj of packed second derivatives."""
    return b[0] + b[1] + b[2], b[6] + b[7] + b[8], b[12] + b[13] + b[14]


def laplacian_row(c: Any) -> Vector:
    """C_jkk of one component's packed third derivatives."""
    return c[0] + c[3] + c[5], c[1] + c[6] + c[8], c[2] + c[7] + c[9]


def laplacian_gradient(third: Any) -> Matrix:
    """Lap A_ij = C_ijkk of packed third derivatives, by rows."""
    return laplacian_row(third[0:10]) + laplacian_row(third[10:20]) + laplacian_row(third[20:30])


def velocity_and_gradient(x: Any, flow: Any, m: Matrix) -> Any:
    """u (3) and A by rows (9) at x, from M = B x: u = v + (A0 + M/2) x, A = A0 + M."""
    velocity = linear_velocity(flow[1], add_matrix(flow[2], m, 0.5), x)
    return velocity, add_matrix(flow[2], m, 1.0)


def add_third(x: Any, velocity: Any, gradient: Any, second: Any, n: Any) -> Any:
    """u, A and B at x from those of degree 2 and N = C x: they gain Nxx/6, Nx/2 and N."""
    m = contract(n, x)
    second = add_matrix(second[0:9], n[0:9], 1.0) + add_matrix(second[9:18], n[9:18], 1.0)
    return add(velocity, product(m, x), 1.0 / 6.0), add_matrix(gradient, m, 0.5), second


def pack_second(second: Array) -> Array:
    """Second derivatives (..., i, j, k) = d_j d_k u_i as the kernels take them, (..., 18)."""
    rows, columns = np.array(PAIRS).T
    return second[..., rows, columns].reshape(*second.shape[:-3], 18)


def pack_flow(flow: PolynomialFlow | ChangingFlow) -> Array:
    """A flow as the numbers (64,) that `unpack_flow` reads: a lower degree needs fewer (`ROWS`).

    One that changes is taken at t = 0.
    """
    degree = [max(flow.degree or 0, 1)]
    if isinstance(flow, ChangingFlow):
        flow = flow.at(0.0)
    second = pack_second(flow.hessian)
    third = [flow.third[i, j, k, m] for i in range(3) for j, k, m in TRIPLES]
    parts = degree, flow.origin, flow.value, flow.gradient_tensor.ravel(), second, third
    return np.concatenate(parts)


def unpack_linear(t: Any) -> Any:
    """(degree, velocity, gradient, second, third, origin) of the numbers of a flow of degree 1."""
    gradient = three(t, 7) + three(t, 10) + three(t, 13)
    return int(t[0]), three(t, 4), gradient, None, None, three(t, 1)


def unpack_quadratic(t: Any) -> Any:
    """The same of degree 2."""
    degree, velocity, gradient, _, _, origin = unpack_linear(t)
    second = six(t, 16) + six(t, 22) + six(t, 28)
    return degree, velocity, gradient, second, None, origin


def unpack_flow(t: Any) -> Any:
    """The same of any degree."""
    degree, velocity, gradient, second, _, origin = unpack_quadratic(t)
    third = six(t, 34) + six(t, 40) + six(t, 46) + six(t, 52) + six(t, 58)
    return degree, velocity, gradient, second, third, origin


# What the kernels of a degree need of a flow.
UNPACK = {1: unpack_linear, 2: unpack_quadratic, 3: unpack_flow}


# -- frames of a body and how they turn -----------------------------------------------------------


def body_axes(q: Any) -> Matrix:
    """Columns D1, D2, D3 of R(q), in this order, for a quaternion of any length."""
    q0, q1, q2, q3 = q
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


def symmetry_axis(q: Any) -> Vector:
    """D3 alone, for a quaternion of any length."""
    q0, q1, q2, q3 = q
    a, b, c, d = q0 * q0, q1 * q1, q2 * q2, q3 * q3
    s = 1.0 / (a + b + c + d)
    t = s + s
    return t * (q1 * q3 + q0 * q2), t * (q2 * q3 - q0 * q1), s * (a - b - c + d)


def quaternion_rate_space(q: Any, omega: Any) -> Quaternion:
    """dq/dt = (0, Omega) * q / 2 with Omega in the space frame."""
    q0, q1, q2, q3 = q
    o1, o2, o3 = omega
    return (
        -0.5 * (o1 * q1 + o2 * q2 + o3 * q3),
        0.5 * (o1 * q0 + o2 * q3 - o3 * q2),
        0.5 * (o2 * q0 + o3 * q1 - o1 * q3),
        0.5 * (o3 * q0 + o1 * q2 - o2 * q1),
    )


def quaternion_rate_body(q: Any, w: Any) -> Quaternion:
    """dq/dt = q * (0, W) / 2 with W in the body frame."""
    q0, q1, q2, q3 = q
    w1, w2, w3 = w
    return (
        -0.5 * (q1 * w1 + q2 * w2 + q3 * w3),
        0.5 * (q0 * w1 + q2 * w3 - q3 * w2),
        0.5 * (q0 * w2 + q3 * w1 - q1 * w3),
        0.5 * (q0 * w3 + q1 * w2 - q2 * w1),
    )
