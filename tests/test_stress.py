"""`task: stress`: the tables in their small extent keep their bounds; a broken one is told."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from qbxstokes.__main__ import main
from qbxstokes.app import stress
from qbxstokes.app.stress.checks import Checks
from qbxstokes.app.tabulate import Work, failed_rows
from qbxstokes.io.results import load
from qbxstokes.io.tables import Column, Table

pytestmark = pytest.mark.slow

WriteCase = Callable[..., Path]


@pytest.fixture(scope="module", autouse=True)
def petsc() -> None:
    from qbxstokes.petsc import session

    session.start([])


def small(name: str) -> list[Table]:
    work = Work(SimpleNamespace(size="small", seed=0, repeats=1), 1, lambda line: None)
    return list(import_module(stress.MAKERS[name]).tables(work))


@pytest.mark.parametrize("name", [name for name in stress.MAKERS if name != "invariances"])
def test_bounds_hold_in_the_small_extent(name: str) -> None:
    for table in small(name):
        assert len(table)
        assert table.names.count("passed") == 1
        assert list(failed_rows(table)) == []
        assert max(map(len, table.to_text().splitlines())) <= 80


def broken(work: Work) -> Iterator[Table]:
    """A table whose second check fails, and whose third is not a number."""
    checks = Checks("broken", "Broken", (Column("what"),), "value")
    checks.see("good", value=1e-12, bound=1e-10)
    checks.see("bad", value=1e-12, bound=1e-10)
    checks.see("bad", value=3.0, bound=1e-10, at="k = 7")
    checks.see("bad", value=1e-11, bound=1e-10)
    checks.see("nan", value=math.nan, bound=1.0)
    checks.see("nan", value=0.0, bound=1.0)
    yield checks.table()


def raising(work: Work) -> Iterator[Table]:
    """A maker with a fault of its own."""
    raise RuntimeError("no way")


def test_a_bound_that_is_exceeded_makes_the_run_fail_and_is_named(
    write_case: WriteCase,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(
        stress, "MAKERS", {"broken": __name__, "torque_free": stress.MAKERS["torque_free"]}
    )
    monkeypatch.setitem(globals(), "tables", broken)
    case = write_case({"task": "stress", "stress": {"size": "small"}})
    assert main([str(case), "--progress", "none"]) == 1
    told = capsys.readouterr()
    lines = told.err.splitlines()
    assert len(lines) == 2
    assert "what bad, worst 3.0e+00, bound 1e-10, at k = 7" in lines[0]
    assert "what nan" in lines[1]
    assert "passed" in told.out
    result = load(tmp_path / "case.h5")
    # The other table was made and everything is kept.
    assert list(result.tables) == ["broken", "torque_free", "worst_cases"]
    assert result.tables["broken"]["passed"].tolist() == [True, False, False]
    worst = result.tables["worst_cases"]
    assert worst["passed"].tolist() == [False, True]
    assert worst["checks"].tolist() == [3, len(result.tables["torque_free"])]
    assert np.isinf(worst["worst"][0])
    assert worst["met"][0] == "what nan"
    assert (tmp_path / "case_torque_free.csv").exists()


def test_a_maker_that_breaks_does_not_take_the_others_along(
    write_case: WriteCase,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(
        stress, "MAKERS", {"raising": __name__, "torque_free": stress.MAKERS["torque_free"]}
    )
    monkeypatch.setitem(globals(), "tables", raising)
    case = write_case({"task": "stress", "stress": {"size": "small", "csv": False}})
    assert main([str(case), "--quiet"]) == 1
    assert "stress raising: RuntimeError: no way" in capsys.readouterr().err
    assert list(load(tmp_path / "case.h5").tables) == ["torque_free"]


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"stress": {"tables": ["pole"]}}, r"stress.tables\[0\]: 'pole' is not a table"),
        ({"stress": {"tables": ["long_run"]}}, "did you mean long_runs"),
        ({"stress": {"tables": []}}, "stress.tables"),
        ({"stress": {"size": "huge"}}, "one of small, full"),
        ({"body": {"aspect_ratio": 2}}, "body: has no meaning for task: stress"),
        ({"benchmark": {}}, "benchmark: has no meaning for task: stress"),
        ({"task": "motion", "stress": {}}, "stress: has no meaning for task: motion"),
    ],
)
def test_what_has_no_meaning_is_refused(
    change: dict[str, Any],
    expected: str,
    write_case: WriteCase,
    capsys: pytest.CaptureFixture[str],
) -> None:
    import re

    case = write_case({"task": "stress"} | change)
    assert main(["check", str(case)]) == 2
    assert re.search(expected, capsys.readouterr().err)
