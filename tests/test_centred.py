"""Bodies that stay where they are: the rotation alone gives the numbers of the whole equations."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import qbxstokes as qs
from qbxstokes.case.load import load_case
from qbxstokes.flows.polynomial import PolynomialFlow
from qbxstokes.geometry import rotation
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.motion.equations import Constraints, Loads, RigidBodyEquations
from qbxstokes.motion.layout import Step
from qbxstokes.petsc import stepper
from qbxstokes.petsc.stepper import integrate
from qbxstokes.petsc.system import RK_FORMULAS
from qbxstokes.petsc.trajectory import Chunk
from qbxstokes.runs.sweep_blocks import Scenes
from qbxstokes.simulation.hydrodynamics import exact_model

Array = np.ndarray
SHEAR = PolynomialFlow(None, [[0.0, 1.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
TIMES = np.linspace(0.0, 9.0, 31)
N = 9


def odd_cubic(centre: Any) -> PolynomialFlow:
    """A shear with a part of degree 3, odd about its centre."""
    third = np.zeros((3, 3, 3, 3))
    third[0, 1, 1, 1], third[1, 0, 0, 0] = 0.3, -0.2
    return PolynomialFlow(None, SHEAR.gradient_tensor, None, third, centre)


def equations_of(flow: Any, stokes_number: Any, *more: Any) -> RigidBodyEquations:
    return RigidBodyEquations(exact_model(Spheroid(0.5)), flow, stokes_number, N, *more)


def start_of(equations: RigidBodyEquations, place: Any, spin: Any = None) -> Array:
    q = rotation.random_quaternions(N, np.random.default_rng(5))
    return equations.initial_state(place, q, None, spin)


@pytest.fixture
def whole(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Any]:
    """The same integration with every component of the state."""

    def run(*arguments: Any, **more: Any) -> Any:
        with monkeypatch.context() as changed:
            changed.setattr(RigidBodyEquations, "at_rest", lambda *_: False)
            return integrate(*arguments, **more)

    return run


def sizes(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Numbers per body of what is integrated from now on."""
    found: list[int] = []
    build = stepper.Run._build

    def noted(self: Any) -> None:
        build(self)
        found.append(self._vector.getSize() // self.equations.n_lanes)

    monkeypatch.setattr(stepper.Run, "_build", noted)
    return found


@pytest.mark.parametrize(
    ("stokes_number", "method", "rounding"),
    [
        (0.0, "8vr", 0.0),
        (0.0, "5dp", 0.0),
        (np.linspace(1.0, 3.0, N), "8vr", 0.0),
        (1e-3, "bdf", 1e-12),
        (1e-2, "arkimex", 1e-12),
        (1e-2, "rosw", 1e-12),
        (0.0, "rosw", 1e-12),
    ],
)
@pytest.mark.parametrize("flow", ["linear", "cubic"])
def test_rotation_alone_gives_the_whole_motion(
    stokes_number: Any,
    method: str,
    rounding: float,
    flow: str,
    whole: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    explicit = method in RK_FORMULAS
    # A shear leaves every body on its stagnation plane in its place. The Newton iteration of the
    # implicit methods ends by the length of what is integrated: there alone places would count.
    place = (7.0, 0.0, -2.0) if explicit else (0.0, 0.0, 0.0)
    chosen = SHEAR if flow == "linear" else odd_cubic(place)
    equations = equations_of(chosen, stokes_number)
    start = start_of(equations, place, None if np.all(stokes_number == 0) else (0.3, -0.1, 0.2))
    times = TIMES if explicit else TIMES[:4]
    full = whole(equations, start, times, 1e-7, method=method)
    found = sizes(monkeypatch)
    short = integrate(equations, start, times, 1e-7, method=method)
    assert set(found) == {4 if equations.massless else 7}
    assert short.checkpoint.steps == full.checkpoint.steps
    assert np.abs(short.states - full.states).max() <= rounding
    assert np.array_equal(short.states[:, :, :3], np.broadcast_to(start[:, :3], (len(times), N, 3)))
    if rounding == 0.0:
        assert short.checkpoint.evaluations == full.checkpoint.evaluations


@pytest.mark.parametrize(
    "loads",
    [
        Loads(torque=(0.3, 0.0, -0.2), body_torque=(0.0, 0.1, 0.2)),
        Loads(torque=lambda t: np.array([np.sin(t), 0.0, 0.3])),
    ],
    ids=["steady", "timed"],
)
@pytest.mark.parametrize("stokes_number", [0.0, 2.0])
def test_torques_move_no_centre(
    loads: Loads, stokes_number: float, whole: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    equations = equations_of(SHEAR, stokes_number, loads)
    start = start_of(equations, (0.0, 0.0, 0.0))
    full = whole(equations, start, TIMES, 1e-7)
    found = sizes(monkeypatch)
    short = integrate(equations, start, TIMES, 1e-7)
    assert set(found) == {7 if stokes_number else 4}
    # Samples from the polynomial of a step are sums of as many products, in no fixed order.
    assert np.abs(short.states - full.states).max() <= (0.0 if equations.steady else 1e-14)


def places(offset: float) -> Array:
    where = np.zeros((N, 3))
    where[N // 2, 1] = offset
    return where


@pytest.mark.parametrize(
    ("flow", "stokes_number", "more", "place", "velocity"),
    [
        (SHEAR, 0.0, (), places(1e-12), None),
        (PolynomialFlow((1e-300, 0, 0), SHEAR.gradient_tensor), 0.0, (), places(0.0), None),
        (qs.flow("paraboloid", curvature=1.0).polynomial, 0.0, (), places(0.0), None),
        (odd_cubic((1, 2, -3)), 0.0, (), np.add(places(0.0), (1.1, 2.0, -3.0)), None),
        (SHEAR, 0.0, (Loads(force=(0, 0, 1e-9)),), places(0.0), None),
        (SHEAR, 0.0, (Loads(body_force=lambda t: np.zeros(3)),), places(0.0), None),
        (SHEAR, 1.0, (), places(0.0), (0.0, 0.0, 1e-9)),
        (SHEAR, 0.0, (None, Constraints.held()), places(0.0), None),
    ],
)
def test_what_can_move_is_not_at_rest(
    flow: Any, stokes_number: float, more: Any, place: Array, velocity: Any
) -> None:
    equations = equations_of(flow, stokes_number, *more)
    q = rotation.random_quaternions(N, np.random.default_rng(5))
    assert not equations.at_rest(equations.initial_state(place, q, velocity))


def test_going_on_from_a_checkpoint_gives_the_same_numbers(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(stepper, "BDF_STEPS", 50)
    for stokes_number, count in ((0.0, 16), (5.0, 16), (1e-2, 4)):
        equations = equations_of(SHEAR, stokes_number)
        start, times = start_of(equations, (3.0, 0.0, 0.0)), TIMES[:count]
        cut: dict[str, Any] = {"chunk_samples": count // 3, "chunk_steps": 100}
        chunks: list[Chunk] = []
        integrate(equations, start, times, 1e-7, on_chunk=chunks.append, **cut)
        assert len(chunks) >= 2
        last = chunks[-1].checkpoint
        assert last.state.shape == (N, equations.n_state)
        again = integrate(equations, chunks[0].checkpoint, times, 1e-7, **cut)
        assert np.array_equal(again.checkpoint.state, last.state)


def test_an_observer_sees_whole_states(whole: Callable[..., Any]) -> None:
    equations = equations_of(SHEAR, 1.0)
    start = start_of(equations, (3.0, 0.0, 0.0))
    seen: list[list[Array]] = []
    for run in (whole, integrate):
        inside: list[Array] = []

        def observe(step: Step, inside: list[Array] = inside) -> float | None:
            middle = 0.5 * (step.before + step.after)
            inside += [step.start, step.state(middle), step.end]
            return middle if step.after > 4.0 else None

        ended = run(equations, start, TIMES, 1e-7, observe=observe)
        seen.append([*inside, *ended.states])
        assert ended.stopped
    assert len(seen[0]) == len(seen[1])
    assert all(np.array_equal(one, two) for one, two in zip(*seen, strict=True))


# -- sweeps -------------------------------------------------------------------------------------

CASE: dict[str, Any] = {
    "body": {"aspect_ratio": 0.4},
    "flow": {"type": "shear"},
    "time": {"end": 6, "samples": 7, "tolerance": 1e-7},
    "hydrodynamics": {"tolerance": 1e-7},
    "compare": {"reference": "none"},
}
RANDOM = {"start.orientation": {"random": "axes", "count": 4, "seed": 2}}


def test_a_sweep_with_bodies_on_and_off_the_stagnation_plane() -> None:
    """One scene holds them all: its blocks rest, or move, as a whole."""
    heights = [0.0, 0.0, 0.5]
    mixed = qs.sweep(CASE, {"start.position.1": heights, **RANDOM})
    still = qs.sweep(CASE, RANDOM)
    position, axis = (array.reshape(3, 4, 7, 3) for array in (mixed.position, mixed.axis))
    for row in range(2):
        assert not np.any(position[row])
        # The steps are those of the whole block, not of these bodies.
        assert np.abs(axis[row] - still.axis).max() < 1e-7
    assert np.allclose(position[2, :, -1, 0], 0.5 * 6, rtol=1e-12)


@pytest.mark.parametrize(
    ("change", "axes", "centred"),
    [
        ({}, {}, True),
        ({"body": {"aspect_ratio": 0.4, "stokes_number": 3}}, {}, True),
        ({"start": {"position": [5, 0, 2]}}, {}, True),
        ({"start": {"position": [5, 1, 2]}}, {}, False),
        ({}, {"start.position.1": [0, 1]}, False),
        ({"forces": {"force": [0, 0, 1]}}, {}, False),
        ({"flow": {"type": "paraboloid"}}, {}, False),
        ({"flow": {"type": "stokeslet", "position": [0, 3, 0], "strength": [1, 0, 0]}}, {}, False),
    ],
)
def test_the_plan_of_a_sweep_tells_what_its_blocks_do(
    change: dict[str, Any],
    axes: dict[str, Any],
    centred: bool,
    write_case: Callable[..., Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    whole = [{name: values} for name, values in {**RANDOM, **axes}.items()]
    path = write_case({**CASE, **change, "sweep": {"axes": whole}})
    scenes = Scenes(load_case(path))
    assert scenes.centred == centred
    assert any(text.startswith("translation:") for text in scenes.skips) == centred
    found = sizes(monkeypatch)
    qs.sweep({**CASE, **change}, {**RANDOM, **axes})
    assert (set(found) <= {4, 7} - ({7} if change.get("body") is None else {4})) == centred
