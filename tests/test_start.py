"""How a process starts: MPI without its daemon for one process, untouched for what is launched."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

import pytest
from conftest import ENVIRONMENT, ROOT, Run

from qbxstokes.petsc import launch

Told = Callable[..., str]

# Names of the programs that run below this process.
DAEMONS = """
import os, pathlib
below = pathlib.Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()
daemons = [pathlib.Path(f"/proc/{pid}/comm").read_text().strip() for pid in below]
"""


@pytest.fixture
def told() -> Told:
    """Output of a fresh interpreter, in this environment without what launchers put there."""

    def run(code: str, **more: str) -> str:
        plain = {
            name: value
            for name, value in (os.environ | ENVIRONMENT).items()
            if not name.startswith((*launch._LAUNCHERS, *launch._ALONE))
        }
        done = subprocess.run(
            [sys.executable, "-c", code],
            env=plain | more,
            capture_output=True,
            text=True,
            check=False,
            timeout=120,
        )
        assert done.returncode == 0, done.stderr
        return done.stdout.strip()

    return run


@pytest.mark.parametrize(
    "start",
    [
        "from qbxstokes.runs.parallel import world; world()",
        "from qbxstokes.petsc import session; session.start()",
        "import qbxstokes as qs; qs.Suspension([qs.Body(1)], tolerance=0.1).free(None, [0, 0, 0])",
    ],
)
def test_a_single_process_starts_no_daemon_and_leaves_no_trace(told: Told, start: str) -> None:
    code = f"""
before = dict(__import__("os").environ)
{start}
{DAEMONS}
assert dict(os.environ) == before
import subprocess
names = subprocess.run("env", capture_output=True, text=True).stdout
left = [n for n in names.splitlines() if n.startswith(("OMPI_", "PMIX_", "ORTE_"))]
print(daemons, sorted(n.partition("=")[0] for n in left) == sorted(
    n for n in before if n.startswith("OMPI_")))
"""
    assert told(code) == "[] True"


def test_the_users_own_settings_stand(told: Told) -> None:
    code = """
import os
from qbxstokes.petsc.launch import starting_mpi
with starting_mpi():
    print(*(os.environ["OMPI_MCA_" + n] for n in ("btl", "pml", "ess_singleton_isolated")))
print("OMPI_MCA_btl" in os.environ, "OMPI_MCA_pml" in os.environ)
"""
    assert told(code, OMPI_MCA_btl="tcp,self").split() == ["tcp,self", "ob1", "1", "True", "False"]


@pytest.mark.parametrize(
    "name", ["OMPI_COMM_WORLD_SIZE", "PMI_RANK", "PMIX_RANK", "SLURM_PROCID", "MPI_LOCALNRANKS"]
)
def test_what_a_launcher_has_started_is_left_alone(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for known in [n for n in os.environ if n.startswith(launch._LAUNCHERS)]:
        monkeypatch.delenv(known)
    assert not launch.launched()
    monkeypatch.setenv(name, "0")
    assert launch.launched()
    with launch.starting_mpi():
        assert "OMPI_MCA_ess_singleton_isolated" not in os.environ


def test_what_the_program_asks_of_mpi_works_in_a_process_of_its_own(told: Told) -> None:
    """A window that is fetched from and added to, and a barrier that is not waited for."""
    code = """
import numpy as np
from qbxstokes.runs.parallel import on_root, world
comm = world()
from mpi4py import MPI
window = MPI.Win.Allocate(40, 8, comm=comm)
window.Lock_all()
found, one = np.zeros(1, np.int64), np.ones(1, np.int64)
np.frombuffer(window, dtype=np.int64)[:] = 5
for _ in range(2):
    window.Fetch_and_op(one, found, 0, 1, MPI.SUM)
    window.Flush(0)
window.Unlock_all()
window.Free()
arrived = comm.Ibarrier()
while not arrived.Test():
    pass
print(comm.size, found[0], comm.allgather("all"), on_root(comm, lambda: 3))
"""
    assert told(code) == "1 6 ['all'] 3"


@pytest.mark.mpi
def test_a_script_that_has_run_a_case_can_launch_others(told: Told, tmp_path: object) -> None:
    code = """
import subprocess, sys
import qbxstokes as qs
case = {"body": {"aspect_ratio": 0.5}, "flow": {"type": "shear"}, "time": {"end": 1}}
qs.run(case)
ranks = "from qbxstokes.runs.parallel import world; c = world(); print(*[c.size][c.rank:], end='')"
for command in ([], ["mpirun", "-n", "2"], ["mpirun", "-n", "1"]):
    done = subprocess.run([*command, sys.executable, "-c", ranks], capture_output=True, text=True)
    print(done.stdout)
"""
    assert told(code).split() == ["1", "2", "1"]


@pytest.mark.mpi
@pytest.mark.parametrize("ranks", [1, 2])
def test_ranks_of_a_launcher_have_mpi_as_it_is(mpirun: Run, ranks: int) -> None:
    script = """
import os
from qbxstokes.petsc.launch import launched
from qbxstokes.runs.parallel import world
comm = world()
found = comm.gather((launched(), "OMPI_MCA_pml" in os.environ))
if comm.rank == 0:
    print(found)
"""
    done = mpirun(ranks, script=script)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == str([(True, False)] * ranks)


@pytest.mark.slow
def test_the_whole_command_over_its_bare_imports(
    tmp_path: Path, record_property: Callable[[str, object], None]
) -> None:
    """Three Jeffery periods; medians of processes that take turns, with a warm cache (TURNS=5).

    Within 1.4 times the imports where nothing else runs; twice, where something does.
    """
    imports = "import petsc4py, numpy, h5py; petsc4py.init(); from petsc4py import PETSc; "
    program, case = [sys.executable, "-m", "qbxstokes"], str(ROOT / "cases/jeffery_prolate.yaml")
    first = [*program, case, "--overwrite", "--quiet"]
    commands = {
        "bare imports": [sys.executable, "-c", f"{imports} from mpi4py import MPI"],
        "a run": first,
        "a run without cache": [*first, "--no-cache"],
        "check": [*program, "check", case],
        "--help": [*program, "--help"],
    }
    own = os.environ | ENVIRONMENT | {"QBXSTOKES_CACHE": str(tmp_path / "cache")}
    spans: dict[str, list[float]] = {name: [] for name in commands}
    for turn in range(-1, int(os.environ.get("TURNS", 1))):
        for name, words in commands.items():
            begin = time.perf_counter()
            subprocess.run(words, cwd=tmp_path, env=own, stdout=subprocess.PIPE, check=True)
            spans[name] += [time.perf_counter() - begin] if turn >= 0 else []
    bare = median(spans["bare imports"])
    for name, span in spans.items():
        record_property("worst", f"{name}: {median(span):.2f} s, {median(span) / bare:.2f}")
    assert median(spans["a run"]) < 2.0 * bare
