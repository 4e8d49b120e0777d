"""The whole command from the shell against the bare imports of its base libraries."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

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
ROOT = Path(__file__).resolve().parents[3]


def run(words: Sequence[str], folder: Path) -> float:
    """Wall time of a process; raises ConvergenceError with its complaint if it fails."""
    # What a launcher left for this process would mislead the next one.
    inherited = {n: v for n, v in os.environ.items() if not n.startswith(_OF_THE_LAUNCHER)}
    environment = inherited | {"QBXSTOKES_CACHE": str(folder / "cache")}
    environment["PYTHONPATH"] = os.pathsep.join(
        filter(None, (str(ROOT), environment.get("PYTHONPATH")))
    )
    begin = time.perf_counter()
    done = subprocess.run(
        words, cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    span = time.perf_counter() - begin
    if done.returncode:
        told = " ".join(done.stderr.split())
        raise ConvergenceError(f"{' '.join(words[:6])} failed: {told[:300]}")
    return span


def tables(work: Work) -> Iterator[Table]:
    """Medians of processes that take turns, so that a busy machine disturbs all alike."""
    table = Table(
        "command",
        "The whole command for three Jeffery periods, and what it consists of",
        (
            Column("command"),
            Column("time", "s", "wall time", ".3f"),
            Column("ratio", "", "over the bare imports", ".2f"),
        ),
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
                spans[name].append(run(words, folder))
    medians = {name: sorted(values)[len(values) // 2] for name, values in spans.items()}
    for name, median in medians.items():
        table.add(command=name, time=median, ratio=median / medians["bare imports"])
    yield table
