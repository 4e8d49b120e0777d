"""The whole command from the shell against the bare imports of its base libraries."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING

from qbxstokes.app.benchmark.timing import largest_memory
from qbxstokes.errors import ConvergenceError
from qbxstokes.io.tables import Column, Table

if TYPE_CHECKING:
    from qbxstokes.app.tabulate import Work

IMPORTS = (
    "import petsc4py, numpy, h5py; petsc4py.init(); from petsc4py import PETSc; "
    "from mpi4py import MPI"
)
# What cases/jeffery_prolate.yaml holds, without its comments.
CASE = """\
body: {aspect_ratio: 0.5}
flow: {type: shear}
start: {orientation: {euler: {phi: 30 deg, theta: 60 deg, psi: 0}}}
time: {periods: 3, samples: 301, tolerance: 1e-12}
hydrodynamics: {tolerance: 1e-12}
"""
_OF_THE_LAUNCHER = ("OMPI_COMM_", "OMPI_UNIVERSE", "OMPI_MCA_ess", "OMPI_MCA_orte", "PMIX_", "PMI_")
_LOOK = 0.005  # s between two looks at the memory of a process
ROOT = Path(__file__).resolve().parents[3]


@dataclass(frozen=True)
class Process:
    """A process that has ended: wall time (s) and what it printed.

    memory: the largest that it or a process below it held (MB), where Linux told it.
    """

    time: float
    output: str
    memory: float | None = None


def run(words: Sequence[str], folder: Path, watched: bool = False) -> Process:
    """Run a process to its end; raises ConvergenceError with its complaint if it fails.

    watched: look at its memory, which disturbs the timing.
    """
    # What a launcher left for this process would mislead the next one.
    inherited = {n: v for n, v in os.environ.items() if not n.startswith(_OF_THE_LAUNCHER)}
    environment = inherited | {"QBXSTOKES_CACHE": str(folder / "cache")}
    environment["PYTHONPATH"] = os.pathsep.join(
        filter(None, (str(ROOT), environment.get("PYTHONPATH")))
    )
    memory = 0.0
    with tempfile.TemporaryFile("w+") as output, tempfile.TemporaryFile("w+") as told:
        begin = time.perf_counter()
        process = subprocess.Popen(words, cwd=folder, env=environment, stdout=output, stderr=told)
        while watched and process.poll() is None:
            memory = max(memory, *(largest_memory(pid) or 0.0 for pid in family(process.pid)))
            time.sleep(_LOOK)
        process.wait()
        span = time.perf_counter() - begin
        for stream in (output, told):
            stream.seek(0)
        if process.returncode:
            complaint = " ".join(told.read().split())
            raise ConvergenceError(f"{' '.join(words[:6])} failed: {complaint[:300]}")
        return Process(span, output.read(), memory or None)


def family(pid: int) -> Iterator[int]:
    """A process and all below it."""
    yield pid
    try:
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    except OSError:  # it has ended, or the system does not tell
        return
    for child in children:
        yield from family(int(child))


def tables(work: Work) -> Iterator[Table]:
    """Medians of processes that take turns, so that a busy machine disturbs all alike."""
    table = Table(
        "command",
        "The whole command for three Jeffery periods, and what it consists of",
        (
            Column("command"),
            Column("time", "s", "wall time", ".3f"),
            Column("ratio", "", "over the bare imports", ".2f"),
            Column("memory", "MB", "largest resident memory", ".0f"),
        ),
        plot={"x": "command", "y": "time"},
        notes=["With a warm cache of the hydrodynamics; the first run on a machine forms them."],
    )
    if work.ranks > 1:
        table.notes.append("Not measured within a parallel run.")
        yield table
        return
    python = sys.executable
    run_case = [python, "-m", "qbxstokes", "case.yaml", "--overwrite", "--quiet"]
    commands = {
        "bare imports": [python, "-c", IMPORTS],
        "a run": run_case,
        "a run without cache": [*run_case, "--no-cache"],
        "check": [python, "-m", "qbxstokes", "check", "case.yaml"],
        "--help": [python, "-m", "qbxstokes", "--help"],
    }
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "case.yaml").write_text(CASE)
        run(run_case, folder)
        spans: dict[str, list[float]] = {name: [] for name in commands}
        for turn in range(work.choose(1, max(5, work.section.repeats))):
            work.say(f"command, turn {turn + 1}")
            for name, words in commands.items():
                spans[name].append(run(words, folder).time)
        memory = {name: run(words, folder, watched=True).memory for name, words in commands.items()}
    base = median(spans["bare imports"])
    for name, times in spans.items():
        table.add(command=name, time=median(times), ratio=median(times) / base, memory=memory[name])
    yield table
