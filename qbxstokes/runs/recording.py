"""A motion on its way to disk: rows as they come, checkpoints, and what a resumed run needs."""

from __future__ import annotations

import json
import math
import os
import time
from collections.abc import Iterable, Iterator, Mapping
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qbxstokes.case.load import LoadedCase
from qbxstokes.errors import CaseError
from qbxstokes.io.checkpoint import Journal, discard, identity_of, run_of, unfinished
from qbxstokes.io.names import numbered
from qbxstokes.io.writer import ResultWriter
from qbxstokes.motion.events import Events
from qbxstokes.petsc.trajectory import Checkpoint, Chunk
from qbxstokes.quantities import MOTION, TIME, of_event
from qbxstokes.runs.plan import Plan
from qbxstokes.runs.target import result_path
from qbxstokes.simulation.assembly import CUT_SAMPLES, CUT_STEPS, Assembled
from qbxstokes.simulation.compare import orbit_drift
from qbxstokes.simulation.watch import split_columns

Array = NDArray[np.float64]

SAMPLES = "samples"
_COLUMNS = {"time": TIME, **MOTION}
# Sections that may change between a run and its continuation: its numbers do not depend on them.
_IRRELEVANT = ("title", "output", "compare", "checkpoint", "field", "sweep")
# Names of results, with numbers, that are looked through for a run to go on with.
_NUMBERED = 1000
# Samples that are kept in memory for the comparison with a reference; thinned from there on.
_KEPT = 20_000
# Rows go to the result in pieces of this size (bytes).
_PIECE = 2**21


class Recording:
    """Rows and checkpoints of one motion.

    start: where to begin, the checkpoint of an earlier run or None. target: the file the result is
    for. An unfinished run of the same result is gone on with (`resume`), replaced (`overwrite`), or
    refused with a CaseError. finished: the result of this very run, where there is nothing left to
    go on with.
    """

    def __init__(
        self,
        loaded: LoadedCase,
        plan: Plan,
        target: Path,
        options: list[str],
        resume: bool,
        overwrite: bool,
    ) -> None:
        self._loaded, self._plan = loaded, plan
        self._interval = loaded.case.checkpoint.interval
        if self._interval.unit == "periods" and plan.period is None:
            raise loaded.error(
                "checkpoint.every", "the flow turns no axis around", "seconds or steps instead"
            )
        self._identity = self._identify(options)
        self.overwrite, self.samples = overwrite, 0
        self.run, self.target = os.urandom(16).hex(), target
        self.start: Checkpoint | None = None
        self.resumed_at: float | None = None
        self._state: dict[str, Any] | None = None
        found, self.finished = None, None
        if resume:
            names = list(islice(numbered(result_path(loaded)), _NUMBERED))
            found = unfinished(names)
            if found is None and not overwrite:
                self.finished = self._finished(names)
        elif overwrite:
            discard(target)
        else:
            left = unfinished(dict.fromkeys([result_path(loaded), target]))
            if left is not None:
                raise CaseError(
                    f"{left}: an unfinished run is kept in {Journal(left).folder}; go on with "
                    "--resume, or begin anew with --overwrite"
                )
        self.journal = Journal(target)
        if found is not None:
            self._reopen(found)
        self._saved = (time.monotonic(), 0, 0.0)
        if self.start is not None:
            self._saved = (time.monotonic(), self.start.steps, self.start.time)
        self._latest: dict[str, Any] | None = None
        self.saved = self.start is not None

    def _identify(self, options: list[str]) -> dict[str, Any]:
        """What a run and its continuation have in common."""
        resolved = self._loaded.resolved()
        kept = {key: value for key, value in resolved.items() if key not in _IRRELEVANT}
        interval = self._interval
        # Cuts are part of the numbers; those by the clock only choose among them.
        cuts = None if interval.unit == "seconds" else self._loaded.case.checkpoint.every
        return json.loads(json.dumps({**kept, "cuts": cuts, "options": options}))

    def _reopen(self, found: Path) -> None:
        self.journal, checkpoint = Journal.reopened(found)
        other = _first_difference(checkpoint["identity"], self._identity)
        if other is not None:
            raise CaseError(
                f"{self.journal.folder}: the run to go on with had another {other}; restore it, or "
                "begin anew with --overwrite"
            )
        self.target, self.run = found, checkpoint["run"]
        numbers = checkpoint["integrator"]
        self.start = Checkpoint(**{**numbers, "state": np.array(numbers["state"])})
        self._state, self.resumed_at = checkpoint["events"], self.start.time

    def _finished(self, names: Iterable[Path]) -> Path | None:
        """The result that an earlier run of this case has left, None without any result.

        Raises CaseError where there are results of other cases alone.
        """
        other = ""
        for path in names:
            identity = identity_of(path)
            if identity is None:
                continue
            difference = _first_difference(identity, self._identity)
            if difference is None:
                return path
            other = other or f"{path}: is the result of a run with another {difference}"
        if other:
            raise CaseError(
                f"{other}, and no unfinished run is left to go on with; leave out --resume"
            )
        return None

    @property
    def provenance(self) -> dict[str, str]:
        """What a result says of the run it came from."""
        return {"run": self.run, "identity": json.dumps(self._identity)}

    # -- while it runs ------------------------------------------------------------------------

    @property
    def limits(self) -> dict[str, Any]:
        """Where the integrator cuts the run, independent of the clock."""
        steps = CUT_STEPS[self._plan.simulation.kind]
        span = math.inf
        if self._interval.unit == "steps":
            steps = min(steps, int(self._interval.number))
        elif self._interval.unit == "periods":
            span = self._interval.number * (self._plan.period or 0.0)
        return {"chunk_steps": steps, "chunk_samples": CUT_SAMPLES, "chunk_time": span}

    def receiver(self, assembled: Assembled, events: Events) -> Any:
        """The function that takes the integrator's chunks."""
        if self._state is not None:
            events.restore(self._state)

        def receive(chunk: Chunk) -> None:
            if len(chunk.times):
                found = assembled.observe(chunk.times, chunk.states, tuple(MOTION))
                columns = [found[name].reshape(len(chunk.times), -1) for name in MOTION]
                rows = np.concatenate([chunk.times[:, None], *columns], axis=1)
                self.journal.append(SAMPLES, rows)
            for name, rows in events.take().items():
                self.journal.append(name, rows)
            numbers = {**vars(chunk.checkpoint), "state": chunk.checkpoint.state.tolist()}
            self._latest = {
                "run": self.run,
                "identity": self._identity,
                "integrator": numbers,
                "events": events.state(),
            }
            if chunk.checkpoint.next_sample < len(self._plan.times) and self._due(chunk):
                self.save()

        return receive

    def _due(self, chunk: Chunk) -> bool:
        clock, steps, t = self._saved
        number, at = self._interval.number, chunk.checkpoint
        if self._interval.unit == "seconds":
            return time.monotonic() - clock >= number
        if self._interval.unit == "steps":
            return at.steps - steps >= number
        return at.time - t >= number * (self._plan.period or 0.0)

    def save(self) -> None:
        """Make the run safe up to the last cut."""
        if self._latest is None:
            return
        self.journal.save(self._latest)
        numbers = self._latest["integrator"]
        self._saved = (time.monotonic(), numbers["steps"], numbers["time"])
        self.saved = True

    # -- at the end ---------------------------------------------------------------------------

    def write(self, writer: ResultWriter, quantities: Iterable[str]) -> dict[str, Array]:
        """All rows into the result; returns the samples, thinned if they are many, by name.

        `largest_orbit_drift` is the largest |C/C0 - 1| of all samples.
        """
        total = sum(len(rows) for name, rows in self.journal.pieces() if name == SAMPLES)
        self.samples = total
        stride = max(1, -(-total // _KEPT))
        kept: list[Array] = []
        first, seen, drift = None, 0, 0.0
        constant = _place("orbit_constant")
        for name, rows in _together(self.journal.pieces()):
            if name != SAMPLES:
                columns = of_event(name)
                writer.append_events(name, split_columns(rows, columns), columns)
                continue
            data = split_columns(rows, _COLUMNS)
            writer.append({"time": data["time"], **{key: data[key] for key in quantities}})
            first = rows[0, constant] if first is None else first
            drift = max(drift, float(orbit_drift(rows[:, constant], first)))
            index = np.arange(seen, seen + len(rows))
            kept.append(rows[(index % stride == 0) | (index == total - 1)])
            seen += len(rows)
        width = sum(about.size for about in _COLUMNS.values())
        samples = np.concatenate([np.empty((0, width)), *kept])
        return {**split_columns(samples, _COLUMNS), "largest_orbit_drift": np.array(drift)}

    def replaces(self, path: Path) -> bool:
        """Whether the file at `path` is what an interrupted part of this very run left."""
        return self.start is not None and run_of(path) == self.run


def _together(pieces: Iterable[tuple[str, Array]]) -> Iterator[tuple[str, Array]]:
    """The pieces of each name joined into larger ones of about `_PIECE` bytes."""
    waiting: dict[str, list[Array]] = {}
    for name, rows in pieces:
        pile = waiting.setdefault(name, [])
        pile.append(rows)
        if sum(part.nbytes for part in pile) > _PIECE:
            yield name, np.concatenate(waiting.pop(name))
    for name, pile in waiting.items():
        yield name, np.concatenate(pile)


def _place(name: str) -> int:
    """First column of a quantity in the rows of samples."""
    start = 0
    for key, about in _COLUMNS.items():
        if key == name:
            return start
        start += about.size
    raise KeyError(name)


def _first_difference(one: Any, other: Any, prefix: str = "") -> str | None:
    """Dotted key of the first difference of two nested dictionaries."""
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        for key in dict.fromkeys([*one, *other]):
            found = _first_difference(one.get(key), other.get(key), f"{prefix}{key}.")
            if found is not None:
                return found
        return None
    return None if one == other else prefix.rstrip(".")
