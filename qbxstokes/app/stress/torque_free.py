"""A heavy body spinning in still fluid: energy and angular momentum."""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from qbxstokes.app.stress.checks import Checks
from qbxstokes.app.stress.scenes import polynomial
from qbxstokes.app.tabulate import Work
from qbxstokes.bie.exact import exact_model
from qbxstokes.geometry import rotation
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.io.tables import Column, Table
from qbxstokes.motion.equations import RigidBodyEquations

Array = NDArray[np.float64]

TOLERANCE = 1e-11
LITTLE = 0.01  # relaxation rate times the time below which angular momentum is kept
SPIN = (0.6, -0.3, 1.0)


def decaying_spin(k: float, stokes_number: float, t: Array) -> Array:
    """Body-frame angular velocity (T, 3) of a free spinning spheroid in still fluid.

    W3 decays by its drag alone, and w = W1 + i W2 by its own while W3 turns it:
    w = w0 exp(-b t) exp(i g W3(0) (1 - exp(-a t))/a) with a = R_a/(St J3), b = R_t/(St J1) and
    g = (J3 - J1)/J1, from Euler's equations (method, section 1).
    """
    a, b, g = _constants(k, stokes_number)
    turned = g * SPIN[2] * -np.expm1(-a * t) / a
    w = (SPIN[0] + 1j * SPIN[1]) * np.exp(-b * t + 1j * turned)
    return np.stack([w.real, w.imag, SPIN[2] * np.exp(-a * t)], axis=-1)


def turned_with(k: float, stokes_number: float, q: Array, t: Array) -> Array:
    """Orientations (T, 4) from the start q under `decaying_spin`, by an integrator of its own."""
    from scipy.integrate import solve_ivp

    a, b, g = _constants(k, stokes_number)
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


def _constants(k: float, stokes_number: float) -> tuple[float, float, float]:
    """Rates a and b of `decaying_spin`, and g."""
    r = vars(exact_model(k).resistance)
    j1, _, j3 = Spheroid(k).inertia
    a = r["rotation_axial"] / (stokes_number * j3)
    b = r["rotation_transverse"] / (stokes_number * j1)
    return float(a), float(b), float((j3 - j1) / j1)


def tables(work: Work) -> Iterator[Table]:
    """Energy and angular momentum against Euler's equations with linear drag."""
    from qbxstokes.petsc.stepper import integrate

    checks = Checks(
        "torque_free",
        "A free body spinning in still fluid",
        (
            Column("aspect_ratio", format="g", heading="k"),
            Column("stokes_number", format=".0e", heading="St"),
            Column("quantity"),
        ),
        "largest difference over the run, relative to the start",
    )
    still = polynomial("uniform", velocity=[0.0, 0.0, 0.0])
    times = np.linspace(0.0, work.choose(50.0, 1000.0), 41)
    for k in work.choose((0.5,), (0.1, 0.5, 1.0, 2.0, 10.0)):
        inertia = Spheroid(k).inertia
        for stokes in work.choose((1e8,), (1e4, 1e8, 1e12)):
            work.say(f"torque-free body, k = {k:g}, St = {stokes:g}")
            equations = RigidBodyEquations(exact_model(k), still, stokes)
            q = rotation.from_axis([0.3, 0.5, 0.8])
            start = equations.initial_state(
                np.zeros(3), q, np.array([1.0, 2.0, 3.0]), rotation.to_space(q, np.array(SPIN))
            )
            states = integrate(equations, start, times, TOLERANCE).states[:, 0]
            w, exact = states[:, 10:13], decaying_spin(k, stokes, times)
            energy, known = (np.sum(inertia * s * s, axis=-1) for s in (w, exact))
            momentum = rotation.to_space(states[:, 3:7], inertia * w)
            turns = turned_with(k, stokes, q, times)
            should = rotation.to_space(turns, inertia * exact)
            missed = np.linalg.norm(momentum - should, axis=-1).max() / np.linalg.norm(should[0])
            size, last = (np.linalg.norm(m, axis=-1) for m in (momentum, should))
            off = np.abs(size - last).max() / last[0]
            # What the fluid takes away; the rest of the change is the integrator's.
            kept = np.linalg.norm(momentum - momentum[0], axis=-1).max() / size[0]
            drag = float(equations.relaxation_rates[2:, 0].max() * times[-1])
            bound = 20.0 * TOLERANCE
            checked = [
                ("angular velocity", np.abs(w - exact).max(), bound * times[-1]),
                ("energy", np.abs(energy - known).max() / known[0], bound),
                ("angular momentum, size", off, bound),
                ("angular momentum", missed, bound * times[-1]),
            ]
            if drag < LITTLE:
                checked.append(("angular momentum kept", kept, bound * times[-1] + drag))
            for what, value, limit in checked:
                checks.see(k, stokes, what, value=float(value), bound=limit)
    checks.note(
        f"Sizes are bounded by twenty times the tolerance {TOLERANCE:g}, what has a phase by that "
        "times the time. Where drag is weak, it may take the relaxation rate times the time of the "
        "angular momentum at the start; the rest must be kept."
    )
    yield checks.table()
