"""Work and precision of the integrators: the axis after ten Jeffery periods in shear.

Hydrodynamics by closed forms, so that only the integration errs; the axis against Jeffery's, or his
torque integrated by DOP853 at 1e-13. `taken`: the program takes this method. One that took more
than 50,000 right-hand sides is tried at tighter tolerances only where it is taken.

Run:      python cases/benchmarks/integrators.py      (5 min; --small: 3 s; --csv)
Expected: the method that is taken errs by at most ten times the tolerance and is near the cheapest.
"""

from functools import partial

import numpy as np
from measure import command, timed

from qbxstokes.flows.named import Shear
from qbxstokes.geometry import rotation
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.motion.equations import RigidBodyEquations
from qbxstokes.petsc import session
from qbxstokes.reference import inertial, jeffery
from qbxstokes.simulation.closed_forms import exact_model

# Aspect ratio and Stokes number.
ORBITS = {"massless": (0.5, 0.0), "inertial": (0.5, 1.0), "thin": (0.05, 0.0)}
ORBITS |= {"heavy": (2.0, 100.0), "stiff": (0.5, 0.1)}
METHODS = ("8vr", "5dp", "bdf", "arkimex", "rosw")
MOST_EVALUATIONS = 50_000
AXIS = np.array([0.48, 0.6, 0.64])


def orbit(name, periods, small):
    """A row per method and tolerance."""
    from qbxstokes.petsc.stepper import integrate

    k, stokes_number = ORBITS[name]
    equations = RigidBodyEquations(exact_model(Spheroid(k)), Shear(), stokes_number)
    start = equations.initial_state(np.zeros(3), rotation.from_axis(AXIS))
    times = [0.0, periods * jeffery.period(k)]
    exact = jeffery.axis_at(times[1], k, AXIS)
    if stokes_number:
        scene = (k, stokes_number, Shear().gradient(np.zeros(3)), start[0, 3:7], times)
        exact = rotation.axis(inertial.linear_flow(*scene, start[0, 10:13]).orientation[1])
    tolerances = (1e-6, 1e-10) if small else (1e-4, 1e-6, 1e-8, 1e-10, 1e-12)
    taken = {to: integrate(equations, start, times, to).checkpoint.method for to in tolerances}
    rows = []
    for method in METHODS[: 2 if small else None]:
        evaluations = 0
        for tolerance in tolerances:
            if evaluations > MOST_EVALUATIONS and taken[tolerance] != method:
                continue
            go = partial(integrate, equations, start, times, tolerance, method=method)
            span, run = timed(go, 1 if small else 5)
            evaluations = run.checkpoint.evaluations
            error = float(np.abs(rotation.axis(run.states[-1, 0, 3:7]) - exact).max())
            row = {"orbit": name, "method": method, "tolerance": tolerance, "error": error}
            row |= {"steps": run.checkpoint.steps, "right_hand_sides": evaluations}
            row |= {"jacobians": run.checkpoint.jacobians, "time": span}
            rows.append(row | {"taken": taken[tolerance] == method})
    return rows


@command
def main(small=False):
    """A table per orbit."""
    session.start([])
    chosen = list(ORBITS)[: 2 if small else None]
    return {f"integrators_{name}": orbit(name, 1 if small else 10, small) for name in chosen}
