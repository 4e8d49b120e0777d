"""What the benchmarks share: their command line, how they take time, and how they print."""

import argparse
import csv
import time
from pathlib import Path
from statistics import median

LONGEST = 2.0  # s after which an action is not timed once more
SECONDS = 0.05  # spent on one timing of what is quick


def command(main):
    """Of a script's `main(small)`, which makes the rows of tables by name: [--small] [--csv]."""
    if main.__module__ != "__main__":
        return main
    parser = argparse.ArgumentParser(description=main.__globals__["__doc__"].split("\n")[0])
    parser.add_argument("--small", action="store_true", help="a look: few sizes, no repeats")
    parser.add_argument("--csv", action="store_true", help="write each table to TABLE.csv as well")
    options = parser.parse_args()
    for name, rows in main(options.small).items():
        cells = [list(rows[0]), *(list(map(shown, row.values())) for row in rows)]
        widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
        print(f"\n{name}")
        for line in cells:
            print("  " + "  ".join(map(str.ljust, line, widths)).rstrip())
        if options.csv:
            with Path(f"{name}.csv").open("w", newline="") as file:
                writer = csv.DictWriter(file, list(rows[0]))
                writer.writeheader()
                writer.writerows(rows)
    return main


def shown(value):
    """Three digits of a number, a dash for what was not measured."""
    return "-" if value is None else f"{value:.3g}" if isinstance(value, float) else str(value)


def timed(action, repeats, clock=time.perf_counter):
    """Median time of the repeats (s) and the last result; what takes long is repeated less.

    clock: `time.thread_time` is not disturbed by whatever else the machine does.
    """
    spans, result = [], None
    while len(spans) < repeats and sum(spans) < LONGEST:
        begin = clock()
        result = action()
        spans.append(clock() - begin)
    return median(spans), result


def seconds_each(action, repeats):
    """Median over the repeats of the time (s) of one call, each measured over many calls."""
    action()
    once, _ = timed(action, 1)
    count = max(1, int(SECONDS / max(once, 1e-7)))
    return timed(lambda: [action() for _ in range(count)], repeats)[0] / count


def turns(actions, rounds):
    """What the actions return, in turns, so that a busy machine disturbs all alike."""
    found = {name: [] for name in actions}
    for _ in range(rounds):
        for name, action in actions.items():
            found[name].append(action())
    return found
