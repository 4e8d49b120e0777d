"""How the tables time things and see their memory."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

LONGEST = 2.0  # s after which an action is not timed once more
SECONDS = 0.05  # spent on one timing of what is quick


def timed(
    action: Callable[[], Any], repeats: int, clock: Callable[[], float] = time.perf_counter
) -> tuple[float, Any]:
    """Median time of the repeats (s) and the last result; what takes long is repeated less.

    clock: `time.thread_time` is not disturbed by whatever else the machine does, for work that one
    thread does alone.
    """
    spans: list[float] = []
    result = None
    while len(spans) < repeats and sum(spans) < LONGEST:
        begin = clock()
        result = action()
        spans.append(clock() - begin)
    return median(spans), result


def seconds_each(action: Callable[[], Any], repeats: int) -> float:
    """Median over the repeats of the wall time of one call, each measured over many calls."""
    action()
    once, _ = timed(action, 1)
    count = max(1, int(SECONDS / max(once, 1e-7)))

    def many() -> None:
        for _ in range(count):
            action()

    return timed(many, repeats)[0] / count


def peak_memory(action: Callable[[], Any]) -> float | None:
    """Resident memory (MB) that an action added at its largest, PETSc's included.

    To be used before the action has run: what it leaves to be used again is not seen anew. None
    where the system does not tell.
    """
    try:
        Path("/proc/self/clear_refs").write_text("5")  # starts the high-water mark anew, proc(5)
    except OSError:
        return None
    before, _ = largest_memory("self"), action()
    after = largest_memory("self")
    return None if before is None or after is None else after - before


def largest_memory(process: int | str) -> float | None:
    """The high-water mark (MB) of the resident memory of a process, None if it has ended."""
    try:
        lines = Path(f"/proc/{process}/status").read_text().splitlines()
    except OSError:
        return None
    marks = [float(line.split()[1]) for line in lines if line.startswith("VmHWM:")]
    return marks[0] / 1024.0 if marks else None
