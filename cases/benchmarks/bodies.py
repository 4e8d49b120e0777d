"""A wall and several bodies: errors, iterations, times against what they are to be.

Errors of spheres are against the exact series in bispherical coordinates (Brenner 1961; O'Neill
1964; Jeffrey & Onishi 1984), of spheroids against grids a quarter finer at a hundredth of the
tolerance, relative to the largest entry of the resistance. Times are CPU times of one core.

Run:      python cases/benchmarks/bodies.py      (4 min; --small: 10 s; --csv)
Expected: met; times on a machine with nothing else to do.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from measure import Rows, command, timed

import qbxstokes as qs
from qbxstokes.bie.multiple_scattering import closest
from qbxstokes.geometry import rotation
from qbxstokes.motion.over_wall import rate
from qbxstokes.reference.bispherical import Bispherical, near_wall

UP = qs.Wall(normal=[0.0, 0.0, 1.0])
SHEAR = qs.flow("polynomial", gradient=[[0, 0, 1], [0, 0, 0], [0, 0, 0]])


def row(what: str, measured: float, bar: float) -> dict[str, Any]:
    """A figure beside its bar."""
    return {"what": what, "measured": float(measured), "bar": bar, "met": bool(measured <= bar)}


def relative(found: Any, exact: Any) -> float:
    """Largest difference over the largest entry."""
    return float(np.abs(np.subtract(found, exact)).max() / np.abs(exact).max())


def sphere_by_a_wall(small: bool) -> Rows:
    """All resistances, coupling and loads in shear, relative to themselves (coupling: 6 pi a^2)."""
    rows = []
    cases = ((10.0, 1e-10), (3.0, 1e-10), (1.5430806, 1e-10), (1.5, 1e-10), (1.1, 1e-8))
    for h, bar in cases[:2] if small else (*cases, (1.05, 1e-6)):
        scene, exact = qs.Suspension([qs.Body(1.0)], UP, tolerance=bar), near_wall(h)
        r = scene.resistance([[0, 0, h]])
        force, torque = scene.force_torque(SHEAR, [[0, 0, h]])
        six, eight = 6.0 * np.pi, 8.0 * np.pi
        coupling = Bispherical(1.0, np.inf, h - 1.0).across()[0, 1]
        found = {
            "normal": r[2, 2] / (six * exact["normal"]),
            "parallel": r[0, 0] / (six * exact["parallel"]),
            "rotation_parallel": r[3, 3] / (eight * exact["rotation_parallel"]),
            "rotation_normal": r[5, 5] / (eight * exact["rotation_normal"]),
            "coupling": 1.0 + (abs(r[0, 4]) - abs(coupling)) / six,
            "shear_force": force[0, 0] / (six * h * exact["shear_force"]),
            "shear_torque": torque[0, 1] / (4.0 * np.pi * exact["shear_torque"]),
        }
        name = max(found, key=lambda key: abs(found[key] - 1.0))
        rows.append(row(f"sphere by a wall, h/a = {h:g}: {name}", abs(found[name] - 1.0), bar))
    return rows


def two_spheres(small: bool) -> Rows:
    """All resistance functions of equal spheres, and the speeds at which two fall."""
    rows = []
    cases = ((3.0, 1e-9), (2.5, 1e-9), (2.1, 1e-7))
    for s, bar in cases[:1] if small else cases:
        scene, x = qs.Suspension([qs.Body(1.0)] * 2, tolerance=bar), [[0, 0, 0], [0, 0, s]]
        r, series = scene.resistance(x), Bispherical(1.0, 1.0, s - 2.0)
        parts = (
            ([8, 2], series.along()),
            ([6, 10, 0, 4], series.across()),
            ([11, 5], series.about()),
        )
        worst = max(relative(r[np.ix_(at, at)], exact) for at, exact in parts)
        rows.append(row(f"two spheres, s = {s:g}: all of R", worst, bar))
        rows.append(row(f"two spheres, s = {s:g}: speeds", speeds(scene, s), bar))
    if not small:
        scene = qs.Suspension([qs.Body(1.0)] * 2, tolerance=1e-4)
        rows.append(row("two spheres, s = 2.01: speeds", speeds(scene, 2.01), 1e-4))
        scene, x = qs.Suspension([qs.Body(1.0)] * 2, tolerance=1e-2), [[0, 0, 0], [0, 0, 2.01]]
        held = scene.held(None, x, velocity=[[0, 0, 1], [0, 0, -1]]).force[0, 2]
        exact = Bispherical(1.0, 1.0, 0.01).along()[0] @ [1.0, -1.0]
        rows.append(row("two spheres, s = 2.01: squeezing", abs(held / exact - 1.0), 1e-2))
    return rows


def speeds(scene: qs.Suspension, s: float) -> float:
    """Larger error of the speeds of two equal spheres that fall along and across their line."""
    series, x = Bispherical(1.0, 1.0, s - 2.0), [[0, 0, 0], [0, 0, s]]
    along = np.linalg.solve(series.along(), [1.0, 1.0])[0]
    across = np.linalg.solve(series.across(), [1.0, 0.0, 1.0, 0.0])[0]
    one = scene.free(None, x, force=[0, 0, 1]).velocity[0, 2]
    two = scene.free(None, x, force=[1, 0, 0]).velocity[0, 0]
    return float(max(abs(one / along - 1.0), abs(two / across - 1.0)))


def spheroids(small: bool) -> Rows:
    """Resistances of spheroids by the wall in three tilts, in pairs and triples."""
    rows = []
    for gap, bar in ((0.3, 1e-8),) if small else ((0.3, 1e-8), (0.1, 1e-6)):
        for k in (0.2,) if small else (0.2, 0.5, 2.0):
            worst, uneven = 0.0, 0.0
            for tilt in (0.0, 0.7, 0.5 * np.pi):
                axis = np.array([np.sin(tilt), 0.0, np.cos(tilt)])
                h = np.sqrt(k * k + (1.0 - k * k) * axis[2] ** 2) + gap
                error, asymmetry = compared([qs.Body(k)], UP, [[0, 0, h]], [axis], bar)
                worst, uneven = max(worst, error), max(uneven, asymmetry)
            rows.append(row(f"spheroid k = {k:g} by the wall, gap {gap:g}: R", worst, bar))
            if gap == 0.3:
                rows.append(row(f"spheroid k = {k:g} by the wall: R - R^T", uneven, 1e-9))
    if not small:
        side, up = [[0, 0, 0], [1.3, 0, 0], [0, 1.3, 0]], [[0, 0, 1.0]] * 3
        for count in (2, 3):
            error, _ = compared([qs.Body(0.5)] * count, None, side[:count], up[:count], 1e-8)
            rows.append(row(f"{count} spheroids k = 0.5, gap 0.3: R", error, 1e-8))
    return rows


def compared(bodies: Any, wall: Any, x: Any, axes: Any, tolerance: float) -> tuple[float, float]:
    """Error of a resistance and its asymmetry, relative to the largest entry."""
    scene = qs.Suspension(bodies, wall, tolerance=tolerance)
    finer = qs.Suspension(bodies, wall, tolerance=0.01 * tolerance)
    nodes = [int(1.25 * n) + 2 for n in scene.grids(scene.placed(x, axes))]
    r, exact = scene.resistance(x, axes), finer.resistance(x, axes, nodes=nodes)
    return relative(r, exact), relative(r, r.T)


def iterations(small: bool) -> Rows:
    """GMRES to 1e-8 for two spheroids side by side, of given motion and free.

    An iteration is a product, in which each body's flow is evaluated on the other once.
    """
    rows = []
    for gap, bar in ((0.3, 14.0),) if small else ((0.3, 14.0), (0.1, 25.0)):
        for k in (0.5,) if small else (0.2, 0.5, 1.0, 2.0):
            # The system is solved a hundred times more closely than the tolerance says.
            pair = qs.Suspension([qs.Body(k)] * 2, tolerance=1e-6)
            x = [[0, 0, 0], [2 * k + gap, 0, 0]]
            motion = [[0.3, 0.2, -1.0], [-0.3, 0.1, 0.5]]
            nodes = [20, 20]
            held = pair.held(None, x, velocity=motion, nodes=nodes).iterations
            free = pair.free(SHEAR, x, force=[1, 0, 1], nodes=nodes).iterations
            rows.append(row(f"iterations, k = {k:g}, gap {gap:g}", max(held, free), bar))
    return rows


def motion(small: bool) -> Rows:
    """A pair in shear and back."""
    pair, flow, end = qs.Suspension([qs.Body(0.5)] * 2, tolerance=1e-6), qs.flow("shear"), 2.0
    end = 0.2 if small else end
    x, axes = [[-2.0, 0.3, 0.0], [2.0, -0.3, 0.1]], [[0.6, 0.8, 0.0], [0.0, 0.6, 0.8]]
    there = pair.integrate(flow, [0.0, end], x, axes, tolerance=1e-8)
    last = there.position[-1], there.orientation[-1]
    back = pair.integrate(-flow, [0.0, end], *last, tolerance=1e-8)
    off = max(np.abs(back.position[-1] - x).max(), np.abs(back.axis[-1] - axes).max())
    return [row("a pair in shear and back", off, 1e-7)]


def speed(small: bool) -> Rows:
    """A velocity of a free body by a wall, and of ten bodies at volume fraction 0.1."""
    one = qs.Suspension([qs.Body(0.5)], UP, tolerance=1e-6)
    axis = [[0.8, 0.0, 0.6]]
    place = [[0, 0, np.sqrt(0.25 + 0.75 * 0.36) + 0.3]]

    def free() -> Any:
        return one.free(SHEAR, place, axis)

    free()
    span, _ = timed(free, 2 if small else 15, time.process_time)
    rows = [row("free body by a wall, gap 0.3, 1e-6: s", span, 0.02)]
    x, q, load = ten(0.1)
    exact = None
    for tolerance, bar in ((1e-4, 0.2),) if small else ((1e-8, 0.0), (1e-4, 0.2), (1e-6, 2.0)):
        scene = qs.Suspension([qs.Body(0.5)] * 10, tolerance=tolerance)

        def solve(scene: qs.Suspension = scene) -> Any:
            return scene.free(None, x, q, force=load)

        found = solve().velocity
        if tolerance == 1e-8:
            exact = found
            continue
        span, _ = timed(solve, 1 if small else 5, time.process_time)
        rows.append(row(f"ten bodies, {tolerance:.0e}: s", span, bar))
        if exact is not None:
            error = relative(found, exact)
            rows.append(row(f"ten bodies, {tolerance:.0e}: error", error, tolerance))
    return rows


def table(small: bool) -> Rows:
    """One body over a wall from a table: a velocity in blocks, and dy/dt one by one."""
    body, count = qs.Body(0.5), 10_000 if small else 200_000
    cells, rng = qs.OverWall(body, UP, tolerance=1e-4), np.random.default_rng(0)
    x = np.array([0.0, 0.0, 1.6]) + rng.uniform(0.0, 0.1, (count, 1)) * [0.0, 0.0, 1.0]
    axes, terms = rotation.random_axes(count, rng), cells.flow_terms(SHEAR)

    def block() -> Any:
        return cells.motion(terms, x, axes)

    block()
    span, _ = timed(block, 2, time.process_time)
    rows = [row("table: a velocity in blocks: s", span / count, 1e-6)]
    c, y, out = (
        cells.constants(terms, np.zeros(6)),
        np.array([0, 0, 1.6, 0.9, 0, 0.4, 0]),
        np.empty(7),
    )
    # What PETSc calls without Python in between, here with it.
    numbers = c.load, c.plane, c.ratio, c.size, c.terms, c.first, c.cells, c.pieces
    calls = 100 if small else 20_000

    def one_by_one() -> None:
        for _ in range(calls):
            rate(y, *numbers, out)

    one_by_one()
    span, _ = timed(one_by_one, 3, time.process_time)
    rows.append(row("table: a right-hand side of one body: s", span / calls, 1e-5))
    return rows


def two_ranks(_: bool) -> Rows:
    """A motion of twelve bodies on two ranks, against two runs of it on one rank each, at once.

    Time of the one over half that of the two, which share two cores as it does; and its CPU time
    over that of one of the two: 1 where the ranks neither wait awake nor do anything twice.
    """
    x, q, load = ten(0.05, 12, 0.3)
    parts = zip(x.tolist(), q.tolist(), load.tolist(), strict=True)
    case = {
        "bodies": [
            {
                "aspect_ratio": 0.5,
                "start": {"position": at, "orientation": {"quaternion": turn}},
                "forces": {"force": force},
            }
            for at, turn, force in parts
        ],
        "flow": {"type": "shear"},
        "hydrodynamics": {"tolerance": 1e-5},
        "time": {"end": 2.0, "samples": 3, "tolerance": 1e-5},
    }
    run = [sys.executable, "-m", "qbxstokes", "case.json", "--quiet", "--overwrite", "-o"]
    both = ["mpirun", "-n", "2", "--oversubscribe", "--allow-run-as-root", *run, "c.h5"]
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "case.json").write_text(json.dumps(case))

        def spent(commands: list[list[str]]) -> np.ndarray:
            begin, before = time.perf_counter(), sum(os.times()[2:4])
            running = [subprocess.Popen(command, cwd=folder) for command in commands]
            if any(process.wait() for process in running):
                raise SystemExit("a run failed")
            return np.array([time.perf_counter() - begin, sum(os.times()[2:4]) - before])

        spent([[*run, "a.h5"]])  # compiles what is not yet
        alone, shared = spent([[*run, "a.h5"], [*run, "b.h5"]]), spent([both])
    named = f"twelve bodies on two ranks ({shared[0]:.1f} s): "
    wall, cpu = 2.0 * shared / alone
    return [row(named + "time", wall, 1.0 / 0.9), row(named + "CPU time", cpu, np.inf)]


def ten(
    share: float, count: int = 10, least: float = 0.12
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centres, quaternions and forces of ten spheroids k = 1/2 at a volume fraction."""
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


def main(small: bool = False) -> dict[str, Rows]:
    """A table of each kind."""
    parts = [sphere_by_a_wall, two_spheres, spheroids, iterations, motion, speed, table]
    parts += [] if small else [two_ranks]
    return {part.__name__: part(small) for part in parts}


if __name__ == "__main__":
    command(main)
