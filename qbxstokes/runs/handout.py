"""Work handed out to ranks as they become free, by a counter that all of them share.

The counter lies in a window of rank 0's memory and is advanced by `MPI_Fetch_and_op`: no rank is
lost to serving the others, and with shared memory or hardware atomics rank 0 takes no part at all.
Where MPI needs the target's help (windows over plain messages), rank 0 gives it whenever it calls
`poke`, which the integration does at every step.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from qbxstokes.runs.parallel import wait_asleep

# Places in the window.
MODELS, BLOCKS, DONE, FAILED, WORK = range(5)
_PLACES = 5


class HandOut:
    """Counters shared by all ranks; on one rank plain numbers."""

    def __init__(self, comm: Any) -> None:
        self._comm = comm
        self._local = np.zeros(_PLACES, dtype=np.int64)
        self._window: Any = None
        if comm.size > 1:
            from mpi4py import MPI

            self._mpi = MPI
            size = 8 * _PLACES if comm.rank == 0 else 0
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
            wait_asleep(self._comm)

    def close(self) -> None:
        """Free the window; all ranks together."""
        if self._window is not None:
            self._window.Unlock_all()
            self._window.Free()
            self._window = None
