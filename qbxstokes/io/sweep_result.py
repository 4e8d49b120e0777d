"""Result of a sweep: laid out as a whole and then filled with rows, or showing its parts.

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

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from qbxstokes.errors import OutputError, ResultFileError
from qbxstokes.io.format import PARTS, describe, placed_dataset
from qbxstokes.io.store import Work, check_disk, unwritable
from qbxstokes.io.writer import ResultWriter
from qbxstokes.quantities import RECORDABLE, SAMPLE, TIME, TRAJECTORY, of_bodies
from qbxstokes.quantity import Quantity
from qbxstokes.typing import AnyArray

if TYPE_CHECKING:
    import h5py


REASON_LENGTH = 160
DONE, FAILED = 1, 2
_AT_ONCE = 2048  # rows that lie apart and are written together


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
    times: AnyArray | None
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
    rows: AnyArray
    places: AnyArray


class SweepWriter(ResultWriter):
    """The result of a sweep in the making: laid out, its room on the disk claimed, to be filled.

    coordinates: (first trajectory, column -> values) in pieces. shown: parts that the result shows
    instead of rows of its own. Raises OutputError where the disk does not take it.
    """

    def __init__(
        self,
        work: Work,
        layout: Layout,
        provenance: Mapping[str, Any],
        coordinates: Iterator[tuple[int, dict[str, AnyArray]]],
        shown: Sequence[Shown] | None = None,
    ) -> None:
        super().__init__(work.target, "sweep", provenance, True, work.folder)
        made: Any = placed_dataset if shown is None else partial(_virtual_dataset, shown)
        with self._writing():
            self.axes = _lay_out(self.file, layout, made)
        if shown is not None:
            group = self.file.create_group(PARTS)
            names = [_relative(part.path) for part in shown]
            group.create_dataset("name", data=names, track_times=False)
            sizes = [part.path.stat().st_size for part in shown]
            group.create_dataset("bytes", data=sizes, track_times=False)
        self.claim()
        with self._writing():
            for first, columns in coordinates:
                for name, values in columns.items():
                    self.file[name][first : first + len(values)] = values

    def write_rows(self, rows: AnyArray, arrays: Mapping[str, AnyArray]) -> None:
        """Rows (m,) of the table and the quantities, dataset -> (m, ...); raises OutputError."""
        with self._writing():
            for name, values in arrays.items():
                put_rows(self.file[name], rows, values)

    def _lost(self, failure: OSError) -> OutputError:
        return unwritable(self.path, failure)


def put_rows(data: h5py.Dataset, rows: AnyArray, values: AnyArray) -> None:
    """Write values (m, ...) as the rows (m,) of a dataset, in whatever order."""
    steps = np.diff(rows)
    if len(rows) > 1 and steps[0] > 0 and np.all(steps == steps[0]):
        data[rows[0] : rows[-1] + 1 : steps[0]] = values
        return
    order = np.argsort(rows)
    for first in range(0, len(rows), _AT_ONCE):
        piece = order[first : first + _AT_ONCE]
        data[rows[piece]] = values[piece]


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
    shown: Sequence[Shown],
    file: h5py.File,
    name: str,
    shape: tuple[int, ...],
    dtype: Any,
    about: Quantity | None = None,
) -> h5py.Dataset:
    """A dataset whose rows stand in parts."""
    import h5py

    whole = h5py.VirtualLayout(shape, dtype)
    for part in shown:
        held = h5py.VirtualSource(_relative(part.path), name, (part.size, *shape[1:]), dtype)
        for rows, places in zip(*map(_slices, _even(part.rows, part.places)), strict=True):
            whole[rows] = held[places]
    data = file.create_virtual_dataset(name, whole, np.nan if dtype == "f8" else None)
    if about is not None:
        describe(data, about)
    return data


def _even(rows: AnyArray, places: AnyArray) -> tuple[list[AnyArray], list[AnyArray]]:
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


def _slices(stretches: list[AnyArray]) -> Iterator[slice]:
    for numbers in stretches:
        step = int(numbers[1] - numbers[0]) if len(numbers) > 1 else 1
        yield slice(int(numbers[0]), int(numbers[-1]) + 1, step)


def _lay_out(
    file: h5py.File, layout: Layout, rows_of: Callable[..., h5py.Dataset]
) -> dict[str, tuple[str, ...]]:
    """All datasets, whose numbers come later; their axes. rows_of: makes those with rows."""
    rows = ("table", "trajectory", *layout.coordinates)
    axes: dict[str, tuple[str, ...]] = dict.fromkeys(rows, ("trajectory",))
    table = rows_of(file, "table", (layout.size,), layout.dtype)
    table.attrs["description"] = "one row per trajectory"
    for name in layout.dtype.names or ():
        about = layout.descriptions[name]
        table.attrs[f"{name}: description"] = about.description
        if about.units:
            table.attrs[f"{name}: units"] = about.units
    table.attrs["coordinates"] = " ".join(layout.coordinates)  # as netCDF has them
    placed_dataset(file, "trajectory", (layout.size,), "i8", TRAJECTORY)
    for name in layout.coordinates:
        placed_dataset(file, name, (layout.size,), layout.dtype[name], layout.descriptions[name])
    if not layout.quantities:
        return axes
    lead = ("trajectory", "time" if layout.times is not None else "sample")
    axes |= {"time": lead if layout.times is None else lead[1:]}
    if layout.times is None:
        axes["sample"] = lead[1:]
        rows_of(file, "time", (layout.size, layout.samples), "f8", TIME)
        placed_dataset(file, "sample", (layout.samples,), "i8", SAMPLE)
    else:
        placed_dataset(file, "time", (layout.samples,), "f8", TIME)
    for name in layout.quantities:
        about = layout.about(name)
        shape = (layout.size, layout.samples, *about.shape)
        axes[name] = replace(about, lead=lead).axes(len(shape))
        rows_of(file, name, shape, "f8", about)
    return axes


@contextmanager
def reading(path: str | Path) -> Iterator[h5py.File]:
    """A finished result, of which rows are read; raises ResultFileError."""
    import h5py

    try:
        with h5py.File(path, "r") as file:
            yield file
    except (OSError, KeyError) as error:
        raise ResultFileError(f"{path}: cannot be read ({error})") from None
