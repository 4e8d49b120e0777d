"""Runs that are stopped at any instant, and go on."""

from __future__ import annotations

import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import ENVIRONMENT, Run

from qbxstokes import load
from qbxstokes.cli.main import run_command

WriteCase = Callable[..., Path]
CASE: dict[str, Any] = {
    "body": {"aspect_ratio": 0.5, "stokes_number": 2},
    "flow": {"type": "shear"},
    "start": {"orientation": {"axis": [1, 1, 1]}},
    "time": {"periods": 8, "samples": 161, "tolerance": 1e-10},
    "checkpoint": {"every": "100 steps"},
    "compare": {"reference": "none"},
    "petsc": {"ts_type": "rk"},
}


def test_a_damaged_checkpoint_is_refused(
    run_cli: Run, write_case: WriteCase, tmp_path: Path
) -> None:
    write_case(CASE | {"time": CASE["time"] | {"periods": 200}})
    stop_at_random(tmp_path, signal.SIGKILL, random.Random(3))
    last = sorted((tmp_path / "killed.h5.parts").glob("rows-*.h5"))[-1]
    whole = last.read_bytes()
    for data in (b"", b"{}", whole[: len(whole) // 2], whole[1:]):
        last.write_bytes(data)
        done = run_cli("case.yaml", "--resume", "--set", "output.file=killed.h5")
        assert done.returncode == 2
        assert "no checkpoint to go on from" in done.stderr
        assert "--overwrite" in done.stderr
        assert done.stderr.count("\n") == 1


def test_a_kill_while_the_parts_are_removed_harms_nothing(
    write_case: WriteCase, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whichever of them goes first: what is left is no run to go on with, and goes as well."""
    monkeypatch.chdir(tmp_path)
    words = [str(write_case(CASE)), "--quiet", "--resume", "--set", "output.file=a.h5"]
    folder, result = tmp_path / "a.h5.parts", tmp_path / "a.h5"
    for first in (0, 1, -1):

        def cut(folder: Path, first: int = first, **options: Any) -> None:
            sorted(folder.glob("rows-*"))[first].unlink()

        with monkeypatch.context() as patch:
            patch.setattr(shutil, "rmtree", cut)
            assert run_command(words) == 0
        assert list(folder.glob("rows-*"))
        whole = result.read_bytes()
        assert run_command(words) == 0
        assert result.read_bytes() == whole
        assert not folder.exists()
        result.unlink()


def test_a_missing_part_is_told(run_cli: Run, write_case: WriteCase, tmp_path: Path) -> None:
    write_case(CASE | {"time": CASE["time"] | {"periods": 200, "samples": 2001}})
    stop_at_random(tmp_path, signal.SIGKILL, random.Random(4))
    while len(parts := sorted((tmp_path / "killed.h5.parts").glob("rows-*.h5"))) < 2:
        stop_at_random(tmp_path, signal.SIGKILL, random.Random(5))
    parts[0].unlink()
    done = run_cli("case.yaml", "--resume", "--set", "output.file=killed.h5")
    assert done.returncode == 2
    assert "a part is missing before rows-" in done.stderr
    assert not (tmp_path / "killed.h5").exists()


def same(one: Path, other: Path) -> None:
    a, b = load(one), load(other)
    for name in b.names:
        np.testing.assert_array_equal(a[name], b[name])
    for name, values in b.groups["events"]["half_turns"].items():
        np.testing.assert_array_equal(a.groups["events"]["half_turns"][name], values)
    for name in ("integration", "events"):
        np.testing.assert_equal(a.summary[name], b.summary[name])


def start(folder: Path) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "qbxstokes", "case.yaml", "--resume", "--quiet"]
    return subprocess.Popen(
        [*command, "--set", "output.file=killed.h5"],
        cwd=folder,
        env=os.environ | ENVIRONMENT,
        stderr=subprocess.PIPE,
        text=True,
    )


def stop_at_random(folder: Path, number: int, rng: random.Random) -> str:
    """Start or go on, and send a signal some time after a new checkpoint; '' if it was done."""
    parts = folder / "killed.h5.parts"
    before = len(list(parts.glob("rows-*")))
    process = start(folder)
    while process.poll() is None:
        if len(list(parts.glob("rows-*"))) > before:
            break
        time.sleep(1e-3)
    time.sleep(rng.uniform(0.0, 0.1))
    process.send_signal(number)
    _, error = process.communicate()
    return error or ("killed" if process.returncode == -number else "")


def run_to_the_end(folder: Path, signals: list[int]) -> None:
    rng = random.Random(1)
    for number in signals:
        stop_at_random(folder, number, rng)
    process = start(folder)
    _, error = process.communicate()
    assert process.returncode == 0, error


def test_three_stops_lose_nothing(run_cli: Run, write_case: WriteCase, tmp_path: Path) -> None:
    write_case(CASE)
    done = run_cli("case.yaml", "--quiet", "--set", "output.file=whole.h5")
    assert done.returncode == 0, done.stderr
    run_to_the_end(tmp_path, [signal.SIGKILL, signal.SIGTERM, signal.SIGKILL])
    same(tmp_path / "killed.h5", tmp_path / "whole.h5")
    assert sorted(os.listdir(tmp_path)) == ["case.yaml", "killed.h5", "whole.h5"]


@pytest.mark.slow
def test_twenty_kills_lose_nothing(run_cli: Run, write_case: WriteCase, tmp_path: Path) -> None:
    write_case(CASE | {"time": CASE["time"] | {"periods": 40}})
    done = run_cli("case.yaml", "--quiet", "--set", "output.file=whole.h5")
    assert done.returncode == 0, done.stderr
    run_to_the_end(tmp_path, [signal.SIGKILL] * 20)
    same(tmp_path / "killed.h5", tmp_path / "whole.h5")


def test_an_interrupted_run_says_how_to_go_on(
    run_cli: Run, write_case: WriteCase, tmp_path: Path
) -> None:
    write_case(CASE | {"time": CASE["time"] | {"periods": 200}})
    told = stop_at_random(tmp_path, signal.SIGINT, random.Random(2))
    assert "SIGINT: stopped at t = " in told
    assert "--resume" in told
    assert len(told.splitlines()) == 1
    part = load(tmp_path / "killed.h5")
    assert not part.summary["complete"]
    assert len(part.time) == part.summary["samples"] > 0
    output = ("--set", "output.file=killed.h5")
    again = run_cli("case.yaml", *output)
    assert again.returncode == 2
    assert "an unfinished run is kept" in again.stderr
    other = run_cli("case.yaml", *output, "--resume", "--set", "body.stokes_number=3")
    assert other.returncode == 2
    assert "another body.stokes_number" in other.stderr


FIELD: dict[str, Any] = {
    "task": "field",
    "body": {"aspect_ratio": 0.5},
    "flow": {"type": "shear"},
    "checkpoint": {"every": "1e-6 s"},
    "field": {
        "plane": {"shape": [60, 50]},
        "surface": {"shape": [5, 8]},
        "streamlines": {"number": 2, "samples": 11},
        "vtk": False,
        "check": 2,
    },
}
MOVING: dict[str, Any] = {
    **{key: FIELD[key] for key in ("body", "flow", "checkpoint")},
    "start": {"orientation": {"axis": [1, 1, 1]}},
    "time": {"end": 3, "samples": 4},
    "field": {**FIELD["field"], "every": 1},
    "compare": {"reference": "none"},
}


class Stop(Exception):
    """Stands for the end of the process."""


@pytest.mark.parametrize("case", [FIELD, MOVING], ids=["field", "motion"])
def test_a_field_goes_on_piece_by_piece(
    case: dict[str, Any],
    write_case: WriteCase,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from qbxstokes.runs import field_work

    monkeypatch.chdir(tmp_path)
    path = str(write_case(case))
    assert run_command([path, "--quiet", "--set", "output.file=whole.h5"]) == 0
    work, done = field_work.FieldWork._do, [0]

    def limited(self: Any, *arguments: Any) -> Any:
        done[0] += 1
        if done[0] % 3 == 0:
            raise Stop
        return work(self, *arguments)

    with monkeypatch.context() as patch:
        patch.setattr(field_work.FieldWork, "_do", limited)
        stops = 0
        while run_command([path, "--quiet", "--resume", "--set", "output.file=a.h5"]) != 0:
            stops += 1
            assert (tmp_path / "a.h5.parts").exists()
    assert stops >= 2
    whole, again = load(tmp_path / "whole.h5"), load(tmp_path / "a.h5")
    assert done[0] < 4 * stops + 4  # nothing that was finished was done again
    for name in whole.names:
        np.testing.assert_array_equal(again[name], whole[name])
    np.testing.assert_equal(again.groups["field"], whole.groups["field"])
    assert again.summary["errors"] == whole.summary["errors"]
    assert not (tmp_path / "a.h5.parts").exists()
