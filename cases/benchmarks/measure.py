"""What the benchmarks share: their command line, how they take time, and how they print."""

from __future__ import annotations

import argparse
import csv
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

Rows = list[dict[str, Any]]

LONGEST = 2.0  # s after which an action is not timed once more
SECONDS = 0.05  # spent on one timing of what is quick


def command(main: Callable[[bool], dict[str, Rows]]) -> None:
    """`[--small] [--csv]` of a script, whose `main(small)` makes the rows of tables by name."""
    parser = argparse.ArgumentParser(description=(main.__globals__["__doc__"] or "").split("\n")[0])
    parser.add_argument("--small", action="store_true", help="a look: few sizes, no repeats")
    parser.add_argument("--csv", action="store_true", help="write each table to TABLE.csv as well")
    options = parser.parse_args()
    for name, rows in main(options.small).items():
        heads = list(rows[0])
        cells = [heads, *([shown(row[head]) for head in heads] for row in rows)]
        widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
        print(f"\n{name}")
        for line in cells:
            print("  " + "  ".join(map(str.ljust, line, widths)).rstrip())
        if options.csv:
            with Path(f"{name}.csv").open("w", newline="") as file:
                writer = csv.DictWriter(file, heads)
                writer.writeheader()
                writer.writerows(rows)


def shown(value: Any) -> str:
    """Three digits of a number, a dash for what was not measured."""
    if value is None:
        return "-"
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def timed(
    action: Callable[[], Any], repeats: int, clock: Callable[[], float] = time.perf_counter
) -> tuple[float, Any]:
    """Median time of the repeats (s) and the last result; what takes long is repeated less.

    clock: `time.thread_time` is not disturbed by whatever else the machine does.
    """
    spans: list[float] = []
    result = None
    while len(spans) < repeats and sum(spans) < LONGEST:
        begin = clock()
        result = action()
        spans.append(clock() - begin)
    return median(spans), result


def seconds_each(action: Callable[[], Any], repeats: int) -> float:
    """Median over the repeats of the time (s) of one call, each measured over many calls."""
    action()
    once, _ = timed(action, 1)
    count = max(1, int(SECONDS / max(once, 1e-7)))
    return timed(lambda: [action() for _ in range(count)], repeats)[0] / count


def turns(actions: dict[str, Callable[[], Any]], rounds: int) -> dict[str, list[Any]]:
    """What the actions return, in turns, so that a busy machine disturbs all alike."""
    found: dict[str, list[Any]] = {name: [] for name in actions}
    for _ in range(rounds):
        for name, action in actions.items():
            found[name].append(action())
    return found
