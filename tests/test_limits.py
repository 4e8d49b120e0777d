"""What a machine does not give: room on the disk, memory, an output; told in a line, beforehand."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import ENVIRONMENT, Run

import qbxstokes as qs
from qbxstokes.runs.parallel import guarded
from qbxstokes.runs.sharing import ALONE

SHEAR: dict[str, Any] = {
    "body": {"aspect_ratio": 0.5},
    "flow": {"type": "shear"},
    "hydrodynamics": {"tolerance": 1e-6},
}
MOTION = {**SHEAR, "time": {"end": 1, "samples": 3}}
SWEEP = {**MOTION, "sweep": {"axes": [{"body.stokes_number": [0, 1]}]}}
FIELD = {
    "task": "field",
    **{key: SHEAR[key] for key in ("body", "flow")},
    "field": {"plane": {"shape": [20, 20]}, "check": 2, "vtk": False},
}
TWICE = {"motion": MOTION, "sweep": SWEEP, "field": FIELD}
ABSURD = [
    (MOTION, "time.samples=100000000", "must be <= 1e+07"),
    (SWEEP, "sweep.axes=[{start.orientation: {random: axes, count: 1e9}}]", "the sweep needs"),
    (SWEEP, "sweep.axes=[{start.orientation: {random: axes, count: 1e11}}]", "blocks"),
    (FIELD, "field.box.shape=[2000, 2000, 2000]", "the field needs"),
]


@pytest.mark.parametrize(("case", "change", "told"), ABSURD, ids=[c for _, c, _ in ABSURD])
def test_absurd_sizes_are_refused_before_anything_is_made(
    case: dict[str, Any],
    change: str,
    told: str,
    run_cli: Run,
    write_case: Callable[..., Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    path = write_case(case)
    usage = shutil.disk_usage(path)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=20 * 10**9))
    done = run_cli(path.name, "--quiet", "--set", change)
    assert done.returncode in (1, 2)
    assert told in done.stderr
    assert done.stderr.count("\n") == 1
    assert os.listdir(tmp_path) == [path.name]
    if "blocks" in told:
        assert run_cli(path.name, "--dry-run", "--set", change).returncode == 2


def process(folder: Path, *words: str, out: str = "/dev/full") -> subprocess.CompletedProcess[str]:
    with open(out, "w") as stream:
        return subprocess.run(
            [sys.executable, "-m", "qbxstokes", *words],
            cwd=folder,
            env=os.environ | ENVIRONMENT,
            stdout=stream,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
def test_an_output_that_is_full_is_told(write_case: Callable[..., Path], tmp_path: Path) -> None:
    path = write_case(MOTION)
    for words in ([path.name], ["check", path.name], ["info", "case.h5"], ["schema"], ["--help"]):
        done = process(tmp_path, *words)
        assert done.returncode == 1, words
        assert done.stderr == (
            "qbxstokes: standard output: cannot be written (No space left on device)\n"
        )
    assert len(qs.load(tmp_path / "case.h5").time) == 3  # the result itself is there


def test_outputs_that_are_closed_or_full_end_nothing(
    write_case: Callable[..., Path], tmp_path: Path
) -> None:
    path = write_case(MOTION)
    command = f"{sys.executable} -m qbxstokes"
    full = [f"{command} {path.name} --overwrite 2>/dev/full"] if Path("/dev/full").exists() else []
    for line in (f"{command} info {path.name} >&-", f"{command} --version 2>&-", *full):
        keys = {"cwd": tmp_path, "env": os.environ | ENVIRONMENT, "text": True}
        qs.run(path, file=tmp_path / "case.h5") if not (tmp_path / "case.h5").exists() else None
        (tmp_path / "case-orbit.pdf").write_text("older, which is remarked")
        done = subprocess.run(["sh", "-c", line], capture_output=True, **keys)
        assert (done.returncode, "Traceback" in done.stderr) == (0, False), line


def closed_pipe(folder: Path, *words: str, both: bool = False) -> tuple[int, str]:
    """Exit status and standard error where nobody reads the output (`| true`, `2>&1 | true`)."""
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run(
        [sys.executable, *words],
        cwd=folder,
        env=os.environ | ENVIRONMENT,
        stdout=write,
        stderr=write if both else subprocess.PIPE,
        text=True,
        check=False,
    )
    os.close(write)
    return done.returncode, done.stderr or ""


def test_who_stops_reading_disturbs_nothing(
    write_case: Callable[..., Path], tmp_path: Path
) -> None:
    path = write_case(MOTION)
    program = ("-m", "qbxstokes")
    for words in ([path.name], ["doctor"], ["help", "keys"]):  # PETSc runs in two of them
        assert closed_pipe(tmp_path, *program, *words) == (0, ""), words
    swept = write_case(MOTION | {"sweep": {"axes": [{"time.end": [1.0, 2.0]}]}}, "swept.yaml")
    assert closed_pipe(tmp_path, *program, swept.name, "--progress", "line", both=True)[0] == 0
    assert (qs.load(tmp_path / "swept.h5").table["status"] == 1).all()
    assert closed_pipe(tmp_path, *program, "no.yaml", both=True)[0] == 2


def test_memory_that_does_not_suffice_is_told(capfd: pytest.CaptureFixture[str]) -> None:
    def greedy() -> int:
        raise MemoryError("Unable to allocate 7.28 TiB for an array")

    assert guarded(ALONE, greedy) == 1
    assert capfd.readouterr().err == (
        "qbxstokes: out of memory (Unable to allocate 7.28 TiB for an array); what was finished "
        "is kept\n"
    )


@pytest.mark.parametrize(
    "kind",
    [pytest.param(k, marks=() if k == "field" else pytest.mark.slow) for k in TWICE],
)
def test_of_two_programs_in_one_place_one_runs(
    kind: str, write_case: Callable[..., Path], tmp_path: Path
) -> None:
    """Started at once: one is refused in one true line, or takes a name of its own."""
    case = TWICE[kind]
    if kind != "field":
        case = case | {"time": {"end": 2e4, "samples": 3}}
    else:
        case = case | {"field": {**FIELD["field"], "plane": {"shape": [400, 400]}}}
    path = write_case(case)
    told: list[subprocess.CompletedProcess[str]] = []

    def run() -> None:
        told.append(process(tmp_path, path.name, "--quiet", out=os.devnull))

    both = [threading.Thread(target=run) for _ in "ab"]
    for thread in both:
        thread.start()
    for thread in both:
        thread.join()
    told.sort(key=lambda done: done.returncode)
    assert told[0].returncode == 0, told[0].stderr
    assert qs.load(tmp_path / "case.h5").summary
    if told[1].returncode:
        assert told[1].returncode == 2
        assert "another run is writing here (process " in told[1].stderr
        assert told[1].stderr.count("\n") == 1
        assert "overwrite" not in told[1].stderr
    else:  # the first had ended already
        assert qs.load(tmp_path / "case-1.h5").summary
    assert not list(tmp_path.glob("*.parts"))
    assert not list(tmp_path.glob(".*"))


def test_one_rule_for_names(run_cli: Run, write_case: Callable[..., Path], tmp_path: Path) -> None:
    """A finished result stays, and the next run takes a numbered name, whatever the task."""
    for name, case in (("m", MOTION), ("s", SWEEP), ("f", FIELD)):
        write_case(case, f"{name}.yaml")
        for _ in range(2):
            assert run_cli(f"{name}.yaml", "--quiet").returncode == 0
        assert (tmp_path / f"{name}-1.h5").exists()
        assert run_cli(f"{name}.yaml", "--quiet", "--resume").returncode == 0
        assert not (tmp_path / f"{name}-2.h5").exists()


@pytest.mark.slow
def test_foreign_and_damaged_files_are_told(
    run_cli: Run, write_case: Callable[..., Path], tmp_path: Path
) -> None:
    """A result cut off or overwritten anywhere: a line, never a traceback or a hang."""
    for name, case in (("m", MOTION), ("s", SWEEP)):
        assert run_cli(write_case(case, f"{name}.yaml").name, "--quiet").returncode == 0
        whole = (tmp_path / f"{name}.h5").read_bytes()
        for part in range(12):
            begin, size = part * len(whole) // 12, len(whole) // 12
            (tmp_path / "damaged.h5").write_bytes(whole[:begin])
            assert run_cli("info", "damaged.h5").returncode == 2
            # HDF5 itself would read some of these without end.
            (tmp_path / "damaged.h5").write_bytes(
                whole[:begin] + bytes(size) + whole[begin + size :]
            )
            done = run_cli("plot", "damaged.h5", "--output", "p")
            assert done.returncode in (0, 2), (part, done.stderr)
    import h5py

    with h5py.File(tmp_path / "foreign.h5", "w") as file:
        file["x"] = [1.0]
    for task in ("motion", "sweep", "field", "body", "dance"):
        with h5py.File(tmp_path / "ours.h5", "w") as file:
            file.attrs.update(format="qbxstokes", format_version=1, task=task)
            file.create_group("summary")
            file["table"] = [1.0]
        for name in ("foreign.h5", "ours.h5"):
            for words in (["info"], ["plot"]):
                done = run_cli(words[0], name)
                assert done.returncode in (0, 2), (task, name, words)
    assert json.loads(run_cli("info", "m.h5", "--json").stdout)["task"] == "motion"


@pytest.mark.parametrize("k", [0.02, 0.05, 50.0])
def test_thin_bodies_keep_their_period(k: float) -> None:
    """Ten periods at 1e-10: the small part of the law is solved to its own relative accuracy."""
    axis, end = np.array([0.48, 0.6, 0.64]), 20.0 * np.pi * (k + 1.0 / k)
    motion = qs.Body(k).integrate(qs.flow("shear"), [end], orientation=axis, tolerance=1e-10)
    assert np.abs(motion.axis[-1] - axis).max() < 1e-9
