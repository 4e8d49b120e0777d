"""Results that show the parts of a sweep instead of holding them: moved, damaged, mended."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from conftest import Run

import qbxstokes as qs
from qbxstokes.errors import ConvergenceError, ResultFileError
from qbxstokes.io.names import parts_of
from qbxstokes.io.sweep_result import _even, _slices

CASE: dict[str, Any] = {
    "body": {"aspect_ratio": 0.5},
    "flow": {"type": "shear"},
    "time": {"end": 5.0, "samples": 6, "tolerance": 1e-6},
    "hydrodynamics": {"tolerance": 1e-6},
    "checkpoint": {"every": "1e-6 s"},
    "output": {"merge": False},
    "sweep": {
        "block": 3,
        # The slower axis makes no scene, so that the rows of a block lie apart.
        "axes": [
            {"start.orientation": {"random": "rotations", "count": 5, "seed": 3}},
            {"body.stokes_number": [0, 5]},
        ],
    },
}


def contents(path: Path) -> dict[str, bytes]:
    with h5py.File(path) as file:
        found = {name: item[()] for name, item in file.items() if isinstance(item, h5py.Dataset)}
    table = found.pop("table")
    columns = {name: table[name] for name in table.dtype.names if name != "wall_time"}
    return {name: values.tobytes() for name, values in {**found, **columns}.items()}


@pytest.fixture
def shown(run_cli: Run, write_case: Callable[..., Path], tmp_path: Path) -> Path:
    """A result of parts, and `whole.h5`, which is merged."""
    write_case(CASE)
    told = run_cli(
        "case.yaml", "--quiet", "--set", "output.file=whole.h5", "--set", "output.merge=true"
    )
    assert told.returncode == 0, told.stderr
    told = run_cli("case.yaml", "--progress", "none")
    assert told.returncode == 0, told.stderr
    assert "which shows what stands in case.h5.parts" in told.stdout
    return tmp_path / "case.h5"


def test_it_opens_as_if_it_were_one(shown: Path, run_cli: Run, tmp_path: Path) -> None:
    whole = tmp_path / "whole.h5"
    assert contents(shown) == contents(whole)
    assert not parts_of(whole).exists()
    held, seen = qs.load(whole), qs.load(shown)
    assert seen.names == held.names
    np.testing.assert_equal(seen.table["end"], held.table["end"])
    np.testing.assert_array_equal(seen.trajectory(7).axis, held.axis[7])
    # A moved folder keeps working, and so does a result under another name.
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    for path in (shown, parts_of(shown)):
        shutil.move(path, elsewhere)
    (elsewhere / "case.h5").rename(elsewhere / "other.h5")
    assert contents(elsewhere / "other.h5") == contents(whole)
    drawn = ["plot", "--output", "p", "--x", "stokes_number", "--y", "end"]
    for words in (["info"], drawn, ["plot", "--trajectory", "3"]):
        told = run_cli(words[0], "elsewhere/other.h5", *words[1:])
        assert told.returncode == 0, told.stderr


def test_what_lacks_a_part_is_told_and_mended(shown: Path, run_cli: Run, tmp_path: Path) -> None:
    part = sorted(parts_of(shown).glob("blocks-*.h5"))[1]
    whole = part.read_bytes()
    for damage, told in ((whole[:-100], "is damaged"), (None, "is not there")):
        part.unlink()
        if damage is not None:
            part.write_bytes(damage)
        with pytest.raises(ResultFileError, match=rf"{part.name}, which {told}.*--resume"):
            qs.load(shown)
        assert run_cli("info", "case.h5").returncode == 2
    assert run_cli("case.yaml", "--resume", "--quiet").returncode == 0
    assert contents(shown) == contents(tmp_path / "whole.h5")
    # Bytes that have changed are noticed where they are read.
    flipped = bytearray(whole := part.with_name("blocks-0001-00000-000001.h5").read_bytes())
    with h5py.File(part.with_name("blocks-0001-00000-000001.h5")) as file:
        info = file["axis"].id.get_chunk_info(0)
    flipped[info.byte_offset + 9] ^= 1
    part.with_name("blocks-0001-00000-000001.h5").write_bytes(bytes(flipped))
    assert len(flipped) == len(whole)
    with pytest.raises(ResultFileError, match="is damaged"):
        qs.load(shown)["axis"]


def test_it_is_left_alone_or_merged_or_replaced(shown: Path, run_cli: Run, tmp_path: Path) -> None:
    whole = contents(tmp_path / "whole.h5")
    told = run_cli("case.yaml", "--resume")
    assert "finished already, nothing to resume" in told.stdout
    # A new run takes a name of its own, also where the parts alone are left.
    assert run_cli("case.yaml", "--quiet").returncode == 0
    assert contents(tmp_path / "case-1.h5") == whole
    shown.rename(tmp_path / "kept.h5")
    assert run_cli("case.yaml", "--quiet").returncode == 0
    assert contents(tmp_path / "kept.h5") == contents(tmp_path / "case-2.h5") == whole
    (tmp_path / "kept.h5").rename(shown)
    assert run_cli("case.yaml", "--quiet", "--overwrite").returncode == 0
    assert contents(shown) == whole
    assert run_cli("case.yaml", "--resume", "--quiet", "--set", "output.merge=true").returncode == 0
    assert contents(shown) == whole
    assert sorted(os.listdir(tmp_path)) == sorted(
        [
            "case.yaml",
            "case.h5",
            "whole.h5",
            *(f"case-{i}.h5{s}" for i in (1, 2) for s in ("", ".parts")),
        ]
    )


def test_failures_are_mended_in_parts_that_follow(
    run_cli: Run, write_case: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from qbxstokes.petsc import stepper

    write_case(CASE)
    integrate = stepper.integrate

    def failing(equations: Any, *arguments: Any, **options: Any) -> Any:
        if np.any(equations.stokes_number == 5):
            raise ConvergenceError("steps grew too small")
        return integrate(equations, *arguments, **options)

    with monkeypatch.context() as patch:
        patch.setattr(stepper, "integrate", failing)
        assert run_cli("case.yaml", "--quiet").returncode == 1
    result = qs.load(tmp_path / "case.h5")
    assert result.table["status"].tolist() == [1, 2] * 5
    assert result.summary["failed"] == 5
    assert run_cli("case.yaml", "--resume", "--quiet").returncode == 0
    assert qs.load(tmp_path / "case.h5").summary["failed"] == 0
    merged = ("--quiet", "--set", "output.file=whole.h5", "--set", "output.merge=true")
    assert run_cli("case.yaml", *merged).returncode == 0
    assert contents(tmp_path / "case.h5") == contents(tmp_path / "whole.h5")


def test_from_python_and_for_sweeps_alone(
    run_cli: Run, write_case: Callable[..., Path], tmp_path: Path
) -> None:
    case = {key: CASE[key] for key in ("body", "flow", "time", "hydrodynamics")}
    axes = {"body.stokes_number": [0, 2]}
    seen = qs.sweep(case, axes, file=tmp_path / "a.h5", merge=False)
    assert (tmp_path / "a.h5.parts").is_dir()
    np.testing.assert_array_equal(seen.axis, qs.sweep(case, axes).axis)
    write_case({**case, "output": {"merge": False}})
    told = run_cli("case.yaml")
    assert told.returncode == 2
    assert "output.merge: only a sweep has parts to show" in told.stderr
    told = run_cli("check", write_case(CASE).name)
    assert told.returncode == 0


@pytest.mark.mpi
def test_two_ranks_show_what_one_holds(
    mpirun: Run, run_cli: Run, write_case: Callable[..., Path], tmp_path: Path
) -> None:
    write_case(CASE | {"checkpoint": {"every": "60 s"}})
    assert mpirun(2, "case.yaml", "--quiet").returncode == 0
    merged = ("--quiet", "--set", "output.file=whole.h5", "--set", "output.merge=true")
    assert run_cli("case.yaml", *merged).returncode == 0
    assert contents(tmp_path / "case.h5") == contents(tmp_path / "whole.h5")
    assert len(list((tmp_path / "case.h5.parts").glob("blocks-*"))) <= 2


def test_stretches_that_rise_evenly() -> None:
    rng = np.random.default_rng(0)
    rows = [np.arange(4), 3 + 2 * np.arange(5), np.array([5]), np.array([9, 2, 3, 7, 8])]
    rows += [rng.permutation(40), np.sort(rng.choice(99, 30, replace=False)), np.arange(0)]
    for numbers in rows:
        places = np.sort(rng.choice(200, len(numbers), replace=False))
        cut = [list(_slices(part)) for part in _even(numbers, places)]
        everything = np.arange(200)
        for part, values in zip(cut, (numbers, places), strict=True):
            assert [n for piece in part for n in everything[piece]] == values.tolist()
    assert len(_even(np.arange(3, 90, 3), np.arange(29))[0]) == 1


def test_the_disk_that_is_needed_is_told(
    run_cli: Run, write_case: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    write_case(CASE)
    told = run_cli("case.yaml", "--dry-run")
    assert "in parts that stay in case.h5.parts" in " ".join(told.stdout.split())
    facts = json.loads(run_cli("case.yaml", "--dry-run", "--json").stdout)
    usage = shutil.disk_usage(".")
    needed = facts["bytes_on_disk"]
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=needed + 10))
    assert run_cli("case.yaml", "--quiet").returncode == 0
    told = run_cli("case.yaml", "--quiet", "--set", "output.merge=true")
    assert told.returncode == 1
    assert "output.merge: false" in told.stderr
