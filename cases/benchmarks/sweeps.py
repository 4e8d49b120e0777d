"""What a sweep costs: the constants by which `--dry-run` reckons, fitted to sweeps.

The model is that of `qbxstokes/runs/cost.py`. Its constants are told by sweeps of random
orientations that differ in one thing each; seconds are those of the parts of the command beyond the
ones of a sweep of two trajectories.

Run:      python cases/benchmarks/sweeps.py      (4 min; --small: 40 s; --csv)
Expected: the model, with these constants, within a factor of 1.4 of each sweep.
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from command import run
from measure import Rows, command

from qbxstokes.case.load import load_case
from qbxstokes.runs.cost import XEON, estimate, weights
from qbxstokes.runs.scenes import Scenes
from qbxstokes.runs.sweep import layout_of

# One shear at the centre of each, so that the bodies turn alike; a slow stream lets them move.
FLOWS = {
    "linear": "{u1: {'1': 1.0e-9, x2: 1}}",
    "centred": "{u1: {x2: 1}}",
    "quadratic": "{u1: {x2: 1, x2^2: 0.25, x3^2: 0.25}}",
    "cubic": "{u1: {'1': 1.0e-9, x2: 1, x2^3: 0.1}, u2: {x1^3: 0.1}}",
}
CASE = """\
body: {{aspect_ratio: 0.5, stokes_number: {stokes_number}}}
flow: {{type: polynomial, coefficients: {coefficients}}}
time: {{end: {end}, samples: {samples}, tolerance: 1e-9}}
sweep:
  store: {store}
  block: {block}
  axes: [{{start.orientation: {{random: axes, count: {count}, seed: 1}}}}]
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
        end = 31.4 * self.periods / 2.0
        return CASE.format(coefficients=FLOWS[self.flow], end=end, **vars(self))


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


def told(trial: Trial, path: Path, *more: str) -> dict[str, Any]:
    """What the command says of a trial."""
    path.write_text(trial.text())
    words = [sys.executable, "-m", "qbxstokes", path.name, "--json", "--overwrite", *more]
    told: dict[str, Any] = json.loads(run([*words, "--progress", "none"], path.parent)[1])
    return told


def timed(trial: Trial, path: Path) -> Timed:
    """Run a trial."""
    few = replace(trial, count=2)
    told(few, path)  # compiles what has not been compiled yet
    start, end = told(few, path), told(trial, path)
    spent, spared = end["wall_times"], start["wall_times"]
    parts = {n: spent.get(n, 0.0) - spared.get(n, 0.0) for n in ("blocks", "output", "waiting")}
    scenes = Scenes(load_case(path))
    return Timed(trial, parts, end["rhs_evaluations"], scenes, layout_of(scenes).row_bytes)


def fitted(done: dict[str, Timed]) -> dict[str, float]:
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
    few, other = replace(base, count=128 * size), replace(base, count=512 * size)
    heavy = replace(other, stokes_number=10.0)
    return [
        base,
        replace(few, name="small blocks", block=8),
        replace(few, name="small short blocks", block=8, periods=0.01),
        replace(few, name="many samples", samples=401),
        replace(few, name="all samples stored", samples=401, store="samples"),
        replace(base, name="many short ones", periods=0.01, count=8192 * size),
        *(replace(other, name=f"massless, {flow} flow", flow=flow) for flow in flows[1:]),
        *(replace(heavy, name=f"inertial, {flow} flow", flow=flow) for flow in flows),
    ]


def main(small: bool = False) -> dict[str, Rows]:
    """Constants, and the model against the sweeps that were run."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "sweep.yaml")
        wanted = trials(1 if small else 16, list(FLOWS)[: 2 if small else None])
        done = {trial.name: timed(trial, path) for trial in wanted}
        formed = told(Trial("", 2), path, "--no-cache")["wall_times"]["models"]
    values = fitted(done) | {"model": formed}
    constants = [
        {"constant": name, "measured": value, "known": getattr(XEON, name)}
        for name, value in values.items()
    ]
    model: Rows = []
    now = replace(XEON, **(values | {"model": 0.0}))  # the body comes from the cache
    for name, t in done.items():
        spent = sum(t.parts.values())
        predicted = estimate(t.scenes, t.row_bytes, now).seconds(1)
        row = {"sweep": name, "trajectories": t.trial.count, "measured": spent}
        model.append(row | {"predicted": predicted, "ratio": spent / predicted})
    return {"sweep_constants": constants, "sweep_model": model}


if __name__ == "__main__":
    command(main)
