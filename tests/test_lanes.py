"""Lanes with bodies, Stokes numbers and flows of their own; several bodies in a lane."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from conftest import random_flow
from petsc4py import PETSc

import qbxstokes as qs
from qbxstokes.bie.functional import BodyModel, FaxenCoefficients
from qbxstokes.flows.named import Paraboloid, Shear
from qbxstokes.flows.polynomial import PolynomialFlow
from qbxstokes.geometry import rotation
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.motion.equations import Constraints, Loads, RigidBodyEquations
from qbxstokes.motion.layout import Layout
from qbxstokes.petsc.native import NativeRate
from qbxstokes.petsc.stepper import integrate
from qbxstokes.simulation.hydrodynamics import exact_model

Array = np.ndarray
RNG = np.random.default_rng(6)
N = 70  # more than a tile
MODELS = [exact_model(Spheroid(k)) for k in np.geomspace(0.05, 20.0, 7)]
FLOWS = [
    Shear(),
    Paraboloid(0.3),
    random_flow(1, RNG).shifted((0.5, 0.0, -1.0)),
    random_flow(2, RNG),
    random_flow(3, RNG).shifted((1.0, -2.0, 0.5)),
]
LOADS = Loads((1.0, 2.0, 3.0), (0.5, 0.0, 1.0), (1.0, 0.0, -0.5), (0.1, 0.2, 0.3))


def lanes(
    mixed: str, massless: bool, loads: Loads | None, n: int = N, **more: Any
) -> tuple[RigidBodyEquations, list[RigidBodyEquations]]:
    """A block, and its lanes one by one."""
    models = [MODELS[(i if mixed != "flows" else 2) % len(MODELS)] for i in range(n)]
    flows = [FLOWS[(i if mixed != "bodies" else 3) % len(FLOWS)] for i in range(n)]
    stokes = np.zeros(n) if massless else np.linspace(0.3, 3.0, n)
    block = RigidBodyEquations(models, flows, stokes, n, loads, **more)
    single = [
        RigidBodyEquations(*entry, 1, loads, inertia=more.get("inertia", "both"))
        for entry in zip(models, flows, stokes, strict=True)
    ]
    return block, single


def random_state(equations: RigidBodyEquations) -> Array:
    """The same states whichever tests ran before."""
    n, rng = equations.n_lanes, np.random.default_rng(3)
    velocities = () if equations.massless else rng.standard_normal((2, n, 3))
    return equations.initial_state(
        rng.standard_normal((n, 3)), rotation.random_quaternions(n, rng), *velocities
    )


def rates(equations: RigidBodyEquations, y: Array) -> Array:
    columns = np.ascontiguousarray(y.T)
    columns.flags.writeable = False  # as PETSc hands it out
    out = np.empty_like(columns)
    equations.rate_function()(0.0, columns, out)
    return out.T


def jacobian(equations: RigidBodyEquations, y: Array) -> Array:
    columns = np.ascontiguousarray(y.T)
    columns.flags.writeable = False
    out = np.empty((len(y), equations.n_state, equations.n_state))
    equations.jacobian_function()(0.0, columns, out)
    return out


@pytest.mark.parametrize(
    ("evaluation", "loads", "massless"),
    [
        *(("plain", loads, massless) for loads in (None, LOADS) for massless in (True, False)),
        ("compiled", None, True),
        ("compiled", LOADS, False),
    ],
)
@pytest.mark.parametrize("mixed", ["bodies", "flows", "both"])
def test_a_lane_of_a_block_has_the_bits_of_the_lane_alone(
    mixed: str, loads: Loads | None, massless: bool, evaluation: str
) -> None:
    """Flows of lower degree in the kernels of the highest one, too."""
    block, single = lanes(mixed, massless, loads, evaluation=evaluation)
    y = random_state(block)
    alone = np.concatenate([rates(one, row[None]) for one, row in zip(single, y, strict=True)])
    assert np.array_equal(rates(block, y), alone)


@pytest.mark.parametrize(
    ("mixed", "massless", "loads"), [("bodies", False, LOADS), ("flows", True, None)]
)
def test_jacobians_of_lanes(mixed: str, massless: bool, loads: Loads | None) -> None:
    compiled, single = lanes(mixed, massless, loads, evaluation="compiled")
    plain, _ = lanes(mixed, massless, loads, evaluation="plain")
    y = random_state(plain)
    alone = np.concatenate([jacobian(one, row[None]) for one, row in zip(single, y, strict=True)])
    # Complex products round differently, by the size of what cancels: up to that of the rates.
    size = np.abs(alone).max(axis=(1, 2)) + np.abs(rates(plain, y)).max(axis=1)
    for block in (plain, compiled):
        error = np.abs(jacobian(block, y) - alone).max(axis=(1, 2))
        assert np.all(error < 8.0 * np.finfo(float).eps * size)
    step, which = 1e-3, np.eye(plain.n_state)
    for j in range(plain.n_state):
        central = [
            (rates(plain, y + h * which[j]) - rates(plain, y - h * which[j])) / (2.0 * h)
            for h in (step, 2.0 * step)
        ]
        differenced = (4.0 * central[0] - central[1]) / 3.0  # Richardson: error of order h^4
        assert np.allclose(alone[:, :, j], differenced, rtol=0, atol=1e-9 * np.abs(alone).max())


@pytest.mark.parametrize(
    ("mixed", "massless", "loads", "inertia"),
    [
        ("bodies", True, None, "both"),
        ("flows", True, LOADS, "both"),
        ("both", False, LOADS, "rotation"),
    ],
)
def test_the_rate_that_petsc_calls_itself_knows_the_lanes(
    mixed: str, massless: bool, loads: Loads | None, inertia: str
) -> None:
    equations, _ = lanes(mixed, massless, loads, evaluation="compiled", inertia=inertia)
    block = equations.block_constants()
    assert block is not None
    native = NativeRate.made(block, equations.layout)
    assert native is not None
    states = np.ascontiguousarray(random_state(equations).T)
    state = PETSc.Vec().createWithArray(states.ravel(), comm=PETSc.COMM_SELF)
    rate = state.duplicate()
    ts = PETSc.TS().create(PETSc.COMM_SELF)
    native.give(ts, state.duplicate())
    ts.setSolution(state)
    ts.computeRHSFunction(0.0, state, rate)
    assert rate.getArray().tobytes() == rates(equations, states.T).T.tobytes()
    ts.destroy()


@pytest.mark.parametrize("constraints", [None, Constraints(velocity=(0.0, 1.0, 0.0))])
@pytest.mark.parametrize("massless", [True, False])
def test_what_is_told_of_lanes(massless: bool, constraints: Constraints | None) -> None:
    block, single = lanes("both", massless, LOADS, 9, constraints=constraints)
    if constraints:
        single = [
            RigidBodyEquations(
                one.model, flow, one.stokes_number, 1, LOADS, constraints=constraints
            )
            for one, flow in zip(single, [FLOWS[i % len(FLOWS)] for i in range(9)], strict=True)
        ]
    y = random_state(block)
    pairs = list(zip(single, y[:, None], strict=True))
    for told in ("velocities", "force_torque"):
        alone = [np.concatenate(getattr(one, told)(0.0, row), axis=1) for one, row in pairs]
        found = np.concatenate(getattr(block, told)(0.0, y), axis=1)
        assert np.allclose(found, np.concatenate(alone), rtol=1e-13, atol=1e-13)
        many = block.repeated(2)
        twice = np.concatenate(getattr(many, told)(0.0, np.tile(y, (2, 1))), axis=1)
        assert np.array_equal(twice, np.tile(found, (2, 1)))
    assert np.allclose(rates(block, y), [rates(one, row)[0] for one, row in pairs], rtol=1e-13)
    assert np.array_equal(block.effective_ratio, [one.model.shape.aspect_ratio for one in single])
    assert np.array_equal(
        block.relaxation_rates, np.concatenate([one.relaxation_rates for one in single], axis=1)
    )
    assert block.sensitivity(0.0, y, 9.0) == max(one.sensitivity(0.0, x, 9.0) for one, x in pairs)
    with pytest.raises(ValueError, match="lanes differ"):
        _ = block.model


@pytest.mark.parametrize("method", ["8vr", "bdf"])
def test_lanes_move_as_alone(method: str) -> None:
    models, flows = MODELS[2:5], [Shear(), Paraboloid(0.25), Shear(2.0)]
    stokes = [0.5, 1.0, 2.0] if method == "8vr" else [1e-3, 2e-3, 4e-3]
    block = RigidBodyEquations(models, flows, stokes, 3, evaluation="compiled")
    start = block.initial_state((0.0, 1.0, 0.5), rotation.random_quaternions(3, RNG))
    times = [0.5, 1.5]
    together = integrate(block, start, times, 1e-8, method=method)
    for i, (model, flow) in enumerate(zip(models, flows, strict=True)):
        single = RigidBodyEquations(model, flow, stokes[i])
        alone = integrate(single, start[i : i + 1], times, 1e-8, method=method)
        assert np.abs(together.states[:, i] - alone.states[:, 0]).max() < 4e-8


@pytest.mark.parametrize("stokes_number", [0.0, 1.0])
def test_lanes_at_rest_turn_as_in_the_whole_equations(
    stokes_number: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    stokes = stokes_number * np.linspace(1.0, 2.0, 7)
    block = RigidBodyEquations(MODELS, Shear(), stokes, 7, evaluation="compiled")
    start = block.initial_state((3.0, 0.0, 0.0), rotation.random_quaternions(7, RNG))
    assert block.at_rest(start)
    mixed = RigidBodyEquations(MODELS, [Shear(), *[Paraboloid(0.3)] * 6], stokes, 7)
    assert not mixed.at_rest(start)
    short = integrate(block, start, [0.5], 1e-6, method="8vr")
    monkeypatch.setattr(RigidBodyEquations, "at_rest", lambda *_: False)
    whole = integrate(block, start, [0.5], 1e-6, method="8vr")
    assert np.array_equal(short.states, whole.states)


class Grid:
    """A free motion that is no polynomial, of bodies that a factor tells apart."""

    def __init__(self, factor: float) -> None:
        self.factor = factor

    def free_motion(self, t: float, x: Array, q: Array) -> tuple[Array, Array]:
        return self.factor * np.sin(x), self.factor * q[:, 1:]


class Forces(Grid):
    """The same, which also knows force and torque."""

    def force_torque(
        self, t: float, x: Array, q: Array, v: Array, omega: Array
    ) -> tuple[Array, Array]:
        return self.factor * (np.sin(x) - v), q[:, 1:] - omega


@pytest.mark.parametrize("kind", [Grid, Forces])
@pytest.mark.parametrize("stokes_number", [0.0, 0.7])
def test_each_lane_may_have_a_provider(kind: Callable[..., Any], stokes_number: float) -> None:
    providers = [kind(1.0), kind(2.0), kind(3.0)]
    providers.append(providers[0])
    models = MODELS[:4]
    block = RigidBodyEquations(models, providers, stokes_number, 4)
    y = random_state(block)
    for i, model in enumerate(models):
        single = RigidBodyEquations(model, providers[i], stokes_number)
        row = y[i : i + 1]
        assert np.allclose(rates(block, y)[i], rates(single, row)[0], rtol=1e-13)
        assert np.allclose(jacobian(block, y)[i], jacobian(single, row)[0], rtol=1e-8, atol=1e-8)
        many = block.repeated(2).force_torque(0.0, np.tile(y, (2, 1)))
        for found, alone in zip(many, single.force_torque(0.0, row), strict=True):
            assert np.allclose(found[[i, i + 4]], alone, rtol=1e-12, atol=1e-12)


def test_bodies_in_a_flow_that_is_no_polynomial() -> None:
    """Each has a functional of its own, on the flow that all share."""
    flow = qs.flow("stokeslet", position=[0.0, 8.0, 0.0], strength=[1.0, 0.0, 0.0])
    each = [
        qs.Simulation(qs.Body(k, tolerance=1e-5), flow, orientation=axis, tolerance=1e-5)
        for k, axis in ((0.5, (0.0, 1.0, 0.0)), (2.0, (0.6, 0.8, 0.0)))
    ]
    together = qs.Simulation.stack(each).integrate([0.0, 5.0])
    for i, simulation in enumerate(each):
        alone = simulation.integrate([0.0, 5.0])
        assert np.abs(together.axis[i] - alone.axis).max() < 2e-5
        assert np.abs(together.velocity[i] - alone.velocity).max() < 2e-5


def test_equal_lanes_are_one() -> None:
    again = [Shear() for _ in range(3)]
    block = RigidBodyEquations([MODELS[0], replace(MODELS[0]), MODELS[0]], again, 0.0, 3)
    one = RigidBodyEquations(MODELS[0], Shear(), 0.0, 3)
    y = random_state(one)
    assert block.model is MODELS[0]
    assert block.bodies.table.ndim == 1
    assert np.array_equal(rates(block, y), rates(one, y))


def test_what_lanes_cannot_be() -> None:
    with pytest.raises(ValueError, match="2 entries for 3 lanes"):
        RigidBodyEquations(MODELS[:2], Shear(), 0.0, 3)
    with pytest.raises(ValueError, match="all polynomial, or none"):
        RigidBodyEquations(MODELS[0], [Shear(), Grid(1.0)], 0.0, 2)  # type: ignore[list-item]

    class Skew(FaxenCoefficients):
        symmetry = "revolution"

    other = replace(MODELS[1], faxen=Skew(0.5, np.zeros(5), np.zeros(4)))
    with pytest.raises(ValueError, match="of one class"):
        RigidBodyEquations([MODELS[0], other], Shear(), 0.0, 2)


def test_small_numbers_may_be_given() -> None:
    """k^2/(1 + k^2) of a body so long that lambda is 1 to rounding still turns it."""
    k = 1e-9
    law = replace(MODELS[0].faxen, linear=1.0, small=k**2 / (1.0 + k**2), small_of_second=1e-20)
    model = BodyModel.from_arrays(replace(MODELS[0], faxen=law).to_arrays())
    assert (model.faxen.rest, model.faxen.rest_of_second) == (1e-18, 1e-20)
    along = np.sqrt([0.5, 0.0, 0.5, 0.0])  # the axis along the stream, to the last bit
    for evaluation in ("plain", "compiled"):
        equations = RigidBodyEquations([model, MODELS[6]], Shear(), 0.0, 2, evaluation=evaluation)  # type: ignore[arg-type]
        y = equations.initial_state((0.0, 0.0, 0.0), along)
        # dq/dt = (0, Omega) q/2 with Omega_3 = -k^2/(1 + k^2).
        turn = rotation.multiply([0.0, 0.0, 0.0, -1e-18], along) / 2.0
        assert np.allclose(rates(equations, y)[0, 3:7], turn, rtol=1e-12, atol=1e-33)


# -- several bodies in a lane --------------------------------------------------------------------


def test_layout_of_several_bodies() -> None:
    layout = Layout(7, 4, 3)
    states = RNG.standard_normal((layout.columns, layout.n_state))
    flat = layout.flat_by_lane(states)
    assert np.array_equal(layout.by_lane(flat), states.T)
    assert np.array_equal(layout.by_component(states.T.ravel()), states.T)
    # The states of lane 2: columns body * lanes + lane, one body after the other.
    assert np.array_equal(flat.reshape(4, layout.block)[2], states[2::4].ravel())


class Pairs(RigidBodyEquations):
    """Lanes of two bodies, here without an influence on each other."""

    def __init__(self, *arguments: Any, **more: Any) -> None:
        super().__init__(*arguments, **more)
        self.layout = Layout(self.n_state, self.n_lanes // 2, 2)

    def jacobian_function(self, evaluations: float = 0.0) -> Any:
        single, lanes, size = (
            super().jacobian_function(evaluations),
            self.layout.lanes,
            self.n_state,
        )
        blocks = np.empty((self.n_lanes, size, size))

        def function(t: float, y: Array, out: Array) -> None:
            single(t, y, blocks)
            out[:] = 0.0
            out[:, :size, :size], out[:, size:, size:] = blocks[:lanes], blocks[lanes:]

        return function


@pytest.mark.parametrize("evaluation", ["plain", "compiled"])
@pytest.mark.parametrize(("method", "lanes"), [("8vr", 3), ("bdf", 3), ("bdf", 1)])
def test_several_bodies_of_a_lane_are_integrated_together(
    method: str, lanes: int, evaluation: str
) -> None:
    n, stokes = 2 * lanes, 1.0 if method == "8vr" else 1e-3
    arguments = MODELS[3], Paraboloid(0.25), stokes, n
    pairs = Pairs(*arguments, evaluation=evaluation)
    apart = RigidBodyEquations(*arguments, evaluation=evaluation)  # type: ignore[arg-type]
    start = apart.initial_state((0.0, 1.0, 0.5), rotation.random_quaternions(n, RNG))
    one, two = (integrate(each, start, [0.5, 1.0], 1e-8, method=method) for each in (pairs, apart))
    assert np.abs(one.states - two.states).max() <= (0.0 if method == "8vr" else 1e-8)


@pytest.mark.slow
def test_a_block_of_many_bodies_is_half_as_fast_at_least() -> None:
    """Right-hand sides per second of 512 k and St in one block, against a block of one k."""
    n, flow = 512, PolynomialFlow(None, Shear().gradient_tensor)
    stokes = np.geomspace(0.1, 10.0, n)
    models = [exact_model(Spheroid(k)) for k in np.geomspace(0.02, 50.0, n)]
    functions = []
    for given in (exact_model(Spheroid(0.5)), models):
        equations = RigidBodyEquations(given, flow, stokes, n, evaluation="compiled")
        y = np.ascontiguousarray(random_state(equations).T)
        y.flags.writeable = False
        functions.append((equations.rate_function(), y, np.empty_like(y)))
    best = np.full(2, np.inf)
    for _ in range(200):
        for i, (function, y, out) in enumerate(functions):
            begin = time.perf_counter()
            for _ in range(10):
                function(0.0, y, out)
            best[i] = min(best[i], time.perf_counter() - begin)
    assert best[1] < 2.0 * best[0]
