"""What is kept on disk: found again, never trusted when damaged, safe under many writers."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import pytest

import qbxstokes as qs
from qbxstokes import folders
from qbxstokes.folders import default_folder
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.io import cache as cache_module
from qbxstokes.io.cache import Cache
from qbxstokes.io.store import read_part, write_part
from qbxstokes.simulation.hydrodynamics import Workshop
from qbxstokes.simulation.stresses import form_stresslet

KEY = {"aspect_ratio": 0.1, "scheme": {"n_theta": 6}}
ARRAYS = {"weights": np.arange(6.0).reshape(2, 3), "size": np.array(3), "word": np.array("Φ")}


def entry(folder):
    (path,) = folder.glob("*.h5")
    return path


def test_what_is_stored_is_found_bit_by_bit(tmp_path):
    kept = Cache(tmp_path / "new" / "folder")
    assert kept.load("body", KEY) is None
    kept.store("body", KEY, ARRAYS)
    found = Cache(kept.folder).load("body", KEY)
    assert found is not None
    assert set(found) == set(ARRAYS)
    assert all(np.array_equal(found[name], ARRAYS[name]) for name in ARRAYS)
    assert kept.problems == []
    assert [path.suffix for path in kept.folder.iterdir()] == [".h5"]


@pytest.mark.parametrize(
    "other",
    [
        {**KEY, "aspect_ratio": 0.1 + 1e-17 + 2e-17},
        {**KEY, "aspect_ratio": np.nextafter(0.1, 1.0)},
        {**KEY, "scheme": {"n_theta": 8}},
        {**KEY, "more": None},
    ],
)
def test_any_difference_of_the_key_is_another_entry(tmp_path, other):
    kept = Cache(tmp_path)
    kept.store("body", KEY, ARRAYS)
    same = other["aspect_ratio"] == 0.1 and other == KEY
    assert (kept.load("body", other) is not None) == same
    assert kept.load("operator", KEY) is None


def test_changed_sources_or_format_find_nothing(tmp_path, monkeypatch):
    kept = Cache(tmp_path)
    kept.store("body", KEY, ARRAYS)
    monkeypatch.setattr(cache_module, "FORMAT_VERSION", cache_module.FORMAT_VERSION + 1)
    assert kept.load("body", KEY) is None
    monkeypatch.undo()
    monkeypatch.setattr(cache_module, "fingerprint", lambda: "other sources")
    assert kept.load("body", KEY) is None
    monkeypatch.undo()
    assert kept.load("body", KEY) is not None


def truncated(path):
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def empty(path):
    path.write_bytes(b"")


def flipped(path):
    data = bytearray(path.read_bytes())
    where = data.find(np.arange(6.0).tobytes())
    data[where + 9] ^= 0x10
    path.write_bytes(bytes(data))


def foreign(path):
    path.write_bytes(b"HDF\r\n" * 100)


def of_another_body(path):
    Cache(path.parent).store("body", {**KEY, "aspect_ratio": 7.0}, ARRAYS)
    (other,) = (each for each in path.parent.glob("*.h5") if each != path)
    os.replace(other, path)


def plain_array(path):
    np.save(path.with_suffix(".npy"), np.arange(3.0))
    os.replace(path.with_suffix(".npy"), path)


def without_a_note(path):
    with h5py.File(path, "w") as file:
        file["weights"] = ARRAYS["weights"]


@pytest.mark.parametrize(
    "damage", [truncated, empty, flipped, foreign, of_another_body, plain_array, without_a_note]
)
def test_damage_is_told_and_mended(tmp_path, damage):
    kept = Cache(tmp_path)
    kept.store("body", KEY, ARRAYS)
    path = entry(tmp_path)
    damage(path)
    again = Cache(tmp_path)
    assert again.load("body", KEY) is None
    (problem,) = again.problems
    assert str(path) in problem
    assert problem.endswith("computed anew")
    again.store("body", KEY, ARRAYS)
    assert Cache(tmp_path).load("body", KEY) is not None


def test_a_folder_that_cannot_be_used_costs_no_run(tmp_path):
    (tmp_path / "file").write_text("in the way")
    kept = Cache(tmp_path / "file" / "below")
    kept.store("body", KEY, ARRAYS)
    assert "not written" in kept.problems[0]
    assert kept.load("body", KEY) is None


def test_without_a_folder_nothing_is_kept():
    kept = Cache(None)
    kept.store("body", KEY, ARRAYS)
    assert kept.load("body", KEY) is None
    assert kept.problems == []


WRITER = """
import sys, numpy as np
from pathlib import Path
from qbxstokes.io import cache
from qbxstokes.io.cache import Cache
cache.fingerprint = lambda: "the same sources"
kept, bad = Cache(Path(sys.argv[1])), 0
arrays = {"weights": np.arange(200_000.0)}
for _ in range(15):
    kept.store("body", {"k": 1}, arrays)
    found = kept.load("body", {"k": 1})
    bad += found is None or not np.array_equal(found["weights"], arrays["weights"])
sys.exit(bool(bad or kept.problems))
"""


def test_many_processes_write_and_read_at_once(tmp_path):
    root = str(Path(cache_module.__file__).parents[2])
    environment = {**os.environ, "PYTHONPATH": root}
    command = [sys.executable, "-c", WRITER, str(tmp_path)]
    writers = [subprocess.Popen(command, env=environment) for _ in range(4)]
    assert [writer.wait(timeout=60) for writer in writers] == [0, 0, 0, 0]
    assert len(list(tmp_path.iterdir())) == 1


def test_folder_of_the_user(monkeypatch, tmp_path):
    monkeypatch.setenv("QBXSTOKES_CACHE", str(tmp_path))
    assert default_folder() == tmp_path
    monkeypatch.setenv("QBXSTOKES_CACHE", "")
    assert default_folder() is None
    monkeypatch.delenv("QBXSTOKES_CACHE")
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert default_folder() == tmp_path / "qbxstokes"
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert default_folder() == tmp_path / ".cache" / "qbxstokes"


def test_compiled_functions_go_where_something_can_be_written(monkeypatch, tmp_path):
    """Beside the sources, else below the program's own folder, else nowhere, and it is said."""
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv("QBXSTOKES_CACHE", str(tmp_path / "own"))
    sources = Path(folders.__file__).parent
    writable = folders.unwritable

    def locked(folder):  # the tests may be run by root, to whom all is open
        return f"{folder}: locked" if folder.is_relative_to(sources) else writable(folder)

    monkeypatch.setattr(folders, "unwritable", locked)
    own = tmp_path / "own" / "compiled"
    assert folders.folder_of_compiled() == (own, "")
    own.chmod(0o777)
    assert "written by, others" in folders.folder_of_compiled()[1]
    (tmp_path / "file").touch()
    monkeypatch.setenv("QBXSTOKES_CACHE", str(tmp_path / "file"))
    folder, told = folders.folder_of_compiled()
    assert folder is None
    assert "cannot be written" in told
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "numba"))
    assert folders.folder_of_compiled() == (tmp_path / "numba", "")


def test_a_warm_start_takes_milliseconds(tmp_path):
    from qbxstokes.bie.accuracy import AccurateBody, accurate_body
    from qbxstokes.geometry.spheroid import Spheroid

    body = accurate_body(Spheroid(0.5), 1e-10)
    Cache(tmp_path).store("body", KEY, body.to_arrays())
    best = np.inf
    for _ in range(5):
        start = time.perf_counter()
        arrays = Cache(tmp_path).load("body", KEY)
        again = AccurateBody.from_arrays(arrays)
        best = min(best, time.perf_counter() - start)
    assert best < 0.02
    assert again.model.resistance == body.model.resistance
    assert again.model.error_parts == body.model.error_parts
    assert again.scheme == body.scheme
    for name, weight in body.functional.weights.items():
        assert np.array_equal(again.functional.weights[name], weight)


# -- what is read is not believed -------------------------------------------------------------


def rewritten(path, change):
    """The entry with other arrays, whole and with a right checksum."""
    arrays, note = read_part(path)
    change(arrays)
    write_part(path, arrays, note)


def scaled(pattern, factor=1.5):
    def change(arrays):
        names = [name for name in arrays if pattern in name and arrays[name].dtype.kind == "f"]
        assert names
        arrays.update({name: factor * arrays[name] for name in names})

    return change


def without(name):
    return lambda arrays: arrays.pop(name)


def put(name, values):
    return lambda arrays: arrays.update({name: np.asarray(values)})


BODY_CHANGES = {
    "all": scaled(""),
    "law": scaled("model_linear"),
    "quadratic": scaled("model_quadratic"),
    "resistance": scaled("model_resistance"),
    "weights": scaled("weight_", 1.001),
    "nan": put("model_linear", np.nan),
    "missing": without("model_cubic"),
    "no scheme": without("scheme"),
    "shape": put("model_cubic", np.zeros((2, 2))),
    "type": put("model_linear", "two"),
    "other body": put("model_shape", json.dumps(Spheroid(0.4).spec())),
}
ROWS_CHANGES = {
    "all": scaled(""),
    "a little": scaled("double", 1.0 + 1e-5),
    "nan": scaled("single", np.nan),
    "missing": without("single"),
    "shape": lambda arrays: arrays.update(double=arrays["double"][:1]),
    "type": lambda arrays: arrays.update(double=arrays["double"].astype(np.float32)),
}
MOTION = {
    "body": {"aspect_ratio": 0.5, "stokes_number": 1},
    "flow": {"type": "plane_poiseuille", "half_width": 20},
    "start": {"position": [0, 0.3, 0]},
    "time": {"end": 1, "samples": 3},
    "hydrodynamics": {"tolerance": 1e-6},
}


@pytest.fixture(scope="module")
def entries(tmp_path_factory):
    """A folder with a body and an operator, and the numbers that they give."""
    folder, found = tmp_path_factory.mktemp("kept"), {}
    for kind, solve in (("body", "functional"), ("operator", "every_step")):
        case = {**MOTION, "hydrodynamics": {"tolerance": 1e-6, "solve": solve}}
        case["hydrodynamics"]["cache"] = str(folder)
        found[kind] = case, qs.run(case).axis
    return folder, found


@pytest.mark.parametrize(
    ("kind", "change"),
    [("body", name) for name in BODY_CHANGES]
    + [
        pytest.param("operator", name, marks=() if name == "all" else pytest.mark.slow)
        for name in ROWS_CHANGES
    ],
)
def test_wrong_numbers_are_computed_anew(entries, tmp_path, kind, change):
    """A whole entry with a right checksum and wrong arrays changes no result."""
    folder, found = entries
    case, axis = found[kind]
    shutil.copytree(folder, tmp_path / "kept")
    for path in (tmp_path / "kept").glob(f"{kind}-*"):
        rewritten(path, (BODY_CHANGES if kind == "body" else ROWS_CHANGES)[change])
    case = {**case, "hydrodynamics": {**case["hydrodynamics"], "cache": str(tmp_path / "kept")}}
    result = qs.run(case)
    np.testing.assert_array_equal(result.axis, axis)
    problems = result.summary["cache_problems"]
    assert any(f"{kind}-" in text and "computed anew" in text for text in problems), problems
    assert len(qs.run(case).summary["cache_problems"]) == 0  # mended


@pytest.mark.parametrize("name", ["numbers", "profile_1", "error_parts"])
def test_a_stresslet_is_not_believed_either(tmp_path, name):
    body = qs.Body(0.5, tolerance=1e-4)
    body.workshop = workshop = Workshop(cache=Cache(tmp_path))
    right = form_stresslet(body)
    assert form_stresslet(body).numbers.tolist() == right.numbers.tolist()
    rewritten(entry(tmp_path), scaled(name, np.nan if name == "error_parts" else 1.5))
    assert form_stresslet(body).numbers.tolist() == right.numbers.tolist()
    assert "computed anew" in workshop.cache.problems[0]


def test_a_sweep_says_what_it_does_not_believe(entries, tmp_path, capsys):
    case, _ = entries[1]["body"]
    shutil.copytree(entries[0], tmp_path / "kept")
    case = {**case, "hydrodynamics": {"tolerance": 1e-6, "cache": str(tmp_path / "kept")}}
    axes = {"start.position[1]": [0.3, 0.4]}
    whole = qs.sweep(case, axes)
    assert "cache" not in capsys.readouterr().err
    for path in (tmp_path / "kept").glob("body-*"):
        rewritten(path, scaled(""))
    np.testing.assert_array_equal(qs.sweep(case, axes).axis, whole.axis)
    assert "computed anew" in capsys.readouterr().err


@pytest.mark.parametrize("k", [0.02, 0.1, 0.5, 1.0, 3.0, 50.0])
@pytest.mark.parametrize("section", [{"tolerance": 1e-2}, {}, {"n_theta": 6}], ids=str)
def test_nothing_right_is_doubted(tmp_path, k, section):
    """Bodies that are coarse, thin or flat are found again."""
    body = qs.Body(k, tolerance=section.get("tolerance", 1e-10))
    case = {
        **MOTION,
        "body": {"aspect_ratio": k, "stokes_number": 1},
        "flow": {"type": "shear"},
        "time": {"end": 0.01, "samples": 2},
        "hydrodynamics": {**section, "cache": str(tmp_path)},
        "compare": {"reference": "none"},
    }
    assert body.shape.aspect_ratio == k
    qs.run(case)
    again = qs.run(case)
    assert again.summary["hydrodynamics"]["cache"] == "found"
    assert len(again.summary["cache_problems"]) == 0


def test_what_others_may_have_written_is_not_used(tmp_path):
    kept = Cache(tmp_path)
    kept.store("body", KEY, ARRAYS)
    path = entry(tmp_path)
    for make, told in (
        (lambda: path.chmod(0o666), "others may write it"),
        (lambda: path.unlink() or os.mkfifo(path), "not a file"),
        (lambda: path.unlink() or path.symlink_to("/etc/hostname"), "not a file"),
    ):
        make()
        again = Cache(tmp_path)
        assert again.load("body", KEY) is None
        assert told in again.problems[0]
    again.store("body", KEY, ARRAYS)
    assert Cache(tmp_path).load("body", KEY) is not None
    if os.geteuid() == 0:
        os.chown(path, 12345, -1)
        again = Cache(tmp_path)
        assert again.load("body", KEY) is None
        assert "belongs to another user" in again.problems[0]
