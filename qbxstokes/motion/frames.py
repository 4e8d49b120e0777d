"""Frames of a body and how they turn, as scalar arithmetic (see `kernels`)."""

from typing import Any

from qbxstokes.motion.taylor import Matrix, Scalar, Vector

Quaternion = tuple[Scalar, Scalar, Scalar, Scalar]


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
