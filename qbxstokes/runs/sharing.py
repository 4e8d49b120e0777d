"""Work that ranks share: its numbers on their way to them, its results on their way to rank 0.

Every rank takes the next number as it becomes free. What it computes does not depend on who it is.
A rank keeps what it has finished until `every` seconds have passed or it is much, and then makes it
safe as one part of the working folder: a thousand ranks make thousands of files, not millions. What
is left at the end goes to rank 0 by a message.

Set-up is spread as well: each rank forms its share of the rows of the layer potentials. Rows are
independent, so that any number of ranks gives the numbers of one. Rank 0 runs the set-up and asks
for rows when it needs them (not at all where the cache has the result); the other ranks wait for
its orders without occupying their cores.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from qbxstokes.case.load import LoadedCase
from qbxstokes.errors import QbxStokesError, ResultFileError
from qbxstokes.io.store import DamagedPart, Work, read_part
from qbxstokes.petsc.launch import finish_asleep
from qbxstokes.qbx.operator import layer_rows
from qbxstokes.runs.parallel import HandOut, interrupted, on_root
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
        """On rank 0 all that is finished, part by part, then what the ranks have handed over.

        Raises ResultFileError for a part that is damaged: it is removed, and a resumed run does its
        work again.
        """
        for path in self.work.parts(self._kind):
            rows, note = read_whole(path)
            yield from [(rows, note)] if rows else zip(note["held"], note["items"], strict=True)
        while self._items:
            yield self._items.pop(0)
        while self._waiting:
            yield from self._messages.recv(source=self._waiting.pop(0), tag=_TAG)

    def concluded(self, write: Callable[[Iterator[Item]], T]) -> T:
        """What `write` makes on rank 0 of all that is finished; every rank calls this and knows it.

        An error is raised on all of them; none waits for ever for what nobody takes.
        """
        if self.comm.rank:
            self._messages.send(self._items, dest=0, tag=_TAG)

        def run() -> T:
            try:
                return write(self.collect())
            finally:
                while self._waiting:
                    self._messages.recv(source=self._waiting.pop(0), tag=_TAG)

        return on_root(self.comm, run)


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


# -- rows of operators -----------------------------------------------------------------------------


T = TypeVar("T")


class Alone:
    """Stands for the communicator of a single rank."""

    rank, size = 0, 1


ALONE = Alone()


class RowTeam:
    """The ranks of a communicator at the service of rank 0, above all as one former of rows.

    `dismiss` ends their service.
    """

    def __init__(self, comm: Any, services: Mapping[str, Callable[..., Any]] | None = None) -> None:
        """services: what the other ranks can do together with rank 0, by name (see `join`)."""
        self._comm, self._services = comm, services or {}
        self._serving = comm.size > 1

    def __call__(
        self, shape: Any, scheme: Any, n_modes: int, rows: Any, with_single: bool = False
    ) -> tuple[Any, Any]:
        """Rows as `layer_rows` gives them, formed by all ranks; for rank 0."""
        order = (shape, scheme, n_modes, list(rows), with_single)
        if not self._serving:
            return layer_rows(*order)
        ordered(self._comm, ("rows", order))
        return _put_together(self._comm.gather(_share(order, 0, self._comm.size)))

    def serve(self) -> None:
        """Form rows for rank 0, and join in services, until dismissed; for the other ranks."""
        while (order := ordered(self._comm)) is not None:
            name, arguments = order
            if name == "rows":
                self._comm.gather(_share(arguments, self._comm.rank, self._comm.size))
            else:
                self._services[name](*arguments)

    def join(self, name: str, *arguments: Any) -> Any:
        """Have the other ranks begin a service, in which rank 0 then takes part itself.

        Returns the communicator of those who take part.
        """
        if not self._serving:
            return ALONE
        ordered(self._comm, (name, arguments))
        return self._comm

    def dismiss(self) -> None:
        """Let the other ranks go on; rank 0 forms further rows alone."""
        if self._serving:
            self._serving = False
            ordered(self._comm)


def ordered(comm: Any, order: Any = None, pause: float = 2e-3) -> Any:
    """The order of rank 0 on every rank; pause: between looks of the others, who sleep."""
    arrived = comm.Ibarrier()
    if comm.rank:
        finish_asleep(arrived, pause)
    else:
        arrived.Wait()
    return comm.bcast(order)


def _share(order: Any, rank: int, size: int) -> tuple[Any, Any]:
    """A rank's share of an order: every `size`-th row, so that dear rows are dealt out evenly."""
    shape, scheme, n_modes, rows, *single = order
    return layer_rows(shape, scheme, n_modes, rows[rank::size], *single)


def _put_together(parts: list[tuple[Any, Any]]) -> tuple[Any, Any]:
    """The shares of all ranks as one."""
    double, single = (np.concatenate(shares) for shares in zip(*parts, strict=True))
    for rank, (first, second) in enumerate(parts):
        double[rank :: len(parts)] = first
        single[rank :: len(parts)] = second
    return double, single


def rows_by_all(comm: Any, *order: Any) -> tuple[Any, Any]:
    """Rows as `layer_rows` gives them, formed by all ranks and known to all; called by all."""
    share = _share(order, comm.rank, comm.size)
    return share if comm.size == 1 else _put_together(comm.allgather(share))


def with_team(
    comm: Any,
    action: Callable[[RowTeam], T],
    services: Mapping[str, Callable[..., Any]] | None = None,
) -> Callable[[], T]:
    """The action of rank 0 with the other ranks at its service; they have served on return.

    Every rank calls this; the result is to be run on rank 0 (`parallel.on_root`). A failure that
    all ranks share, in a service, ends the service of the others.
    """
    team = RowTeam(comm, services)
    if comm.rank:
        try:
            team.serve()
        except QbxStokesError as error:
            if not error.on_all_ranks:
                raise

    def run() -> T:
        shared = False
        try:
            return action(team)
        except QbxStokesError as error:
            shared = error.on_all_ranks
            raise
        finally:
            if not shared:
                team.dismiss()

    return run
