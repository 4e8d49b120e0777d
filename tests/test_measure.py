"""Bodies without a motion, measured sweeps, and what is drawn of both."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import Run

import qbxstokes as qs
from qbxstokes.bie.exact import true_error
from qbxstokes.case.load import load_case
from qbxstokes.errors import CaseError, ConvergenceError
from qbxstokes.quantities import BODY
from qbxstokes.runs.body import plan_body

WriteCase = Callable[..., Path]

BARE: dict[str, Any] = {
    "task": "body",
    "body": {"aspect_ratio": 0.5},
    "hydrodynamics": {"tolerance": 1e-8},
}
PLACE = {"position": [0.0, 1.0, 0.0], "orientation": {"axis": [1.0, 0.0, 1.0]}}
FLOWS = {
    "linear": {"type": "shear", "rate": 2.0},
    "quadratic": {"type": "paraboloid", "curvature": 0.3},
    "singular": {"type": "stokeslet", "strength": [1.0, 0.5, 0.0], "position": [0.0, 4.0, 0.0]},
}
EVERY_STEP = {"hydrodynamics": {"tolerance": 1e-8, "solve": "every_step"}}


def refused(case: dict[str, Any], write: WriteCase) -> str:
    with pytest.raises(CaseError) as caught:
        load_case(write(case))
    return str(caught.value)


# -- a body ----------------------------------------------------------------------------------------


def test_a_body_says_what_python_says() -> None:
    result, body = qs.run(BARE), qs.Body(0.5, tolerance=1e-8)
    assert result.task == "body"
    assert sorted(result.names) == ["cubic", "linear", "mobility", "quadratic", "resistance"]
    np.testing.assert_array_equal(result.resistance, body.resistance)
    np.testing.assert_array_equal(result.mobility, body.mobility)
    law = body.model.faxen
    assert result.linear == law.linear
    np.testing.assert_array_equal(result.quadratic, law.quadratic)
    np.testing.assert_array_equal(result.cubic, law.cubic)
    hydro, summary = result.summary["hydrodynamics"], result.summary
    assert hydro["error_estimate"] == body.error_estimate
    assert hydro["error_parts"] == vars(body.model.error_parts)
    assert summary["errors"] == {"law": true_error(body.model)}
    assert summary["largest_error"] < hydro["error_estimate"] < 1e-8
    assert hydro["solves"] == 4
    assert hydro["iterations"] >= 4
    assert hydro["true_residual"] < 1e-9
    assert summary["setup_time"] > 0.0
    assert summary["nodes"] == hydro["n_theta"] * hydro["n_phi"]
    for name in result.names:
        assert result.attributes[name]["units"] == BODY[name].units


@pytest.mark.parametrize(
    ("flow", "change"), [*((name, {}) for name in FLOWS), ("quadratic", EVERY_STEP)]
)
def test_a_body_in_a_flow_moves_or_is_held(flow: str, change: dict[str, Any]) -> None:
    result = qs.run({**BARE, "flow": FLOWS[flow], "start": PLACE, **change})
    background = qs.flow(**FLOWS[flow])
    body = qs.Body(0.5, tolerance=1e-8, hydrodynamics=change.get("hydrodynamics"))
    place, axis = PLACE["position"], PLACE["orientation"]["axis"]
    u, omega = body.free_motion(background, place, axis)
    force, torque = body.force_torque(background, place, axis)
    same = np.testing.assert_allclose if change else np.testing.assert_array_equal
    for name, values in (
        ("free_velocity", u),
        ("free_angular_velocity", omega),
        ("held_force", force),
        ("held_torque", torque),
    ):
        # The operators of each step have no resistance in them where no force is asked for.
        same(result[name], values, **({"atol": 1e-12} if change else {}))
        assert result.summary["errors"][name] < 1e-8


def test_the_flow_decides_what_the_law_is_for(write_case: WriteCase) -> None:
    known = {"linear": "degree <= 1", "quadratic": "degree <= 2", "singular": "any flow"}
    for name, words in known.items():
        assert words in plan_body(load_case(write_case(BARE | {"flow": FLOWS[name]}))).needs[0]
    assert "degree <= 3" in plan_body(load_case(write_case(BARE))).needs[0]


def test_commands_behave_as_for_a_motion(
    run_cli: Run, write_case: WriteCase, tmp_path: Path
) -> None:
    write_case(BARE | {"flow": FLOWS["quadratic"], "start": PLACE})
    done = run_cli("case.yaml", "--dry-run")
    assert done.returncode == 0
    assert "force and torque on the held one" in done.stdout
    assert "nothing is integrated" in done.stdout
    assert json.loads(run_cli("case.yaml", "--dry-run", "--json").stdout)["plan"]["needs"]
    assert [path.name for path in tmp_path.iterdir()] == ["case.yaml"]
    done = run_cli("case.yaml", "--explain")
    assert done.returncode == 0, done.stderr
    for word in ("Plan", "GMRES", "held force", "free velocity", "Errors", "case.h5"):
        assert word in done.stdout
    assert max(map(len, done.stdout.splitlines())) <= 80
    told = run_cli("info", "case.h5").stdout
    assert "held_force 3" in told
    assert "[mu c^2/tau]" in told
    assert run_cli("case.yaml", "--quiet", "--overwrite").stdout == ""
    facts = json.loads(run_cli("case.yaml", "--json", "--overwrite").stdout)
    assert facts["held_force"] == qs.load(tmp_path / "case.h5").held_force.tolist()
    assert run_cli("check", "case.yaml").stdout == "case.yaml: valid, task body\n"


def test_an_error_above_the_limit_is_told(run_cli: Run, write_case: WriteCase) -> None:
    write_case(BARE | {"compare": {"tolerance": 1e-30}})
    done = run_cli("case.yaml", "--quiet")
    assert done.returncode == ConvergenceError.exit_status
    assert "exceeds compare.tolerance 1e-30" in done.stderr
    write_case(BARE | {"compare": {"reference": "none", "tolerance": 1e-30}})
    assert run_cli("case.yaml", "--quiet").returncode == 0


@pytest.mark.parametrize(
    ("change", "wrong"),
    [
        ({"time": {"end": 1}}, "time: has no meaning for task: body"),
        ({"forces": {"force": [1, 0, 0]}}, "forces: has no meaning for task: body"),
        ({"start": PLACE}, "start: has no meaning without a flow"),
        (EVERY_STEP, "hydrodynamics.solve: has no meaning without a flow"),
        ({"body": {"aspect_ratio": 1, "stokes_number": 1}}, "body.stokes_number: has no meaning"),
        ({"hydrodynamics": {"cache": "x"}}, "hydrodynamics.cache: has no meaning"),
        ({"flow": {"rate": 1}}, "flow.type: is missing"),
        ({"flow": {"type": "sheer"}}, "did you mean 'shear'"),
        ({"task": "motion", "time": {"end": 1}}, "flow: is missing"),
    ],
)
def test_what_has_no_meaning_is_refused(
    change: dict[str, Any], wrong: str, write_case: WriteCase
) -> None:
    assert wrong in refused(BARE | change, write_case)
