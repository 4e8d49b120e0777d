"""Numbers of flows that change in time: functions, expressions and series by one kernel."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_data_flows import AXIS, cosines, jeffery

import qbxstokes as qs
from qbxstokes.errors import ConvergenceError, QbxStokesError, SceneError, SinglePrecisionWarning
from qbxstokes.flows.interpolation import Series
from qbxstokes.flows.signals import Part, Sampled, Signal
from qbxstokes.petsc.stepper import integrate
from qbxstokes.simulation.assembly import assemble

TIMES = np.linspace(0.0, 6.0, 241)

GRADIENTS = [[[0, 1, 0], [0, 0, 0], [0, 0, 0]], [[0, 2, 0], [0, 0, 0], [0, 0, 0]]]
LINEAR = {"interpolation": "linear"}
SHEAR = np.array(GRADIENTS[0], dtype=float)


def sampled(function: Any, end: float = 10.0, accuracy: float = 1e-10) -> Sampled:
    found = Sampled(Signal([Part(function, (), ("rate",))]), end, accuracy, end / 50.0)
    found.cover(end, 0.0)
    return found


@pytest.mark.parametrize("k", [0.2, 5.0])
def test_a_motion_is_that_of_scipy_to_ten_digits(k: float) -> None:
    flow = qs.flow("linear", gradient=cosines(3))
    motion = qs.Body(k).integrate(flow, [8.0], orientation=AXIS, tolerance=1e-11)
    assert np.abs(motion.axis[-1] - jeffery(cosines(3), k, AXIS, 8.0)).max() < 1e-10


def test_steps_pass_samples_at_which_six_points_are_smooth_enough() -> None:
    """Four hundred samples of slow waves; of a pulse the steps end at samples."""
    times, body = np.linspace(0.0, 20.0, 401), qs.Body(3.0)
    waves = np.array([cosines(3)(0.5 * t) for t in times])
    pulse = 30.0 * np.exp(-(((times - 7.3) / 0.05) ** 2))[:, None, None] * waves[0]
    for samples, most in ((waves, 60), (waves + pulse, 120)):
        series = qs.GradientSeries(times, samples)
        motion = body.integrate(
            qs.flow("linear", gradient=series), [20.0], orientation=AXIS, tolerance=1e-6
        )
        exact = body.axes(series, [20.0], AXIS, tolerance=1e-12)
        assert np.abs(motion.axis[-1] - exact[-1]).max() < 1e-6
        assert motion.summary["steps"] < most
    rough = series.breaks(20.0, 1e-3)
    assert 5 < len(rough) < 40
    assert np.abs(rough - 7.3).max() < 0.6
    assert (len(series.breaks(20.0)), len(series.breaks(20.0, 1e-14))) == (399, 395)


def test_pieces_are_the_function_and_end_where_it_does() -> None:
    t = np.linspace(0.0, 10.0, 2001)
    smooth = sampled(lambda s: np.cos(3.0 * s) + 30.0 * np.exp(-(((s - 7.3) / 0.05) ** 2)))
    exact = np.cos(3.0 * t) + 30.0 * np.exp(-(((t - 7.3) / 0.05) ** 2))
    assert np.abs(smooth.many(t)[:, 0] - exact).max() < 3e-9
    assert smooth.asked < 2000
    jump = sampled(lambda s: float(s > np.pi))
    off = np.abs(jump.many(t)[:, 0] - (t > np.pi))
    assert (off > 1e-9).sum() <= 1
    ended = sampled(lambda s: np.sqrt(1e-3 + 9.0 - s) if s < 9.0 else 1 / 0)
    assert 8.999 < ended.edges[-1] <= 9.0
    assert "division" in str(ended.refusal)
    long = sampled(np.cos, end=2e4)
    t = np.linspace(0.0, 2e4, 1001)
    assert long.edges[-1] == 2e4
    later = t[t >= long.edges[0]]
    assert np.abs(long.many(later)[:, 0] - np.cos(later)).max() < 1e-8
    with pytest.warns(SinglePrecisionWarning, match="rough in time"):
        rough = sampled(lambda s: np.float32(np.sin(s)), accuracy=1e-12)
    t = np.linspace(0.0, 10.0, 2001)
    assert np.abs(rough.many(t)[:, 0] - np.sin(t)).max() < 1e-6


def test_what_is_no_function_of_time_to_speak_of_is_refused() -> None:
    rng = np.random.default_rng(1)
    noise = sampled(lambda s: rng.normal())
    assert noise.edges[-1] == 0.0
    assert "no smooth function of time" in str(noise.refusal)
    pole = sampled(lambda s: 1.0 / (3.0 - s))
    assert pole.edges[-1] == pytest.approx(3.0, abs=1e-10)
    assert "without bound" in str(pole.refusal)


@pytest.mark.parametrize(
    ("keys", "gradient"),
    [
        (
            {"type": "shear", "rate": "1 + cos(t)"},
            lambda t: [[0, 1 + np.cos(t), 0], [0] * 3, [0] * 3],
        ),
        (
            {"type": "extension", "kind": "planar", "rate": np.cos},
            lambda t: np.diag([np.cos(t), -np.cos(t), 0.0]),
        ),
        (
            {"type": "rotation", "angular_velocity": [0, "sin(t)", 1]},
            lambda t: [[0, -1, np.sin(t)], [1, 0, 0], [-np.sin(t), 0, 0]],
        ),
        (
            {
                "type": "polynomial",
                "coefficients": {"u1": {"x2": "t/3", "x1": 0.1}, "u3": {"x3": -0.1}},
            },
            lambda t: [[0.1, t / 3, 0], [0] * 3, [0, 0, -0.1]],
        ),
        (
            {"type": "shear", "rate": Series(TIMES, 1.0 + np.cos(TIMES))},
            lambda t: [[0, 1 + np.cos(t), 0], [0] * 3, [0] * 3],
        ),
        (
            {"type": "linear", "gradient": {"times": [0, 9], "values": GRADIENTS} | LINEAR},
            lambda t: [[0, 1 + t / 9, 0], [0] * 3, [0] * 3],
        ),
        (
            {"type": "sum", "terms": [{"type": "shear"}, {"type": "shear", "rate": "cos(t)"}]},
            lambda t: [[0, 1 + np.cos(t), 0], [0] * 3, [0] * 3],
        ),
        (
            {"type": "transformed", "flow": {"type": "shear"}, "factor": "1 + cos(t)"},
            lambda t: [[0, 1 + np.cos(t), 0], [0] * 3, [0] * 3],
        ),
    ],
)
def test_every_number_of_a_flow_may_change(keys: dict[str, Any], gradient: Any) -> None:
    flow = qs.flow(**keys)
    assert not flow.steady
    assert flow.degree == 1
    motion = qs.Body(0.3).integrate(flow, [5.0], orientation=AXIS, tolerance=1e-8)
    exact = jeffery(lambda t: np.array(gradient(t), dtype=float), 0.3, AXIS, 5.0)
    assert np.abs(motion.axis[-1] - exact).max() < 1e-7


def test_curved_and_singular_flows_change_as_the_same_functions() -> None:
    body, start = qs.Body(0.4), {"position": [0.2, 0.5, -0.3], "orientation": AXIS}

    def stream(x: Any, t: float) -> Any:
        speed = np.cos(t) * (1.0 - 0.04 * (x[:, 1] ** 2 + x[:, 2] ** 2))
        return speed[:, None] * [1.0, 0.0, 0.0]

    tube = qs.flow("tube_poiseuille", radius=5.0, speed="cos(t)")
    assert tube.degree == 2
    found = body.integrate(tube, [3.0], **start, tolerance=1e-8)
    exact = body.integrate(qs.flow("user", function=stream), [3.0], **start, tolerance=1e-8)
    assert np.abs(found.axis - exact.axis).max() < 1e-7
    assert np.abs(found.position - exact.position).max() < 1e-7
    point = {"position": [0.0, 4.0, 0.0]}
    one = qs.flow("stokeslet", strength=[0, "2*t", 9], **point)
    two = 2.0 * qs.flow("stokeslet", strength=["0", "t", "4.5"], **point)
    x = np.array([[0.3, 0.1, 0.2]])
    steady = qs.flow("stokeslet", strength=[0, 1.4, 9], **point).velocity(x)
    assert np.allclose(one.velocity(x, 0.7), steady, rtol=1e-14)
    assert np.allclose(two.velocity(x, 0.7), steady, rtol=1e-14)
    assert len(one.singular_points) == 1
    assert one.degree is None


def test_stresslets_and_fields_know_flows_that_change() -> None:
    body, place = qs.Body(0.4), {"position": [0.1, 0.2, 0], "orientation": AXIS, "t": 0.7}
    one = qs.flow("shear", rate="cos(t)")
    two = qs.flow("shear", rate=float(np.cos(0.7)))
    assert np.allclose(body.stresslet(one, **place), body.stresslet(two, **place), atol=1e-12)
    points = np.array([[2.0, 1.0, 1.0]])
    found = [body.field(flow, points, **place)["velocity"] for flow in (one, two)]
    assert np.allclose(*found, atol=1e-12)
    motion = body.integrate(one, [0.7], orientation=AXIS, tolerance=1e-8)
    exact = body.stresslet(two, orientation=motion.axis[-1])
    assert np.allclose(motion.stresslet[-1], exact, atol=1e-6)


def test_a_case_reads_series_of_numbers(tmp_path: Path) -> None:
    np.savetxt(tmp_path / "rate.csv", np.column_stack([TIMES, np.cos(TIMES)]), delimiter=",")
    (tmp_path / "own.py").write_text("import math\ndef rate(t):\n    return math.cos(t)\n")
    axes = []
    for rate in (
        "cos(t)",
        "own.py:rate",
        {"file": "rate.csv"},
        {"times": TIMES.tolist(), "values": np.cos(TIMES).tolist(), "outside": "clamp"},
    ):
        case = {
            "body": {"aspect_ratio": 0.3},
            "flow": {"type": "shear", "rate": rate},
            "start": {"orientation": {"axis": AXIS.tolist()}},
            "time": {"end": 5, "tolerance": 1e-8},
        }
        (tmp_path / "case.yaml").write_text(json.dumps(case))
        scene = qs.from_case(tmp_path / "case.yaml")
        axes.append(scene.integrate([5.0]).axis[-1])
    assert np.ptp(axes, axis=0).max() < 1e-7


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        (
            {"type": "uniform", "velocity": [Series(TIMES, TIMES), 0, 0]},
            "a series stands for the whole of velocity",
        ),
        ({"type": "shear", "rate": "t", "trajectory": 1}, "without a series of gradients"),
        ({"type": "shear", "rate": "cos(x)"}, "rate must be a finite number or an expression in t"),
        ({"type": "shear", "rate": Series(TIMES, np.ones((241, 2)))}, "2 numbers in its series"),
        ({"type": "shear", "rate": {"times": [0, 1], "value": [0, 1]}}, "no key 'value'"),
        ({"type": "shear", "rate": {"times": [0, 1]}}, "values is missing"),
        ({"type": "shear", "rate": {"times": [0, 1], "values": [0]}}, "values have shape (1,)"),
        ({"type": "shear", "rate": lambda t: [1.0, 2.0]}, "the rate at t = 0 must be a finite"),
        ({"type": "linear", "gradient": [["t", 0, 0], [0, 0, 0], [0, 0, "-t*t"]]}, "trace"),
        ({"type": "shear", "rate": {"times": [0, 2], "values": [0, 1]}}, "too few for six points"),
    ],
)
def test_what_cannot_change_so_is_refused(keys: dict[str, Any], message: str) -> None:
    with pytest.raises(QbxStokesError, match=re.escape(message)):
        qs.Body(0.5).integrate(qs.flow(**keys), [3.0], tolerance=1e-6)


def test_terms_that_are_no_stokes_flow_together_are_refused() -> None:
    flow = qs.flow("polynomial", coefficients={"u1": {"x1": "t"}, "u2": {"x2": "-sin(t)"}})
    with pytest.raises(QbxStokesError, match="not Stokesian"):
        qs.Body(0.5).integrate(flow, [3.0], tolerance=1e-6)


@pytest.mark.parametrize("stokes", [0.0, 0.5])
def test_plain_and_compiled_find_the_same_numbers(stokes: float) -> None:
    flow = qs.flow("linear", gradient=cosines(4)) + 0.3 * qs.flow("paraboloid", curvature="sin(t)")
    body = qs.Body(0.3, stokes_number=stokes)
    found = []
    for evaluation in ("plain", "compiled"):
        scene = qs.Simulation(body, flow, orientation=AXIS, position=[0.1, 0, 0.2], tolerance=1e-7)
        scene = scene.assemble()
        scene.equations.evaluation = evaluation
        found.append(scene.integrate([1.0, 2.5]))
    assert np.array_equal(found[0].axis, found[1].axis)
    assert np.array_equal(found[0].position, found[1].position)


def test_lanes_with_flows_of_their_own_find_the_same_numbers() -> None:
    times, axes = np.linspace(0.0, 3.0, 61), np.random.default_rng(3).normal(size=(10, 3))
    gradients: list[Any] = [cosines(seed) for seed in range(10)]
    series = qs.GradientSeries(times, [[a(t) for t in times] for a in gradients])
    flows = [qs.flow("linear", gradient=series.path(n)) for n in range(9)] + [qs.flow("shear")]
    mixed = [*flows[:8], qs.flow("linear", gradient=gradients[8]), flows[9]]
    for block in (flows, mixed):
        scenes = [
            qs.Simulation(qs.Body(0.3), flow, orientation=axis, tolerance=1e-7)
            for flow, axis in zip(block, axes, strict=True)
        ]
        found = []
        for evaluation in ("plain", "compiled"):
            together = assemble(scenes, evaluation=evaluation)
            found.append(together.integrate([1.0, 3.0]).axis)
        assert np.array_equal(found[0], found[1])
        alone = [scene.integrate([1.0, 3.0]).axis for scene in scenes]
        assert np.abs(found[0] - np.array(alone)).max() < 1e-6


def test_a_function_is_asked_once_for_however_many_bodies() -> None:
    calls = 0
    inner = cosines(5)

    def gradient(t: float) -> Any:
        nonlocal calls
        calls += 1
        return inner(t)  # type: ignore[operator]

    counts, axes = [], np.random.default_rng(2).normal(size=(40, 3))
    flows = [qs.flow("linear", gradient=gradient) for _ in range(2)]
    for flow, orientation in ((flows[0], axes[0]), (flows[1], axes), (flows[1], axes)):
        calls = 0
        qs.Body(0.3).integrate(flow, [5.0], orientation=orientation, tolerance=1e-6)
        counts.append(calls)
    assert abs(counts[0] - counts[1]) < 5
    assert counts[0] < 700
    assert counts[2] < 60  # what was sampled serves again


def test_a_run_goes_on_to_the_same_end() -> None:
    scene = qs.Simulation(
        qs.Body(0.3), qs.flow("linear", gradient=cosines(6)), orientation=AXIS, tolerance=1e-8
    ).assemble()
    times = np.linspace(0.0, 20.0, 41)
    asked = 0

    def interrupted() -> bool:
        nonlocal asked
        asked += 1
        return asked > 20

    whole = scene.trajectory(times, chunk_samples=5)
    first = scene.trajectory(times, chunk_samples=5, interrupted=interrupted)
    again = qs.Simulation(
        qs.Body(0.3), qs.flow("linear", gradient=cosines(6)), orientation=AXIS, tolerance=1e-8
    ).assemble()
    last = again.trajectory(times, first.checkpoint, chunk_samples=5)
    assert not first.finished
    assert np.array_equal(np.concatenate([first.states, last.states]), whole.states)


@pytest.mark.parametrize("stokes", [0.0, 1.0])
def test_a_run_may_be_its_start(stokes: float) -> None:
    body, flow = qs.Body(0.5, stokes_number=stokes), qs.flow("shear", rate="cos(t)")
    motion = body.integrate(flow, [0.0], orientation=AXIS)
    assert np.allclose(motion.axis, AXIS)


def test_a_run_ends_where_its_series_does() -> None:
    times = np.linspace(0.0, 4.0, 81)
    series = qs.GradientSeries(times, [cosines(3)(t) for t in times])  # type: ignore[operator]
    flow = qs.flow("linear", gradient=series)
    with pytest.raises(ConvergenceError, match=r"stopped at t = 4, .*outside the series"):
        qs.Body(0.5).integrate(flow, [5.0], tolerance=1e-6)
    scene = qs.Simulation(qs.Body(0.5), flow, tolerance=1e-6).assemble()
    assert integrate(scene.equations, scene.initial, [4.0], 1e-6).finished


def test_a_heavy_body_waits_for_a_pulse() -> None:
    rate = np.array([[0.1, 0.3, 0.0], [-0.2, 0.1, 0.4], [0.1, 0.0, -0.2]])

    def gradient(t: float) -> Any:  # 1e-100 at first
        return 20.0 * np.exp(-(((t - 2.75) / 0.1786) ** 2)) * rate

    flow = qs.flow("linear", gradient=gradient, longest_step=0.1786)
    body = qs.Body(26.65, stokes_number=0.0151)
    axes = [
        body.integrate(flow, [10.0], orientation=AXIS, tolerance=tolerance).axis[-1]
        for tolerance in (2.7e-10, 1e-7)
    ]
    assert np.abs(axes[0] - axes[1]).max() < 1e-6
    assert np.abs(axes[0] - AXIS).max() > 0.1


@pytest.mark.parametrize(
    ("rate", "strain"),
    [
        (lambda t: 1.0 if t < 2.0 else -3.0, -16.0),
        (lambda t: 1.0 + 0.5 * math.sin(3e3 * t), 8.0 + (1.0 - math.cos(2.4e4)) / 6e3),
    ],
    ids=["jump", "oscillation"],
)
def test_jumps_and_what_is_faster_than_the_body_are_seen(rate: Any, strain: float) -> None:
    body, start = qs.Body(0.3), [0.6, 0.3, 0.8]
    steady = qs.flow("shear", rate=math.copysign(1.0, strain))
    right = body.integrate(steady, [abs(strain)], orientation=start, tolerance=1e-11).axis[-1]
    for tolerance in (1e-4, 1e-6):
        flow = qs.flow("shear", rate=rate)
        found = body.integrate(flow, [8.0], orientation=start, tolerance=tolerance)
        assert np.abs(found.axis[-1] - right).max() < 2.0 * tolerance


@pytest.mark.parametrize("late", [False, True])
def test_functions_that_are_asked_at_every_stage_are_seen(late: bool) -> None:
    """Strengths of singular flows, among one body or several: jumps, and what is fast."""

    def rate(t: float) -> float:
        return 1.0 if t < 1.0 or (late and t == 1.0) else -2.0

    def stokeslet(strength: Any, **given: Any) -> Any:
        return qs.flow("stokeslet", position=[0, 2, 0], strength=strength, **given)

    one, bodies = qs.Body(0.5), [qs.Body(0.5), qs.Body(1.0)]
    place = {"position": [[0, 0, 0], [3, 0.5, 0]], "orientation": [[1, 0, 0.2], [0, 0, 1]]}

    def alone(flow: Any, end: float, tolerance: float, **start: Any) -> Any:
        return one.integrate(flow, [end], **start, tolerance=tolerance)

    def pair(flow: Any, end: float, tolerance: float, **start: Any) -> Any:
        scene = qs.Simulation(bodies, flow, **start, tolerance=tolerance, resolution=1e-3)
        return scene.integrate([end])

    for run, kind, tolerance, start in (
        (alone, lambda f: stokeslet([f, 0, 0]), 1e-6, {"orientation": [1, 0, 0.2]}),
        (pair, lambda f: qs.flow("shear", rate=f), 1e-3, place),
    ):
        ahead, back = kind(1.0), kind(-2.0)
        if run is alone:
            given = stokeslet(lambda t: [rate(t), 0.0, 0.0])
        else:
            given = qs.flow("shear", rate=rate)
        first = run(ahead, 1.0, 1e-2 * tolerance, **start)
        then = {"position": first.position[-1], "orientation": first.orientation[-1]}
        right = run(back, 1.0, 1e-2 * tolerance, **then)
        found = run(given, 2.0, tolerance, **start)
        for name in ("position", "axis"):
            assert np.abs(getattr(found, name) - getattr(right, name)).max() < 0.5 * tolerance

    def fast(t: float) -> list[float]:
        return [10.0 + 5.0 * math.sin(300.0 * t), 0.0, 0.0]

    if not late:
        start = {"orientation": [1, 0, 0.2]}
        noise = stokeslet(lambda t: [math.sin(1e12 * t), 0.0, 0.0])
        with pytest.raises(SceneError, match="no smooth function of time"):
            alone(noise, 2.0, 1e-4, **start)
        right = alone(stokeslet(fast, longest_step=2e-3), 1.0, 1e-6, **start)
        found = alone(stokeslet(fast), 1.0, 1e-3, **start)
        assert np.abs(found.position - right.position).max() < 1e-3


def test_several_bodies_keep_their_motion_up_to_where_a_function_ends() -> None:
    def rate(t: float) -> float:
        if t > 1.5:
            raise ValueError("nothing after 1.5")
        return 1.0

    still = [[0.0, 0.0, 0.0], [3.0, 0.5, 0.0]]
    for flow, last in (
        (qs.flow("shear", rate=rate), 1.5),
        (
            qs.flow(
                "linear",
                gradient=qs.GradientSeries(np.linspace(0.0, 1.0, 11), np.zeros((11, 3, 3))),
            ),
            1.0,
        ),
    ):
        scene = qs.Simulation([qs.Body(0.5), qs.Body(1.0)], flow, position=still, tolerance=1e-3)
        motion = scene.integrate([0.0, 0.5, 2.0])
        assert motion.time[-1] == pytest.approx(last, abs=1e-3)
        assert len(motion.time) == 3


def test_stresslets_change_and_walls_do_not() -> None:
    """Symmetric and traceless at every instant; entries, functions and samples are one flow."""
    strength = np.array([[1.0, 0.3, 0.0], [0.3, -0.5, 0.2], [0.0, 0.2, -0.5]])
    steady = qs.flow("stresslet", position=[4, 0, 0], strength=strength)
    entries = [[f"{value}*cos(t)" for value in row] for row in strength]
    samples = qs.Series(TIMES, [(np.cos(t) * strength).ravel() for t in TIMES])
    at = np.array([0.0, 1.0, 0.0])
    for given in (entries, lambda t: np.cos(t) * strength, samples):
        found = qs.flow("stresslet", position=[4, 0, 0], strength=given).velocity(at, 2.0)
        np.testing.assert_allclose(found, np.cos(2.0) * steady.velocity(at), rtol=1e-6)
    wrong = qs.flow("stresslet", position=[4, 0, 0], strength=lambda t: t * np.eye(3))
    with pytest.raises(QbxStokesError, match="symmetric"):
        wrong.velocity(at, 1.0)
    for kind, key, value in (
        ("plane_poiseuille", "half_width", "2 + t"),
        ("tube_poiseuille", "radius", np.cos),
    ):
        with pytest.raises(
            QbxStokesError, match=f"{key} of {kind} cannot change in time, as speed"
        ):
            qs.flow(kind, **{key: value})


@pytest.mark.parametrize("stokes", [0.0, 1.0])
def test_quantities_at_many_instants_are_those_at_each(stokes: float) -> None:
    """Of lanes in a series, a function and a steady flow, to the last bit."""
    series = qs.GradientSeries(TIMES, [cosines(1)(t) for t in TIMES])
    flows = [qs.flow("linear", gradient=given) for given in (series, cosines(2))]
    body, times = qs.Body(0.2, stokes_number=stokes), np.linspace(0.0, 6.0, 31)
    scenes = [qs.Simulation(body, flow, orientation=AXIS) for flow in (*flows, qs.flow("shear"))]
    for together in (assemble(scenes), assemble(scenes[:1])):
        states = together.trajectory(times).states
        wanted = ["velocity", "angular_velocity", "torque"]
        found = together.observe(times, states, wanted)
        for i in range(len(times)):
            one = together.observe(times[i : i + 1], states[i : i + 1], wanted)
            assert all(np.array_equal(one[name][0], found[name][i]) for name in wanted)


def test_steps_of_several_bodies_end_at_samples() -> None:
    """Two bodies far from each other, in a gradient that is held, as one of them alone."""
    times = np.linspace(0.0, 1.0, 4)
    series = qs.GradientSeries(times, [cosines(3)(7.0 * t) for t in times], interpolation="hold")
    flow, body = qs.flow("linear", gradient=series), qs.Body(0.5)
    alone = body.integrate(flow, [1.0], orientation=AXIS, tolerance=1e-9)
    places = {"position": [[0, 0, 0], [0, 300, 0]], "orientation": [AXIS, [0, 0, 1]]}
    two = qs.Simulation([body, body], flow, **places, tolerance=1e-5).assemble().integrate([1.0])
    assert np.abs(two.axis[-1, 0] - alone.axis[-1]).max() < 1e-7
    assert two.summary["steps"] < 30


def test_steps_of_slender_bodies_are_as_long_as_their_own_motion_lets_them() -> None:
    """A gradient that turns: errors of axes hardly grow, and a shear in all but name: by k^2."""
    body = qs.Body(0.02)
    for gradient, most, share in (
        (cosines(3), 1e2, 1e-5),
        (lambda t: (1 + 1e-9 * t) * SHEAR, 3e3, 0),
    ):
        scene = qs.Simulation(
            body, qs.flow("linear", gradient=gradient), orientation=AXIS
        ).assemble()
        assert 1.0 < scene.equations.sensitivity(0.0, scene.initial, 20.0) < most
        motion = body.integrate(scene.parts[0].flow, [20.0], orientation=AXIS, tolerance=1e-9)
        exact = body.axes(scene.parts[0].flow, [20.0], AXIS, tolerance=1e-13)
        assert share * 1e-9 < np.abs(motion.axis[-1] - exact[-1]).max() < 1e-9


def test_stiff_bodies_in_a_function_known_to_rounding() -> None:
    """Its pieces differ by rounding where they meet, which is no jump: BDF began anew at each."""
    flow, body = qs.flow("linear", gradient=cosines(3)), qs.Body(0.08, stokes_number=1e-3)
    keys = {"orientation": AXIS, "tolerance": 1e-12}
    exact, found = (
        body.integrate(flow, [2.0], **keys),
        body.integrate(flow, [2.0], **keys | {"tolerance": 1e-7}),
    )
    assert np.abs(found.axis - exact.axis).max() < 1e-7
    assert exact.summary["steps"] < 2000


def test_a_function_that_changes_between_motions_is_looked_at_anew() -> None:
    """And a motion has the same bits whatever has been followed in its flow before."""
    size = [0.01]

    def gradient(t: float) -> Any:
        return [[0, size[0] * np.cos(t), 0], [0, 0, 0], [0, 0, 0]]

    body, start = qs.Body(0.05), [0.48, 0.6, 0.64]

    def followed(flow: Any) -> Any:
        return body.integrate(flow, [5.0], orientation=start, tolerance=1e-6)

    flow = qs.flow("linear", gradient=gradient)
    followed(flow)
    size[0] = 10.0
    changed, fresh = followed(flow), followed(qs.flow("linear", gradient=gradient))
    body.axes(flow, [5.0], start, tolerance=1e-10)
    again = followed(flow)
    for found in (changed, again):
        assert found.summary == fresh.summary
        assert np.array_equal(found.orientation, fresh.orientation)
