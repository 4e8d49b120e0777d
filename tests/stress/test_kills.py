"""Runs that are killed at random instants, on one rank and two, and go on: the same bits.

    KILLS=50 SEED=3 pytest -m "" tests/stress/test_kills.py

KILLS are shared among the kinds of runs (default: one of each). A kill is SIGKILL to one rank or
to all, at any instant from the start of the program on, that of the merge and of the start
included. A run that ends before it is killed is compared and begun again. EVERY names the intervals
of checkpoints, in seconds, for which what a kill loses is measured (default: 1; `EVERY=1,3,30`).
PATHS=100000 follows so many (default: 500; 3.6 GB in HDF5, made here and deleted; 10 min).
"""

from __future__ import annotations

import contextlib
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
import numpy as np
import pytest
from conftest import ENVIRONMENT, See

from qbxstokes.io.names import parts_of

pytestmark = [pytest.mark.slow, pytest.mark.mpi]
SEED = int(os.environ.get("SEED", "1"))
OFTEN = {"every": "1e-6 s"}
SHEAR: dict[str, Any] = {"body": {"aspect_ratio": 0.5}, "flow": {"type": "shear"}}
BODY = SHEAR | {"hydrodynamics": {"tolerance": 1e-6}, "compare": {"reference": "none"}}
START = {"start": {"orientation": {"axis": [1, 1, 1]}}}
FIELD = {
    "plane": {"shape": [60, 60], "extent": [-2, 2, -2, 2]},
    "surface": {"shape": [5, 8]},
    "streamlines": {"number": 2, "samples": 21},
    "vtk": True,
    "check": 1,
}
MOTION = {
    **START,
    "body": {"aspect_ratio": 0.5, "stokes_number": 2},
    "time": {"periods": 10, "samples": 101},
    "petsc": {"ts_type": "rk"},
}
SWEEP = {
    "time": {"end": 200.0, "samples": 31, "tolerance": 1e-8},
    "checkpoint": OFTEN,
    "sweep": {
        "block": 4,
        "axes": [
            {"start.orientation": {"random": "rotations", "count": 8, "seed": 3}},
            {"body.stokes_number": [0, 5]},
        ],
    },
}
ENSEMBLE: dict[str, Any] = {
    "body": {"aspect_ratio": 0.2},
    "flow": {
        "type": "linear",
        "gradient": {"process": "gaussian", "paths": 6_000, "end": 4.0, "spacing": 0.05},
    },
    "time": {"end": 4.0, "tolerance": 1e-6},
    "sweep": {"store": "statistics", "axes": [{"flow.trajectory": "all"}]},
}
KINDS: dict[str, tuple[int, dict[str, Any]]] = {
    "motion": (1, BODY | MOTION | {"checkpoint": {"every": "100 steps"}}),
    "motion by the clock": (1, BODY | MOTION | {"checkpoint": OFTEN}),
    "motion with a field": (
        2,
        {**BODY, **START, "time": {"end": 4, "samples": 3}, "field": FIELD | {"every": 1}}
        | {"checkpoint": OFTEN},
    ),
    "sweep": (2, BODY | SWEEP),
    "sweep shown": (2, BODY | SWEEP | {"output": {"merge": False}}),
    "ensemble": (2, ENSEMBLE | {"checkpoint": OFTEN}),
    "field": (1, {"task": "field", **SHEAR, "field": FIELD, "checkpoint": OFTEN}),
    "field on two": (2, {"task": "field", **SHEAR, "field": FIELD, "checkpoint": OFTEN}),
}
KILLS = -(-int(os.environ.get("KILLS", len(KINDS))) // len(KINDS))
PATHS = int(os.environ.get("PATHS", "500"))
EVERY = [float(number) for number in os.environ.get("EVERY", "1").split(",")]


# Runs a command and prints the memory (kB) of the largest of its processes: of a child of this one,
# which is large, the system tells no less than its own.
_MEASURED = """
import resource, subprocess, sys
done = subprocess.call(sys.argv[1:])
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
sys.exit(done)
"""


def start(folder: Path, ranks: int, *words: str, within: Any = ()) -> subprocess.Popen[str]:
    """The program, at its work or on its way there. within: command that runs it."""
    launcher = [shutil.which("mpirun") or "mpiexec", "-n", str(ranks)] if ranks > 1 else []
    return subprocess.Popen(
        [*within, *launcher, sys.executable, "-m", "qbxstokes", "case.yaml", "--quiet", *words],
        cwd=folder,
        env=os.environ | ENVIRONMENT,
        start_new_session=True,
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE if within else subprocess.DEVNULL,
        text=True,
    )


def members(session: int) -> Iterator[int]:
    """Processes of a session that run Python."""
    for entry in Path("/proc").iterdir():
        try:
            if not entry.name.isdigit() or os.getsid(int(entry.name)) != session:
                continue
            if b"python" in (entry / "cmdline").read_bytes().split(b"\0")[0]:
                yield int(entry.name)
        except OSError:
            continue


def kill(job: subprocess.Popen[str], rng: random.Random) -> None:
    """SIGKILL to all of it, or to one rank, whose launcher ends the others."""
    ranks = list(members(job.pid))
    if len(ranks) > 1 and rng.random() < 0.5:
        os.kill(rng.choice(ranks), signal.SIGKILL)
    else:
        with contextlib.suppress(ProcessLookupError):  # it has ended by itself
            os.killpg(job.pid, signal.SIGKILL)
    with contextlib.suppress(subprocess.TimeoutExpired):
        job.wait(10)
    if job.poll() is None:  # a launcher may wait for ever for a rank that died before MPI began
        os.killpg(job.pid, signal.SIGKILL)
        job.wait(10)
    for _ in range(30):  # a rank that was being started becomes Python a little later
        for rank in members(job.pid):
            os.kill(rank, signal.SIGKILL)
        with contextlib.suppress(subprocess.TimeoutExpired):
            job.communicate(timeout=1)
            return
    raise TimeoutError("the ranks of a job that was killed do not end")


def contents(path: Path) -> dict[str, bytes]:
    """Every dataset as bytes, but for what tells of the run itself."""
    found: dict[str, bytes] = {}

    def take(name: str, item: Any) -> None:
        if not isinstance(item, h5py.Dataset) or name.split("/")[0] in (
            "provenance",
            "summary",
            "parts",
        ):
            return
        data = item[()]
        for column in data.dtype.names or ():
            if column != "wall_time":
                found[f"{name}.{column}"] = data[column].tobytes()
        if data.dtype.names is None:
            found[name] = np.asarray(data).tobytes()

    with h5py.File(path) as file:
        file.visititems(take)
    return found


@pytest.mark.parametrize("kind", KINDS)
def test_killed_runs_give_the_same_bits(kind: str, tmp_path: Path) -> None:
    ranks, case = KINDS[kind]
    rng = random.Random(f"{kind} {SEED}")
    (tmp_path / "case.yaml").write_text(json.dumps(case))
    begin = time.monotonic()
    job = start(tmp_path, ranks, "--set", "output.file=whole.h5")
    _, told = job.communicate()
    assert job.returncode == 0, told
    span = time.monotonic() - begin
    whole = contents(tmp_path / "whole.h5")
    files = {path.name for path in tmp_path.iterdir()}
    kills = ended = 0
    while kills < KILLS or not ended:
        last = kills >= KILLS
        job = start(tmp_path, ranks, "--resume")
        try:
            _, told = job.communicate(timeout=None if last else rng.uniform(0.0, 1.1 * span))
        except subprocess.TimeoutExpired:
            kill(job, rng)
            kills += 1
            continue
        assert job.returncode == 0, told
        ended += 1
        assert contents(tmp_path / "case.h5") == whole
        shown = {"case.h5.parts", "whole.h5.parts"} if kind == "sweep shown" else set()
        left = {path.name for path in tmp_path.iterdir()} - files - shown
        assert left <= {"case.h5", "case.vtkhdf"}, left
        (tmp_path / "case.h5").unlink()
        shutil.rmtree(parts_of(tmp_path / "case.h5"), ignore_errors=True)
    print(f"{kind}: {kills} kills, {ended} times ended, {span:.1f} s undisturbed")


@pytest.mark.parametrize("kind", ["motion by the clock", "sweep", "field on two"])
@pytest.mark.parametrize("every", EVERY)
def test_what_is_lost_is_what_was_asked_for(
    kind: str, every: float, tmp_path: Path, see: See
) -> None:
    """The age of what is safe, seen every 20 ms from the first part on: never much over `every`."""
    ranks, case = KINDS[kind]
    case, longer = case | {"checkpoint": {"every": f"{every} s"}}, max(1.0, every / 3.0)
    if kind == "field on two":
        # Of many harmonics: the disk is not what is looked at.
        flow = {"type": "stokeslet", "strength": [0, 1, 0], "position": [0, 1.2, 0]}
        plane = {"shape": [2000, int(4000 * longer)], "extent": [-2, 2, -2, 1.1]}
        case |= {"flow": flow, "field": FIELD | {"plane": plane, "vtk": False}}
    else:
        case |= {"time": case["time"] | {"samples": 1001}}
        case["time"].pop("periods", None)
        case["time"]["end"] = longer * (20_000.0 if ranks == 1 else 26_000.0)
    if ranks == 1:
        case |= {"petsc": {"ts_type": "rk", "ts_rk_type": "5dp"}}
    (tmp_path / "case.yaml").write_text(json.dumps(case))
    job = start(tmp_path, ranks)
    folder, oldest, until = parts_of(tmp_path / "case.h5"), 0.0, None
    while job.poll() is None and (until is None or time.time() < until):
        time.sleep(0.02)
        safe: dict[str, float] = {}  # of every rank the latest
        for path in [*folder.glob("[!.]*-*.h5")]:
            rank = path.name.split("-")[2] if path.name.count("-") > 2 else path.name
            with_time = safe.get(rank, 0.0)
            try:
                safe[rank] = max(with_time, path.stat().st_mtime)
            except FileNotFoundError:
                continue
        if safe and until is None:
            until = time.time() + 6 * every
        if safe:
            oldest = max(oldest, time.time() - max(safe.values()))
    ran = job.poll() is None
    kill(job, random.Random(0))
    assert ran, "it ended too early to tell"
    see(oldest, 1.5 * every + 0.5, f"{kind}, every {every} s")


def make_paths(file: Path, samples: int, end: float) -> None:
    """Gradients of five cosines along each path, [time, trajectory], 256 paths at a time."""
    times, rng = np.linspace(0.0, end, samples), np.random.default_rng(1)
    frequency = np.array([0.4, 0.9, 1.5, 2.3, 3.1])
    with h5py.File(file, "w") as out:
        out["t"] = times
        data = out.create_dataset("A", (PATHS, samples, 9), np.float32)
        for first in range(0, PATHS, 256):
            n = min(256, PATHS - first)
            phase = rng.uniform(0.0, 2.0 * np.pi, (n, 1, 5))
            waves = np.cos(times[:, None] * frequency + phase).astype(np.float32)
            amplitude = 0.3 * rng.normal(size=(n, 5, 9))
            amplitude[..., 8] = -amplitude[..., 0] - amplitude[..., 4]
            data[first : first + n] = waves @ amplitude.astype(np.float32)


def test_many_paths(tmp_path: Path, record_property: Callable[[str, object], None]) -> None:
    """The same bits on one rank to three and after a kill; what a rank holds of them is bounded."""
    samples, end = 1001, 20.0
    make_paths(tmp_path / "paths.h5", samples, end)
    case = {
        "body": {"aspect_ratio": 0.2},
        "flow": {"type": "linear", "gradient": {"file": "paths.h5"}},
        "time": {"end": end, "tolerance": 1e-6},
        "statistics": {"quantities": ["tumbling"], "keep": 64, "every": 10},
        "checkpoint": {"every": "2 s"},
        "sweep": {"axes": [{"flow.trajectory": "all"}], "store": "statistics"},
    }
    (tmp_path / "case.yaml").write_text(json.dumps(case))
    first, told, spans = {}, "", []
    start(
        tmp_path, 1, "--set", "output.file=once.h5"
    ).communicate()  # may compile, which takes memory
    for ranks, killed in ((2, False), (1, False), (3, True)):
        result = tmp_path / f"{ranks}{'_killed' * killed}.h5"
        words = ["--set", f"output.file={result.name}"]
        if killed:
            job = start(tmp_path, ranks, *words)
            time.sleep(0.5 * spans[0])
            kill(job, random.Random(0))
            words.append("--resume")
        begin = time.monotonic()
        job = start(tmp_path, ranks, *words, within=(sys.executable, "-c", _MEASURED))
        memory = int(job.communicate()[0]) >> 10
        spans.append(time.monotonic() - begin)
        first = first or contents(result)
        assert (job.returncode, contents(result) == first) == (0, True)
        assert memory < 300
        span, size = 1e6 * spans[-1] * ranks / (PATHS * samples), result.stat().st_size / 1e6
        told += f"{ranks}{' killed' * killed}: {span:.2g} us, {memory} MB, {size:.2g} MB; "
    record_property("worst", f"ranks: time of a path and sample, memory of a rank, result: {told}")
