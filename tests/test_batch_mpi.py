"""Sweeps on several ranks: the same bits on any number, kills, failures of one rank."""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import h5py
import pytest

from qbxstokes.cli.main import run_command
from qbxstokes.io.names import parts_of

CASE: dict[str, Any] = {
    "checkpoint": {"every": "1e-6 s"},
    "body": {"aspect_ratio": 0.5},
    "flow": {"type": "shear"},
    "time": {"end": 5.0, "samples": 11, "tolerance": 1e-6},
    "hydrodynamics": {"tolerance": 1e-6},
    "sweep": {
        "block": 2,
        "axes": [
            {"body.stokes_number": [0, 5]},
            {"start.orientation": {"random": "rotations", "count": 8, "seed": 3}},
        ],
    },
}

pytestmark = pytest.mark.mpi


def contents(path: Path) -> dict[str, bytes]:
    """Every dataset as bytes, without the wall times and the totals of the run."""
    found = {}
    with h5py.File(path) as file:
        for name, item in file.items():
            if isinstance(item, h5py.Group):
                continue
            data = item[()]
            for column in data.dtype.names or ():
                if column != "wall_time":
                    found[f"{name}.{column}"] = data[column].tobytes()
            if data.dtype.names is None:
                found[name] = data.tobytes()
    return found


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """The undisturbed sweep on one rank, computed once."""
    folder = tmp_path_factory.mktemp("whole")
    (folder / "case.yaml").write_text(json.dumps(CASE))
    target = folder / "whole.h5"
    words = [str(folder / "case.yaml"), "--quiet", "--set", f"output.file={target}"]
    assert run_command(words) == 0
    return contents(target)


@pytest.fixture
def whole(
    undisturbed: dict[str, bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> dict[str, bytes]:
    """The undisturbed sweep, and its case in the folder of the test."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "case.yaml").write_text(json.dumps(CASE))
    return undisturbed


def test_a_dry_run_does_not_wait_for_the_other_ranks(
    mpirun: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rank 0 alone begins some blocks to see what they take."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "case.yaml").write_text(json.dumps(CASE))
    script = (
        "import sys\n"
        "from qbxstokes.cli.main import run_command\n"
        "sys.exit(run_command(sys.argv[1:]))"
    )
    told = mpirun(2, "case.yaml", "--dry-run", "--explain", script=script)
    assert told.returncode == 0, told.stderr
    assert "16 trajectories" in told.stdout
    assert "on 2 ranks" in told.stdout
    assert os.listdir(tmp_path) == ["case.yaml"]


@pytest.mark.parametrize("ranks", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_any_number_of_ranks_gives_the_same_bits(
    whole: dict[str, bytes], mpirun: Callable[..., Any], tmp_path: Path, ranks: int
) -> None:
    done = mpirun(ranks, "case.yaml", "--progress", "line")
    assert done.returncode == 0, done.stderr
    assert "16 of 16 trajectories (100.0%)" in done.stderr
    assert done.stdout.count("Result") == 1
    assert contents(tmp_path / "case.h5") == whole


# Pauses before each block, so that a signal meets the sweep at work; a rank may fail at its second.
SLOW = """
import os, sys, time
from mpi4py import MPI
from qbxstokes.runs import block
compute, count = block.compute_block, [0]
def slow(*arguments):
    count[0] += 1
    failing, rank = os.environ.get("FAILING"), str(MPI.COMM_WORLD.rank)
    if count[0] == 2 and failing == rank:
        raise ZeroDivisionError("the reactor of rank one")
    # The others leave work to the one that is to fail.
    time.sleep(0.15 if failing in (None, rank) else 1.0)
    return compute(*arguments)
block.compute_block = slow
from qbxstokes.cli.main import run_command
sys.exit(run_command(sys.argv[1:]))
"""


def test_an_exception_on_one_rank_ends_the_job_with_its_message(
    whole: dict[str, bytes],
    mpirun: Callable[..., Any],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("FAILING", "1")
    done = mpirun(2, "case.yaml", "--quiet", script=SLOW, timeout=60)
    assert done.returncode != 0
    assert "rank 1: ZeroDivisionError: the reactor of rank one" in done.stderr
    monkeypatch.delenv("FAILING")
    assert run_command(["case.yaml", "--quiet", "--resume"]) == 0  # on another number of ranks
    assert contents(tmp_path / "case.h5") == whole


# Rank 0 raises where it is told to, and says when.
BROKEN = """
import os, sys, time
from importlib import import_module
from mpi4py import MPI
where, _, kind = os.environ["BROKEN"].partition(" ")
module, _, name = where.rpartition(":")
holder, _, attribute = name.rpartition(".")
owner = import_module(module)
owner = getattr(owner, holder) if holder else owner
intact, calls = getattr(owner, attribute), [0]
def broken(*arguments, **options):
    calls[0] += 1
    if calls[0] < int(os.environ.get("CALL", "1")):
        return intact(*arguments, **options)
    print(f"at {time.time()}", flush=True)
    raise (OSError(28, "No space left on device") if kind else ZeroDivisionError("the fuse"))
if MPI.COMM_WORLD.rank == 0:
    setattr(owner, attribute, broken)
from qbxstokes.cli.main import run_command
sys.exit(run_command(sys.argv[1:]))
"""
SWEEP_FAILS = [
    "qbxstokes.io.sweep_result:_lay_out",
    "qbxstokes.io.sweep_result:_lay_out full",
    "qbxstokes.runs.sweep:todo_of",
    "qbxstokes.runs.block:compute_block",
    "qbxstokes.io.sweep_result:put_rows",
    "qbxstokes.io.store:write_part full",
    "qbxstokes.runs.sweep_blocks:Scenes.scene",
]
MOTION_FAILS = [
    "qbxstokes.simulation.formed_body:FormedBody.formed",
    "qbxstokes.io.writer:ResultWriter.append",
    "qbxstokes.io.field:create",
    "qbxstokes.io.field:put_rows",
    "qbxstokes.io.writer:ResultWriter.finish full",
    "qbxstokes.runs.field_work:FieldWork._do",
]
SOME = ("qbxstokes.io.sweep_result:put_rows", "qbxstokes.io.field:put_rows")


@pytest.mark.parametrize(
    "where",
    [
        pytest.param(where, marks=() if where in SOME else pytest.mark.slow)
        for where in SWEEP_FAILS + MOTION_FAILS
    ],
)
def test_a_failure_of_rank_0_ends_the_job_within_seconds(
    where: str, mpirun: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """None waits for ever: not for what rank 0 would have sent, nor for it to take what they do."""
    case = CASE
    if where in MOTION_FAILS:
        case = {key: CASE[key] for key in ("body", "flow", "time", "hydrodynamics")}
        case["field"] = {"plane": {"shape": [20, 20]}, "every": 5, "check": 2, "vtk": False}
    (tmp_path / "case.yaml").write_text(json.dumps(case))
    monkeypatch.setenv("BROKEN", where)
    done = mpirun(2, "case.yaml", "--quiet", script=BROKEN, timeout=90)
    failed = float(done.stdout.split("at ")[1].split()[0])
    assert done.returncode != 0
    assert time.time() - failed < 15.0
    assert ("No space left" if where.endswith("full") else "ZeroDivisionError: the fuse") in (
        done.stderr
    )


@pytest.mark.parametrize("full", ["", " full"])
def test_a_failure_in_the_middle_of_the_merge_loses_nothing(
    full: str,
    whole: dict[str, bytes],
    mpirun: Callable[..., Any],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Rank 0 fails at the third of several pieces; a resumed run computes nothing anew."""
    monkeypatch.setenv("BROKEN", SWEEP_FAILS[4] + full)
    monkeypatch.setenv("CALL", "3")
    words = ("case.yaml", "--quiet", "--set", "checkpoint.every=1e-6 s")
    done = mpirun(2, *words, script=BROKEN, timeout=90)
    assert done.returncode != 0
    assert ("No space left" if full else "the fuse") in done.stderr
    assert not (tmp_path / "case.h5").exists()
    parts = sorted(parts_of(tmp_path / "case.h5").glob("blocks-*.h5"))
    again = mpirun(2, *words, "--resume")
    assert again.returncode == 0, again.stderr
    assert len(parts) > 2
    assert contents(tmp_path / "case.h5") == whole
    assert not parts_of(tmp_path / "case.h5").exists()


def children(group: int) -> Iterator[int]:
    """Processes of a session that run Python."""
    for entry in Path("/proc").iterdir():
        if not entry.name.isdigit():
            continue
        try:
            if os.getsid(int(entry.name)) == group:
                command = (entry / "cmdline").read_bytes().split(b"\0")[0]
                if b"python" in command:
                    yield int(entry.name)
        except (OSError, ProcessLookupError):
            continue


def kill_and_resume(tmp_path: Path, kills: int, seed: int) -> None:
    """Kill a rank, or the whole job, at random instants; then let it end."""
    launcher = shutil.which("mpirun") or shutil.which("mpiexec")
    if launcher is None:
        pytest.skip("no mpirun on this machine")
    from conftest import ENVIRONMENT

    rng = random.Random(seed)
    command = [launcher, "-n", "2", sys.executable, "-c", SLOW, "case.yaml", "--resume", "--quiet"]
    kept = 0
    for number in range(kills):
        job = subprocess.Popen(
            command,
            cwd=tmp_path,
            env=os.environ | ENVIRONMENT,
            start_new_session=True,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        deadline = time.monotonic() + rng.uniform(0.5, 8.0)
        while time.monotonic() < deadline and job.poll() is None:
            folder = parts_of(tmp_path / "case.h5")
            if folder.is_dir() and len(list(folder.glob("blocks-*.h5"))) > kept:
                time.sleep(rng.uniform(0.0, 0.3))
                break
            time.sleep(0.02)
        if job.poll() is None:
            ranks = list(children(job.pid))
            if number % 2 and ranks:
                os.kill(rng.choice(ranks), signal.SIGKILL)
            else:
                os.killpg(job.pid, signal.SIGKILL)
        job.wait(timeout=30)
        for rank in children(job.pid):
            os.kill(rank, signal.SIGKILL)
        if (tmp_path / "case.h5").exists():
            return
        folder = parts_of(tmp_path / "case.h5")
        found = len(list(folder.glob("blocks-*.h5")))
        assert found >= kept  # what was finished stays finished
        kept = found


def test_killed_sweeps_lose_only_blocks_in_flight(whole: dict[str, bytes], tmp_path: Path) -> None:
    kill_and_resume(tmp_path, 2, seed=1)
    assert run_command(["case.yaml", "--quiet", "--resume"]) == 0  # on another number of ranks
    assert contents(tmp_path / "case.h5") == whole


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_twenty_random_kills(whole: dict[str, bytes], tmp_path: Path, seed: int) -> None:
    kill_and_resume(tmp_path, 5, seed)
    assert run_command(["case.yaml", "--quiet", "--resume"]) == 0  # on another number of ranks
    assert contents(tmp_path / "case.h5") == whole
