"""What a sweep costs: constants of the cost model fitted here, and its word on many ranks.

The model is that of `qbxstokes/runs/cost.py`, by which `--dry-run` and `--explain` reckon. Its
constants are told by sweeps of random orientations that differ in one thing each; seconds are those
of the parts of the command beyond the ones of a sweep of two trajectories.

    python cases/benchmarks/sweeps.py [--small] [--csv]

5 min, two cores. Expected: the model within a factor of 1.4 of the sweeps; for 1e7 inertial
trajectories of ten periods 6 hours on one core, 35 s on 1,000 ranks and 15 s on 10,000, where the
layout of the file on one rank and the last block (`sweep.block`) bound the speed-up. Start-up, and
a file system that several nodes share, are not in the model.
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from command import launcher, run
from measure import Rows, command

from qbxstokes.case.load import load_case
from qbxstokes.runs.cost import XEON, Constants, Estimate, estimate, weights
from qbxstokes.runs.scenes import Scenes
from qbxstokes.runs.sweep import layout_of

# One shear at the centre of each, so that the bodies turn alike; a slow stream lets them move.
FLOWS = {
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
HANDOUT = """\
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
            f"flow: {{type: polynomial, coefficients: {FLOWS[self.flow]}}}\n"
            f"time: {{end: {31.4 * self.periods / 2.0}, samples: {self.samples}, "
            "tolerance: 1e-9}\n"
            f"sweep: {{store: {self.store}, block: {self.block}, axes: "
            f"[{{start.orientation: {{random: axes, count: {self.count}, seed: 1}}}}]}}\n"
        )


@dataclass(frozen=True)
class Timed:
    """A trial with the seconds of its parts and the right-hand sides of all trajectories."""

    trial: Trial
    parts: dict[str, float]
    evaluations: float
    scenes: Scenes
    row_bytes: int

    @property
    def terms(self) -> list[float]:
        """What `rhs`, `call`, `sample` and `block` are multiplied by."""
        calls = self.evaluations * self.scenes.blocks / self.trial.count
        samples = self.trial.count * self.trial.samples
        return [self.evaluations, calls, samples, self.scenes.blocks - 1]

    @property
    def integration(self) -> float:
        """Seconds of the blocks without what their samples take whatever they hold, as known."""
        fixed = self.terms[3] * self.trial.samples * XEON.block_sample
        return self.parts["blocks"] - fixed


def timed(trial: Trial, folder: Path, words: Sequence[str]) -> Timed:
    """Run a trial."""
    path = folder / "sweep.yaml"
    few = replace(trial, count=2)
    told(few, path, words)  # compiles what has not been compiled yet
    start, all_of_it = (told(one, path, words) for one in (few, trial))
    spent, spared = all_of_it["wall_times"], start["wall_times"]
    parts = {n: spent.get(n, 0.0) - spared.get(n, 0.0) for n in ("blocks", "output", "waiting")}
    scenes = Scenes(load_case(path))
    return Timed(trial, parts, all_of_it["rhs_evaluations"], scenes, layout_of(scenes).row_bytes)


def told(trial: Trial, path: Path, words: Sequence[str], *more: str) -> dict[str, Any]:
    """What the command says of a trial."""
    path.write_text(trial.text())
    options = ["--json", "--overwrite", "--progress", "none", *more]
    told: dict[str, Any] = json.loads(
        run([*words, "-m", "qbxstokes", path.name, *options], path.parent).output
    )
    return told


def fitted(done: dict[str, Timed], handout: float, model: float) -> dict[str, float]:
    """The constants that the trials, by name, tell.

    Blocks: seconds = evaluations (rhs + call/bodies) + samples sample + blocks block, four trials
    for the four; output: seconds = trajectories layout + bytes stored_byte, two trials for the two.
    """
    names = ("massless, shear", "small blocks", "small short blocks", "many samples")
    four = [done[name] for name in names]
    rhs, *rest = np.linalg.solve([t.terms for t in four], [t.integration for t in four])
    two = [done[name] for name in ("many short ones", "all samples stored")]
    system = [[t.trial.count, t.trial.count * t.row_bytes] for t in two]
    layout, byte = np.linalg.solve(system, [t.parts["output"] for t in two])
    values = dict(zip(("call", "sample", "block"), rest, strict=True))
    values |= {"rhs_massless_linear": rhs, "layout": layout, "stored_byte": byte}
    values |= {"handout": handout, "model": model}
    for name, t in done.items():
        kind, _, flow = name.removesuffix(" flow").partition(", ")
        if flow in FLOWS:
            own = t.integration - float(np.dot(t.terms[1:], rest))
            values[f"rhs_{kind}_{flow}"] = own / t.evaluations
    for kind, name in (("massless", "massless, shear"), ("inertial", "inertial, linear flow")):
        t = done[name]
        expected = float(weights(t.scenes).mean()) * t.trial.count
        values[f"steps_{kind}"] = XEON.steps(kind == "inertial") * t.evaluations / expected
    return {name: float(value) for name, value in values.items()}


def trials(size: int, flows: Sequence[str]) -> list[Trial]:
    """Those that tell the constants."""
    base = Trial("massless, shear", 1024 * size)
    few = replace(base, count=128 * size)
    return [
        base,
        replace(few, name="small blocks", block=8),
        replace(few, name="small short blocks", block=8, periods=0.01),
        replace(few, name="many samples", samples=401),
        replace(few, name="all samples stored", samples=401, store="samples"),
        replace(base, name="many short ones", periods=0.01, count=8192 * size),
        *(
            replace(
                base, name=f"{kind}, {flow} flow", flow=flow, stokes_number=st, count=512 * size
            )
            for kind, st in (("massless", 0.0), ("inertial", 10.0))
            for flow in flows
            if (kind, flow) != ("massless", "linear")
        ),
    ]


def compared(timed: Timed, ranks: int, constants: Constants) -> dict[str, Any]:
    """A row of the model against a sweep; its body comes from the cache."""
    cost = estimate(timed.scenes, timed.row_bytes, replace(constants, model=0.0))
    spent, predicted, count = sum(timed.parts.values()), cost.seconds(ranks), timed.trial.count
    row = {"sweep": timed.trial.name, "trajectories": count, "ranks": ranks}
    row |= {"microseconds_each": 1e6 * ranks * spent / count, "measured": spent}
    return row | {"predicted": predicted, "ratio": spent / predicted}


def many(cost: Estimate) -> Rows:
    """What the model says of up to 10,000 ranks."""
    rows: Rows = []
    for ranks in (1, 2, 10, 100, 1000, 10_000):
        total = cost.seconds(ranks)
        row = {"ranks": ranks, "time": total, "efficiency": cost.work / total / ranks}
        rows.append(row | cost.parts(ranks))
    return rows


def main(small: bool = False) -> dict[str, Rows]:
    """Constants, the model against sweeps that were run, and its word on many ranks."""
    size = 1 if small else 16
    two = launcher(2)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        wanted = trials(size, ("linear", "centred") if small else tuple(FLOWS))
        done = {trial.name: timed(trial, folder, [sys.executable]) for trial in wanted}
        parallel = timed(wanted[0], folder, two)
        code = HANDOUT.format(count=1000 if small else 100_000)
        handout = float(run([*two, "-c", code], folder).output)
        formed = told(Trial("", 2), folder / "body.yaml", [sys.executable], "--no-cache")
        values = fitted(done, handout, formed["wall_times"]["models"])
        constants = replace(XEON, **values)
        (folder / "large.yaml").write_text(LARGE)
        scenes = Scenes(load_case(folder / "large.yaml"))
        cost = estimate(scenes, layout_of(scenes).row_bytes, constants)
    known = asdict(XEON)
    rows = [
        {"constant": item.name, "measured": values.get(item.name), "known": known[item.name]}
        for item in fields(XEON)
    ]
    runs = [(t, 1) for t in done.values()] + [(parallel, 2)]
    model = [compared(t, ranks, constants) for t, ranks in runs]
    return {"sweep_constants": rows, "sweep_model": model, "sweep_ranks": many(cost)}


if __name__ == "__main__":
    command(main)
