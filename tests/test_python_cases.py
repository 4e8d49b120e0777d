"""What a program may give in a case: functions, flows, shapes, arrays, ranges and paths."""

from __future__ import annotations

import functools

import numpy as np
import pytest

import qbxstokes as qs
from qbxstokes.errors import CaseError, SceneError
from qbxstokes.flows.user import hand_over, load_function

TIMES = np.linspace(0.0, 1.0, 3)
CASE = {
    "body": {"shape": qs.Spheroid(0.5)},
    "start": {"orientation": {"axis": np.array([1, 0, 1])}},
    "time": {"at": TIMES, "tolerance": 1e-8},
}


def swirl(x):
    """A shear and a point torque at (0, 6, 0)."""
    r = x - [0.0, 6.0, 0.0]
    spin = np.cross([0.0, 0.0, 20.0], r) / np.linalg.norm(r, axis=1)[:, None] ** 3
    return spin + x[:, [1]] * [1.0, 0.0, 0.0]


def turning(t):
    return [[0.0, np.cos(t), 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]


FLOWS = {
    "function": qs.flow("user", function=swirl, length=6, singular_points=[[0, 6, 0]]),
    "sum": qs.flow("shear") + 0.1 * qs.flow("user", function=swirl, singular_points=[[0, 6, 0]]),
    "gradient": qs.flow("linear", gradient=turning),
    "turned": qs.flow("linear", gradient=turning).rotated(
        [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    ),
    "series": qs.flow(
        "linear",
        gradient=qs.GradientSeries(
            np.linspace(0, 2, 21), [turning(t) for t in np.linspace(0, 2, 21)]
        ),
    ),
}


@pytest.mark.parametrize("name", FLOWS)
def test_flows_of_a_program_stand_in_a_case(name):
    flow = FLOWS[name]
    motion = qs.Body(0.5).integrate(flow, TIMES, orientation=[1, 0, 1], tolerance=1e-8)
    assert np.array_equal(qs.run({**CASE, "flow": flow}).axis, motion.axis)
    with pytest.raises(SceneError, match="holds a Python function, which no file holds"):
        qs.Simulation(qs.Body(0.5), flow).to_yaml()
    if name == "function":
        keys = {"type": "user", "function": swirl, "length": 6, "singular_points": [[0, 6, 0]]}
        assert np.array_equal(qs.run({**CASE, "flow": keys}).axis, motion.axis)
        assert qs.from_case({**CASE, "flow": keys}).flow.function is swirl


def test_functions_of_a_program_push_and_hold_a_body():
    def push(t):
        return [0.0, np.sin(t), 0.0]

    shear = qs.flow("shear")
    by_hand = qs.Body(0.5).integrate(
        shear, TIMES, orientation=[1, 0, 1], tolerance=1e-8, loads=qs.Loads(force=push)
    )
    pushed = {**CASE, "flow": shear}
    swept = qs.sweep(pushed, {"forces.force": [push, lambda t: [0.0, 0.0, t]]})
    assert np.abs(swept.position[0] - by_hand.position).max() < 1e-12
    assert swept.position[1, -1, 2] > 0.01
    held = qs.run({**pushed, "constraints": {"rotation": lambda t: [0.0, 0.0, np.cos(t)]}})
    assert held.angular_velocity[:, 2] == pytest.approx(np.cos(TIMES))


class Swirl:
    """A callable that Python cannot refer to weakly."""

    __slots__ = ()

    def __call__(self, x):
        return swirl(x)

    def push(self, t):
        return [0.0, np.sin(t), 0.0]


def test_any_callable_is_taken():
    for function in (Swirl(), functools.partial(swirl), Swirl().__call__):
        keys = {"type": "user", "function": function, "length": 6, "singular_points": [[0, 6, 0]]}
        found = qs.run({**CASE, "flow": keys}).axis
        flow = qs.flow(**keys)
        alone = qs.Body(0.5).integrate(flow, TIMES, orientation=[1, 0, 1], tolerance=1e-8)
        assert np.array_equal(found, alone.axis)
    pushed = qs.run({**CASE, "flow": qs.flow("shear"), "forces": {"force": Swirl().push}})
    assert pushed.position[-1, 1] > 0.01


def test_names_of_functions_end_with_them():
    def made(sign):
        def wind(t):
            return sign * t

        return wind

    first, second = made(1), made(-1)
    names = hand_over(first), hand_over(second), hand_over(first)
    assert names == ("<python>.py:wind", "<python>.py:wind_2", "<python>.py:wind")
    assert load_function(names[1]) is second
    del second
    with pytest.raises(CaseError, match="there is no file"):
        load_function(names[1])


def test_ranges_and_paths_are_taken(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "push.csv").write_text("t,1,2,3\n0,0,0,1\n9,0,0,1\n")
    table = {"force": {"table": tmp_path / "push.csv"}}
    case = {**CASE, "flow": {"type": "shear"}, "forces": table, "time": {"at": range(1, 3)}}
    assert qs.run(case).time.tolist() == [1.0, 2.0]


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (
            {"start": {"position": {1, 2}}},
            r"case: start.position: is {1, 2}, of type set; numbers, ",
        ),
        ({"forces": {"force": np.sin}}, r"<python>.py:sin must return three finite numbers"),
        ({"start": {"position": turning}}, r"case: start.position: is the function turning; 3"),
        ({"forces": {"force": turning}}, r"<python>.py:turning must return three finite numb"),
    ],
)
def test_what_cannot_stand_in_a_case_is_told_by_its_key(change, told):
    with pytest.raises(CaseError, match=told) as raised:
        qs.run({**CASE, "flow": {"type": "shear"}, **change})
    assert "\n" not in str(raised.value)
