"""What a sweep costs: constants of the model fitted here, and what they say of many ranks."""

from __future__ import annotations

import json
import shutil
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from qbxstokes.app.benchmark.command import run
from qbxstokes.case.load import load_case
from qbxstokes.io.tables import Column, Table
from qbxstokes.runs.cost import XEON, Constants, Estimate, estimate, weights
from qbxstokes.runs.scenes import Scenes
from qbxstokes.runs.sweep import layout_of

if TYPE_CHECKING:
    from qbxstokes.app.tabulate import Work

RANKS = (1, 2, 10, 100, 1000, 10_000)
# One shear at the centre of each, so that the bodies turn alike; a slow stream lets them move.
_FLOWS = {
    "linear": "{u1: {'1': 1.0e-9, x2: 1}}",
    "centred": "{u1: {x2: 1}}",
    "quadratic": "{u1: {x2: 1, x2^2: 0.25, x3^2: 0.25}}",
    "cubic": "{u1: {'1': 1.0e-9, x2: 1, x2^3: 0.1}, u2: {x1^3: 0.1}}",
}
# What the prediction for many ranks is made of.
LARGE = """\
body: {aspect_ratio: 0.5, stokes_number: 10}
flow: {type: shear}
time: {periods: 10, samples: 2, tolerance: 1e-8}
sweep:
  store: summary
  axes:
    - start.orientation: {random: axes, count: 10000000, seed: 1}
"""
# Mean time of one of many numbers that two ranks take at once.
_HANDOUT = """\
import time
from mpi4py import MPI
from qbxstokes.runs.handout import BLOCKS, HandOut
counters = HandOut(MPI.COMM_WORLD)
counters.wait()
begin = time.perf_counter()
while counters.next(BLOCKS) < {count}:
    pass
counters.wait()
if MPI.COMM_WORLD.rank == 0:
    print((time.perf_counter() - begin) / {count})
counters.close()
"""


@dataclass(frozen=True)
class Trial:
    """A sweep of random orientations that is timed."""

    name: str
    count: int
    block: int = 512
    samples: int = 2
    periods: float = 2.0
    stokes_number: float = 0.0
    flow: str = "linear"
    store: str = "summary"

    def text(self) -> str:
        """The case."""
        return (
            f"body: {{aspect_ratio: 0.5, stokes_number: {self.stokes_number}}}\n"
            f"flow: {{type: polynomial, coefficients: {_FLOWS[self.flow]}}}\n"
            f"time: {{end: {31.4 * self.periods / 2.0}, samples: {self.samples}, "
            "tolerance: 1e-9}\n"
            f"sweep: {{store: {self.store}, block: {self.block}, axes: "
            f"[{{start.orientation: {{random: axes, count: {self.count}, seed: 1}}}}]}}\n"
        )


@dataclass(frozen=True)
class Timed:
    """A trial: seconds of the parts of its command beyond those of a sweep of two trajectories.

    evaluations: right-hand sides of all trajectories.
    """

    trial: Trial
    parts: dict[str, float]
    evaluations: float
    scenes: Scenes
    row_bytes: int

    @property
    def calls(self) -> float:
        """Right-hand sides of all blocks."""
        return self.evaluations * self.scenes.blocks / self.trial.count

    @property
    def more_blocks(self) -> int:
        """Blocks beyond that of the sweep of two trajectories."""
        return self.scenes.blocks - 1

    @property
    def integration(self) -> float:
        """Seconds of the blocks without what their samples take whatever they hold, as known."""
        return self.parts["blocks"] - self.more_blocks * self.trial.samples * XEON.block_sample

    def estimate(self, constants: Constants) -> Estimate:
        """What the model says of it; its body comes from the cache."""
        return estimate(self.scenes, self.row_bytes, replace(constants, model=0.0))


def tables(work: Work) -> Iterator[Table]:
    """Constants, the model against sweeps that were run, and its word on many ranks."""
    launcher = shutil.which("mpirun") or shutil.which("mpiexec")
    if work.ranks > 1 or launcher is None:
        table = _constants(XEON, set())
        table.notes.append("Not measured: within a parallel run, or without mpirun.")
        yield table
        return
    size = work.choose(1, 16)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        base = Trial("massless, shear", 1024 * size)
        trials = [
            base,
            replace(base, name="small blocks", block=8, count=128 * size),
            replace(base, name="small short blocks", block=8, count=128 * size, periods=0.01),
            replace(base, name="many samples", samples=401, count=128 * size),
            replace(
                base, name="all samples stored", samples=401, count=128 * size, store="samples"
            ),
            replace(base, name="many short ones", periods=0.01, count=8192 * size),
        ]
        for stokes_number, kind in ((0.0, "massless"), (10.0, "inertial")):
            for flow in work.choose(("linear", "centred"), _FLOWS):
                new = replace(base, flow=flow, stokes_number=stokes_number, count=512 * size)
                if (kind, flow) != ("massless", "linear"):
                    trials.append(replace(new, name=f"{kind}, {flow} flow"))
        done = {}
        for trial in trials:
            work.say(f"sweep: {trial.name}")
            done[trial.name] = _timed(trial, folder, [sys.executable])
        work.say("sweep: two ranks")
        two = [launcher, "-n", "2", sys.executable]
        parallel = _timed(base, folder, two)
        code = _HANDOUT.format(count=work.choose(1000, 100_000))
        handout = float(run([*two, "-c", code], folder).output)
        work.say("sweep: forming a body")
        few = Trial("a body", 2)
        formed = _told(few, folder / "body.yaml", [sys.executable], "--no-cache")
        constants, measured = fitted(done, handout, formed["wall_times"]["models"])
        yield _constants(constants, measured)
        yield _model(constants, [(t, 1) for t in done.values()] + [(parallel, 2)])
        (folder / "large.yaml").write_text(LARGE)
        scenes = Scenes(load_case(folder / "large.yaml"))
        yield _many(estimate(scenes, layout_of(scenes).row_bytes, constants), scenes)


def _timed(trial: Trial, folder: Path, words: list[str]) -> Timed:
    path = folder / "sweep.yaml"
    few = replace(trial, count=2)
    _told(few, path, words)  # compiles what has not been compiled yet
    start, told = (_told(one, path, words) for one in (few, trial))
    parts = {
        name: told["wall_times"].get(name, 0.0) - start["wall_times"].get(name, 0.0)
        for name in ("blocks", "output", "waiting")
    }
    scenes = Scenes(load_case(path))
    return Timed(trial, parts, told["rhs_evaluations"], scenes, layout_of(scenes).row_bytes)


def _told(trial: Trial, path: Path, words: list[str], *more: str) -> dict[str, Any]:
    """What the command says of a trial."""
    path.write_text(trial.text())
    words = [*words, "-m", "qbxstokes", path.name, "--json", "--overwrite", "--progress", "none"]
    told: dict[str, Any] = json.loads(run([*words, *more], path.parent).output)
    return told


def fitted(done: dict[str, Timed], handout: float, model: float) -> tuple[Constants, set[str]]:
    """Constants from the trials by name, and the names of those that they tell.

    Blocks: seconds = evaluations (rhs + call/bodies) + samples sample + blocks block, four trials
    for the four; output: seconds = trajectories layout + bytes stored_byte, two trials for the two.
    """
    names = ("massless, shear", "small blocks", "small short blocks", "many samples")
    four = [done[name] for name in names]
    system = [
        [t.evaluations, t.calls, t.trial.count * t.trial.samples, t.more_blocks] for t in four
    ]
    rhs, call, sample, block = np.linalg.solve(system, [t.integration for t in four])
    two = (done["many short ones"], done["all samples stored"])
    system = [[t.trial.count, t.trial.count * t.row_bytes] for t in two]
    layout, byte = np.linalg.solve(system, [t.parts["output"] for t in two])
    values = {
        "rhs_massless_linear": rhs,
        "call": call,
        "sample": sample,
        "block": block,
        "layout": layout,
        "stored_byte": byte,
        "handout": handout,
        "model": model,
    }
    for kind in ("massless", "inertial"):
        for flow in _FLOWS:
            timed = done.get(f"{kind}, {flow} flow")
            if timed is not None:
                rest = timed.calls * call + timed.trial.count * timed.trial.samples * sample
                rest += timed.more_blocks * block
                values[f"rhs_{kind}_{flow}"] = (timed.integration - rest) / timed.evaluations
    for kind, name in (("massless", "massless, shear"), ("inertial", "inertial, linear flow")):
        timed = done[name]
        expected = float(weights(timed.scenes).mean()) * timed.trial.count
        values[f"steps_{kind}"] = XEON.steps(kind == "inertial") * timed.evaluations / expected
    return replace(XEON, **{name: float(value) for name, value in values.items()}), set(values)


def _constants(constants: Constants, measured: set[str]) -> Table:
    table = Table(
        "sweep_constants",
        "Sweeps: constants of the cost model",
        (
            Column("constant"),
            Column("measured", "s", "in this run; steps_* are numbers", ".2e"),
            Column("known", "s", "what `--dry-run` reckons with", ".2e"),
            Column("ratio", "", "", ".2f"),
        ),
    )
    for item in fields(constants):
        known, now = getattr(XEON, item.name), getattr(constants, item.name)
        if item.name in measured:
            table.add(constant=item.name, measured=now, known=known, ratio=now / known)
        else:
            table.add(constant=item.name, known=known)
    return table


def _model(constants: Constants, runs: list[tuple[Timed, int]]) -> Table:
    table = Table(
        "sweep_model",
        "Sweeps: the cost model against whole sweeps",
        (
            Column("sweep"),
            Column("trajectories", "", "", "d"),
            Column("ranks", "", "", "d"),
            Column("each", "us", "per trajectory, on one core", ".3g"),
            Column("measured", "s", "without start-up", ".3g"),
            Column("predicted", "s", "with the constants of this run", ".3g"),
            Column("ratio", "", "measured over predicted", ".2f"),
        ),
    )
    for timed, ranks in runs:
        measured, predicted = sum(timed.parts.values()), timed.estimate(constants).seconds(ranks)
        table.add(
            sweep=timed.trial.name,
            trajectories=timed.trial.count,
            ranks=ranks,
            each=1e6 * ranks * measured / timed.trial.count,
            measured=measured,
            predicted=predicted,
            ratio=measured / predicted,
        )
    return table


def _many(cost: Estimate, scenes: Scenes) -> Table:
    count = scenes.space.size
    table = Table(
        "sweep_ranks",
        f"Sweeps: {count:.0e} inertial trajectories of ten periods, predicted",
        (
            Column("ranks", "", "", "d"),
            Column("time", "s", "without start-up", ".3g"),
            Column("efficiency", "", "", ".2f"),
            *(
                Column(part.replace(" ", "_").replace("-", ""), "s", "", ".2g", part)
                for part in cost.parts(1)
            ),
        ),
        notes=[
            f"{scenes.blocks} blocks of {scenes.block_size}; St = 10, tolerance 1e-8, the table of "
            "summaries alone. The last block and the layout of the file on one rank bound the "
            "speed-up; smaller blocks (sweep.block) shorten the former.",
            "Not in the model: start-up, and a file system that several nodes share.",
        ],
        plot={"x": "ranks", "y": "time", "scale": "loglog"},
    )
    for ranks in RANKS:
        parts = cost.parts(ranks)
        total = cost.seconds(ranks)
        values = {name.replace(" ", "_").replace("-", ""): value for name, value in parts.items()}
        table.add(ranks=ranks, time=total, efficiency=cost.work / total / ranks, **values)
    return table
