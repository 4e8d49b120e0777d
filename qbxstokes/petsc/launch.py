"""How MPI starts: by itself for a process that no launcher has started; and how ranks wait.

Open MPI launches a daemon for such a process, and loads the networks of the machine, so that it
might be joined by others. Half of the time that a short run takes goes into that, for nothing: one
process has nobody to talk to. Among several, a rank that waits for others lets whoever else is at
work have its core. Other implementations of MPI do not read what is set here.
"""

import ctypes
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count, takewhile
from typing import Any

# Starts of names that launchers and resource managers give to the processes they start.
_LAUNCHERS = (
    *("OMPI_COMM_WORLD_", "OMPI_UNIVERSE_", "PMI_", "PMIX_", "HYDRA_", "HYDI_", "MPIEXEC_"),
    *("MPI_LOCAL", "MPIRUN_", "MV2_COMM_WORLD_", "PALS_", "ALPS_", "SLURM_", "FLUX_", "JSM_"),
)
# Starts of names that Open MPI gives to what it keeps in the environment.
_OPEN_MPI = ("OMPI_", "ORTE_", "PMIX_", "PRTE_")
# No daemon; nothing but messages of a process to itself.
_ALONE = {"OMPI_MCA_ess_singleton_isolated": "1", "OMPI_MCA_btl": "self", "OMPI_MCA_pml": "ob1"}
_AMONG_OTHERS = {"OMPI_MCA_mpi_yield_when_idle": "1"}


def launched() -> bool:
    """Whether a launcher has started this process, alone or with others."""
    return any(name.startswith(_LAUNCHERS) for name in os.environ)


@contextmanager
def starting_mpi() -> Iterator[None]:
    """Import what starts MPI in here.

    What the user has set in the environment stands. What is set here, and what Open MPI makes of
    it, is gone afterwards: a program started by this one, `mpirun` say, does not take itself for a
    part of it.
    """
    if "mpi4py.MPI" in sys.modules or "petsc4py.PETSc" in sys.modules:
        yield
        return
    alone = not launched()
    wanted = _ALONE if alone else _AMONG_OTHERS
    added = {name: value for name, value in wanted.items() if name not in os.environ}
    os.environ.update(added)
    try:
        yield
    finally:
        for name in added:
            del os.environ[name]
        for name in _environment() - set(os.environ) if alone else ():
            if name.startswith(_OPEN_MPI):
                os.unsetenv(name)


def finish_asleep(request: Any, pause: float = 2e-3, awake: float = 0.0) -> None:
    """Wait for what ranks do together, asleep between looks: those at work have their cores.

    awake: time (s) before the first sleep.
    """
    until = time.perf_counter() + awake
    while not request.Test():
        if time.perf_counter() >= until:
            time.sleep(pause)


def _environment() -> set[str]:
    """Names in the environment of C, which is what programs inherit; none where it is hidden."""
    try:
        entries = ctypes.POINTER(ctypes.c_char_p).in_dll(ctypes.CDLL(None), "environ")
    except (OSError, ValueError):
        return set()
    listed = takewhile(lambda entry: entry is not None, (entries[i] for i in count()))
    return {os.fsdecode(entry.partition(b"=")[0]) for entry in listed if entry is not None}
