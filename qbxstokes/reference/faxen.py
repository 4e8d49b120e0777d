"""Faxen laws of the ellipsoid: exact free motion, force and torque in any Stokes flow.

With semi-axes a_i, D^2 = sum a_i^2 d_i^2 (body axes) and the flow u taken at the centre
(H. Brenner 1964, Chem. Eng. Sci. 19, 703; S. Kim & S. J. Karrila 1991, Microhydrodynamics,
chapter 3),

    U = (sinh D/D) u = (1 + D^2/6 + ...) u,
    Omega = Jeffery's angular velocity of the gradient (3/D d/dD)(sinh D/D) grad u
          = the same of (1 + D^2/10 + ...) grad u.

The two operators are means: sinh D/D is the mean of u(a s) over the unit sphere of s, and
(3/D d/dD)(sinh D/D) the mean over the volume of the ellipsoid, so that by the divergence theorem
both need u on the surface alone. The semi-axes of a spheroid are (k, k, 1).
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.reference.jeffery import rotation_resistance
from qbxstokes.reference.lamb import translation_resistance
from qbxstokes.typing import Array


def body_coefficients(k: float) -> tuple[float, Array, Array]:
    """(lambda, q (5,), c (4,)): the laws above for a polynomial flow of degree <= 3.

    U     = u + q0 Lap u + q1 (d.grad)^2 u + q2 d (d.Lap u) + q3 d (d.(d.grad)^2 u)
              + q4 grad(d.(d.grad) u),
    Omega = w/2 + lambda d x (E d) + c0 (d.grad)^2 w + c1 d (d.(d.grad)^2 w)
              + c2 d x ((Lap E) d) + c3 d x (((d.grad)^2 E) d),
    d the axis, w = curl u, E = sym grad u. With D^2 = k^2 Lap + (1-k^2)(d.grad)^2 and Lap w = 0:
    lambda = (1-k^2)/(1+k^2), q = (k^2/6, (1-k^2)/6, 0, 0, 0),
    c = ((1-k^2)/20, 0, lambda k^2/10, lambda (1-k^2)/10).
    """
    square = k * k
    shape = (1.0 - square) / (1.0 + square)
    quadratic = np.array([square / 6.0, (1.0 - square) / 6.0, 0.0, 0.0, 0.0])
    second = shape / 10.0 * np.array([square, 1.0 - square])
    return shape, quadratic, np.array([(1.0 - square) / 20.0, 0.0, *second])


def resistance(k: float) -> tuple[float, float, float, float]:
    """Translation (transverse, axial) and rotation (transverse, axial) resistance."""
    return (*translation_resistance(k), *rotation_resistance(k))


def free_motion_polynomial(
    k: float,
    axis: ArrayLike,
    velocity: ArrayLike,
    gradient: ArrayLike,
    hessian: ArrayLike,
    third: ArrayLike,
) -> tuple[Array, Array]:
    """(U, Omega) (..., 3) of a free spheroid in a flow of degree <= 3, space frame.

    axis (..., 3), unit; derivatives of the flow at the centre with the derivative indices last:
    velocity (..., 3), gradient (..., 3, 3), hessian (..., 3, 3, 3), third (..., 3, 3, 3, 3).
    """
    d = np.asarray(axis, dtype=float)
    second = k * k * np.eye(3) + (1.0 - k * k) * d[..., :, None] * d[..., None, :]
    curved, cubic = np.asarray(hessian, dtype=float), np.asarray(third, dtype=float)
    mean_velocity = velocity + np.einsum("...jk,...ijk->...i", second, curved) / 6.0
    mean_gradient = gradient + np.einsum("...kl,...ijkl->...ij", second, cubic) / 10.0
    strain = 0.5 * (mean_gradient + np.swapaxes(mean_gradient, -1, -2))
    shape = (1.0 - k * k) / (1.0 + k * k)
    spin = shape * np.cross(d, np.einsum("...ij,...j->...i", strain, d))
    off = mean_gradient - np.swapaxes(mean_gradient, -1, -2)
    vorticity = np.stack([off[..., 2, 1], off[..., 0, 2], off[..., 1, 0]], axis=-1)
    return mean_velocity, 0.5 * vorticity + spin


def surface_means(
    semi_axes: ArrayLike,
    rotation: ArrayLike,
    centre: ArrayLike,
    velocity: Callable[[Array], Array],
    order: int = 40,
) -> tuple[Array, Array]:
    """Means of u and grad u that the Faxen laws need, from u on the surface.

    Returns ((sinh D/D) u (3,), (3/D d/dD)(sinh D/D) grad u (3, 3)), both in body components.
    semi_axes (3,); rotation R (3, 3), body to space; velocity: (n, 3) -> (n, 3) in space.
    (1/4pi) int u ds over the unit sphere s, x = R (a s), and
    (1/V) int u_i n_j dS = (3/4pi) int u_i s_j/a_j ds; Gauss-Legendre nodes in s_3 (`order`) and
    the trapezoid rule (2 `order`) round it. Exact to rounding for a polynomial flow; otherwise
    the error falls exponentially with `order`.
    """
    axes = np.asarray(semi_axes, dtype=float)
    turn = np.asarray(rotation, dtype=float)
    height, weight = np.polynomial.legendre.leggauss(order)
    angle = np.pi / order * (np.arange(2 * order) + 0.5)
    radius = np.sqrt(1.0 - height**2)
    around = np.outer(radius, np.cos(angle)), np.outer(radius, np.sin(angle))
    sphere = np.stack([*around, np.repeat(height[:, None], 2 * order, axis=1)], axis=-1)
    sphere = sphere.reshape(-1, 3)
    measure = np.repeat(weight / (4.0 * order), 2 * order)
    u = velocity(np.asarray(centre, dtype=float) + (sphere * axes) @ turn.T) @ turn
    mean_gradient: Array = 3.0 * (u * measure[:, None]).T @ (sphere / axes)
    return measure @ u, mean_gradient


def free_motion(
    k: ArrayLike,
    rotation: ArrayLike,
    centre: ArrayLike,
    velocity: Callable[[Array], Array],
    order: int = 40,
) -> tuple[Array, Array]:
    """(U, Omega) (3,) in space of a free spheroid in any flow; arguments as `surface_means`.

    k may be the semi-axes (3,) of a triaxial ellipsoid.
    Omega_1 = (b^2 A_32 - c^2 A_23)/(b^2 + c^2) and cyclic (Jeffery 1922).
    """
    turn = np.asarray(rotation, dtype=float)
    axes = np.asarray(k if np.ndim(k) else (k, k, 1.0), dtype=float)
    mean, gradient = surface_means(axes, turn, centre, velocity, order)
    a, b, c = axes**2
    omega = [
        (b * gradient[2, 1] - c * gradient[1, 2]) / (b + c),
        (c * gradient[0, 2] - a * gradient[2, 0]) / (c + a),
        (a * gradient[1, 0] - b * gradient[0, 1]) / (a + b),
    ]
    return turn @ mean, turn @ omega


def fixed_force_torque(
    k: float,
    rotation: ArrayLike,
    centre: ArrayLike,
    velocity: Callable[[Array], Array],
    order: int = 40,
) -> tuple[Array, Array]:
    """(F, M) (3,) in space on a spheroid held fixed in any flow: F = R U_free, M = R Omega_free."""
    turn = np.asarray(rotation, dtype=float)
    speed, spin = free_motion(k, turn, centre, velocity, order)
    across, along, turning, spinning = resistance(k)
    force = turn @ (np.array([across, across, along]) * (turn.T @ speed))
    return force, turn @ (np.array([turning, turning, spinning]) * (turn.T @ spin))
