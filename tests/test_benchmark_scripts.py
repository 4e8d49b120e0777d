"""The benchmarks of cases/benchmarks, small: what is timed gives equal numbers, bounds hold."""

from __future__ import annotations

import csv
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import ENVIRONMENT, ROOT, Run, script

import qbxstokes as qs
from qbxstokes.geometry import rotation
from qbxstokes.reference import jeffery

FOLDER = ROOT / "cases" / "benchmarks"
SCRIPTS = sorted(path.stem for path in FOLDER.glob("*.py") if path.stem != "measure")
Rows = list[dict[str, Any]]


def column(rows: Rows, name: str) -> np.ndarray:
    return np.array([row[name] for row in rows])


def small(name: str) -> dict[str, Rows]:
    tables: dict[str, Rows] = script(f"benchmarks/{name}").main(small=True)
    assert all(rows and len({tuple(row) for row in rows}) == 1 for rows in tables.values())
    return tables


@pytest.mark.slow
def test_bodies() -> None:
    (row,) = [row for row in small("bodies")["solved"] if row["what"].endswith("error")]
    assert row["met"]


def test_setup() -> None:
    axes = {"body.aspect_ratio": [0.1, 2.0], "hydrodynamics.tolerance": [1e-4, 1e-10]}
    table = qs.sweep(
        {"task": "body", "body": {"aspect_ratio": 1}}, axes, measure={"repeats": 1}
    ).table
    assert np.all(table["error"] <= table["hydrodynamics_tolerance"])
    assert np.all(table["setup_time"] > 0.0)


def test_thinness() -> None:
    axes = {"body.aspect_ratio": [1e-3, 0.01, 1.0, 50.0, 1e3]}
    table = qs.sweep({"task": "body", "body": {"aspect_ratio": 1}}, axes).table
    assert np.all(table["error_estimate"] >= 0.5 * table["error"])


def test_every_way_to_a_right_hand_side_is_the_closed_form() -> None:
    tables = small("step")
    assert column(tables["step"], "difference").max() < 1e-10
    assert tables["step"][0]["ratio"] == 1.0
    assert column(tables["integrated"], "difference").max() < 1e-14
    evaluations = column(tables["integrated"], "right_hand_sides").reshape(2, -1)
    assert np.array_equal(evaluations, evaluations[:, :1].repeat(3, axis=1))  # the same steps


def test_the_closed_form_is_jefferys() -> None:
    closed_form = script("benchmarks/step").closed_form
    for q in rotation.random_quaternions(5, np.random.default_rng(0)):
        for k in (0.2, 1.0, 4.0):
            rate = np.array(closed_form([1.0, 2.0, 3.0, *q], (1 - k * k) / (1 + k * k)))
            turn = rotation.matrix(q)
            gradient = turn.T @ np.array([[0.0, 1.0, 0.0], [0.0] * 3, [0.0] * 3]) @ turn
            spin = turn @ jeffery.free_angular_velocity(k, gradient)
            expected = 0.5 * rotation.multiply([0.0, *spin], q)
            assert np.allclose(rate, [2.0, 0.0, 0.0, *expected], atol=1e-14)


def test_blocks_are_as_accurate_as_the_loop_they_are_compared_with() -> None:
    rows = small("batch")["batch"]
    assert column(rows, "error").max() < 1e-6
    assert rows[0]["ratio"] == 1.0
    q = rotation.random_quaternions(2, np.random.default_rng(0))
    starts = np.concatenate([np.zeros((2, 3)), q], axis=1)
    scipy_loop = script("benchmarks/batch").scipy_loop
    axes, evaluations = scipy_loop(starts, jeffery.period(0.5), 1e-10)
    assert np.allclose(axes, rotation.axis(q), atol=1e-8)
    assert evaluations > 100


def test_field() -> None:
    tables = small("field")
    assert [row["upsampling"] for row in tables["field_costs"]] == [None, 1]


@pytest.mark.parametrize("name", sorted(path.name for path in FOLDER.glob("*.yaml")))
def test_cases_say_what_they_are(name: str, run_cli: Run) -> None:
    text = (FOLDER / name).read_text()
    assert text.startswith("# yaml-language-server: $schema=../../qbxstokes/case/case.schema.json")
    for word in ("# Shows:", "# Source:", "# Run:", "# Expected:"):
        assert word in text
    done = run_cli(FOLDER / name, "--dry-run")
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_series() -> None:
    tables = small("series")
    assert all(row["error"] is None or row["error"] < 1e-6 for row in tables["series"])
    assert np.all(column(tables["ensemble"], "us") > 0.0)


@pytest.mark.slow
def test_functions() -> None:
    tables = small("functions")
    assert np.all(column(tables["functions"], "each of many_us") > 0.0)


@pytest.mark.parametrize("name", SCRIPTS)
def test_scripts_say_what_they_are(name: str) -> None:
    text = (FOLDER / f"{name}.py").read_text()
    head = text.split('"""')[1]
    assert f"\nRun:      python cases/benchmarks/{name}.py      (" in head
    assert "\nExpected: " in head


def test_a_script_prints_and_writes_its_tables(tmp_path: Path) -> None:
    words = [sys.executable, str(FOLDER / "batch.py"), "--small", "--csv"]
    done = subprocess.run(
        words,
        cwd=tmp_path,
        env=os.environ | ENVIRONMENT,
        capture_output=True,
        text=True,
        check=True,
    )
    with (tmp_path / "batch.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) > 2
    assert list(rows[0])[:3] == ["method", "bodies", "error"]
    assert done.stdout.split()[:3] == ["batch", "method", "bodies"]
