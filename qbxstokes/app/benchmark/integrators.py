"""Integrators and tolerances: error after ten Jeffery periods, steps, right-hand sides, time."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from qbxstokes.bie.accuracy import accurate_body
from qbxstokes.flows.named import Shear
from qbxstokes.geometry import rotation
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.io.tables import Column, Table
from qbxstokes.motion.equations import RigidBodyEquations
from qbxstokes.reference import jeffery

if TYPE_CHECKING:
    from qbxstokes.app.tabulate import Work

ASPECT_RATIO = 0.5
# Methods of low order take too long at tight tolerances to be of interest there.
_TOLERANCES = {
    "8vr": (1e-4, 1e-6, 1e-8, 1e-10, 1e-12),
    "5dp": (1e-4, 1e-6, 1e-8, 1e-10, 1e-12),
    "bdf": (1e-4, 1e-6, 1e-8),
    "arkimex": (1e-4, 1e-6, 1e-8),
    "rosw": (1e-4, 1e-6),
}


def tables(work: Work) -> Iterator[Table]:
    """Work and precision of a massless body in shear against Jeffery's orbit."""
    from qbxstokes.petsc.stepper import integrate

    periods = work.choose(1, 10)
    table = Table(
        "integrators",
        f"Integrators: a Jeffery orbit (k = 1/2) after {periods} periods",
        (
            Column("method"),
            Column("tolerance", "", "error accepted at the end", ".0e"),
            Column("error", "", "of the axis at the end", ".1e"),
            Column("steps", "", "accepted", "d"),
            Column("rhs_evaluations", "", "", "d", "right-hand sides"),
            Column("time", "s", "wall time", ".2g"),
            Column("ratio", "", "time over that of 8vr at the same tolerance", ".2g"),
        ),
        plot={"x": "error", "y": "rhs_evaluations", "by": "method", "scale": "loglog"},
    )
    k, axis = ASPECT_RATIO, np.array([0.48, 0.6, 0.64])
    model = accurate_body(Spheroid(k), 1e-12).model
    times = np.array([0.0, periods * jeffery.period(k)])
    exact = jeffery.axis_at(times[-1], k, axis)
    base: dict[float, float] = {}
    chosen = _TOLERANCES if work.full else {"8vr": (1e-6, 1e-10), "5dp": (1e-6,)}
    for method, tolerances in chosen.items():
        for tolerance in tolerances:
            work.say(f"{method}, tolerance {tolerance:g}")
            spans = []
            for _ in range(work.choose(1, min(3, work.section.repeats))):
                equations = RigidBodyEquations(model, Shear())
                start = equations.initial_state(np.zeros(3), rotation.from_axis(axis))
                begin = time.perf_counter()
                run = integrate(equations, start, times, tolerance, method=method)
                spans.append(time.perf_counter() - begin)
            span = sorted(spans)[len(spans) // 2]
            base.setdefault(tolerance, span)
            table.add(
                method=method,
                tolerance=tolerance,
                error=float(np.abs(rotation.axis(run.states[-1, 0, 3:7]) - exact).max()),
                steps=run.steps,
                rhs_evaluations=run.evaluations,
                time=span,
                ratio=span / base[tolerance],
            )
    yield table
