"""Work and precision of the integrators: the axis after ten Jeffery periods in shear.

Hydrodynamics by closed forms, so that only the integration errs; the axis against Jeffery's, or his
torque integrated by DOP853 at 1e-13. METHODS=8vr,5dp,bdf,arkimex,rosw tries these beside what the
program takes (5 min); one that took more than 50,000 right-hand sides is not tried at tighter
tolerances. Expected: what is taken is near the cheapest.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable

import numpy as np
import pytest

from qbxstokes.flows.named import Shear
from qbxstokes.geometry import rotation
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.motion.equations import RigidBodyEquations
from qbxstokes.petsc import session
from qbxstokes.reference import inertial, jeffery
from qbxstokes.simulation.hydrodynamics import exact_model

# Aspect ratio and Stokes number.
ORBITS = {"massless": (0.5, 0.0), "inertial": (0.5, 1.0), "thin": (0.05, 0.0)}
ORBITS |= {"heavy": (2.0, 100.0), "stiff": (0.5, 0.1)}
METHODS = tuple(filter(None, os.environ.get("METHODS", "").split(",")))
PERIODS, MOST_EVALUATIONS = 10, 50_000
AXIS = np.array([0.48, 0.6, 0.64])


@pytest.mark.parametrize(
    "name",
    [n if n in ("massless", "heavy") else pytest.param(n, marks=pytest.mark.slow) for n in ORBITS],
)
def test_integrators_keep_ten_tolerances(
    name: str, record_property: Callable[[str, object], None]
) -> None:
    from qbxstokes.petsc.stepper import integrate

    session.start([])
    k, stokes_number = ORBITS[name]
    equations = RigidBodyEquations(exact_model(Spheroid(k)), Shear(), stokes_number)
    start = equations.initial_state(np.zeros(3), rotation.from_axis(AXIS))
    times = [0.0, PERIODS * jeffery.period(k)]
    exact = jeffery.axis_at(times[1], k, AXIS)
    if stokes_number:
        scene = (k, stokes_number, Shear().gradient(np.zeros(3)), start[0, 3:7], times)
        exact = rotation.axis(inertial.linear_flow(*scene, start[0, 10:13]).orientation[1])
    for method in (None, *METHODS):
        evaluations = 0
        for tolerance in (1e-4, 1e-6, 1e-8, 1e-10, 1e-12):
            if evaluations > MOST_EVALUATIONS and method:
                continue
            begin = time.perf_counter()
            run = integrate(equations, start, times, tolerance, method=method)
            spent, done = time.perf_counter() - begin, run.checkpoint
            error = float(np.abs(rotation.axis(run.states[-1, 0, 3:7]) - exact).max())
            evaluations = done.evaluations
            work = f"{evaluations} right-hand sides, {done.steps} steps, {done.jacobians} Jacobians"
            told = f"{done.method}{'' if method else ', taken'}: {work}, {spent:.2g} s"
            record_property("worst", f"{error:.0e}, tolerance {tolerance:.0e}, {told}")
            assert method or error < 10.0 * tolerance
