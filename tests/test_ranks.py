"""Every task on two ranks gives the numbers it gives on one, and both end."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

Run, WriteCase = Callable[..., Any], Callable[..., Path]

SHEAR: dict[str, Any] = {"flow": {"type": "shear"}, "hydrodynamics": {"tolerance": 1e-2}}
ONE = SHEAR | {"body": {"aspect_ratio": 0.5}}
BODIES = [
    {
        "aspect_ratio": 0.5,
        "start": {"position": [0, 1.6, 0], "orientation": {"axis": [1, 0.3, 0]}},
    },
    {"aspect_ratio": 2, "size": 0.6, "start": {"position": [2.6, 1.3, 0.1]}},
]
PAIR = SHEAR | {"bodies": BODIES, "surroundings": {"type": "wall"}}
HEAVY = SHEAR | {"bodies": [body | {"stokes_number": 2} for body in BODIES]}
TIME = {"time": {"end": 0.5, "samples": 2, "tolerance": 1e-2}}
LINES: dict[str, Any] = {
    "plane": {"extent": [-2, 4, 0.2, 3], "shape": [7, 4]},
    "surface": {"shape": [5, 8]},
    "shells": {"distances": [0.1], "shape": [5, 8]},
    "streamlines": {"start": [-2, 0.3, 0], "stop": [-2, 2.8, 0], "number": 2, "length": 2},
    "tracers": {"start": [-3, 0.3, 0], "stop": [-3, 2.8, 0], "number": 2, "samples": 3},
}
for line in ("streamlines", "tracers"):
    LINES[line]["tolerance"] = 1e-2
HELD = {
    "task": "field",
    "field": LINES | {"body": "held", "tracers": LINES["tracers"] | {"duration": 0.5}},
}
CASES = {
    "body": ONE | {"task": "body"},
    "pair": PAIR | TIME,
    "heavy pair": HEAVY | TIME,
    "pairs": PAIR | TIME | {"sweep": {"axes": [{"bodies[1].aspect_ratio": [0.8, 1, 2]}]}},
    "field": ONE | HELD,
    "field of motion": ONE | TIME | {"field": LINES | {"every": 1}},
    "field among": PAIR | HELD,
    "field among moving": PAIR | TIME | {"field": LINES | {"every": 1}},
    "no tracers": PAIR | TIME | {"field": LINES | {"every": 1, "tracers": None}},
    "rheology": ONE | {"task": "rheology", "rheology": {"peclet_number": [1.0, 10.0]}},
}
QUICK = ("body", "field among moving")
KINDS = [pytest.param(k, marks=() if k in QUICK else pytest.mark.slow) for k in CASES]


def contents(path: Path) -> dict[str, Any]:
    """Every dataset of numbers of a result, without times spent."""
    found: dict[str, Any] = {}

    def look(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and item.dtype.kind in "fi" and "time" not in name:
            found[name] = item[()]

    with h5py.File(path) as file:
        file.visititems(look)
    return found


@pytest.mark.mpi
@pytest.mark.parametrize("kind", KINDS)
def test_two_ranks_give_what_one_gives(
    kind: str, run_cli: Run, mpirun: Run, write_case: WriteCase, tmp_path: Path
) -> None:
    path = write_case(CASES[kind])
    assert run_cli(path.name, "--set", "output.file=one.h5", "--quiet").returncode == 0
    done = mpirun(2, path.name, "--set", "output.file=two.h5", "--quiet")
    assert done.returncode == 0, done.stderr
    one, two = contents(tmp_path / "one.h5"), contents(tmp_path / "two.h5")
    assert one.keys() == two.keys()
    for name, values in one.items():
        np.testing.assert_allclose(two[name], values, rtol=1e-9, atol=1e-9, err_msg=name)
