"""Field files: the group in the result, the VTKHDF file, the command line and several ranks."""

from __future__ import annotations

import errno
import json
import os
import resource
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from qbxstokes.cli.main import run_command
from qbxstokes.geometry import rotation
from qbxstokes.io import field as store
from qbxstokes.io.field import export
from qbxstokes.io.results import load

CASE = {
    "task": "field",
    "body": {"aspect_ratio": 0.5},
    "flow": {"type": "shear"},
    "start": {"orientation": {"axis": [1, 1, 0]}, "position": [1, 2, 3]},
    "field": {
        "plane": {"extent": [-2, 2, -1, 1], "shape": [9, 5]},
        "box": {"shape": [3, 4, 5]},
        "shells": {"distances": [0, 1e-4], "shape": [5, 6]},
        "surface": {"shape": [7, 8]},
        "streamlines": {"number": 3, "samples": 5, "start": [-2, 0.1, 0], "stop": [-2, 1, 0]},
        "tracers": {"number": 2, "samples": 4, "duration": 1.0},
        "check": 2,
    },
}


def made(tmp_path: Path) -> h5py.File:
    """A result of three instants with a growing number of points inside."""
    file = h5py.File(tmp_path / "result.h5", "w")
    sets = {"plane": (5, 4), "box": (3, 3, 2), "points": (3,)}
    store.create(file, np.array([0.0, 0.5, 2.0]), sets, ["velocity", "stress"])
    group = file["field"]
    rng = np.random.default_rng(0)
    for step in range(3):
        for name, shape in sets.items():
            n = int(np.prod(shape))
            block = {
                "points": rng.normal(size=(n, 3)),
                "velocity": np.full((n, 3), step),
                "stress": np.tile(np.arange(6.0), (n, 1)),
                "inside": np.arange(n) < step,
                "source": np.zeros(n),
            }
            store.put_rows(group[name], step, 0, block)
    store.put_arrays(group, "streamlines", {"points": rng.normal(size=(3, 4, 7, 3))}, {})
    surface = {"points": rng.normal(size=(3, 20, 3)), "traction": rng.normal(size=(3, 20, 3))}
    store.put_arrays(group, "surface", surface, {"shape": np.array([4, 5])})
    return file


def test_layout_of_a_series(tmp_path):
    """What the VTKHDF specification asks of each block, and cells kept out of the body."""
    with made(tmp_path) as file:
        path = export(file, tmp_path / "result.vtkhdf")
    with h5py.File(path) as file:
        root = file["VTKHDF"]
        assert root.attrs["Type"] == b"PartitionedDataSetCollection"
        assert set(root["Assembly"]) == {"plane", "box", "points", "streamlines", "surface"}
        assert sorted(root[name].attrs["Index"] for name in root["Assembly"]) == list(range(5))
        plane = root["plane"]
        assert plane.attrs["Type"] == b"UnstructuredGrid"
        assert plane["Steps"].attrs["NSteps"] == 3
        assert plane["Steps"]["Values"][()].tolist() == [0.0, 0.5, 2.0]
        assert plane["NumberOfPoints"][()].tolist() == [20, 20, 20]
        assert plane["NumberOfCells"][()].tolist() == [12, 11, 10]
        assert plane["Steps"]["CellOffsets"][()].tolist() == [0, 12, 23]
        assert len(plane["Connectivity"]) == 4 * 33
        assert len(plane["Offsets"]) == 33 + 3
        # ParaView wants xx yy zz xy yz xz, the result holds 11 22 33 12 13 23.
        assert plane["PointData/stress"][0].tolist() == [0, 1, 2, 3, 5, 4]
        assert set(root["box/Types"][()]) == {12}
        assert set(root["points/Types"][()]) == {1}
        assert root["surface"].attrs["Type"] == b"PolyData"
        assert root["surface/Polygons/NumberOfCells"][()].tolist() == [15, 15, 15]
        assert root["streamlines/Lines/NumberOfCells"][()].tolist() == [4, 4, 4]


def test_reader_of_vtk_opens_it(tmp_path):
    vtk = pytest.importorskip("vtk", reason="the vtk package is not a dependency")
    with made(tmp_path) as file:
        path = export(file, tmp_path / "result.vtkhdf")
    reader = vtk.vtkHDFReader()
    reader.SetFileName(str(path))
    reader.UpdateInformation()
    assert reader.GetNumberOfSteps() == 3
    reader.SetStep(2)
    reader.Update()
    collection = reader.GetOutputDataObject(0)
    assert collection.GetNumberOfPartitionedDataSets() == 5
    sizes = [collection.GetPartition(i, 0).GetNumberOfCells() for i in range(5)]
    assert sorted(sizes) == [1, 2, 4, 10, 15]


def test_field_from_the_command_line(write_case, run_cli, tmp_path):
    done = run_cli(write_case(CASE), "--json")
    assert done.returncode == 0, done.stderr
    summary = json.loads(done.stdout)
    assert summary["largest_error"] < 1e-9
    assert summary["angular_velocity"] == pytest.approx([0, 0, -0.5], abs=1e-12)
    result = load(tmp_path / "case.h5")
    field = result.groups["field"]
    plane = field["plane"]
    assert plane["points"].shape == (1, 45, 3)
    assert plane["inside"].sum() > 0
    assert np.array_equal(np.isnan(plane["pressure"]), plane["inside"])
    # On the plane x2 = 2 far from the body the shear is what is left, at the axis 0.2 slower.
    far = np.abs(plane["disturbance_velocity"][0, :5]).max()
    assert far < 0.3
    shells = field["shells"]
    assert not shells["inside"].any()
    arm = shells["points"][0, :30] - [1, 2, 3]
    rigid = result.velocity[0] + np.cross(result.angular_velocity[0], arm)
    assert np.abs(shells["velocity"][0, :30] - rigid).max() < 1e-12
    assert field["streamlines"]["points"].shape == (1, 3, 5, 3)
    assert field["tracers"]["points"].shape == (4, 2, 3)
    assert (tmp_path / "case.vtkhdf").exists()


MOTION = {
    "body": {"aspect_ratio": 0.5, "stokes_number": 5},
    "flow": {"type": "shear"},
    "time": {"end": 2.0, "samples": 5},
    "field": {
        "shells": {"distances": [0.0], "shape": [5, 6]},
        "at": [0, 1.5],
        "tracers": {"points": [[1.0, 0.2, 0], [0, 0, 0]], "samples": 3},
    },
}


def field_bytes(path: Path) -> dict[str, bytes]:
    """Every dataset of the field."""
    found = {}
    with h5py.File(path) as file:

        def note(name: str, item: Any) -> None:
            if isinstance(item, h5py.Dataset):
                found[name] = item[()].tobytes()

        file["field"].visititems(note)
    return found


@pytest.mark.mpi
@pytest.mark.parametrize("ranks", [2, pytest.param(3, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "case", [CASE | {"field": CASE["field"] | {"check": 12}}, MOTION], ids=["field", "motion"]
)
def test_ranks_give_the_same_field(case, ranks, write_case, run_cli, mpirun, tmp_path):
    path = write_case(case)
    summaries = []
    for name in ("one", "several"):
        options = (path, "--json", "--set", f"output.file={name}.h5")
        done = run_cli(*options) if name == "one" else mpirun(ranks, *options)
        assert done.returncode == 0, done.stderr
        summary = json.loads(done.stdout)
        summaries.append(summary.get("field", summary))
    one, several = (field_bytes(tmp_path / f"{name}.h5") for name in ("one", "several"))
    assert one == several
    assert ("error/error" in one) == (case is not MOTION)
    for name in ("errors", "points", "hydrodynamics"):
        assert summaries[0][name] == summaries[1][name]


def test_tracers_do_not_cross_the_surface_of_a_tumbling_body(write_case, tmp_path, monkeypatch):
    """They start a hair above a slender body, which turns over and carries them along."""
    k, above = 0.2, 1e-8
    theta = np.linspace(0.1, 3.0, 9)
    starts = (1.0 + above) * np.stack([k * np.sin(theta), 0 * theta, np.cos(theta)], axis=-1)
    case = {
        "body": {"aspect_ratio": k},
        "flow": {"type": "shear"},
        "start": {"orientation": {"axis": [0, 1, 0]}},
        "time": {"periods": 0.5, "samples": 41},
        "field": {
            "shells": {"distances": [0.0], "shape": [3, 4]},
            "tracers": {"points": starts.tolist(), "samples": 41, "frame": "body"},
            "vtk": False,
            "check": 0,
        },
    }
    monkeypatch.chdir(tmp_path)
    assert run_command([write_case(case).name, "--quiet"]) == 0
    result = load(tmp_path / "case.h5")
    tracers = result.groups["field"]["tracers"]
    assert np.allclose(tracers["time"], result.time)
    arms = tracers["points"] - tracers["position"][:, None]

    def levels(orientation: np.ndarray) -> np.ndarray:
        inside = np.einsum("tji,tnj->tni", rotation.matrix(orientation), arms)
        return np.sum((inside / [k, k, 1.0]) ** 2, axis=-1)

    level = levels(tracers["orientation"])
    assert level.min() >= 1.0 - 1e-14
    # Nor that of the motion itself, which was integrated by another method.
    assert levels(result.orientation).min() > 1.0
    assert level[-1].max() < 1.0 + 1e-3  # nor do they leave it soon
    assert np.linalg.norm(arms[-1, 0] - arms[0, 0]) > 1.0


def test_lines_alone_need_no_points(write_case, tmp_path, monkeypatch):
    lines = {"surface": None, "check": 0, "vtk": False, "tracers": {"duration": 1, "number": 2}}
    case = {"task": "field", "flow": {"type": "shear"}, "body": {"aspect_ratio": 0.5}}
    monkeypatch.chdir(tmp_path)
    path = write_case(case | {"field": lines})
    assert run_command([path.name, "--quiet"]) == 0
    result = load(tmp_path / "case.h5")
    assert 0.0 < result.summary["errors"]["no slip"] < 1e-12


@pytest.mark.parametrize("claimed", [True, False], ids=["claimed", "written"])
def test_a_full_disk_ends_a_field_in_one_line(claimed, write_case, tmp_path, monkeypatch, capfd):
    """It is full when room is claimed, or, where the file system claims none, when rows come."""
    path = write_case(CASE)
    monkeypatch.chdir(tmp_path)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    with monkeypatch.context() as patch:
        if not claimed:
            patch.setattr(os, "posix_fallocate", lambda *_: None)
        resource.setrlimit(resource.RLIMIT_FSIZE, (30_000, limits[1]))
        try:
            assert run_command([path.name, "--quiet"]) == 1
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    told = capfd.readouterr().err.splitlines()
    reason = os.strerror(errno.EFBIG)
    assert told == [f"qbxstokes: case.h5: cannot be written ({reason})"]
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["case.yaml"]


def test_field_of_a_motion(write_case, run_cli, tmp_path):
    done = run_cli(write_case(MOTION), "--json")
    assert done.returncode == 0, done.stderr
    result = load(tmp_path / "case.h5")
    field = result.groups["field"]
    assert field["time"].tolist() == [0.0, 1.5]
    for step, index in enumerate((0, 3)):
        shell = field["shells"]
        arm = shell["points"][step] - result.position[index]
        rigid = result.velocity[index] + np.cross(result.angular_velocity[index], arm)
        assert np.abs(shell["velocity"][step] - rigid).max() < 1e-10
    tracers = field["tracers"]
    assert tracers["time"].tolist() == [0.0, 1.0, 2.0]
    assert np.allclose(tracers["points"][0, 0], [1.0, 0.2, 0])
    assert np.isnan(tracers["points"][:, 1]).all()
    assert np.allclose(tracers["position"], result.position[[0, 2, 4]], atol=1e-7)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"field": {"plane": {"second": [1, 0, 0]}}}, "field.plane.second"),
        ({"field": {"surface": None}}, "asks for nothing"),
        ({"field": {"body": "held", "force": [1, 0, 0]}}, "field.force"),
        ({"field": {"points": {"file": "missing.csv"}}}, "missing.csv"),
        ({"field": {"tracers": {}}}, "duration"),
        ({"field": {"at": [0.0]}}, "field.at"),
        ({"field": {"shells": {"distances": [0.1, 0.1]}}}, "distances"),
        ({"field": {"plan": {}}}, "did you mean plane?"),
        ({"time": {"end": 1.0}}, "time"),
    ],
)
def test_bad_sections_are_told(write_case, run_cli, change, told):
    done = run_cli("check", write_case({**CASE, **change}))
    if "missing.csv" in told:  # seen when the case is planned
        done = run_cli(write_case({**CASE, **change}), "--dry-run")
    assert done.returncode == 2
    assert told in done.stderr
    assert "Traceback" not in done.stderr


def test_points_from_files(write_case, run_cli, tmp_path):
    points = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0 + 1e-12]])
    np.save(tmp_path / "points.npy", points)
    np.savetxt(tmp_path / "points.csv", points, delimiter=",", header="x,y,z", comments="")
    found = []
    for name in ("points.npy", "points.csv"):
        case = CASE | {
            "start": {"orientation": {"axis": [0, 0, 1]}},
            "field": {"points": {"file": name}, "surface": None, "vtk": False, "check": 0},
        }
        done = run_cli(write_case(case), "--quiet", "--overwrite")
        assert done.returncode == 0, done.stderr
        found.append(load(tmp_path / "case.h5").groups["field"]["points"])
    assert found[0]["inside"].tolist() == [[False, True, False]]
    assert np.array_equal(found[0]["stress"], found[1]["stress"], equal_nan=True)
