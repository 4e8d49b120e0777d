"""One rank and two: a sweep, the same file, the same numbers."""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
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


def tables(work: Work) -> Iterator[Table]:
    """Wall time of the whole command on one and two ranks, and the part that is shared."""
    count = work.choose(64, 15_000)
    table = Table(
        "ranks",
        f"A sweep of {count} trajectories on one and two ranks",
        (
            Column("ranks", "", "", "d"),
            Column("time", "s", "wall time of the command", ".2f"),
            Column("start", "s", "the same for a sweep of two trajectories", ".2f"),
            Column("speedup", "", "of what lies between them", ".2f"),
            Column("efficiency", "", "speed-up over ranks", ".2f"),
            Column("memory", "MB", "largest resident memory of a rank", ".0f"),
        ),
        notes=[f"{os.cpu_count()} cores; start-up and set-up are subtracted for the speed-up."],
    )
    launcher = shutil.which("mpirun") or shutil.which("mpiexec")
    if work.ranks > 1 or launcher is None:
        table.notes.append("Not measured: within a parallel run, or without mpirun.")
        yield table
        return
    base = 0.0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for size, stem in ((2, "few"), (count, "many")):
            (folder / f"{stem}.yaml").write_text(CASE.format(count=size))
        # Fills the cache.
        run([sys.executable, "-m", "qbxstokes", "few.yaml", "--quiet"], folder)
        for ranks in (1, 2):
            spans = {}
            for stem in ("few", "many"):
                words = [launcher, "-n", str(ranks), sys.executable, "-m", "qbxstokes"]
                words += [f"{stem}.yaml", "--overwrite", "--quiet", "--progress", "none"]
                ended = []
                for turn in range(work.choose(1, 2 if stem == "many" else 3)):
                    work.say(f"{ranks} ranks, {stem}, turn {turn + 1}")
                    ended.append(run(words, folder))
                spans[stem] = median(process.time for process in ended)
            memory = run(words, folder, watched=True).memory
            shared = spans["many"] - spans["few"]
            base = base or shared
            # Work shorter than the scatter of the start-up has no speed-up to speak of.
            known = min(base, shared) > 0.5 * spans["few"]
            table.add(
                ranks=ranks,
                time=spans["many"],
                start=spans["few"],
                speedup=base / shared if known else None,
                efficiency=base / shared / ranks if known else None,
                memory=memory,
            )
    yield table
