"""`python -m qbxstokes`: the command line, with one thread budget for all ranks of a node."""

import gc
import io
import os
import sys
from collections.abc import Sequence

# How launchers tell a process how many ranks share its node.
_LOCAL_RANKS = ("OMPI_COMM_WORLD_LOCAL_SIZE", "MPI_LOCALNRANKS", "SLURM_NTASKS_PER_NODE")
_THREAD_VARIABLES = (
    "OPENBLAS_NUM_THREADS",
    "OMP_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMBA_NUM_THREADS",
)
# Objects between two collections of garbage: at Python's 700, a tenth of a short run goes into
# looking through what has just been imported.
_ALLOCATIONS = 100_000


def share_threads() -> None:
    """Divide the cores among the ranks of a node, unless the user has said otherwise.

    Must run before NumPy is imported: BLAS reads these variables once.
    """
    ranks = next((os.environ[name] for name in _LOCAL_RANKS if name in os.environ), "1")
    if ranks.isdigit() and int(ranks) > 1:
        threads = max(1, len(os.sched_getaffinity(0)) // int(ranks))
        for name in _THREAD_VARIABLES:
            os.environ.setdefault(name, str(threads))


class _Remarks(io.TextIOWrapper):
    """Standard error that ends no run where nobody reads it, `2>&1 | head`, or a disk is full."""

    beneath: io.TextIOWrapper

    def write(self, text: str, /) -> int:
        try:
            return super().write(text)
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), self.fileno())
            return len(text)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    share_threads()
    gc.set_threshold(_ALLOCATIONS)
    # Pictures are drawn into files: a notebook's backend may not be there.
    os.environ.pop("MPLBACKEND", None)
    sys.stdout = sys.stdout or open(os.devnull, "w")  # noqa: SIM115 (closed: >&-)
    sys.stderr = sys.stderr or open(os.devnull, "w")  # noqa: SIM115
    if isinstance(sys.stdout, io.TextIOWrapper):  # a terminal may not know all signs
        sys.stdout.reconfigure(errors="backslashreplace")
    if isinstance(sys.stderr, io.TextIOWrapper):  # and not taken by a test
        told = sys.stderr
        remarks = _Remarks(told.buffer, told.encoding, told.errors, line_buffering=True)
        remarks.beneath = told  # it would close the buffer when it goes
        sys.stderr = remarks
    from qbxstokes.cli.main import run_command

    return run_command(sys.argv[1:] if arguments is None else arguments)


if __name__ == "__main__":
    sys.exit(main())
