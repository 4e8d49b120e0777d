"""`task: benchmark`: tables in their small extent; what is timed gives equal numbers."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from qbxstokes.__main__ import main
from qbxstokes.app import benchmark
from qbxstokes.app.benchmark import integrators
from qbxstokes.app.benchmark.batch import scipy_loop
from qbxstokes.app.benchmark.step import closed_form
from qbxstokes.app.tabulate import Work
from qbxstokes.geometry import rotation
from qbxstokes.io.results import load
from qbxstokes.io.tables import Table
from qbxstokes.plots.table import figure_of
from qbxstokes.reference import jeffery

pytestmark = pytest.mark.slow

WriteCase = Callable[..., Path]


@pytest.fixture(scope="module", autouse=True)
def petsc() -> None:
    from qbxstokes.petsc import session

    session.start([])


def small(name: str) -> dict[str, Table]:
    work = Work(SimpleNamespace(size="small", repeats=1), 1, lambda line: None)
    made = {table.name: table for table in import_module(benchmark.MAKERS[name]).tables(work)}
    for table in made.values():
        assert len(table)
        assert max(map(len, table.to_text().splitlines())) <= 80
    return made


def test_every_way_to_a_right_hand_side_is_the_closed_form() -> None:
    tables = small("step")
    assert tables["step"]["difference"].max() < 1e-10
    assert tables["step"]["ratio"][0] == 1.0
    assert tables["integrated"]["difference"].max() < 1e-14
    evaluations = tables["integrated"]["evaluations"].reshape(2, -1)
    assert np.array_equal(evaluations, evaluations[:, :1].repeat(3, axis=1))  # the same steps


def test_events_between_the_steps_leave_the_motion_and_petscs_agree() -> None:
    table = small("events")["events"]
    found, errors = table["found"].reshape(-1, 5), table["error"].reshape(-1, 5)
    assert np.array_equal(errors[:, 0], errors[:, 1])
    assert np.array_equal(found, np.outer(np.ones(len(found)), [0, 2, 2, 2, 2]))
    off = np.array([value for value in table["off_plane"] if value is not None], dtype=float)
    off = off[np.isfinite(off)].reshape(-1, 4)
    assert off.max() < 1e-5
    assert off[:, 0].max() < 1e-7  # ten times the tolerance, as the table asks


def test_the_closed_form_is_jefferys() -> None:
    for q in rotation.random_quaternions(5, np.random.default_rng(0)):
        for k in (0.2, 1.0, 4.0):
            rate = np.array(closed_form([1.0, 2.0, 3.0, *q], (1 - k * k) / (1 + k * k)))
            turn = rotation.matrix(q)
            gradient = turn.T @ np.array([[0.0, 1.0, 0.0], [0.0] * 3, [0.0] * 3]) @ turn
            spin = turn @ jeffery.free_angular_velocity(k, gradient)
            expected = 0.5 * rotation.multiply([0.0, *spin], q)
            assert np.allclose(rate, [2.0, 0.0, 0.0, *expected], atol=1e-14)


def test_integrators_keep_their_tolerance() -> None:
    made = small("integrators")
    assert list(made) == ["integrators_massless", "integrators_inertial"]
    for table in made.values():
        assert np.all(table["share"] < integrators.MARGIN)
        assert table["default"].sum() == 2  # one method of each tolerance


def test_blocks_are_as_accurate_as_the_loop_they_are_compared_with() -> None:
    table = small("batch")["batch"]
    assert table["error"].max() < 1e-6
    assert table["ratio"][0] == 1.0
    q = rotation.random_quaternions(2, np.random.default_rng(0))
    starts = np.concatenate([np.zeros((2, 3)), q], axis=1)
    axes, evaluations, steps = scipy_loop(starts, jeffery.period(0.5), 1e-10)
    assert np.allclose(axes, rotation.axis(q), atol=1e-8)
    assert evaluations > 12 * steps > 100


@pytest.mark.parametrize("name", ["command", "field", "scaling", "iterations", "setup"])
def test_the_other_tables_are_made(name: str) -> None:
    for table in small(name).values():
        assert "passed" not in table.names or table["passed"].all()


@pytest.mark.mpi
@pytest.mark.slow
def test_one_rank_and_two(monkeypatch: pytest.MonkeyPatch) -> None:
    from conftest import ENVIRONMENT

    for key, value in ENVIRONMENT.items():
        monkeypatch.setenv(key, value)
    table = small("ranks")["ranks"]
    if "Not measured" not in " ".join(table.notes):
        assert table["ranks"].tolist() == [1, 2]


def test_a_case_stores_prints_and_draws(
    write_case: WriteCase,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    section = {"tables": ["integrators"], "size": "small", "repeats": 1, "figures": True}
    case = write_case({"task": "benchmark", "benchmark": section}, "bench.yaml")
    assert main([str(case), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["failures"] == []
    table = load(tmp_path / "bench.h5").tables["integrators_massless"]
    assert table["error"].tolist() == [row["error"] for row in told["tables"][0]["rows"]]
    assert set(table.provenance) == {"machine", "command", "version"}
    assert (tmp_path / "bench_integrators_massless.pdf").read_bytes().startswith(b"%PDF")
    text = (tmp_path / "bench_integrators_massless.csv").read_text()
    rows = list(csv.reader(line for line in text.splitlines() if not line.startswith("#")))
    assert rows[0] == table.names
    assert len(rows) == 1 + len(table)
    figure_of(table)
    assert main([str(case), "--explain", "--dry-run"]) == 0
    assert "integrators" in capsys.readouterr().out
