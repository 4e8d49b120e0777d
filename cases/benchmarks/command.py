"""The whole command from the shell against bare imports, and a sweep on one rank and two.

    python cases/benchmarks/command.py [--small] [--csv]

2 min. `command`: medians of processes that take turns, with a warm cache. `ranks`: start-up and
set-up, which a sweep of two trajectories takes as well, are subtracted for the speed-up. Memory is
the largest resident one of a process. Expected: the first case within 1.4 times the bare imports;
two ranks with an efficiency above 0.8 where two processes do not slow each other.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

from measure import Rows, command, turns

CASES = Path(__file__).resolve().parents[1]
IMPORTS = (
    "import petsc4py, numpy, h5py; petsc4py.init(); from petsc4py import PETSc; "
    "from mpi4py import MPI"
)
SWEEP = """\
body: {{aspect_ratio: 0.5}}
flow: {{type: shear}}
time: {{periods: 20, samples: 5, tolerance: 1e-9}}
sweep: {{axes: [{{start.orientation: {{random: axes, count: {count}, seed: 1}}}}]}}
"""
# What a launcher left for this process would mislead the next one.
LAUNCHER = ("OMPI_COMM_", "OMPI_UNIVERSE", "OMPI_MCA_ess", "OMPI_MCA_orte", "PMIX_", "PMI_")
PYTHON = [sys.executable, "-m", "qbxstokes"]
QUIET = ["--overwrite", "--quiet", "--progress", "none"]


@dataclass(frozen=True)
class Process:
    """A process that has ended: wall time (s), what it printed, largest resident memory (MB)."""

    time: float
    output: str
    memory: float


def run(words: Sequence[str], folder: Path) -> Process:
    """Run a process to its end; raises RuntimeError with its complaint if it fails."""
    environment = {n: v for n, v in os.environ.items() if not n.startswith(LAUNCHER)}
    environment["QBXSTOKES_CACHE"] = str(folder / "cache")
    environment["PYTHONPATH"] = os.pathsep.join(
        filter(None, (str(CASES.parent), environment.get("PYTHONPATH")))
    )
    with tempfile.TemporaryFile("w+") as output, tempfile.TemporaryFile("w+") as told:
        begin = time.perf_counter()
        process = subprocess.Popen(words, cwd=folder, env=environment, stdout=output, stderr=told)
        _, status, usage = os.wait4(process.pid, 0)
        span = time.perf_counter() - begin
        process.returncode = os.waitstatus_to_exitcode(status)
        output.seek(0), told.seek(0)
        if process.returncode:
            raise RuntimeError(f"{' '.join(words[:6])} failed: {told.read()[:500]}")
        return Process(span, output.read(), usage.ru_maxrss / 1024.0)


def launcher(ranks: int) -> list[str]:
    """The words that start a Python on so many ranks."""
    found = shutil.which("mpirun") or shutil.which("mpiexec")
    if found is None:
        raise RuntimeError("no mpirun on this machine")
    return [found, "-n", str(ranks), sys.executable]


def starts(folder: Path, rounds: int) -> Rows:
    """The command for three Jeffery periods, and what it consists of."""
    case = str(CASES / "jeffery_prolate.yaml")
    commands = {
        "bare imports": [sys.executable, "-c", IMPORTS],
        "a run": [*PYTHON, case, *QUIET],
        "a run without cache": [*PYTHON, case, *QUIET, "--no-cache"],
        "check": [*PYTHON, "check", case],
        "--help": [*PYTHON, "--help"],
    }
    run(commands["a run"], folder)
    ended = turns({n: lambda w=words: run(w, folder) for n, words in commands.items()}, rounds)
    times = {name: median(process.time for process in ended[name]) for name in commands}
    return [
        {
            "command": name,
            "time": times[name],
            "ratio": times[name] / times["bare imports"],
            "memory": max(process.memory for process in ended[name]),
        }
        for name in commands
    ]


def ranks(folder: Path, count: int, rounds: int) -> Rows:
    """Wall time of a sweep on one and two ranks, and the part that is shared."""
    for size, stem in ((2, "few"), (count, "many")):
        (folder / f"{stem}.yaml").write_text(SWEEP.format(count=size))
    run([*PYTHON, "few.yaml", *QUIET], folder)  # fills the cache
    rows: Rows = []
    for number in (1, 2):
        words = [*launcher(number), "-m", "qbxstokes"]
        few, many = (
            [run([*words, f"{stem}.yaml", *QUIET], folder) for _ in range(rounds)]
            for stem in ("few", "many")
        )
        start, total = (median(process.time for process in ended) for ended in (few, many))
        row = {"ranks": number, "time": total, "start": start, "shared": total - start}
        speedup = rows[0]["shared"] / row["shared"] if rows else 1.0
        row |= {"speedup": speedup, "efficiency": speedup / number}
        rows.append(row | {"memory": max(process.memory for process in many)})
    return rows


def main(small: bool = False) -> dict[str, Rows]:
    """Both tables."""
    with tempfile.TemporaryDirectory() as name:
        return {
            "command": starts(Path(name), 1 if small else 5),
            "ranks": ranks(Path(name), 64 if small else 15_000, 1 if small else 3),
        }


if __name__ == "__main__":
    command(main)
