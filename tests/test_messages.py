"""What is told of a mistake that people make: what is meant, and what to write."""

from __future__ import annotations

import errno
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import Run

import qbxstokes as qs
from qbxstokes.case.load import case_of
from qbxstokes.errors import CaseError, ConvergenceError, SceneError
from qbxstokes.runs import progress
from qbxstokes.runs.progress import _tell_of_compilation

CASE = {"body": {"aspect_ratio": 0.5}, "flow": {"type": "shear"}, "time": {"end": 1.0}}


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (
            {"start": {"axis": [1, 0, 0]}},
            "start.axis: is a form of orientation; write orientation: {axis: [1, 0, 0]}",
        ),
        (
            {"body": {"aspect_ratio": {"min": 0.1, "max": 2}}},
            "body.aspect_ratio: is a mapping of keys; one number is expected, such as 0.5; several "
            "values are an axis of `sweep`",
        ),
        (
            {"body": {"k": 0.5, "aspect_ratio": 0.5}},
            "body.k: is called aspect_ratio; write aspect_ratio: 0.5",
        ),
        (
            {"body": {"shape": "ellipsoid"}},
            "body.shape: is 'ellipsoid'; write shape: {type: ellipsoid} and its numbers; types: ",
        ),
        (
            {"body": {"shape": {"type": "sphreoid", "aspect_ratio": 1}}},
            "body.shape.type: is 'sphreoid'; did you mean spheroid?",
        ),
        (
            {"orientation": [1, 0, 0]},
            "orientation: belongs to start; write start: {orientation: ...}",
        ),
        ({"flow": "swirl.py:velocity"}, "write flow: {type: user, function: swirl.py:velocity}"),
        ({"viscosity": 1}, "viscosity: belongs to units; write units: {viscosity: ...}"),
    ],
)
def test_keys_in_the_wrong_place_are_told_theirs(change: dict[str, Any], told: str) -> None:
    with pytest.raises(CaseError) as raised:
        case_of({**CASE, **change})
    assert told in str(raised.value)


@pytest.mark.parametrize("case", [None, 3, [CASE]])
def test_what_is_no_case_is_told(case: Any) -> None:
    with pytest.raises(CaseError, match="a dictionary of its keys, or the path of a case file"):
        qs.run(case)


BODY = qs.Body(0.5)
SHEAR = qs.flow("shear")


@pytest.mark.parametrize(
    ("call", "told"),
    [
        (lambda: BODY.free_motion("shear"), "flow is 'shear'; a flow such as qs.flow('shear')"),
        (lambda: BODY.field("shear", [[2, 0, 0]]), "flow is 'shear'; a flow such as"),
        (lambda: qs.rheology(BODY, "shear", [1.0]), "flow is 'shear'; a flow such as"),
        (lambda: qs.rheology(0.2, "shear", [1.0]), "body is 0.2; a body such as qs.Body(0.2)"),
        (
            lambda: qs.rheology(BODY, qs.flow("shear"), "many"),
            "peclet_number.0 'many' is not",
        ),
        (lambda: qs.Body(0.5, stokes_number=-1), "stokes_number is -1; 0 (massless) or more"),
        (lambda: qs.Body(0.5, stokes_number="x"), "stokes_number is 'x'; 0 (massless) or more"),
        (lambda: qs.Body([0.1, 0.2]), "aspect_ratio is [0.1, 0.2]; one number"),
        (lambda: BODY.free_motion(SHEAR, orientation="x"), "orientation is 'x'; an axis"),
        (lambda: BODY.free_motion(SHEAR, orientation=[0, 0, 0]), "orientation has a zero vector"),
        (lambda: BODY.integrate(SHEAR, [0, np.nan]), "times is not finite; increasing instants"),
        (lambda: BODY.integrate(SHEAR, [0, 1], loads={"force": [0, 0, 1]}), "; qs.Loads(force="),
    ],
)
def test_arguments_are_told_in_a_line(call: Callable[[], Any], told: str) -> None:
    with pytest.raises(SceneError) as raised:
        call()
    assert told in str(raised.value)
    assert "\n" not in str(raised.value)


def test_commands_are_told(run_cli: Run) -> None:
    done = run_cli("plo")
    assert (done.returncode, "did you mean plot?" in done.stderr) == (2, True)
    assert "begin with running" in run_cli("help").stdout
    assert "lists them" in run_cli("help", "nonsense").stderr


def test_new_is_short_and_in_full(run_cli: Run, tmp_path: Path) -> None:
    for task in ("motion", "field", "body", "rheology"):
        short = run_cli("new", "--task", task).stdout
        assert len(short.splitlines()) < 20
        assert max(map(len, short.splitlines())) <= 80
        run_cli("new", "--task", task, "-o", f"{task}.yaml")
        assert run_cli("check", f"{task}.yaml").returncode == 0
    assert len(run_cli("new", "--full").stdout.splitlines()) > 100


def test_a_field_out_of_reach_is_told(write_case: Callable[..., Path], run_cli: Run) -> None:
    """On standard error where it is missed, with its place where no grid will do."""
    field = {"tolerance": 1e-18, "plane": {"shape": [3, 3]}, "check": 0, "vtk": False}
    case = {"task": "field", "body": {"aspect_ratio": 0.2}, "flow": {"type": "shear"}}
    done = run_cli(write_case({**case, "field": field}).name)
    assert done.returncode == 0
    assert "field.tolerance 1e-18 is missed: the slip on a surface is" in done.stderr
    near = {"type": "stokeslet", "strength": [1, 0, 0], "position": [0, 0.25, 0.3]}
    done = run_cli(write_case({**case, "flow": near, "field": field}).name)
    assert done.returncode == 2
    assert "flow: the flow varies too much over the body" in done.stderr


def test_what_a_sweep_does_not_know_is_told(
    write_case: Callable[..., Path], run_cli: Run, tmp_path: Path
) -> None:
    """Half-turns that a short motion does not have."""
    axes = {"axes": [{"body.aspect_ratio": [0.5, 2]}]}
    path = write_case({**CASE, "time": {"end": 1.0, "samples": 11}, "sweep": axes})
    done = run_cli(path.name)
    told = "period, rotation_rate: not known of 2 of 2 trajectories: no whole half-turn of the axis"
    assert done.returncode == 0
    assert f"qbxstokes: {told}" in done.stderr
    shown = run_cli("info", "case.h5").stdout
    assert "Not known" in shown
    assert told in " ".join(shown.split())
    assert run_cli(path.name, "--quiet", "--overwrite").stderr == ""


def test_a_full_disk_is_told_and_holds_nothing_half(
    run_cli: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run_cli("new", "case.yaml")
    assert run_cli("case.yaml", "--quiet", "--set", "time={end: 1, samples: 3}").returncode == 0
    before = {path.name for path in tmp_path.iterdir()}

    def full(*_: Any) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "write", full)
    monkeypatch.setattr(Path, "write_bytes", full)
    for words in (["new", "other.yaml"], ["plot", "case.h5", "--kind", "orbit"]):
        done = run_cli(*words)
        assert done.returncode == 2
        assert done.stderr.endswith("cannot be written (No space left on device)\n")
        assert done.stderr.count("\n") == 1
    assert {path.name for path in tmp_path.iterdir()} == before
    Path(tmp_path / "folder").mkdir()
    for name in ("folder", os.devnull, "case.yaml"):
        assert "exists already" in run_cli("new", name).stderr


def test_advice_for_a_body_too_thin_turns_on_nothing_that_is_on() -> None:
    body = qs.Body(2e-5)
    with pytest.raises(ConvergenceError, match="beyond double precision"):
        _ = body.resistance


def test_compilation_is_told_once(capfd: pytest.CaptureFixture[str]) -> None:
    _tell_of_compilation.cache_clear()
    _tell_of_compilation()
    _tell_of_compilation()
    assert capfd.readouterr().err.count("compiling") == 1


def test_a_long_motion_tells_how_far_it_is(
    run_cli: Run, write_case: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(progress, "_LONG", 0.0)
    write_case(CASE | {"time": {"end": 90.0, "samples": 30001}})
    told = run_cli("case.yaml").stderr
    assert re.match(r"qbxstokes: t = [1-8][0-9.]+ of 90, [0-9]+ steps\n", told), told
    assert run_cli("case.yaml", "--progress", "none").stderr == ""
