"""Events between steps: roots, half-turns, turning points, rest, regions, singular points."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import qbxstokes as qs
from qbxstokes.bie.functional import BodyModel, FaxenCoefficients, Resistance
from qbxstokes.flows import build_flow
from qbxstokes.flows.domain import channel, tube
from qbxstokes.geometry import rotation
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.motion.averages import ShearFrame
from qbxstokes.motion.contacts import Contacts, edge_gap, root, singular_gap
from qbxstokes.motion.equations import RigidBodyEquations
from qbxstokes.motion.events import (
    Event,
    Events,
    Passage,
    leaving,
    steady,
    turning_point,
)
from qbxstokes.petsc.leaps import Leaps
from qbxstokes.petsc.stepper import integrate
from qbxstokes.petsc.trajectory import Checkpoint, Chunk
from qbxstokes.reference import faxen, jeffery

SHEAR = build_flow({"type": "shear"}).polynomial


def equations_of(k: float, flow: Any = SHEAR, stokes: float = 0.0) -> RigidBodyEquations:
    model = BodyModel(
        Spheroid(k),
        Resistance(*faxen.resistance(k)),
        FaxenCoefficients(*faxen.body_coefficients(k)),
        None,
        0.0,
    )
    return RigidBodyEquations(model, flow, stokes)


def watch(equations: RigidBodyEquations, *events: Event, half_turns: bool = False) -> Events:
    k = equations.model.shape.aspect_ratio
    passage = Passage.of(SHEAR.gradient_tensor, k) if half_turns else None
    return Events(equations, passage, events, ShearFrame.of(SHEAR.gradient_tensor))


@pytest.mark.parametrize("steepness", [1.0, 30.0, 1e6])
def test_root_is_found_to_rounding(steepness: float) -> None:
    def function(x: float) -> float:
        return math.tanh(steepness * (x - 0.3)) + 1e-3 * (x - 0.3)

    assert root(function, 0.0, 1.0, function(0.0), function(1.0)) == pytest.approx(0.3, rel=4e-15)


@pytest.mark.parametrize("k", [0.05, 0.5, 1.0, 3.0])
@pytest.mark.parametrize("method", ["8vr", "5dp"])
def test_half_turns_have_jefferys_period(k: float, method: str) -> None:
    equations = equations_of(k)
    period = jeffery.period(k)
    start = equations.initial_state([0, 0, 0], rotation.from_axis(np.array([1.0, 1.0, 1.0])))
    events = watch(equations, half_turns=True)
    integrate(equations, start, [3.2 * period], 1e-9, method=method, observe=events)
    rows = events.take()["half_turns"]
    assert len(rows) in (6, 7)
    np.testing.assert_allclose(np.diff(rows[:, 0]), 0.5 * period, rtol=1e-7)
    np.testing.assert_allclose(rows[2:, 11], period, rtol=1e-7)
    np.testing.assert_allclose(rows[:, 10], jeffery.orbit_constant(k, [1, 1, 1]), rtol=1e-6)


@pytest.mark.parametrize("axis", [[0, 0, 1], [1, 0, 0], [0, 1, 1e-12]])
def test_log_rolling_and_tumbling_are_no_special_cases(axis: list[float]) -> None:
    equations = equations_of(0.5)
    start = equations.initial_state([0, 0, 0], rotation.from_axis(np.array(axis, dtype=float)))
    events = watch(equations, half_turns=True)
    integrate(equations, start, [50.0], 1e-8, observe=events)
    assert events.counts.get("half_turns", 0) == (0 if axis[2] == 1 else 6)


def test_watching_does_not_change_the_motion() -> None:
    equations = equations_of(0.5)
    start = equations.initial_state([0, 1, 0], rotation.from_axis(np.array([1.0, 1.0, 1.0])))
    events = watch(equations, turning_point(equations, "d3", 1.0), half_turns=True)
    watched = integrate(equations, start, [10.0, 40.0], 1e-9, observe=events)
    alone = integrate(equations, start, [10.0, 40.0], 1e-9)
    np.testing.assert_array_equal(watched.states, alone.states)
    rows = events.take()["turning_d3"]
    # d3 of an orbit is extreme where the axis passes the planes of d1 = 0 and d2 = 0.
    np.testing.assert_allclose(np.min(np.abs(rows[:, 4:6]), axis=1), 0.0, atol=1e-7)


def test_leaving_a_region_ends_the_run_there() -> None:
    equations = equations_of(0.5)
    start = equations.initial_state([0, 2, 0], [1, 0, 0, 0])  # moves with u = x2 = 2
    events = watch(equations, leaving((None, None, None), (5.0, None, None)))
    found = integrate(equations, start, np.linspace(0, 10, 11), 1e-9, observe=events)
    assert found.stopped
    assert found.times[-1] == pytest.approx(2.5, rel=1e-12)
    assert found.states[-1, 0, 0] == pytest.approx(5.0, rel=1e-12)
    assert events.ended[0] == "left_region"


def test_steady_state_in_extension_is_found() -> None:
    flow = build_flow({"type": "linear", "gradient": [[1, 0, 0], [0, -0.5, 0], [0, 0, -0.5]]})
    equations = equations_of(0.5, flow.polynomial)
    start = equations.initial_state([0, 0, 0], rotation.from_axis(np.array([1.0, 0.5, 0.2])))
    events = watch(equations, steady(equations, 1e-6, True))
    found = integrate(equations, start, [200.0], 1e-10, observe=events)
    assert found.stopped
    # The angle to the axis of extension falls as exp(-3 lambda t/2), lambda = 3/5.
    slope = np.hypot(0.5, 0.2) * np.exp(-0.9 * found.times[-1])
    assert 0.9 * slope == pytest.approx(1e-6, rel=1e-4)


def test_meeting_a_point_is_seen_from_the_surface() -> None:
    equations = equations_of(1.0)
    start = equations.initial_state([-4, 1, 0], [1, 0, 0, 0])  # a unit sphere moving at speed 1
    gap = singular_gap(np.array([[0.0, 1.0, 0.0]]), Spheroid(1.0), 0.5)
    events = Events(equations, contacts=Contacts([gap], np.ones(1)))
    found = integrate(equations, start, [20.0], 1e-9, observe=events)
    assert found.states[-1, 0, 0] == pytest.approx(-1.5, abs=1e-8)
    assert events.contacts is not None
    assert events.contacts.nearest["clearance"] == (0.5, found.times[-1])


def test_events_of_a_resumed_run_are_those_of_a_whole_one() -> None:
    equations = equations_of(0.5)
    start = equations.initial_state([0, 0, 0], rotation.from_axis(np.array([1.0, 1.0, 1.0])))
    arguments: dict[str, Any] = {"tolerance": 1e-9, "chunk_steps": 40}
    events, saved, rows = watch(equations, half_turns=True), [], []

    def keep(chunk: Chunk) -> None:
        rows.extend(events.take().get("half_turns", np.empty((0, 15))).tolist())
        saved.append((chunk.checkpoint, events.state(), len(rows)))

    integrate(equations, start, [60.0], observe=events, on_chunk=keep, **arguments)
    checkpoint, state, count = saved[1]
    assert isinstance(checkpoint, Checkpoint)
    later = watch(equations, half_turns=True)
    later.restore(state)
    integrate(equations, checkpoint, [60.0], observe=later, **arguments)
    np.testing.assert_array_equal(later.take()["half_turns"], np.array(rows[count:]))


def farthest(k: float, axis: Any, centre: Any) -> float:
    """Largest distance from the line along e1 of a spheroid's surface, by a fine grid."""
    theta = np.linspace(0.0, np.pi, 801)[:, None]
    points = Spheroid(k).surface(theta, np.linspace(0.0, 2.0 * np.pi, 1201))
    turned = points @ rotation.matrix(rotation.from_axis(np.array(axis))).T + centre
    return float(np.hypot(turned[..., 1], turned[..., 2]).max())


@pytest.mark.parametrize("k", [0.1, 1.0, 4.0])
def test_gaps_are_distances_of_surfaces(k: float) -> None:
    rng = np.random.default_rng(3)
    for axis in [*rotation.random_axes(3, rng), np.eye(3)[0], np.eye(3)[1]]:
        body, place = Spheroid(k).extent(axis), rng.uniform(-2.0, 2.0, 3)
        for centre in (place, 0.0 * place, place * [1, 0, 1]):
            (wall,) = tube(9.0)
            assert wall.gap(centre, body) == pytest.approx(
                9.0 - farthest(k, axis, centre), abs=2e-5
            )
            upper, lower = channel(9.0)
            reach = np.sqrt(k * k + (1.0 - k * k) * axis[1] ** 2)
            assert upper.gap(centre, body) == pytest.approx(9.0 - centre[1] - reach, rel=1e-14)
            assert lower.gap(centre, body) == pytest.approx(9.0 + centre[1] - reach, rel=1e-14)


def test_walls_go_with_their_flow() -> None:
    spec = {"type": "plane_poiseuille", "half_width": 5.0, "position": [0, 1, 0]}
    flow = build_flow({"type": "sum", "terms": [spec, {"type": "rotation"}]}).scaled(2.0)
    assert [str(edge) for edge in flow.domain] == ["the wall x2 = 6", "the wall x2 = -4"]
    turned = build_flow({**spec, "rotation": {"axis": [0, 0, 1], "angle": math.pi / 2}})
    assert str(turned.rotated(np.eye(3)).domain[0]) == "the wall x1 = -5"
    assert not SHEAR.domain


def test_a_passing_touch_between_the_ends_of_a_step_is_seen() -> None:
    """A rod in shear, whose tip passes a plane only while it stands upright."""
    equations = equations_of(0.1)
    start = equations.initial_state([0, 0, 0], rotation.from_axis(np.array([1.0, -0.3, 0.0])))
    end = np.array([jeffery.period(0.1)])
    for height in (0.999999, 0.9, 0.6):
        gaps = [edge_gap(edge, Spheroid(0.1), slice(None)) for edge in channel(height)]
        events = Events(equations, contacts=Contacts(gaps, np.ones(1)))
        found = integrate(equations, start, end, 1e-8, method="8vr", observe=events)
        assert events.ended[0] == "domain_exit"
        axis = rotation.axis(found.states[-1, 0, 3:7])
        assert math.sqrt(0.01 + 0.99 * axis[1] ** 2) == pytest.approx(height, abs=1e-7)


@pytest.mark.parametrize("stokes", [0.0, 2.0])
@pytest.mark.parametrize("flow", ["shear", "pulse", "jump", "paraboloid"])
def test_steps_that_nobody_looks_at_are_the_same(
    flow: str, stokes: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    def rate(t: float) -> float:
        return (
            2.0 if flow == "jump" and t > 3.3 else 1.0 + 30.0 * np.exp(-(((t - 7.3) / 0.02) ** 2))
        )

    kind = flow if flow in ("shear", "paraboloid") else "linear"
    keys = {} if kind == flow else {"gradient": lambda t: [[0, rate(t), 0], [0, 0, 0], [0, 0, 0]]}
    body, found = qs.Body(0.2, stokes_number=stokes), []
    start = {"position": [0, 0.5, 0], "orientation": [0.48, 0.6, 0.64]}
    for leaps in (Leaps.of, lambda *_: None):
        monkeypatch.setattr(Leaps, "of", leaps)
        assembled = qs.Simulation(body, qs.flow(kind, **keys), **start, tolerance=1e-7).assemble()
        assembled.equations.evaluation = "compiled"
        found.append(assembled.integrate([0.0, 5.0, 5.1, 20.0]))
    one, other = found
    assert one.steps > 10
    assert one.summary == other.summary
    for name in ("position", "orientation", "angular_velocity"):
        assert np.array_equal(getattr(one, name), getattr(other, name))
    assert one.events.keys() == other.events.keys()
    for name, columns in one.events.items():
        for column, values in columns.items():
            assert np.array_equal(values, other.events[name][column], equal_nan=True)
