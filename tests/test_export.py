"""Results for other programs: tables, Datasets, CSV, NPZ and netCDF files; `-o FILE`."""

from __future__ import annotations

import csv
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import Run

import qbxstokes as qs
from qbxstokes.errors import CaseError, MissingPackageError

SCENE = {"body": {"aspect_ratio": 0.5}, "flow": {"type": "shear"}}
MOTION = {**SCENE, "time": {"periods": 1, "samples": 11}}
TASKS: dict[str, dict[str, Any]] = {
    "motion": MOTION,
    "sweep": {**MOTION, "sweep": {"axes": [{"body.aspect_ratio": [0.5, 2]}]}},
    "field": {"task": "field", **SCENE, "field": {"plane": {"shape": [4, 3]}, "vtk": False}},
    "body": {"task": "body", "body": {"aspect_ratio": 0.5}},
    "rheology": {
        "task": "rheology",
        "body": {"aspect_ratio": 0.5},
        "flow": {"type": "shear"},
        "rheology": {"peclet_number": [1.0, 2.0, 4.0]},
    },
}


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    folder = tmp_path_factory.mktemp("results")
    return {name: qs.run(case, file=folder / f"{name}.h5") for name, case in TASKS.items()}


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as stream:
        return list(csv.DictReader(stream))


ROWS = {"motion": 11, "sweep": 2, "field": 12, "body": 1, "rheology": 3}


@pytest.mark.parametrize("task", TASKS)
def test_every_task_is_exported(task: str, results: dict[str, Any], tmp_path: Path) -> None:
    """All numbers come back to the last bit, from each format."""
    result = results[task]
    made = result.export(tmp_path / "out.csv")
    table = rows(made[0])
    assert len(table) == ROWS[task]
    with np.load(result.export(tmp_path / "out.npz")[0]) as arrays:
        held = {name: arrays[name] for name in arrays.files}
    assert "units" in held
    for name in result.names:
        if name != "table":
            assert np.array_equal(held[name], result[name], equal_nan=True), name
    xarray = pytest.importorskip("xarray")
    pytest.importorskip("h5netcdf")
    data = xarray.load_dataset(result.export(tmp_path / "out.nc")[0])
    for name in result.names:
        if name != "table":
            assert np.array_equal(data[name], result[name], equal_nan=True), name
            assert data[name].attrs["units"] == result.attributes[name]["units"]
    opened = xarray.load_dataset(result.path, engine="h5netcdf")  # the result itself
    assert {name: opened[name].dims for name in result.names} == {
        name: ("trajectory",) if name == "table" else data[name].dims for name in result.names
    }
    assert not set(opened) - set(result.names)
    if task == "motion":
        assert [float(row["axis_3"]) for row in table] == result.axis[:, 2].tolist()
        assert data["axis"].dims == ("time", "component")
    elif task == "sweep":
        assert [float(row["end"]) for row in table] == result.table["end"].tolist()
        assert data["axis"].dims == ("trajectory", "sample", "component")
        assert np.array_equal(held["table/end"], result.table["end"])
    elif task == "field":
        assert made[0].name == "out-plane.csv"
        plane = result.groups["field"]["plane"]
        assert [float(row["velocity_1"]) for row in table] == plane["velocity"][0, :, 0].tolist()
        assert np.array_equal(held["field/plane/velocity"], plane["velocity"])
    elif task == "body":
        assert float(table[0]["resistance_3_3"]) == result.resistance[2, 2]
        assert data["resistance"].dims == ("resistance_row", "resistance_column")
    else:
        assert [float(row["particle_stress_1_2"]) for row in table] == (
            result.particle_stress[:, 0, 1].tolist()
        )
        assert data["distribution"].dims == ("peclet_number", "theta", "phi")


@pytest.mark.parametrize("task", TASKS)
def test_tables_of_pandas_are_those_of_csv(
    task: str, results: dict[str, Any], tmp_path: Path
) -> None:
    pandas = pytest.importorskip("pandas")
    if task == "field":
        return
    frame = results[task].to_pandas().reset_index(drop=task == "body")
    made = pandas.read_csv(
        results[task].export(tmp_path / "out.csv")[0], float_precision="round_trip"
    )
    assert list(frame.columns) == list(made.columns)
    numbers = frame.select_dtypes("number")
    assert np.array_equal(numbers, made[numbers.columns], equal_nan=True)


@pytest.mark.parametrize(
    ("package", "use"),
    [
        ("pandas", lambda result, folder: result.to_pandas()),
        ("xarray", lambda result, folder: result.to_xarray()),
        ("h5netcdf", lambda result, folder: result.export(folder / "a.nc")),
    ],
)
def test_a_missing_library_is_told_in_a_line(
    package: str,
    use: Callable[[Any, Path], Any],
    results: dict[str, Any],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(MissingPackageError, match=f"needs {package}, which is not .* pip install"):
        use(results["motion"], tmp_path)
    assert not list(tmp_path.iterdir())


def test_command_exports(
    results: dict[str, Any], run_cli: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    sweep = str(results["sweep"].path)
    assert run_cli("export", sweep, "--csv", "--npz", "-o", "out").stdout == (
        "out/sweep.csv\nout/sweep.npz\n"
    )
    assert (
        run_cli("export", sweep, "--format", "npz", "-o", "out/new").stdout == "out/new/sweep.npz\n"
    )
    assert json.loads(run_cli("export", sweep, "--trajectory", "1", "--json").stdout) == [
        "sweep-1.csv"
    ]
    times = [float(row["time"]) for row in rows(tmp_path / "sweep-1.csv")]
    assert times == results["sweep"].trajectory(1).time.tolist()
    again = run_cli("export", sweep, "--trajectory", "1")
    assert (again.returncode, again.stderr) == (
        2,
        "sweep-1.csv: exists already; choose another name with -o, or --overwrite\n",
    )
    assert run_cli("export", sweep, "--overwrite", "-o", "named.npz", "--quiet").stdout == ""
    assert (tmp_path / "named.npz").exists()
    for words, told in (
        (["-o", "a.xlsx"], "a.xlsx: -o takes a folder, or a file that ends in .csv, .npz, .nc"),
        ([sweep, "-o", "a.csv"], "a.csv: one file for several results; name a folder"),
        (["-o", "named.npz/x"], "cannot be made a folder"),
    ):
        done = run_cli("export", sweep, *words)
        assert done.returncode == 2
        assert told in done.stderr
        assert done.stderr.count("\n") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["named.npz", "out", "sweep-1.csv"]
    with pytest.raises(CaseError, match=r"a\.xlsx: results are exported as \.csv, \.npz, \.nc"):
        results["motion"].export("a.xlsx")


def test_every_command_that_writes_takes_a_file(
    write_case: Callable[..., Path], run_cli: Run, tmp_path: Path
) -> None:
    case = write_case(MOTION | {"time": {"periods": 1, "samples": 41}}).name
    for words in (
        [case, "-o", "my.h5", "--quiet"],
        ["plot", "my.h5", "--kind", "orbit", "-o", "sub/orbit.png"],
        ["plot", "my.h5", "--kind", "orbit", "-o", "sub"],
        ["animate", "my.h5", "--frames", "1", "-o", "film.gif"],
        ["export", "my.h5", "-o", "my.npz"],
        ["new", "-o", "mine.yaml"],
        ["schema", "-o", "schema.json"],
        ["check", case, "-o", "other.h5"],
    ):
        done = run_cli(*words)
        assert done.returncode == 0, done.stderr
    names = {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*.*")}
    assert names == {
        *(case, "my.h5", "sub/orbit.png", "sub/my-orbit.pdf", "film.gif", "my.npz"),
        *("mine.yaml", "schema.json"),
    }
    for words, told in (
        ([case, "-o", "nowhere/my.h5"], "there is no directory nowhere"),
        (["plot", "my.h5", "-o", "a.pdf"], "a.pdf: is one picture; choose with --kind among orbit"),
        (["info", "my.h5", "-o", "a"], "info writes no file, so takes no -o"),
        (["new", "-o", "mine.yaml"], "mine.yaml: exists already"),
    ):
        done = run_cli(*words)
        assert done.returncode == 2
        assert told in done.stderr
