"""Work that ranks share: its numbers on their way to them, its results on their way to rank 0.

Every rank takes the next number as it becomes free. What it computes does not depend on who it is.
A rank keeps what it has finished until `every` seconds have passed or it is much, and then makes it
safe as one part of the working folder: a thousand ranks make thousands of files, not millions. What
is left at the end goes to rank 0 by a message.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from qbxstokes.case.load import LoadedCase
from qbxstokes.errors import ResultFileError
from qbxstokes.io.store import DamagedPart, Work, read_part
from qbxstokes.runs.parallel import HandOut, interrupted
from qbxstokes.runs.progress import Progress
from qbxstokes.typing import AnyArray

if TYPE_CHECKING:
    from qbxstokes.runs.command import Job

Item = tuple[dict[str, AnyArray], dict[str, Any]]

# Bytes that are kept in memory at most.
MOST = 128 * 2**20
_TAG = 77


class Gathering:
    """What one rank has finished: items of arrays with a note.

    kind: of the parts. joined: whether items are rows of the same arrays, which a part holds
    together. every: seconds between two parts, most: bytes kept in memory.
    """

    def __init__(
        self,
        comm: Any,
        work: Work,
        kind: str,
        joined: bool = False,
        every: float = 30.0,
        most: int = MOST,
    ) -> None:
        self.comm, self.work, self._kind, self._joined = comm, work, kind, joined
        self.every, self._most = every, most
        self._items: list[Item] = []
        self._bytes, self.saved_at = 0, time.monotonic()
        self._waiting = [] if comm.rank else list(range(1, comm.size))

    @cached_property
    def _messages(self) -> Any:
        """The communicator with messages that hold arrays as they are, not copies of them."""
        from mpi4py.util import pkl5

        return pkl5.Intracomm(self.comm)

    def add(self, arrays: Mapping[str, AnyArray], note: Mapping[str, Any]) -> None:
        """Take a finished item."""
        self._items.append((dict(arrays), dict(note)))
        self._bytes += sum(values.nbytes for values in arrays.values())
        if self._bytes > self._most or self.late():
            self.save()

    def late(self, ahead: float = 0.0) -> bool:
        """Whether something is to be made safe, were the next chance so many seconds ahead."""
        return time.monotonic() + ahead - self.saved_at >= self.every

    def save(self) -> None:
        """Make what there is safe; raises OutputError."""
        held, told = [arrays for arrays, _ in self._items], [note for _, note in self._items]
        if self._joined and held:
            rows = {name: [part[name] for part in held] for name in held[0]}
            self.work.save(self._kind, rows, {"items": told})
        elif held:
            self.work.save(self._kind, {}, {"items": told, "held": held})
        self._items, self._bytes = [], 0
        self.saved_at = time.monotonic()

    def collect(self) -> Iterator[Item]:
        """On rank 0 all that is finished, part by part; the other ranks hand over what they hold.

        Raises ResultFileError for a part that is damaged: it is removed, and a resumed run does its
        work again.
        """
        if self.comm.rank:
            self._messages.send(self._items, dest=0, tag=_TAG)
            return
        for path in self.work.parts(self._kind):
            rows, note = read_whole(path)
            yield from [(rows, note)] if rows else zip(note["held"], note["items"], strict=True)
        while self._items:
            yield self._items.pop(0)
        while self._waiting:
            yield from self._messages.recv(source=self._waiting.pop(0), tag=_TAG)

    def drain(self) -> None:
        """Take from the other ranks what nobody wants, so that none of them waits for ever."""
        while self._waiting:
            self._messages.recv(source=self._waiting.pop(0), tag=_TAG)


class Crew:
    """The ranks at work on numbered pieces, whose results are gathered.

    total: how many of what `unit` names there are, for the progress that rank 0 tells; 0: none is
    told. before: how many of them earlier runs have done.
    """

    def __init__(
        self, job: Job, gathering: Gathering, total: int = 0, unit: str = "", before: int = 0
    ) -> None:
        comm, style = gathering.comm, job.options.progress
        self.gathering, self.counters = gathering, HandOut(comm)
        self._total, self._before = total, before
        self._interruption, self._clock = job.interruption, job.clock
        told = total and comm.rank == 0 and not job.options.quiet
        self._progress = Progress(total, style, comm.size, unit, before) if told else None

    def numbers(self, count: int) -> Iterator[int]:
        """Numbers below the count for this rank; raises Interrupted as `stop_if_asked`."""
        while (number := self.counters.next(HandOut.NUMBERS)) < count:
            self.stop_if_asked()
            yield number

    def poke(self) -> bool:
        """Between steps: serve MPI, tell the progress; whether a signal asks to stop."""
        if self._progress is None or not self._progress.due:
            self.counters.poke()
        else:
            read = self.counters.read
            done, share = self._before + read(HandOut.DONE), 1e-6 * read(HandOut.SHARE)
            self._progress.update(min(done, self._total), read(HandOut.FAILED), share)
        return self._interruption.asked()

    def stop_if_asked(self) -> None:
        """Raise Interrupted where a signal has asked for it, after what there is was made safe."""
        if self._interruption.asked():
            self.gathering.save()
            raise interrupted(self.gathering.work.folder, self._interruption.signal)

    def end(self) -> int:
        """Wait for all ranks, once none of them has work; how many pieces have failed."""
        with self._clock.part("waiting"):
            self.counters.wait()
        done, failed = self.counters.read(HandOut.DONE), self.counters.read(HandOut.FAILED)
        if self._progress is not None:
            self._progress.close(min(self._before + done, self._total), failed)
        self.counters.wait()
        self.counters.close()
        return failed


class Keeper:
    """Keeps the state of a block in work on disk, so that a run that is killed loses little."""

    def __init__(self, gathering: Gathering, name: str, only: list[int]) -> None:
        self._gathering, self._name, self._only = gathering, name, only

    def late(self, ahead: float) -> bool:
        """Whether the state is to be saved now, the next chance being so many seconds ahead."""
        return self._gathering.late(ahead)

    def save(self, state: Mapping[str, Any]) -> None:
        """Make the state safe, and whatever else this rank has finished."""
        self._gathering.save()
        self._gathering.work.save_state(self._name, {**state, "only": self._only})

    def load(self) -> dict[str, Any] | None:
        """The state that an earlier run has left of this block, None without one."""
        found = self._gathering.work.state(self._name)
        return found if found is not None and found["only"] == self._only else None


def read_whole(path: Path, names: Sequence[str] | None = None) -> Item:
    """Arrays (those of the names, or all) and note of a part; removes it if it is damaged.

    Raises ResultFileError then.
    """
    try:
        return read_part(path, names)
    except (DamagedPart, OSError) as error:
        path.unlink(missing_ok=True)
        raise ResultFileError(f"{error}; its work is lost, and done again with --resume") from None


def seconds_between(loaded: LoadedCase) -> float:
    """How often a rank makes safe what it has: the section `checkpoint`, in seconds here."""
    interval = loaded.case.checkpoint.interval
    if interval.unit != "seconds":
        right = "an interval of wall time, such as 30 s"
        raise loaded.error("checkpoint.every", f"counts {interval.unit} of a single motion", right)
    return interval.number


def notes(work: Work, kind: str) -> Iterator[dict[str, Any]]:
    """Notes of all items in the parts of earlier runs; damaged parts are removed."""
    for path in work.parts(kind):
        try:
            _, note = read_part(path, [])
        except (DamagedPart, OSError):
            path.unlink(missing_ok=True)
            continue
        yield from note["items"]
