"""Integrators and tolerances: error after ten Jeffery periods, steps, right-hand sides, time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from qbxstokes.app.benchmark.timing import timed
from qbxstokes.bie.exact import exact_model
from qbxstokes.flows.named import Shear
from qbxstokes.geometry import rotation
from qbxstokes.io.tables import Column, Table
from qbxstokes.motion.equations import RigidBodyEquations
from qbxstokes.reference import inertial, jeffery

if TYPE_CHECKING:
    from qbxstokes.app.tabulate import Work

Array = NDArray[np.float64]

METHODS = ("8vr", "5dp", "bdf", "arkimex", "rosw")
TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10, 1e-12)
# The error at the end may exceed the tolerance by as much.
MARGIN = 10.0
# A method that took more right-hand sides than these is not tried at tighter tolerances.
MOST_EVALUATIONS = 50_000
AXIS = np.array([0.48, 0.6, 0.64])


@dataclass(frozen=True)
class Orbit:
    """A body in the shear u = (x2, 0, 0), with the start of a free one."""

    name: str
    title: str
    aspect_ratio: float
    stokes_number: float = 0.0

    def equations(self) -> RigidBodyEquations:
        """Equations of motion, with exact hydrodynamics: only the integration errs."""
        return RigidBodyEquations(exact_model(self.aspect_ratio), Shear(), self.stokes_number)

    def axes_at(self, times: Sequence[float], start: Array) -> Array:
        """The axes (n, 3): Jeffery's, or his torque integrated by DOP853 at 1e-13."""
        k = self.aspect_ratio
        if self.stokes_number == 0.0:
            return jeffery.axis_at(times, k, AXIS)
        gradient = Shear().gradient(np.zeros(3))
        found = inertial.linear_flow(
            k, self.stokes_number, gradient, start[3:7], [0.0, *times], start[10:13]
        )
        return rotation.axis(found.orientation[1:])


ORBITS = (
    Orbit("massless", "massless, k = 1/2", 0.5),
    Orbit("thin", "massless, k = 1/20", 0.05),
    Orbit("heavy", "St = 100, k = 2", 2.0, 100.0),
    Orbit("inertial", "St = 1, k = 1/2", 0.5, 1.0),
    Orbit("stiff", "St = 0.1, k = 1/2", 0.5, 0.1),
)


def tables(work: Work) -> Iterator[Table]:
    """A table per body: work and precision of every method, and which one the program takes."""
    periods = work.choose(1, 10)
    for orbit in work.choose((ORBITS[0], ORBITS[3]), ORBITS):
        yield _table(
            orbit,
            periods,
            work.choose(("8vr", "5dp"), METHODS),
            work.choose((1e-6, 1e-10), TOLERANCES),
            work,
        )


def _table(
    orbit: Orbit, periods: int, methods: Sequence[str], tolerances: Sequence[float], work: Work
) -> Table:
    from qbxstokes.petsc.stepper import integrate

    table = Table(
        f"integrators_{orbit.name}",
        f"Integrators: {orbit.title}, {periods} Jeffery period{'s'[: periods > 1]} in shear",
        (
            Column("method"),
            Column("tolerance", "", "error accepted at the end", ".0e"),
            Column("error", "", "of the axis at the end", ".1e"),
            Column("share", "", "error over tolerance", ".2g"),
            Column("steps", "", "accepted", "d"),
            Column("rhs_evaluations", "", "", "d", "right-hand sides"),
            Column("jacobians", "", "", "d"),
            Column("time", "s", "median wall time", ".2g"),
            Column("ratio", "", "time over that of 8vr at the same tolerance", ".2g"),
            Column("default", "", "whether the program would take this method"),
            Column("passed", "", f"of the default: error at most {MARGIN:g} times the tolerance"),
        ),
        plot={"x": "time", "y": "error", "by": "method", "scale": "loglog"},
    )
    equations = orbit.equations()
    start = equations.initial_state(np.zeros(3), rotation.from_axis(AXIS))
    times = np.array([0.0, periods * jeffery.period(orbit.aspect_ratio)])
    exact = orbit.axes_at(times[-1:].tolist(), start[0])[0]
    base: dict[float, float] = {}
    taken = {}
    for tolerance in tolerances:
        taken[tolerance] = integrate(equations, start, times, tolerance).method
    for method in methods:
        evaluations = 0
        for tolerance in tolerances:
            if evaluations > MOST_EVALUATIONS and taken[tolerance] != method:
                continue
            work.say(f"{orbit.title}: {method}, tolerance {tolerance:g}")
            go = partial(integrate, equations, start, times, tolerance, method=method)
            span, run = timed(go, work.choose(1, work.section.repeats))
            base.setdefault(tolerance, span)
            error = float(np.abs(rotation.axis(run.states[-1, 0, 3:7]) - exact).max())
            default = taken[tolerance] == method
            table.add(
                method=method,
                tolerance=tolerance,
                error=error,
                share=error / tolerance,
                steps=run.steps,
                rhs_evaluations=run.evaluations,
                jacobians=run.jacobians,
                time=span,
                ratio=span / base[tolerance],
                default=default,
                passed=error <= MARGIN * tolerance if default else None,
            )
            evaluations = run.evaluations
    table.notes.append(
        "Hydrodynamics by closed forms. A method that took more than "
        f"{MOST_EVALUATIONS} right-hand sides is tried at tighter tolerances only where it is the "
        "default."
    )
    return table
