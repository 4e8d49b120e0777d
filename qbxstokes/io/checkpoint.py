"""What a long run leaves on disk before it is finished: a journal of rows and a checkpoint.

Both live in the working folder `RESULT.h5.parts/`. The journal is only ever appended to; the
checkpoint, which holds length and checksum of the journal that belongs to it, is written to a file
of its own and moved into place. Whatever instant a process or a machine ends at, the last
checkpoint and the journal up to its length are whole. A run shorter than the first checkpoint
leaves nothing.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import shutil
import struct
import zlib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from qbxstokes.errors import CaseError, OutputError
from qbxstokes.io.names import numbered, parts_of

Array = NDArray[np.float64]

ROWS, CHECKPOINT = "rows.bin", "checkpoint.json"
# A piece of rows: name, number of rows and of columns, then the numbers.
_HEAD = struct.Struct("<24sQQ")
# Rows are kept in memory up to this size (bytes) before the disk is needed.
_IN_MEMORY = 8 * 2**20


class Journal:
    """Pieces of rows by name, in order; in memory until they are many or must be safe.

    >>> journal = Journal(Path("result.h5"))
    >>> journal.append("samples", np.ones((2, 3)))
    >>> [(name, rows.shape) for name, rows in journal.pieces()]
    [('samples', (2, 3))]
    """

    def __init__(self, target: Path) -> None:
        """Nothing is touched until it is needed. target: the result the rows are for."""
        self.target = target
        self._stream: BinaryIO | None = None
        self._waiting = bytearray()
        self._written = self._checksum = 0

    @property
    def folder(self) -> Path:
        """The working folder."""
        return parts_of(self.target)

    @property
    def length(self) -> int:
        """Bytes so far."""
        return self._written + len(self._waiting)

    def append(self, name: str, rows: Array) -> None:
        """Add a piece of rows (n, columns)."""
        piece = np.ascontiguousarray(rows, dtype="<f8")
        self._waiting += _HEAD.pack(name.encode(), *piece.shape) + piece.tobytes()
        if len(self._waiting) > _IN_MEMORY:
            self._flush()

    def save(self, checkpoint: Mapping[str, Any]) -> None:
        """Make the rows so far safe, and then the checkpoint that belongs to them."""
        self._flush()
        assert self._stream is not None
        temporary = self.folder / f"{CHECKPOINT}.part"
        try:
            os.fsync(self._stream.fileno())
            with temporary.open("w") as stream:
                own = {"length": self._written, "checksum": self._checksum}
                json.dump({**checkpoint, **own}, stream)
                stream.flush()
                os.fsync(stream.fileno())
            os.replace(temporary, self.folder / CHECKPOINT)
        except OSError as error:
            raise self._unwritable(error) from None

    def pieces(self) -> Iterator[tuple[str, Array]]:
        """All pieces in order."""
        if self._stream is not None:
            with (self.folder / ROWS).open("rb") as stream:
                while stream.tell() < self._written:
                    name, rows, columns = _HEAD.unpack(stream.read(_HEAD.size))
                    yield _block(name, stream.read(8 * rows * columns), columns)
        start = 0
        waiting = bytes(self._waiting)
        while start < len(waiting):
            name, rows, columns = _HEAD.unpack_from(waiting, start)
            start += _HEAD.size + 8 * rows * columns
            yield _block(name, waiting[start - 8 * rows * columns : start], columns)

    def close(self, remove: bool = False) -> None:
        """Let go of the files; with `remove` the folder goes as well."""
        if self._stream is not None:
            if remove:
                shutil.rmtree(self.folder, ignore_errors=True)
            self._stream.close()
            self._stream = None

    def _flush(self) -> None:
        try:
            if self._stream is None:
                self._create()
            assert self._stream is not None
            self._stream.write(self._waiting)
            self._stream.flush()
        except OSError as error:
            raise self._unwritable(error) from None
        self._written += len(self._waiting)
        self._checksum = zlib.crc32(self._waiting, self._checksum)
        self._waiting.clear()

    def _create(self) -> None:
        """A folder of our own: another run of the same case may have taken the first name."""
        for name in numbered(self.target):
            with contextlib.suppress(FileExistsError):
                parts_of(name).mkdir()
                self.target = name
                break
        self._stream = (self.folder / ROWS).open("xb")
        _lock(self._stream, self.folder)

    def _unwritable(self, error: OSError) -> OutputError:
        return OutputError(
            f"{self.folder}: cannot be written ({error.strerror or error}). What it holds is kept: "
            "make room and run again with --resume"
        )

    @classmethod
    def reopened(cls, target: Path) -> tuple[Journal, dict[str, Any]]:
        """The journal of an unfinished run at its last checkpoint, and that checkpoint.

        Raises CaseError if they cannot be read, or another process is at work on them.
        """
        journal = cls(target)
        try:
            checkpoint = json.loads((journal.folder / CHECKPOINT).read_text())
            length, checksum = checkpoint["length"], checkpoint["checksum"]
            stream = (journal.folder / ROWS).open("r+b")
            _lock(stream, journal.folder)
            if _checksum(stream, length) != checksum:
                stream.close()
                raise ValueError(f"{ROWS} is damaged")
            stream.truncate(length)
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise CaseError(
                f"{journal.folder}: no checkpoint to go on from ({error}); begin anew with "
                "--overwrite"
            ) from None
        journal._stream, journal._written, journal._checksum = stream, length, checksum
        return journal, checkpoint


def _checksum(stream: BinaryIO, length: int) -> int | None:
    """Checksum of the first bytes of a file, which stands after them then; None if too short."""
    value = 0
    while length > 0:
        piece = stream.read(min(length, 2**24))
        if not piece:
            return None
        value = zlib.crc32(piece, value)
        length -= len(piece)
    return value


def _block(name: bytes, data: bytes, columns: int) -> tuple[str, Array]:
    rows = np.frombuffer(data, dtype="<f8").reshape(-1, columns)
    return name.rstrip(b"\0").decode(), rows


def _lock(stream: BinaryIO, folder: Path) -> None:
    """Held until the file is closed or the process ends, however it ends."""
    try:
        fcntl.flock(stream.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        stream.close()
        raise CaseError(f"{folder}: another process is at work on this run") from None
    except OSError:
        return  # a file system without locks


def unfinished(targets: Iterable[Path]) -> Path | None:
    """The first of the results whose run left a checkpoint, if any did."""
    return next((path for path in targets if (parts_of(path) / CHECKPOINT).exists()), None)


def run_of(path: Path) -> str | None:
    """Identifier of the run that a result file came from, None without a file of ours."""
    return _provenance(path, "run")


def identity_of(path: Path) -> dict[str, Any] | None:
    """What identifies the complete run that a result holds, None without such a result."""
    text = _provenance(path, "identity", complete=True)
    found: dict[str, Any] | None = None if text is None else json.loads(text)
    return found


def _provenance(path: Path, name: str, complete: bool = False) -> str | None:
    """An attribute of a result's provenance."""
    if not path.exists():
        return None
    import h5py

    try:
        with h5py.File(path, "r") as file:
            if complete and not file["summary"].attrs["complete"]:
                return None
            held = file["provenance"]
            return str(held.attrs[name] if name in held.attrs else held[name].asstr()[()])
    except (OSError, KeyError):
        return None


def discard(target: Path) -> None:
    """Remove what an unfinished run of this result left, unless it is still at work."""
    folder = parts_of(target)
    if not (folder / ROWS).exists():
        return
    with (folder / ROWS).open("rb") as stream:
        _lock(stream, folder)
        shutil.rmtree(folder, ignore_errors=True)
