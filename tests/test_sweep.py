"""Sweeps in one process: axes and their faults, numbers against references, files, resumption."""

from __future__ import annotations

import errno
import json
import math
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

import qbxstokes
from qbxstokes.case.document import parse_key
from qbxstokes.case.load import load_case
from qbxstokes.case.sweep import column_name
from qbxstokes.cli.main import run_command
from qbxstokes.errors import CaseError
from qbxstokes.geometry import rotation
from qbxstokes.io import store, sweep_result
from qbxstokes.io.names import parts_of
from qbxstokes.io.store import holds_work, read_part
from qbxstokes.motion.averages import ShearFrame, turn_averages
from qbxstokes.quantities import MOTION
from qbxstokes.reference import inertial, jeffery
from qbxstokes.runs.sweep_blocks import Scenes

CASE: dict[str, Any] = {
    "body": {"aspect_ratio": 0.5},
    "flow": {"type": "shear"},
    "time": {"end": 10.0, "samples": 21, "tolerance": 1e-8},
    "hydrodynamics": {"tolerance": 1e-8},
}
SHEAR = np.zeros((3, 3))
SHEAR[0, 1] = 1.0
RANDOM = {"start.orientation": {"random": "rotations", "count": 6, "seed": 3}}

ROOT = Path(qbxstokes.__file__).parents[1]

Sweep = Callable[..., Any]


@pytest.fixture
def write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Path]:
    """A case file with the given axes in the working directory."""
    monkeypatch.chdir(tmp_path)

    def write(*axes: dict[str, Any], **changes: Any) -> Path:
        sweep = {"axes": list(axes), **changes.pop("sweep", {})}
        path = tmp_path / "case.yaml"
        path.write_text(json.dumps(CASE | {"sweep": sweep} | changes, indent=1))
        return path

    return write


@pytest.fixture
def sweep(write: Callable[..., Path], capfd: pytest.CaptureFixture[str]) -> Sweep:
    """Run a sweep and return its result; `status` is what the command must return."""

    def run(*axes: dict[str, Any], status: int = 0, options: Any = (), **changes: Any) -> Any:
        path = write(*axes, **changes)
        ended = run_command([str(path), "--progress", "none", "--overwrite", *options])
        assert ended == status, capfd.readouterr().err
        return qbxstokes.load(path.with_suffix(".h5"))

    return run


def fault(path: Path) -> str:
    with pytest.raises(CaseError) as caught:
        load_case(path)
    return str(caught.value)


# -- axes ------------------------------------------------------------------------------------------


def test_axes_multiply_and_keys_of_one_axis_run_together(write: Callable[..., Path]) -> None:
    path = write(
        {"body.aspect_ratio": [0.5, "1/4"]},
        {"body.stokes_number": {"logspace": [0.1, 10], "count": 3}, "time.end": [1, 2, 3]},
        {"start.position[1]": {"linspace": [0, 1], "count": 2, "endpoint": False}},
    )
    space = load_case(path).space
    assert space is not None
    assert space.shape == (2, 3, 2)
    values = space.values(np.arange(12))
    np.testing.assert_array_equal(values["body", "aspect_ratio"], [0.5] * 6 + [0.25] * 6)
    np.testing.assert_allclose(values["body", "stokes_number"], [0.1, 0.1, 1, 1, 10, 10] * 2)
    np.testing.assert_array_equal(values["time", "end"], [1, 1, 2, 2, 3, 3] * 2)
    np.testing.assert_array_equal(values["start", "position", 1], [0, 0.5] * 6)


@pytest.mark.parametrize("kind", ["axes", "rotations"])
def test_random_orientations_are_uniform_and_made_in_pieces(
    write: Callable[..., Path], kind: str
) -> None:
    path = write({"start.orientation": {"random": kind, "count": 20_000, "seed": 1}})
    space = load_case(path).space
    assert space is not None
    points = space.values(np.arange(20_000))["start", "orientation"]
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 1.0, rtol=1e-14)
    moments = points.T @ points / len(points)
    np.testing.assert_allclose(moments, np.eye(len(moments)) / len(moments), atol=0.012)
    np.testing.assert_allclose(points.mean(axis=0), 0.0, atol=0.02)
    piece = np.array([12_345, 4095, 4096, 3])
    np.testing.assert_array_equal(space.values(piece)["start", "orientation"], points[piece])


HEADER = ",".join(f"start.orientation.quaternion[{i}]" for i in range(4))


@pytest.mark.parametrize("kind", ["npy", "float32", "named npy", "csv", "keys", "euler"])
def test_orientations_come_from_files(
    kind: str, write: Callable[..., Path], tmp_path: Path
) -> None:
    q = np.random.default_rng(2).standard_normal((5, 4))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    file, axis = tmp_path / "q.npy", {"start.orientation": {"table": "q.npy"}}
    if kind in ("csv", "keys"):
        file, axis = tmp_path / "q.csv", {"start.orientation": {"table": "q.csv"}}
        np.savetxt(file, q, delimiter=";", header=HEADER.replace(",", ";"), comments="")
    elif kind == "named npy":
        np.save(file, np.rec.fromarrays(q.T, names=HEADER.split(",")))
    elif kind == "euler":
        np.save(file, rotation.to_euler(q))
        axis = {"start.orientation.euler": {"table": "q.npy"}}
    else:
        np.save(file, q.astype(np.float32) if kind == "float32" else q)
    space = load_case(write({"table": file.name} if kind in ("keys", "named npy") else axis)).space
    values = space.values(np.arange(5))
    if kind == "euler":
        found = rotation.from_euler(
            *(values["start", "orientation", "euler", n] for n in ("phi", "theta", "psi"))
        )
        np.testing.assert_allclose(np.abs(np.sum(found * q, axis=1)), 1.0, rtol=1e-14)
    else:
        found = values["start", "orientation"]
        np.testing.assert_allclose(found, q, rtol=1e-7 if kind == "float32" else 1e-15)


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (f"{HEADER}\n1,0,0,0\n1,0,x,0\n", "t.csv, line 3, column 3: 'x' is no finite number"),
        (f"{HEADER}\n\n1,0,0,0\n0,0,0,0\n", "t.csv, line 4"),
        ("start.orientation.quaternion[0]\n1\n", "give all of quaternion[0] to quaternion[3]"),
        (HEADER.replace("[3]", "[4]") + "\n1,0,0,0\n", "give all of quaternion"),
        ("start.position[7]\n1\n", "use an index from 0 to 2"),
        ("body.aspect_ratio\n1\n# two\n-1\n", "t.csv, line 4"),
    ],
)
def test_faults_of_tables_name_file_and_line(
    content: str, told: str, write: Callable[..., Path], tmp_path: Path
) -> None:
    (tmp_path / "t.csv").write_text(content)
    with pytest.raises(CaseError) as caught:
        load_case(write({"table": "t.csv"}))
    assert told in str(caught.value)


def test_tables_hold_numbers_angles_and_words(write: Callable[..., Path], tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text(
        "start.orientation.euler.theta,flow.type,body.stokes_number\n90 deg,shear,1\n0,rotation,2\n"
    )
    space = load_case(write({"table": "t.csv"})).space
    assert space is not None
    values = space.values(np.arange(2))
    np.testing.assert_allclose(values["start", "orientation", "euler", "theta"], [math.pi / 2, 0])
    assert values["flow", "type"].tolist() == ["shear", "rotation"]
    assert values["body", "stokes_number"].tolist() == [1.0, 2.0]


def test_any_piece_of_a_vast_sweep_is_made_on_its_own(write: Callable[..., Path]) -> None:
    path = write(
        {"body.stokes_number": {"logspace": [1, 100], "count": 1000}},
        {"start.orientation": {"random": "axes", "count": 10**6}},
    )
    scenes = Scenes(load_case(path))
    assert scenes.space.size == 10**9
    block = scenes.block(scenes.blocks - 1)
    assert block.index[-1] == 10**9 - 1
    assert scenes.block_sizes().sum() == 10**9


def test_blocks_hold_every_trajectory_once_and_one_decade_each(
    write: Callable[..., Path],
) -> None:
    path = write(
        {"start.orientation": {"random": "axes", "count": 5}},
        {"body.stokes_number": [0, 5, 0.5, 2, 0]},
        {"flow.rate": [1, 2]},
        sweep={"block": 4},
    )
    scenes = Scenes(load_case(path))
    blocks = [scenes.block(number) for number in range(scenes.blocks)]
    seen = np.concatenate([block.index for block in blocks])
    assert sorted(seen.tolist()) == list(range(50))
    assert [len(block.index) for block in blocks] == scenes.block_sizes().tolist()
    for block in blocks:
        values = scenes.space.values(block.index)
        assert np.all(np.diff(block.index) > 0)
        assert len(set(values["flow", "rate"].tolist())) == 1
        stokes = values["body", "stokes_number"]
        with np.errstate(divide="ignore"):
            assert len(set(np.floor(np.log10(stokes)).tolist())) == 1


@pytest.mark.parametrize(
    ("axis", "told"),
    [
        ({"body.aspect_ration": [1]}, "body.aspect_ration: unknown key; did you mean"),
        ({"bdy.aspect_ratio": [1]}, "unknown key; did you mean body.aspect_ratio"),
        ({"body.stokes_number": [0, -1]}, "is -1 (value 2 of the axis); must be >= 0"),
        ({"body.stokes_number": {"linspace": [0, 1]}}, "add count"),
        ({"body.stokes_number": {"logspace": [0, 1], "count": 3}}, "numbers > 0"),
        ({"body.stokes_number": {"linspac": [0, 1], "count": 3}}, "one of linspace"),
        ({"body.stokes_number": []}, "has no values"),
        ({"body.stokes_number": 3}, "a list of values"),
        ({"body.stokes_number": [1, 2], "time.end": [1]}, "different numbers of values"),
        ({"start.position": {"random": "axes", "count": 3}}, "values of start.orientation"),
        ({"start.orientation": {"random": "circle", "count": 3}}, "axes (on the sphere)"),
        ({"start.orientation": [1, 2, 3]}, "no orientations; a list of axes"),
        ({"start.orientation": ["up", "down"]}, "no orientations"),
        ({"start.orientation": [{"axis": [1, 0, 0]}]}, "no orientations"),
        ({"start.orientation": {"linspace": [0, 1], "count": 3}}, "no orientations"),
        ({"output.file": ["a", "b"]}, "output is the same for all"),
        ({"time.samples": [2, 3]}, "time.samples is the same for all"),
        ({"table": "none.csv"}, "cannot be read"),
        ({"start.position[7]": [1]}, "start.position is a list of 3 entries"),
        ({"body.aspect_ratio.x": [1]}, "body.aspect_ratio is not a section"),
        ({"body.stokes_number": {"linspace": [0, 1], "count": 2, "seed": 1}}, "seed: has no mean"),
        ({"flow.rat": [1]}, "did you mean rate"),
    ],
)
def test_faults_are_told_with_file_and_line(
    write: Callable[..., Path], axis: dict[str, Any], told: str
) -> None:
    message = fault(write(axis))
    assert told in message
    assert "case.yaml:" in message


def test_keys_are_set_once(write: Callable[..., Path]) -> None:
    again = fault(write({"body.stokes_number": [1]}, {"body.stokes_number": [2]}))
    assert "sets already" in again
    assert "sets already" in fault(write(RANDOM, {"start.orientation.euler.phi": [0]}))


def test_names_of_coordinates() -> None:
    names = ["body.stokes_number", "start.position[1]", "start.orientation.orbit.constant"]
    short = [column_name(parse_key(name)) for name in names]
    assert short == ["stokes_number", "start_position_2", "start_orbit_constant"]


# -- numbers ---------------------------------------------------------------------------------------


def orientations(table: Any, prefix: str) -> Any:
    return np.stack([table[f"{prefix}_{i}"] for i in range(4)], axis=-1)


def test_massless_orbits_are_jefferys(sweep: Sweep) -> None:
    result = sweep(
        {"body.aspect_ratio": [0.5, 3]},
        {"start.orientation.orbit.constant": [0.2, 1, "inf"]},
        {"start.orientation.orbit.phase": {"linspace": [0, "360 deg"], "count": 4}},
        time={"periods": 1.25, "samples": 41, "tolerance": 1e-9},
    )
    assert result.shape == (2, 3, 4)
    table = result.table
    assert np.all(table["status"] == 1)
    assert result.time.shape == (24, 41)  # periods differ with the aspect ratio
    np.testing.assert_allclose(table["period"], table["jeffery_period"], rtol=1e-7)
    found, wanted = table["orbit_constant_start"], table["start_orbit_constant"]
    np.testing.assert_allclose(1 / (1 + found), 1 / (1 + wanted), rtol=1e-12, atol=1e-12)
    for row, axis, times in zip(table, result.axis, result.time, strict=True):
        k = row["aspect_ratio"]
        exact = jeffery.axis_at(times, k, axis[0] / np.linalg.norm(axis[0]))
        assert np.abs(axis - exact).max() < 1e-7
        # A quarter of a turn after a whole one.
        phase = row["start_orbit_phase"] + 0.5 * np.pi
        assert np.sign(axis[-1, 0]) == np.sign(np.cos(phase)) or abs(axis[-1, 0]) < 1e-6


def test_every_inertial_trajectory_of_a_block_meets_the_tolerance(sweep: Sweep) -> None:
    result = sweep({"body.stokes_number": [1, 3, 9]}, RANDOM)
    table = result.table
    starts, ends = (
        orientations(table, "start_orientation"),
        orientations(table, "final_orientation"),
    )
    assert result.shape == (3, 6)
    times, accuracy = [0.0, 10.0], {"rtol": 1e-9, "atol": 1e-9}
    for row, start, end in list(zip(table, starts, ends, strict=True))[::4]:
        exact = inertial.linear_flow(0.5, row["stokes_number"], SHEAR, start, times, **accuracy)
        off = np.abs(rotation.axis(end) - rotation.axis(exact.orientation[-1])).max()
        assert off < 1e-7


def test_a_trajectory_does_not_depend_on_its_company(sweep: Sweep) -> None:
    axes = ({"body.stokes_number": [0, 2]}, RANDOM)
    together = sweep(*axes)
    alone = sweep(*axes, sweep={"block": 1})
    for name in MOTION:
        scale = np.abs(alone[name]).max()
        close = np.abs(together[name] - alone[name]).max() <= 2e-7 * max(scale, 1.0)
        assert close or name in ("euler_angles", "force", "torque"), name


def test_drift_and_positions_in_a_paraboloid(sweep: Sweep) -> None:
    """Without inertia a sphere follows Faxen's law: u + Lap u/6 = (K eta^2 + 2 K/3) e1."""
    result = sweep(
        {"start.position": [[0, 1, 0], [0, 2, 0]]},
        {"start.orientation.euler.psi": [0, 1]},
        body={"aspect_ratio": 1},
        flow={"type": "paraboloid", "curvature": 0.3},
    )
    eta = np.array([1, 1, 2, 2])
    np.testing.assert_allclose(result.table["mean_velocity_1"], 0.3 * eta**2 + 0.2, rtol=1e-7)
    np.testing.assert_allclose(result.table["mean_velocity_2"], 0.0, atol=1e-8)


def test_flows_of_other_kinds_are_swept_by_the_grid(sweep: Sweep) -> None:
    flow = {
        "type": "stresslet",
        "position": [4, 0, 0],
        "strength": [[1, 0, 0], [0, -1, 0], [0, 0, 0]],
    }
    result = sweep(
        {"start.position": [[0, 0, 0], [0, 1, 0], [4, 0, 0]]},
        flow=flow,
        time={"end": 2.0, "samples": 5, "tolerance": 1e-6},
        hydrodynamics={"tolerance": 1e-6},
        status=1,
    )
    assert result.table["status"].tolist() == [1, 1, 2]
    assert b"singular" in result.table["reason"][2]
    assert np.isnan(result.axis[2]).all()
    assert result.summary["failed"] == 1


def test_windows_and_turns_of_averages() -> None:
    k = 0.2
    frame = ShearFrame.of(SHEAR)
    period = jeffery.period(k)
    times = np.linspace(0.0, 3.3 * period, 400)
    starts = np.array([[0.3, 0.4, 0.6], [0, 0, 1], [1, 0, 0], [-0.5, 0.1, 0.5]], dtype=float)
    starts /= np.linalg.norm(starts, axis=1, keepdims=True)
    axis = np.stack([jeffery.axis_at(times, k, start) for start in starts], axis=1)
    shape = (1 - k * k) / (1 + k * k)
    spin = np.array([0, 0, -0.5]) + shape * np.cross(axis, axis @ (0.5 * (SHEAR + SHEAR.T)))
    position, velocity = np.zeros_like(axis), np.zeros_like(axis)
    position[..., 0], velocity[..., 0] = np.sin(times)[:, None], np.cos(times)[:, None]
    samples = {"axis": axis, "angular_velocity": spin, "position": position, "velocity": velocity}
    averages = turn_averages(times, samples, k, frame, discard=0.1)
    np.testing.assert_array_equal(averages["half_turns"], [5, 0, 5, 5])
    np.testing.assert_allclose(averages["period"], [period, np.nan, period, period], rtol=1e-12)
    np.testing.assert_allclose(averages["rotation_rate"][0], -2 * np.pi / period, rtol=1e-12)
    start = times[np.searchsorted(times, 0.1 * times[-1])]
    end = start + 2.5 * period
    mean = (np.sin(end) - np.sin(start)) / (end - start)
    np.testing.assert_allclose(averages["mean_velocity"][0, 0], mean, atol=1e-6)
    np.testing.assert_allclose(averages["orbit_drift"][[0, 3]], 0.0, atol=1e-8)
    assert np.isinf(averages["orbit_constant_end"][2])


def test_turns_that_samples_miss_are_not_counted() -> None:
    """Samples 0.7 periods apart look like turns the other way."""
    period = jeffery.period(0.5)
    start = np.array([0.6, 0.0, 0.8])
    for spacing, known in ((0.7, False), (1.0, False), (0.3, True)):
        times = spacing * period * np.arange(15.0)
        axis = jeffery.axis_at(times, 0.5, start)[:, None]
        spin = np.array([0, 0, -0.5]) + 0.6 * np.cross(axis, axis @ (0.5 * (SHEAR + SHEAR.T)))
        samples = {"axis": axis, "angular_velocity": spin, "position": axis, "velocity": axis}
        found = turn_averages(times, samples, 0.5, ShearFrame.of(SHEAR))
        expected = period if known else np.nan
        np.testing.assert_allclose(found["period"], expected, rtol=1e-8)


@pytest.mark.parametrize("turns", [1, 2, 3])
def test_a_turn_that_ends_with_the_last_sample_counts(turns: int) -> None:
    times = np.linspace(0.0, turns * jeffery.period(0.5), 81)
    starts = np.random.default_rng(0).standard_normal((20, 3))
    starts /= np.linalg.norm(starts, axis=1, keepdims=True)
    axis = np.stack([jeffery.axis_at(times, 0.5, start) for start in starts], axis=1)
    strain = 0.5 * (SHEAR + SHEAR.T)
    spin = np.array([0, 0, -0.5]) + 0.6 * np.cross(axis, axis @ strain)
    samples = {"axis": axis, "angular_velocity": spin, "position": axis, "velocity": axis}
    averages = turn_averages(times, samples, 0.5, ShearFrame.of(SHEAR))
    np.testing.assert_allclose(averages["period"], jeffery.period(0.5), rtol=1e-8)


# -- files -----------------------------------------------------------------------------------------


def test_results_are_read_in_two_lines(sweep: Sweep, tmp_path: Path) -> None:
    sweep({"body.aspect_ratio": [0.5, 1]}, RANDOM)
    table = h5py.File(tmp_path / "case.h5")["table"]
    assert table["period"].shape == (12,)
    file = h5py.File(tmp_path / "case.h5")
    scales = [[scale.name for scale in dim.values()] for dim in file["axis"].dims]
    assert scales == [["/trajectory"], ["/time"], ["/component"]]
    assert file["aspect_ratio"].dims[0][0].name == "/trajectory"
    pandas = pytest.importorskip("pandas")
    frame = pandas.DataFrame(h5py.File(tmp_path / "case.h5")["table"][:])
    assert frame.groupby("aspect_ratio")["period"].mean().shape == (2,)
    loaded = qbxstokes.load(tmp_path / "case.h5").to_pandas()
    assert loaded["reason"].eq("").all()
    pytest.importorskip("xarray")
    data = qbxstokes.load(tmp_path / "case.h5").to_xarray()
    assert dict(data.sizes)["trajectory"] == 12
    assert data.axis.sel(trajectory=3, component="1").dims == ("time",)
    assert data.aspect_ratio.dims == ("trajectory",)


def test_summaries_alone_need_no_samples(sweep: Sweep, tmp_path: Path) -> None:
    result = sweep(RANDOM, sweep={"store": "summary"})
    assert "axis" not in result.names
    assert np.isfinite(result.table["final_position_1"]).all()
    assert (tmp_path / "case.h5").stat().st_size < 40_000


def test_dry_run_tells_and_writes_nothing(
    write: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write({"body.aspect_ratio": [0.5, 1]}, RANDOM)
    assert run_command([str(path), "--dry-run"]) == 0
    text = capsys.readouterr().out
    for word in ("12 trajectories (2 x 6)", "2 operators", "memory", "disk", "time", "scenes"):
        assert word in text
    assert run_command([str(path), "--dry-run", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["trajectories"] == 12
    assert [p.name for p in tmp_path.iterdir()] == ["case.yaml"]


def test_events_of_single_motions_are_refused(
    write: Callable[..., Path], capfd: pytest.CaptureFixture[str]
) -> None:
    path = write(RANDOM, field={"plane": {}})
    assert run_command([str(path)]) == 2
    assert "belongs to a single motion" in capfd.readouterr().err


def python(folder: Path, statements: str) -> subprocess.CompletedProcess[str]:
    """A process of its own that runs statements with `run_command` and exits with `status`."""
    script = (
        f"import sys; from qbxstokes.cli.main import run_command\n{statements}\nsys.exit(status)"
    )
    root = str(Path(qbxstokes.__file__).parents[1])
    return subprocess.run(
        [sys.executable, "-c", script],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": root},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


def same(first: Path, second: Path) -> bool:
    with h5py.File(first) as a, h5py.File(second) as b:
        assert set(a) == set(b)
        for name, item in a.items():
            if isinstance(item, h5py.Group):
                continue
            x, y = item[()], b[name][()]
            for column in x.dtype.names or ():
                if column != "wall_time" and x[column].tobytes() != y[column].tobytes():
                    return False
            if x.dtype.names is None and x.tobytes() != y.tobytes():
                return False
    return True


class Stop(Exception):
    """Stands for the end of the process."""


# A part after every block.
OFTEN = {"every": "1e-6 s"}


def stopped_after(monkeypatch: pytest.MonkeyPatch, path: Path, blocks: int) -> None:
    """Run the sweep and end it after some blocks."""
    from qbxstokes.runs import block

    compute, count = block.compute_block, [0]

    def limited(*arguments: Any) -> Any:
        count[0] += 1
        if count[0] > blocks:
            raise Stop
        return compute(*arguments)

    with monkeypatch.context() as patch:
        patch.setattr(block, "compute_block", limited)
        assert run_command([str(path), "--progress", "none"]) == 1


def kept_blocks(folder: Path) -> list[int]:
    found = []
    for part in sorted(folder.glob("blocks-*.h5")):
        found += [note["block"] for note in read_part(part, [])[1]["items"]]
    return found


def test_a_stopped_sweep_goes_on_where_it_was(
    write: Callable[..., Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    axes = {"body.stokes_number": [0, 1]}, RANDOM
    path = write(*axes, sweep={"block": 2}, checkpoint=OFTEN)
    assert run_command([str(path), "--quiet"]) == 0
    (tmp_path / "case.h5").rename(tmp_path / "whole.h5")
    stopped_after(monkeypatch, path, 4)
    folder = parts_of(tmp_path / "case.h5")
    assert len(kept_blocks(folder)) == 4
    assert run_command([str(path)]) == 2
    assert "--resume" in capfd.readouterr().err
    changed = write(*axes, sweep={"block": 3}, checkpoint=OFTEN)
    assert run_command([str(changed), "--resume"]) == 2
    assert "another sweep.block" in capfd.readouterr().err
    path = write(*axes, sweep={"block": 2}, checkpoint=OFTEN)
    for damaged in (b"", b"{}", b"[1, 2]", b"\0\xff"):
        whole = (folder / "run.json").read_bytes()
        (folder / "run.json").write_bytes(damaged)
        assert not holds_work(folder)
        (folder / "run.json").write_bytes(whole)
    # Parts that are torn or damaged are as if they were not there.
    parts = sorted(folder.glob("blocks-*.h5"))
    parts[0].write_bytes(parts[0].read_bytes()[:-900])
    parts[1].write_bytes(b"")
    assert run_command([str(path), "--resume", "--progress", "none"]) == 0
    assert same(tmp_path / "whole.h5", tmp_path / "case.h5")
    assert not folder.exists()
    assert run_command([str(path), "--resume"]) == 0
    assert "finished already, nothing to resume" in capfd.readouterr().out


def test_a_block_in_work_goes_on_from_its_state(
    write: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One long block, cut often, ended in its midst again and again: the same bits."""
    from qbxstokes.runs import block
    from qbxstokes.simulation import assembly

    monkeypatch.setattr(assembly.Assembled, "steps_of", lambda *_: 25)
    path = write(RANDOM, {"body.stokes_number": [1, 2]}, checkpoint=OFTEN)
    assert run_command([str(path), "--quiet"]) == 0
    (tmp_path / "case.h5").rename(tmp_path / "whole.h5")
    save, count = block._Integration.save, [0]
    steps: list[int] = []

    def limited(self: Any) -> None:
        save(self)
        assert self.begun is not None
        steps.append(self.begun[1].steps)
        count[0] += 1
        if count[0] % 3 == 0:
            raise Stop

    with monkeypatch.context() as patch:
        patch.setattr(block._Integration, "save", limited)
        stops = 0
        while run_command([str(path), "--resume", "--progress", "none"]) != 0:
            stops += 1
    assert stops >= 3
    assert steps == sorted(steps)  # each went on where the last one was
    assert same(tmp_path / "whole.h5", tmp_path / "case.h5")
    assert not parts_of(tmp_path / "case.h5").exists()


def test_a_mixed_block_of_which_some_fail_goes_on_from_its_halves(
    write: Callable[..., Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    from qbxstokes.errors import ConvergenceError
    from qbxstokes.petsc import stepper
    from qbxstokes.runs import block

    path = write({"body.stokes_number": [1, 2, 3, 4]}, RANDOM, checkpoint=OFTEN)
    integrate = stepper.integrate

    def failing(equations: Any, *arguments: Any, **options: Any) -> Any:
        if np.any(equations.stokes_number == 3):
            raise ConvergenceError("steps grew too small")
        return integrate(equations, *arguments, **options)

    monkeypatch.setattr(stepper, "integrate", failing)
    assert run_command([str(path), "--quiet"]) == 1
    (tmp_path / "case.h5").rename(tmp_path / "whole.h5")
    summarise, count = block._Integration._summarise, [0]

    def limited(self: Any, *arguments: Any) -> None:
        summarise(self, *arguments)
        count[0] += 1
        if count[0] == 2:
            self.save()
            raise Stop

    with monkeypatch.context() as patch:
        patch.setattr(block._Integration, "_summarise", limited)
        assert run_command([str(path), "--progress", "none"]) == 1
    assert run_command([str(path), "--resume", "--quiet"]) == 1
    assert same(tmp_path / "whole.h5", tmp_path / "case.h5")
    assert "steps grew too small" in capfd.readouterr().err


def test_failures_are_told_and_mended(
    write: Callable[..., Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    from qbxstokes.errors import ConvergenceError
    from qbxstokes.petsc import stepper

    path = write({"body.stokes_number": [1, 2, 3]}, RANDOM, sweep={"block": 7})
    integrate = stepper.integrate

    def failing(equations: Any, *arguments: Any, **options: Any) -> Any:
        if np.any(equations.stokes_number == 2):
            raise ConvergenceError("steps grew too small")
        return integrate(equations, *arguments, **options)

    with monkeypatch.context() as patch:
        patch.setattr(stepper, "integrate", failing)
        assert run_command([str(path), "--quiet"]) == 1
    errors = capfd.readouterr().err
    assert "trajectory 6 failed: steps grew too small" in errors
    result = qbxstokes.load(tmp_path / "case.h5")
    assert result.table["status"].reshape(3, 6).tolist() == [[1] * 6, [2] * 6, [1] * 6]
    untouched = result.axis.copy()
    assert run_command([str(path), "--resume", "--quiet"]) == 0
    result = qbxstokes.load(tmp_path / "case.h5")
    assert np.all(result.table["status"] == 1)
    assert result.summary["failed"] == 0
    np.testing.assert_array_equal(result.axis[:6], untouched[:6])
    assert np.isfinite(result.axis).all()


def test_a_full_disk_is_told_before_anything_is_computed(
    write: Callable[..., Path],
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    path = write(RANDOM)
    usage = shutil.disk_usage(path)
    with monkeypatch.context() as patch:
        patch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=1000))
        assert run_command([str(path), "--progress", "none"]) == 1
    told = capfd.readouterr().err
    assert "0.001 MB are free" in told
    assert not parts_of(path.parent / "case.h5").exists()
    assert run_command([str(path), "--resume", "--quiet"]) == 0


def test_a_disk_that_fills_up_keeps_what_is_there(
    write: Callable[..., Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    path = write(RANDOM, sweep={"block": 1}, checkpoint=OFTEN)
    assert run_command([str(path), "--quiet"]) == 0
    (tmp_path / "case.h5").rename(tmp_path / "whole.h5")
    put, part, count = sweep_result.put_rows, store.write_part, [0, 0]

    def filling(*rows: Any) -> None:
        count[0] += 1
        if count[0] > 20:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        put(*rows)

    def full(*what: Any) -> None:
        count[1] += 1
        if count[1] > 3:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        part(*what)

    folder = parts_of(tmp_path / "case.h5")
    with monkeypatch.context() as patch:  # in the midst of the work
        patch.setattr(store, "write_part", full)
        assert run_command([str(path), "--progress", "none"]) == 1
    assert "No space left on device" in capfd.readouterr().err
    assert 0 < len(kept_blocks(folder)) < 6
    with monkeypatch.context() as patch:  # while the result is put together
        patch.setattr(sweep_result, "put_rows", filling)
        assert run_command([str(path), "--resume", "--progress", "none"]) == 1
    told = capfd.readouterr().err
    assert "No space left on device" in told
    assert "--resume" in told
    assert run_command([str(path), "--resume", "--quiet"]) == 0
    assert same(tmp_path / "whole.h5", tmp_path / "case.h5")


def test_overwrite_begins_anew(write: Callable[..., Path], tmp_path: Path) -> None:
    path = write(RANDOM)
    assert run_command([str(path), "--quiet"]) == 0
    assert run_command([str(path), "--quiet"]) == 0
    assert (tmp_path / "case-1.h5").exists()
    folder = parts_of(tmp_path / "case.h5")
    folder.mkdir()
    shutil.copy(path, folder / "blocks-0001-00000-000001.h5")
    (folder / "run.json").write_text('{"run": 1, "identity": {}}')
    assert run_command([str(path), "--quiet"]) == 2
    assert run_command([str(path), "--quiet", "--overwrite"]) == 0
    assert not folder.exists()


def test_memory_does_not_grow_with_the_sweep(write: Callable[..., Path], tmp_path: Path) -> None:
    """Peak memory of a process after few trajectories and after many: one table lies between."""
    write(
        {"start.orientation": {"random": "axes", "count": 16_384}},
        sweep={"store": "summary", "block": 512},
        time={"end": 0.2, "samples": 2, "tolerance": 1e-2},
    )
    few = "sweep.axes=[{start.orientation: {random: axes, count: 512}}]"
    done = python(
        tmp_path,
        "import resource\n"
        f"for options in (['--set', {few!r}], []):\n"
        "    status = run_command(['case.yaml', '--overwrite', '--quiet', *options])\n"
        "    assert status == 0\n"
        "    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)",
    )
    assert done.returncode == 0, done.stderr
    peaks = [int(line) for line in done.stdout.split()]
    assert peaks[1] - peaks[0] < 12_000  # kB


@pytest.mark.parametrize(
    "case", sorted((ROOT / "cases").glob("sweep_*.yaml")), ids=lambda p: p.stem
)
def test_cases_give_what_they_promise(case: Path, tmp_path: Path) -> None:
    """Their massless trajectories have Jeffery's period and, in a shear, keep their orbit.

    A parabolic flow carries bodies across it and back, to another rate.
    """
    target = tmp_path / "case.h5"
    few = ["--set", "time.samples=41", "--set", "time.tolerance=1e-6"]
    assert run_command([str(case), "--quiet", *few, "--set", f"output.file={target}"]) == 0
    table = qbxstokes.load(target).table
    massless = table["stokes_number"] == 0 if "stokes_number" in table.dtype.names else ...
    period = table["period"][massless] / table["jeffery_period"][massless]
    assert np.nanmax(np.abs(period - 1.0)) < 1e-5
    if "type: shear" in case.read_text():
        assert np.nanmax(np.abs(table["orbit_drift"][massless])) < 1e-4
