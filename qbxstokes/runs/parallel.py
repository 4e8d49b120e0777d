"""Ranks and signals: what rank 0 decides reaches all, work is handed out, one's failure ends all.

Signals that ask a run to stop, those of a batch system too: asked once, it stops when it can.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any, TypeVar

import numpy as np

from qbxstokes.errors import Interrupted, OutputError, QbxStokesError
from qbxstokes.petsc.launch import finish_asleep, starting_mpi

T = TypeVar("T")


def world() -> Any:
    """The communicator of all ranks (starts MPI)."""
    with starting_mpi():
        from mpi4py import MPI

    return MPI.COMM_WORLD


def on_root(comm: Any, action: Callable[[], T]) -> T:
    """Result of `action` on rank 0, given to all ranks; a QbxStokesError is raised on all.

    The waiting ranks sleep instead of spinning, so that they leave their cores to rank 0.
    """
    outcome: tuple[Any, QbxStokesError | None] = (None, None)
    if comm.rank == 0:
        try:
            outcome = (action(), None)
        except QbxStokesError as error:
            outcome = (None, error)
    if comm.size > 1:
        finish_asleep(comm.Ibarrier())
        outcome = comm.bcast(outcome)
    value, failure = outcome
    if failure is not None:
        failure.on_all_ranks = True
        raise failure
    return value


def agree(comm: Any, failure: QbxStokesError | None) -> None:
    """Raise on all ranks what has failed on any of them, that of the lowest; all ranks together."""
    failures = comm.allgather(failure) if comm.size > 1 else [failure]
    first = next((entry for entry in failures if entry is not None), None)
    if first is not None:
        first.on_all_ranks = True
        raise first


def guarded(comm: Any, action: Callable[[], int]) -> int:
    """Run `action` on every rank; an error that not all ranks share ends the whole job.

    An error shared by all (see `on_root`), or that of a single process, is told once and becomes
    the exit status. Any other is told with its rank, and every rank is stopped.
    """
    try:
        return action()
    except QbxStokesError as error:
        if comm.size == 1 or error.on_all_ranks:
            if comm.rank == 0:
                tell(error)
            return error.exit_status
        print(f"qbxstokes: rank {comm.rank}: {error}", file=sys.stderr, flush=True)
        status = error.exit_status
    except (Exception, KeyboardInterrupt) as error:
        if number := _stopping(error):
            name = "" if number == signal.SIGINT else f"{signal.Signals(number).name}: "
            text = f"qbxstokes: {name}interrupted; no result was written\n"
        else:
            told = petsc_message(error) or missing_message(error) or memory_message(error)
            text = f"qbxstokes: {told}\n" if told else traceback.format_exc()
            if comm.size > 1:
                text = "".join(f"rank {comm.rank}: {line}\n" for line in text.splitlines())
        status = 128 + number if number else 1
        sys.stderr.write(text)
        sys.stderr.flush()
    if comm.size > 1:
        sys.stdout.flush()
        comm.Abort(status)
        os._exit(status)
    return status


def _stopping(error: BaseException | None) -> int:
    """The signal that stopped the program; 0 if none did. What it stops may fail in consequence."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__context__
    if error is None:
        return 0
    return int(error.args[0]) if error.args else int(signal.SIGINT)


def missing_message(error: BaseException) -> str:
    """One line for a package that is not installed, '' for any other error."""
    name = getattr(error, "name", None)
    if not isinstance(error, ModuleNotFoundError) or str(name).startswith("qbxstokes"):
        return ""
    return (
        f"{name} is not installed; python -m qbxstokes doctor says what is missing and what helps"
    )


def memory_message(error: BaseException) -> str:
    """One line where memory does not suffice, '' for any other error."""
    import resource

    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    unmapped = isinstance(error, ImportError | OSError) and getattr(error, "errno", None) is None
    if unmapped and limit != resource.RLIM_INFINITY:
        return f"the limit of memory, {limit >> 20} MB (ulimit -v), is too low ({error})"
    if not isinstance(error, MemoryError):
        return ""
    return f"out of memory ({error or 'the system gives no more'}); what was finished is kept"


def tell(error: QbxStokesError) -> None:
    """The error as one line on standard error; bad input starts with its file and line."""
    prefix = "" if error.exit_status == 2 else "qbxstokes: "
    print(f"{prefix}{error}", file=sys.stderr, flush=True)


def say(text: str) -> None:
    """Print at once, to nobody where a pipe is closed; raises OutputError if it cannot be done."""
    try:
        print(text, flush=True)
    except OSError as error:
        # What is kept for a later attempt would make the interpreter complain at its end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if not isinstance(error, BrokenPipeError):
            raise OutputError(f"standard output: cannot be written ({error.strerror})") from None


def petsc_message(error: BaseException) -> str:
    """One line for an error that PETSc raised, '' for any other."""
    if type(error).__module__.partition(".")[0] != "petsc4py":
        return ""
    lines = [line.split("] ", 1)[-1].strip() for line in str(error).splitlines()]
    reasons = [line for line in lines[1:] if line and "() at " not in line]
    return f"PETSc {lines[0]}: {'; '.join(reasons) or 'no further reason given'}"


class HandOut:
    """Counters shared by all ranks, by which work is handed out as they become free.

    They lie in a window of rank 0's memory and are advanced by `MPI_Fetch_and_op`: no rank is lost
    to serving the others, and with shared memory or hardware atomics rank 0 takes no part at all.
    Where MPI needs the target's help (windows over plain messages), rank 0 gives it whenever it
    calls `poke`, which the integration does at every step. On one rank they are plain numbers.
    """

    # Places in the window: the next number; what is done, failed, and of the cost in millionths.
    NUMBERS, DONE, FAILED, SHARE = range(4)
    _PLACES = 4

    def __init__(self, comm: Any) -> None:
        self._comm = comm
        self._local = np.zeros(self._PLACES, dtype=np.int64)
        self._window: Any = None
        if comm.size > 1:
            from mpi4py import MPI

            self._mpi = MPI
            size = 8 * self._PLACES if comm.rank == 0 else 0
            self._window = MPI.Win.Allocate(size, 8, comm=comm)
            if comm.rank == 0:
                self._window.Lock(0)
                np.frombuffer(self._window, dtype=np.int64)[:] = 0
                self._window.Unlock(0)
            comm.Barrier()
            self._window.Lock_all()

    def next(self, place: int) -> int:
        """The next number of a counter, each given once over all ranks."""
        return self.add(place, 1)

    def add(self, place: int, amount: int) -> int:
        """Add to a counter; returns what it held before."""
        if self._window is None:
            before = int(self._local[place])
            self._local[place] += amount
            return before
        result = np.zeros(1, dtype=np.int64)
        given = np.array([amount], dtype=np.int64)
        operation = self._mpi.SUM if amount else self._mpi.NO_OP
        self._window.Fetch_and_op(given, result, 0, place, operation)
        self._window.Flush(0)
        return int(result[0])

    def read(self, place: int) -> int:
        """What a counter holds."""
        return self.add(place, 0)

    def poke(self) -> None:
        """Let MPI serve the other ranks."""
        if self._window is not None:
            self._comm.Iprobe()

    def wait(self) -> None:
        """Wait for all ranks."""
        if self._window is not None:
            finish_asleep(self._comm.Ibarrier())

    def close(self) -> None:
        """Free the window; all ranks together."""
        if self._window is not None:
            self._window.Unlock_all()
            self._window.Free()
            self._window = None


# -- signals ---------------------------------------------------------------------------------------

# What a person, a closing terminal, and a batch system before its limit send; those there are.
_SIGNALS = [
    getattr(signal, f"SIG{name}")
    for name in ("INT", "TERM", "HUP", "QUIT", "USR1", "USR2", "XCPU")
    if hasattr(signal, f"SIG{name}")
]


class Interruption:
    """Within it the first signal is noted, and a second one stops the process at once.

    listening: whether anybody looks at `asked`; until then the first signal stops at once, too.
    patient: the process waits for another one (rank 0), which decides. Outside the main thread,
    where Python takes no signals, nothing is noted.
    """

    def __init__(self) -> None:
        self.signal = 0
        self.listening = self.patient = False
        self._former: dict[int, Any] = {}

    def asked(self) -> bool:
        """Whether a signal has come."""
        return self.signal != 0

    @contextmanager
    def at_once(self, folder: Path) -> Iterator[None]:
        """Within it a signal stops at once what nobody looks after; the folder keeps the rest."""
        if self.signal:
            raise interrupted(folder, self.signal)
        listening, self.listening = self.listening, False
        try:
            yield
        except KeyboardInterrupt as stop:
            raise interrupted(folder, stop.args[0] if stop.args else signal.SIGINT) from None
        finally:
            self.listening = listening

    def _note(self, number: int, frame: FrameType | None) -> None:
        if self.patient:
            return
        if self.signal or not self.listening:
            raise KeyboardInterrupt(number)
        self.signal = number

    def take(self) -> None:
        """Take over the signals, once more where PETSc has taken some of them as it started."""
        if threading.current_thread() is not threading.main_thread():
            return
        for number in _SIGNALS:
            former = signal.signal(number, self._note)
            self._former.setdefault(number, former)

    def __enter__(self) -> Interruption:
        """Take over the signals."""
        self.take()
        return self

    def __exit__(self, *_: object) -> None:
        """Give them back; those whose handler Python does not know stay at their default."""
        for number, handler in self._former.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)


def interrupted(folder: Path, number: int) -> Interrupted:
    """What to tell when the signal `number` has stopped a run that keeps what is finished."""
    return Interrupted(
        f"{signal.Signals(number).name}: interrupted; what is finished is kept in {folder}: go on "
        "with --resume",
        number,
    )
