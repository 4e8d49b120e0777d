"""Integration: tolerance is error, samples as good as steps, stiff and long motions, resuming."""

from __future__ import annotations

import math
import subprocess
import sys
from collections.abc import Iterator
from typing import Any, Literal

import numpy as np
import pytest
from petsc4py import PETSc
from scenes import phase_period

from qbxstokes.bie.functional import BodyModel, FaxenCoefficients, Resistance
from qbxstokes.errors import ConvergenceError
from qbxstokes.flows.polynomial import PolynomialFlow
from qbxstokes.geometry import rotation
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.motion import diagnostics
from qbxstokes.motion.equations import Loads, RigidBodyEquations
from qbxstokes.motion.forecast import Forecast
from qbxstokes.motion.layout import Step
from qbxstokes.petsc import stepper
from qbxstokes.petsc.native import NativeRate
from qbxstokes.petsc.stepper import integrate
from qbxstokes.petsc.trajectory import Checkpoint, Chunk
from qbxstokes.reference import faxen, inertial, jeffery
from qbxstokes.simulation.hydrodynamics import exact_model

Array = np.ndarray
SHEAR = PolynomialFlow(None, [[0.0, 1.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
AXIS = np.array([0.3, 0.4, 0.5]) / math.sqrt(0.5)
MATRIX = [[0.0, 1.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]


def paraboloid(curvature: float) -> PolynomialFlow:
    hessian = np.zeros((3, 3, 3))
    hessian[0, 1, 1] = hessian[0, 2, 2] = 2.0 * curvature
    return PolynomialFlow(hessian=hessian)


def start_of(equations: RigidBodyEquations, axis: Array = AXIS) -> Array:
    return equations.initial_state((0.0, 0.3, 0.0), rotation.from_axis(axis))


@pytest.fixture
def options() -> Iterator[PETSc.Options]:
    """PETSc's options, with what a test sets taken back."""
    database = PETSc.Options()
    before = set(database.getAll())
    yield database
    for name in set(database.getAll()) - before:
        database.delValue(name)


@pytest.mark.parametrize("method", ["5dp", "8vr"])
@pytest.mark.parametrize("k", [0.1, 0.5, 10.0])
def test_tolerance_is_the_error_of_ten_periods(k: float, method: str) -> None:
    equations = RigidBodyEquations(exact_model(Spheroid(k)), SHEAR)
    end = 10.0 * jeffery.period(k)
    for tolerance in (1e-4, 1e-7) if method == "5dp" else (1e-5, 1e-8, 1e-11):
        found = integrate(equations, start_of(equations), [end], tolerance, method=method)
        error = rotation.axis(found.states[0, 0, 3:7]) - jeffery.axis_at(end, k, AXIS)
        assert np.abs(error).max() < 2.0 * tolerance


@pytest.mark.parametrize("method", ["bdf", "arkimex", "rosw"])
def test_tolerance_is_the_error_of_implicit_methods(method: str) -> None:
    k = 0.5
    equations = RigidBodyEquations(exact_model(Spheroid(k)), SHEAR)
    end = 2.0 * jeffery.period(k)
    for tolerance in (1e-4, 1e-6):
        found = integrate(equations, start_of(equations), [end], tolerance, method=method)
        assert found.checkpoint.method == method
        error = rotation.axis(found.states[0, 0, 3:7]) - jeffery.axis_at(end, k, AXIS)
        assert np.abs(error).max() < 6.0 * tolerance


@pytest.mark.parametrize("method", ["bdf", "arkimex", "rosw"])
@pytest.mark.parametrize("stokes", [0.0, 1e-3])
def test_implicit_steps_in_c_are_those_in_python(method: str, stokes: float) -> None:
    plain, compiled = (
        integrate(equations, start_of(equations), [1.0, 5.0], 1e-6, method=method)
        for equations in (
            RigidBodyEquations(exact_model(Spheroid(0.2)), paraboloid(0.1), stokes, evaluation=how)
            for how in ("plain", "compiled")
        )
    )
    assert compiled.states == pytest.approx(plain.states, abs=1e-9)
    for name in ("steps", "rejections", "jacobians"):
        assert getattr(compiled.checkpoint, name) == getattr(plain.checkpoint, name)
    assert abs(compiled.checkpoint.evaluations - plain.checkpoint.evaluations) <= 20


@pytest.mark.parametrize("method", ["bdf", "arkimex"])
def test_implicit_steps_in_c_tell_a_blow_up(method: str) -> None:
    """x1' = x1^2 + 1/3 from 1: its end is at sqrt(3) pi/6."""
    hessian = np.zeros((3, 3, 3))
    hessian[0, 0, 0], hessian[1, 0, 1], hessian[1, 1, 0] = 2.0, -2.0, -2.0
    flow = PolynomialFlow(hessian=hessian)
    equations = RigidBodyEquations(exact_model(Spheroid(1.0)), flow, evaluation="compiled")
    start = equations.initial_state((1.0, 0.0, 0.0), rotation.from_axis(AXIS))
    with pytest.raises(ConvergenceError, match=r"t = 0\.906[89].* without bound"):
        integrate(equations, start, [2.0], 1e-6, method=method)


@pytest.mark.parametrize(("k", "method"), [(0.1, "8vr"), (0.5, "bdf")])
def test_error_of_rounding_is_foretold(k: float, method: str) -> None:
    equations = RigidBodyEquations(exact_model(Spheroid(k)), SHEAR)
    end = (10.0 if method == "8vr" else 3.0) * jeffery.period(k)
    times = end * np.array([0.93, 0.95, 0.97, 1.0])
    found = integrate(equations, start_of(equations), times, 1e-15, method=method)
    error = rotation.axis(found.states[:, 0, 3:7]) - jeffery.axis_at(times, k, AXIS)
    assert 0.03 < np.abs(error).max() / found.checkpoint.reachable < 10.0


def test_light_bodies_take_explicit_steps_where_implicit_ones_round_too_much() -> None:
    equations = RigidBodyEquations(exact_model(Spheroid(0.5)), SHEAR, 1e-2)
    coarse, fine = (
        integrate(equations, start_of(equations), [20.0], tolerance, t0=10.0).checkpoint.method
        for tolerance in (1e-6, 1e-13)
    )
    assert (coarse, fine) == ("bdf", "8vr")


def test_orbit_and_period_over_ten_periods() -> None:
    k = 0.5
    period = jeffery.period(k)
    equations = RigidBodyEquations(exact_model(Spheroid(k)), SHEAR)
    times = np.linspace(0.0, 10.0 * period, 201)
    found = integrate(equations, start_of(equations), times, 1e-10)
    axes = rotation.axis(found.states[:, 0, 3:7])
    constant = diagnostics.orbit_constant(axes, k)
    assert np.abs(constant / constant[0] - 1.0).max() < 1e-9
    measured, residual = phase_period(times, axes, k)
    assert abs(measured / period - 1.0) < 1e-10
    assert residual < 1e-9
    assert np.abs(axes - jeffery.axis_at(times, k, AXIS)).max() < 1e-10


@pytest.mark.parametrize("method", ["5dp", "8vr", "bdf"])
def test_samples_are_as_good_as_steps(method: str) -> None:
    k, tolerance = 0.5, 1e-7
    equations = RigidBodyEquations(exact_model(Spheroid(k)), SHEAR)
    times = np.sort(np.random.default_rng(0).uniform(0.0, jeffery.period(k), 100))
    found = integrate(equations, start_of(equations), times, tolerance, method=method)
    error = np.abs(rotation.axis(found.states[:, 0, 3:7]) - jeffery.axis_at(times, k, AXIS))
    assert error.max() < 3.0 * tolerance


@pytest.mark.parametrize(("k", "tolerance"), [(0.5, 1e-6), (0.5, 1e-12), (0.1, 1e-10), (20, 1e-9)])
def test_many_states_of_a_step_are_as_good_as_few(k: float, tolerance: float) -> None:
    equations = RigidBodyEquations(exact_model(Spheroid(k)), SHEAR)
    end = 0.7 * jeffery.period(k)
    few = integrate(equations, start_of(equations), [end], tolerance, method="8vr")
    times = np.linspace(0.0, end, 40 * few.checkpoint.steps)
    many = integrate(equations, start_of(equations), times, tolerance, method="8vr")
    assert many.checkpoint.evaluations < few.checkpoint.evaluations + 33 * many.checkpoint.steps
    error = np.abs(rotation.axis(many.states[:, 0, 3:7]) - jeffery.axis_at(times, k, AXIS))
    assert error.max() < 3.0 * tolerance


def test_samples_do_not_change_the_motion() -> None:
    equations = RigidBodyEquations(exact_model(Spheroid(0.5)), SHEAR)
    few = integrate(equations, start_of(equations), [20.0])
    many = integrate(equations, start_of(equations), np.linspace(0.0, 20.0, 400))
    assert np.array_equal(few.states[-1], many.states[-1])


def test_inertial_body_in_shear() -> None:
    k, stokes_number = 0.5, 10.0
    equations = RigidBodyEquations(exact_model(Spheroid(k)), SHEAR, stokes_number)
    start = start_of(equations)
    times = np.linspace(0.0, 2.0 * jeffery.period(k), 9)
    found = integrate(equations, start, times, 1e-10)
    expected = inertial.linear_flow(k, stokes_number, MATRIX, start[0, 3:7], times)
    assert np.abs(found.states[:, 0, 3:7] - expected.orientation).max() < 1e-9
    assert np.abs(found.states[:, 0, 10:13] - expected.angular_velocity).max() < 1e-9


@pytest.mark.parametrize(
    ("stokes_number", "loads", "inertia"),
    [
        (0.0, None, "both"),
        (0.0, Loads(torque=(0.1, 0.0, 0.2)), "both"),
        ([1.0, 2.0, 5.0], None, "both"),
        ([1.0, 2.0, 5.0], Loads(body_force=(0.0, 0.3, 0.2)), "rotation"),
    ],
    ids=["massless", "massless, loaded", "inertial", "inertial, loaded, following"],
)
def test_the_rate_that_petsc_calls_itself_has_the_same_bits(
    stokes_number: float | list[float], loads: Loads | None, inertia: Literal["both", "rotation"]
) -> None:
    n = 3
    flow = paraboloid(0.1)
    equations = RigidBodyEquations(
        exact_model(Spheroid(0.5)), flow, stokes_number, n, loads, None, "compiled", inertia
    )
    block = equations.block_constants()
    assert block is not None
    native = NativeRate.made(block, equations.layout)
    assert native is not None
    rng = np.random.default_rng(2)
    states = rng.standard_normal((equations.n_state, n))
    through_python = np.empty_like(states)
    equations.rate_function()(0.0, states, through_python)
    ts = PETSc.TS().create(PETSc.COMM_SELF)
    state = PETSc.Vec().createWithArray(states.ravel(), comm=PETSc.COMM_SELF)
    rate = state.duplicate()
    native.give(ts, state.duplicate())
    ts.setSolution(state)
    for _ in range(2):
        rate.set(0.0)
        ts.computeRHSFunction(0.0, state, rate)
        assert rate.getArray().tobytes() == through_python.tobytes()
    assert native.calls == 2
    ts.destroy()


@pytest.mark.parametrize("stokes_number", [0.0, 1e-3, 10.0])
def test_inertial_body_in_a_paraboloid(stokes_number: float) -> None:
    k, curvature, phi = 0.5, 0.25, 0.3
    equations = RigidBodyEquations(exact_model(Spheroid(k)), paraboloid(curvature), stokes_number)
    q = rotation.from_euler(phi, np.pi / 2, 0.0)
    times = np.linspace(0.0, 10.0, 5)
    if stokes_number == 1e-3:  # too stiff for the reference's explicit method at length
        times = 0.01 * times
    found = integrate(equations, equations.initial_state((0.0, 2.0, 0.0), q), times, 1e-9)
    expected = inertial.paraboloid(k, stokes_number, curvature, (0.0, 2.0), phi, times)
    assert np.abs(found.states[:, 0, :2] - expected.position).max() < 1e-8
    angles = rotation.to_euler(found.states[:, 0, 3:7])
    turn = np.exp(1j * angles[:, 0]) - np.exp(1j * expected.phi)
    assert np.abs(turn).max() < 1e-8


def test_small_inertia_is_first_order() -> None:
    k, end = 0.5, 6.0
    massless = RigidBodyEquations(exact_model(Spheroid(k)), paraboloid(0.25))
    q = rotation.from_axis(AXIS)
    times = [end]
    limit = integrate(massless, massless.initial_state((0.0, 2.0, 0.0), q), times, 1e-9)
    differences = []
    for stokes_number in (1e-3, 1e-4, 1e-6):
        equations = RigidBodyEquations(exact_model(Spheroid(k)), paraboloid(0.25), stokes_number)
        start = equations.initial_state((0.0, 2.0, 0.0), q)
        found = integrate(equations, start, times, 1e-9)
        assert found.checkpoint.method == "bdf"
        assert found.checkpoint.steps < 3000
        differences.append(np.abs(found.states[0, 0, :7] - limit.states[0, 0]).max())
    orders = np.log10(np.array(differences[:-1]) / differences[1:]) / [1.0, 2.0]
    assert np.allclose(orders, 1.0, atol=0.05)


@pytest.mark.parametrize("stokes_number", [1e-6, 1e-3, 1.0, 1e6])
def test_release_from_rest(stokes_number: float) -> None:
    """A sphere in uniform flow: V = 1 - exp(-9 t/(2 St)), all through its relaxation."""
    rate = 4.5 / stokes_number
    equations = RigidBodyEquations(
        exact_model(Spheroid(1.0)), PolynomialFlow([1, 0, 0]), stokes_number
    )
    start = equations.initial_state((0, 0, 0), (1, 0, 0, 0), (0, 0, 0), (0, 0, 0))
    times = np.concatenate([np.linspace(0.0, 5.0, 11) / rate, [max(10.0, 20.0 / rate)]])
    found = integrate(equations, start, times, 1e-9)
    decay = np.exp(-rate * times)
    velocity, position = 1.0 - decay, times - (1.0 - decay) / rate
    assert np.abs(found.states[:, 0, 7] - velocity).max() < 1e-8
    size = np.maximum(1.0, position)
    assert np.abs((found.states[:, 0, 0] - position) / size).max() < 1e-8


def test_a_first_step_that_cannot_be_solved_is_shortened() -> None:
    """A light body along the stream hardly moves at first: the first step is far too long."""
    equations = RigidBodyEquations(exact_model(Spheroid(0.2)), SHEAR, 1.0)
    along = rotation.from_axis(np.array([1.0, 0.0, 0.0]))
    start = equations.initial_state((0.0, 0.0, 0.0), along)
    found = integrate(equations, start, [10.0], 1e-7, method="bdf")
    expected = inertial.linear_flow(0.2, 1.0, MATRIX, start[0, 3:7], np.array([0.0, 10.0]))
    assert np.abs(found.states[0, 0, 3:7] - expected.orientation[-1]).max() < 1e-6


def test_free_top_keeps_energy_and_angular_momentum() -> None:
    k = 0.3
    linear, quadratic, cubic = faxen.body_coefficients(k)
    vacuum = BodyModel(
        Spheroid(k),
        Resistance(1e-300, 1e-300, 1e-300, 1e-300),
        FaxenCoefficients(linear, quadratic, cubic),
        None,
        0.0,
    )
    equations = RigidBodyEquations(vacuum, PolynomialFlow(), 1.0)
    q = rotation.from_axis(AXIS)
    start = equations.initial_state((0, 0, 0), q, (0.1, 0.2, 0.3), (1.0, -2.0, 3.0))
    found = integrate(equations, start, np.linspace(0.0, 50.0, 20), 1e-10)
    y, moments = found.states[:, 0], Spheroid(k).inertia
    momentum = rotation.to_space(y[:, 3:7], moments * y[:, 10:13])
    energy = 0.5 * np.sum(moments * y[:, 10:13] ** 2, axis=1)
    assert np.abs(momentum - momentum[0]).max() < 1e-9 * np.abs(momentum).max()
    assert np.abs(energy / energy[0] - 1.0).max() < 1e-9
    assert np.allclose(y[:, :3], np.outer(found.times, [0.1, 0.2, 0.3]), atol=1e-9)


@pytest.mark.parametrize("k", [0.01, 1.0, 100.0])
@pytest.mark.parametrize("axis", [(0, 0, 1), (0, 0, -1), (1, 0, 0), (0, 1, 0)])
def test_no_orientation_is_singular(k: float, axis: tuple[int, int, int]) -> None:
    equations = RigidBodyEquations(exact_model(Spheroid(k)), SHEAR)
    times = np.linspace(0.0, 30.0, 4)
    found = integrate(equations, start_of(equations, np.array(axis, dtype=float)), times, 1e-9)
    expected = jeffery.axis_at(times, k, np.array(axis, dtype=float))
    assert np.abs(rotation.axis(found.states[:, 0, 3:7]) - expected).max() < 1e-8


@pytest.mark.parametrize("stokes_number", [0.0, 1.0, 1e-4])
def test_block_is_its_bodies(stokes_number: float) -> None:
    model, axes = exact_model(Spheroid(0.5)), rotation.random_axes(3, np.random.default_rng(3))
    block = RigidBodyEquations(model, paraboloid(0.25), stokes_number, 3)
    single = RigidBodyEquations(model, paraboloid(0.25), stokes_number)
    times = [1.0, 4.0 if stokes_number != 1e-4 else 1.5]
    place = (0.0, 1.0, 0.5)
    together = integrate(block, block.initial_state(place, rotation.from_axis(axes)), times, 1e-8)
    for i in range(3):
        start = single.initial_state(place, rotation.from_axis(axes[i]))
        alone = integrate(single, start, times, 1e-8)
        assert np.abs(together.states[:, i] - alone.states[:, 0]).max() < 4e-8


@pytest.mark.parametrize("stokes_number", [0.0, 10.0, 1e-3])
def test_resuming_gives_the_same_numbers(
    stokes_number: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stepper, "BDF_STEPS", 200)
    equations = RigidBodyEquations(exact_model(Spheroid(0.4)), SHEAR, stokes_number)
    start, times = start_of(equations), np.linspace(0.0, 12.0 if stokes_number != 1e-3 else 0.5, 61)
    chunks: list[Chunk] = []
    cuts: dict[str, Any] = {"chunk_samples": 15, "chunk_steps": 2 if stokes_number == 1e-3 else 17}
    whole = integrate(equations, start, times, 1e-8, on_chunk=chunks.append, **cuts)
    assert len(whole.times) == 0
    assert sum(len(chunk.times) for chunk in chunks) == len(times)
    assert np.array_equal(np.concatenate([chunk.times for chunk in chunks]), times)
    assert len(chunks) >= 3
    for i in {len(chunks) // 2, len(chunks) - 2}:
        again: list[Chunk] = []
        resumed = integrate(
            equations,
            chunks[i].checkpoint,
            times,
            1e-8,
            on_chunk=again.append,
            **cuts,
        )
        assert len(again) == len(chunks) - i - 1
        for one, two in zip(again, chunks[i + 1 :], strict=True):
            assert one.first == two.first
            assert np.array_equal(one.states, two.states)
            assert one.checkpoint.step == two.checkpoint.step
            assert one.checkpoint.steps == two.checkpoint.steps
        assert np.array_equal(resumed.checkpoint.state, whole.checkpoint.state)


def test_interruption_stops_at_the_last_cut() -> None:
    equations = RigidBodyEquations(exact_model(Spheroid(0.4)), SHEAR)
    start, times = start_of(equations), np.linspace(0.0, 40.0, 101)
    whole = integrate(equations, start, times, 1e-8, chunk_samples=10)
    asked = iter([False] * 60 + [True])
    part = integrate(
        equations, start, times, 1e-8, chunk_samples=10, interrupted=lambda: next(asked)
    )
    assert not part.finished
    assert 0 < len(part.times) < len(times)
    rest = integrate(equations, part.checkpoint, times, 1e-8, chunk_samples=10)
    assert np.array_equal(np.concatenate([part.states, rest.states]), whole.states)


def test_long_run_keeps_orbit_and_norm() -> None:
    k, periods = 0.5, 50
    equations = RigidBodyEquations(exact_model(Spheroid(k)), SHEAR)
    constants, longest = [], 0

    def store(chunk: Chunk) -> None:
        nonlocal longest
        longest = max(longest, len(chunk.times))
        constants.append(diagnostics.orbit_constant(rotation.axis(chunk.states[:, 0, 3:7]), k))

    times = np.linspace(0.0, periods * jeffery.period(k), 20 * periods + 1)
    found = integrate(
        equations, start_of(equations), times, 1e-9, on_chunk=store, chunk_samples=100
    )
    constant = np.concatenate(constants)
    assert longest < 110
    assert np.abs(constant / constant[0] - 1.0).max() < 2e-9
    assert found.checkpoint.norm_drift < 1e-10
    assert abs(np.linalg.norm(found.checkpoint.state[0, 3:7]) - 1.0) < 1e-15


def test_time_dependent_torque() -> None:
    """A disc turned about its axis by a torque cos t: the angle is sin t/R."""
    k = 3.0
    loads = Loads(body_torque=lambda t: (0.0, 0.0, 50.0 * math.cos(t)))
    equations = RigidBodyEquations(exact_model(Spheroid(k)), PolynomialFlow(), 0.0, loads=loads)
    times = np.linspace(0.0, 9.0, 10)
    start = equations.initial_state((0, 0, 0), (1.0, 0.0, 0.0, 0.0))
    found = integrate(equations, start, times, 1e-9, longest_step=0.5)
    angle = 50.0 * np.sin(times) / jeffery.rotation_resistance(k)[1]
    assert np.allclose(found.states[:, 0, 3], np.cos(0.5 * angle), atol=1e-9)
    assert np.allclose(found.states[:, 0, 6], np.sin(0.5 * angle), atol=1e-9)


def test_options_choose_the_method(options: PETSc.Options) -> None:
    equations = RigidBodyEquations(exact_model(Spheroid(0.5)), SHEAR)
    options["stepper_test_ts_type"] = "rk"
    options["stepper_test_ts_rk_type"] = "3bs"
    found = integrate(equations, start_of(equations), [1.0], 1e-4, prefix="stepper_test_")
    assert found.checkpoint.method == "3bs"
    before = set(PETSc.Options().getAll())
    integrate(equations, start_of(equations), [1.0], 1e-4)
    assert set(PETSc.Options().getAll()) == before


def test_too_many_steps(options: PETSc.Options) -> None:
    equations = RigidBodyEquations(exact_model(Spheroid(0.5)), SHEAR)
    options["stepper_test_ts_max_steps"] = "5"
    with pytest.raises(ConvergenceError, match=r"t = .*step 5 .*ts_max_steps.*Try"):
        integrate(equations, start_of(equations), [100.0], 1e-8, prefix="stepper_test_")


class Wall:
    """A free motion that is not a number beyond x1 = 1."""

    def free_motion(self, t: float, x: Array, q: Array) -> tuple[Array, Array]:
        return np.where(x[:, :1] < 1.0, [1.0, 0.0, 0.0], np.nan), np.zeros_like(x)


class Broken:
    """A free motion that cannot be computed."""

    def free_motion(self, t: float, x: Array, q: Array) -> tuple[Array, Array]:
        if t > 0.5:
            raise ConvergenceError("no solution at t > 0.5")
        return np.broadcast_to([1.0, 0.0, 0.0], x.shape), np.zeros_like(x)


def test_failures_are_told() -> None:
    model = exact_model(Spheroid(0.5))
    broken = RigidBodyEquations(model, Broken())
    with pytest.raises(ConvergenceError, match="no solution at t"):
        integrate(broken, start_of(broken), [2.0])
    wall = RigidBodyEquations(model, Wall())
    for method in ("5dp", "8vr", "bdf"):
        with pytest.raises(ConvergenceError, match=rf"time integration .{method}. stopped at t ="):
            integrate(wall, start_of(wall), [2.0], method=method)


def test_observer_finds_crossings() -> None:
    k = 0.5
    equations = RigidBodyEquations(exact_model(Spheroid(k)), SHEAR)
    moments: list[float] = []

    def watch(step: Step) -> float | None:
        def height(t: float) -> float:
            return float(rotation.axis(rotation.normalize(step.state(t)[0, 3:7]))[0])

        low, high = step.before, step.after
        if height(low) * height(high) < 0.0:
            for _ in range(60):
                middle = 0.5 * (low + high)
                low, high = (middle, high) if height(low) * height(middle) > 0.0 else (low, middle)
            moments.append(0.5 * (low + high))
        return moments[-1] if len(moments) == 5 else None

    found = integrate(equations, start_of(equations), [100.0], 1e-10, observe=watch)
    assert found.stopped
    assert found.times[-1] == moments[-1]
    periods = np.array(moments[2:]) - moments[:-2]
    assert np.allclose(periods, jeffery.period(k), rtol=1e-10)


def test_checkpoint_alone_starts_a_run() -> None:
    equations = RigidBodyEquations(exact_model(Spheroid(0.5)), SHEAR)
    start = start_of(equations)
    one = integrate(equations, Checkpoint(0.0, start), [5.0])
    assert np.array_equal(one.states, integrate(equations, start, [5.0]).states)


def test_compiled_blocks_leave_the_hdf5_of_h5py_alone():
    """PETSc's own HDF5 must not reach an h5py that is imported after the first integration."""
    program = (
        "import numpy as np\n"
        "from qbxstokes.petsc import session\n"
        "session.start([], {})\n"
        "from qbxstokes.petsc.native import library\n"
        "assert library() is not None\n"
        "import h5py\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("k", "stokes_number"), [(0.2, 0.0), (0.5, 0.1), (2.0, 0.1), (0.2, 1.0), (0.5, 100.0)]
)
def test_the_forecast_tells_method_and_steps(k: float, stokes_number: float) -> None:
    """What the dry run of a sweep builds its time on: within a factor of 2."""
    equations = RigidBodyEquations(exact_model(Spheroid(k)), paraboloid(0.05), stokes_number)
    start = equations.initial_state((0.0, 10.0, 0.0), (1.0, 0.2, 0.3, 0.4))
    forecast = Forecast(equations, 0.0, start, 40.0, 1e-8)
    run = integrate(equations, start, [40.0], 1e-8)
    assert run.checkpoint.method == forecast.method
    assert (
        0.5
        < forecast.steps("rk" if run.checkpoint.method == "8vr" else "bdf") / run.checkpoint.steps
        < 2.0
    )
