"""Bodies that share a fluid, and one above a wall: what a velocity takes beside its bar.

CPU times of one core; accuracy and iterations have their bars in tests/stress/test_bodies.py.

Run:      python cases/benchmarks/bodies.py      (3 min; --small: 10 s; --csv)
Expected: met, on a machine with nothing else to do.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

import numpy as np
from measure import command, timed

import qbxstokes as qs
from qbxstokes.bie.multiple_scattering import closest
from qbxstokes.geometry import rotation
from qbxstokes.motion.over_wall import rate

UP = qs.Wall(normal=[0.0, 0.0, 1.0])
SHEAR = qs.flow("polynomial", gradient=[[0, 0, 1], [0, 0, 0], [0, 0, 0]])


def row(what, measured, bar):
    """A figure beside its bar."""
    return {"what": what, "measured": float(measured), "bar": bar, "met": bool(measured <= bar)}


def scattered(share, count=10, least=0.12):
    """Centres, quaternions and forces of spheroids k = 1/2 at a volume fraction."""
    rng = np.random.default_rng(0)
    side = (count * 4.0 * np.pi / 3.0 * 0.25 / share) ** (1.0 / 3.0)
    x, q = np.zeros((0, 3)), np.zeros((0, 4))
    while len(x) < count:
        more = np.vstack([x, rng.uniform(0.0, side, 3)])
        turns = np.vstack([q, rotation.random_quaternions(1, rng)])
        places = qs.Suspension([qs.Body(0.5)] * len(more)).placed(more, turns)
        if closest(places, None)[0] > least:
            x, q = more, turns
    return x, q, rng.normal(size=(count, 3))


def solved(small):
    """A velocity of a free body by a wall, and of ten bodies at volume fraction 0.1."""
    one = qs.Suspension([qs.Body(0.5)], UP, tolerance=1e-6)
    place = [[0, 0, np.sqrt(0.25 + 0.75 * 0.36) + 0.3]]
    free = partial(one.free, SHEAR, place, [[0.8, 0.0, 0.6]])
    free()
    span, _ = timed(free, 2 if small else 15, time.process_time)
    rows = [row("free body by a wall, gap 0.3, 1e-6: s", span, 0.02)]
    x, q, load = scattered(0.1)
    many = {t: qs.Suspension([qs.Body(0.5)] * 10, tolerance=t) for t in (1e-4, 1e-6, 1e-8)}
    exact = many[1e-6 if small else 1e-8].free(None, x, q, force=load).velocity
    for tolerance, bar in ((1e-4, 0.2),) if small else ((1e-4, 0.2), (1e-6, 2.0)):
        solve = partial(many[tolerance].free, None, x, q, force=load)
        error = np.abs(solve().velocity - exact).max() / np.abs(exact).max()
        span, _ = timed(solve, 1 if small else 5, time.process_time)
        rows.append(row(f"ten bodies, {tolerance:.0e}: s", span, bar))
        rows.append(row(f"ten bodies, {tolerance:.0e}: error", error, tolerance))
    return rows


def table(small):
    """One body over a wall from a table: a velocity in blocks, and dy/dt one by one."""
    body, count, calls = qs.Body(0.5), *((10_000, 100) if small else (200_000, 20_000))
    cells, rng = qs.OverWall(body, UP, tolerance=1e-4), np.random.default_rng(0)
    x = np.array([0.0, 0.0, 1.6]) + rng.uniform(0.0, 0.1, (count, 1)) * [0.0, 0.0, 1.0]
    axes, terms = rotation.random_axes(count, rng), cells.flow_terms(SHEAR)
    block = partial(cells.motion, terms, x, axes)
    block()  # makes the cells
    c, out = cells.constants(terms, np.zeros(6)), np.empty(7)
    y = np.array([0, 0, 1.6, 0.9, 0, 0.4, 0])
    # What PETSc calls without Python in between, here with it.
    numbers = c.load, c.plane, c.ratio, c.size, c.terms, c.first, c.cells, c.pieces

    def one_by_one():
        for _ in range(calls):
            rate(y, *numbers, out)

    one_by_one()  # compiles
    blocks, _ = timed(block, 2, time.process_time)
    single, _ = timed(one_by_one, 3, time.process_time)
    return [
        row("table: a velocity in blocks: s", blocks / count, 1e-6),
        row("table: a right-hand side of one body: s", single / calls, 1e-5),
    ]


def neared(x, q, gap):
    """The same centres, but for the nearest two of the bodies, now at a gap."""
    places = qs.Suspension([qs.Body(0.5)] * len(x)).placed
    b, c = closest(places(x, q), None)[1]
    way, x = (x[b] - x[c]) / np.linalg.norm(x[b] - x[c]), x.copy()
    for _ in range(40):
        x[b] -= 0.7 * (closest(places(x, q), None)[0] - gap) * way
    return x


def two_ranks():
    """Motions of twelve bodies on two ranks, against two runs of it on one rank each, at once.

    Time of the one over half that of the two, which share two cores as it does; and its CPU time
    over that of one of the two: 1 where the ranks neither wait awake nor do anything twice. In the
    second scene two bodies are near each other and have by far the finest grids.
    """
    x, q, force = scattered(0.05, 12, 0.3)
    return compared("", x, q, force, 2.0) + compared(
        ", two near", neared(x, q, 0.06), q, force, 0.1
    )


def compared(named, x, q, force, end):
    """Rows of one scene, see `two_ranks`."""
    bodies = [
        {
            "aspect_ratio": 0.5,
            "start": {"position": at, "orientation": {"quaternion": turn}},
            "forces": {"force": load},
        }
        for at, turn, load in zip(x.tolist(), q.tolist(), force.tolist(), strict=True)
    ]
    case = {
        "bodies": bodies,
        "flow": {"type": "shear"},
        "hydrodynamics": {"tolerance": 1e-5},
        "time": {"end": end, "samples": 3, "tolerance": 1e-5},
    }
    run = [sys.executable, "-m", "qbxstokes", "case.json", "--quiet", "--overwrite", "-o"]
    both = ["mpirun", "-n", "2", "--oversubscribe", "--allow-run-as-root", *run, "c.h5"]
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "case.json").write_text(json.dumps(case))

        def spent(*commands):
            begin, before = time.perf_counter(), sum(os.times()[2:4])
            running = [subprocess.Popen(command, cwd=folder) for command in commands]
            if any(process.wait() for process in running):
                raise SystemExit("a run failed")
            return np.array([time.perf_counter() - begin, sum(os.times()[2:4]) - before])

        spent([*run, "a.h5"])  # compiles what is not yet
        alone, shared = spent([*run, "a.h5"], [*run, "b.h5"]), spent(both)
    named = f"twelve bodies{named} on two ranks ({shared[0]:.1f} s): "
    wall, cpu = 2.0 * shared / alone
    return [row(named + "time", wall, 1.0 / 0.9), row(named + "CPU time", cpu, np.inf)]


@command
def main(small=False):
    """The tables."""
    found = {"solved": solved(small), "table": table(small)}
    return found if small else found | {"two_ranks": two_ranks()}
