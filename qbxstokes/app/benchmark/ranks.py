"""One rank and two: a sweep, the same file, the same numbers."""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING

from qbxstokes.app.benchmark.command import run
from qbxstokes.io.tables import Column, Table

if TYPE_CHECKING:
    from qbxstokes.app.tabulate import Work

CASE = """\
body: {{aspect_ratio: 0.5}}
flow: {{type: shear}}
time: {{periods: 20, samples: 5, tolerance: 1e-9}}
sweep:
  axes:
    - start.orientation: {{random: axes, count: {count}, seed: 1}}
"""


# What is run: ranks of a run, and how many runs at the same time.
_RUNS = {"one rank": (1, 1), "one rank, two runs at once": (1, 2), "two ranks": (2, 1)}


def tables(work: Work) -> Iterator[Table]:
    """Wall time of the whole command on one and two ranks, and the part that is shared."""
    count = work.choose(64, 15_000)
    table = Table(
        "ranks",
        f"A sweep of {count} trajectories on one and two ranks",
        (
            Column("run"),
            Column("time", "s", "wall time of the command", ".2f"),
            Column("start", "s", "the same for a sweep of two trajectories", ".2f"),
            Column("speedup", "", "work per second of what lies between them", ".2f"),
            Column("of_machine", "", "over that of two runs at once", ".2f"),
            Column("memory", "MB", "largest resident memory of a rank", ".0f"),
        ),
        notes=[
            f"{os.cpu_count()} cores; start-up and set-up are subtracted for the speed-up. Two "
            "runs that know nothing of each other show what the second core is worth."
        ],
    )
    launcher = shutil.which("mpirun") or shutil.which("mpiexec")
    if work.ranks > 1 or launcher is None:
        table.notes.append("Not measured: within a parallel run, or without mpirun.")
        yield table
        return
    base = machine = 0.0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for size, stem in ((2, "few"), (count, "many")):
            (folder / f"{stem}.yaml").write_text(CASE.format(count=size))
        # Fills the cache.
        run([sys.executable, "-m", "qbxstokes", "few.yaml", "--quiet"], folder)

        def words(ranks: int, stem: str, copy: int) -> list[str]:
            return [
                *(launcher, "-n", str(ranks), sys.executable, "-m", "qbxstokes", f"{stem}.yaml"),
                *("--overwrite", "--quiet", "--progress", "none"),
                *("--set", f"output.file={stem}-{copy}.h5"),
            ]

        def span(ranks: int, runs: int, stem: str) -> float:
            """Seconds until all runs have ended."""
            with ThreadPoolExecutor(runs) as pool:
                ended = pool.map(lambda copy: run(words(ranks, stem, copy), folder), range(runs))
                return max(process.time for process in ended)

        for what, (ranks, runs) in _RUNS.items():
            spans = {}
            for stem in ("few", "many"):
                turns = work.choose(1, 2 if stem == "many" else 3)
                work.say(f"{what}: {stem} trajectories")
                spans[stem] = median(span(ranks, runs, stem) for _ in range(turns))
            shared = spans["many"] - spans["few"]
            base = base or shared
            # Work shorter than the scatter of the start-up has no speed-up to speak of.
            known = min(base, shared) > 0.5 * spans["few"]
            speedup = runs * base / shared if known else None
            if runs > 1:
                machine = speedup or 0.0
            table.add(
                run=what,
                time=spans["many"],
                start=spans["few"],
                speedup=speedup,
                of_machine=speedup / machine if speedup and machine else None,
                memory=run(words(ranks, "many", 0), folder, watched=True).memory,
            )
    yield table
