"""The table of one body over a wall against solved instants, and motions from it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import qbxstokes as qs
from qbxstokes.errors import CaseError, SceneError
from qbxstokes.flows.polynomial import PolynomialFlow
from qbxstokes.motion.loads import Loads

WALL = qs.Wall(normal=[1.0, 2.0, 0.5], point=[0.1, 0.2, -0.3])


def quadratic(rng: np.random.Generator) -> PolynomialFlow:
    """A random flow of degree 2 that vanishes on the wall."""
    normal = WALL.normal
    turn = np.column_stack([*np.linalg.svd(normal[None])[2][1:], normal])
    gradient, hessian, spread = np.zeros((3, 3)), np.zeros((3, 3, 3)), rng.normal(size=(2, 2))
    gradient[:2, 2] = rng.normal(size=2)
    hessian[:2, :2, 2] = hessian[:2, 2, :2] = spread
    hessian[:2, 2, 2] = rng.normal(size=2)
    hessian[2, 2, 2] = -np.trace(spread)
    hessian = np.einsum("ai,bj,ck,ijk->abc", turn, turn, turn, hessian)
    return PolynomialFlow(np.zeros(3), turn @ gradient @ turn.T, hessian, origin=WALL.point)


@pytest.mark.slow
@pytest.mark.parametrize(("k", "size"), [(0.5, 0.7)])
def test_the_table_is_the_solution(k: float, size: float) -> None:
    rng = np.random.default_rng(1)
    table = qs.OverWall(qs.Body(k, size=size), WALL, tolerance=1e-3)
    scene = qs.Suspension([qs.Body(k, size=size)], WALL, tolerance=1e-6)
    flow = quadratic(rng)
    for axis in (WALL.normal, *rng.normal(size=(4, 3))):
        d = axis / np.linalg.norm(axis)
        height = size * np.sqrt(k * k + (1 - k * k) * (d @ WALL.normal) ** 2)
        away = np.cross(WALL.normal, rng.normal(size=3))
        x = WALL.point + (height + size * rng.uniform(1.0, 2.0)) * WALL.normal + away
        load = rng.normal(size=6)
        found = table.free_motion(flow, x[None], d[None], load[None])
        exact = scene.free_motion(flow, x[None], d[None], force=load[:3], torque=load[3:])
        for a, b in zip(found, exact, strict=True):
            assert np.abs(a - b).max() < 2e-3 * np.abs(b).max()
    assert 0.0 < table.error_estimate < 2e-3


def test_a_sphere_over_a_wall_has_few_numbers() -> None:
    table = qs.OverWall(qs.Body(1.0), qs.Wall(), tolerance=1e-4)
    flow = qs.flow("shear")
    u, w = table.free_motion(flow, [[3.0, 2.7, 1.0]], [[0.6, 0.0, 0.8]])
    exact = qs.Suspension([qs.Body(1.0)], qs.Wall(), tolerance=1e-6).free_motion(
        flow, [[3.0, 2.7, 1.0]]
    )
    assert np.allclose([u, w], exact, atol=2e-4)
    with pytest.raises(SceneError, match="has a gap to the wall"):
        table.free_motion(flow, [[0.0, 0.5, 0.0]], [[0.0, 0.0, 1.0]])
    with pytest.raises(SceneError, match="no polynomial of degree 2"):
        table.free_motion(qs.flow("above_wall", flow={"type": "stokeslet", "position": [0, 1, 0],
                                                       "strength": [1, 0, 0]}),
                          [[3.0, 2.7, 1.0]], [[0.6, 0.0, 0.8]])  # fmt: skip


def test_a_motion_from_the_table_is_that_of_solves() -> None:
    case = {
        "body": {"aspect_ratio": 1, "stokes_number": 0.5},
        "start": {"position": [0, 2.6, 0]},
        "surroundings": {"type": "wall"},
        "flow": {"type": "shear"},
        "time": {"end": 1, "samples": 3, "tolerance": 1e-3},
    }
    table, plain = (
        qs.run({**case, "hydrodynamics": {"tolerance": 1e-3, "solve": how}})
        for how in ("functional", "every_step")
    )
    assert table.summary["solves"] == 2 < plain.summary["solves"]
    assert np.allclose(table.position, plain.position, rtol=0.0, atol=2e-3)
    assert table.summary["velocity_errors"]["velocity"] > 0.0


def test_errors_of_a_table_are_those_of_the_speeds_it_gives() -> None:
    errors = []
    for force in (1.0, 1e6):
        down: Any = {"position": [[0, 2.6, 0]], "loads": Loads(np.array([[0.0, -force, 0.0]]))}
        scene = qs.Simulation([qs.Body(1.0)], None, qs.Wall(), **down, tolerance=1e-2, table=True)
        together: Any = scene.assemble()
        together.free(0.0, scene.position, scene.quaternion)
        together.estimate(0.0, together.initial)
        errors.append(together.errors["velocity"] / force)
        assert together.relative_error > scene.table.error_estimate > 0.0
    assert errors[0] == pytest.approx(errors[1])


def test_a_table_is_one_of_a_single_body_by_a_wall() -> None:
    with pytest.raises(SceneError, match="one body by a wall"):
        qs.Simulation([qs.Body(0.5)] * 2, None, qs.Wall(), position=[[0, 3, 0]] * 2, table=True)
    case = {
        "bodies": [{"aspect_ratio": 1}] * 2,
        "time": {"end": 1},
        "hydrodynamics": {"solve": "functional"},
    }
    with pytest.raises(CaseError, match="a table is one of a single body"):
        qs.run(case)
