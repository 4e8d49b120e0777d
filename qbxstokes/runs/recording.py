"""A motion on its way to disk: rows as they come, checkpoints, and what a resumed run needs."""

import json
import math
import os
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np

from qbxstokes.case.load import LoadedCase
from qbxstokes.errors import CaseError
from qbxstokes.io.names import told_by
from qbxstokes.io.store import DamagedPart, Work, check_disk, read_part
from qbxstokes.io.writer import ResultWriter
from qbxstokes.petsc.trajectory import Checkpoint, Chunk
from qbxstokes.quantities import MOTION, STRESS, TIME, of_event
from qbxstokes.runs.plan import MotionPlan
from qbxstokes.simulation.compare import orbit_drift
from qbxstokes.simulation.watching import split_columns
from qbxstokes.typing import Array

SAMPLES, ROWS = "samples", "rows"
STATE = "|integrator|state"  # the dataset of a part that holds the checkpoint's state
# Samples that are kept in memory for the comparison with a reference; thinned from there on.
_KEPT = 20_000
# Rows are kept in memory up to this size (bytes) before the disk is needed, and go to the result
# in pieces of that size.
_IN_MEMORY, _PIECE = 8 * 2**20, 2**21


class Recording:
    """Rows and checkpoints of one motion.

    work: the working folder, held by this process. start: where to begin, the checkpoint of an
    earlier run or None. saved: whether there is something to go on with.
    """

    def __init__(self, loaded: LoadedCase, plan: MotionPlan, work: Work) -> None:
        """Raises CaseError where the earlier run has left nothing to go on with, OutputError."""
        self._plan, self.work = plan, work
        # What is recorded: all that every motion has, and the stresses that are stored.
        self._names = (*MOTION, *(name for name in plan.quantities if name in STRESS))
        self._columns = {"time": TIME, **{name: plan.about(name) for name in self._names}}
        self._interval = loaded.case.checkpoint.interval
        if self._interval.unit == "periods" and plan.period is None:
            raise loaded.error(
                "checkpoint.every", "the flow turns no axis around", "seconds or steps instead"
            )
        right = "half of them while it runs; make room, or fewer samples"
        check_disk(work.target, 2.0 * plan.bytes_on_disk, "the motion", right)
        self.samples = 0
        self.start: Checkpoint | None = None
        self.resumed_at: float | None = None
        self._events: dict[str, Any] | None = None
        self._waiting: list[tuple[str, Array]] = []
        self._safe = 0  # samples in the parts
        self._latest: dict[str, Any] | None = None
        self._run = os.urandom(16).hex()
        if work.resumed:
            self._reopen()
        start = self.start
        self._saved = (time.monotonic(), start.steps if start else 0, start.time if start else 0.0)
        self.saved = start is not None

    def _reopen(self) -> None:
        """Go on from the checkpoint in the last part."""
        try:
            reached, note = 0, dict[str, Any]()
            for path in self.work.parts(ROWS):
                _, note = read_part(path, [STATE])
                if note["first"] != reached:
                    raise DamagedPart(f"a part is missing before {path.name}")
                reached = note["integrator"]["next_sample"]
            self.start = Checkpoint(**note["integrator"])
            self._events, self._run = note["events"], note["run"]
        except (DamagedPart, OSError, KeyError, TypeError) as error:
            wrong = f"no checkpoint to go on from ({error}); begin anew with --overwrite"
            raise CaseError(f"{self.work.folder}: {wrong}") from None
        self.resumed_at, self._safe = self.start.time, reached

    @property
    def provenance(self) -> dict[str, str]:
        """What a result says of the run it came from."""
        return {"run": self._run, "identity": json.dumps(self.work.identity)}

    # -- while it runs ------------------------------------------------------------------------

    @property
    def limits(self) -> dict[str, Any]:
        """Where the integrator cuts the run, independent of the clock."""
        steps, samples = self._plan.cuts
        span = math.inf
        if self._interval.unit == "steps":
            steps = min(steps, int(self._interval.number))
        elif self._interval.unit == "periods":
            span = self._interval.number * (self._plan.period or 0.0)
        return {"chunk_steps": steps, "chunk_samples": samples, "chunk_time": span}

    def receiver(self, assembled: Any, events: Any, advance: Callable[[float, int], None]) -> Any:
        """The function that takes the integrator's chunks: the scene's, with what watches it.

        advance: is told the time and the steps so far.
        """
        if self._events is not None:
            events.restore(self._events)

        def receive(chunk: Chunk) -> None:
            if len(chunk.times):
                found = assembled.observe(chunk.times, chunk.states, self._names)
                columns = [found[name].reshape(len(chunk.times), -1) for name in self._names]
                rows = np.concatenate([chunk.times[:, None], *columns], axis=1)
                self._waiting.append((SAMPLES, rows))
            advance(chunk.checkpoint.time, chunk.checkpoint.steps)
            self._waiting += events.take().items()
            self._latest = {"integrator": vars(chunk.checkpoint), "events": events.state()}
            if chunk.checkpoint.next_sample < len(self._plan.times) and self._due(chunk):
                self.save()

        return receive

    def _due(self, chunk: Chunk) -> bool:
        if sum(rows.nbytes for _, rows in self._waiting) > _IN_MEMORY:
            return True
        clock, steps, t = self._saved
        number, at = self._interval.number, chunk.checkpoint
        if self._interval.unit == "seconds":
            return time.monotonic() - clock >= number
        if self._interval.unit == "steps":
            return at.steps - steps >= number
        return at.time - t >= number * (self._plan.period or 0.0)

    def save(self) -> None:
        """Make the run safe up to the last cut: its rows since the last save, and its state."""
        if self._latest is None:
            return
        rows = dict(_joined(self._waiting, math.inf))
        self.work.save(ROWS, rows, {**self._latest, "first": self._safe, "run": self._run})
        numbers = self._latest["integrator"]
        self._waiting, self._safe = [], numbers["next_sample"]
        self._saved = (time.monotonic(), numbers["steps"], numbers["time"])
        self.saved = True

    # -- at the end ---------------------------------------------------------------------------

    def _rows(self) -> Iterator[tuple[str, Array]]:
        """All rows by name, in their order."""
        for path in self.work.parts(ROWS):
            try:
                arrays, _ = read_part(path)
            except (DamagedPart, OSError) as error:
                wrong = f"a part cannot be read ({error}); begin anew with --overwrite"
                raise CaseError(f"{self.work.folder}: {wrong}") from None
            yield from arrays.items()
        yield from self._waiting

    def write(self, writer: ResultWriter, quantities: Iterable[str]) -> dict[str, Array]:
        """All rows into the result; returns the samples, thinned if they are many, by name.

        `largest_orbit_drift` is the largest |C/C0 - 1| of all samples.
        """
        if self._latest is not None:
            total = int(self._latest["integrator"]["next_sample"])
        else:
            total = 0 if self.start is None else self.start.next_sample
        self.samples = total
        stride = max(1, -(-total // _KEPT))
        kept: list[Array] = []
        first, seen, drift = None, 0, 0.0
        for name, rows in _joined(self._rows(), _PIECE):
            if name != SAMPLES:
                columns = of_event(name, coupled=self._plan.simulation.coupled)
                writer.append(split_columns(rows, columns), columns, f"events/{name}/")
                continue
            data = split_columns(rows, self._columns)
            stored = {"time": data["time"], **{key: data[key] for key in quantities}}
            writer.append(stored, self._columns)
            constant = data["orbit_constant"]
            first = constant[0] if first is None else first
            drift = max(drift, float(orbit_drift(constant, first)))
            index = np.arange(seen, seen + len(rows))
            kept.append(rows[(index % stride == 0) | (index == total - 1)])
            seen += len(rows)
        width = sum(column.size for column in self._columns.values())
        samples = np.concatenate([np.empty((0, width)), *kept])
        return {**split_columns(samples, self._columns), "largest_orbit_drift": np.array(drift)}

    @property
    def replaces(self) -> bool:
        """Whether the target is what an interrupted part of this very run left."""
        return self.start is not None and told_by(self.work.target, "run") == self._run


def _joined(pieces: Iterable[tuple[str, Array]], most: float) -> Iterator[tuple[str, Array]]:
    """The pieces of each name joined into larger ones of about `most` bytes."""
    waiting: dict[str, list[Array]] = {}
    for name, rows in pieces:
        pile = waiting.setdefault(name, [])
        pile.append(rows)
        if sum(part.nbytes for part in pile) > most:
            yield name, np.concatenate(waiting.pop(name))
    for name, pile in waiting.items():
        yield name, np.concatenate(pile)
