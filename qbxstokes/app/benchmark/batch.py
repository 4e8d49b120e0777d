"""Throughput of a block of bodies over its size, against a loop of SciPy's solve_ivp."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from qbxstokes.app.benchmark.step import closed_form
from qbxstokes.app.benchmark.timing import peak_memory, timed
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


def scipy_loop(starts: Array, end: float, rtol: float) -> tuple[Array, float, float]:
    """Final axes (n, 3) by DOP853 on the closed form, one body at a time.

    Also the mean numbers of right-hand sides and of steps of a trajectory.
    """
    from scipy.integrate import solve_ivp

    shape = (1.0 - ASPECT_RATIO**2) / (1.0 + ASPECT_RATIO**2)
    axes, evaluations, steps = np.empty((len(starts), 3)), 0, 0
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
        steps += len(found.t) - 1
    return axes, evaluations / len(starts), steps / len(starts)


@dataclass(frozen=True)
class Row:
    """Bodies integrated together, trajectories in all, error, seconds, and counts for each."""

    method: str
    bodies: int
    count: int
    error: float
    span: float
    evaluations: float
    steps: float
    memory: float | None

    @property
    def rate(self) -> float:
        """Trajectories per second."""
        return self.count / self.span

    def rival(self, loops: Sequence[Row]) -> Row:
        """The first of others, from loose to tight, that is as accurate; the last if none is."""
        return next((loop for loop in loops if loop.error <= self.error), loops[-1])


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
            Column("ratio", "", "trajectories per second over SciPy's at no larger error", ".3g"),
            Column("steps", "", "accepted, of a trajectory or a block", "d"),
            Column("memory", "MB", "peak of one integration", ".3g"),
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
    rows: list[Row] = []
    for size in sizes:
        work.say(f"block of {size}")
        equations = RigidBodyEquations(model, Shear(), 0.0, size, evaluation="compiled")
        start = equations.initial_state(np.zeros(3), quaternions[:size])
        go = partial(integrate, equations, start, [0.0, end], TOLERANCE)
        if size == sizes[0]:
            go()  # loads what is compiled
        held = peak_memory(go)
        span, run = timed(go, work.choose(1, work.section.repeats))
        error = float(np.abs(rotation.axis(run.states[-1][:, 3:7]) - exact[:size]).max())
        rows.append(Row("block", size, size, error, span, run.evaluations, run.steps, held))
    count = min(_LOOPED, max(sizes))
    starts = np.concatenate([np.zeros((count, 3)), quaternions[:count]], axis=1)
    loops: list[Row] = []
    for rtol in 10.0 ** np.arange(-6.0, -13.0, -0.5):
        work.say(f"SciPy, tolerance {rtol:.0e}")
        loop = partial(scipy_loop, starts, end, float(rtol))
        held = peak_memory(loop)
        span, (axes, *counts) = timed(loop, work.choose(1, work.section.repeats))
        error = float(np.abs(axes - exact[:count]).max())
        name = f"SciPy loop, {rtol:.0e}"
        loops.append(Row(name, 1, count, error, span, counts[0], counts[1], held))
        if error <= min(row.error for row in rows):
            break
    rivals = {row.method + str(row.bodies): row.rival(loops) for row in rows}
    for row in (*dict.fromkeys(rivals.values()), *rows):
        base = rivals.get(row.method + str(row.bodies), row)
        table.add(
            method=row.method,
            bodies=row.bodies,
            error=row.error,
            trajectories=row.rate,
            evaluations=row.evaluations * row.rate,
            ratio=row.rate / base.rate,
            steps=round(row.steps),
            memory=row.memory,
        )
    table.notes.append(
        f"SciPy's DOP853 integrates the closed form for {count} of the orientations; each block is "
        "compared with it at the loosest tolerance with which it is at least as accurate."
    )
    yield table
