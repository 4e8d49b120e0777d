"""How a motion ends that cannot go on, is stopped early, or is finished already."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import Run

from qbxstokes import load
from qbxstokes.bie.accuracy import accurate_body
from qbxstokes.bie.resolution import flow_error
from qbxstokes.geometry.spheroid import Spheroid

WriteCase = Callable[..., Path]
FLOWS = """\
import os, signal
import numpy as np

def stream(x):
    u = np.zeros_like(x)
    u[:, 0] = 1.0 + 0.1 * x[:, 1]
    return u

def pole(x, t):
    return stream(x) / (3.0 - t)

def nowhere(x):
    return np.where(x[:, :1] > 1.0, np.nan, stream(x))

def endless(x):
    return np.where(x[:, :1] > 1.0, np.inf, stream(x))

def raising(x):
    if x[:, 0].max() > 1.0:
        raise RuntimeError("no data here")
    return stream(x)

def other_shape(x):
    return stream(x)[int(x[:, 0].max() > 1.0):]

def stopping(x, t, asked=[]):
    if t > 0.0 and not asked:  # a second signal would not wait for the step
        asked.append(t)
        os.kill(os.getpid(), signal.SIGINT)
    return stream(x)
"""
CASE: dict[str, Any] = {
    "body": {"aspect_ratio": 0.5},
    "start": {"position": [-6, 0, 0]},
    "time": {"end": 20, "samples": 41, "tolerance": 1e-6},
}


def user_case(name: str, **body: Any) -> dict[str, Any]:
    flow = {"type": "user", "function": f"flows.py:{name}"}
    return CASE | {"flow": flow, "body": CASE["body"] | body}


@pytest.fixture
def flows(tmp_path: Path) -> None:
    (tmp_path / "flows.py").write_text(FLOWS)


@pytest.mark.usefixtures("flows")
@pytest.mark.parametrize("stokes_number", [0, 1])
@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("pole", "the rates of change grow without bound"),
        ("nowhere", "the rates of change have no finite value further on"),
        ("endless", "the rates of change have no finite value further on"),
        ("raising", "flows.py:raising raised RuntimeError: no data here"),
        ("other_shape", "flows.py:other_shape must return a real array of the shape of its points"),
    ],
)
def test_a_flow_that_ends_ends_the_run_in_one_line(
    name: str, told: str, stokes_number: float, run_cli: Run, write_case: WriteCase, tmp_path: Path
) -> None:
    write_case(user_case(name, stokes_number=stokes_number))
    done = run_cli("case.yaml", "--quiet")
    assert done.returncode == 1, done.stderr
    assert len(done.stderr.splitlines()) == 1
    for part in ("stopped at t = ", "body at (", told, "case.h5 holds the motion so far"):
        assert part in done.stderr
    result = load(tmp_path / "case.h5")
    assert not result.summary["complete"]
    assert told in result.summary["failure"]
    last = float(result.time[-1])
    if name == "pole":
        assert last == pytest.approx(3.0, abs=1e-9)
    else:  # the tip of the body, which lies along the flow, is where there is no value
        assert result.position[-1, 0] > 0.0
        assert np.isfinite(result.position).all()
    assert not (tmp_path / "case.h5.parts").exists()


@pytest.mark.usefixtures("flows")
def test_a_run_stopped_within_its_first_steps_leaves_nothing(
    run_process: Run, write_case: WriteCase, tmp_path: Path
) -> None:
    case = user_case("stopping")
    case["flow"]["recognise"] = False  # which would ask at t > 0 before the run
    write_case(case)
    done = run_process("case.yaml", "--quiet")
    assert done.returncode == 130, done.stderr
    assert "no result was written, start again" in done.stderr
    assert sorted(path.name for path in tmp_path.glob("case*")) == ["case.yaml"]


def test_a_finished_motion_is_not_computed_again(
    run_cli: Run, write_case: WriteCase, tmp_path: Path
) -> None:
    write_case({**CASE, "flow": {"type": "shear"}, "time": {"end": 1, "samples": 3}})
    assert run_cli("case.yaml", "--quiet", "--resume").returncode == 0
    made = (tmp_path / "case.h5").stat().st_mtime_ns
    again = run_cli("case.yaml", "--resume", "--set", "title=another title")
    assert again.returncode == 0, again.stderr
    assert again.stdout == "case.h5: finished already, nothing to resume\n"
    told = run_cli("case.yaml", "--resume", "--json")
    assert json.loads(told.stdout) == {"result": "case.h5", "finished_before": True}
    other = run_cli("case.yaml", "--resume", "--set", "time.end=2")
    assert other.returncode == 2
    assert "case.h5: is the result of a run with another time.end" in other.stderr
    assert (tmp_path / "case.h5").stat().st_mtime_ns == made
    assert sorted(path.name for path in tmp_path.glob("case*")) == ["case.h5", "case.yaml"]


def test_a_uniform_stream_turns_nothing_on_any_grid() -> None:
    functional = accurate_body(Spheroid(0.5), 1e-10).functional
    stream = np.array([0.3, -0.4, 0.5])
    assert flow_error(functional, lambda x: np.broadcast_to(stream, x.shape), 6, 8) < 1e-12
