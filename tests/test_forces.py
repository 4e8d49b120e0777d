"""Loads and constraints from the case to the motion, against closed forms."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import ROOT, Run

from qbxstokes.case.load import load_case
from qbxstokes.case.values import expression_in_time
from qbxstokes.errors import CaseError
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.simulation.arguments import timed
from qbxstokes.simulation.from_case import loads_and_constraints

WriteCase = Callable[..., Path]
CASE: dict[str, Any] = {
    "body": {"aspect_ratio": 0.5},
    "flow": {"type": "uniform", "velocity": [0, 0, 0]},
    "time": {"end": 1, "samples": 3},
}


@pytest.mark.parametrize(
    "name",
    ["settling_spheroid", "relaxation_from_rest", "held_in_paraboloid", "torque_in_shear"],
)
def test_cases_agree_with_closed_forms(name: str, run_cli: Run) -> None:
    done = run_cli(ROOT / "cases" / f"{name}.yaml", "--json")
    assert done.returncode == 0, done.stderr
    summary = json.loads(done.stdout)
    assert summary["largest_error"] < 1e-9
    if name == "settling_spheroid":
        x = summary["final_position"]
        r = summary["resistance"]
        across, along = r["translation_transverse"], r["translation_axial"]
        assert abs(x[0] / x[2]) == pytest.approx((across - along) / (across + along), rel=1e-9)


def test_expressions_are_functions_of_time() -> None:
    assert expression_in_time("2*sin(pi*t/2) - t**2")(1.0) == pytest.approx(1.0)
    for text in ("__import__('os')", "t.real", "x + 1", "sin", "[t]"):
        with pytest.raises(ValueError, match=r"not known|not an expression"):
            expression_in_time(text)


def test_tables_are_smooth_and_must_cover_the_motion(tmp_path: Path) -> None:
    times = np.linspace(0.0, 2.0, 41)
    rows = np.stack([times, np.sin(times), np.cos(times), 0 * times], axis=1)
    np.savetxt(tmp_path / "load.csv", rows, delimiter=",", header="t,1,2,3")
    vector = timed({"table": "load.csv"}, tmp_path, 2.0)
    assert callable(vector)
    np.testing.assert_allclose(vector(0.77), [np.sin(0.77), np.cos(0.77), 0.0], atol=1e-6)
    with pytest.raises(CaseError, match="covers t = 0 to 2"):
        timed({"table": "load.csv"}, tmp_path, 3.0)


def test_functions_of_the_user_are_checked(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text("def good(t): return [t, 0, 1]\ndef bad(t): return [1, 2]\n")
    vector = timed("mine.py:good", tmp_path, 1.0)
    assert callable(vector)
    np.testing.assert_array_equal(vector(2.0), [2.0, 0.0, 1.0])
    with pytest.raises(CaseError, match="three finite numbers"):
        timed("mine.py:bad", tmp_path, 1.0)


COUNTED = """\
import os
with open(os.path.join(os.path.dirname(__file__), "count"), "a") as stream:
    stream.write(f"{os.getpid()}\\n")
def flow(x): return x[:, [1, 0, 0]] * [1.0, 0.0, 0.0]
def force(t): return [0.0, 0.0, 0.1 * t]
"""
USERS = CASE | {
    "flow": {"type": "user", "function": "mine.py:flow"},
    "forces": {"force": "mine.py:force"},
    "hydrodynamics": {"tolerance": 1e-4},
    "time": {"end": 0.1, "samples": 2, "tolerance": 1e-4},
}
SWEPT = {"sweep": {"axes": [{"start.position[2]": [0, 1]}, {"body.aspect_ratio": [0.5, 0.6]}]}}


@pytest.mark.parametrize("more", [{}, SWEPT], ids=["motion", "sweep"])
def test_a_users_file_is_executed_once_in_a_run(
    more: dict[str, Any], run_cli: Run, write_case: WriteCase, tmp_path: Path
) -> None:
    write_case(COUNTED, "mine.py")
    done = run_cli(write_case(USERS | more), "--quiet")
    assert done.returncode == 0, done.stderr
    assert len((tmp_path / "count").read_text().splitlines()) == 1


@pytest.mark.mpi
def test_a_users_file_is_executed_once_on_each_rank(
    mpirun: Run, write_case: WriteCase, tmp_path: Path
) -> None:
    write_case(COUNTED, "mine.py")
    done = mpirun(2, write_case(USERS), "--quiet")
    assert done.returncode == 0, done.stderr
    ranks = (tmp_path / "count").read_text().splitlines()
    assert len(ranks) == len(set(ranks)) == 2


def test_weight_in_both_groups_is_the_same(write_case: WriteCase) -> None:
    heavy = CASE | {"body": {"aspect_ratio": 0.5, "stokes_number": 3}}
    found = []
    for gravity in ({"number": 1.8}, {"acceleration": 1, "density_ratio": 2.5}):
        loaded = load_case(write_case(heavy | {"forces": {"gravity": gravity}}))
        loads, held = loads_and_constraints(loaded, 1.0)
        assert loads is not None
        assert held is None
        found.append(loads.force)
    np.testing.assert_allclose(found[0], [0, 0, -1.8 * Spheroid(0.5).volume], rtol=1e-14)
    np.testing.assert_allclose(found[0], found[1], rtol=1e-14)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"forces": {"force": [1, 2]}}, "forces.force: has 2 entries"),
        ({"forces": {"torque": [1, "q", 0]}}, "forces.torque: 'q'"),
        ({"forces": {"gravity": {}}}, "forces.gravity: is not determined"),
        ({"forces": {"gravity": {"acceleration": 1, "density_ratio": 2}}}, "stokes_number > 0"),
        ({"constraints": {"rotation": "stuck"}}, "constraints.rotation: is 'stuck'"),
        ({"checkpoint": {"every": "often"}}, "checkpoint.every"),
        ({"events": {"stop_when_steady": True}}, "events.stop_when_steady: needs steady"),
        ({"events": {"turning_points": ["x4"]}}, "events.turning_points"),
    ],
)
def test_faults_name_their_key(
    change: dict[str, Any], expected: str, write_case: WriteCase
) -> None:
    with pytest.raises(CaseError) as caught:
        load_case(write_case(CASE | change))
    assert expected in str(caught.value)


def test_prescribed_motion_is_followed_and_its_force_recorded(
    run_cli: Run, write_case: WriteCase, tmp_path: Path
) -> None:
    from qbxstokes import load

    write_case(
        CASE
        | {
            "body": {"aspect_ratio": 0.5, "stokes_number": 1e-3},
            "constraints": {"translation": ["cos(t)", 0, 0], "rotation": "locked"},
        }
    )
    assert run_cli("case.yaml", "--quiet").returncode == 0
    result = load(tmp_path / "case.h5")
    np.testing.assert_allclose(result.position[:, 0], np.sin(result.time), atol=1e-10)
    across = result.summary["resistance"]["translation_transverse"]
    np.testing.assert_allclose(result.force[:, 0], -across * np.cos(result.time), rtol=1e-12)
