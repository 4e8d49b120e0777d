"""Specialised right-hand sides: the numbers of the general ones, with less arithmetic."""

from __future__ import annotations

import ast
import inspect
import operator
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest
from conftest import random_flow, script
from hypothesis import given
from hypothesis import strategies as st

from qbxstokes.flows import build_flow
from qbxstokes.flows.named import Paraboloid, Shear, Uniform
from qbxstokes.flows.polynomial import PolynomialFlow
from qbxstokes.geometry import rotation
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.motion import fore_aft, tracing
from qbxstokes.motion.equations import Loads, RigidBodyEquations
from qbxstokes.motion.taylor import pack_flow, unpack_flow
from qbxstokes.motion.tracing import specialise
from qbxstokes.simulation.hydrodynamics import exact_model

RNG = np.random.default_rng(4)
OPERATORS = (operator.add, operator.sub, operator.mul)
PUSH = Loads(force=(0.0, 0.0, -1.5), body_torque=(0.2, 0.0, 0.0))


@given(st.data())
def test_any_arithmetic_is_kept(data: st.DataObject) -> None:
    """Random programs on inputs, zeros, ones and other constants, plain and specialised."""
    constants = st.sampled_from([0.0, -0.0, 1.0, -1.0, 0.5, -3.0, 7.0])
    steps = data.draw(
        st.lists(
            st.tuples(st.integers(0, 4), st.integers(0, 40), st.integers(0, 40), constants),
            min_size=1,
            max_size=30,
        )
    )

    def program(rows: list[Any], more: list[Any]) -> list[Any]:
        values = [*rows, *more]
        for choice, i, j, constant in steps:
            a, b = values[i % len(values)], values[j % len(values)]
            if choice == 3:
                values.append(-a)
            elif choice == 4:  # of what cannot be zero
                values.append(b / (a * a + 1.5))
            else:
                values.append(OPERATORS[choice](*((a, constant) if i % 2 else (constant, b))))
                values.append(OPERATORS[choice](a, b))
        return values

    number = st.floats(-2.0, 2.0, allow_subnormal=False)
    numbers = data.draw(st.lists(number, min_size=4, max_size=4))
    plain = program(numbers[:3], numbers[3:])
    values = specialise(program, 3, 1)(0.0, numbers[:3], numbers[3:])
    with np.errstate(all="ignore"):
        kept = np.isfinite(plain)
    assert np.array_equal(np.array(values)[kept], np.array(plain)[kept])


SCENES: dict[str, tuple[float, PolynomialFlow, Loads | None, str]] = {
    "shear": (0.5, Shear(), None, "both"),
    "moved shear": (3.0, Shear().shifted((1.0, -2.0, 0.5)), None, "translation"),
    "uniform": (0.2, Uniform((0.0, 2.0, 0.0)), PUSH, "both"),
    "paraboloid": (0.5, Paraboloid(0.3), None, "rotation"),
    "sphere in a paraboloid": (1.0, Paraboloid(0.3), None, "both"),
    "degree 3 and loads": (2.0, random_flow(3, RNG), PUSH, "both"),
}


@pytest.mark.parametrize("stokes_number", [0.0, 0.7])
@pytest.mark.parametrize("scene", SCENES)
def test_scenes_keep_their_numbers(scene: str, stokes_number: float) -> None:
    k, flow, loads, inertia = SCENES[scene]
    model = exact_model(Spheroid(k))
    equations = RigidBodyEquations(model, flow, stokes_number, 1, loads, inertia=inertia)  # type: ignore[arg-type]
    velocities = RNG.standard_normal((2, 3)) if stokes_number else ()
    q = rotation.random_quaternions(1, RNG)[0]
    y = equations.initial_state(RNG.standard_normal(3), q, *velocities)[0].tolist()
    general = general_rates(equations, flow, loads, inertia)
    assert np.array_equal(equations.rate_of_rows(0.0, y), general(y))
    moved = [value + 0.1j * (i == 4) for i, value in enumerate(y)]
    assert np.array_equal(equations.rate_of_rows(0.0, moved), general(moved))


def general_rates(
    equations: RigidBodyEquations, flow: Any, loads: Any, inertia: str
) -> Callable[[list[Any]], Any]:
    """The kernels themselves with all constants handed over."""
    model = equations.model
    r = model.resistance
    drag = r.translation_transverse, r.translation_axial, r.rotation_transverse, r.rotation_axial
    forces = (
        None
        if loads is None
        else (*loads.force, *loads.body_force, *loads.torque, *loads.body_torque)
    )
    law, _, _ = fore_aft.unpack_body(fore_aft.pack_body(model, True))
    head = unpack_flow(pack_flow(flow).tolist()), law, tuple(1.0 / x for x in drag), forces
    if equations.massless:
        return lambda rows: fore_aft.massless(rows, *head)
    follow = None
    if inertia != "both":
        follow = float(inertia == "rotation"), float(inertia == "translation")
    rates = equations.relaxation_rates[:, 0].tolist()
    j1, _, j3 = Spheroid(model.shape.aspect_ratio).inertia.tolist()
    return lambda rows: fore_aft.inertial(rows, *head, rates, (j3 - j1) / j1, follow)


def operations(equations: RigidBodyEquations, monkeypatch: pytest.MonkeyPatch) -> int:
    """How many additions, multiplications and so on a right-hand side takes."""
    sources: list[str] = []
    monkeypatch.setattr(tracing, "_KNOWN", {})
    monkeypatch.setattr(
        tracing,
        "compile",
        lambda source, *rest: sources.append(source) or compile(source, *rest),
        raising=False,
    )
    equations.rate_of_rows(0.0, [0.1] * equations.n_state)
    return count_operations(sources[0])


def count_operations(source: str) -> int:
    kinds = ast.BinOp | ast.UnaryOp
    return sum(isinstance(node, kinds) for node in ast.walk(ast.parse(source)))


def test_zeros_cost_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """A shear costs no more arithmetic than its closed form; a sphere needs no axis."""
    closed = count_operations(inspect.getsource(script("benchmarks/step").closed_form))
    shear = RigidBodyEquations(exact_model(Spheroid(0.5)), Shear())
    assert operations(shear, monkeypatch) <= 1.2 * closed
    slender, sphere = (
        operations(RigidBodyEquations(exact_model(Spheroid(k)), Paraboloid(0.3)), monkeypatch)
        for k in (0.5, 1.0)
    )
    assert sphere < 0.5 * slender


def test_flows_that_change_alike_share_what_is_written() -> None:
    """Their numbers are handed over: another series needs no other function, other rows do."""
    y, written = np.array([0.1, -0.2, 0.3, 0.8, 0.2, -0.4, 0.1])[:, None], []
    linear = np.array([[0.0, 1.0, 0.2], [0.0, 0.5, 0.0], [0.3, 0.0, -0.5]])
    for key, value in (("gradient", linear), ("gradient", -0.4 * linear), ("rate", 1.0)):
        rates = np.zeros((2, *y.shape))
        both = np.array(value).tolist(), partial(lambda value, t: value, value)
        for numbers, found in zip(both, rates, strict=True):
            flow = build_flow({"type": "linear" if key == "gradient" else "shear", key: numbers})
            equations = RigidBodyEquations(exact_model(Spheroid(0.5)), flow)
            equations.rates(0.3, y, found)
        np.testing.assert_allclose(rates[0], rates[1], rtol=1e-15, atol=1e-16)
        written.append(inspect.getclosurevars(equations.rate_of_rows).nonlocals["kernel"])
    assert written[0] is written[1]
    assert written[0] is not written[2]
