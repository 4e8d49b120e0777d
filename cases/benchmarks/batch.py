"""Throughput of a block of bodies over its size, against a loop of SciPy's solve_ivp.

One Jeffery period of massless bodies of k = 1/2 from random orientations, after which each axis is
where it was; one core. SciPy's DOP853 integrates the closed form, a body at a time; each block is
compared with it at the loosest tolerance with which it is at least as accurate.

Run:      python cases/benchmarks/batch.py      (1 min; --small: 3 s; --csv)
Expected: blocks of 1024 over 200 times as fast as the loop.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from measure import Rows, command, timed
from numpy.typing import NDArray
from step import SHAPE, K, closed_form

from qbxstokes.bie.accuracy import accurate_body
from qbxstokes.flows.named import Shear
from qbxstokes.geometry import rotation
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.motion.equations import RigidBodyEquations
from qbxstokes.petsc import session
from qbxstokes.reference import jeffery

Array = NDArray[np.float64]

TOLERANCE = 1e-8
LOOPED = 8  # trajectories that SciPy integrates one after the other


def scipy_loop(starts: Array, end: float, rtol: float) -> tuple[Array, float, float]:
    """Final axes (n, 3), right-hand sides and steps of a trajectory."""
    from scipy.integrate import solve_ivp

    def rate(t: float, y: Array) -> tuple[float, ...]:
        return closed_form(y.tolist(), SHAPE)

    runs = [
        solve_ivp(rate, (0.0, end), start, method="DOP853", rtol=rtol, atol=rtol)
        for start in starts
    ]
    axes = rotation.axis(rotation.normalize(np.array([run.y[3:7, -1] for run in runs])))
    evaluations, steps = ([run.nfev for run in runs], [len(run.t) - 1 for run in runs])
    return axes, float(np.mean(evaluations)), float(np.mean(steps))


def main(small: bool = False) -> dict[str, Rows]:
    """Trajectories and right-hand sides per second, at equal error."""
    session.start([])
    from qbxstokes.petsc.stepper import integrate

    repeats, sizes = (1, (1, 256)) if small else (5, (1, 4, 16, 64, 256, 1024, 4096, 16384))
    model, end = accurate_body(Spheroid(K), 1e-12).model, jeffery.period(K)
    quaternions = rotation.random_quaternions(max(sizes), np.random.default_rng(0))
    exact = rotation.axis(quaternions)
    rows: Rows = []
    for size in sizes:
        equations = RigidBodyEquations(model, Shear(), 0.0, size, evaluation="compiled")
        start = equations.initial_state(np.zeros(3), quaternions[:size])
        go = partial(integrate, equations, start, [0.0, end], TOLERANCE)
        if size == sizes[0]:
            go()  # loads what is compiled
        span, run = timed(go, repeats)
        error = float(np.abs(rotation.axis(run.states[-1][:, 3:7]) - exact[:size]).max())
        row = {"method": "block", "bodies": size, "error": error, "trajectories": size / span}
        rows.append(row | {"right_hand_sides": run.evaluations * size / span, "steps": run.steps})
    starts = np.concatenate([np.zeros((LOOPED, 3)), quaternions[:LOOPED]], axis=1)
    loops: Rows = []
    for rtol in (10.0 ** np.arange(-6.0, -13.0, -0.5)).tolist():
        span, (axes, evaluations, steps) = timed(partial(scipy_loop, starts, end, rtol), repeats)
        rate, error = LOOPED / span, float(np.abs(axes - exact[:LOOPED]).max())
        row = {"method": f"SciPy, {rtol:.0e}", "bodies": 1, "error": error, "trajectories": rate}
        loops.append(row | {"right_hand_sides": evaluations * rate, "steps": round(steps)})
        if error <= min(row["error"] for row in rows):
            break
    for row in rows:
        rival = next((loop for loop in loops if loop["error"] <= row["error"]), loops[-1])
        row |= {"rival": rival["method"], "ratio": row["trajectories"] / rival["trajectories"]}
    used = {row["rival"] for row in rows}
    loops = [loop | {"rival": None, "ratio": 1.0} for loop in loops if loop["method"] in used]
    return {"batch": [*loops, *rows]}


if __name__ == "__main__":
    command(main)
