"""Long motions: invariants, memory, and Stokes numbers of any size."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import ROOT, Run

WriteCase = Callable[..., Path]
CASE: dict[str, Any] = {
    "body": {"aspect_ratio": 0.5},
    "flow": {"type": "shear"},
    "start": {"orientation": {"axis": [1, 1, 1]}},
    "time": {"periods": 1, "samples": 5, "tolerance": 1e-8},
    "compare": {"reference": "none"},
}


def run(run_cli: Run, *arguments: Any) -> dict[str, Any]:
    done = run_cli(*arguments, "--json", "--overwrite")
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


@pytest.mark.parametrize("k", [0.02, 50])
def test_extreme_shapes_keep_their_orbit(k: float, run_cli: Run) -> None:
    case = ROOT / "cases" / "slender_and_flat.yaml"
    summary = run(run_cli, case, "--set", f"body.aspect_ratio={k}")
    assert summary["events"]["counts"]["half_turns"] == 6
    assert summary["errors"]["period"] < 1e-8


def test_a_stokeslet_that_is_met_ends_the_run(run_cli: Run) -> None:
    case = ROOT / "cases" / "meeting_a_stokeslet.yaml"
    done = run_cli(case, "--json", "--set", "compare.tolerance=1e-9")
    assert done.returncode == 0, done.stderr
    assert "1e-09 is held against nothing: no closed form for the motion in this" in done.stderr
    assert "ended at t = 3.61" in done.stderr
    summary = json.loads(done.stdout)
    assert summary["events"]["ended_by"] == "clearance"
    assert summary["final_position"][0] == pytest.approx(-1.5, abs=1e-8)


def test_small_stokes_numbers_converge_to_none_at_first_order(
    run_cli: Run, write_case: WriteCase
) -> None:
    write_case(CASE)
    ends = {}
    for stokes in (0, 1e-3, 1e-4):
        summary = run(run_cli, "case.yaml", "--set", f"body.stokes_number={stokes}")
        ends[stokes] = np.array(summary["final_axis"])
    far, near = (np.linalg.norm(ends[stokes] - ends[0]) for stokes in (1e-3, 1e-4))
    assert np.log10(far / near) == pytest.approx(1.0, abs=0.05)


@pytest.mark.slow
def test_ten_thousand_periods(run_cli: Run) -> None:
    summary = run(run_cli, ROOT / "cases" / "long_run.yaml")
    assert summary["events"]["counts"]["half_turns"] == 20_000
    assert summary["orbit_constant_drift"] < 1e-7
    assert summary["integration"]["quaternion_norm_drift"] < 1e-12
