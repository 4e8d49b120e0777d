"""Motion of a spheroid with (and without) inertia from closed forms and an independent integrator.

The force and torque are those of Jeffery, Lamb and Chwang; the equations

    dq/dt = q (0, Omega)/2,   dV/dt = F/(St Theta),   dOmega/dt = J^-1 (M/St - Omega x (J Omega))

(body frame Omega; Bagge 2015, eqs. 3.26-3.29, 3.46-3.48) are integrated by scipy's DOP853, so
that nothing is shared with the program that they verify.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.reference import chwang, jeffery, lamb
from qbxstokes.typing import Array

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class RotationSolution:
    """times (T,), orientation (T, 4) unit quaternion, angular_velocity (T, 3) body frame."""

    times: Array
    orientation: Array
    angular_velocity: Array


@dataclass(frozen=True)
class PlaneSolution:
    """Motion in the plane x3 = 0 with theta = pi/2, psi = 0.

    times (T,), position (T, 2), velocity (T, 2) in space, phi (T,), phi_rate (T,).
    """

    times: Array
    position: Array
    velocity: Array
    phi: Array
    phi_rate: Array


def inertia(k: float) -> Array:
    """Moments of inertia (3,): (4 pi/15) k^2 (k^2+1, k^2+1, 2 k^2), density one."""
    square = k * k
    shape = np.array([square + 1.0, square + 1.0, 2.0 * square])
    return np.asarray(4.0 * np.pi / 15.0 * square * shape)


def volume(k: float) -> float:
    """Volume 4 pi k^2/3."""
    return 4.0 * np.pi * k * k / 3.0


# The rates below are plain arithmetic on numbers, a tenth of the time of NumPy's on so few of them.


def _axes(q: Sequence[float]) -> tuple[Triple, Triple, Triple]:
    """D1, D2, D3 in space of a quaternion of any length but zero (it is normalised)."""
    s, x, y, z = q
    n = 2.0 / (s * s + x * x + y * y + z * z)
    return (
        (1.0 - n * (y * y + z * z), n * (x * y + s * z), n * (x * z - s * y)),
        (n * (x * y - s * z), 1.0 - n * (x * x + z * z), n * (y * z + s * x)),
        (n * (x * z + s * y), n * (y * z - s * x), 1.0 - n * (x * x + y * y)),
    )


def _dot(a: Triple, b: Triple) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _quaternion_rate(q: Sequence[float], omega: Triple) -> list[float]:
    """q (0, Omega)/2."""
    s, x, y, z = q
    a, b, c = omega
    return [
        -0.5 * (x * a + y * b + z * c),
        0.5 * (s * a + y * c - z * b),
        0.5 * (s * b + z * a - x * c),
        0.5 * (s * c + x * b - y * a),
    ]


def _integrate(rate: object, start: Array, times: Array, rtol: float, atol: float) -> Array:
    """States (T, n) at the times, the first of which is the start; raises RuntimeError."""
    from scipy.integrate import solve_ivp

    if len(times) < 2:
        return np.tile(start, (len(times), 1))
    keys = {"method": "DOP853", "t_eval": times, "rtol": rtol, "atol": atol}
    solution = solve_ivp(rate, (times[0], times[-1]), start, **keys)
    if not solution.success:
        raise RuntimeError(f"reference integration failed: {solution.message}")
    return np.asarray(solution.y.T, dtype=float)


def linear_flow(
    k: float,
    stokes_number: float,
    gradient: ArrayLike,
    orientation: ArrayLike,
    times: ArrayLike,
    angular_velocity: ArrayLike | None = None,
    rtol: float = 1e-13,
    atol: float = 1e-13,
) -> RotationSolution:
    """Rotation of a spheroid in the linear flow u = A x, from times[0] on.

    gradient A (3, 3) in space; orientation (4,) quaternion, scalar first; angular_velocity (3,)
    in the body frame at the start, None for that of a free massless body. stokes_number = 0 is
    the massless body, whose angular velocity is Jeffery's at every instant (the one given is
    ignored). Linear shear u = (x2, 0, 0): A[0, 1] = 1.
    """
    a = np.asarray(gradient, dtype=float)
    r1, r2, r3 = a.tolist()
    j1, j2, j3 = inertia(k).tolist()
    transverse, axial = jeffery.rotation_resistance(k)
    times = np.asarray(times, dtype=float)
    start = np.asarray(orientation, dtype=float)
    start = start / np.sqrt(start @ start)

    def free(q: Sequence[float]) -> Triple:
        d1, d2, d3 = _axes(q)
        a1, a2, a3 = ((_dot(r1, d), _dot(r2, d), _dot(r3, d)) for d in (d1, d2, d3))  # A D1, ...
        gradient = (_dot(d1, a2), _dot(d2, a1), _dot(d1, a3), _dot(d3, a1))
        return jeffery.free_rates(k, *gradient, _dot(d2, a3), _dot(d3, a2))

    def massless(_: float, y: Array) -> list[float]:
        q = y.tolist()
        return _quaternion_rate(q, free(q))

    def inertial(_: float, y: Array) -> list[float]:
        s0, s1, s2, s3, p, q, r = y.tolist()
        f1, f2, f3 = free((s0, s1, s2, s3))
        # Jeffery's torque, with its part at rest written as resistance times free velocity.
        return [
            *_quaternion_rate((s0, s1, s2, s3), (p, q, r)),
            (transverse * (f1 - p) / stokes_number - (j3 - j2) * q * r) / j1,
            (transverse * (f2 - q) / stokes_number - (j1 - j3) * r * p) / j2,
            (axial * (f3 - r) / stokes_number - (j2 - j1) * p * q) / j3,
        ]

    if stokes_number == 0.0:
        q = _integrate(massless, start, times, rtol, atol)
        omega = np.array([free(row) for row in q.tolist()])
    else:
        given = angular_velocity
        spin = free(start.tolist()) if given is None else np.asarray(given, dtype=float)
        states = _integrate(inertial, np.concatenate([start, spin]), times, rtol, atol)
        q, omega = states[:, :4], states[:, 4:]
    return RotationSolution(times, q / np.linalg.norm(q, axis=1, keepdims=True), omega)


def paraboloid(
    k: float,
    stokes_number: float,
    curvature: float,
    position: ArrayLike,
    phi: float,
    times: ArrayLike,
    velocity: ArrayLike | None = None,
    phi_rate: float | None = None,
    rtol: float = 1e-13,
    atol: float = 1e-13,
) -> PlaneSolution:
    """Chwang's special orientation (theta = pi/2, psi = 0) in u = K (x2^2 + x3^2) e1, x3 = 0.

    D1 = (cos phi, sin phi, 0), D3 = (sin phi, -cos phi, 0); phi is measured as Euler's angle.
    curvature K is nondimensional, 1/(2 eta0) for time in units of 1/(2 K eta0); position (2,)
    and velocity (2,) in space; velocity and phi_rate None start as the free massless body does.
    stokes_number = 0 is the massless body.
    """
    times = np.asarray(times, dtype=float)
    start = np.asarray(position, dtype=float)
    across, along = lamb.translation_resistance(k)
    turning, _ = jeffery.rotation_resistance(k)
    volume_st, moment_st = volume(k) * stokes_number, float(inertia(k)[1]) * stokes_number

    def held(x2: float, angle: float, v1: float, v2: float, rate: float) -> list[float]:
        """Force along D1 and D3 and torque about D2 = e3 on the moving body, and e1.D3, e1.D1."""
        # D1 = (sine, cosine), D3 = (cosine, -sine).
        cosine, sine = math.sin(angle), math.cos(angle)
        first, third = chwang.fixed_force(k, curvature, x2, cosine, sine)
        first -= across * (v1 * sine + v2 * cosine)
        third -= along * (v1 * cosine - v2 * sine)
        moment = chwang.fixed_torque(k, curvature, x2, cosine) - turning * rate
        return [first, third, moment, cosine, sine]

    def free(x2: float, angle: float) -> list[float]:
        """Velocity in space and rate of turning of the free massless body."""
        first, third, moment, cosine, sine = held(x2, angle, 0.0, 0.0, 0.0)
        first, third = first / across, third / along
        return [first * sine + third * cosine, first * cosine - third * sine, moment / turning]

    def massless(_: float, y: Array) -> list[float]:
        return free(*y[1:3].tolist())

    def inertial(_: float, y: Array) -> list[float]:
        _, x2, angle, v1, v2, rate = y.tolist()
        first, third, moment, cosine, sine = held(x2, angle, v1, v2, rate)
        force = first * sine + third * cosine, first * cosine - third * sine
        return [v1, v2, rate, *(f / volume_st for f in force), moment / moment_st]

    if stokes_number == 0.0:
        states = _integrate(massless, np.array([*start, phi]), times, rtol, atol)
        motions = np.array([free(*row) for row in states[:, 1:3].tolist()])
        return PlaneSolution(times, states[:, :2], motions[:, :2], states[:, 2], motions[:, 2])
    *free_velocity, free_rate = free(float(start[1]), phi)
    v0 = free_velocity if velocity is None else np.asarray(velocity, dtype=float)
    initial = np.array([*start, phi, *v0, free_rate if phi_rate is None else phi_rate])
    states = _integrate(inertial, initial, times, rtol, atol)
    return PlaneSolution(times, states[:, :2], states[:, 3:5], states[:, 2], states[:, 5])
