"""Throughput of a block of bodies over its size, against a loop of SciPy's solve_ivp."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from qbxstokes.app.benchmark.step import closed_form
from qbxstokes.bie.accuracy import accurate_body
from qbxstokes.flows.named import Shear
from qbxstokes.geometry import rotation
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.io.tables import Column, Table
from qbxstokes.motion.equations import RigidBodyEquations
from qbxstokes.reference import jeffery

if TYPE_CHECKING:
    from qbxstokes.app.tabulate import Work

Array = NDArray[np.float64]

ASPECT_RATIO = 0.5
TOLERANCE = 1e-8
_LOOPED = 8  # trajectories that SciPy integrates one after the other


def scipy_loop(starts: Array, end: float, rtol: float) -> tuple[Array, int]:
    """Final axes (n, 3) by DOP853 on the closed form, one body at a time; right-hand sides."""
    from scipy.integrate import solve_ivp

    shape = (1.0 - ASPECT_RATIO**2) / (1.0 + ASPECT_RATIO**2)
    axes, evaluations = np.empty((len(starts), 3)), 0
    for index, start in enumerate(starts):
        found = solve_ivp(
            lambda t, y: closed_form(y.tolist(), shape),
            (0.0, end),
            start,
            method="DOP853",
            rtol=rtol,
            atol=rtol,
        )
        axes[index] = rotation.axis(rotation.normalize(found.y[3:7, -1]))
        evaluations += int(found.nfev)
    return axes, evaluations


def tables(work: Work) -> Iterator[Table]:
    """Trajectories per second and right-hand sides per second, at equal error."""
    from qbxstokes.petsc.stepper import integrate

    table = Table(
        "batch",
        "Throughput of a block: one Jeffery period (k = 1/2), random orientations",
        (
            Column("method"),
            Column("bodies", "", "in a block", "d"),
            Column("error", "", "largest of the axes at the end", ".0e"),
            Column("trajectories", "1/s", "per second and core", ".3g"),
            Column("evaluations", "1/s", "right-hand sides of a trajectory", ".2e"),
            Column("ratio", "", "trajectories per second over SciPy's", ".3g"),
        ),
        plot={"x": "bodies", "y": "trajectories", "by": "method", "scale": "loglog"},
    )
    k = ASPECT_RATIO
    model = accurate_body(Spheroid(k), 1e-12).model
    end = jeffery.period(k)
    sizes = work.choose((1, 256), (1, 4, 16, 64, 256, 1024, 4096, 16384))
    rng = np.random.default_rng(0)
    quaternions = rotation.random_quaternions(max(sizes), rng)
    exact = rotation.axis(quaternions)  # after a whole period the axes are where they were
    rows: list[tuple[str, int, float, float, int]] = []
    for size in sizes:
        work.say(f"block of {size}")
        equations = RigidBodyEquations(model, Shear(), 0.0, size)
        start = equations.initial_state(np.zeros(3), quaternions[:size])
        integrate(equations, start, [0.0, 0.01 * end], TOLERANCE)  # load what is compiled
        spans = []
        for _ in range(work.choose(1, min(3, work.section.repeats))):
            begin = time.perf_counter()
            run = integrate(equations, start, [0.0, end], TOLERANCE)
            spans.append(time.perf_counter() - begin)
        found = rotation.axis(run.states[-1][:, 3:7])
        error = float(np.abs(found - exact[:size]).max())
        span = sorted(spans)[len(spans) // 2]
        rows.append(("block", size, error, span, run.evaluations * size))
    worst = max(row[2] for row in rows)
    # SciPy is given the loosest tolerance with which it is as accurate as the worst block.
    count = min(_LOOPED, max(sizes))
    starts = np.concatenate([np.zeros((count, 3)), quaternions[:count]], axis=1)
    for rtol in 10.0 ** np.arange(-5.0, -13.0, -0.5):
        begin = time.perf_counter()
        axes, evaluations = scipy_loop(starts, end, float(rtol))
        span = time.perf_counter() - begin
        error = float(np.abs(axes - exact[:count]).max())
        if error <= worst:
            break
    rows.insert(0, ("SciPy DOP853, loop", 1, error, span, evaluations))
    base = count / span
    for method, size, error, span, evaluations in rows:
        trajectories = count if method != "block" else size
        table.add(
            method=method,
            bodies=size,
            error=error,
            trajectories=trajectories / span,
            evaluations=evaluations / span,
            ratio=trajectories / span / base,
        )
    table.notes.append(
        f"SciPy integrates the closed form for {count} of the orientations, at the loosest "
        "tolerance with which it is as accurate as the least accurate block."
    )
    yield table
