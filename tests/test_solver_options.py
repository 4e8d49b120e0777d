"""Options of PETSc: refused where they would make a run wrong, or where a case would run code."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import ENVIRONMENT

import qbxstokes as qs
from qbxstokes.case.load import case_of
from qbxstokes.errors import CaseError
from qbxstokes.petsc import session
from qbxstokes.solver_options import METHODS, given

CASE = {"body": {"aspect_ratio": 0.5}, "flow": {"type": "shear"}, "time": {"end": 3}}


@pytest.fixture
def options() -> Iterator[Any]:
    database = session.start([]).Options()
    before = set(database.getAll())
    yield database
    for name in set(database.getAll()) - before:
        database.delValue(name)


@pytest.mark.parametrize(
    "name",
    ["pc_type python", "pc_python_type x.C", "ts_type python", "ts_monitor :file", "log_view :file",
     "ksp_view binary", "options_file x", "ts_save_trajectory 1", "ksp_monitor_draw",
     "pc_type [x]y", "on_error_attach_debugger xterm", "viewer_binary_filename x", "info x"],
)  # fmt: skip
def test_a_case_runs_no_code_and_writes_no_files(name: str) -> None:
    key, _, value = name.partition(" ")
    with pytest.raises(CaseError, match="on the command line"):
        case_of({**CASE, "petsc": {key: value or None}})


@pytest.mark.parametrize(
    "name",
    ["ts_type beuler", "ts_type cn", "ts_type theta", "ts_rk_type 1fe", "ts_rk_type 4", "ts_rtol 1",
     "ts_exact_final_time stepover", "ts_max_time 1", "ts_adapt_type none", "ts_adapt_dt_min 1",
     "ts_adapt_always_accept", "ts_snes_type ksponly", "ts_rosw_type theta1", "ts_dt 1"],
)  # fmt: skip
def test_what_would_be_wrong_in_silence_is_refused(name: str, options: Any) -> None:
    key, _, value = name.partition(" ")
    with pytest.raises(CaseError, match=key):
        case_of({**CASE, "petsc": {key: value or None}})
    options.setValue(key, value or None)
    with pytest.raises(CaseError, match=key):
        qs.Simulation(qs.Body(0.5), qs.flow("shear")).integrate([0.0, 1.0])


@pytest.mark.parametrize(
    ("method", "formula"), [(m, f) for m, formulas in METHODS.items() for f in formulas or ("",)]
)
def test_methods_that_are_taken_hold_the_tolerance(method: str, formula: str, options: Any) -> None:
    options.setValue("ts_type", method)
    if formula:
        options.setValue(f"ts_{method}_type", formula)
    scene = qs.Simulation(qs.Body(0.5), qs.flow("shear"), orientation=[1, 1, 0.3], tolerance=1e-5)
    assert scene.integrate(np.linspace(0.0, 10.0, 4)).errors()["axis"] < 1e-4


def test_monitors_mean_what_they_say() -> None:
    asked = {"ts_monitor": "on", "ksp_monitor": "no", "ts_view": False, "log_view": None}
    assert given({**asked, "ksp_rtol": 1e-9}) == {
        "ts_monitor": None, "log_view": None, "ksp_rtol": "1e-09"
    }  # fmt: skip
    assert given({"ts_type": None}) == {}  # a value of a swept option: the program chooses
    assert case_of({**CASE, "petsc": {"ts_type": None}}).case.petsc == {"ts_type": None}
    with pytest.raises(CaseError, match="neither on nor off"):
        case_of({**CASE, "petsc": {"ts_monitor": "maybe"}})


def test_modules_of_the_working_folder_do_not_stand_in_for_others(tmp_path: Path) -> None:
    for name in ("json", "typing", "numpy", "yaml"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit('shadowed')")
    (tmp_path / ".petscrc").write_text("-pc_type python\n-help\n")
    found = subprocess.run(
        [sys.executable, "-m", "qbxstokes", "doctor"],
        cwd=tmp_path,
        env={**os.environ, **ENVIRONMENT, "PYTHONPATH": str(Path(qs.__file__).parents[1])},
        capture_output=True,
        text=True,
        check=False,
    )
    assert "shadowed" not in found.stdout + found.stderr
    assert "pc_type" not in found.stdout
