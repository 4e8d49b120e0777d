"""Throughput of a block of bodies over its size, against a loop of SciPy's solve_ivp.

One Jeffery period of massless bodies of k = 1/2 from random orientations, after which each axis is
where it was; one core. SciPy's DOP853 integrates the closed form, a body at a time; each block is
compared with it at the loosest tolerance with which it is at least as accurate.

Run:      python cases/benchmarks/batch.py      (1 min; --small: 3 s; --csv)
Expected: blocks of 1024 over 200 times as fast as the loop.
"""

from functools import partial

import numpy as np
from measure import command, timed
from numpy.typing import NDArray
from step import SHAPE, K, closed_form

import qbxstokes as qs
from qbxstokes.geometry import rotation
from qbxstokes.reference import jeffery

Array = NDArray[np.float64]

TOLERANCE = 1e-8
LOOPED = 8  # trajectories that SciPy integrates one after the other


def scipy_loop(starts, end, rtol):
    """Final axes (n, 3), and right-hand sides of a trajectory."""
    from scipy.integrate import solve_ivp

    def rate(t, y):
        return closed_form(y.tolist(), SHAPE)

    runs = [
        solve_ivp(rate, (0.0, end), start, method="DOP853", rtol=rtol, atol=rtol)
        for start in starts
    ]
    axes = rotation.axis(rotation.normalize(np.array([run.y[3:7, -1] for run in runs])))
    return axes, float(np.mean([run.nfev for run in runs]))


def blocks(sizes, repeats, quaternions):
    """A row per size."""
    times, rows = np.array([0.0, jeffery.period(K)]), []
    body = qs.Body(K, tolerance=1e-12)
    for size in sizes:
        scene = qs.Simulation(
            body, qs.flow("shear"), orientation=quaternions[:size], tolerance=TOLERANCE
        )
        assembled = scene.assemble()
        assembled.equations.evaluation = "compiled"  # also one body alone
        go = partial(assembled.trajectory, times)
        go()  # loads what is compiled
        span, run = timed(go, repeats)
        axes = rotation.axis(run.states[-1][:, 3:7]) - rotation.axis(quaternions[:size])
        row = {"method": "block", "bodies": size, "error": float(np.abs(axes).max())}
        evaluations = run.checkpoint.evaluations
        row |= {"trajectories": size / span, "right_hand_sides": evaluations * size / span}
        rows.append(row)
    return rows


def loops(quaternions, repeats, least):
    """A row per tolerance of SciPy, until its error is the least that is wanted."""
    starts = np.concatenate([np.zeros((LOOPED, 3)), quaternions[:LOOPED]], axis=1)
    rows = []
    for rtol in (10.0 ** np.arange(-6.0, -13.0, -0.5)).tolist():
        go = partial(scipy_loop, starts, jeffery.period(K), rtol)
        span, (axes, evaluations) = timed(go, repeats)
        error = float(np.abs(axes - rotation.axis(starts[:, 3:7])).max())
        row = {"method": f"SciPy, {rtol:.0e}", "bodies": 1, "error": error}
        row |= {"trajectories": LOOPED / span, "right_hand_sides": evaluations * LOOPED / span}
        rows.append(row)
        if error <= least:
            break
    return rows


@command
def main(small=False):
    """Trajectories and right-hand sides per second, at equal error."""
    repeats, sizes = (1, (1, 256)) if small else (5, (1, 4, 16, 64, 256, 1024, 4096, 16384))
    quaternions = rotation.random_quaternions(max(sizes), np.random.default_rng(0))
    rows = blocks(sizes, repeats, quaternions)
    scipy = loops(quaternions, repeats, min(row["error"] for row in rows))
    for row in rows:
        rival = next((loop for loop in scipy if loop["error"] <= row["error"]), scipy[-1])
        row |= {"rival": rival["method"], "ratio": row["trajectories"] / rival["trajectories"]}
    used = {row["rival"] for row in rows}
    kept = [loop | {"rival": None, "ratio": 1.0} for loop in scipy if loop["method"] in used]
    return {"batch": [*kept, *rows]}
