"""Flows from data and functions of time: series, expressions, and what is refused."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any

import h5py
import numba
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import qbxstokes as qs
from qbxstokes.errors import CaseError, ConvergenceError, FlowError, QbxStokesError, SceneError
from qbxstokes.flows.recognition import recognised
from qbxstokes.reference.jeffery import axis_at
from qbxstokes.runs import destination as target
from qbxstokes.simulation.ensemble import Ensemble

AXIS = np.array([0.48, 0.6, 0.64])


def random_gradient(seed: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Amplitudes (5, 3, 3), traceless, and frequencies of a smooth A(t)."""
    rng = np.random.default_rng(seed)
    a = rng.normal(size=(5, 3, 3)) * 0.25
    return a - np.trace(a, axis1=1, axis2=2)[:, None, None] * np.eye(3) / 3.0, np.array(
        [0.4, 0.9, 1.5, 2.3, 3.1]
    )


def cosines(seed: int) -> object:
    amplitude, frequency = random_gradient(seed)
    return lambda t: np.einsum("n,nij->ij", np.cos(frequency * t + 1.0), amplitude)


def jeffery(gradient: object, k: float, axis: NDArray[np.float64], end: float) -> object:
    """The axis at the end, by SciPy's DOP853 of Jeffery's equation."""
    shape = (1.0 - k * k) / (1.0 + k * k)

    def rate(t: float, p: NDArray[np.float64]) -> NDArray[np.float64]:
        a = gradient(t)  # type: ignore[operator]
        pull = 0.5 * (a - a.T) @ p + shape * 0.5 * (a + a.T) @ p
        return pull - (p @ pull) * p

    return solve_ivp(rate, (0.0, end), axis, "DOP853", rtol=1e-12, atol=1e-13, max_step=0.02).y[
        :, -1
    ]


@pytest.mark.parametrize("k", [0.2, 5.0])
def test_functions_and_series_follow_jeffery(k: float) -> None:
    a = cosines(3)
    exact = jeffery(a, k, AXIS, 8.0)
    body = qs.Body(k)
    motion = body.integrate(qs.flow("linear", gradient=a), [8.0], orientation=AXIS, tolerance=1e-8)
    assert np.abs(motion.axis[-1] - exact).max() < 1e-7
    t = np.linspace(0.0, 8.0, 401)
    series = qs.GradientSeries(t, [a(s) for s in t])  # type: ignore[operator]
    flow = qs.flow("linear", gradient=series)
    motion = body.integrate(flow, [8.0], orientation=AXIS, tolerance=1e-7)
    assert np.abs(motion.axis[-1] - exact).max() < 1e-6


@pytest.mark.parametrize("k", [0.02, 0.2, 1.0, 5.0, 50.0])
def test_one_matrix_turns_all_axes(k: float) -> None:
    """Against SciPy's DOP853, Jeffery's orbit over ten periods, and held gradients."""
    a, body, times = cosines(3), qs.Body(k), np.array([0.0, 3.3, 8.0])
    starts = np.random.default_rng(1).normal(size=(2, 3, 3))
    exact = jeffery(a, k, starts[1, 2] / np.linalg.norm(starts[1, 2]), 8.0)
    for tolerance in (1e-4, 1e-7, 1e-10):
        found = body.axes(qs.flow("linear", gradient=a), times, starts, tolerance=tolerance)
        assert found.shape == (2, 3, 3, 3)
        assert np.abs(found[1, 2, -1] - exact).max() < 10.0 * tolerance
    assert (
        np.abs(found[..., 0, :] * np.linalg.norm(starts, axis=-1)[..., None] - starts).max() < 1e-14
    )
    t = np.linspace(0.0, 8.0, 41)
    for rule in ("hold", "linear", "sextic"):
        series = qs.GradientSeries(t, [a(s) for s in t], interpolation=rule)  # type: ignore[operator]
        paths = qs.GradientSeries(t, series.samples[None], interpolation=rule)
        other = Ensemble((body,), paths, AXIS, tolerance=1e-10).follow(0)[1][0, 0]
        assert np.abs(body.axes(series, [8.0], AXIS, tolerance=1e-8)[0] - other).max() < 1e-7
    t = np.linspace(0.0, 20.0 * np.pi * (k + 1.0 / k), 21)
    orbit = body.axes(qs.flow("shear"), t, AXIS, tolerance=1e-8)
    assert np.abs(orbit - axis_at(t, k, AXIS)).max() < 1e-7


def test_axes_of_what_has_no_matrix_are_refused() -> None:
    for body, flow in ((qs.Body(0.5), "paraboloid"), (qs.Body(0.5, stokes_number=1.0), "shear")):
        with pytest.raises(SceneError, match="integrate"):
            body.axes(qs.flow(flow), [1.0])
    with pytest.raises(FlowError, match="too fast"):
        qs.Body(0.5).axes(qs.flow("shear", rate=1e30), [1.0])


@pytest.mark.parametrize("k", [0.2, 5.0])
def test_a_gradient_that_turns_and_a_shear_that_oscillates(k: float) -> None:
    """In the frame that turns with A it is constant; a harmonic shear retraces Jeffery's orbit."""
    still, speed, end = np.array([[0.2, 1.0, 0.0], [-0.3, -0.5, 0.4], [0.0, 0.1, 0.3]]), 0.7, 6.0
    cross = np.array([[0.0, -speed, 0.0], [speed, 0.0, 0.0], [0.0, 0.0, 0.0]])

    def turned(t: float) -> NDArray[np.float64]:
        turn = expm(cross * t)
        return np.asarray(turn @ still @ turn.T)

    shape = (1.0 - k * k) / (1.0 + k * k)
    inside = 0.5 * (still - still.T) + 0.5 * shape * (still + still.T) - cross
    exact = expm(cross * end) @ expm(inside * end) @ AXIS
    body = qs.Body(k)
    flow = qs.flow("linear", gradient=turned)
    found = body.integrate(flow, [end], orientation=AXIS, tolerance=1e-8).axis[-1]
    assert np.abs(found - exact / np.linalg.norm(exact)).max() < 1e-7
    harmonic = [[0, "2*cos(1.5*t)", 0], [0, 0, 0], [0, 0, 0]]
    flow = qs.flow("linear", gradient=harmonic)
    found = body.integrate(flow, [end], orientation=AXIS, tolerance=1e-8).axis[-1]
    shear = np.zeros((3, 3))
    shear[0, 1] = 2.0 * np.sin(1.5 * end) / 1.5
    exact = expm(0.5 * (shear - shear.T) + 0.5 * shape * (shear + shear.T)) @ AXIS
    assert np.abs(found - exact / np.linalg.norm(exact)).max() < 1e-7


def test_a_pulse_in_a_fluid_at_rest_is_not_stepped_over() -> None:
    def pulse(t: float) -> NDArray[np.float64]:
        return 30.0 * np.exp(-(((t - 7.3) / 0.02) ** 2)) * np.eye(3)[:, [2, 0, 1]] * [[1], [0], [0]]

    exact = jeffery(pulse, 0.2, AXIS, 10.0)
    flow = qs.flow("linear", gradient=pulse)
    motion = qs.Body(0.2).integrate(flow, [10.0], orientation=AXIS, tolerance=1e-8)
    assert np.abs(motion.axis[-1] - AXIS).max() > 0.01
    assert np.abs(motion.axis[-1] - exact).max() < 1e-7


@pytest.mark.parametrize("cause", ["cubic", "divergent"])
def test_flows_that_cease_to_be_stokesian_are_refused(cause: str) -> None:
    def velocity(x: NDArray[np.float64], t: float) -> NDArray[np.float64]:
        u = np.zeros_like(x)
        u[:, 0] = x[:, 1]
        if cause == "cubic":
            u[:, 0] += t * x[:, 1] ** 3
        else:
            u += 0.1 * t * x
        return u

    with pytest.raises(SceneError, match="not Stokesian"):
        qs.Body(0.5).integrate(qs.flow("user", function=velocity), [1.0])


def test_interpolation_converges_at_its_order() -> None:
    a = cosines(5)
    errors = {}
    for name, order in (("hold", 1), ("linear", 2), ("sextic", 6)):
        sizes = []
        for n in (101, 201):
            t = np.linspace(0.0, 10.0, n)
            flow = qs.GradientSeries(t, [a(s) for s in t], interpolation=name)  # type: ignore[operator]
            places = np.linspace(2.003, 7.997, 300)
            sizes.append(max(np.abs(flow(s) - a(s)).max() for s in places))  # type: ignore[operator]
        errors[name] = np.log2(sizes[0] / sizes[1])
        assert errors[name] == pytest.approx(order, abs=0.4)


def test_files_give_the_same_series(tmp_path: Path) -> None:
    a = cosines(7)
    t = np.linspace(0.0, 4.0, 41)
    samples = np.array([[a(s).ravel(), -a(s).ravel()] for s in t])  # type: ignore[operator]
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["A"], file["t"] = samples, t
    np.save(tmp_path / "a.npy", np.column_stack([t, samples[:, 1]]))
    np.savetxt(tmp_path / "a.csv", np.column_stack([t, samples[:, 1, :8]]), delimiter=";")
    expected = -a(1.2345)  # type: ignore[operator]
    for keys in (
        {"file": "a.h5", "layout": ["time", "trajectory"]},
        {"file": "a.npy"},
        {"file": "a.csv"},
    ):
        case = {"type": "linear", "gradient": keys, "trajectory": 1 if "layout" in keys else 0}
        flow = qs.build_flow(case, tmp_path)
        assert np.abs(flow.gradient([0.0, 0.0, 0.0], 1.2345) - expected).max() < 1e-4
        with pytest.raises(FlowError, match="outside the series"):
            flow.gradient([0.0, 0.0, 0.0], 4.5)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"dataset": "group"}, "file: .*cannot be read"),
        ({"dataset": 3}, "file: .*cannot be read"),
        ({"time": "number"}, "file: .*cannot be read"),
        ({"layout": 3}, "gradient.layout: layout is 3"),
        ({"interpolation": ["linear"]}, "gradient.interpolation: .*one of sextic"),
        ({"unit": -1.0}, "gradient.unit: .*positive"),
    ],
)
def test_wrong_keys_of_a_file_are_told(tmp_path: Path, keys: dict[str, Any], message: str) -> None:
    with h5py.File(tmp_path / "f.h5", "w") as file:
        file["A"], file["t"], file["number"] = np.zeros((3, 9, 9)), np.arange(9.0), 3.0
        file.create_group("group")
    gradient = {"file": str(tmp_path / "f.h5"), **keys}
    flow = {"type": "linear", "gradient": gradient, "trajectory": 0}
    case = {"body": {"aspect_ratio": 0.2}, "flow": flow, "time": {"end": 2.0}}
    with pytest.raises(CaseError, match=message):
        qs.run(case)


def test_steps_without_number_are_refused() -> None:
    flow = qs.flow("shear", rate="t^2", longest_step=1e-12)
    with pytest.raises(FlowError, match="a run of 2e"):
        qs.Body(0.2).integrate(flow, [2.0])


def test_dimensions_with_names_and_units_of_time(tmp_path: Path) -> None:
    a = cosines(7)
    t = np.linspace(0.0, 4.0, 41)
    samples = np.array([[a(s).ravel(), -a(s).ravel()] for s in t])  # type: ignore[operator]
    with h5py.File(tmp_path / "a.nc", "w") as file:  # as netCDF-4 writes it
        file["time"], file["A"] = t, samples
        file["time"].make_scale("time")
        file["A"].dims[0].attach_scale(file["time"])
    named = qs.GradientSeries.from_file(tmp_path / "a.nc")
    assert named.paths == (2,)
    assert np.abs(named.read(1, 2)[0] - samples[:, 1]).max() < 1e-15
    scaled = qs.GradientSeries.from_file(tmp_path / "a.nc", unit=0.5)
    assert np.array_equal(scaled.times, 2.0 * t)
    assert np.abs(scaled.path(1).read(0, 1)[0] - 0.5 * samples[:, 1]).max() < 1e-15
    with pytest.raises(FlowError, match="unit"):
        qs.GradientSeries.from_file(tmp_path / "a.nc", unit=-1.0)


def test_the_trace_is_projected_and_told() -> None:
    samples = np.tile(np.diag([1.0, 0.0, 0.2]), (8, 1, 1))
    series = qs.GradientSeries(np.arange(8.0), samples)
    assert np.trace(series(2.5)) == pytest.approx(0.0, abs=1e-15)
    assert series.trace == pytest.approx(1.2)
    with pytest.raises(FlowError, match="trace"):
        qs.GradientSeries(np.arange(8.0), samples, trace="error")(2.5)


def test_a_case_takes_expressions() -> None:
    simulation = qs.from_case(
        {
            "task": "motion",
            "body": {"aspect_ratio": 0.2},
            "flow": {"type": "linear", "gradient": [[0, "cos(t)", 0], [0, 0, 0], [0, 0, 0]]},
            "start": {"orientation": {"axis": AXIS.tolist()}},
            "time": {"end": 6.0, "samples": 3, "tolerance": 1e-8},
        }
    )
    exact = jeffery(lambda t: np.cos(t) * np.outer([1, 0, 0], [0, 1, 0]), 0.2, AXIS, 6.0)
    assert np.abs(simulation.integrate([6.0]).axis[-1] - exact).max() < 1e-7


@pytest.mark.parametrize("k", [0.2, 5.0])
def test_a_shear_that_is_still_at_first_and_then_strong(k: float) -> None:
    """What the steps have to be good for shows at no single instant."""
    flow = qs.flow("linear", gradient=[[0, "200*sin(t)", 0], [0, 0, 0], [0, 0, 0]])
    motion = qs.Body(k).integrate(flow, [8.0], orientation=AXIS, tolerance=1e-6)
    exact = axis_at(200.0 * (1.0 - np.cos(8.0)), k, AXIS)
    assert np.abs(motion.axis[-1] - exact).max() < 1e-6


def test_lanes_with_gradients_of_their_own_are_those_alone() -> None:
    body, times = qs.Body(0.2), np.linspace(0.0, 3.0, 4)
    flows = [qs.flow("linear", gradient=cosines(seed)) for seed in (1, 2)]
    flows.append(qs.flow("shear"))
    scenes = [
        qs.Simulation(body, flow, orientation=[AXIS, [1, 0, 0]], tolerance=1e-8) for flow in flows
    ]
    together = qs.Simulation.stack(scenes).integrate(times)
    for place, scene in enumerate(scenes):
        alone = scene.integrate(times)
        assert np.abs(together.axis[2 * place : 2 * place + 2] - alone.axis).max() < 1e-7


@pytest.mark.parametrize("stokes_number", [0.0, 3.0])
def test_compiled_blocks_and_single_bodies_agree(stokes_number: float) -> None:
    flow = qs.flow("linear", gradient=cosines(4))
    body = qs.Body(0.5, stokes_number=stokes_number)
    axes = np.random.default_rng(1).standard_normal((9, 3))
    block = body.integrate(flow, [4.0], orientation=axes, tolerance=1e-9)
    for place in (0, 8):
        alone = body.integrate(flow, [4.0], orientation=axes[place], tolerance=1e-9)
        assert np.abs(block.axis[place, -1] - alone.axis[-1]).max() < 1e-8


def test_a_narrow_pulse_is_seen_with_a_longest_step() -> None:
    gradient = [[0, "300*exp(-((t-7.3)/0.002)**2)", 0], [0, 0, 0], [0, 0, 0]]
    strain = 300.0 * 0.002 * np.sqrt(np.pi)
    flow = qs.flow("linear", gradient=gradient, longest_step=0.005)
    motion = qs.Body(0.2).integrate(flow, [10.0], orientation=AXIS, tolerance=1e-8)
    assert motion.summary["longest_step"] == 0.005
    assert np.abs(motion.axis[-1] - axis_at(strain, 0.2, AXIS)).max() < 1e-7
    with pytest.raises(FlowError, match="longest_step"):
        qs.flow("linear", gradient=gradient, longest_step=0.0)


@pytest.mark.parametrize("k", [0.03, 0.12, 20.0])
def test_what_a_law_leaves_over_many_turns_is_told(k: float) -> None:
    end = 10.0 * 2.0 * np.pi * (k + 1.0 / k)
    found = qs.Body(k, tolerance=1e-7).integrate(
        qs.flow("shear"), [end], orientation=AXIS, tolerance=1e-9
    )
    error = float(np.linalg.norm(found.axis[-1] - AXIS))
    told = found.summary["expected_error"]
    assert error / 3.0 < told["total"] < 100.0 * max(error, 1e-9)
    assert told["total"] == sum(value for name, value in told.items() if name != "total")


def test_large_files_count_by_their_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(target, "_LARGE", 1000)
    monkeypatch.setattr(target, "_END", 100)
    path = tmp_path / "a.npy"
    seen = set()
    for size, place in ((900, 450), (2000, None), (2000, 0), (2000, 1999), (2100, None)):
        content = bytearray(size)
        if place is not None:
            content[place] = 1
        path.write_bytes(content)
        os.utime(path, ns=(10**18, 10**18))
        seen.add(target.fingerprint(path))
    os.utime(path, ns=(2 * 10**18, 2 * 10**18))
    seen.add(target.fingerprint(path))
    assert len(seen) == 6


def test_functions_that_are_polynomials_are_recognised() -> None:
    def shear(x: Any) -> Any:
        return np.stack(
            [
                x[:, 1] + 0.125 * (x[:, 1] ** 3 - 3.0 * x[:, 1] * x[:, 2] ** 2),
                0.0 * x[:, 0],
                0.0 * x[:, 0],
            ],
            1,
        )

    terms = {"u1": {"x2": 1.0, "x2^3": 0.125, "x2*x3^2": -0.375}}
    body, times = qs.Body(0.2), [1.0, 3.0]
    found = body.integrate(qs.flow("user", function=shear), times, orientation=AXIS)
    named = body.integrate(qs.flow("polynomial", coefficients=terms), times, orientation=AXIS)
    assert np.array_equal(found.axis, named.axis)
    assert found.summary["recognised"].startswith("a polynomial of degree 3")
    whole = qs.flow("user", function=shear, recognise=False)
    plain = body.integrate(whole, times, orientation=AXIS)
    assert "recognised" not in plain.summary
    assert np.abs(plain.axis - named.axis).max() < 1e-9


def test_a_polynomial_of_every_instant_is_recognised() -> None:
    def oscillating(x: Any, t: float) -> Any:
        return np.stack(
            [np.cos(t) * x[:, 1] + np.sin(t) * x[:, 1] ** 2, 0.0 * x[:, 0], 0.1 + 0.0 * x[:, 0]], 1
        )

    motions = [
        qs.Body(0.2).integrate(
            qs.flow("user", function=oscillating, recognise=recognise),
            [3.0],
            position=[0.0, 0.5, 0.0],
            orientation=axes,
            tolerance=1e-8,
        )
        for recognise, axes in ((True, AXIS), (False, AXIS), (True, [AXIS] * 9))
    ]
    assert "of degree 2 at every instant" in motions[0].summary["recognised"]
    for motion in motions[1:]:
        assert np.abs(motion.axis[..., -1, :] - motions[0].axis[-1]).max() < 1e-7
        assert np.abs(motion.position[..., -1, :] - motions[0].position[-1]).max() < 1e-7


def test_what_is_a_polynomial_only_where_it_was_tried_ends_the_run() -> None:
    def clipped(x: Any) -> Any:
        return np.stack(
            [np.where(x[:, 0] < 500.0, 100.0 + x[:, 1], 0.0), 0.0 * x[:, 0], 0.0 * x[:, 0]], 1
        )

    def late(x: Any, t: float) -> Any:
        w = x[:, 1] + max(0.0, t - 35.0) * x[:, 1] ** 4
        return np.stack([w, 0.0 * w, 0.0 * w], 1)

    def wave(x: Any) -> Any:
        return np.stack([np.sin(x[:, 1] / 500.0), 0.0 * x[:, 0], 0.0 * x[:, 0]], 1)

    for function, end in ((clipped, 10.0), (late, 40.0)):
        with pytest.raises(ConvergenceError, match="recognise: false"):
            qs.Body(0.5).integrate(qs.flow("user", function=function), [end], tolerance=1e-6)
    assert recognised(qs.flow("user", function=wave)) is None


ROLLS = """
import math
import numpy as np

def slow(x, t, s):
    w = s * (1.0 + 0.3 * np.cos(t)) * np.exp(0.3 * x[:, 1])
    return np.stack([w * np.cos(0.3 * x[:, 0]), w * np.sin(0.3 * x[:, 0]), 0.0 * w], axis=1)

def fast(x, y, z, t, s):
    w = s * (1.0 + 0.3 * math.cos(t)) * math.exp(0.3 * y)
    return w * math.cos(0.3 * x), w * math.sin(0.3 * x), 0.0

def steady(x, y, z):
    return y, 0.0, 0.0

def wrong(x, y, z):
    return y

def strange(x, y, z):
    return open("a"), 0.0, 0.0
"""


def test_a_compiled_function_moves_a_body_as_the_plain_one(tmp_path: Path) -> None:
    (tmp_path / "rolls.py").write_text(ROLLS)
    case = {
        "body": {"aspect_ratio": 0.2},
        "flow": {
            "type": "user",
            "function": f"{tmp_path}/rolls.py:slow",
            "parameters": {"s": 0.5},
            "length": 3.0,
        },
        "start": {"orientation": {"axis": AXIS.tolist()}},
        "time": {"end": 1.0, "samples": 3, "tolerance": 1e-8},
    }
    for stokes in (0.0, 1.0):
        case["body"] = {"aspect_ratio": 0.2, "stokes_number": stokes}
        plain = qs.run(case)
        name = f"{tmp_path}/rolls.py:fast"
        fast = qs.run({**case, "flow": {**case["flow"], "function": name, "compiled": True}})
        for one in ("axis", "position", "orientation"):
            assert np.abs(plain[one] - fast[one]).max() < 1e-10
    with pytest.raises(FlowError, match=r"parameters are \['s'\]"):
        qs.flow("user", function=name, compiled=True)


@pytest.mark.parametrize(
    ("stokes_number", "loaded"),
    [
        (2.0, True),
        *(pytest.param(*p, marks=pytest.mark.slow) for p in ((0.0, True), (1e-3, True))),
    ],
)
def test_compiled_flows_with_loads_and_inertia(
    stokes_number: float, loaded: bool, tmp_path: Path
) -> None:
    (tmp_path / "rolls.py").write_text(ROLLS)
    loads = None
    if loaded:
        loads = qs.Loads(
            force=[0.3, -2, 1],
            torque=[0.2, 0.1, 0.3],
            body_force=[0, 0.2, 1],
            body_torque=[1, 0, 2],
        )
    slow, fast = (
        qs.Body(0.4, stokes_number=stokes_number).integrate(
            qs.flow(
                "user",
                function=f"{tmp_path}/rolls.py:{name}",
                compiled=name == "fast",
                parameters={"s": 0.5},
                length=3.0,
            ),
            [1.0],
            orientation=[AXIS, [1, 0, 0]],
            loads=loads,
            tolerance=1e-9,
        )
        for name in ("slow", "fast")
    )
    stiff = stokes_number == 1e-3
    assert fast.summary["method"] == slow.summary["method"] == ("bdf" if stiff else "8vr")
    for name in ("axis", "position", "velocity"):
        off = np.abs(getattr(fast, name) - getattr(slow, name)).max()
        assert off < (1e-9 if stiff else 1e-12)  # Jacobians are not the same to the last digit


def test_functions_of_c_move_a_body_as_the_plain_one(tmp_path: Path) -> None:
    (tmp_path / "rolls.py").write_text(ROLLS)

    def in_c(x, y, z, t, p, u):  # type: ignore[no-untyped-def]
        w = p[0] * (1.0 + 0.3 * math.cos(t)) * math.exp(0.3 * y)
        u[0], u[1], u[2] = w * math.cos(0.3 * x), w * math.sin(0.3 * x), 0.0

    pointer = numba.types.CPointer(numba.float64)
    found = numba.cfunc(numba.void(*[numba.float64] * 4, pointer, pointer))(in_c)
    given = f"{tmp_path}/rolls.py:slow", found, found.ctypes, found.address
    motions = [
        qs.Body(0.2).integrate(
            qs.flow("user", function=f, parameters={"s": 0.5}, length=3.0, compiled=f != given[0]),
            [1.0],
            orientation=AXIS,
            tolerance=1e-8,
        )
        for f in given
    ]
    for motion in motions[1:]:
        assert np.abs(motion.axis - motions[0].axis).max() < 1e-13
    (tmp_path / "a.so").write_bytes(b"")
    with pytest.raises(FlowError, match="compiled: true"):
        qs.flow("user", function=f"{tmp_path}/a.so:velocity")
    other = numba.cfunc(numba.float64(numba.float64))(lambda x: x)
    with pytest.raises(FlowError, match="a C function of a flow is void"):
        qs.flow("user", function=other, compiled=True)


def test_steps_are_taken_again_where_a_grid_misses_too_much() -> None:
    """A body that drifts into a region where the flow varies over it."""

    def stokeslet(x: Any) -> Any:
        r = x - [30.0, 3.0, 0.0]
        d = np.linalg.norm(r, axis=1, keepdims=True)
        return [1.0, 0.0, 0.0] + 3.0 * ([0.0, 1.0, 0.0] / d + r * r[:, 1:2] / d**3)

    flow, body = qs.flow("user", function=stokeslet, length=3.0), qs.Body(0.5)
    motion = body.integrate(flow, [34.0], orientation=AXIS, tolerance=1e-5)
    exact = qs.flow("uniform", velocity=[1, 0, 0]) + qs.flow(
        "stokeslet", strength=[0, 24.0 * np.pi, 0], position=[30, 3, 0]
    )
    true = body.integrate(exact, [34.0], orientation=AXIS, tolerance=1e-9)
    assert np.abs(motion.axis - true.axis).max() < 1e-5
    assert np.abs(motion.position - true.position).max() < 1e-4
    assert motion.summary["coarsest_nodes"][0] < 6 < motion.summary["finest_nodes"][0]


def test_what_cannot_be_compiled_is_told(tmp_path: Path) -> None:
    (tmp_path / "rolls.py").write_text(ROLLS)
    for name, message in (("slow", "arguments"), ("wrong", "three numbers"), ("strange", "open")):
        with pytest.raises(FlowError, match=message):
            qs.flow(
                "user",
                function=f"{tmp_path}/rolls.py:{name}",
                compiled=True,
                parameters={"s": 1.0} if name == "slow" else None,
            )
    flow = qs.flow("user", function=f"{tmp_path}/rolls.py:steady", compiled=True)
    assert flow.steady
    axes = np.random.default_rng(1).normal(size=(5, 3))
    found = qs.Simulation(qs.Body(0.5), flow, orientation=axes, tolerance=1e-8).integrate([2.0])
    shear = qs.Simulation(qs.Body(0.5), qs.flow("shear"), orientation=axes).integrate([2.0])
    assert np.abs(found.axis - shear.axis).max() < 1e-7


@pytest.mark.parametrize("stokes", [0.0, 2.0])
def test_steps_end_where_a_flow_is_not_smooth(stokes: float) -> None:
    """A gradient that is held from sample to sample, and one that is switched over, within 10 tol.

    Of massless bodies against exponentials, of others against the nodes of ensembles.
    """
    times = np.linspace(0.0, 5.0, 21)
    a = np.array([cosines(3)(t) for t in times])  # type: ignore[operator]
    series = qs.GradientSeries(times, a, interpolation="hold")
    body, k = qs.Body(0.2, stokes_number=stokes), 0.2
    if stokes:
        paths = qs.GradientSeries(times, a[None], interpolation="hold")
        exact = Ensemble((body,), paths, AXIS, tolerance=1e-11).follow(0)[1][0, 0]
    else:
        exact = AXIS
        for gradient in a[:-1]:
            strain, turn = 0.5 * (gradient + gradient.T), 0.5 * (gradient - gradient.T)
            exact = expm(0.25 * (turn + (1.0 - k * k) / (1.0 + k * k) * strain)) @ exact
        exact = exact / np.linalg.norm(exact)
    for tolerance in (1e-5, 1e-9):
        motion = body.integrate(
            qs.flow("linear", gradient=series), [5.0], orientation=AXIS, tolerance=tolerance
        )
        assert np.abs(motion.axis[-1] - exact).max() < 10.0 * tolerance
        switched = qs.flow(
            "linear", gradient=lambda t: a[min(int(4.0 * t), 19)], breaks=times[1:-1].tolist()
        )
        again = body.integrate(switched, [5.0], orientation=AXIS, tolerance=tolerance)
        assert np.abs(again.axis[-1] - exact).max() < 10.0 * tolerance


@pytest.mark.parametrize("stokes", [0.0, 2.0])
def test_single_motions_tell_what_the_sampling_leaves(tmp_path: Path, stokes: float) -> None:
    a, fine = cosines(4), np.linspace(0.0, 6.0, 1201)
    body = qs.Body(0.3, stokes_number=stokes)
    samples = np.array([a(t) for t in fine])  # type: ignore[operator]

    def motion(every: int, rule: str) -> qs.Motion:
        series = qs.GradientSeries(fine[::every], samples[::every], interpolation=rule)
        flow = qs.flow("linear", gradient=series)
        return body.integrate(flow, [6.0], orientation=AXIS, tolerance=1e-10)

    exact = motion(1, "sextic")
    for every, rule in ((40, "sextic"), (40, "linear"), (8, "linear")):
        found = motion(every, rule)
        off = float(np.linalg.norm(found.axis[-1] - exact.axis[-1]))
        assert 0.1 * off < found.sampling["axis"] < 30.0 * off
    np.save(tmp_path / "a.npy", np.column_stack([fine[::40], samples[::40].reshape(-1, 9)]))
    found = qs.run(
        {
            "body": {"aspect_ratio": 0.3, "stokes_number": stokes},
            "flow": {"type": "linear", "gradient": {"file": f"{tmp_path}/a.npy"}},
            "start": {"orientation": {"axis": AXIS.tolist()}},
            "time": {"end": 6.0, "samples": 3, "tolerance": 1e-9},
        }
    )
    told = motion(40, "sextic").sampling["axis"]
    assert found.summary["sampling"]["axis"] == pytest.approx(told, rel=1e-3)
    assert body.integrate(qs.flow("shear"), [1.0]).sampling == {}


def test_paths_that_follow_one_another_in_a_file(tmp_path: Path) -> None:
    """CF's contiguous ragged arrays, and gradients of three by three, read in parts."""
    rng, t = np.random.default_rng(1), np.linspace(0.0, 2.0, 21)
    a = rng.normal(size=(3, 21, 3, 3))
    a -= np.trace(a, axis1=2, axis2=3)[..., None, None] * np.eye(3) / 3.0
    lengths = [21, 15, 18]
    with h5py.File(tmp_path / "ragged.h5", "w") as file:
        file["rowsize"] = lengths
        file["A"] = np.concatenate([a[i, :n] for i, n in enumerate(lengths)])
        file["t"] = np.concatenate([t[:n] for n in lengths])
        file["square"], file["time"] = a, t
        file["late"] = np.concatenate([t[:n] + i for i, n in enumerate(lengths)])
    name = tmp_path / "ragged.h5"
    series = qs.GradientSeries.from_file(name, rows="rowsize")
    assert series.paths == (3,)
    assert np.abs(series.read(0, 3) - a[:, :15].reshape(3, 15, 9)).max() < 1e-14
    two = series.chosen(np.array([2, 0])).read(0, 2)
    assert np.abs(two - a[[2, 0], :15].reshape(2, 15, 9)).max() < 1e-14
    square = qs.GradientSeries.from_file(name, dataset="square", time="time")
    assert np.abs(square.read(1, 3, 4, 9) - a[1:, 4:9].reshape(2, 5, 9)).max() < 1e-14
    np.save(tmp_path / "a.npy", np.swapaxes(a, 0, 1).astype(np.float32))
    np.save(tmp_path / "t.npy", t)
    layout = ["time", "trajectory"]
    mapped = qs.GradientSeries.from_file(tmp_path / "a.npy", time="t.npy", layout=layout, unit=2.0)
    assert np.abs(mapped.read(1, 3, 4, 9) - 2.0 * a[1:, 4:9].reshape(2, 5, 9)).max() < 1e-6
    assert np.array_equal(mapped.times, t / 2.0)
    with pytest.raises(FlowError, match="cannot be read"):
        qs.GradientSeries.from_file(tmp_path / "a.npy", time="none.npy")
    given = {"file": str(name), "rows": "rowsize"}
    flow = qs.flow("linear", gradient=given, trajectory=2)
    assert np.abs(flow.gradient(np.zeros(3), 1.7) - a[2, 17]).max() < 1e-12
    late = qs.flow("linear", gradient={**given, "time": "late", "outside": "clamp"}, trajectory=1)
    assert np.abs(late.gradient(np.zeros(3), 1.3) - a[1, 3]).max() < 1e-12
    for keys, message in (
        ({"rows": "rowsize", "time": "late"}, "times of their own"),
        ({"rows": "none"}, "cannot be read"),
        ({"rows": "t"}, "add up"),
    ):
        with pytest.raises(FlowError, match=message):
            qs.GradientSeries.from_file(name, **keys)
    with pytest.raises(FlowError, match="trajectory 7 of 3"):
        qs.flow("linear", gradient=given, trajectory=7)


def test_a_gradient_that_dies_out_ends_no_motion() -> None:
    """Its trace is rounding of the least numbers there are."""
    a = cosines(3)(0.0)  # type: ignore[operator]
    flow = qs.flow("linear", gradient=lambda t: 5.0 * np.exp(-(((t - 7.0) / 0.1) ** 2)) * a)
    motion = qs.Body(0.2).integrate(flow, [0.0, 10.0], orientation=AXIS, tolerance=1e-8)
    assert motion.time[-1] == 10.0
    assert "ended_by" not in motion.summary["events"]
    bad = qs.flow("linear", gradient=lambda t: a + (t > 1.0) * np.eye(3))
    with pytest.raises(ConvergenceError, match="trace"):
        qs.Body(0.2).integrate(bad, [10.0], orientation=AXIS)


@pytest.mark.parametrize("breaks", [[1.0, 1.0], ["a"], [[1.0, 2.0]], [float("nan")]])
def test_breaks_that_are_none_are_refused(breaks: object) -> None:
    gradient = [[0, "t", 0], [0, 0, 0], [0, 0, 0]]
    with pytest.raises(FlowError, match="breaks"):
        qs.flow("linear", gradient=gradient, breaks=breaks)


WAVES = """
import numpy as np

K = 0.03

def velocity(x, t, s):
    e = s * np.exp(K * x[:, 1]) * (1.0 + 0.3 * np.cos(t))
    return np.stack([e * np.cos(K * x[:, 0]), e * np.sin(K * x[:, 0]), 0.0 * e], axis=1)

def gradient(x, t, s):
    u, v, _ = velocity(x, t, s).T
    out = np.zeros((len(x), 3, 3))
    out[:, 0, 0], out[:, 0, 1], out[:, 1, 0], out[:, 1, 1] = -K * v, K * u, K * u, K * v
    return out

def hessian(x, t, s):
    u, v, _ = velocity(x, t, s).T
    out = np.zeros((len(x), 3, 3, 3))
    out[:, 0, 0, 0], out[:, 0, 1, 1], out[:, 0, 0, 1], out[:, 0, 1, 0] = -u, u, -v, -v
    out[:, 1, 0, 0], out[:, 1, 1, 1], out[:, 1, 0, 1], out[:, 1, 1, 0] = -v, v, u, u
    return K * K * out

def other(x, t, s):
    return 1.1 * gradient(x, t, s)
"""


def test_small_bodies_in_flows_that_are_none_of_stokes() -> None:
    """In an ABC flow, u = curl u; the centre goes with it, the axis by Jeffery's equation."""
    size = 0.02

    def velocity(x: np.ndarray) -> np.ndarray:
        s, c = np.sin(size * x), np.cos(size * x)
        return np.stack([s[:, 2] + c[:, 1], s[:, 0] + c[:, 2], s[:, 1] + c[:, 0]], axis=1)

    def rates(_: float, y: np.ndarray) -> np.ndarray:
        s, c = size * np.sin(size * y[:3]), size * np.cos(size * y[:3])
        a = np.array([[0, -s[1], c[2]], [c[0], 0, -s[2]], [-s[0], c[1], 0]])
        turned = 0.5 * (a - a.T) @ y[3:] + (12 / 13) * 0.5 * (a + a.T) @ y[3:]
        return np.concatenate([velocity(y[None, :3])[0], turned - y[3:] * (y[3:] @ turned)])

    case: dict[str, object] = {
        "body": {"aspect_ratio": 0.2},
        "flow": {"type": "user", "function": velocity, "length": 50.0},
        "start": {"orientation": {"axis": AXIS.tolist()}},
        "time": {"end": 9.0, "samples": 2, "tolerance": 1e-9},
    }
    found = qs.run({**case, "hydrodynamics": {"derivatives": 1}})
    start = np.concatenate([np.zeros(3), AXIS])
    exact = solve_ivp(rates, (0, 9), start, "DOP853", rtol=1e-11, atol=1e-13).y[:, -1]
    assert np.abs(np.concatenate([found.position[-1], found.axis[-1]]) - exact).max() < 1e-7
    with pytest.raises(QbxStokesError, match=r"not Stokesian: .*hydrodynamics\.derivatives"):
        qs.run(case)


def test_small_bodies_are_moved_by_derivatives_at_their_centres(tmp_path: Path) -> None:
    """What that leaves out is told, and as large as the difference to the whole surface."""
    (tmp_path / "waves.py").write_text(WAVES)

    def case(degree: int | None, **flow: str) -> dict[str, object]:
        given = {name: f"{tmp_path}/waves.py:{value}" for name, value in flow.items()}
        return {
            "body": {"aspect_ratio": 0.2},
            "flow": {
                "type": "user",
                "function": f"{tmp_path}/waves.py:velocity",
                "parameters": {"s": 5.0},
                "length": 30.0,
                **given,
            },
            "start": {"orientation": {"axis": AXIS.tolist()}},
            "hydrodynamics": {} if degree is None else {"derivatives": degree},
            "time": {"end": 1.0, "samples": 3, "tolerance": 1e-8},
        }

    whole = qs.run(case(None))
    names = {"gradient": "gradient", "hessian": "hessian"}
    for degree, flow in ((1, {}), (2, {}), (1, {"gradient": "gradient"}), (2, names)):
        found = qs.run(case(degree, **flow))
        velocity, turning = found.summary["hydrodynamics"]["neglected"]
        assert 1e-9 < turning < 1e-4
        assert 1e-9 < velocity < (1e-2 if degree == 1 else 1e-6)
        assert np.abs(found.axis - whole.axis).max() < turning
        assert np.abs(found.velocity - whole.velocity).max() < velocity
    with pytest.raises(QbxStokesError, match=r"flow\.gradient: the gradient differs"):
        qs.run(case(1, gradient="other"))
    with pytest.raises(QbxStokesError, match="derivatives"):
        qs.run({**case(1), "flow": {"type": "shear"}})
