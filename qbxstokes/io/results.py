"""Result files, one HDF5 file per run, read back as NumPy arrays, tables of pandas
or Datasets of xarray.

Layout of a motion (format_version 1): datasets `time` (T) and the quantities of a motion
(`quantities.MOTION`), each (T, ...) with attributes `units`, `description`, `frame` and `time` as
its dimension scale; groups `provenance` (how it was made) and `summary` (what came out);
attributes `format`, `format_version`, `task`, `conventions` at the root.
"""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from qbxstokes.errors import HeldFileError, ResultFileError
from qbxstokes.folders import unreadable
from qbxstokes.io.format import FORMAT, FORMAT_VERSION, PARTS, is_dimension, open_file, read_tree
from qbxstokes.io.listing import Held, LazyArrays, listing
from qbxstokes.io.names import newest
from qbxstokes.motion.averages import Mean, mean_of
from qbxstokes.typing import AnyArray

if TYPE_CHECKING:
    import h5py
    import pandas
    import xarray

    from qbxstokes.units import Scales

_ATTRIBUTES = ("units", "description", "frame", "components", "coordinates")


class Result:
    """A result read into memory: each dataset is an attribute holding a NumPy array.

    `provenance` and `summary` are nested dictionaries; `attributes` maps each dataset's name to
    its units, description and frame; `names` lists the datasets.
    """

    def __init__(
        self,
        path: Path,
        header: dict[str, Any],
        arrays: Mapping[str, AnyArray],
        attributes: dict[str, dict[str, Any]],
        groups: dict[str, dict[str, Any]],
    ) -> None:
        self.path = path
        self.task: str = header["task"]
        self.format_version = int(header["format_version"])
        self.conventions: str = header.get("conventions", "")
        self.provenance: dict[str, Any] = groups.pop("provenance", {})
        self.summary: dict[str, Any] = groups.pop("summary", {})
        self.groups = groups
        self.arrays = arrays
        self.attributes = attributes
        # Of a result in physical units: the one that it is made of, and its scales.
        self.original: Result | None = None
        self.converted_by: Scales | None = None

    @property
    def scales(self) -> dict[str, Any]:
        """Physical scales of a case that gives `units`, as texts, with St, Re and G; else empty."""
        return dict(self.provenance.get("scales", {}))

    def in_units(self) -> Result:
        """The same with its arrays in physical units, by the section `units` of its case.

        Summary and pictures stay as they are. Raises ResultFileError where the case gives none.
        """
        from qbxstokes.io.listing import physical

        return physical(self)

    @property
    def names(self) -> list[str]:
        """Names of the datasets."""
        return list(self.arrays)

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Shapes of the datasets by name."""
        return {name: np.shape(data) for name, data in self.arrays.items()}

    @property
    def events(self) -> Held:
        """What happened between the samples: `events.half_turns.time` and the like."""
        return Held(self.groups.get("events", {}), scales=self.converted_by)

    @property
    def fields(self) -> Held:
        """The datasets by name; of a field also its sets: `fields.plane.velocity`."""
        held: Any = ChainMap(self.arrays, self.sets)  # type: ignore[arg-type]
        return Held(held, self.shapes, self.attributes, self.converted_by)

    @property
    def sets(self) -> dict[str, Mapping[str, Any]]:
        """The sets of points, surface and lines of a field, arrays by name."""
        held = self.groups.get("field", {}).items()
        return {name: value for name, value in held if isinstance(value, Mapping)}

    def __getattr__(self, name: str) -> AnyArray:
        arrays = self.__dict__.get("arrays", {})
        if name in arrays:
            return arrays[name]
        raise AttributeError(f"no dataset {name}; there are {', '.join(arrays)}")

    def __getitem__(self, name: str) -> AnyArray:
        return self.arrays[name]

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self.arrays]

    def _ipython_key_completions_(self) -> list[str]:
        return self.names

    def __repr__(self) -> str:
        return listing(self)

    def plot(self, kind: str = "", ax: Any = None, **roles: Any) -> Any:
        """A picture as `plot` draws it, as a figure of matplotlib, or into axes of one's own.

        kind: as `plot --kind`, or a quantity such as "axis"; the first of `kinds` unless given. ax:
        Axes, or as many as the picture has panels. roles: of a sweep x, y, by, value and scale.
        """
        from qbxstokes.plots.pictures import plot

        return plot(self.original or self, kind, ax, roles)

    @property
    def kinds(self) -> list[str]:
        """The pictures that the result calls for."""
        from qbxstokes.plots.pictures import kinds

        return list(kinds(self))

    def to_pandas(self) -> pandas.DataFrame:
        """A table with a row per instant (per trajectory of a sweep), columns such as position_1.

        Raises MissingPackageError without pandas.
        """
        from qbxstokes.io.export import to_pandas

        return to_pandas(self)

    def to_xarray(self) -> xarray.Dataset:
        """A Dataset with named axes, units and descriptions as attributes.

        Raises MissingPackageError without xarray.
        """
        from qbxstokes.io.export import to_xarray

        return to_xarray(self)

    def export(self, path: str | Path) -> list[Path]:
        """Write the table as .csv, all arrays as .npz, or with their axes as .nc (netCDF-4).

        The ending of the name says which. Returns the files written, of a field as .csv one for
        each set of points. Raises CaseError for another ending.
        """
        from qbxstokes.io.export import write

        return write(self, Path(path))


class SweepResult(Result):
    """A sweep: `table` holds one row per trajectory, the quantities are (trajectory, time, ...).

    `shape` has one entry per axis of the sweep, so that `result.table["period"].reshape(shape)` is
    the period over the grid of swept values; `coordinates` names the swept columns.
    """

    @property
    def coordinates(self) -> list[str]:
        """Names of the swept columns."""
        return list(self.attributes["table"]["coordinates"])

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of points of every axis of the sweep."""
        return tuple(int(n) for n in np.atleast_1d(self.provenance["shape"]))

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Shapes of the datasets by name; nothing is read for them."""
        assert isinstance(self.arrays, LazyArrays)
        return self.arrays.shapes

    def mean(self, name: str, discard: float = 0.0) -> Mean:
        """Mean of a quantity over whole turns, and over the trajectories, with its errors.

        name: such as "particle_stress", in the components that are stored; discard: the first part
        of the time, which is left out. Raises AttributeError where its samples were not stored.
        """
        values, times = getattr(self, name), self.arrays["time"]
        if not len(self.table) or values.shape[:1] != self.table.shape or values.ndim < 2:
            raise AttributeError(f"{name} has no samples; output.fields stores them")
        rows = np.moveaxis(values, 0, 1)
        if np.ndim(times) == 1:
            return mean_of(times, rows, self.table["period"], discard)
        # Instants of their own, at the same parts of a time: by that.
        return mean_of(times[0] / times[0, -1], rows, self.table["period"] / times[:, -1], discard)

    def trajectory(self, number: int) -> Result:
        """One trajectory as the result of a motion; raises IndexError where there is none.

        Only its own samples are read. `provenance["swept"]` holds its swept values.
        """
        from qbxstokes.io.export import texts

        with open_file(self.path) as file:
            if not 0 <= number < len(file["table"]):
                raise IndexError(f"no trajectory {number} among {len(file['table'])}")
            row = file["table"][number : number + 1]
            arrays = {
                name: file[name][()] if file[name].ndim == 1 else file[name][number]
                for name in self._samples()
                if file[name].ndim > 1 or name == "time"
            }
        summary = {name: texts(row[name])[0].item() for name in row.dtype.names}
        swept = {name: summary.pop(name) for name in self.coordinates}
        header = {"task": "motion", "format_version": self.format_version}
        groups = {"provenance": {**self.provenance, "swept": swept}, "summary": summary}
        attributes = {name: dict((self.original or self).attributes[name]) for name in arrays}
        for about in attributes.values():
            about["axes"] = tuple(axis for axis in about["axes"] if axis != "trajectory")
        found = Result(self.path, header, arrays, attributes, groups)
        return found.in_units() if self.original else found

    def _samples(self) -> dict[str, tuple[int, ...]]:
        known = {"table", "trajectory", "sample", *self.coordinates}
        return {name: shape for name, shape in self.shapes.items() if name not in known}


def load(path: str | Path, units: bool = False) -> Result:
    """Read a result file; raises ResultFileError if it is missing, damaged or not ours.

    Of a case file its newest result in the working folder, which `path` of the result names.
    units: with the arrays in physical units, of a case with a section `units` (`Result.in_units`).

    >>> result = load("jeffery_prolate.h5")  # doctest: +SKIP
    >>> result.time.shape, result.axis.shape  # doctest: +SKIP
    ((301,), (301, 3))
    """
    result = _read(newest(path))
    return result.in_units() if units else result


def _read(path: Path) -> Result:
    import h5py

    if wrong := unreadable(path, "a result file (.h5)"):
        raise ResultFileError(f"{path}: {wrong}")
    if not h5py.is_hdf5(path):
        raise ResultFileError(f"{path}: is not an HDF5 file; name a result of this program")
    try:
        with open_file(path) as file:
            header = dict(file.attrs)
            if header.get("format") != FORMAT or "task" not in header:
                raise ResultFileError(f"{path}: an HDF5 file, but not written by this program")
            if int(header.get("format_version", 0)) > FORMAT_VERSION:
                raise ResultFileError(
                    f"{path}: has format version {header['format_version']}, this program reads "
                    f"{FORMAT_VERSION}; update qbxstokes"
                )
            whole = dict(file.items())
            items = {n: item for n, item in whole.items() if isinstance(item, h5py.Dataset)}
            groups = {n: read_tree(item) for n, item in whole.items() if n not in items}
            items = {n: item for n, item in items.items() if not is_dimension(item)}
            attributes = {name: _told(item) for name, item in items.items()}
            if header["task"] == "sweep":  # its datasets are read later, by name
                if "status" not in (items["table"].dtype.names or ()):
                    raise ResultFileError(f"{path}: is damaged: its table is not one of a sweep")
                _look_for_parts(path, groups.get(PARTS, {}))
                shapes = {name: item.shape for name, item in items.items()}
                lazy = LazyArrays(shapes, lambda name: _dataset(path, name))
                return SweepResult(path, header, lazy, attributes, groups)
            arrays = {name: item[()] for name, item in items.items()}
            if "summary" not in groups:
                raise ResultFileError(f"{path}: is incomplete: it has no summary; run it again")
    except ResultFileError:
        raise
    except Exception as error:  # h5py reports damage by errors of many kinds
        raise _damaged(path, error) from None
    return Result(path, header, arrays, attributes, groups)


def _dataset(path: Path, name: str) -> AnyArray:
    try:
        with open_file(path) as file:
            return np.asarray(file[name][()])
    except OSError as error:
        raise _damaged(path, error) from None


def _damaged(path: Path, error: Exception) -> ResultFileError:
    reason = " ".join(str(error).split())
    return ResultFileError(f"{path}: is damaged or truncated ({reason})")


def _look_for_parts(path: Path, parts: Mapping[str, Any]) -> None:
    """Raise ResultFileError unless the parts that a result shows are there, each as a whole."""
    for name, size in zip(parts.get("name", ()), parts.get("bytes", ()), strict=True):
        part = path.parent / name
        if not part.is_file() or part.stat().st_size != size:
            wrong = "is damaged" if part.is_file() else "is not there"
            raise ResultFileError(
                f"{path}: shows what stands in {part}, which {wrong}; move both together, or let "
                "--resume compute it again"
            )


def shows_parts(path: Path) -> bool:
    """Whether a file is a result that shows its parts rather than holding what stood in them."""
    try:
        with open_file(path) as file:
            return file.attrs.get("format") == FORMAT and PARTS in file
    except (OSError, HeldFileError):
        return False


def _told(item: h5py.Dataset) -> dict[str, Any]:
    """What a dataset, or each column of a table, says of itself."""
    found = {key: item.attrs[key] for key in item.attrs if key in _ATTRIBUTES or ": " in key}
    if isinstance(swept := found.get("coordinates", []), str):
        found["coordinates"] = swept.split()
    elif len(swept):
        found["coordinates"] = [str(name) for name in swept]
    own, axes = item.name.rpartition("/")[2], enumerate(item.dims)
    names = [axis[0].name.rpartition("/")[2] if len(axis) else f"{own}_{n}" for n, axis in axes]
    found["axes"] = (own,) if item.is_scale else tuple(names)
    return found
