"""Result files: layout, atomic writing, names that are not overwritten, refusals."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
from conftest import ROOT

from qbxstokes.errors import CaseError, ResultFileError
from qbxstokes.io.names import check_writable
from qbxstokes.io.results import load
from qbxstokes.io.writer import ResultWriter
from qbxstokes.motion.observables import OBSERVABLES
from qbxstokes.quantities import (
    COLUMNS,
    FLUID,
    HALF_TURN,
    MOTION,
    PARAMETER,
    POINT,
    RECORDABLE,
    SUMMARY,
    SURFACE,
    column,
)


def block(start: int, count: int) -> dict[str, np.ndarray]:
    time = np.arange(start, start + count, dtype=float)
    rng = np.random.default_rng(start)
    return {"time": time} | {
        name: rng.normal(size=(count, *about.shape)) for name, about in MOTION.items()
    }


def test_each_quantity_of_a_motion_has_one_function_and_names_of_its_own() -> None:
    assert list(OBSERVABLES) == list(RECORDABLE)
    for table in (RECORDABLE, HALF_TURN, FLUID | POINT | SURFACE, SUMMARY, PARAMETER):
        for name, about in table.items():
            assert about.name == name
            assert about.description
            assert len(about.symbols) == len(about.components) == (about.size if about.shape else 0)
    assert set(SUMMARY) <= {name.rstrip("_0123") for name in COLUMNS}
    assert column("final_velocity_2").heading == "final velocity $V_2$"
    assert column("hydrodynamics_n_theta") == column("n_theta")
    assert column("my_own").heading == "my own"


def write(path: Path, *blocks: dict[str, np.ndarray], overwrite: bool = False) -> Path:
    provenance = {"case": "body: {}\n" * 2000, "ranks": 2, "versions": {"numpy": "1"}}
    with ResultWriter(path, "motion", provenance, overwrite) as writer:
        for samples in blocks:
            writer.append(samples)
        return writer.finish({"error": 1e-12, "steps": 7, "note": None, "words": ["a", "b"]})


def test_appended_blocks_read_back_as_one(tmp_path: Path) -> None:
    first, second = block(0, 5), block(5, 3)
    result = load(write(tmp_path / "a.h5", first, second))
    for name in ("time", *MOTION):
        np.testing.assert_array_equal(result[name], np.concatenate([first[name], second[name]]))
    np.testing.assert_array_equal(result.axis, result["axis"])
    assert result.provenance["case"] == "body: {}\n" * 2000
    assert result.provenance["versions"] == {"numpy": "1"}
    assert result.summary["error"] == 1e-12
    assert result.summary["note"] is None
    assert result.summary["words"] == ["a", "b"]
    assert "axis" in dir(result)
    with pytest.raises(AttributeError, match="no dataset nothing"):
        _ = result.nothing


def test_every_dataset_has_units_and_time_as_its_scale(tmp_path: Path) -> None:
    with h5py.File(write(tmp_path / "a.h5", block(0, 4))) as file:
        assert file["time"].attrs["CLASS"] == b"DIMENSION_SCALE"
        for name in MOTION:
            assert file[name].dims[0][0].name == "/time"
            assert file[name].attrs["units"] == MOTION[name].units
        assert file.attrs["format"] == "qbxstokes"
        assert "q0, q1, q2, q3" in file.attrs["conventions"]


def test_existing_result_is_kept_unless_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    assert write(path, block(0, 2)) == path
    assert write(path, block(0, 3)) == tmp_path / "a-1.h5"
    assert write(path, block(0, 4)) == tmp_path / "a-2.h5"
    assert len(load(path).time) == 2
    assert write(path, block(0, 5), overwrite=True) == path
    assert len(load(path).time) == 5
    assert sorted(os.listdir(tmp_path)) == ["a-1.h5", "a-2.h5", "a.h5"]


def test_interrupted_writer_leaves_nothing(tmp_path: Path) -> None:
    with ResultWriter(tmp_path / "a.h5", "motion") as writer:
        writer.append(block(0, 2))
        assert os.listdir(tmp_path)
    assert not os.listdir(tmp_path)


def test_unwritable_targets_are_refused(tmp_path: Path) -> None:
    with pytest.raises(CaseError, match="is a directory"):
        ResultWriter(tmp_path, "motion")
    with pytest.raises(CaseError, match="no directory"):
        ResultWriter(tmp_path / "nowhere" / "a.h5", "motion")


def test_full_disk_is_reported_and_leaves_nothing(tmp_path: Path) -> None:
    script = """
import resource, signal, sys
import numpy as np
from pathlib import Path
from qbxstokes.errors import OutputError
from qbxstokes.io.writer import ResultWriter
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, 200_000))
try:
    with ResultWriter(Path("a.h5"), "motion") as writer:
        for start in range(100):
            writer.append({"time": np.arange(1000.0), "axis": np.ones((1000, 3))})
        writer.finish()
except OutputError as error:
    print(error)
"""
    done = subprocess.run(
        [sys.executable, "-c", script],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("a.h5: cannot be written")
    assert len(done.stdout.splitlines()) == 1
    assert not os.listdir(tmp_path)


def test_truncated_and_foreign_files_are_refused(tmp_path: Path) -> None:
    whole = write(tmp_path / "a.h5", block(0, 500)).read_bytes()
    for size in (0, 7, 100, len(whole) // 2, len(whole) - 1):
        (tmp_path / "cut.h5").write_bytes(whole[:size])
        with pytest.raises(ResultFileError):
            load(tmp_path / "cut.h5")
    damaged = bytearray(whole)
    data = np.frombuffer(load(tmp_path / "a.h5").axis.tobytes()[:64], np.uint8).tobytes()
    damaged[whole.index(data)] ^= 0xFF
    (tmp_path / "damaged.h5").write_bytes(damaged)
    with pytest.raises(ResultFileError, match="damaged"):
        load(tmp_path / "damaged.h5")
    with h5py.File(tmp_path / "foreign.h5", "w") as file:
        file["time"] = [1.0]
    with pytest.raises(ResultFileError, match="not written by this program"):
        load(tmp_path / "foreign.h5")
    for bad in ("missing.h5", "."):
        with pytest.raises(ResultFileError):
            load(tmp_path / bad)


HOLDER = "import h5py, sys; f = h5py.File(sys.argv[1], 'r+'); print('held', flush=True); input()"


def test_a_file_that_another_program_writes_is_neither_damaged_nor_replaced(tmp_path: Path) -> None:
    path = tmp_path / "r.h5"
    with ResultWriter(path, "motion", {}) as writer:
        writer.append({"time": [0.0]})
        writer.finish({"steps": 1})
    with subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "held\n"
        with pytest.raises(ResultFileError, match="another program has it open to write; wait"):
            load(path)
        with pytest.raises(CaseError, match="another program has it open to write; wait"):
            check_writable(path, overwrite=True)
        other.communicate("\n")
    assert load(path).time.tolist() == [0.0]
    check_writable(path, overwrite=True)


def test_result_converts_to_pandas_and_xarray(tmp_path: Path) -> None:
    result = load(write(tmp_path / "a.h5", block(0, 4)))
    pytest.importorskip("pandas")
    frame = result.to_pandas()
    np.testing.assert_array_equal(frame["axis_3"], result.axis[:, 2])
    np.testing.assert_array_equal(frame.index, result.time)
    pytest.importorskip("xarray")
    dataset = result.to_xarray()
    np.testing.assert_array_equal(dataset.axis, result.axis)
    assert dataset.velocity.attrs["units"] == "c/tau"
    assert list(dataset.euler_angles_component.values) == ["phi", "theta", "psi"]
