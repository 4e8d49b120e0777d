"""Work on its way to a result: whole files, each by one writer, and what a resumed run finds.

A result `NAME.h5` in the making has a working folder `NAME.h5.parts/` with

    lock          held by the run that is at work, and gone with it however it ends
    run.json      what the numbers depend on: a run goes on only where nothing of it has changed
    KIND-*.h5     parts: arrays of finished work with a note, numbered by run, writer and order;
                  the result may show them in place of copies, and they then stay (`finished`)
    state-*.h5    resumable states of work in progress, each replaced by the next

Every file is written by one process under a temporary name, brought to the disk and renamed: one
that carries its name is whole. No two processes ever write one file, since network file systems
promise nothing there. To resume means to do what no part holds.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import shutil
import time
from collections.abc import Iterable, Mapping
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from qbxstokes.errors import CaseError, OutputError
from qbxstokes.io.format import first_difference
from qbxstokes.io.names import numbered, parts_of
from qbxstokes.io.results import shows_parts
from qbxstokes.io.writer import whole_file
from qbxstokes.typing import AnyArray

RUN, LOCK = "run.json", "lock"
_NOTE, _SUFFIX = "note", ".h5"
_FORMAT = 3  # of what parts and states hold
# Names of results, with numbers, that are looked through for a run to go on with.
NUMBERED = 1000


# Arrays by their names; lists are pieces of one, end to end.
Arrays = Mapping[str, AnyArray | list[AnyArray]]


class DamagedPart(Exception):
    """A part that is not whole, or not one of ours."""


# -- whole files ----------------------------------------------------------------------------------


def write_whole(path: Path, data: bytes) -> None:
    """Write a file that appears under its name complete or not at all; raises OSError."""
    with whole_file(path) as stream:
        stream.write(data)


def _taken_out(value: Any, path: str, arrays: dict[str, AnyArray]) -> Any:
    """Nested data with nothing in the place of its arrays, which go to `arrays` by their paths."""
    if isinstance(value, np.ndarray):
        arrays[path] = value
        return None
    if isinstance(value, Mapping):
        return {key: _taken_out(entry, f"{path}|{key}", arrays) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_taken_out(entry, f"{path}|{n}", arrays) for n, entry in enumerate(value)]
    return value


def write_part(path: Path, arrays: Arrays, note: Mapping[str, Any]) -> None:
    """Arrays and a note as an HDF5 file; damage to either is noticed when reading.

    The note is plain data that may hold arrays, too. Raises OSError.
    """
    import h5py

    held: dict[str, Any] = {}
    note = _taken_out(note, "", held)
    pieces_of = {
        name: values if isinstance(values, list) else [np.asarray(values)]
        for name, values in {**arrays, **held}.items()
    }
    kinds = {
        name: {"scalar": first.ndim == 0, "text": first.dtype.kind == "U"}
        for name, (first, *_) in pieces_of.items()
    }
    text = json.dumps({"note": note, "kinds": kinds}).encode()
    pieces_of[_NOTE] = [np.frombuffer(text, dtype=np.uint8)]
    with whole_file(path) as stream, h5py.File(stream, "w", libver=("v110", "v110")) as file:
        for name, pieces in pieces_of.items():
            pieces = [np.atleast_1d(piece) for piece in pieces]
            if pieces[0].dtype.kind == "U":
                pieces = [np.char.encode(piece, "utf-8") for piece in pieces]
            first, length = pieces[0], sum(map(len, pieces))
            checked: dict[str, Any] = {}
            if first.size:
                checked = {"fletcher32": True, "chunks": first.shape}
            data = file.create_dataset(
                name, (length, *first.shape[1:]), first.dtype, track_times=False, **checked
            )
            end = 0
            for piece in pieces:
                end += len(piece)
                data[end - len(piece) : end] = piece


def read_part(
    path: Path, names: Iterable[str] | None = None
) -> tuple[dict[str, AnyArray], dict[str, Any]]:
    """Arrays and note of a part, or of its arrays only those of the names.

    Raises DamagedPart, OSError.
    """
    import h5py

    if not path.is_file():
        raise FileNotFoundError(2, "No such file", str(path))
    try:
        with h5py.File(path, "r") as file:
            told = json.loads(file[_NOTE][()].tobytes())
            wanted = [name for name in file if name != _NOTE] if names is None else names
            arrays = {name: file[name][()] for name in wanted}
        for name in arrays.keys() & told["kinds"].keys():
            if told["kinds"][name]["text"]:
                arrays[name] = np.char.decode(arrays[name], "utf-8")
            if told["kinds"][name]["scalar"]:
                arrays[name] = np.asarray(arrays[name][0])
        note = told["note"]
        for name in [name for name in arrays if name.startswith("|")]:
            holder, (*keys, last) = note, name[1:].split("|")
            for key in keys:
                holder = holder[int(key) if isinstance(holder, list) else key]
            holder[int(last) if isinstance(holder, list) else last] = arrays.pop(name)
    except Exception as error:  # h5py reports damage by errors of many kinds
        raise DamagedPart(f"{path}: {' '.join(str(error).split())}") from None
    return arrays, note


# -- working folders ------------------------------------------------------------------------------


class Work:
    """The working folder of a result as one writer sees it.

    target: the result. writer: number of this process among those at work; the first holds the
    lock. run: how many runs have been at work here, this one included. identity: what the numbers
    depend on. resumed: whether there is work of an earlier run. stays: whether the result shows
    what is in the folder.
    """

    def __init__(
        self, target: Path, identity: Mapping[str, Any], run: int, writer: int = 0
    ) -> None:
        self.target, self.identity, self.run, self.writer = target, dict(identity), run, writer
        self.folder = parts_of(target)
        self.resumed, self.stays = run > 1, False
        self._lock: int | None = None
        self._count = 0

    def joined(self, writer: int) -> Work:
        """The same folder for another process of the run; plain data, to be sent to it."""
        return Work(self.target, self.identity, self.run, writer)

    # -- what is written ----------------------------------------------------------------------

    def save(self, kind: str, arrays: Arrays, note: Mapping[str, Any]) -> Path:
        """Make finished work safe as a part; raises OutputError."""
        self._count += 1
        name = f"{kind}-{self.run:04d}-{self.writer:05d}-{self._count:06d}{_SUFFIX}"
        self._write(self.folder / name, arrays, note)
        return self.folder / name

    def save_state(self, name: str, state: Mapping[str, Any]) -> None:
        """Replace the resumable state (a note) of work in progress; raises OutputError."""
        self._write(self.folder / f"state-{name}{_SUFFIX}", {}, state)

    def drop_state(self, name: str) -> None:
        """Forget the state of work that is finished."""
        (self.folder / f"state-{name}{_SUFFIX}").unlink(missing_ok=True)

    def _write(self, path: Path, arrays: Arrays, note: Mapping[str, Any]) -> None:
        try:
            write_part(path, arrays, note)
        except OSError as error:
            raise unwritable(self.folder, error) from None

    # -- what is found ------------------------------------------------------------------------

    def parts(self, kind: str) -> list[Path]:
        """Parts of a kind in the order in which they were written, writer by writer."""
        return sorted(self.folder.glob(f"{kind}-*{_SUFFIX}"))

    def state(self, name: str) -> dict[str, Any] | None:
        """The state of work in progress, None where there is none that is whole."""
        try:
            return read_part(self.folder / f"state-{name}{_SUFFIX}")[1]
        except (OSError, DamagedPart):
            return None

    # -- beginning and end --------------------------------------------------------------------

    def hold(self) -> Work:
        """Take the lock; raises CaseError where another run has it."""
        self._lock = locked(self.folder)
        return self

    def note_run(self, finished: bool = False) -> None:
        """Write down what this run is: from now on it may be gone on with, unless it is finished.

        finished: the result is there, and shows the parts.
        """
        told = {"run": self.run, "identity": self.identity}
        told |= {"finished": finished, "format": _FORMAT}
        self.stays = finished
        try:
            write_whole(self.folder / RUN, json.dumps(told).encode())
        except OSError as error:
            raise unwritable(self.folder, error) from None

    def close(self, remove: bool = False) -> None:
        """Let go of the folder; with `remove` it goes as well."""
        if remove:
            # First what says that there is something to go on with: some parts alone are no run.
            (self.folder / RUN).unlink(missing_ok=True)
            shutil.rmtree(self.folder, ignore_errors=True)
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None


# -- of several runs that would write at one place, one holds the lock of its folder -------------


def locked(folder: Path) -> int:
    """A descriptor that holds the folder's lock, the folder being made where it is not there."""
    while True:
        try:
            folder.mkdir(exist_ok=True)
            descriptor = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o644)
        except FileNotFoundError:  # its owner has just removed it
            continue
        except OSError as error:
            raise OutputError(
                f"{folder}: cannot be made ({error.strerror or error}); choose another output.file"
            ) from None
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            who = _owner(descriptor)
            os.close(descriptor)
            raise CaseError(
                f"{folder}: another run is writing here{f' ({who})' if who else ''}; wait for it, "
                "or choose another output.file"
            ) from None
        except OSError:  # a file system without locks: two runs at once cannot be told apart
            pass
        try:
            if os.stat(folder / LOCK).st_ino == os.fstat(descriptor).st_ino:
                break
        except FileNotFoundError:
            pass
        os.close(descriptor)  # the folder was removed, and perhaps made anew, in between
    os.ftruncate(descriptor, 0)
    os.write(descriptor, f"process {os.getpid()} on {os.uname().nodename}\n".encode())
    return descriptor


def _owner(descriptor: int) -> str:
    """Who holds a lock: whoever has just taken it may not have written its name yet."""
    until = time.monotonic() + 1.0
    while not (who := os.pread(descriptor, 200, 0)) and time.monotonic() < until:
        time.sleep(0.01)
    return who.decode(errors="replace").strip()


def unwritable(place: Path, error: OSError) -> OutputError:
    """The error for a disk that takes no more: what is on it stays valid."""
    return OutputError(
        f"{place}: cannot be written ({error.strerror or error}). What was finished is kept: make "
        "room and run again with --resume"
    )


def _run_in(folder: Path) -> dict[str, Any] | None:
    """What run.json says, None where there is none that can be read."""
    try:
        found = json.loads((folder / RUN).read_text())
        return {
            "run": int(found["run"]),
            "identity": dict(found["identity"]),
            "finished": bool(found.get("finished")),
            "format": found.get("format", 1),
        }
    except (OSError, ValueError, KeyError, TypeError):
        return None


def holds_work(folder: Path) -> bool:
    """Whether an earlier run has left anything in a working folder to go on with."""
    told = _run_in(folder)
    work = any(folder.glob(f"[!.]*-*{_SUFFIX}"))
    return told is not None and not told["finished"] and work


def remove_remains(target: Path) -> None:
    """Remove the working folder of a finished result that a killed run was about to remove."""
    folder = parts_of(target)
    if folder.is_dir() and not (folder / RUN).exists():
        with contextlib.suppress(CaseError, OutputError):  # its owner is at it, or it may not be
            Work(target, {}, 1).hold().close(remove=True)


def check_disk(target: Path, needed: float, what: str, right: str) -> None:
    """Refuse what the disk cannot hold before anything is computed; raises OutputError.

    needed: bytes in all, of which the parts of an unfinished run have theirs.
    """
    folder, parts = target.parent, parts_of(target)
    there = parts.glob("*-*.h5") if holds_work(parts) else ()
    held = sum(path.stat().st_size for path in there)
    free = shutil.disk_usage(folder).free
    if free < needed - held:
        size, room = f"{needed / 1e6:.3g} MB", f"{free / 1e6:.3g} MB"
        raise OutputError(f"{folder}: {room} are free, and {what} needs {size}, {right}")


def open_work(
    asked: Path, identity: Mapping[str, Any], *, resume: bool = False, overwrite: bool = False
) -> Work:
    """The working folder of a run, held: of a new one, or of an unfinished one to go on with.

    asked: the result that the case names; a new run takes the next free name unless it overwrites.
    Raises CaseError where another run is at work, where an unfinished run is neither gone on with
    nor to be overwritten, and where what is to be resumed depends on something that has changed.
    """
    wanted = json.loads(json.dumps(identity))
    if resume:
        for name in islice(numbered(asked), NUMBERED):
            if holds_work(parts_of(name)):
                return reopen(name, wanted)
            if not name.exists():
                break
    target = asked if overwrite else free_name(asked)
    work = Work(target, wanted, 1).hold()
    for name in dict.fromkeys([asked, target]):
        folder = parts_of(name)
        if not overwrite and holds_work(folder):
            if name != target:  # is it at work, or has it stopped?
                Work(name, wanted, 1).hold().close()
            work.close(remove=name != target)
            raise CaseError(
                f"{name}: an unfinished run is kept in {folder}; go on with --resume, or begin "
                "anew with --overwrite"
            )
    if any(work.folder.glob(f"[!.]*-*{_SUFFIX}")) and shows_parts(target):
        target.unlink()  # it would show what takes the place of its parts
    (work.folder / RUN).unlink(missing_ok=True)
    for path in work.folder.iterdir():
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path, ignore_errors=True)
        elif path.name != LOCK:
            path.unlink(missing_ok=True)
    return work


def free_name(path: Path) -> Path:
    """`path`, or the first numbered name that neither a result nor the parts of one have."""
    return next(
        name
        for name in numbered(path)
        if not os.path.lexists(name) and not (_run_in(parts_of(name)) or {}).get("finished")
    )


def reopen(target: Path, identity: Mapping[str, Any]) -> Work:
    """The run of a result, held, if it depends on what this one does; raises CaseError."""
    wanted = json.loads(json.dumps(identity))
    work = Work(target, wanted, 1).hold()
    found = _run_in(work.folder)
    other = "case" if found is None else first_difference(found["identity"], wanted)
    if found is not None and found["format"] != _FORMAT:
        other = "version of the program"
    if found is None or other is not None:
        work.close()
        raise CaseError(
            f"{work.folder}: the run to go on with had another {other}; restore it, or begin anew "
            "with --overwrite"
        )
    work.run, work.resumed = found["run"] + 1, True
    for path in work.folder.glob(".*.part"):  # what a killed process was about to write
        path.unlink(missing_ok=True)
    work.note_run()  # parts of every run have names of their own
    return work
