"""The whole command from the shell against the bare imports of its base libraries.

Medians of processes that take turns, with a warm cache.

Run:      python cases/benchmarks/command.py      (1 min; --small: 5 s; --csv)
Expected: the first case within 1.4 times the bare imports.
"""

import os
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path
from statistics import median

from measure import command, turns

ROOT = Path(__file__).resolve().parents[2]
IMPORTS = (
    "import petsc4py, numpy, h5py; petsc4py.init(); from petsc4py import PETSc; "
    "from mpi4py import MPI"
)


def run(words, folder):
    """Wall time (s) and output of a process; raises CalledProcessError where it fails."""
    paths = [str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]
    own = {"QBXSTOKES_CACHE": str(folder / "cache"), "PYTHONPATH": os.pathsep.join(paths)}
    begin = time.perf_counter()
    done = subprocess.run(
        words, cwd=folder, env=os.environ | own, stdout=subprocess.PIPE, text=True, check=True
    )
    return time.perf_counter() - begin, done.stdout


@command
def main(small=False):
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
    rows = []
    for name, processes in ended.items():
        span = median(span for span, _ in processes)
        rows.append(
            {"command": name, "time": span, "ratio": span / (rows or [{"time": span}])[0]["time"]}
        )
    return {"command": rows}
