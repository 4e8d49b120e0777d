"""Cases with several bodies or a wall: what comes out is what Python gives, faults are told."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import yaml

import qbxstokes as qs
from qbxstokes.bie.multiple_scattering import gaps_of
from qbxstokes.case.load import case_of
from qbxstokes.errors import CaseError
from qbxstokes.geometry import rotation
from qbxstokes.plots.pictures import motion_drawings as drawings
from qbxstokes.runs.plan import plan_coupled
from qbxstokes.runs.plan_report import plan_text

WALL = {"type": "wall", "normal": [0, 0, 1]}
PAIR: dict[str, Any] = {
    "task": "body",
    "bodies": [
        {"aspect_ratio": 0.5, "start": {"position": [0, 0, 0]}},
        {"aspect_ratio": 1.0, "size": 0.5, "start": {"position": [3, 0, 0]}},
    ],
    "forces": {"gravity": {"number": 1.0}},
    "hydrodynamics": {"tolerance": 1e-4},
}


def test_a_case_of_two_bodies_is_what_python_gives() -> None:
    found = qs.run(PAIR)
    scene = qs.Suspension([qs.Body(0.5), qs.Body(1.0, size=0.5)], tolerance=1e-4)
    x = [[0, 0, 0], [3, 0, 0]]
    assert np.array_equal(found.resistance, scene.resistance(x))
    volumes = 4.0 * np.pi / 3.0 * np.array([0.25, 0.125])
    force = -volumes[:, None] * np.array([0.0, 0.0, 1.0])
    u, _ = scene.free_motion(None, x, force=force)
    assert np.array_equal(found.free_velocity, u)
    assert found.free_velocity.shape == (2, 3)
    assert found.stresslet.shape == (2, 6)
    assert "held_force" not in found.names
    estimates = found.summary["error_estimates"]
    assert 0.0 < estimates["resistance"] < 1e-4
    assert found.summary["gap"] == pytest.approx(2.0)


@pytest.mark.parametrize("ranks", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_any_number_of_ranks_gives_the_same_numbers(
    mpirun: Callable[..., Any], tmp_path: Path, ranks: int
) -> None:
    case = {**PAIR, "surroundings": {"type": "wall", "point": [0, -2, 0]}}
    (tmp_path / "case.yaml").write_text(yaml.safe_dump(case))
    done = mpirun(ranks, "case.yaml", "--quiet")
    assert done.returncode == 0, done.stderr
    one, several = qs.run(case), qs.load(tmp_path / "case.h5")
    for name in ("resistance", "free_velocity", "free_angular_velocity", "stresslet"):
        assert np.allclose(several[name], one[name], rtol=0, atol=1e-12 * np.abs(one[name]).max())


def test_a_table_stands_for_the_bodies(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rows = "aspect_ratio,size,position_1,position_2,position_3\n0.5,1,0,0,0\n1,0.5,3,0,0\n"
    (tmp_path / "bodies.csv").write_text(rows)
    monkeypatch.chdir(tmp_path)
    tabled = qs.run({**PAIR, "bodies": {"table": "bodies.csv"}})
    assert np.array_equal(tabled.resistance, qs.run(PAIR).resistance)
    with h5py.File("bodies.h5", "w") as file:
        file["aspect_ratio"], file["size"] = [0.5, 1.0], [1.0, 0.5]
        file["position"] = [[0.0, 0.0, 0.0], [3.0, 0.0, 0.0]]
    tabled = qs.run({**PAIR, "bodies": {"table": "bodies.h5"}})
    assert np.array_equal(tabled.resistance, qs.run(PAIR).resistance)
    with h5py.File("wrong.h5", "w") as file:
        file["position"] = [1.0, 2.0]
    with pytest.raises(CaseError, match=r"position, of shape \(2,\), is no quantity of bodies"):
        qs.run({**PAIR, "bodies": {"table": "wrong.h5"}})
    for header, told in (("sise", "did you mean size"), ("position_1,size", "position_2 is miss")):
        (tmp_path / "wrong.csv").write_text(
            f"{header},aspect_ratio\n" + "1," * (1 + header.count(",")) + "1\n"
        )
        with pytest.raises(CaseError, match=told):
            qs.run({**PAIR, "bodies": {"table": "wrong.csv"}})


def test_one_body_by_a_wall_has_no_axis_of_bodies() -> None:
    case = {
        "task": "body",
        "body": {"aspect_ratio": 1.0},
        "start": {"position": [0, 0, 2]},
        "surroundings": WALL,
        "hydrodynamics": {"tolerance": 1e-4},
        "flow": {"type": "polynomial", "gradient": [[0, 0, 1], [0, 0, 0], [0, 0, 0]]},
    }
    found = qs.run(case)
    assert found.free_velocity.shape == found.held_force.shape == (3,)
    assert found.resistance.shape == (6, 6)
    assert found.free_velocity[0] == pytest.approx(1.9, abs=0.1)
    assert found.held_force[0] > 0.0


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"constraints": {"rotation": "locked"}}, "constraints: has no meaning"),
        ({"hydrodynamics": {"n_theta": 8}}, r"hydrodynamics.n_theta: has no meaning with a wall"),
        ({"bodies": [{**PAIR["bodies"][0], "stokes_number": 1}]}, r"bodies: hold a stokes_number"),
        ({"bodies": [{"aspect_ratio": 1, "siz": 2}]}, r"bodies\[0\].siz: .*did you mean size"),
        ({"surroundings": WALL, "flow": {"type": "shear"}}, "flow: slips on the wall"),
        ({"surroundings": {"type": "unbounded", "point": [0, 0, 0]}}, "no meaning for type"),
    ],
)
def test_faults_of_bodies_and_walls_are_told(change: dict[str, Any], told: str) -> None:
    with pytest.raises(CaseError, match=told):
        qs.run({**PAIR, **change})


def test_bodies_that_touch_are_refused() -> None:
    bodies = [PAIR["bodies"][0], {**PAIR["bodies"][1], "start": {"position": [0.9, 0, 0]}}]
    with pytest.raises(CaseError, match=r"bodies: bodies 1 and 2: the gap is -0\.1"):
        qs.run({**PAIR, "bodies": bodies})


FALL: dict[str, Any] = {
    "bodies": [
        {"aspect_ratio": 1.0, "start": {"position": [0, 0, 3]}, "forces": {"force": [0, 0, -9]}},
        {"aspect_ratio": 1.0, "size": 0.5, "start": {"position": [3, 0, 2]}},
    ],
    "forces": {"force": [0, 0, "-3*cos(t)"]},
    "surroundings": WALL,
    "time": {"end": 1.5, "samples": 4, "tolerance": 1e-3},
    "hydrodynamics": {"tolerance": 1e-3},
}


def test_a_motion_has_the_bodies_behind_the_time_and_is_that_of_python() -> None:
    found = qs.run(FALL)
    assert found.position.shape == found.velocity.shape == (4, 2, 3)
    assert found.orientation.shape == (4, 2, 4)
    assert np.allclose(found.force[:, 0], [0, 0, 9])
    assert np.allclose(found.force[:, 1, 2], 3 * np.cos(found.time))
    assert found.summary["events"]["nearest"]["who"] == "body 2 and the wall"
    assert found.summary["velocity_errors"]["velocity"] < 1e-3
    scene = qs.from_case(FALL)
    motion = scene.integrate(np.linspace(0.0, 1.5, 4))
    assert np.array_equal(motion.position, found.position)
    assert {"scene", "displacement", "velocity", "rotation"} == set(drawings(found))
    for draw in drawings(found).values():
        assert draw().axes
    x = [[0, 0, 3], [3, 0, 2]]
    force = [[0, 0, -9], [0, 0, -3]]
    suspension = qs.Suspension([qs.Body(1.0), qs.Body(1.0, size=0.5)], qs.Wall([0, 0, 1]))
    u, _ = suspension.free_motion(None, x, force=force)
    assert np.allclose(found.velocity[0], u, atol=1e-3)


def test_loads_of_bodies_and_the_time_are_told() -> None:
    loaded = case_of(FALL)
    told = plan_text(loaded, plan_coupled(loaded), Path("fall.h5"), None)
    assert "loads                 body 1: force (0, 0, -9)\n" in told
    assert "body 2: force (0, 0, -3*cos(t))\n" in told
    assert "time                  0 to 1.5, 4 samples\n" in told


def test_a_fall_ends_at_the_clearance_of_the_case() -> None:
    case = {**FALL, "events": {"clearance": 0.8, "turning_points": ["x3"]}}
    found = qs.run({**case, "time": {"end": 9.0, "samples": 4, "tolerance": 1e-3}})
    events = found.summary["events"]
    assert events["ended_by"] == "clearance"
    assert found.summary["end"] < 9.0
    assert found.time[-1] == found.summary["end"]
    assert found.position[-1, :, 2].min() > 0.8
    assert events["counts"]["clearance"] == 1


def test_a_sweep_computes_scenes_alone_and_tells_those_that_touch() -> None:
    axes = {"bodies[1].start.position[0]": [3.0, 1.2, 2.0]}
    found = qs.sweep({**PAIR, "bodies": PAIR["bodies"]}, axes)
    assert found.table["status"].tolist() == [1, 1, 1]
    assert np.allclose(found.table["gap"], [2.0, 0.2, 1.0])
    alone = qs.run(PAIR)
    assert found.table["free_velocity_2_3"][0] == alone.free_velocity[1, 2]
    moving = {**FALL, "time": {"end": 0.2, "samples": 2, "tolerance": 1e-3}}
    moved = qs.sweep(moving, {"bodies[1].size": [0.5, 3.0]})
    assert moved.position.shape == (2, 2, 2, 3)
    assert moved.table["status"].tolist() == [1, 2]
    assert b"body 2 and the wall: the gap is -1" in moved.table["reason"][1]
    assert np.array_equal(moved.trajectory(0).position, qs.run(moving).position)


def test_a_repulsion_is_the_slope_of_its_potential_and_holds_bodies_apart() -> None:
    bodies, wall = [qs.Body(0.5), qs.Body(2.0, size=0.7)], qs.Wall(normal=[0, 0, 1])
    scene, push = qs.Suspension(bodies, wall), qs.Repulsion(2.0, 0.3)
    x = np.array([[0.0, 0.0, 1.3], [2.8, 0.3, 1.4]])
    q = rotation.from_axis(np.array([[0.6, 0.0, 0.8], [0.2, 0.3, 1.0]]))

    def energy(x: np.ndarray, q: np.ndarray) -> float:
        gaps = gaps_of(scene.placed(x, q), scene.wall).gap
        return float(0.6 * np.exp(-gaps / 0.3).sum())

    force, torque = push.loads(scene.placed(x, q), scene.wall)
    step = 1e-5
    for body, part in np.ndindex(2, 3):
        moved, spin = np.zeros((2, 3)), np.zeros((2, 4))
        moved[body, part] = step
        spin[body, 1 + part] = 0.5 * step
        turned = [rotation.normalize(q + s * rotation.multiply(spin, q)) for s in (1.0, -1.0)]
        slope = (energy(x + moved, q) - energy(x - moved, q)) / (2.0 * step)
        turn = (energy(x, turned[0]) - energy(x, turned[1])) / (2.0 * step)
        assert force[body, part] == pytest.approx(-slope, abs=1e-8)
        assert torque[body, part] == pytest.approx(-turn, abs=1e-8)
    case = {
        "body": {"aspect_ratio": 1.0},
        "start": {"position": [0, 0, 1.2]},
        "surroundings": WALL,
        "forces": {"force": [0, 0, -5]},
        "repulsion": {"strength": 20, "range": 0.1},
        "time": {"end": 20, "samples": 2, "tolerance": 1e-2},
        "hydrodynamics": {"tolerance": 1e-2},
    }
    found = qs.run(case)  # the weight is borne where 20 exp(-gap/0.1) = 5
    assert found.position[-1, 2] == pytest.approx(1.0 + 0.1 * np.log(4.0), abs=3e-3)
    with pytest.raises(CaseError, match="repulsion: has no meaning for one body"):
        qs.run({**case, "surroundings": None, "flow": {"type": "shear"}})


def test_inertia_follows_the_drag() -> None:
    # A sphere far from the wall takes up its velocity with the rate 6 pi/(St 4 pi/3).
    body = qs.Body(1.0, stokes_number=2.0)
    still = {"velocity": [0.0, 0.0, 0.0], "angular_velocity": [0.0, 0.0, 0.0]}
    load = qs.Loads(force=[[0.0, 0.0, -6.0 * np.pi]])
    scene = qs.Simulation(
        [body], None, qs.Wall([0, 0, 1], [0, 0, -1e5]), loads=load, tolerance=1e-6, **still
    )
    times = np.array([0.0, 0.3, 1.0])
    motion = scene.integrate(times)
    rate = 4.5 / 2.0
    assert np.allclose(motion.velocity[:, 0, 2], np.exp(-rate * times) - 1.0, atol=3e-5)


def test_a_stokeslet_with_its_images_drives_a_small_body_as_the_fluid_there() -> None:
    push = {"type": "stokeslet", "strength": [1.0, 2.0, 0.5], "position": [0.3, 1.0, 0.0]}
    flow = qs.flow("above_wall", flow=push)
    rng = np.random.default_rng(0)
    plane = rng.normal(size=(20, 3)) * [1, 0, 1]
    assert np.abs(flow.velocity(plane)).max() == 0.0
    # Blake (1971): far along the wall a stokeslet along it leaves 12 h^2 x^2 y/(8 pi x^5).
    along = qs.flow("above_wall", flow={**push, "strength": [1, 0, 0], "position": [0, 0.5, 0]})
    x, y = 60.0, 0.7
    exact = 12.0 * 0.5 * y * x * x / (8.0 * np.pi * x**5)
    assert along.velocity([x, y, 0.0])[0] == pytest.approx(exact, rel=2e-3)
    small = qs.Suspension([qs.Body(0.5, size=0.02)], qs.Wall(), tolerance=1e-4)
    u, _ = small.free_motion(flow, [[2.0, 1.0, 0.0]])
    assert np.allclose(u[0], flow.velocity([2.0, 1.0, 0.0]), atol=2e-6)


def test_a_scene_is_written_down_as_a_case() -> None:
    pair = {
        "bodies": PAIR["bodies"],
        "surroundings": {**WALL, "point": [0, 0, -2]},
        "forces": {"gravity": {"number": 1.0}, "torque": [0.1, 0, 0]},
        "hydrodynamics": {"tolerance": 1e-3},
        "time": {"end": 0.2, "samples": 2, "tolerance": 1e-3},
        "events": {"clearance": 0.1, "turning_points": ["x3"]},
        "repulsion": {"strength": 1.0, "range": 0.2},
    }
    one = {
        "body": {"aspect_ratio": 0.5, "stokes_number": 1.0},
        "start": {"position": [0, 2, 0], "velocity": [1, 0, 0], "angular_velocity": [0, 0, 0]},
        "surroundings": {"type": "wall"},
        "flow": {"type": "shear"},
        "time": {"end": 0.2, "tolerance": 1e-3},
    }
    for case in (pair, one):
        scene = qs.from_case(case)
        again = qs.from_case(yaml.safe_load(scene.to_yaml([0.0, 0.2])))
        assert again.to_yaml() == scene.to_yaml()
        assert len(again) == len(scene)
        assert again.stokes_number.tolist() == scene.stokes_number.tolist()
    times = [0.0, 0.2]
    assert np.array_equal(
        qs.from_case(pair).integrate(times).position[-1], qs.run(pair).position[-1]
    )


def test_one_body_in_free_space_knows_nothing_of_walls_and_others(tmp_path: Path) -> None:
    flow = {"type": "plane_poiseuille", "half_width": 4.0}
    case = {"body": {"aspect_ratio": 0.5}, "flow": flow, "time": {"end": 1.0}}
    (tmp_path / "case.yaml").write_text(json.dumps(case))
    code = """
import sys
from qbxstokes.cli.main import run_command
run_command(["case.yaml"])
mine = "coupl among arriv suspension scatter gap wall repulsion exterior_basis grid_ch".split()
own = [m for m in sys.modules if "qbxstokes" in m]
print("loaded", [m for m in own if any(word in m for word in mine)])
"""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=tmp_path
    )
    assert done.stdout.rstrip().endswith("loaded []")
    assert "their answer to the body is not in the" in done.stdout


def test_a_missed_tolerance_is_told(
    run_cli: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of velocities relative to those that the loads, opposite here, give each body alone."""
    monkeypatch.setattr("qbxstokes.simulation.solved_instant._factor", lambda *_: 1e-3)
    up, down = ({"force": [0, 0, sign]} for sign in (1.0, -1.0))
    bodies = [{"aspect_ratio": 1, "forces": up}, {"aspect_ratio": 1, "forces": down}]
    bodies[1]["start"] = {"position": [0, 0, 2.2]}
    case = {"task": "body", "bodies": bodies, "hydrodynamics": {"tolerance": 1e-3}}
    (tmp_path / "near.yaml").write_text(json.dumps(case))
    done = run_cli("near.yaml")
    assert done.returncode == 0
    assert "hydrodynamics.tolerance 0.001 is missed: errors come to about" in done.stderr
    assert "                        body 2: force (0, 0, -1)" in done.stdout
