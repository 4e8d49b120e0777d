"""The one store: whole files, locks, parts, and what a resumed run finds."""

from __future__ import annotations

import fcntl
import multiprocessing
import os
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from qbxstokes.errors import CaseError, OutputError, ResultFileError
from qbxstokes.io import store
from qbxstokes.io.store import (
    DamagedPart,
    Work,
    holds_work,
    locked,
    open_work,
    read_part,
    write_part,
)
from qbxstokes.runs.sharing import ALONE, Gathering, notes

IDENTITY = {"body": {"aspect_ratio": 0.5}, "options": []}
ROWS = {"index": np.arange(3), "x": np.linspace(0.0, 1.0, 6).reshape(3, 2), "n": np.float64(7.0)}


def test_a_part_is_what_was_written_bit_by_bit(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    kinds = {**ROWS, "word": np.array([b"ab", b""]), "none": np.empty((0, 3))}
    write_part(path, kinds, {"block": 3, "why": "é"})
    arrays, note = read_part(path)
    assert note == {"block": 3, "why": "é"}
    assert set(arrays) == set(kinds)
    for name, values in kinds.items():
        assert np.asarray(arrays[name]).tobytes() == np.asarray(values).tobytes()
        assert np.shape(arrays[name]) == np.shape(values)
    assert list(read_part(path, ["x"])[0]) == ["x"]
    assert os.listdir(tmp_path) == ["a.h5"]


def test_damage_is_noticed(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    data = {"x": np.linspace(0.0, 1.0, 1000)}
    write_part(path, data, {})
    whole = path.read_bytes()
    place = whole.index(data["x"].tobytes()[800:1600])
    flipped = bytearray(whole)
    flipped[place + 5] ^= 1
    for damaged in (b"", whole[: len(whole) // 2], whole[1:], b"\0" * len(whole), bytes(flipped)):
        path.write_bytes(damaged)
        with pytest.raises(DamagedPart):
            read_part(path)


def test_a_full_disk_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: Any) -> int:
        raise OSError(28, "No space left on device")

    work = open_work(tmp_path / "r.h5", IDENTITY)
    with monkeypatch.context() as patch:
        patch.setattr(os, "write", full)
        with pytest.raises(OutputError, match=r"No space left on device.*--resume"):
            work.save("rows", ROWS, {})
    assert sorted(os.listdir(work.folder)) == ["lock"]
    work.close(remove=True)
    assert os.listdir(tmp_path) == []


def test_a_second_run_at_the_same_place_is_told_the_truth(tmp_path: Path) -> None:
    target = tmp_path / "r.h5"
    work = open_work(target, IDENTITY)
    for how in ({}, {"resume": True}, {"overwrite": True}):
        with pytest.raises(CaseError, match=rf"another run is writing here .*{os.getpid()}"):
            open_work(target, IDENTITY, **how)
    work.note_run()
    work.save("rows", ROWS, {})
    with pytest.raises(CaseError, match="another run is writing here"):
        open_work(target, IDENTITY, resume=True)
    assert len(work.parts("rows")) == 1
    work.close()
    with pytest.raises(CaseError, match="an unfinished run is kept in"):
        open_work(target, IDENTITY)
    open_work(target, IDENTITY, resume=True).close(remove=True)
    open_work(target, IDENTITY).close(remove=True)


def _race(target: Path, barrier: Any, queue: Any) -> None:
    barrier.wait()
    try:
        work = open_work(target, IDENTITY)
        queue.put("runs")
        barrier.wait()
        work.close(remove=True)
    except CaseError as error:
        queue.put("another run is writing here (process " in str(error))
        barrier.wait()


def test_of_two_programs_started_at_once_one_runs(tmp_path: Path) -> None:
    context = multiprocessing.get_context("fork")
    for _ in range(10):
        barrier, queue = context.Barrier(2), context.Queue()
        both = [
            context.Process(target=_race, args=(tmp_path / "r.h5", barrier, queue)) for _ in "ab"
        ]
        for process in both:
            process.start()
        told = [queue.get(timeout=30), queue.get(timeout=30)]
        for process in both:
            process.join(30)
        assert sorted(map(str, told)) == ["True", "runs"]


def test_who_took_the_lock_a_moment_ago_is_named(tmp_path: Path) -> None:
    """Between taking the lock and writing its name into it, another program may look."""
    with open(tmp_path / "lock", "w") as owned:
        fcntl.flock(owned, fcntl.LOCK_EX)
        named = threading.Timer(0.05, lambda: (owned.write("process 7"), owned.flush()))
        named.start()
        with pytest.raises(CaseError, match=r"another run is writing here \(process 7\)"):
            locked(tmp_path)
        named.join()


def test_resuming_compares_what_numbers_depend_on(tmp_path: Path) -> None:
    target = tmp_path / "r.h5"
    work = open_work(target, IDENTITY)
    assert not work.resumed
    work.note_run()
    assert not holds_work(work.folder)  # nothing to go on with yet
    work.save_state("7", {"step": 1, "held": [ROWS]})
    work.save_state("7", {"step": 2, "held": [ROWS]})
    work.close()
    assert holds_work(work.folder)
    other = {**IDENTITY, "body": {"aspect_ratio": 0.6}}
    with pytest.raises(CaseError, match=r"another body\.aspect_ratio; restore it"):
        open_work(target, other, resume=True)
    again = open_work(target, IDENTITY, resume=True)
    assert (again.resumed, again.run) == (True, 2)
    found = again.state("7")
    assert found is not None
    assert found["step"] == 2
    assert all(np.array_equal(found["held"][0][name], held) for name, held in ROWS.items())
    again.drop_state("7")
    assert again.state("7") is None
    again.close()
    begun = open_work(target, other, overwrite=True)
    assert os.listdir(begun.folder) == ["lock"]
    begun.close(remove=True)


def test_small_work_is_gathered_and_comes_back_in_order(tmp_path: Path) -> None:
    work = open_work(tmp_path / "r.h5", IDENTITY)
    work.note_run()
    gathering = Gathering(ALONE, work, "blocks", joined=True, every=1e9)
    for number in range(5):
        gathering.add({"index": np.array([number])}, {"block": number})
    assert work.parts("blocks") == []
    gathering.save()
    assert len(work.parts("blocks")) == 1
    gathering.add({"index": np.array([5])}, {"block": 5})
    items = list(gathering.collect())
    assert [part["index"].tolist() for part, _ in items] == [[0, 1, 2, 3, 4], [5]]
    assert [note["block"] for note in notes(work, "blocks")] == [0, 1, 2, 3, 4]
    apart = Gathering(ALONE, work, "field", every=0.0)
    for number in range(2):
        apart.add({"points": np.full((number, 3), number)}, {"number": number})
    assert len(work.parts("field")) == 2
    assert [part["points"].shape for part, _ in apart.collect()] == [(0, 3), (1, 3)]
    work.parts("field")[0].write_bytes(b"torn")
    with pytest.raises(ResultFileError, match="--resume"):
        list(apart.collect())
    assert [note["number"] for note in notes(work, "field")] == [1]
    work.close(remove=True)


def test_many_ranks_make_thousands_of_files_not_millions(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A hundred ranks with a thousand blocks each, ten a second, by a clock of our own."""
    saved, now = [0], [0.0]
    monkeypatch.setattr(Work, "save", lambda *_: saved.__setitem__(0, saved[0] + 1))
    monkeypatch.setattr("qbxstokes.runs.sharing.time.monotonic", lambda: now[0])
    work = Work(tmp_path / "r.h5", IDENTITY, 1)
    rows, ranks, blocks = {"index": np.arange(8)}, 100, 1000
    for rank in range(ranks):
        now[0] = 0.0
        gathering = Gathering(
            SimpleNamespace(rank=rank, size=ranks), work.joined(rank), "blocks", joined=True
        )
        for block in range(blocks):
            now[0] += 0.1
            gathering.add(rows, {"block": block})
    assert ranks <= saved[0] <= 4 * ranks  # 100 s each, a part every 30 s, the rest by message


def test_a_folder_that_cannot_be_made_is_told(tmp_path: Path) -> None:
    (tmp_path / "r.h5.parts").write_text("a file in the way")
    with pytest.raises(OutputError, match="cannot be made"):
        store.open_work(tmp_path / "r.h5", IDENTITY)
