"""A polynomial flow and its derivatives at a point, as scalar arithmetic (see `kernels`).

Derivatives come packed, symmetric indices once: velocity u_i, gradient A_ij by rows, second =
(d_j d_k u_i for jk = 11 22 33 12 13 23, by i), third = (d_j d_k d_l u_i for 111 112 113 122 123 133
222 223 233 333, by i), at the flow's origin.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from qbxstokes.flows.polynomial import PolynomialFlow

# float, complex or a NumPy row of either; numba infers its own types.
Scalar = Any
Vector = tuple[Scalar, Scalar, Scalar]
Matrix = tuple[Scalar, Scalar, Scalar, Scalar, Scalar, Scalar, Scalar, Scalar, Scalar]
Twist = tuple[Scalar, Scalar, Scalar, Scalar, Scalar, Scalar]
Array = NDArray[np.float64]

# Numbers of a flow, and how many of them the kernels of a degree read.
N_FLOW = 64
ROWS = {1: 16, 2: 34, 3: 64}

_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
_TRIPLES = (
    *((0, 0, 0), (0, 0, 1), (0, 0, 2), (0, 1, 1), (0, 1, 2)),
    *((0, 2, 2), (1, 1, 1), (1, 1, 2), (1, 2, 2), (2, 2, 2)),
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


def pack_flow(flow: PolynomialFlow) -> Array:
    """A flow as the numbers (64,) that `unpack_flow` reads: a lower degree needs fewer (`ROWS`)."""
    second = [flow.hessian[i, j, k] for i in range(3) for j, k in _PAIRS]
    third = [flow.third[i, j, k, m] for i in range(3) for j, k, m in _TRIPLES]
    degree = [max(flow.degree or 0, 1)]
    parts = degree, flow.origin, flow.value, flow.gradient_tensor.ravel(), second, third
    return np.concatenate(parts)


def unpack_linear(t: Any) -> Any:
    """(degree, velocity, gradient, second, third, origin) of the numbers of a flow of degree 1.

    Entry by entry, since the compiler makes no tuple of a slice.
    """
    velocity = (t[4], t[5], t[6])
    gradient = (t[7], t[8], t[9], t[10], t[11], t[12], t[13], t[14], t[15])
    return int(t[0]), velocity, gradient, None, None, (t[1], t[2], t[3])


def unpack_quadratic(t: Any) -> Any:
    """The same of degree 2."""
    degree, velocity, gradient, _, _, origin = unpack_linear(t)
    second = (
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
        t[31],
        t[32],
        t[33],
    )
    return degree, velocity, gradient, second, None, origin


def unpack_flow(t: Any) -> Any:
    """The same of any degree."""
    degree, velocity, gradient, second, _, origin = unpack_quadratic(t)
    third = (
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
        t[61],
        t[62],
        t[63],
    )
    return degree, velocity, gradient, second, third, origin


# What the kernels of a degree need of a flow.
UNPACK = {1: unpack_linear, 2: unpack_quadratic, 3: unpack_flow}
