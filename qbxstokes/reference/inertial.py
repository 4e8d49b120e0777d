"""Motion of a spheroid with (and without) inertia from closed forms and an independent integrator.

The force and torque are those of Jeffery, Lamb and Chwang; the equations

    dq/dt = q (0, Omega)/2,   dV/dt = F/(St Theta),   dOmega/dt = J^-1 (M/St - Omega x (J Omega))

(body frame Omega; Bagge 2015, eqs. 3.26-3.29, 3.46-3.48) are integrated by scipy's DOP853, so
that nothing is shared with the program that they verify.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qbxstokes.reference import chwang, jeffery, lamb

Array = NDArray[np.float64]


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
    moments: Array = 4.0 * np.pi / 15.0 * square * shape
    return moments


def volume(k: float) -> float:
    """Volume 4 pi k^2/3."""
    return 4.0 * np.pi * k * k / 3.0


def _cross(a: Array, b: Array) -> Array:
    """a x b of two vectors; numpy's own takes ten times as long for one pair."""
    return np.array(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )


def _body_to_space(q: Array) -> Array:
    """Rotation matrix of a quaternion of any length but zero (it is normalised)."""
    s, x, y, z = q / np.sqrt(q @ q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - s * z), 2 * (x * z + s * y)],
            [2 * (x * y + s * z), 1 - 2 * (x * x + z * z), 2 * (y * z - s * x)],
            [2 * (x * z - s * y), 2 * (y * z + s * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _quaternion_rate(q: Array, omega: Array) -> Array:
    """q (0, Omega)/2."""
    vector = q[0] * omega + _cross(q[1:], omega)
    rate: Array = 0.5 * np.concatenate([[-q[1:] @ omega], vector])
    return rate


def _integrate(rate: object, start: Array, times: Array, rtol: float, atol: float) -> Array:
    """States (T, n) at the times, the first of which is the start; raises RuntimeError."""
    from scipy.integrate import solve_ivp

    if len(times) < 2:
        return np.tile(start, (len(times), 1))
    solution = solve_ivp(
        rate,
        (times[0], times[-1]),
        start,
        method="DOP853",
        t_eval=times,
        rtol=rtol,
        atol=atol,
    )
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
    moments = inertia(k)
    transverse, axial = jeffery.rotation_resistance(k)
    drag = np.array([transverse, transverse, axial])
    times = np.asarray(times, dtype=float)
    start = np.asarray(orientation, dtype=float)
    start = start / np.sqrt(start @ start)

    def free(q: Array) -> Array:
        turn = _body_to_space(q)
        return jeffery.free_angular_velocity(k, turn.T @ a @ turn)

    def massless(_: float, q: Array) -> Array:
        return _quaternion_rate(q, free(q))

    def inertial(_: float, y: Array) -> Array:
        omega = y[4:]
        # Jeffery's torque, with its part at rest written as resistance times free velocity.
        torque = drag * (free(y[:4]) - omega)
        acceleration = (torque / stokes_number - _cross(omega, moments * omega)) / moments
        return np.concatenate([_quaternion_rate(y[:4], omega), acceleration])

    if stokes_number == 0.0:
        q = _integrate(massless, start, times, rtol, atol)
        omega = np.array([free(row) for row in q])
    else:
        spin = free(start) if angular_velocity is None else np.asarray(angular_velocity, float)
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
    volume_st, moment_st = volume(k) * stokes_number, inertia(k)[1] * stokes_number

    def load(x2: float, angle: float, v: Array, rate: float) -> tuple[Array, float]:
        """Force (2,) in space and torque about D2 = e3."""
        cosine, sine = np.sin(angle), np.cos(angle)  # e1.D3, e1.D1
        first, third = np.array([sine, cosine]), np.array([cosine, -sine])  # D1, D3
        body = chwang.fixed_force(k, curvature, x2, cosine, sine)
        force = (body[0] - across * (v @ first)) * first + (body[2] - along * (v @ third)) * third
        moment = chwang.fixed_torque(k, curvature, x2, cosine)[1] - turning * rate
        return force, float(moment)

    def free(x2: float, angle: float) -> tuple[Array, float]:
        cosine, sine = np.sin(angle), np.cos(angle)
        body = chwang.fixed_force(k, curvature, x2, cosine, sine)
        first, third = np.array([sine, cosine]), np.array([cosine, -sine])
        v = body[0] / across * first + body[2] / along * third
        return v, float(chwang.fixed_torque(k, curvature, x2, cosine)[1] / turning)

    def massless(_: float, y: Array) -> Array:
        v, rate = free(y[1], y[2])
        return np.array([v[0], v[1], rate])

    def inertial(_: float, y: Array) -> Array:
        force, moment = load(y[1], y[2], y[3:5], y[5])
        return np.concatenate([y[3:5], [y[5]], force / volume_st, [moment / moment_st]])

    if stokes_number == 0.0:
        states = _integrate(massless, np.array([*start, phi]), times, rtol, atol)
        motions = [free(row[1], row[2]) for row in states]
        rates = np.array([rate for _, rate in motions])
        velocities = np.array([v for v, _ in motions])
        return PlaneSolution(times, states[:, :2], velocities, states[:, 2], rates)
    free_velocity, free_rate = free(float(start[1]), phi)
    v0 = free_velocity if velocity is None else np.asarray(velocity, dtype=float)
    rate0 = free_rate if phi_rate is None else phi_rate
    initial = np.array([*start, phi, *v0, rate0])
    states = _integrate(inertial, initial, times, rtol, atol)
    return PlaneSolution(times, states[:, :2], states[:, 3:5], states[:, 2], states[:, 5])
