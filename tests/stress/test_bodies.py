"""A wall and several bodies against what they are to be: errors, GMRES iterations, the way back.

Errors of spheres are against the exact series in bispherical coordinates (Brenner 1961; O'Neill
1964; Jeffrey & Onishi 1984), of spheroids against grids a quarter finer at a hundredth of the
tolerance, relative to the largest entry of the resistance. FULL=1 looks at the closest as well, and
at three: a minute more.
"""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import pytest
from conftest import See

import qbxstokes as qs
from qbxstokes.reference.bispherical import Bispherical, near_wall

FULL = "FULL" in os.environ
UP = qs.Wall(normal=[0.0, 0.0, 1.0])
SHEAR = qs.flow("polynomial", gradient=[[0, 0, 1], [0, 0, 0], [0, 0, 0]])


def relative(found: Any, exact: Any) -> float:
    """Largest difference over the largest entry."""
    return float(np.abs(np.subtract(found, exact)).max() / np.abs(exact).max())


@pytest.mark.slow
def test_sphere_by_a_wall(see: See) -> None:
    """All resistances, coupling and loads in shear, relative to themselves (coupling: 6 pi a^2)."""
    six, eight = 6.0 * np.pi, 8.0 * np.pi
    far = (10.0, 1e-10), (3.0, 1e-10), (1.5430806, 1e-10), (1.5, 1e-10)
    for h, bar in (*far, (1.1, 1e-8), (1.05, 1e-6)) if FULL else far:
        scene, exact = qs.Suspension([qs.Body(1.0)], UP, tolerance=bar), near_wall(h)
        r = scene.resistance([[0, 0, h]])
        force, torque = scene.force_torque(SHEAR, [[0, 0, h]])
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
        for name, ratio in found.items():
            see(abs(ratio - 1.0), bar, f"h/a = {h:g}: {name}")


def speeds(scene: qs.Suspension, s: float) -> float:
    """Larger error of the speeds of two equal spheres that fall along and across their line."""
    series, x = Bispherical(1.0, 1.0, s - 2.0), [[0, 0, 0], [0, 0, s]]
    along = np.linalg.solve(series.along(), [1.0, 1.0])[0]
    across = np.linalg.solve(series.across(), [1.0, 0.0, 1.0, 0.0])[0]
    one = scene.free(None, x, force=[0, 0, 1]).velocity[0, 2]
    two = scene.free(None, x, force=[1, 0, 0]).velocity[0, 0]
    return float(max(abs(one / along - 1.0), abs(two / across - 1.0)))


@pytest.mark.slow
def test_two_spheres(see: See) -> None:
    """All resistance functions of equal spheres, and the speeds at which two fall."""
    for s, bar in ((3.0, 1e-9), (2.5, 1e-9), (2.1, 1e-7))[: None if FULL else 2]:
        scene, x = qs.Suspension([qs.Body(1.0)] * 2, tolerance=bar), [[0, 0, 0], [0, 0, s]]
        r, series = scene.resistance(x), Bispherical(1.0, 1.0, s - 2.0)
        for at, exact in (
            ([8, 2], series.along()),
            ([6, 10, 0, 4], series.across()),
            ([11, 5], series.about()),
        ):
            see(relative(r[np.ix_(at, at)], exact), bar, f"s = {s:g}: R of {at}")
        see(speeds(scene, s), bar, f"s = {s:g}: speeds")
    if not FULL:
        return
    scene, x = qs.Suspension([qs.Body(1.0)] * 2, tolerance=1e-4), [[0, 0, 0], [0, 0, 2.01]]
    see(speeds(scene, 2.01), 1e-4, "s = 2.01: speeds")
    scene = qs.Suspension([qs.Body(1.0)] * 2, tolerance=1e-2)
    held = scene.held(None, x, velocity=[[0, 0, 1], [0, 0, -1]]).force[0, 2]
    exact = Bispherical(1.0, 1.0, 0.01).along()[0] @ [1.0, -1.0]
    see(abs(held / exact - 1.0), 1e-2, "s = 2.01: squeezing")


def compared(bodies: Any, wall: Any, x: Any, axes: Any, tolerance: float) -> tuple[float, float]:
    """Error of a resistance and its asymmetry, relative to the largest entry."""
    scene = qs.Suspension(bodies, wall, tolerance=tolerance)
    finer = qs.Suspension(bodies, wall, tolerance=0.01 * tolerance)
    nodes = [int(1.25 * n) + 2 for n in scene.grids(scene.placed(x, axes))]
    r, exact = scene.resistance(x, axes), finer.resistance(x, axes, nodes=nodes)
    return relative(r, exact), relative(r, r.T)


@pytest.mark.slow
@pytest.mark.parametrize(("gap", "bar"), [(0.3, 1e-8), (0.1, 1e-6)] if FULL else [(0.3, 1e-8)])
def test_spheroids_by_a_wall(see: See, gap: float, bar: float) -> None:
    """Resistances in three tilts."""
    for k in (0.2, 0.5, 2.0):
        for tilt in (0.0, 0.7, 0.5 * np.pi):
            axis = np.array([np.sin(tilt), 0.0, np.cos(tilt)])
            h = np.sqrt(k * k + (1.0 - k * k) * axis[2] ** 2) + gap
            error, asymmetry = compared([qs.Body(k)], UP, [[0, 0, h]], [axis], bar)
            see(error, bar, f"k = {k:g}, tilt {tilt:.1f}: R")
            if gap == 0.3:
                see(asymmetry, 1e-9, f"k = {k:g}, tilt {tilt:.1f}: R - R^T")


@pytest.mark.slow
@pytest.mark.parametrize("count", [2, 3] if FULL else [2])
def test_spheroids_side_by_side(see: See, count: int) -> None:
    side, up = [[0, 0, 0], [1.3, 0, 0], [0, 1.3, 0]], [[0, 0, 1.0]] * 3
    error, _ = compared([qs.Body(0.5)] * count, None, side[:count], up[:count], 1e-8)
    see(error, 1e-8, f"{count} spheroids k = 0.5, gap 0.3: R")


@pytest.mark.slow
@pytest.mark.parametrize(("gap", "bar"), [(0.3, 14), (0.1, 25)])
def test_iterations_are_few(see: See, gap: float, bar: int) -> None:
    """GMRES to 1e-8 for two spheroids side by side and one by a wall, of given motion and free."""
    for k in (0.2, 0.5, 1.0, 2.0):
        # The system is solved a hundred times more closely than the tolerance says.
        pair = qs.Suspension([qs.Body(k)] * 2, tolerance=1e-6)
        x, nodes = [[0, 0, 0], [2 * k + gap, 0, 0]], [20, 20]
        motion = [[0.3, 0.2, -1.0], [-0.3, 0.1, 0.5]]
        held = pair.held(None, x, velocity=motion, nodes=nodes).iterations
        free = pair.free(SHEAR, x, force=[1, 0, 1], nodes=nodes).iterations
        see(max(held, free), bar, f"k = {k:g}")
        one, n = qs.Suspension([qs.Body(k)], UP, tolerance=1e-6), [20 if gap > 0.2 else 28]
        for axis in ([0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.6, 0.0, 0.8]):
            above = [[0.0, 0.0, np.hypot(axis[2], k * axis[0]) + gap]]
            held = one.held(None, above, [axis], velocity=motion[0], nodes=n).iterations
            free = one.free(None, above, [axis], force=[1, 0, 1], nodes=n).iterations
            see(max(held, free), bar, f"k = {k:g} by a wall, axis {axis}")


@pytest.mark.slow
def test_a_pair_in_shear_and_back(see: See) -> None:
    pair, flow = qs.Suspension([qs.Body(0.5)] * 2, tolerance=1e-6), qs.flow("shear")
    x, axes = [[-2.0, 0.3, 0.0], [2.0, -0.3, 0.1]], [[0.6, 0.8, 0.0], [0.0, 0.6, 0.8]]
    there = pair.integrate(flow, [0.0, 2.0], x, axes, tolerance=1e-8)
    last = there.position[-1], there.orientation[-1]
    back = pair.integrate(-flow, [0.0, 2.0], *last, tolerance=1e-8)
    see(np.abs(back.position[-1] - x).max(), 1e-7, "place")
    see(np.abs(back.axis[-1] - axes).max(), 1e-7, "axis")
