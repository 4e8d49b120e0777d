"""The whole command from the shell against the bare imports of its base libraries.

Medians of processes that take turns, with a warm cache; memory (MB) is the largest resident one.

Run:      python cases/benchmarks/command.py      (1 min; --small: 5 s; --csv)
Expected: the first case within 1.4 times the bare imports.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from statistics import median

from measure import Rows, command, turns

ROOT = Path(__file__).resolve().parents[2]
IMPORTS = (
    "import petsc4py, numpy, h5py; petsc4py.init(); from petsc4py import PETSc; "
    "from mpi4py import MPI"
)
# What a launcher left for this process would mislead the next one.
LAUNCHER = ("OMPI_COMM_", "OMPI_UNIVERSE", "OMPI_MCA_ess", "OMPI_MCA_orte", "PMIX_", "PMI_")


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
        filter(None, (str(ROOT), environment.get("PYTHONPATH")))
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


def main(small: bool = False) -> dict[str, Rows]:
    """The command for three Jeffery periods, and what it consists of."""
    case = str(ROOT / "cases" / "jeffery_prolate.yaml")
    program = [sys.executable, "-m", "qbxstokes"]
    first = [*program, case, "--overwrite", "--quiet"]
    commands = {
        "bare imports": [sys.executable, "-c", IMPORTS],
        "a run": first,
        "a run without cache": [*first, "--no-cache"],
        "check": [*program, "check", case],
        "--help": [*program, "--help"],
    }
    with tempfile.TemporaryDirectory() as name:
        actions = {n: partial(run, words, Path(name)) for n, words in commands.items()}
        actions["a run"]()
        ended = turns(actions, 1 if small else 5)
    rows: Rows = []
    for name, processes in ended.items():
        span = median(process.time for process in processes)
        ratio = span / rows[0]["time"] if rows else 1.0
        memory = max(process.memory for process in processes)
        rows.append({"command": name, "time": span, "ratio": ratio, "memory": memory})
    return {"command": rows}


if __name__ == "__main__":
    command(main)
