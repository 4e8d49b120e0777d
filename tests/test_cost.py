"""What runs will take: the parts of a sweep's time, and what is told against what is spent."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import pytest
from conftest import ROOT, Run

from qbxstokes.case.load import load_case
from qbxstokes.petsc import session
from qbxstokes.runs.block import lanes_of
from qbxstokes.runs.cost import begun, estimate
from qbxstokes.runs.sweep_blocks import Scenes
from qbxstokes.simulation.assembly import assemble
from qbxstokes.simulation.lanes import LaneRun

session.start()


def scenes_of(text: str, folder: Path) -> Scenes:
    path = folder / "sweep.yaml"
    path.write_text(text)
    return Scenes(load_case(path))


def test_parts_add_up_and_ranks_share_what_can_be_shared(tmp_path: Path) -> None:
    scenes = Scenes(load_case(ROOT / "cases" / "benchmarks" / "ten_million.yaml"))
    cost = estimate(scenes)
    for ranks in (1, 7, 1000):
        assert cost.seconds(ranks) > (cost.integration + cost.output) / ranks
    assert cost.seconds(1) > 100 * cost.seconds(1_000_000_000)
    assert cost.seconds(10**9) > cost.layout + cost.handout + 0.5 * cost.last_block


USER = """
import numpy as np
def shear(x):
    return x[..., [1, 0, 0]] * np.array([1.0, 0.0, 0.0])
"""
AXES = {"sweep": {"axes": [{"start.orientation": {"random": "axes", "count": 12, "seed": 1}}]}}
TIMED: dict[str, tuple[dict[str, Any], float]] = {
    "massless": ({"body": {"aspect_ratio": 0.5}, "flow": {"type": "shear"}}, 40),
    "thin and inertial": (
        {"body": {"aspect_ratio": 0.05, "stokes_number": 5}, "flow": {"type": "shear"}},
        0.02,
    ),
    "quadratic": ({"body": {"aspect_ratio": 2}, "flow": {"type": "paraboloid"}}, 20),
    "a user's": (
        {"body": {"aspect_ratio": 0.5}, "flow": {"type": "user", "function": "flow.py:shear"}},
        0.2,
    ),
}


@pytest.mark.parametrize("name", TIMED)
def test_what_a_block_will_take_is_told_within_a_factor_of_two(name: str, tmp_path: Path) -> None:
    """Processor times, the least of several: what else the machine does has little part in them."""
    (tmp_path / "flow.py").write_text(USER)
    given, turns = TIMED[name]
    case = given | AXES | {"time": {"end": 30.0 * turns, "samples": 21}}
    scenes = scenes_of(json.dumps(case | {"start": {"position": [0, 0.5, 0]}}), tmp_path)
    ((scene, members),) = scenes.block(0).pieces
    lanes, times = lanes_of(scenes, scene, members), scenes.scene(0).plan.times
    assembled = assemble([lanes], evaluation="compiled")
    told, spent = list[float](), list[float]()
    for _ in range(3):
        told.append(begun([lanes], times, scenes.quantities, evaluation="compiled"))
        run, begin = LaneRun.of(assembled, times), time.process_time()
        run.go()
        assembled.averages(times, run.samples(scenes.quantities))
        spent.append(time.process_time() - begin)
    assert 0.5 < min(told) / min(spent) < 2.0, f"{told} s told, {spent} s spent"


def test_single_runs_are_told_what_they_take(run_cli: Run, tmp_path: Path) -> None:
    base = {"body": {"aspect_ratio": 0.5}, "flow": {"type": "shear"}}
    field = {"task": "field", "field": {"plane": {"shape": [200, 200]}}}
    wall = {"surroundings": {"type": "wall"}, "start": {"position": [0, 3, 0]}}
    beside = {**wall, "time": {"end": 5, "tolerance": 1e-4}, "hydrodynamics": {"tolerance": 1e-4}}
    suspension = {"task": "rheology", "rheology": {"peclet_number": [1, 10, 100]}}
    random = {"task": "rheology", "rheology": {"peclet_number": [1], "langevin": {"strain": 5}}}
    for more in (field, {"time": {"periods": 3}}, beside, suspension, random):
        (tmp_path / "case.yaml").write_text(json.dumps(base | more))
        facts = json.loads(run_cli("case.yaml", "--dry-run", "--json").stdout)
        assert 0.01 < facts["plan"]["seconds"] < 60.0
        assert "within a factor of 2" in " ".join(run_cli("case.yaml", "--dry-run").stdout.split())
