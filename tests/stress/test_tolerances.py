"""Do motions and ensembles keep their tolerance in flows that change? RUNS=200 follows so many.

One spheroid, k log-uniform in [1/50, 50], St = 0 or log-uniform in [1e-2, 1e3], tolerance in
[1e-10, 1e-4], over T = 10 in a gradient of five cosines: as a function, sampled with linear
interpolation, held from sample to sample, or a pulse of width 0.02 to 0.2 in a fluid at rest. The
axis at the end, of `Body.integrate` (PETSc TS) and of an ensemble, against ensembles at 1e-12,
which are another method (held against SciPy's DOP853 in tests/test_ensemble.py). And in flows of
five distant stokeslets that the program knows nothing of, against a thousandth of the tolerance.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from conftest import See

import qbxstokes as qs
from qbxstokes.simulation.ensemble import Ensemble

END = 10.0
FREQUENCY = np.array([0.4, 0.9, 1.5, 2.3, 3.1])
RUNS = int(os.environ.get("RUNS", 8))
KINDS = ("smooth", "linear", "hold", "pulse")


def scene(seed: int) -> tuple[Any, ...]:
    """Body, axis, flow, its samples and the tolerance."""
    rng, kind = np.random.default_rng(seed), KINDS[seed % 4]
    k, tolerance = float(50.0 ** rng.uniform(-1, 1)), float(10.0 ** rng.uniform(-10, -4))
    stokes = 0.0 if rng.uniform() < 0.5 else float(10.0 ** rng.uniform(-2, 3))
    axis = rng.normal(size=3)
    a = 0.25 * rng.normal(size=(5, 3, 3))
    a -= np.trace(a, axis1=1, axis2=2)[:, None, None] * np.eye(3) / 3.0
    phase, width = rng.uniform(0.0, 6.28, 5), float(10.0 ** rng.uniform(-1.7, -0.7))
    middle, height = rng.uniform(1.0, 9.0), rng.uniform(3.0, 30.0)

    def gradient(t: float) -> Any:
        if kind == "pulse":
            return height * np.exp(-(((t - middle) / width) ** 2)) * a[0]
        return np.einsum("n,nij->ij", np.cos(FREQUENCY * t + phase), a)

    count = {"smooth": 2001, "pulse": int(60.0 * END / width)}.get(kind, 101)
    times = np.linspace(0.0, END, count)
    rule = kind if kind in ("linear", "hold") else "sextic"
    samples = [gradient(t) for t in times]
    series = qs.GradientSeries(times, [samples], interpolation=rule)
    keys: dict[str, Any] = {"longest_step": width} if kind == "pulse" else {}
    given = series.path(0) if rule == kind else gradient
    flow = qs.flow("linear", gradient=given, **keys)
    body = qs.Body(k, stokes_number=stokes)
    return body, axis / np.linalg.norm(axis), flow, series, tolerance


@pytest.mark.slow
@pytest.mark.parametrize("kind", range(4), ids=KINDS)
def test_motions_and_ensembles_keep_their_tolerance(see: See, kind: int) -> None:
    """Errors over the tolerance: 10 are allowed to a motion, 1 to an ensemble."""
    for seed in range(kind, RUNS, 4):
        body, axis, flow, series, tolerance = scene(seed)
        exact, paths = (
            Ensemble((body,), series, axis, tolerance=asked).follow(0)[1][0, 0]
            for asked in (1e-12, tolerance)
        )
        end = body.integrate(flow, [END], orientation=axis, tolerance=tolerance).axis[-1]
        where = f"seed {seed}, St = {body.stokes_number:g}, tolerance {tolerance:.0e}"
        see(np.abs(end - exact).max() / tolerance, 10.0, f"motion, {where}")
        see(np.abs(paths - exact).max() / tolerance, 1.0, f"ensemble, {where}")


def stokeslets(rng: np.random.Generator, scale: float, steady: bool) -> Callable[..., Any]:
    """A flow of five at 1.5 to 2.5 of its scale, zero at the origin; strengths may turn."""
    places, forces = rng.normal(size=(2, 5, 3))
    places *= scale * rng.uniform(1.5, 2.5, (5, 1)) / np.linalg.norm(places, axis=1)[:, None]
    turning = 0.0 * places[:, 0] if steady else rng.uniform(0.2, 2.0, 5)

    def each(d: Any) -> Any:
        r = np.linalg.norm(d, axis=-1, keepdims=True)
        return forces / r + d * np.sum(d * forces, -1, keepdims=True) / r**3

    def flow(x: Any, t: float) -> Any:
        found = each(x[:, None] - places) - each(-places)
        return 0.5 * scale**2 * np.sum(found * np.cos(turning * t)[:, None], axis=1)

    return flow


@pytest.mark.slow
def test_flows_of_a_users_function_keep_their_tolerance(see: See) -> None:
    """Axis, and place relative to the way if that is longer than the body: ten tolerances."""
    for seed in range(max(6, RUNS // 5)):
        rng = np.random.default_rng(seed)
        k, tolerance = float(40.0 ** rng.uniform(-1.0, 1.0)), float(10.0 ** -rng.uniform(4, 8))
        scale = max(1.0, k) * float(6.0 * 25.0 ** rng.uniform())
        flow = qs.flow("user", function=stokeslets(rng, scale, seed % 2 == 0), length=scale)
        body, end = qs.Body(k, stokes_number=[0.0, 0.0, 3.0][seed % 3]), float(rng.uniform(3, 9))
        motion, true = (
            body.integrate(flow, [end], orientation=[0.48, 0.6, 0.64], tolerance=accepted)
            for accepted in (tolerance, max(1e-3 * tolerance, 1e-12))
        )
        way = max(1.0, float(np.linalg.norm(true.position[-1])))
        error = np.linalg.norm(motion.position[-1] - true.position[-1]) / way
        error = max(float(error), float(np.abs(motion.axis[-1] - true.axis[-1]).max()))
        where = f"k = {k:.3g}, scale {scale:.3g}, tolerance {tolerance:.0e}"
        see(error / tolerance, 10.0, f"{where}, {motion.summary['method']}")


@pytest.mark.slow
def test_steps_are_as_long_as_the_tolerance_allows(see: See) -> None:
    """Where the step is not the longest one, a thousandth of the tolerance is used at least.

    Of the axis or, with inertia, of the rates, which are to be known to it as well: those of stiff
    bodies hold the steps, while drag makes little of their errors in the axis.
    """
    times = np.linspace(0.0, END, 41)
    for seed in range(0, RUNS, 4):
        body, axis, flow, _, tolerance = scene(seed)
        one, exact = (
            body.integrate(flow, times, orientation=axis, tolerance=asked)
            for asked in (tolerance, max(tolerance / 3000.0, 2e-13))
        )
        if one.steps <= 55:
            continue
        rate = np.linalg.norm(flow.gradient(np.zeros(3)))
        off = np.abs(one.axis - exact.axis).max()
        if body.stokes_number:
            off = max(off, np.abs(one.angular_velocity - exact.angular_velocity).max() / rate)
        see(1e-3 * tolerance / off, 1.0, f"a thousandth over the error, seed {seed}")
