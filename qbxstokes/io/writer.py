"""Result files in the making: written atomically, sample after sample.

A file is written under a temporary name and moved to its target when it is complete: a file that
carries the final name is a whole one. In the working folder (`io.store`) nothing is left of a file
whose process was killed.

Files are opened as they are by `xarray.open_dataset` and other readers of netCDF-4: every axis of a
dataset has a scale. It is the dataset of that name, such as `time`, or one without numbers that
marks a dimension alone, as netCDF-4 writes it.
"""

from __future__ import annotations

import io
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.errors import CaseError, OutputError
from qbxstokes.io.format import CONVENTIONS, DIMENSION, FORMAT, FORMAT_VERSION, describe, write_tree
from qbxstokes.io.names import check_writable, numbered, temporary_name
from qbxstokes.quantities import FLUID, INSTANT, POINT, RECORDABLE, SURFACE, TIME
from qbxstokes.quantity import Quantity
from qbxstokes.typing import Array

if TYPE_CHECKING:
    import h5py

_VECTORS = ("origin", "first", "second")  # of a plane
_OF_POINTS = {1: ("point",), 2: ("time", "point"), 3: ("time", "line", "sample")}


class PatientFile(io.FileIO):
    """A file that keeps the first failure of the system to itself until it is asked for.

    HDF5 brings the process down when a write fails under it (a full disk); with this file it goes
    on writing into nothing, and the writer looks at `failure` after each piece.
    """

    failure: OSError | None = None

    def write(self, data: Any) -> int:
        """Write all of `data`, or note why that failed."""
        view = memoryview(data).cast("B")
        done = 0
        try:
            while self.failure is None and done < len(view):
                done += os.write(self.fileno(), view[done:])
        except OSError as error:
            self.failure = error
        return len(view)

    def readinto(self, buffer: Any) -> int:
        """Fill all of `buffer`, with zeros where there is nothing to read."""
        view = memoryview(buffer).cast("B")
        count = super().readinto(view) or 0
        view[count:] = bytes(len(view) - count)
        return len(view)

    def truncate(self, size: int | None = None) -> int:
        """Set the length of the file, or note why that failed."""
        try:
            return super().truncate(size)
        except OSError as error:
            self.failure = self.failure or error
            return size or 0


@contextmanager
def whole_file(path: Path, folder: Path | None = None) -> Iterator[PatientFile]:
    """A file to be filled that appears under its name complete or not at all; raises OSError.

    folder: where it stands until then, beside `path` if None.
    """
    temporary = (folder or path.parent) / f".{path.name}.{os.urandom(4).hex()}.part"
    try:
        with PatientFile(temporary, "x+") as stream:
            try:
                yield stream
            except OSError as error:
                raise stream.failure or error from None
            if stream.failure is not None:
                raise stream.failure
            os.fsync(stream.fileno())
        os.replace(temporary, path)
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
    with suppress(OSError):  # a file system that does not sync folders
        opened = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(opened)
        finally:
            os.close(opened)


@contextmanager
def whole_hdf5(path: Path, folder: Path | None = None, **options: Any) -> Iterator[h5py.File]:
    """An HDF5 file to be filled, which then takes the place of what was at `path`.

    Raises OutputError where the disk does not take it; nothing is left of it then.
    """
    import h5py

    try:
        with whole_file(path, folder) as stream, h5py.File(stream, "w", **options) as file:
            yield file
    except OSError as error:
        raise OutputError(f"{path}: cannot be written ({error.strerror or error})") from None


class ResultWriter:
    """A result file in the making; `finish` gives it its name, leaving without it removes it.

    >>> with ResultWriter(Path("result.h5"), "motion") as writer:  # doctest: +SKIP
    ...     writer.append({"time": times, "position": positions})
    ...     writer.finish({"steps": 120})
    """

    def __init__(
        self,
        path: Path,
        task: str,
        provenance: Mapping[str, Any] | None = None,
        overwrite: bool = False,
        folder: Path | None = None,
    ) -> None:
        """Create the temporary file (in a folder, or beside `path`); raises CaseError."""
        import h5py

        check_writable(path, overwrite)
        self.path = path
        self.overwrite = overwrite
        self.axes: dict[str, tuple[str, ...]] = {}
        self.temporary = temporary_name(path, folder)
        try:
            self.stream = PatientFile(self.temporary, "w+")
        except OSError as error:
            raise CaseError(f"{path}: cannot be created ({error.strerror})") from None
        self.file: h5py.File = h5py.File(self.stream, "w", libver=("v110", "v110"))
        self.file.attrs.update(
            format=FORMAT, format_version=FORMAT_VERSION, task=task, conventions=CONVENTIONS
        )
        write_tree(self.file.create_group("provenance"), provenance or {})

    def append(
        self,
        rows: Mapping[str, ArrayLike],
        about: Mapping[str, Quantity] = RECORDABLE,
        group: str = "",
    ) -> None:
        """Append to datasets of a group: `time` (n,) and quantities (n, ...), the same every time.

        Raises OutputError if they cannot be stored.
        """
        with self._writing():
            for name, values in rows.items():
                known = TIME if name == "time" and not group else about[name]
                self._extended(f"{group}{name}", np.asarray(values, dtype=float), known)

    def put(self, arrays: Mapping[str, ArrayLike], about: Mapping[str, Quantity]) -> None:
        """Write whole arrays, each once, as datasets at the root; raises OutputError."""
        with self._writing():
            for name, values in arrays.items():
                data = self.file.create_dataset(name, data=values, track_times=False)
                describe(data, about[name])
                self.axes[name] = about[name].axes(data.ndim)

    @contextmanager
    def _writing(self) -> Iterator[None]:
        """Turn what HDF5 and the system report into one OutputError."""
        try:
            yield
            if self.file:
                self.file.flush()
            failure = self.stream.failure
        except OSError as error:
            failure = self.stream.failure or error
        if failure is not None:
            raise self._lost(failure) from None

    def _lost(self, failure: OSError) -> OutputError:
        return OutputError(f"{self.path}: cannot be written ({failure.strerror or failure})")

    def _extended(self, name: str, values: Array, about: Quantity) -> h5py.Dataset:
        """The dataset `name` with `values` after what it held."""
        if values.shape[1:] != about.shape:
            raise ValueError(f"{name}: samples of shape {values.shape[1:]}, not {about.shape}")
        if name not in self.file:
            chunk = max(1, min(len(values), 65_536 // (8 * max(1, int(np.prod(about.shape))))))
            data = self.file.create_dataset(
                name,
                data=values,
                maxshape=(None, *about.shape),
                chunks=(chunk, *about.shape),
                fletcher32=True,  # damage is noticed when reading
                track_times=False,
            )
            describe(data, about)
            self.axes[name] = replace(about, lead=("time",)).axes(data.ndim)
            return data
        data = self.file[name]
        held = len(data)
        data.resize(held + len(values), axis=0)
        data[held:] = values
        return data

    def claim(self) -> None:
        """Claim the room of all that has been laid out so far; raises OutputError."""
        with self._writing():
            self.file.flush()
            os.posix_fallocate(self.stream.fileno(), 0, os.fstat(self.stream.fileno()).st_size)

    def finish(self, summary: Mapping[str, Any] | None = None) -> Path:
        """Write the summary, close, and give the file its name; returns the name it got.

        An existing file is replaced only when `overwrite` was asked for; otherwise the next free
        numbered name is taken, without a gap in which another process could lose its file.
        Raises OutputError; then nothing is left behind.
        """
        with self._writing():
            write_tree(self.file.require_group("summary"), summary or {})
            _name_axes(self.file, self.axes)
        with self._writing():
            self.file.close()
            os.fsync(self.stream.fileno())
            self.stream.close()
        return self._rename()

    def _rename(self) -> Path:
        """Move the complete file to its name."""
        if self.overwrite:
            os.replace(self.temporary, self.path)
            return self.path
        for name in numbered(self.path):
            try:
                os.link(self.temporary, name)
            except FileExistsError:
                continue
            except OSError:  # a file system without hard links
                if os.path.lexists(name):
                    continue
                os.replace(self.temporary, name)
                return name
            self.temporary.unlink()
            return name
        raise OutputError(f"{self.path}: every numbered name is taken; use --overwrite")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Remove the temporary file unless `finish` moved it."""
        if self.file:
            self.file.close()
        self.stream.close()
        self.temporary.unlink(missing_ok=True)


def _name_axes(file: h5py.File, axes: Mapping[str, Sequence[str]]) -> None:
    """Give every axis of a result's datasets its scale.

    axes: names of the axes of datasets at the root, and of events; those of fields follow from
    their points.
    """
    import h5py

    for name, names in axes.items():
        _scale(file[name].parent, file[name], names)
    about = FLUID | POINT | SURFACE
    for group in file.get("field", {}).values():
        if not isinstance(group, h5py.Group) or "points" not in group:
            continue
        lead = group["points"].shape[:-1]
        before = ("time", "line") if "time" in group else _OF_POINTS[len(lead)]
        for name, data in list(group.items()):
            if name == "time":
                _scale(group, data, ("time",))
            elif data.shape[: len(lead)] == lead:
                known = replace(about.get(name, INSTANT), lead=before)
                _scale(group, data, known.axes(data.ndim))
            else:  # of a grid: its coordinates, or a point or direction
                _scale(group, data, ("component",) if name in _VECTORS else (name,))


def _scale(group: h5py.Group, data: h5py.Dataset, axes: Sequence[str]) -> None:
    """Attach scales to the axes of a dataset of the group that have none yet."""
    if data.is_scale or data.dtype.names:
        return
    if axes == (data.name.rpartition("/")[2],):
        data.make_scale(axes[0])
        return
    for number, axis in enumerate(axes):
        if len(data.dims[number]):
            continue
        size = data.shape[number]
        above = group.parent.get(axis)
        home = group.parent if above is not None and above.shape == (size,) else group
        if axis in home and home[axis].shape != (size,):  # of that name, but another
            axis = f"{data.name.rpartition('/')[2]}_{number}"
        if axis not in home:
            mark = group.create_dataset(axis, (size,), ">f4", track_times=False)
            mark.make_scale(f"{DIMENSION}{size:10d}")
        scale = home[axis]
        if not scale.is_scale:
            scale.make_scale(axis)
        data.dims[number].attach_scale(scale)
