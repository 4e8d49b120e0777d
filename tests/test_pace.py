"""Integrators get on: no more is asked than rounding leaves, and a poor choice is changed."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import pytest

from qbxstokes.flows.named import PlanePoiseuille, Shear, TubePoiseuille, Uniform
from qbxstokes.flows.polynomial import PolynomialFlow
from qbxstokes.geometry import rotation
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.motion import forecast
from qbxstokes.motion.equations import RigidBodyEquations
from qbxstokes.petsc import session
from qbxstokes.petsc.stepper import integrate
from qbxstokes.petsc.trajectory import Chunk
from qbxstokes.simulation.hydrodynamics import exact_model

Array = np.ndarray
# Scenes of the slow test; each takes about 0.1 s.
SCENES = int(os.environ.get("QBXSTOKES_RANDOM_SCENES", "60"))
STRAIN = PolynomialFlow(None, np.diag([0.15, 0.15, -0.3]))


@pytest.fixture(scope="module", autouse=True)
def petsc() -> None:
    session.start([])


def at_rest(k: float, flow: Any, stokes: float, place: Any) -> tuple[RigidBodyEquations, Array]:
    equations = RigidBodyEquations(exact_model(Spheroid(k)), flow, stokes, evaluation="plain")
    q = rotation.from_axis(np.ones(3))
    return equations, equations.initial_state(place, q, [0.1] * 3, [0.1] * 3)


def test_no_integrator_is_asked_for_less_than_rounding_leaves() -> None:
    """A thick disc in a wide channel, faster than the fluid at first: BDF took steps of 1e-7."""
    equations, start = at_rest(18.0, PlanePoiseuille(180.0), 0.4, [0.0, 1.0, 0.0])
    found = integrate(equations, start, [17.0], 1e-10)
    assert found.checkpoint.steps < 300
    finer = integrate(equations, start, [17.0], 1e-12, method="5dp")
    np.testing.assert_allclose(found.states[-1], finer.states[-1], rtol=0.0, atol=1e-9)


def test_a_component_is_asked_for_no_more_than_its_vector_leaves() -> None:
    """Carried away along one axis: what is known of the other two is rounding of the first."""
    equations, start = at_rest(0.93, STRAIN, 2.2e-3, [0.1, 0.1, 0.5])
    found = integrate(equations, start, [100.0], 1e-10, method="bdf").checkpoint
    assert found.steps < 5000
    assert np.linalg.norm(found.state[:, :3]) > 1e4
    assert not found.changed


@pytest.mark.parametrize("stokes", [0.4, 1e-4])
def test_what_does_not_get_on_is_changed(stokes: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """With a local tolerance below rounding: explicit steps, or where they would be too many, a
    larger tolerance; told, and to the last bit the same where the run goes on from a cut."""
    monkeypatch.setitem(forecast._FLOORS, "bdf", 1e-15)
    monkeypatch.setattr(forecast, "WITHIN", np.inf)
    monkeypatch.setattr(forecast, "_START", 0)
    equations, start = at_rest(18.0, PlanePoiseuille(180.0), stokes, [0.0, 1.0, 0.0])
    chunks: list[Chunk] = []
    settings: dict[str, Any] = {"on_chunk": chunks.append, "chunk_steps": 500}
    integrate(equations, start, [2.0, 5.0], 1e-10, **settings)
    last = chunks[-1].checkpoint
    assert (last.method, last.steps < 4000) == ("8vr" if stokes == 0.4 else "bdf", True)
    assert ("explicit steps" if stokes == 0.4 else "larger local tolerance") in last.changed
    changes = [i for i, chunk in enumerate(chunks[:-1]) if chunk.checkpoint.changed]
    for i in {0, changes[0], len(chunks) - 2}:
        again: list[Chunk] = []
        integrate(
            equations,
            chunks[i].checkpoint,
            [2.0, 5.0],
            1e-10,
            **{**settings, "on_chunk": again.append},
        )
        assert np.array_equal(again[-1].checkpoint.state, last.state)
        assert again[-1].checkpoint.changed == last.changed


def random_scene(rng: np.random.Generator, kind: str) -> tuple[RigidBodyEquations, Array, float]:
    """Any k from 1/50 to 50 and St from 1e-3 to 1e4, with the flow, at rest or at any speed."""
    k, stokes = np.exp(rng.uniform(np.log([0.02, 1e-3]), np.log([50.0, 1e4])))
    place, width = rng.uniform(-1.0, 1.0, 3), 10.0 * max(1.0, k)
    matrix = 0.3 * rng.standard_normal((3, 3)) + np.array(Shear().gradient(np.zeros(3)))
    flow = {
        "shear": lambda: Shear(),
        "strain": lambda: STRAIN,
        "linear": lambda: PolynomialFlow(None, matrix - np.eye(3) * np.trace(matrix) / 3.0),
        "uniform": lambda: Uniform([1.0, 0.2, 0.0]),
        "plane": lambda: PlanePoiseuille(width, width),
        "tube": lambda: TubePoiseuille(width, width),
    }[kind]()
    equations = RigidBodyEquations(
        exact_model(Spheroid(float(k))), flow, float(stokes), evaluation="plain"
    )
    speeds = [(None, None), (np.zeros(3), np.zeros(3)), rng.uniform(-1.0, 1.0, (2, 3))]
    v, w = speeds[int(rng.integers(3))]
    q = rotation.from_axis(rng.standard_normal(3))
    return equations, equations.initial_state(place, q, v, w), float(rng.choice([3.0, 10.0]))


@pytest.mark.slow
def test_random_scenes_take_a_small_multiple_of_the_best_steps() -> None:
    """In right-hand sides, a step of BDF as so many as it takes as long as.

    Explicit steps may be as many as are afforded where BDF's rounding would miss the tolerance.
    """
    rng = np.random.default_rng(18)
    for number in range(SCENES):
        kind = ("shear", "strain", "linear", "uniform", "plane", "tube")[number % 6]
        equations, start, end = random_scene(rng, kind)
        done = integrate(equations, start, [end], 1e-10).checkpoint
        cost = 25 * done.jacobians + done.evaluations
        for method, price, multiple in (
            ("8vr", forecast.STAGES, 12.0),
            ("bdf", 50.0, forecast.AFFORDED),
        ):
            if cost < 40_000:  # a quarter of a second
                break
            fewest = cost / multiple / price
            steps = 0

            def counted(step: Any, fewest: float = fewest) -> float | None:
                nonlocal steps
                steps += 1
                return step.after if steps > fewest else None

            other = integrate(equations, start, [end], 1e-10, method=method, observe=counted)
            assert other.stopped, f"scene {number}: {done.method} {done.steps}, {method} {steps}"
