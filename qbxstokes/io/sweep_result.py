"""Result of a sweep: one HDF5 file that one process lays out and fills, or that shows its parts.

The file is laid out completely before anything is put into it: contiguous datasets, all metadata in
place, the room on the disk reserved. From then on HDF5 is not involved: rows of trajectories, which
need not be neighbours, are written with `pwrite` at the offsets that HDF5 gave.

Layout (format_version 1, task "sweep"): `table` (n), one row per trajectory with the swept values
and the summary of each; `time` (T), or (n, T) where the instants differ; the quantities of
`quantities.MOTION` (n, T, ...), each with the scales `trajectory` on the first axis and `time` (or
`sample`) on the second; the swept values (n).

A result that is not merged holds the scales alone; the table and the quantities are virtual
datasets, which HDF5 puts together from the parts (`io.store`) when they are read. These are named
relative to the result, so that both may be moved together. HDF5 reads fill values in place of a
part that is missing; the group `parts` says which there must be, and `io.results` looks for them.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from qbxstokes.errors import ResultFileError
from qbxstokes.io.axes import name_axes
from qbxstokes.io.format import (
    CONVENTIONS,
    FORMAT,
    FORMAT_VERSION,
    PARTS,
    is_dimension,
    write_tree,
)
from qbxstokes.io.places import describe, placed_dataset, reserve, write_at
from qbxstokes.io.store import check_disk
from qbxstokes.quantities import RECORDABLE, SAMPLE, TIME, TRAJECTORY, Quantity, of_bodies

if TYPE_CHECKING:
    import h5py

Array = NDArray[Any]

REASON_LENGTH = 160
MISSING, DONE, FAILED = 0, 1, 2
# Numbers of the whole sweep, written in place when it ends.
TOTALS = (
    "trajectories",
    "done",
    "failed",
    "ended",
    "steps",
    "rhs_evaluations",
    "wall_time",
    "ranks",
)


@dataclass(frozen=True)
class Layout:
    """What a sweep file holds.

    dtype: of the table. quantities: those stored at every instant, () for the table alone.
    times: the instants (T,) of all trajectories, or None where they differ. coordinates: names of
    the table's columns that are swept values. descriptions: of the table's columns. bodies: how
    many share the fluid, 0 where the quantities are those of one body.
    """

    size: int
    samples: int
    dtype: np.dtype[Any]
    quantities: tuple[str, ...]
    times: Array | None
    coordinates: tuple[str, ...]
    descriptions: Mapping[str, Quantity]
    bodies: int = 0

    def about(self, name: str) -> Quantity:
        """What a stored quantity is, of several bodies with their axis."""
        about = RECORDABLE[name]
        return of_bodies(about, self.bodies) if self.bodies else about

    @property
    def row_bytes(self) -> int:
        """Bytes per trajectory."""
        numbers = sum(self.about(name).size for name in self.quantities)
        own_times = self.samples if self.quantities and self.times is None else 0
        scales = 8 * (1 + len(self.coordinates))
        return 8 * numbers * self.samples + 8 * own_times + self.dtype.itemsize + scales

    @property
    def bytes(self) -> int:
        """Size of the file."""
        return self.size * self.row_bytes


@dataclass(frozen=True)
class Shown:
    """Rows of a part that a result shows: its `rows` (m,) are the `places` (m,) of `size`."""

    path: Path
    size: int
    rows: Array
    places: Array


def create(
    path: Path,
    layout: Layout,
    provenance: Mapping[str, Any],
    coordinates: Iterator[tuple[int, dict[str, Array]]],
    shown: Sequence[Shown] | None = None,
) -> WholeFile:
    """Lay out a file, to be filled; raises OSError on a full disk.

    coordinates: (first trajectory, column -> values) in pieces. shown: parts that the result shows
    instead of rows of its own.
    """
    import h5py

    with h5py.File(path, "w", libver=("v110", "v110")) as file:
        file.attrs.update(
            format=FORMAT, format_version=FORMAT_VERSION, task="sweep", conventions=CONVENTIONS
        )
        write_tree(file.create_group("provenance"), provenance)
        totals = file.create_group("summary")
        totals.attrs["complete"] = True  # a file that carries its name is whole
        for name in TOTALS:
            placed_dataset(totals, name, (), np.dtype(np.float64))
        if shown is None:
            _lay_out(file, layout, partial(placed_dataset, file))
        else:
            _lay_out(file, layout, partial(_virtual_dataset, file, shown))
            group = file.create_group(PARTS)
            names = [_relative(part.path) for part in shown]
            group.create_dataset("name", data=names, track_times=False)
            sizes = [part.path.stat().st_size for part in shown]
            group.create_dataset("bytes", data=sizes, track_times=False)
        name_axes(file)
        file.flush()
        offsets = _offsets(file)
    reserve(path)
    whole = WholeFile(path, offsets, layout)
    for first, columns in coordinates:
        for name, values in columns.items():
            whole.write_column(name, first, values)
    return whole


def check_room(target: Path, layout: Layout, merge: bool) -> None:
    """Refuse a sweep that the disk cannot hold, parts and merged result; raises OutputError."""
    check_disk(
        target,
        (1 + merge) * layout.bytes,
        "the sweep",
        "half of them while it runs; make room, output.merge: false, or store: summary"
        if merge
        else "make room, or store: summary",
    )


def _relative(part: Path) -> str:
    """The name of a part as the result beside its folder has it."""
    return f"{part.parent.name}/{part.name}"


def _virtual_dataset(
    file: h5py.File,
    shown: Sequence[Shown],
    name: str,
    shape: tuple[int, ...],
    dtype: np.dtype[Any],
    about: Quantity | None = None,
) -> h5py.Dataset:
    """A dataset whose rows stand in parts."""
    import h5py

    whole = h5py.VirtualLayout(shape, dtype)
    for part in shown:
        held = h5py.VirtualSource(_relative(part.path), name, (part.size, *shape[1:]), dtype)
        for rows, places in zip(*map(_slices, _even(part.rows, part.places)), strict=True):
            whole[rows] = held[places]
    data = file.create_virtual_dataset(name, whole, np.nan if dtype.kind == "f" else None)
    if about is not None:
        describe(data, about)
    return data


def _even(rows: Array, places: Array) -> tuple[list[Array], list[Array]]:
    """Both cut into stretches in which each of them rises evenly."""
    steps = np.stack([np.diff(rows), np.diff(places)])
    changes = np.flatnonzero(np.any(np.diff(steps), axis=0))
    edges, rising = [0], np.all(steps > 0, axis=0)
    while edges[-1] < len(rows):
        first = edges[-1]
        if first + 1 == len(rows) or not rising[first]:
            edges.append(first + 1)
            continue
        after = np.searchsorted(changes, first)
        edges.append(int(changes[after]) + 2 if after < len(changes) else len(rows))
    cut = [slice(*edge) for edge in pairwise(edges)]
    return [rows[part] for part in cut], [places[part] for part in cut]


def _slices(stretches: list[Array]) -> Iterator[slice]:
    for numbers in stretches:
        step = int(numbers[1] - numbers[0]) if len(numbers) > 1 else 1
        yield slice(int(numbers[0]), int(numbers[-1]) + 1, step)


def _lay_out(file: h5py.File, layout: Layout, rows_of: Callable[..., h5py.Dataset]) -> None:
    """All datasets; the numbers come later. rows_of: makes those with rows."""
    numbers = np.dtype(np.float64)
    table = rows_of("table", (layout.size,), layout.dtype)
    table.attrs["description"] = "one row per trajectory"
    for name in layout.dtype.names or ():
        about = layout.descriptions[name]
        table.attrs[f"{name}: description"] = about.description
        if about.units:
            table.attrs[f"{name}: units"] = about.units
    table.attrs["coordinates"] = " ".join(layout.coordinates)  # as netCDF has them
    placed_dataset(file, "trajectory", (layout.size,), np.dtype(np.int64), TRAJECTORY)
    for name in layout.coordinates:
        kind = layout.dtype[name]
        placed_dataset(file, name, (layout.size,), kind, layout.descriptions[name])
    if not layout.quantities:
        return
    if layout.times is None:
        rows_of("time", (layout.size, layout.samples), numbers, TIME)
        placed_dataset(file, "sample", (layout.samples,), np.dtype(np.int64), SAMPLE)
    else:
        placed_dataset(file, "time", (layout.samples,), numbers, TIME)
    for name in layout.quantities:
        about = layout.about(name)
        rows_of(name, (layout.size, layout.samples, *about.shape), numbers, about)


class WholeFile:
    """The laid out file, opened for rows at their offsets."""

    def __init__(
        self, data: Path, offsets: Mapping[str, int], layout: Layout, writable: bool = True
    ) -> None:
        """Open it; raises OSError."""
        self._descriptor = os.open(data, os.O_RDWR if writable else os.O_RDONLY)
        self._offsets, self._layout = offsets, layout
        self._row = {
            name: 8 * layout.samples * layout.about(name).size for name in layout.quantities
        }
        self._row["table"] = layout.dtype.itemsize
        if layout.quantities and layout.times is None:
            self._row["time"] = 8 * layout.samples

    def write_column(self, name: str, first: int, values: Array) -> None:
        """Entries of a one-dimensional dataset from `first` on."""
        offset = self._offsets[name] + first * values.dtype.itemsize
        write_at(self._descriptor, values.tobytes(), offset)

    def write_total(self, name: str, value: float) -> None:
        """A number of the whole sweep."""
        write_at(self._descriptor, np.float64(value).tobytes(), self._offsets[f"summary/{name}"])

    def write_rows(self, rows: Array, arrays: Mapping[str, Array]) -> None:
        """Rows of the table and the quantities: rows (m,), arrays: dataset -> (m, ...)."""
        for name in ("table", "time", *self._layout.quantities):
            if name not in arrays:
                continue
            size, data = self._row[name], np.ascontiguousarray(arrays[name])
            view = data.tobytes() if name == "table" else data.data.cast("B")
            for start, stop in runs(rows):
                offset = self._offsets[name] + int(rows[start]) * size
                write_at(self._descriptor, view[start * size : stop * size], offset)

    def read_rows(self, rows: Array) -> dict[str, Array]:
        """What stands in the rows (m,), as `write_rows` takes it."""
        found = {"table": self.read_table(rows)}
        for name in self._row.keys() - {"table"}:
            shape = self._layout.about(name).shape if name in RECORDABLE else ()
            data = np.frombuffer(self._bytes(name, rows))
            found[name] = data.reshape(len(rows), self._layout.samples, *shape)
        return found

    def read_table(self, rows: Array) -> Array:
        """Rows of the table."""
        return np.frombuffer(self._bytes("table", rows), dtype=self._layout.dtype)

    def _bytes(self, name: str, rows: Array) -> bytes:
        size, begin = self._row[name], self._offsets[name]
        return b"".join(
            os.pread(self._descriptor, (stop - start) * size, begin + int(rows[start]) * size)
            for start, stop in runs(rows)
        )

    def flush(self) -> None:
        """Bring everything to the disk."""
        os.fsync(self._descriptor)

    def __enter__(self) -> WholeFile:
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._descriptor)


def runs(rows: Array) -> list[tuple[int, int]]:
    """Positions [start, stop) of stretches of consecutive numbers in increasing `rows`."""
    breaks = np.flatnonzero(np.diff(rows) != 1) + 1
    edges = [0, *breaks.tolist(), len(rows)]
    return list(pairwise(edges))


def open_result(path: Path, layout: Layout) -> WholeFile:
    """A finished file, to be read; raises ResultFileError."""
    import h5py

    try:
        with h5py.File(path, "r") as file:
            return WholeFile(path, _offsets(file), layout, writable=False)
    except (OSError, KeyError) as error:
        raise ResultFileError(f"{path}: cannot be read ({error})") from None


def _offsets(file: h5py.File) -> dict[str, int]:
    """Place in the file of every dataset that rows and totals are written to."""
    import h5py

    totals = {f"summary/{name}": item for name, item in file["summary"].items()}
    return {
        name: int(item.id.get_offset())
        for name, item in {**file, **totals}.items()
        if isinstance(item, h5py.Dataset) and not item.is_virtual and not is_dimension(item)
    }
