"""What a scene needs: what is left out, and that nothing is where it is needed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import qbxstokes as qs
from qbxstokes.bie.accuracy import accurate_body
from qbxstokes.case.load import load_case
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.io.cache import Cache
from qbxstokes.motion.equations import Constraints, Loads, RigidBodyEquations
from qbxstokes.runs.plan import make_plan
from qbxstokes.runs.sweep_blocks import Scenes
from qbxstokes.simulation.hydrodynamics import Workshop

WriteCase = Callable[..., Path]
CASE: dict[str, Any] = {
    "body": {"aspect_ratio": 0.5},
    "flow": {"type": "shear"},
    "start": {"orientation": {"axis": [0.3, 0.2, 0.8]}},
    "time": {"end": 4, "samples": 9, "tolerance": 1e-8},
    "hydrodynamics": {"tolerance": 1e-8},
    "compare": {"reference": "none"},
}


def test_a_sphere_has_no_axis_in_the_law_of_its_motion(write_case: WriteCase) -> None:
    model = accurate_body(Spheroid(1.0), 1e-8).model
    assert model.faxen.linear == 0.0
    assert not np.any(model.faxen.quadratic[1:])
    assert not np.any(model.faxen.cubic)
    assert model.faxen.quadratic[0] == pytest.approx(1.0 / 6.0, rel=1e-12)
    r = model.resistance
    assert r.translation_transverse == r.translation_axial == pytest.approx(6.0 * np.pi, rel=1e-8)
    assert r.rotation_transverse == r.rotation_axial == pytest.approx(8.0 * np.pi, rel=1e-8)
    ball = CASE | {"body": {"aspect_ratio": 1}}
    assert any(text.startswith("axis") for text in make_plan(load_case(write_case(ball))).skips)


# -- the resistance ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "completion"),
    [
        ({}, None),
        ({"hydrodynamics": {"completion": "surface"}}, "surface"),
        ({"hydrodynamics": {"completion": "point"}}, "point"),
        ({"body": {"aspect_ratio": 0.5, "stokes_number": 1}}, "surface"),
        ({"forces": {"torque": [0, 0, 1]}}, "surface"),
        ({"constraints": {"translation": "locked"}}, "surface"),
    ],
)
def test_the_resistance_is_formed_where_forces_act_or_it_is_asked_for(
    change: dict[str, Any], completion: str | None, write_case: WriteCase
) -> None:
    loaded = load_case(write_case(CASE | change))
    plan = make_plan(loaded)
    assert plan.simulation.completion() == completion
    assert any(text.startswith("resistance:") for text in plan.skips) == (completion is None)
    formed = plan.simulation.assemble().hydrodynamics[0].model.formed_resistance
    assert (formed is None) == (completion is None)


@pytest.mark.parametrize(
    ("axis", "completion"),
    [
        ({"body.stokes_number": [0, 0.0]}, None),
        ({"body.stokes_number": [0, 1]}, "surface"),
        ({"body.aspect_ratio": [0.5, 2]}, None),
        ({"forces.force.2": [0, 1]}, "surface"),
    ],
)
def test_a_sweep_forms_what_any_of_its_bodies_needs(
    axis: dict[str, Any], completion: str | None, write_case: WriteCase
) -> None:
    scenes = Scenes(load_case(write_case(CASE | {"sweep": {"axes": [axis]}})))
    plans = [scenes.scene(n).plan for n in range(scenes.size)]
    assert {p.simulation.completion(scenes.pushed) for p in plans} == {completion}


def test_a_kept_body_with_resistance_serves_without_and_not_the_reverse(
    write_case: WriteCase, tmp_path: Path
) -> None:
    free = load_case(write_case(CASE))
    heavy = load_case(write_case(CASE | {"body": {"aspect_ratio": 0.5, "stokes_number": 1}}))

    def formed(loaded: Any, folder: str) -> Any:
        scene = make_plan(loaded).simulation
        scene.body.workshop = Workshop(cache=Cache(tmp_path / folder))
        return scene.assemble().hydrodynamics[0]

    alone, whole = formed(free, "small"), formed(heavy, "large")
    assert formed(heavy, "small").facts["cache"] == "formed"
    served = formed(free, "large")
    assert served.facts["cache"] == "found"
    assert alone.model.formed_resistance is served.model.formed_resistance is None
    for a, b in zip(alone.model.faxen.cubic, served.model.faxen.cubic, strict=True):
        assert a == b
    assert alone.model.faxen.linear == served.model.faxen.linear == whole.model.faxen.linear


def test_a_motion_without_the_resistance_is_the_same_and_free_of_force() -> None:
    short = qs.run(CASE)
    asked = qs.run(CASE | {"hydrodynamics": {"tolerance": 1e-8, "completion": "surface"}})
    assert "resistance" not in short.summary
    assert asked.summary["resistance"]["translation_axial"] > 0
    for name in ("position", "orientation", "velocity", "angular_velocity", "force", "torque"):
        assert np.array_equal(getattr(short, name), getattr(asked, name)), name
    assert not np.any(short.force)
    assert not np.any(short.torque)


def test_equations_refuse_forces_without_the_resistance() -> None:
    model = accurate_body(Spheroid(0.5), 1e-6, completion=None).model
    flow = qs.flow("shear").polynomial
    assert flow is not None
    RigidBodyEquations(model, flow)
    for given in (
        {"stokes_number": 1.0},
        {"loads": Loads(force=(0, 0, 1))},
        {"constraints": Constraints.held()},
    ):
        with pytest.raises(ValueError, match="without the resistance"):
            RigidBodyEquations(model, flow, **given)  # type: ignore[arg-type]
