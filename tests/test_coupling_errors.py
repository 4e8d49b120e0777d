"""Estimated errors of coupled bodies are promises: never below a third of the true ones."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import qbxstokes as qs
from qbxstokes.bie.multiple_scattering import closest
from qbxstokes.geometry import rotation
from qbxstokes.reference.bispherical import Bispherical, near_wall

UP = qs.Wall(normal=[0.0, 0.0, 1.0])
STRAIN = qs.flow("polynomial", gradient=[[0, 0, 1], [0, 0, 0], [0, 0, 0]])


def random_scene(seed: int) -> tuple[qs.Suspension, np.ndarray, np.ndarray]:
    """One to three spheroids, perhaps above a wall, the least gap from 0.1 to 1."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 4))
    wall = UP if count == 1 or rng.random() < 0.5 else None
    bodies = [
        qs.Body(float(k), size=float(size))
        for k, size in zip(
            rng.choice([0.3, 0.5, 1.0, 2.0], count), rng.choice([1.0, 0.6], count), strict=True
        )
    ]
    scene = qs.Suspension(bodies, wall, tolerance=float(10.0 ** -rng.uniform(2.0, 5.0)))
    q = rotation.random_quaternions(count, rng)
    x = np.cumsum(rng.normal(size=(count, 3)), axis=0)
    x[:, 2] = np.abs(x[:, 2]) + 0.3
    wanted, low, high = 10.0 ** rng.uniform(-1.0, 0.0), 0.0, 60.0
    for _ in range(60):  # blown up about the origin until the least gap is the wanted one
        middle = 0.5 * (low + high)
        near = closest(scene.placed(middle * x, q), scene.wall)[0] < wanted
        low, high = (middle, high) if near else (low, middle)
    return scene, high * x, q


def check(seed: int) -> None:
    """Compare every estimate with the difference from much finer grids."""
    scene, x, q = random_scene(seed)
    nodes = scene.grids(scene.placed(x, q))
    fine, finer = [n + 8 for n in nodes], qs.Suspension(scene.bodies, scene.wall, tolerance=1e-9)
    load = np.random.default_rng(seed).normal(size=(2, len(scene), 3))
    flow = STRAIN if scene.wall is not None else qs.flow("shear")
    free = [
        one.free(flow, x, q, force=load[0], torque=load[1], nodes=n)
        for one, n in ((scene, None), (finer, fine))
    ]
    held = [one.held(flow, x, q, nodes=n) for one, n in ((scene, None), (finer, fine))]
    for (found, exact), names in (
        (free, ("velocity", "angular_velocity", "stresslet")),
        (held, ("force", "torque", "stresslet")),
    ):
        for name in names:
            true = np.abs(getattr(found, name) - getattr(exact, name)).max()
            size = np.abs(getattr(exact, name)).max()
            estimate = found.error_estimate[name]
            assert estimate >= true / 3.0, (seed, name, true, estimate)
            assert estimate <= max(3.0 * scene.tolerance * size, 100.0 * true), name


@pytest.mark.parametrize("seed", [2, 5])
def test_estimates_hold_in_random_scenes(seed: int) -> None:
    check(seed)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(10, 16))
def test_estimates_hold_in_many_random_scenes(seed: int) -> None:
    check(seed)


@pytest.mark.parametrize("gap", [pytest.param(0.05, marks=pytest.mark.slow), 0.3])
def test_estimates_of_the_resistance_hold_against_exact_series(gap: float) -> None:
    one = qs.Suspension([qs.Body(1.0)], UP, tolerance=1e-3)
    found, estimate = one.resistance_and_error([[0.0, 0.0, 1.0 + gap]])
    exact = 6.0 * np.pi * near_wall(1.0 + gap)["normal"]
    assert estimate >= abs(found[2, 2] - exact) / exact / 3.0
    pair = qs.Suspension([qs.Body(1.0)] * 2, tolerance=1e-3)
    found, estimate = pair.resistance_and_error([[0, 0, 0], [0, 0, 2.0 + gap]])
    series = Bispherical(1.0, 1.0, gap).along()
    true = np.abs(found[np.ix_([2, 8], [2, 8])] - series).max() / np.abs(found).max()
    assert estimate >= true / 3.0


@pytest.mark.slow
def test_the_edge_of_a_disc_near_a_flank_is_served_and_told() -> None:
    """Takes more nodes than a motion would, on these two bodies alone."""
    place = ([[0, 0, 0], [0, 0, 3.1], [5, 1, 0]], [[0, 0, 1], [1, 0, 0], [0, 1, 1]])
    bodies, v = [qs.Body(2.0), qs.Body(2.0), qs.Body(0.5)], [[0, 0, 1], [0, 0, -1], [0, 0, 0]]
    found = qs.Suspension(bodies, tolerance=1e-6).held(None, *place, velocity=v)
    assert found.nodes[0] > 64
    assert found.nodes[2] == 8
    finer = qs.Suspension(bodies, tolerance=1e-8)
    exact = finer.held(None, *place, velocity=v, nodes=[82, 54, 20])
    error = np.abs(found.force - exact.force).max()
    assert error < 1e-6 * np.abs(exact.force).max()
    assert error < found.error_estimate["force"] < 100.0 * error


def test_motions_end_within_their_expected_error() -> None:
    pair = [qs.Body(1.0)] * 2, qs.flow("shear"), None
    scenes: list[tuple[Any, Any, float]] = [
        (pair, {"position": [[-3, 1.1, 0], [3, -1.1, 0]]}, 6.0),
        (
            ([qs.Body(0.5)], STRAIN, UP),
            {"position": [[0, 0, 1.4]], "orientation": [[0.8, 0.0, 0.6]]},
            8.0,
        ),
    ]
    for scene, start, end in scenes:
        ends = []
        for tolerance in (1e-3, 1e-6):
            found = qs.Simulation(
                *scene, **start, tolerance=tolerance, resolution=max(tolerance, 1e-5)
            ).integrate([0.0, end])
            ends.append((np.hstack([found.position[-1], found.axis[-1]]), found))
        (rough, found), (fine, _) = ends
        expected = found.summary["expected_error"]
        assert expected["total"] == pytest.approx(sum(list(expected.values())[1:]))
        assert np.abs(rough - fine).max() < expected["total"] < 1e-2
