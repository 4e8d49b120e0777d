"""Motions at their limits: Stokes numbers, many periods, odd orientations, free spinning."""

from __future__ import annotations

import cmath
import math
from itertools import product

import numpy as np
import pytest
from conftest import See, script
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from qbxstokes.flows.named import Shear, Uniform
from qbxstokes.geometry import rotation
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.motion.equations import RigidBodyEquations
from qbxstokes.petsc import session
from qbxstokes.reference import inertial, jeffery
from qbxstokes.simulation.hydrodynamics import exact_model

Array = NDArray[np.float64]
heavy = script("studies/heavy")

extents = pytest.mark.parametrize("extent", ["small", pytest.param("full", marks=pytest.mark.slow)])


def light_axis(k: float, stokes_number: float, axis: Array, times: Array) -> Array:
    """The axis (T, 3) of a body of small Stokes number, to first order in it, without its layer.

    It starts at times[0] as `axis`; d' = g + St lag is not stiff and goes to DOP853.
    """

    def rate(_: float, d: Array) -> Array:
        g = heavy.jeffery_rate(k, d)
        return np.asarray(g + stokes_number * heavy.lag(k, d, g))

    span = (float(times[0]), float(times[-1]))
    found = solve_ivp(rate, span, axis, "DOP853", times, rtol=1e-12, atol=1e-12)
    return np.asarray(found.y.T)


@pytest.fixture(scope="module", autouse=True)
def petsc() -> None:
    session.start([])


@pytest.mark.slow
def test_stokes_numbers(see: See) -> None:
    """The axis after a Jeffery period, St from 1e-8 to 1e8.

    Against Jeffery's torque integrated by DOP853, to ten times the tolerance; where that takes too
    long, light bodies against the expansion in St, whose second order is twice the square of the
    longer relaxation time times max(k, 1/k).
    """
    from qbxstokes.petsc.stepper import integrate

    tolerance, gradient = 1e-9, Shear().gradient(np.zeros(3))
    for k in (0.1, 0.5, 2.0, 10.0):
        times = np.linspace(0.0, jeffery.period(k), 5)
        for power in range(-8, 9):
            stokes = 10.0**power
            equations = RigidBodyEquations(exact_model(Spheroid(k)), Shear(), stokes)
            q = rotation.from_axis(np.array([0.5, 0.3, 0.8]))
            start = equations.initial_state(np.zeros(3), q)
            run = integrate(equations, start, times, tolerance)
            d = rotation.axis(run.states[:, 0, 3:7])
            rates, bound = equations.relaxation_rates[2:, 0], 10.0 * tolerance
            if rates.max() * times[-1] > 2e4:
                exact = light_axis(k, stokes, d[0], times)
                bound += 2.0 * (max(k, 1.0 / k) / float(rates.min())) ** 2
            else:
                found = inertial.linear_flow(
                    k, stokes, gradient, start[0, 3:7], times, start[0, 10:13]
                )
                exact = rotation.axis(found.orientation)
            see(
                float(np.abs(d - exact).max()),
                bound,
                f"k = {k:g}, St = {stokes:g}, {run.checkpoint.method}",
            )


@pytest.mark.slow
def test_long_runs(see: See) -> None:
    """Ten thousand Jeffery periods, streamed at bounded memory."""
    from qbxstokes.petsc.stepper import integrate
    from qbxstokes.petsc.trajectory import Chunk

    axis = np.array([0.48, 0.6, 0.64])
    for k in (0.5, 2.0):
        constant = jeffery.orbit_constant(k, axis)

        def look(chunk: Chunk, k: float = k, constant: float = constant) -> None:
            if len(chunk.times):  # one per period
                d = rotation.axis(chunk.states[:, 0, 3:7])
                drift = np.abs(jeffery.orbit_constant(k, d) / constant - 1.0).max()
                see(float(drift), 1e-7, f"drift of the orbit constant, k = {k:g}")
                see(float(np.abs(d - axis).max()), 1e-7, f"axis after whole periods, k = {k:g}")

        equations = RigidBodyEquations(exact_model(Spheroid(k)), Shear())
        start = equations.initial_state(np.zeros(3), rotation.from_axis(axis))
        times = jeffery.period(k) * np.arange(10_001)
        run = integrate(equations, start, times, 1e-12, on_chunk=look, chunk_samples=256)
        see(run.checkpoint.norm_drift, 1e-12, f"| |q| - 1 |, k = {k:g}")


@extents
def test_orientations(extent: str, see: See) -> None:
    """Quaternions of any length, and orientations at and beside the poles of Euler's angles."""
    from qbxstokes.petsc.stepper import integrate

    rng, small, tolerance = np.random.default_rng(0), extent == "small", 1e-10
    lengths = (1e-300, 1e-150, 1e-10, 0.3, 7.0, 1e150, 1e300)
    for length in lengths[::3] if small else lengths:
        for q in rotation.random_quaternions(5 if small else 200, rng):
            error = float(np.abs(rotation.normalize(length * q) - q).max())
            see(error, 4e-16, f"quaternion of length {length:g}")
    shapes = (0.5,) if small else (0.05, 0.5, 1.0, 2.0, 20.0)
    for angle, k, pole in product((0.0, 1e-300, 1e-16, 1e-12, 1e-8), shapes, (0.0, np.pi)):
        where = f"{angle:g} beside theta = {pole:.2g}, k = {k:g}"
        equations = RigidBodyEquations(exact_model(Spheroid(k)), Shear())
        times = np.linspace(0.0, 2.0 * jeffery.period(k), 9)
        phi, psi = rng.uniform(-3.0, 3.0, 2)
        q = rotation.from_euler(phi, pole + (angle if pole == 0.0 else -angle), psi)
        start = equations.initial_state(np.zeros(3), q)
        states = integrate(equations, start, times, tolerance).states[:, 0, 3:7]
        exact = jeffery.axis_at(times, k, rotation.axis(q))
        error = float(np.abs(rotation.axis(states) - exact).max())
        see(error, 10.0 * tolerance, f"axis, {where}")
        see(euler_error(np.concatenate([states, q[None]])), 1e-14, f"Euler angles, {where}")
    for q in rotation.random_quaternions(50 if small else 5000, rng):
        see(euler_error(q), 1e-14, "Euler angles, anywhere")


def euler_error(q: Array) -> float:
    """Largest entry by which R changes when it goes through Euler's angles."""
    angles = rotation.to_euler(q)
    back = rotation.from_euler(angles[..., 0], angles[..., 1], angles[..., 2])
    return float(np.abs(rotation.matrix(back) - rotation.matrix(q)).max())


SPIN = (0.6, -0.3, 1.0)


def spin_rates(k: float, stokes_number: float) -> tuple[float, float, float]:
    """a = R_a/(St J3), b = R_t/(St J1) and g = (J3 - J1)/J1 of Euler's equations with drag."""
    r = exact_model(Spheroid(k)).resistance
    j1, _, j3 = Spheroid(k).inertia
    a, b = r.rotation_axial / (stokes_number * j3), r.rotation_transverse / (stokes_number * j1)
    return float(a), float(b), float((j3 - j1) / j1)


def decaying_spin(k: float, stokes_number: float, t: Array) -> Array:
    """Body-frame angular velocity (T, 3) of a free spinning spheroid in still fluid.

    W3 decays by its drag alone, and w = W1 + i W2 by its own while W3 turns it:
    w = w0 exp(-b t) exp(i g W3(0) (1 - exp(-a t))/a).
    """
    a, b, g = spin_rates(k, stokes_number)
    turned = g * SPIN[2] * -np.expm1(-a * t) / a
    w = (SPIN[0] + 1j * SPIN[1]) * np.exp(-b * t + 1j * turned)
    return np.stack([w.real, w.imag, SPIN[2] * np.exp(-a * t)], axis=-1)


def turned_with(k: float, stokes_number: float, q: Array, t: Array) -> Array:
    """Orientations (T, 4) from the start q under `decaying_spin`, by an integrator of its own."""
    from scipy.integrate import solve_ivp

    a, b, g = spin_rates(k, stokes_number)
    w0 = complex(SPIN[0], SPIN[1])

    def rate(now: float, state: Array) -> list[float]:
        # Plain arithmetic: a tenth of the time of arrays of so few numbers.
        w = w0 * cmath.exp(complex(-b * now, g * SPIN[2] * -math.expm1(-a * now) / a))
        w1, w2, w3 = w.real, w.imag, SPIN[2] * math.exp(-a * now)
        q0, q1, q2, q3 = state.tolist()
        return [
            -0.5 * (q1 * w1 + q2 * w2 + q3 * w3),
            0.5 * (q0 * w1 + q2 * w3 - q3 * w2),
            0.5 * (q0 * w2 + q3 * w1 - q1 * w3),
            0.5 * (q0 * w3 + q1 * w2 - q2 * w1),
        ]

    span = (float(t[0]), float(t[-1]))
    found = solve_ivp(rate, span, q, "DOP853", t, rtol=1e-13, atol=1e-13)
    return np.asarray(rotation.normalize(found.y.T))


@extents
def test_torque_free(extent: str, see: See) -> None:
    """A body spinning in still fluid: energy and angular momentum.

    Sizes are bounded by twenty times the tolerance, what has a phase by that times the time. Where
    drag is weak, it may take the relaxation rate times the time of the angular momentum at the
    start; the rest must be kept.
    """
    from qbxstokes.petsc.stepper import integrate

    small, tolerance = extent == "small", 1e-11
    still, bound = Uniform([0.0, 0.0, 0.0]), 20.0 * tolerance
    times = np.linspace(0.0, 50.0 if small else 1000.0, 41)
    shapes, heavies = ((0.5,), (1e8,)) if small else ((0.1, 0.5, 1, 2, 10), (1e4, 1e8, 1e12))
    for k, stokes in product(shapes, heavies):
        inertia = Spheroid(k).inertia
        equations = RigidBodyEquations(exact_model(Spheroid(k)), still, stokes)
        q = rotation.from_axis([0.3, 0.5, 0.8])
        spin = rotation.to_space(q, np.array(SPIN))
        start = equations.initial_state(np.zeros(3), q, np.array([1.0, 2.0, 3.0]), spin)
        states = integrate(equations, start, times, tolerance).states[:, 0]
        w, exact = states[:, 10:13], decaying_spin(k, stokes, times)
        energy, known = (np.sum(inertia * s * s, axis=-1) for s in (w, exact))
        momentum = rotation.to_space(states[:, 3:7], inertia * w)
        should = rotation.to_space(turned_with(k, stokes, q, times), inertia * exact)
        size, last = (np.linalg.norm(m, axis=-1) for m in (momentum, should))
        missed = np.linalg.norm(momentum - should, axis=-1).max() / last[0]
        # What the fluid takes away; the rest of the change is the integrator's.
        kept = np.linalg.norm(momentum - momentum[0], axis=-1).max() / size[0]
        drag = float(equations.relaxation_rates[2:, 0].max() * times[-1])
        where = f"k = {k:g}, St = {stokes:g}"
        see(np.abs(w - exact).max(), bound * times[-1], f"angular velocity, {where}")
        see(np.abs(energy - known).max() / known[0], bound, f"energy, {where}")
        see(np.abs(size - last).max() / last[0], bound, f"size of the angular momentum, {where}")
        see(missed, bound * times[-1], f"angular momentum, {where}")
        if drag < 0.01:
            see(kept, bound * times[-1] + drag, f"angular momentum kept, {where}")
