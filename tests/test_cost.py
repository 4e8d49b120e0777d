"""The cost model of sweeps: its parts, its count of steps, and the fit of its constants."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT, script

from qbxstokes.case.load import load_case
from qbxstokes.runs.cost import XEON, Constants, block_seconds, estimate, weights
from qbxstokes.runs.scenes import Scenes
from qbxstokes.runs.sweep import layout_of

sweeps = script("benchmarks/sweeps")


def scenes_of(text: str, folder: Path) -> Scenes:
    path = folder / "sweep.yaml"
    path.write_text(text)
    return Scenes(load_case(path))


def test_parts_add_up_and_ranks_share_what_can_be_shared(tmp_path: Path) -> None:
    scenes = Scenes(load_case(ROOT / "cases" / "benchmarks" / "ten_million.yaml"))
    cost = estimate(scenes, layout_of(scenes).row_bytes)
    for ranks in (1, 7, 1000):
        assert cost.seconds(ranks) == pytest.approx(sum(cost.parts(ranks).values()))
        assert cost.parts(ranks)["integration"] == pytest.approx(cost.integration / ranks)
    assert cost.work == cost.seconds(1) > 900 * cost.seconds(1_000_000_000)
    assert cost.seconds(10**9) > cost.layout + cost.handout + 0.5 * cost.last_block
    assert cost.integration == pytest.approx(block_seconds(scenes).sum())


def test_a_constant_weighs_on_its_own_part_alone(tmp_path: Path) -> None:
    scenes = scenes_of(sweeps.Trial("a", 100, samples=5, store="samples").text(), tmp_path)
    size = layout_of(scenes).row_bytes
    base = estimate(scenes, size).parts(1)
    parts = {
        "rhs_massless_linear": "integration",
        "call": "integration",
        "steps_massless": "integration",
        "sample": "output",
        "stored_byte": "output",
        "handout": "hand-out",
        "layout": "layout",
        "model": "models",
    }
    for name, part in parts.items():
        changed = replace(XEON, **{name: 2.0 * getattr(XEON, name)})
        other = estimate(scenes, size, changed).parts(1)
        assert [key for key in base if other[key] != base[key]] == [part]


@pytest.mark.parametrize("stokes_number", [0.0, 10.0])
def test_the_count_of_right_hand_sides_is_near(
    stokes_number: float, run_cli: Callable[..., object], tmp_path: Path
) -> None:
    import json

    trial = sweeps.Trial("a", 64, stokes_number=stokes_number)
    scenes = scenes_of(trial.text(), tmp_path)
    told = run_cli("sweep.yaml", "--json", "--progress", "none")
    measured = json.loads(told.stdout)["rhs_evaluations"] / trial.count  # type: ignore[attr-defined]
    assert 0.5 < float(weights(scenes).mean()) / measured < 2.0


def test_the_fit_finds_the_constants_that_made_the_times(tmp_path: Path) -> None:
    """Times made of known constants; nothing is measured."""
    known = Constants(
        **{item.name: getattr(XEON, item.name) * (1.3 + 0.1 * i)
           for i, item in enumerate(fields(XEON))}
    )  # fmt: skip
    base = sweeps.Trial("massless, shear", 2048)
    trials = [
        base,
        replace(base, name="small blocks", block=8, count=256),
        replace(base, name="small short blocks", block=8, count=256, periods=0.01),
        replace(base, name="many samples", samples=401, count=256),
        replace(base, name="all samples stored", samples=401, count=256, store="samples"),
        replace(base, name="many short ones", periods=0.01, count=16384),
        replace(base, name="inertial, linear flow", stokes_number=10.0, count=1024),
        replace(base, name="massless, cubic flow", flow="cubic", count=1024),
        replace(base, name="massless, centred flow", flow="centred", count=1024),
    ]
    done = {}
    for trial in trials:
        scenes = scenes_of(trial.text(), tmp_path)
        inertial = trial.stokes_number > 0
        calls = float(weights(scenes, known).mean())
        evaluations = calls * trial.count
        degree = {"linear": 1, "centred": 1, "cubic": 3}[trial.flow]
        rhs = known.rhs(inertial, degree, trial.flow == "centred")
        size = layout_of(scenes).row_bytes
        parts = {
            "blocks": evaluations * rhs
            + calls * scenes.blocks * known.call
            + trial.count * trial.samples * known.sample
            # The first block is part of the start; samples of a block are not fitted.
            + (scenes.blocks - 1) * (known.block + trial.samples * XEON.block_sample),
            "output": trial.count * (known.layout + size * known.stored_byte),
            "waiting": 0.0,
        }
        done[trial.name] = sweeps.Timed(trial, parts, evaluations, scenes, size)
    found = sweeps.fitted(done)
    names = set(found)
    assert {"call", "block", "rhs_massless_cubic", "rhs_inertial_linear", "layout"} < names
    assert "rhs_massless_centred" in names
    assert "rhs_general" not in names
    for name in names - {"steps_massless", "steps_inertial"}:
        assert found[name] == pytest.approx(getattr(known, name), rel=1e-6), name
    # Samples take right-hand sides as well, which no number of steps changes.
    for name in ("steps_massless", "steps_inertial"):
        assert np.isclose(found[name], getattr(known, name), rtol=0.05), name
