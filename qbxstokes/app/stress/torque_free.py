"""A heavy body spinning in still fluid: energy and angular momentum."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from qbxstokes.app.stress.checks import Checks
from qbxstokes.app.stress.scenes import exact_model, polynomial
from qbxstokes.app.tabulate import Work
from qbxstokes.geometry import rotation
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.io.tables import Column, Table
from qbxstokes.motion.equations import RigidBodyEquations

Array = NDArray[np.float64]

TOLERANCE = 1e-11
SPIN = np.array([0.6, -0.3, 1.0])


def decaying_spin(k: float, stokes_number: float, t: Array) -> Array:
    """Body-frame angular velocity (T, 3) of a free spinning spheroid in still fluid.

    W3 decays by its drag alone, and w = W1 + i W2 by its own while W3 turns it:
    w = w0 exp(-b t) exp(i g W3(0) (1 - exp(-a t))/a) with a = R_a/(St J3), b = R_t/(St J1) and
    g = (J3 - J1)/J1, from Euler's equations (method, section 1).
    """
    r = vars(exact_model(k).resistance)
    j1, _, j3 = Spheroid(k).inertia
    a = r["rotation_axial"] / (stokes_number * j3)
    b = r["rotation_transverse"] / (stokes_number * j1)
    turned = SPIN[2] * (j3 - j1) / j1 * -np.expm1(-a * t) / a
    w = (SPIN[0] + 1j * SPIN[1]) * np.exp(-b * t + 1j * turned)
    return np.stack([w.real, w.imag, SPIN[2] * np.exp(-a * t)], axis=-1)


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
                np.zeros(3), q, np.array([1.0, 2.0, 3.0]), rotation.to_space(q, SPIN)
            )
            states = integrate(equations, start, times, TOLERANCE).states[:, 0]
            w, exact = states[:, 10:13], decaying_spin(k, stokes, times)
            energy, known = (np.sum(inertia * s * s, axis=-1) for s in (w, exact))
            momentum = rotation.to_space(states[:, 3:7], inertia * w)
            size = np.linalg.norm(momentum, axis=-1)
            should = np.linalg.norm(inertia * exact, axis=-1)
            way = np.abs(momentum / size[:, None] - momentum[0] / size[0]).max()
            rates = equations.relaxation_rates[2:, 0]
            # Unequal drag along and across the axis turns the angular momentum a little.
            turning = float(np.abs(rates[0] - rates[1]) * times[-1])
            bound = 20.0 * TOLERANCE
            for what, value, limit in (
                ("angular velocity", np.abs(w - exact).max(), bound * times[-1]),
                ("energy", np.abs(energy - known).max() / known[0], bound),
                ("angular momentum, size", np.abs(size - should).max() / should[0], bound),
                ("angular momentum, direction", way, bound + turning),
            ):
                checks.see(k, stokes, what, value=float(value), bound=limit)
    checks.note(
        "The direction of the angular momentum may turn by the difference of the relaxation rates "
        "times the time; everything else is bounded by twenty times the tolerance "
        f"{TOLERANCE:g}, the phase of the precession by that times the time."
    )
    yield checks.table()
