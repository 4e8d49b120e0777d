"""Ten thousand periods: drift of the orbit constant and of the quaternion's length."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qbxstokes.app.stress.checks import Checks
from qbxstokes.app.stress.scenes import polynomial
from qbxstokes.app.tabulate import Work
from qbxstokes.bie.exact import exact_model
from qbxstokes.geometry import rotation
from qbxstokes.io.tables import Column, Table
from qbxstokes.motion.equations import RigidBodyEquations
from qbxstokes.reference import jeffery

Array = NDArray[np.float64]

TOLERANCE = 1e-12
DRIFT = 1e-7
NORM = 1e-12


class _Watch:
    """Largest drifts of the samples that stream by, one per period."""

    def __init__(self, aspect_ratio: float, axis: Array) -> None:
        self._k, self._axis = aspect_ratio, axis
        self._constant = jeffery.orbit_constant(aspect_ratio, axis)
        self.drift = self.offset = 0.0

    def __call__(self, chunk: Any) -> None:
        """Look at one piece of the run."""
        if len(chunk.times):
            d = rotation.axis(chunk.states[:, 0, 3:7])
            drift = np.abs(jeffery.orbit_constant(self._k, d) / self._constant - 1.0)
            self.drift = max(self.drift, float(drift.max()))
            self.offset = max(self.offset, float(np.abs(d - self._axis).max()))


def tables(work: Work) -> Iterator[Table]:
    """Drifts of massless Jeffery orbits, streamed at bounded memory."""
    from qbxstokes.petsc.stepper import integrate

    checks = Checks(
        "long_runs",
        "Jeffery orbits for thousands of periods",
        (
            Column("aspect_ratio", format="g", heading="k"),
            Column("periods", format="d"),
            Column("quantity"),
            Column("wall_time", "s", "of the integration", ".1f"),
        ),
        "largest of all periods",
    )
    flow = polynomial("shear")
    periods = work.choose(100, 10_000)
    axis = np.array([0.48, 0.6, 0.64])
    for k in work.choose((0.5,), (0.5, 2.0)):
        work.say(f"{periods} periods, aspect ratio {k:g}")
        equations = RigidBodyEquations(exact_model(k), flow)
        start = equations.initial_state(np.zeros(3), rotation.from_axis(axis))
        times = jeffery.period(k) * np.arange(periods + 1)
        watch = _Watch(k, axis)
        begin = time.perf_counter()
        run = integrate(equations, start, times, TOLERANCE, on_chunk=watch, chunk_samples=256)
        span = time.perf_counter() - begin
        for name, value in (
            ("drift of the orbit constant", watch.drift),
            ("drift of the axis after whole periods", watch.offset),
        ):
            checks.see(k, periods, name, span, value=value, bound=DRIFT)
        checks.see(k, periods, "| |q| - 1 |", span, value=run.norm_drift, bound=NORM)
    yield checks.table()
