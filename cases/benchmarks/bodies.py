"""Bodies that share a fluid, and one above a wall: what a velocity takes beside its bar.

CPU times of one core; accuracy and iterations have their bars in tests/stress/test_bodies.py,
ranks their case, twelve_bodies.yaml.

Run:      python cases/benchmarks/bodies.py      (1 min; --small: 10 s; --csv)
Expected: met, on a machine with nothing else to do.
"""

import time
from functools import partial

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


@command
def main(small=False):
    """Both tables."""
    return {"solved": solved(small), "table": table(small)}
