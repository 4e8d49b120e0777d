"""The flow among several bodies and by a wall: gradients, tractions, and fields of cases."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from conftest import Run

import qbxstokes as qs
from qbxstokes.bie.lines import lines_in_space
from qbxstokes.cli.main import run_command
from qbxstokes.errors import CaseError, ContactError, ConvergenceError
from qbxstokes.plots.animation import animate
from qbxstokes.plots.pictures import kinds
from qbxstokes.runs.field_lines import _followed
from qbxstokes.simulation.flow_among import FlowAmong

WALL = qs.Wall(normal=[0.0, 1.0, 0.0])
SCENE: dict[str, Any] = {
    "bodies": [
        {
            "aspect_ratio": 0.5,
            "start": {"position": [0, 1.6, 0], "orientation": {"axis": [1, 0, 0]}},
        },
        {"aspect_ratio": 1.0, "size": 0.6, "start": {"position": [2.4, 1.2, 0]}},
    ],
    "surroundings": {"type": "wall"},
    "flow": {"type": "shear"},
    "forces": {"force": [0, -1, 0]},
    "hydrodynamics": {"tolerance": 1e-2},
    "field": {
        "plane": {"extent": [-2, 4, 0, 3], "shape": [7, 4]},
        "surface": {"shape": [5, 8]},
        "quantities": ["velocity", "pressure", "stress"],
    },
}


def two(tolerance: float) -> tuple[FlowAmong, np.ndarray]:
    """A spheroid and a small disc above the wall, in shear, under loads."""
    scene = qs.Suspension([qs.Body(0.5), qs.Body(2.0, size=0.5)], WALL, tolerance=tolerance)
    x, axes = [[0.0, 1.5, 0.0], [2.6, 1.3, 0.2]], [[1.0, 0.2, 0.0], [0.3, 1.0, 0.1]]
    flow = qs.flow("shear")
    load = np.array([[0.3, -1.0, 0.2], [0.0, -0.5, 0.1]])
    return FlowAmong(scene.free(flow, x, axes, force=load), flow), load


def test_gradients_are_those_of_the_velocity_and_pressure() -> None:
    flow, _ = two(1e-4)
    points = np.array([[0.5, 0.6, 0.3], [1.3, 1.5, 0.2], [3.0, 3.0, 1.0], [0.0, 0.01, 0.0]])
    found = flow.evaluate(points, ("gradient", "pressure_gradient", "stress", "pressure"))
    step = 1e-4
    sides = [
        [flow.evaluate(points + s * step * e, ("velocity", "pressure")) for s in (-1.0, 1.0)]
        for e in np.eye(3)
    ]
    for name, slope in (("velocity", "gradient"), ("pressure", "pressure_gradient")):
        parts = [(after[name] - before[name]) / (2.0 * step) for before, after in sides]
        assert np.allclose(np.stack(parts, axis=-1), found[slope], atol=3e-6), name
    assert np.abs(np.trace(found["gradient"], axis1=1, axis2=2)).max() < 1e-6
    shear = found["gradient"][:, 0, 1] + found["gradient"][:, 1, 0]
    assert np.allclose(found["stress"][:, 3], shear, atol=1e-12)


def test_tractions_add_up_to_the_loads_on_every_body() -> None:
    flow, load = two(1e-4)
    cosine, weights = np.polynomial.legendre.leggauss(24)
    theta, phi = np.arccos(-cosine), 2.0 * np.pi * np.arange(48) / 48
    wall = flow.surface(np.zeros(9), np.zeros(11), 2)
    assert np.abs(wall["velocity"]).max() < 1e-4
    assert wall["points"].shape == (9, 11, 3)
    assert np.allclose(wall["traction"][..., 1], -wall["pressure"], atol=1e-4)  # no slip, no strain
    for b, body in enumerate(flow.problem.bodies):
        found, k = flow.surface(theta, phi, b), body.ratio
        area = body.size**2 * k * np.sqrt(np.sin(theta) ** 2 + (k * np.cos(theta)) ** 2)
        area = (weights * area)[:, None, None] * 2.0 * np.pi / 48
        assert np.allclose((area * found["traction"]).sum(axis=(0, 1)), -load[b], atol=1e-6)
        turn = np.cross(found["points"] - body.position, found["traction"])
        assert np.allclose((area * turn).sum(axis=(0, 1)), 0.0, atol=1e-6)


def test_a_field_of_a_case_holds_every_surface_and_draws_bodies_and_wall(tmp_path: Path) -> None:
    name = str(tmp_path / "field.h5")
    found = qs.run({**SCENE, "task": "field", "output": {"file": name}})
    field = found.groups["field"]
    assert {"plane", "surface_1", "surface_2"} <= set(field)
    assert found.velocity.shape == (1, 2, 3)
    assert np.allclose(found.force, [[[0, 1, 0], [0, 1, 0]]])  # of the fluid on the bodies
    plane = field["plane"]
    on_wall = plane["points"][0, :, 1] == 0.0
    assert np.abs(plane["velocity"][0][on_wall]).max() < 1e-4  # to the tolerance
    assert found.summary["errors"]["no slip"] < 1e-2
    scene = qs.Suspension([qs.Body(0.5), qs.Body(1.0, size=0.6)], WALL, tolerance=1e-2)
    x, axes = [[0, 1.6, 0], [2.4, 1.2, 0]], [[1.0, 0, 0], [0, 0, 1.0]]
    nodes = found.summary["hydrodynamics"]["nodes"]
    other = scene.field(
        qs.flow("shear"), plane["points"][0], x, axes, force=[0, -1, 0], nodes=nodes.tolist()
    )
    inside = plane["inside"][0]
    assert np.allclose(other["velocity"][~inside], plane["velocity"][0][~inside], atol=1e-3)
    for kind, draw in kinds(found).items():
        assert draw().axes, kind
    front = kinds(found)["traction"]().axes[0]
    corners = np.concatenate([path.vertices for path in front.collections[0].get_paths()])
    assert np.allclose((corners.min(axis=0) + corners.max(axis=0))[0] / 2.0, 1.0, atol=0.1)


def test_a_motion_stores_surfaces_for_paraview_and_is_animated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    case = {
        **SCENE,
        "time": {"end": 0.2, "samples": 2, "tolerance": 1e-2},
        "field": {"surface": {"shape": [5, 8]}, "every": 1, "quantities": ["velocity"]},
    }
    Path("motion.yaml").write_text(json.dumps(case))
    assert run_command(["motion.yaml", "--quiet"]) == 0
    found = qs.load("motion.h5")
    with h5py.File("motion.vtkhdf") as file:
        for name in ("surface_1", "surface_2", "wall"):
            steps = file["VTKHDF"][name]["Steps"]
            assert steps.attrs["NSteps"] == 2
            assert "traction" in file["VTKHDF"][name]["PointData"]
    middle = found.groups["field"]["surface_1"]["points"].mean(axis=1)
    assert np.allclose(middle, found.position[:, 0], atol=1e-6)
    film = animate(found, frames=2)
    film.show(1)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"tracers": {"duration": 1.0}}, "field.tracers: would follow bodies that do not stay"),
        ({"plane": {"frame": "body"}}, "field.plane.frame: is not space"),
        ({"body": "moving"}, "field.body: has no meaning"),
    ],
)
def test_fields_that_bodies_cannot_have_are_told(change: dict[str, Any], told: str) -> None:
    with pytest.raises(CaseError, match=told):
        qs.run({**SCENE, "task": "field", "field": {**SCENE["field"], **change}})


def test_instants_beyond_the_end_of_a_motion_have_no_field() -> None:
    case = {
        "body": {"aspect_ratio": 1},
        "start": {"position": [0, 1.6, 0]},
        "surroundings": {"type": "wall"},
        "forces": {"force": [0, -20, 0]},
        "time": {"end": 5, "samples": 11, "tolerance": 1e-2},
        "hydrodynamics": {"tolerance": 1e-2},
        "events": {"clearance": 0.3},
        "field": {"surface": {"shape": [5, 4]}, "at": [0, 5], "check": 0},
    }
    found = qs.run(case)
    assert found.time[-1] < 2.0
    assert found.groups["field"]["time"].tolist() == [0.0]


def test_lines_follow_the_flow_among_bodies_and_end_on_them(tmp_path: Path) -> None:
    lines = {"start": [-2, 0.3, 0], "stop": [-2, 2.2, 0], "number": 4, "tolerance": 1e-5}
    field = {
        "body": "held",
        "shells": {"distances": [0.0, 0.2], "shape": [5, 8]},
        "streamlines": {**lines, "length": 3.0, "samples": 61, "both_ways": True},
        "tracers": {**lines, "duration": 2.0, "samples": 41},
        "quantities": ["velocity"],
    }
    path = tmp_path / "lines.h5"
    found = qs.run({**SCENE, "task": "field", "field": field}, file=path).groups["field"]
    bodies = [qs.Body(0.5), qs.Body(1.0, size=0.6)]
    x, axes = [[0, 1.6, 0], [2.4, 1.2, 0]], [[1, 0, 0], [0, 0, 1]]
    held = qs.Suspension(bodies, WALL, tolerance=1e-2).held(qs.flow("shear"), x, axes)
    flow = FlowAmong(held, qs.flow("shear"))

    streams, paths = found["streamlines"]["points"][0], found["tracers"]["points"]
    assert streams.shape == (4, 121, 3)
    for line, step in ((streams, 0.05), (np.moveaxis(paths, 1, 0), 0.05)):
        slope = (line[:, 2:] - line[:, :-2]) / (2.0 * step)
        u = flow.carrying(line[:, 1:-1].reshape(-1, 3)).reshape(slope.shape)
        u /= np.linalg.norm(u, axis=-1, keepdims=True) if line is streams else 1.0
        assert np.abs(slope - u).max() < 0.05
    for b, (body, size) in enumerate(zip(bodies, (1.0, 0.6), strict=True)):
        points = found[f"shells_{b + 1}"]["points"][0].reshape(2, -1, 3)
        away = body.shape.clearance((points - x[b]) / size, np.zeros(3), np.array(axes[b], float))
        assert np.allclose(size * away.T, [0.0, 0.2], atol=1e-6)
    with h5py.File(path.with_suffix(".vtkhdf")) as file:
        assert {"streamlines", "shells_1", "shells_2"} <= set(file["VTKHDF/Assembly"])


def test_lines_end_where_they_come_to_a_moving_body() -> None:
    flow, _ = two(1e-2)
    starts = np.array([[-1.2, 1.5, 0.0], [0.0, 1.5, 0.0], [-1.2, 0.4, 0.0]])
    x = lines_in_space(flow.carrying, flow.inside, starts, np.linspace(0.0, 2.0, 41), 1e-4)
    assert np.isnan(x[1]).all()
    ends = np.isfinite(x[0]).all(axis=1).sum()
    assert 1 < ends < 41
    assert (
        flow.problem.bodies[0].shape.clearance(
            flow.problem.bodies[0].to_body(x[0, ends - 1][None]), np.zeros(3), np.eye(3)[2]
        )
        < 0.1
    )
    assert np.isfinite(x[2]).all()


def test_a_step_of_tracers_into_touching_bodies_is_taken_again() -> None:
    """At a loose tolerance the first steps are long enough to overshoot."""

    def rate(t: float, gap: np.ndarray, tracers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if gap[0] < 0.55:
            raise ContactError("bodies 1 and 2", float(gap[0]), "they touch or overlap")
        return np.sqrt(0.4) * (0.6 - gap) * 50.0, np.ones_like(tracers)

    times = np.linspace(0.0, 4.0, 5)
    gaps, paths = _followed(rate, np.ones(1), np.zeros((1, 3)), times, 1e-2, 1e-2)
    assert np.abs(gaps[1:] - 0.6).max() < 2e-2
    assert np.allclose(paths[:, 0], times[:, None])

    def falling(t: float, gap: np.ndarray, tracers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return 0.0 * rate(t, gap, tracers)[0] - 1.0, np.ones_like(tracers)

    with pytest.raises(ConvergenceError, match=r"tracers stopped: .*; bodies 1 and 2: the gap is"):
        _followed(falling, np.ones(1), np.zeros((1, 3)), times, 1e-2, 1e-2)


def test_tracers_of_one_listed_body_are_those_of_one_body() -> None:
    lines = {"start": [-1.5, 0.1, 0.3], "stop": [1.2, 1, 0], "number": 3, "tolerance": 1e-5}
    case = {
        "flow": {"type": "shear"},
        "forces": {"force": [0, 0, 0.5]},
        "hydrodynamics": {"tolerance": 1e-4},
        "time": {"end": 1.0, "samples": 3, "tolerance": 1e-5},
        "compare": {"reference": "none"},
    }
    one, start = {"aspect_ratio": 0.5}, {"position": [0, 0, 0], "orientation": {"axis": [1, 1, 0]}}
    field = {"quantities": ["velocity"], "tracers": {**lines, "frame": "space", "samples": 3}}
    field |= {"surface": None, "vtk": False, "check": 0}
    alone = qs.run({**case, "body": one, "start": start, "field": field}).groups["field"]["tracers"]
    listed = qs.run({**case, "bodies": [{**one, "start": start}], "field": field}).groups["field"][
        "tracers"
    ]
    assert np.allclose(listed["points"], alone["points"], atol=2e-4)
    assert np.allclose(listed["position"][:, 0], alone["position"], atol=1e-4)


@pytest.mark.mpi
def test_tracers_among_moving_bodies_are_those_of_one_rank(mpirun: Run, tmp_path: Path) -> None:
    tracers = {"points": [[-2, 0.5, 0], [0, 1.6, 0]], "duration": 0.1, "samples": 3}
    case = {
        **SCENE,
        "time": {"end": 0.1, "samples": 2, "tolerance": 1e-2},
        "field": {"surface": {"shape": [5, 8]}, "quantities": ["velocity"], "tracers": tracers},
    }
    (tmp_path / "case.yaml").write_text(json.dumps(case))
    done = mpirun(2, "case.yaml", "--quiet")
    assert done.returncode == 0, done.stderr
    two = qs.load(tmp_path / "case.h5").fields.tracers.points
    one = qs.run(case, file=str(tmp_path / "one.h5")).fields.tracers.points
    assert np.allclose(two, one, rtol=0, atol=1e-9, equal_nan=True)
    assert np.isfinite(one[:, 0]).all()
    assert np.isnan(one[:, 1]).all()  # within the first body
    with h5py.File(tmp_path / "one.h5") as file:
        about = {name: file["field/tracers"][name].attrs for name in ("time", "position", "points")}
        assert {name: told["units"] for name, told in about.items()} == {
            "time": "tau",
            "position": "c",
            "points": "c",
        }
