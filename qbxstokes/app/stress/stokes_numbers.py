"""Stokes numbers from 1e-8 to 1e8: no failure, no silent loss, and the right limits."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from qbxstokes.app.stress.checks import Checks
from qbxstokes.app.stress.scenes import polynomial
from qbxstokes.app.tabulate import Work
from qbxstokes.bie.exact import exact_model
from qbxstokes.geometry import rotation
from qbxstokes.io.tables import Column, Table
from qbxstokes.motion.equations import RigidBodyEquations
from qbxstokes.reference import heavy, inertial

Array = NDArray[np.float64]

TOLERANCE = 1e-9
# Relaxations in a run above which the reference, which is explicit, would take too long. Bodies as
# light as that are held against the expansion in St, by a multiple of the square of what lags.
_EXPLICIT = 2e4
SECOND_ORDER = 2.0


def tables(work: Work) -> Iterator[Table]:
    """Error of the axis after one Jeffery period, and what it cost."""
    from qbxstokes.petsc.stepper import integrate

    checks = Checks(
        "stokes_numbers",
        "Stokes numbers: axis after one Jeffery period in shear",
        (
            Column("aspect_ratio", format="g", heading="k"),
            Column("stokes_number", format=".0e", heading="St"),
            Column("method", description="integrator that was chosen"),
            Column("rhs_evaluations", format="d", heading="right-hand sides"),
            Column("against"),
        ),
        "distance of the axis from the reference",
    )
    flow = polynomial("shear")
    axis = np.array([0.5, 0.3, 0.8])
    quaternion = rotation.from_axis(axis)
    powers = work.choose((-8, 2, 8), tuple(range(-8, 9)))
    for k in work.choose((0.5,), (0.1, 0.5, 2.0, 10.0)):
        work.say(f"Stokes numbers, aspect ratio {k:g}")
        model = exact_model(k)
        times = np.linspace(0.0, 2.0 * np.pi * (k + 1.0 / k), 5)
        for power in powers:
            stokes = 10.0**power
            equations = RigidBodyEquations(model, flow, stokes)
            start = equations.initial_state(np.zeros(3), quaternion)
            run = integrate(equations, start, times, TOLERANCE)
            d = rotation.axis(run.states[:, 0, 3:7])
            rates = equations.relaxation_rates[2:, 0]
            if rates.max() * times[-1] > _EXPLICIT:
                exact = heavy.light_axis(k, stokes, d[0], times)
                lagging = max(k, 1.0 / k) / float(rates.min())
                against = "expansion"
                bound = 10.0 * TOLERANCE + SECOND_ORDER * lagging**2
            else:
                exact, against, bound = _reference(k, stokes, start, times)
            error = float(np.abs(d - exact).max())
            key = (k, stokes, run.method, run.evaluations, against)
            checks.see(*key, value=error, bound=bound)
    checks.note(
        f"The tolerance is {TOLERANCE:g} and the bound ten times as much; against the expansion to "
        f"first order in St, {SECOND_ORDER:g} times the square of the longer relaxation time times "
        "max(k, 1/k) is added."
    )
    table = checks.table()
    table.plot = {
        "x": "stokes_number",
        "y": "rhs_evaluations",
        "by": "aspect_ratio",
        "scale": "loglog",
    }
    yield table


def _reference(k: float, stokes: float, start: Array, times: Array) -> tuple[Array, str, float]:
    """Jeffery's torque integrated by DOP853."""
    gradient = np.zeros((3, 3))
    gradient[0, 1] = 1.0
    solution = inertial.linear_flow(k, stokes, gradient, start[0, 3:7], times, start[0, 10:13])
    return rotation.axis(solution.orientation), "DOP853", 10.0 * TOLERANCE
