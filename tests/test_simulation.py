"""The one assembly: a scene from Python, from a case and on the command line is the same."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import qbxstokes as qs
from qbxstokes.case.load import load_case
from qbxstokes.errors import CaseError, SceneError
from qbxstokes.runs.report import shape_text
from qbxstokes.simulation.from_case import times_of

SHEAR = {"type": "shear"}
SCENES: dict[str, dict[str, Any]] = {
    "thin": {"body": {"aspect_ratio": 0.02}, "flow": SHEAR, "time": {"end": 30, "samples": 7}},
    "inertial": {
        "body": {"aspect_ratio": 0.5, "stokes_number": 3, "inertia": "translation"},
        "flow": {"type": "paraboloid", "curvature": 0.2},
        "time": {"end": 5, "samples": 6},
    },
    "driven": {
        "body": {"aspect_ratio": 2},
        "flow": SHEAR,
        "forces": {"force": [0, 0, 1], "body_torque": [0.1, 0, 0]},
        "constraints": {"translation": "locked"},
        "time": {"end": 3, "samples": 4},
    },
    "singular": {
        "body": {"aspect_ratio": 0.5},
        "flow": {"type": "stokeslet", "strength": [1, 0, 0], "position": [0, 4, 0]},
        "hydrodynamics": {"tolerance": 1e-8},
        "time": {"end": 2, "samples": 3, "tolerance": 1e-8},
    },
}
START = {"start": {"position": [0.1, 0.2, 0.0], "orientation": {"axis": [0.48, 0.6, 0.64]}}}
NONE = {"compare": {"reference": "none"}}


@pytest.mark.parametrize("name", SCENES)
def test_python_a_case_and_the_command_give_the_same_bits(name: str, tmp_path: Path) -> None:
    case = SCENES[name] | START | NONE
    result = qs.run(case)
    scene = qs.from_case(case)
    motion = scene.integrate(result.time)
    for quantity in ("position", "orientation", "velocity", "force", "torque"):
        assert np.array_equal(getattr(motion, quantity), result[quantity]), quantity
    # And once more from what the simulation writes of itself.
    path = tmp_path / "written.yaml"
    path.write_text(scene.to_yaml(result.time))
    again = qs.run(path)
    for quantity in ("position", "orientation", "velocity", "force", "torque"):
        assert np.array_equal(again[quantity], result[quantity]), quantity


def test_a_thin_body_from_python_is_as_accurate_as_on_the_command_line() -> None:
    """Ten periods of k = 1/50, where the hydrodynamics' solver decides (it was 2.4e-6)."""
    body, flow = qs.Body(1 / 50), qs.flow("shear")
    times = np.linspace(0.0, 20.0 * np.pi * (50.0 + 1 / 50), 5)
    motion = body.integrate(flow, times, orientation=[0.48, 0.6, 0.64])
    assert motion.errors()["axis"] < 1e-9


def test_lanes_may_differ_in_everything_and_agree_with_each_alone() -> None:
    rng = np.random.default_rng(4)
    times = np.linspace(0.0, 10.0, 6)
    flows = [qs.flow("shear"), qs.flow("extension", rate=0.3), qs.flow("paraboloid", curvature=0.2)]
    scenes = [
        qs.Simulation(
            qs.Body(k, stokes_number=st, tolerance=1e-8),
            flow,
            position=0.3 * rng.normal(size=(n, 3)),
            orientation=rng.normal(size=(n, 3)),
            tolerance=1e-9,
        )
        for k, st, flow, n in (
            (0.2, 1.0, flows[0], 3),
            (1.0, 5.0, flows[1], 1),
            (3.0, 2.0, flows[2], 2),
        )
    ]
    together = qs.Simulation.stack(scenes).integrate(times)
    assert together.axis.shape == (6, 6, 3)
    alone = [scene.integrate(times) for scene in scenes]
    for quantity in ("position", "axis", "velocity", "angular_velocity", "force", "torque"):
        whole = np.concatenate([getattr(motion, quantity) for motion in alone])
        scale = max(1.0, float(np.abs(whole).max()))
        assert np.abs(getattr(together, quantity) - whole).max() < 1e-8 * scale, quantity
    constants = np.concatenate([motion.orbit_constant for motion in alone])
    assert np.array_equal(np.isnan(together.orbit_constant), np.isnan(constants))
    averages = together.averages()
    assert averages["rotation_rate"].shape == (6,)
    with pytest.raises(SceneError, match="differ in tolerance"):
        qs.Simulation.stack([scenes[0], qs.Simulation(scenes[1].body, flows[0])]).integrate(times)


def test_some_of_the_lanes_are_a_scene_like_all() -> None:
    axes = np.array([[1.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 1.0]])
    loads = qs.Loads(force=np.eye(3))
    scene = qs.Simulation(qs.Body(0.5), qs.flow("shear"), orientation=axes, loads=loads)
    some = scene.at(np.array([0, 2]))
    assert type(some) is qs.Simulation
    assert some.period == scene.period
    assert len(some) == 2
    np.testing.assert_array_equal(some.numbers, [0, 2])
    times = [0.0, 1.0]
    np.testing.assert_allclose(
        some.integrate(times).position, scene.integrate(times).position[[0, 2]], atol=1e-12
    )


def test_lanes_keep_the_shape_of_what_was_given() -> None:
    axes = np.random.default_rng(5).normal(size=(2, 3, 3))
    body = qs.Body(0.5, stokes_number=np.array([1.0, 2.0, 4.0]), tolerance=1e-8)
    scene = qs.Simulation(body, qs.flow("shear"), orientation=axes, tolerance=1e-8)
    assert scene.lanes == (2, 3)
    motion = scene.integrate(np.linspace(0.0, 4.0, 5))
    assert motion.axis.shape == (2, 3, 5, 3)
    assert motion.orbit_constant.shape == (2, 3, 5)
    assert motion.averages()["mean_velocity"].shape == (2, 3, 3)
    case = load_case_text(scene.to_yaml([1.0, 2.0]))
    assert case.space is not None
    assert case.space.size == 6
    assert times_of(case).tolist() == [1.0, 2.0]


def load_case_text(text: str) -> Any:
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "case.yaml")
        path.write_text(text)
        return load_case(path)


@pytest.mark.parametrize(
    ("keys", "told"),
    [
        ({"bodies": [qs.Body(0.5), qs.Body(0.5)]}, "position has shape"),
        ({"surroundings": "wall"}, "None or a qs.Wall"),
        ({"flow": "shear"}, r"qs\.flow\('shear'\)"),
        ({"tolerance": 0.0}, "more than 0"),
        ({"position": np.zeros((2, 3)), "orientation": np.ones((3, 3))}, "broadcast|shape"),
        ({"velocity": np.zeros((4, 3))}, "velocity has shape"),
        ({"events": {"half_turn": True}}, "half_turn"),
    ],
)
def test_what_makes_no_scene_is_told_in_a_line(keys: dict[str, Any], told: str) -> None:
    whole = {"bodies": qs.Body(0.5), "flow": qs.flow("shear"), **keys}
    with pytest.raises((CaseError, ValueError), match=told):
        qs.Simulation(
            whole.pop("bodies"), whole.pop("flow"), whole.pop("surroundings", None), **whole
        )


@pytest.mark.parametrize(
    ("keys", "told"),
    [
        ({}, "exactly one of aspect_ratio"),
        ({"shape": {"type": "sheroid"}}, r"shape.type is 'sheroid'; did you mean spheroid"),
        ({"shape": {"type": "spheroid"}}, "shape.aspect_ratio is missing; a number"),
        ({"shape": {"type": "spheroid", "aspect_ratio": -1}}, "shape.aspect_ratio is -1"),
        ({"shape": 0.5}, "shape is 0.5; a shape, or"),
        ({"aspect_ratio": 1, "length_over_diameter": 1}, "exactly one of"),
        ({"length_over_diameter": 0}, "more than 0"),
        ({"aspect_ratio": 0.5, "stokes_number": -1}, "stokes_number is -1"),
        ({"aspect_ratio": 0.5, "size": 0.0}, "size is 0"),
        ({"aspect_ratio": 0.5, "inertia": "none"}, "both, translation or rotation"),
        ({"aspect_ratio": 0.5, "hydrodynamics": {"n_theta": 1}}, "hydrodynamics.n_theta"),
    ],
)
def test_what_makes_no_body_is_told_in_a_line(keys: dict[str, Any], told: str) -> None:
    with pytest.raises(CaseError, match=told):
        qs.Body(**keys)


def test_a_body_by_length_over_diameter_or_shape() -> None:
    rod = qs.Body(length_over_diameter=5.0)
    assert rod.shape.aspect_ratio == 0.2
    assert shape_text(rod.shape) == "prolate spheroid, k = 0.2 (L/D = 5)"
    assert qs.Body(shape=qs.Spheroid(3.0)).shape.aspect_ratio == 3.0


def test_what_no_file_holds_is_named() -> None:
    push = qs.Loads(force=lambda t: [0.0, 0.0, t])
    scene = qs.Simulation(qs.Body(0.5), qs.flow("shear"), loads=push)
    with pytest.raises(SceneError, match=r"loads\.force is a Python function"):
        scene.to_yaml()
    swirl = qs.flow("user", function=lambda x: np.stack([x[:, 1], 0 * x[:, 0], 0 * x[:, 0]], 1))
    with pytest.raises(SceneError, match="flow holds a Python function"):
        qs.Simulation(qs.Body(0.5), swirl).to_yaml()


def test_a_flow_that_yaml_refuses_python_refuses() -> None:
    rough = qs.flow(
        "user", function=lambda x: np.stack([x[:, 1] ** 4, 0 * x[:, 0], 0 * x[:, 0]], 1)
    )
    with pytest.raises(SceneError, match="not Stokesian"):
        qs.Body(0.5).integrate(rough, [1.0], position=[0, 1, 0])
    point = qs.flow("stokeslet", strength=[1, 0, 0])
    with pytest.raises(SceneError, match="singular"):
        qs.Body(0.5).free_motion(point)


def test_loads_push_a_free_body_by_its_mobility() -> None:
    body = qs.Body(0.3)
    still = qs.flow("uniform", velocity=[0, 0, 0])
    u, omega = body.free_motion(still, force=[1, 0, 2], torque=[0, 1, 0])
    assert np.allclose(np.concatenate([u, omega]), body.mobility @ [1, 0, 2, 0, 1, 0], atol=1e-15)


def test_lanes_end_where_their_flow_does() -> None:
    """The first lane reaches the wall; it has no samples from there on, the others have theirs."""
    flow, weight = qs.flow("plane_poiseuille", half_width=5.0), qs.Loads(force=[0.0, 1.0, 0.0])
    places, times = [[0, 3.5, 0], [0, -4, 0]], np.linspace(0.0, 20.0, 21)

    def motion(place: Any) -> qs.Motion:
        scene = qs.Simulation(
            qs.Body(0.5), flow, position=place, orientation=[1, 1, 0.2], loads=weight
        )
        return scene.integrate(times)

    together, first, second = motion(places), motion(places[0]), motion(places[1])
    assert first.summary["events"]["ended_by"] == "domain_exit"
    ended = together.summary["ended"]
    assert list(ended) == [0]
    assert ended[0]["time"] == pytest.approx(first.time[-1], abs=1e-7)
    count = len(first.time) - 1
    np.testing.assert_allclose(together.position[0, :count], first.position[:-1], atol=1e-8)
    assert np.isnan(together.axis[0, count:]).all()
    np.testing.assert_allclose(together.axis[1], second.axis, atol=1e-8)
    with pytest.raises(SceneError, match="start with the whole body inside"):
        motion([0, 4.9, 0])


@pytest.mark.parametrize(
    ("keys", "told"),
    [
        ({"times": [-1.0]}, "times begin at -1"),
        ({"tolerance": -1}, "tolerance is -1"),
        ({"tolerance": np.nan}, "tolerance is not finite"),
        ({"tolerance": "tight"}, "tolerance is 'tight'"),
        ({"orientation": "x"}, "orientation is 'x'"),
    ],
)
def test_odd_arguments_of_motions_and_axes_are_told(keys: dict[str, Any], told: str) -> None:
    given = {"times": [1.0], "orientation": [1, 0, 0], **keys}
    for follow in (qs.Body(0.5).integrate, qs.Body(0.5).axes):
        with pytest.raises(SceneError, match=told):
            follow(qs.flow("shear"), **given)
