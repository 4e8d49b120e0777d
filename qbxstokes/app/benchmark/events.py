"""Events found between the steps against PETSc's own event handler."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from qbxstokes.app.benchmark.integrators import AXIS, MARGIN, ORBITS, Orbit
from qbxstokes.flows.named import Shear
from qbxstokes.geometry import rotation
from qbxstokes.io.tables import Column, Table
from qbxstokes.motion.events import Events, Passage
from qbxstokes.reference import jeffery

if TYPE_CHECKING:
    from qbxstokes.app.tabulate import Work

TOLERANCE = 1e-8


def tables(work: Work) -> Iterator[Table]:
    """What half-turns cost, how well their instants are known, and what becomes of the motion."""
    periods = work.choose(1, 5)
    table = Table(
        "events",
        f"Half-turns in {periods} Jeffery period{'s'[: periods > 1]} in shear, tolerance "
        f"{TOLERANCE:g}",
        (
            Column("body"),
            Column("method"),
            Column("events", "", "how they are found"),
            Column("found", "", "half-turns", "d"),
            Column("rhs_evaluations", "", "", "d", "right-hand sides"),
            Column("steps", "", "accepted", "d"),
            Column("error", "", "of the axis at the end", ".1e"),
            Column("off_plane", "", "component of the true axis across the plane then", ".1e"),
            Column("passed", "", "between the steps: within ten times the tolerance"),
        ),
    )
    bodies = [
        (ORBITS[0], ("8vr", "bdf")),
        (ORBITS[3], ("8vr",)),
        (ORBITS[4], ("bdf",)),
    ]
    for orbit, methods in bodies[: work.choose(1, 3)]:
        for method in methods:
            work.say(f"half-turns: {orbit.title}, {method}")
            _add(table, orbit, method, periods)
    table.notes.append(
        "PETSc's handler (TSSetEventHandler) ends a step at each event and starts anew; its rows "
        "are for the tolerance of the function's values that PETSc sets, and for two others."
    )
    yield table


def _add(table: Table, orbit: Orbit, method: str, periods: int) -> None:
    from qbxstokes.petsc.handler import integrate_with_handler
    from qbxstokes.petsc.stepper import integrate

    equations = orbit.equations()
    start = equations.initial_state(np.zeros(3), rotation.from_axis(AXIS))
    end = periods * jeffery.period(orbit.aspect_ratio)
    passage = Passage.of(Shear().gradient(np.zeros(3)), orbit.aspect_ratio)

    def row(name: str, instants: Sequence[float], state: np.ndarray, *counts: int) -> None:
        *axes, exact = orbit.axes_at([*instants, end], start[0])
        error = float(np.abs(rotation.axis(state[0, 3:7]) - exact).max())
        off = max((abs(float(axis @ passage.normal)) for axis in axes), default=None)
        own = name == "between the steps"
        table.add(
            body=orbit.title,
            method=method,
            events=name,
            found=len(instants),
            rhs_evaluations=counts[0],
            steps=counts[1],
            error=error,
            off_plane=off,
            passed=max(error, off or 0.0) <= MARGIN * TOLERANCE if own else None,
        )

    watch = Events(equations, passage)
    for name, observe in (("none", None), ("between the steps", watch)):
        run = integrate(equations, start, [end], TOLERANCE, method=method, observe=observe)
        instants = [found[0] for found in watch.found.get("half_turns", [])] if observe else []
        row(name, instants, run.states[-1], run.evaluations, run.steps)
    for tolerance in (None, 1e-8, 1e-12):
        name = "PETSc's handler" + (f", {tolerance:g}" if tolerance else "")
        found = integrate_with_handler(
            equations, start, end, TOLERANCE, passage.value, method, tolerance
        )
        row(name, found.instants, found.state, found.evaluations, found.steps)
