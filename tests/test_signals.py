"""Signals of batch systems and terminals: every run stops in one line that says how to go on."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import ENVIRONMENT

import qbxstokes as qs
from qbxstokes.runs.parallel import guarded
from qbxstokes.runs.sharing import ALONE

SHEAR: dict[str, Any] = {
    "body": {"aspect_ratio": 0.5},
    "flow": {"type": "shear"},
    "hydrodynamics": {"tolerance": 1e-6},
    "compare": {"reference": "none"},
    "checkpoint": {"every": "1e-6 s"},
}
LONG = {"time": {"end": 1e7, "samples": 11, "tolerance": 1e-8}}
CASES = {
    "motion": SHEAR | LONG | {"start": {"orientation": {"axis": [1, 1, 1]}}},
    "sweep": SHEAR
    | LONG
    | {"sweep": {"axes": [{"start.orientation": {"random": "axes", "count": 9}}]}},
    "field": {
        "task": "field",
        **{key: SHEAR[key] for key in ("body", "flow", "checkpoint")},
        "field": {"plane": {"shape": [3000, 3000]}, "vtk": False, "pictures": False},
    },
}
FAST = {("motion", "USR1"), ("sweep", "XCPU"), ("field", "HUP")}
NAMES = ("INT", "TERM", "HUP", "QUIT", "USR1", "USR2", "XCPU")


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        pytest.param(kind, name, marks=() if (kind, name) in FAST else pytest.mark.slow)
        for kind in CASES
        for name in NAMES
    ],
)
def test_a_signal_stops_a_run_in_one_line(kind: str, name: str, tmp_path: Path) -> None:
    (tmp_path / "case.yaml").write_text(json.dumps(CASES[kind]))
    process = subprocess.Popen(
        [sys.executable, "-m", "qbxstokes", "case.yaml", "--quiet"],
        cwd=tmp_path,
        env=os.environ | ENVIRONMENT,
        stderr=subprocess.PIPE,
        text=True,
    )
    folder, deadline = tmp_path / "case.h5.parts", time.monotonic() + 60.0
    while not any(folder.glob("[!.]*-*.h5")) and time.monotonic() < deadline:
        assert process.poll() is None, process.communicate()[1]
        time.sleep(0.01)
    number = getattr(signal, f"SIG{name}")
    process.send_signal(number)
    _, told = process.communicate(timeout=30)
    assert process.returncode == 128 + number
    assert told.count("\n") == 1, told
    assert f"SIG{name}: " in told
    assert "--resume" in told
    assert not [path for path in folder.iterdir() if path.name.endswith(".part")]


def test_a_signal_before_there_is_anything_says_so(
    write_case: Callable[..., Path], run_process: Any
) -> None:
    path = write_case({**SHEAR, "time": {"end": 1.0}})
    script = (
        "import os, signal, sys\n"
        "from qbxstokes.runs.command import Job\n"
        "start = Job.start\n"
        "def started(*arguments):\n"
        "    os.kill(os.getpid(), signal.SIGHUP)\n"
        "    return start(*arguments)\n"
        "Job.start = started\n"
        "from qbxstokes.cli.main import run_command\n"
        f"sys.exit(run_command([{path.name!r}]))"
    )
    done = subprocess.run(
        [sys.executable, "-c", script],
        cwd=path.parent,
        env=os.environ | ENVIRONMENT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 129
    assert done.stderr == "qbxstokes: SIGHUP: interrupted; no result was written\n"
    assert os.listdir(path.parent) == [path.name]


def test_a_signal_stops_tracers_and_keeps_the_rest(tmp_path: Path, run_process: Any) -> None:
    field = {"points": {"file": "points.csv"}, "tracers": {"points": [[0, 1, 0]], "duration": 0.1}}
    case = {**SHEAR, "time": {"end": 1.0, "samples": 3}, "field": field}
    (tmp_path / "case.yaml").write_text(json.dumps(case))
    (tmp_path / "points.csv").write_text("x1,x2,x3\n0,2,0\n")
    script = (
        "import os, signal, sys\n"
        "from qbxstokes.runs import field\n"
        "def tracers(*_):\n"
        "    os.kill(os.getpid(), signal.SIGTERM)\n"
        "    sum(range(10**6))\n"
        "    raise AssertionError\n"
        "field.moving_tracers = tracers\n"
        "from qbxstokes.cli.main import run_command\n"
        "sys.exit(run_command(['case.yaml', '--quiet']))"
    )
    done = subprocess.run(
        [sys.executable, "-c", script],
        cwd=tmp_path,
        env=os.environ | ENVIRONMENT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 143
    assert done.stderr.startswith("qbxstokes: SIGTERM: interrupted; what is finished is kept in")
    assert run_process("case.yaml", "--resume", "--quiet").returncode == 0
    assert np.isfinite(qs.load(tmp_path / "case.h5").fields.tracers.points).all()


def test_what_fails_because_of_a_signal_is_told_as_one(capsys: pytest.CaptureFixture[str]) -> None:
    def compiling() -> int:
        try:
            raise KeyboardInterrupt(signal.SIGTERM)
        finally:
            raise RuntimeError("no compiled object yet")

    assert guarded(ALONE, compiling) == 143
    assert capsys.readouterr().err == "qbxstokes: SIGTERM: interrupted; no result was written\n"


def test_other_threads_run_cases_without_handlers() -> None:
    case = {**SHEAR, "time": {"end": 1.0, "samples": 3}}
    before = signal.getsignal(signal.SIGTERM)

    async def both() -> Any:
        return await asyncio.to_thread(qs.run, case)

    there = asyncio.run(both())
    here = qs.run(case)
    assert there.axis.tolist() == here.axis.tolist()
    swept = asyncio.run(asyncio.to_thread(qs.sweep, case, {"body.stokes_number": [0, 1]}))
    assert swept.summary["failed"] == 0
    assert signal.getsignal(signal.SIGTERM) is before


def test_bodies_stop_at_the_next_solve_and_go_on_with_the_same_numbers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bodies = [{"aspect_ratio": 1, "start": {"position": [x, y, 0]}} for x, y in ((0, 0), (3, 0.4))]
    case = {
        "bodies": bodies,
        "flow": {"type": "shear"},
        "time": {"end": 6.0, "samples": 5, "tolerance": 1e-6},
        "hydrodynamics": {"tolerance": 1e-3},
        "checkpoint": {"every": "1e-6 s"},
    }
    monkeypatch.chdir(tmp_path)
    Path("case.yaml").write_text(json.dumps(case))
    script = (
        "import os, signal, sys\n"
        "from qbxstokes.simulation.coupled import CoupledSimulation as Scene\n"
        "solved, counts = Scene.solved, []\n"
        "def noted(*arguments, **motion):\n"
        "    counts.append(1)\n"
        "    if len(counts) == 62:\n"
        "        os.kill(os.getpid(), signal.SIGINT)\n"
        "    assert len(counts) < 63\n"
        "    return solved(*arguments, **motion)\n"
        "Scene.solved = noted\n"
        "from qbxstokes.cli.main import run_command\n"
        "sys.exit(run_command(['case.yaml', '--quiet']))"
    )
    command = [sys.executable, "-c", script]
    settings: Any = {"env": os.environ | ENVIRONMENT, "capture_output": True, "text": True}
    done = subprocess.run(command, check=False, **settings)
    assert done.returncode == 130, done.stderr
    assert done.stderr.startswith("qbxstokes: SIGINT: stopped at t = ")
    assert done.stderr.count("\n") == 1
    resume = [sys.executable, "-m", "qbxstokes", "case.yaml", "--quiet", "--resume"]
    assert subprocess.run(resume, check=False, **settings).returncode == 0
    assert np.array_equal(qs.load("case.h5").position, qs.run(case).position)
