"""Results of a sweep: one HDF5 file that all ranks fill at once, and journals of what is in it.

The file is laid out completely before anything is computed: contiguous datasets, all metadata in
place, the room on the disk reserved. From then on HDF5 is not involved: a rank writes the rows of
its trajectories with `pwrite` at the offsets that HDF5 gave, and then one line to a journal of its
own that says which block this was and the checksum of its bytes. No instant at which a process or a
machine ends can therefore damage the file's structure; a block without a line in a journal, with a
torn line, or whose bytes do not have the checksum, is computed again by `--resume`. When all blocks
are there the file is moved from its working folder `NAME.h5.parts/` to its name.

Layout (format_version 1, task "sweep"): `table` (n), one row per trajectory with the swept values
and the summary of each; `time` (T), or (n, T) where the instants differ; the quantities of
`quantities.MOTION` (n, T, ...), each with the dimension scales `trajectory` and the swept values on
the first axis and `time` (or `sample`) on the second.
"""

from __future__ import annotations

import json
import os
import shutil
import zlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from qbxstokes.errors import QbxStokesError, ResultFileError
from qbxstokes.io.format import CONVENTIONS, FORMAT, FORMAT_VERSION, write_tree
from qbxstokes.io.names import parts_of as parts_of
from qbxstokes.io.places import place, placed_dataset, reserve, write_at
from qbxstokes.quantities import MOTION, SAMPLE, TIME, TRAJECTORY, Quantity

if TYPE_CHECKING:
    import h5py

Array = NDArray[Any]

DATA, LAYOUT = "data.h5", "layout.json"
REASON_LENGTH = 160
MISSING, DONE, FAILED = 0, 1, 2
# Numbers of the whole sweep, written in place when it ends.
TOTALS = ("trajectories", "done", "failed", "steps", "rhs_evaluations", "wall_time", "ranks")


@dataclass(frozen=True)
class Layout:
    """What a sweep file holds.

    dtype: of the table. quantities: those stored at every instant, () for the table alone.
    times: the instants (T,) of all trajectories, or None where they differ. coordinates: names of
    the table's columns that are swept values. descriptions: of the table's columns.
    """

    size: int
    samples: int
    dtype: np.dtype[Any]
    quantities: tuple[str, ...]
    times: Array | None
    coordinates: tuple[str, ...]
    descriptions: Mapping[str, Quantity]

    @property
    def row_bytes(self) -> int:
        """Bytes per trajectory."""
        numbers = sum(MOTION[name].size for name in self.quantities)
        own_times = self.samples if self.quantities and self.times is None else 0
        scales = 8 * (1 + len(self.coordinates))
        return 8 * numbers * self.samples + 8 * own_times + self.dtype.itemsize + scales

    @property
    def bytes(self) -> int:
        """Size of the file."""
        return self.size * self.row_bytes


@dataclass
class Committed:
    """What the journals say.

    blocks: finished blocks with their checksums; failed: trajectories that failed and why, by
    block; totals: sums over all that was computed; run: number of the latest run.
    """

    blocks: dict[int, int] = field(default_factory=dict)
    failed: dict[int, dict[int, str]] = field(default_factory=dict)
    totals: dict[str, float] = field(default_factory=dict)
    run: int = 0


def create(
    path: Path,
    layout: Layout,
    digest: str,
    provenance: Mapping[str, Any],
    coordinates: Iterator[tuple[int, dict[str, Array]]],
) -> Path:
    """Lay out the file in its working folder, which is returned; raises on a full disk.

    coordinates: (first trajectory, column -> values) in pieces. The folder is complete once it
    holds `layout.json`, which is written last.
    """
    import h5py

    folder = parts_of(path)
    try:
        folder.mkdir(exist_ok=True)
        data = folder / DATA
        _check_room(folder, layout)
        with h5py.File(data, "w", libver=("v108", "v110")) as file:
            file.attrs.update(
                format=FORMAT, format_version=FORMAT_VERSION, task="sweep", conventions=CONVENTIONS
            )
            write_tree(file.create_group("provenance"), provenance)
            totals = file.create_group("summary")
            for name in TOTALS:
                placed_dataset(totals, name, (), np.dtype(np.float64))
            _lay_out(file, layout)
            file.flush()
            offsets = _offsets(file)
        reserve(data)
        with WholeFile(data, offsets, layout) as whole:
            for first, columns in coordinates:
                for name, values in columns.items():
                    whole.write_column(name, first, values)
        _write_atomically(folder / LAYOUT, json.dumps({"digest": digest, "offsets": offsets}))
    except OSError as error:
        raise full_disk(path, error, layout.bytes) from None
    return folder


def full_disk(path: Path, error: OSError, needed: int = 0) -> QbxStokesError:
    """The error to raise when writing failed: what is on the disk stays valid."""
    reason = error.strerror or str(error)
    size = f"; the whole sweep needs {needed / 1e6:.3g} MB" if needed else ""
    return QbxStokesError(
        f"{path}: cannot be written ({reason}){size}. What was finished is kept: make room and "
        "run again with --resume"
    )


def _check_room(folder: Path, layout: Layout) -> None:
    free = shutil.disk_usage(folder).free
    if free < layout.bytes:
        raise OSError(28, f"no space left: {free / 1e6:.3g} MB are free")


def _lay_out(file: h5py.File, layout: Layout) -> None:
    """All datasets with their scales; the numbers come later."""
    numbers = np.dtype(np.float64)
    table = placed_dataset(file, "table", (layout.size,), layout.dtype)
    table.attrs["description"] = "one row per trajectory"
    for name in layout.dtype.names or ():
        about = layout.descriptions[name]
        table.attrs[f"{name}: description"] = about.description
        if about.units:
            table.attrs[f"{name}: units"] = about.units
    table.attrs["coordinates"] = list(layout.coordinates)
    index = placed_dataset(file, "trajectory", (layout.size,), np.dtype(np.int64), TRAJECTORY)
    index.make_scale("trajectory")
    scales = []
    for name in layout.coordinates:
        kind = layout.dtype[name]
        scale = placed_dataset(file, name, (layout.size,), kind, layout.descriptions[name])
        scale.make_scale(name)
        scales.append(scale)
    table.dims[0].label = "trajectory"
    for scale in (index, *scales):
        table.dims[0].attach_scale(scale)
    if not layout.quantities:
        return
    own = layout.times is None
    shape = (layout.size, layout.samples) if own else (layout.samples,)
    time = placed_dataset(file, "time", shape, numbers, TIME)
    second = time
    if own:
        second = placed_dataset(file, "sample", (layout.samples,), np.dtype(np.int64), SAMPLE)
        time.dims[0].attach_scale(index)
        second.make_scale("sample")
        time.dims[1].attach_scale(second)
    else:
        time.make_scale("time")
    for name in layout.quantities:
        about = MOTION[name]
        data = placed_dataset(
            file, name, (layout.size, layout.samples, *about.shape), numbers, about
        )
        for scale in (index, *scales):
            data.dims[0].attach_scale(scale)
        data.dims[1].attach_scale(second)
        data.dims[0].label, data.dims[1].label = "trajectory", "sample" if own else "time"


def _write_atomically(path: Path, text: str) -> None:
    temporary = path.with_suffix(".new")
    with open(temporary, "w") as stream:
        stream.write(text)
        stream.flush()
        os.fsync(stream.fileno())
    os.replace(temporary, path)


class WholeFile:
    """The laid out file, opened for rows at their offsets."""

    def __init__(
        self, data: Path, offsets: Mapping[str, int], layout: Layout, writable: bool = True
    ) -> None:
        """Open it; raises OSError."""
        self._descriptor = os.open(data, os.O_RDWR if writable else os.O_RDONLY)
        self._offsets, self._layout = offsets, layout
        self._row = {name: 8 * layout.samples * MOTION[name].size for name in layout.quantities}
        self._row["table"] = layout.dtype.itemsize
        if layout.quantities and layout.times is None:
            self._row["time"] = 8 * layout.samples

    def write_column(self, name: str, first: int, values: Array) -> None:
        """Entries of a one-dimensional dataset from `first` on."""
        data = np.ascontiguousarray(values)
        write_at(
            self._descriptor, data.tobytes(), self._offsets[name] + first * data.dtype.itemsize
        )

    def write_total(self, name: str, value: float) -> None:
        """A number of the whole sweep."""
        write_at(self._descriptor, np.float64(value).tobytes(), self._offsets[f"summary/{name}"])

    def write_rows(self, rows: Array, arrays: Mapping[str, Array]) -> int:
        """Rows of the table and the quantities; returns their checksum.

        rows (m,) increasing; arrays: dataset -> (m, ...).
        """
        checksum = 0
        for name in self._names(arrays):
            size, data = self._row[name], np.ascontiguousarray(arrays[name])
            view = data.tobytes() if name == "table" else data.data.cast("B")
            checksum = zlib.crc32(view, checksum)
            for start, stop in runs(rows):
                offset = self._offsets[name] + int(rows[start]) * size
                write_at(self._descriptor, view[start * size : stop * size], offset)
        return checksum

    def checksum(self, rows: Array) -> int:
        """Checksum of what stands in the file at these rows."""
        value = 0
        for name in self._names(self._row):
            size = self._row[name]
            for start, stop in runs(rows):
                offset = self._offsets[name] + int(rows[start]) * size
                end = offset + (stop - start) * size
                while offset < end:
                    piece = os.pread(self._descriptor, min(end - offset, 2**24), offset)
                    if not piece:
                        return -1
                    value = zlib.crc32(piece, value)
                    offset += len(piece)
        return value

    def read_table(self, rows: Array) -> Array:
        """Rows of the table."""
        size, parts = self._row["table"], []
        for start, stop in runs(rows):
            offset = self._offsets["table"] + int(rows[start]) * size
            parts.append(os.pread(self._descriptor, (stop - start) * size, offset))
        return np.frombuffer(b"".join(parts), dtype=self._layout.dtype)

    def flush(self) -> None:
        """Bring everything to the disk."""
        os.fsync(self._descriptor)

    def _names(self, present: Mapping[str, Any]) -> list[str]:
        return [name for name in ("table", "time", *self._layout.quantities) if name in present]

    def __enter__(self) -> WholeFile:
        """The file itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close it."""
        os.close(self._descriptor)


def runs(rows: Array) -> list[tuple[int, int]]:
    """Positions [start, stop) of stretches of consecutive numbers in increasing `rows`."""
    breaks = np.flatnonzero(np.diff(rows) != 1) + 1
    edges = [0, *breaks.tolist(), len(rows)]
    return list(pairwise(edges))


def open_layout(folder: Path, layout: Layout) -> WholeFile:
    """The file of a working folder."""
    return WholeFile(folder / DATA, _head(folder)["offsets"], layout)


def _head(folder: Path) -> dict[str, Any]:
    """Digest and offsets of a working folder; raises ResultFileError if they cannot be read."""
    try:
        head = json.loads((folder / LAYOUT).read_text())
        return {name: head[name] for name in ("digest", "offsets")}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ResultFileError(
            f"{folder / LAYOUT}: is damaged ({error}); begin anew with --overwrite"
        ) from None


class Journal:
    """One rank's record of finished blocks, appended to line by line."""

    def __init__(self, folder: Path, rank: int) -> None:
        name = f"journal-{rank:06d}-{os.getpid()}.txt"
        flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND
        self._descriptor = os.open(folder / name, flags, 0o644)
        os.write(self._descriptor, b"\n")  # ends a torn line of a process with the same number

    def record(self, entry: Mapping[str, Any]) -> None:
        """Append one line, with a checksum of its own, in one call."""
        text = json.dumps(entry, separators=(",", ":"))
        line = f"{text}\t{zlib.crc32(text.encode()):08x}\n".encode()
        written = os.write(self._descriptor, line)
        if written != len(line):
            raise OSError(28, "No space left on device")

    def close(self) -> None:
        """Close the file."""
        os.close(self._descriptor)


def read_journals(folder: Path) -> Committed:
    """Everything the journals of a working folder say; torn lines are passed over."""
    entries = []
    for path in sorted(folder.glob("journal-*.txt")):
        for line in path.read_bytes().split(b"\n"):
            text, tab, check = line.partition(b"\t")
            if tab and f"{zlib.crc32(text):08x}".encode() == check:
                entries.append(json.loads(text))
    found = Committed()
    # A block that a later run has computed again stands as that run left it.
    for entry in sorted(entries, key=lambda entry: entry["run"]):
        block = entry["block"]
        found.run = entry["run"]
        found.blocks[block] = entry["checksum"]
        found.failed[block] = {int(i): reason for i, reason in entry["failed"].items()}
        for name, value in entry["totals"].items():
            found.totals[name] = found.totals.get(name, 0.0) + value
    return found


def finish(folder: Path, path: Path, whole: WholeFile, totals: Mapping[str, float]) -> Path:
    """Write the totals, give the file its name and remove the working folder."""
    for name, value in totals.items():
        whole.write_total(name, value)
    whole.flush()
    os.replace(folder / DATA, path)
    shutil.rmtree(folder, ignore_errors=True)
    return path


def unfinished(names: Iterable[Path]) -> Path | None:
    """The first of `names` that has a working folder with a complete layout."""
    return next((name for name in names if (parts_of(name) / LAYOUT).exists()), None)


def digest_in(folder: Path) -> str:
    """Digest of the sweep that a working folder belongs to."""
    return str(_head(folder)["digest"])


def check_data(folder: Path) -> None:
    """Refuse a working folder whose file is not the one that was laid out; ResultFileError."""
    offsets, _ = offsets_of(folder / DATA)
    if offsets != _head(folder)["offsets"]:
        raise ResultFileError(
            f"{folder / DATA}: is not the file that was laid out; begin anew with --overwrite"
        )


def offsets_of(path: Path) -> tuple[dict[str, int], str]:
    """Where the datasets of a finished file stand, and the digest of its sweep."""
    import h5py

    try:
        with h5py.File(path, "r") as file:
            if file.attrs.get("format") != FORMAT or file.attrs.get("task") != "sweep":
                raise ResultFileError(f"{path}: is not the result of a sweep; nothing to resume")
            return _offsets(file), str(file["provenance"].attrs["digest"])
    except (OSError, KeyError) as error:
        raise ResultFileError(
            f"{path}: is damaged ({error}); begin anew with --overwrite"
        ) from None


def _offsets(file: h5py.File) -> dict[str, int]:
    """Place in the file of every dataset that rows and totals are written to."""
    import h5py

    totals = {f"summary/{name}": item for name, item in file["summary"].items()}
    return {
        name: place(item)
        for name, item in {**file, **totals}.items()
        if isinstance(item, h5py.Dataset)
    }


def reopen(
    path: Path, digest: str, offsets: Mapping[str, int], entries: Iterable[Mapping[str, Any]]
) -> Path:
    """A working folder from a finished file, which stays until a better one takes its place."""
    folder = parts_of(path)
    try:
        folder.mkdir(exist_ok=True)
        shutil.copyfile(path, folder / DATA)
        journal = Journal(folder, 0)
        for entry in entries:
            journal.record(entry)
        journal.close()
        head = {"digest": digest, "offsets": offsets}
        _write_atomically(folder / LAYOUT, json.dumps(head))
    except OSError as error:
        raise full_disk(path, error) from None
    return folder
