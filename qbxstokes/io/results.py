"""Result files, one HDF5 file per run, read back as NumPy arrays, tables of pandas
or Datasets of xarray.

Layout of a motion (format_version 1): datasets `time` (T) and the quantities of a motion
(`quantities.MOTION`), each (T, ...) with attributes `units`, `description`, `frame` and `time` as
its dimension scale; groups `provenance` (how it was made) and `summary` (what came out);
attributes `format`, `format_version`, `task`, `conventions` at the root.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from qbxstokes.errors import ResultFileError
from qbxstokes.io.format import FORMAT, FORMAT_VERSION, PARTS, read_tree
from qbxstokes.io.names import newest

if TYPE_CHECKING:
    import h5py
    import pandas
    import xarray

_TOLD = ("units", "description")
_ATTRIBUTES = (*_TOLD, "frame", "components", "coordinates")


class Result:
    """A result read into memory: each dataset is an attribute holding a NumPy array.

    `provenance` and `summary` are nested dictionaries; `attributes` maps each dataset's name to
    its units, description and frame; `names` lists the datasets.
    """

    def __init__(
        self,
        path: Path,
        header: dict[str, Any],
        arrays: Mapping[str, NDArray[Any]],
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

    @property
    def names(self) -> list[str]:
        """Names of the datasets."""
        return list(self.arrays)

    def __getattr__(self, name: str) -> NDArray[Any]:
        arrays = self.__dict__.get("arrays", {})
        if name in arrays:
            return arrays[name]
        raise AttributeError(f"no dataset {name}; there are {', '.join(arrays)}")

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self.arrays[name]

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self.arrays]

    def __repr__(self) -> str:
        shapes = ", ".join(f"{name}{list(data.shape)}" for name, data in self.arrays.items())
        return f"<{self.task} result {self.path}: {shapes}>"

    def to_pandas(self) -> pandas.DataFrame:
        """A table with one row per instant, columns such as position_1; needs pandas."""
        import pandas as pd

        columns: dict[str, NDArray[Any]] = {}
        for name, data in self.arrays.items():
            if name == "time" or len(data) != len(self.time):
                continue
            if data.ndim == 1:
                columns[name] = data
            else:
                for label, column in zip(self._labels(name), data.T, strict=True):
                    columns[f"{name}_{label}"] = column
        return pd.DataFrame(columns, index=pd.Index(self.time, name="time"))

    def to_xarray(self) -> xarray.Dataset:
        """A Dataset over time with units and descriptions as attributes; needs xarray."""
        import xarray as xr

        variables: dict[str, Any] = {}
        coordinates: dict[str, Any] = {"time": ("time", self.time, self.attributes["time"])}
        for name, data in self.arrays.items():
            if name == "time":
                continue
            components = [f"{name}_component"] * (data.ndim - 1)
            variables[name] = (["time", *components], data, self.attributes[name])
            if data.ndim == 2:
                coordinates[components[0]] = list(self._labels(name))
        return xr.Dataset(variables, coordinates, {"title": str(self.path), "task": self.task})

    def _labels(self, name: str) -> Sequence[str]:
        labels = self.attributes[name].get("components")
        if labels is None:
            return [str(index + 1) for index in range(self.arrays[name].shape[1])]
        return list(labels)


class LazyArrays(Mapping[str, NDArray[Any]]):
    """Datasets of a file by name, each read into memory when it is first used."""

    def __init__(self, path: Path, shapes: Mapping[str, tuple[int, ...]]) -> None:
        self.path, self.shapes = path, dict(shapes)
        self._held: dict[str, NDArray[Any]] = {}

    def __getitem__(self, name: str) -> NDArray[Any]:
        if name not in self._held:
            import h5py

            if name not in self.shapes:
                raise KeyError(name)
            try:
                with h5py.File(self.path, "r") as file:
                    self._held[name] = file[name][()]
            except OSError as error:
                raise _damaged(self.path, error) from None
        return self._held[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.shapes)

    def __len__(self) -> int:
        return len(self.shapes)


class SweepResult(Result):
    """A sweep: `table` holds one row per trajectory, the quantities are (trajectory, time, ...).

    `shape` has one entry per axis of the sweep, so that `result.table["period"].reshape(shape)` is
    the period over the grid of swept values; `coordinates` names the swept columns.
    """

    @property
    def coordinates(self) -> list[str]:
        """Names of the swept columns."""
        return [str(name) for name in self.attributes["table"]["coordinates"]]

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of points of every axis of the sweep."""
        return tuple(int(n) for n in np.atleast_1d(self.provenance["shape"]))

    def __repr__(self) -> str:
        assert isinstance(self.arrays, LazyArrays)
        shapes = ", ".join(f"{name}{list(shape)}" for name, shape in self.arrays.shapes.items())
        return f"<sweep result {self.path}: {shapes}>"

    def trajectory(self, number: int) -> Result:
        """One trajectory as the result of a motion; raises IndexError where there is none.

        Only its own samples are read. `provenance["swept"]` holds its swept values.
        """
        import h5py

        with h5py.File(self.path, "r") as file:
            if not 0 <= number < len(file["table"]):
                raise IndexError(f"no trajectory {number} among {len(file['table'])}")
            row = file["table"][number : number + 1]
            arrays = {
                name: file[name][()] if file[name].ndim == 1 else file[name][number]
                for name in self._samples()
                if file[name].ndim > 1 or name == "time"
            }
        summary = {name: _texts(row[name])[0].item() for name in row.dtype.names}
        swept = {name: summary.pop(name) for name in self.coordinates}
        header = {"task": "motion", "format_version": self.format_version}
        attributes = {name: self.attributes[name] for name in arrays}
        groups = {"provenance": {**self.provenance, "swept": swept}, "summary": summary}
        return Result(self.path, header, arrays, attributes, groups)

    def to_pandas(self) -> pandas.DataFrame:
        """The table, one row per trajectory; needs pandas."""
        import pandas as pd

        table = self.arrays["table"]
        columns = {name: _texts(table[name]) for name in table.dtype.names or ()}
        return pd.DataFrame(columns, index=pd.RangeIndex(len(table), name="trajectory"))

    def to_xarray(self) -> xarray.Dataset:
        """Table and samples over trajectory (with the swept values) and time; needs xarray."""
        import xarray as xr

        table = self.arrays["table"]
        about = self.attributes["table"]
        variables: dict[str, Any] = {}
        coordinates: dict[str, Any] = {"trajectory": np.arange(len(table))}
        for name in table.dtype.names or ():
            told = {key: about[f"{name}: {key}"] for key in _TOLD if f"{name}: {key}" in about}
            held = coordinates if name in self.coordinates else variables
            held[name] = ("trajectory", _texts(table[name]), told)
        for name, shape in self._samples().items():
            attributes = {k: v for k, v in self.attributes[name].items() if k != "components"}
            if name == "time":
                second = ("trajectory", "sample") if len(shape) == 2 else ("time",)
                coordinates["time"] = (second, self.arrays["time"], attributes)
                continue
            instants = "sample" if "sample" in self.arrays else "time"
            dimensions = ["trajectory", instants]
            if len(shape) == 3:
                dimensions.append(f"{name}_component")
                coordinates[f"{name}_component"] = list(self.attributes[name]["components"])
            variables[name] = (dimensions, self.arrays[name], attributes)
        return xr.Dataset(variables, coordinates, {"title": str(self.path), "task": self.task})

    def _samples(self) -> dict[str, tuple[int, ...]]:
        assert isinstance(self.arrays, LazyArrays)
        known = {"table", "trajectory", "sample", *self.coordinates}
        return {name: s for name, s in self.arrays.shapes.items() if name not in known}


def _texts(column: NDArray[Any]) -> NDArray[Any]:
    return np.char.decode(column, "ascii") if column.dtype.kind == "S" else column


def load(path: str | Path) -> Result:
    """Read a result file; raises ResultFileError if it is missing, damaged or not ours.

    Of a case file its newest result in the working folder, which `path` of the result names.

    >>> result = load("jeffery_prolate.h5")  # doctest: +SKIP
    >>> result.time.shape, result.axis.shape  # doctest: +SKIP
    ((301,), (301, 3))
    """
    import h5py

    path = newest(path)
    try:
        if path.is_dir():
            raise ResultFileError(f"{path}: is a directory; name a result file (.h5)")
        if not path.exists():
            raise ResultFileError(f"{path}: no such file; name a result file (.h5)")
        if not path.is_file():  # reading a pipe might wait for ever
            raise ResultFileError(f"{path}: is a pipe or device; name a result file (.h5)")
        if not os.access(path, os.R_OK):
            raise ResultFileError(f"{path}: no permission to read it")
    except OSError as error:
        raise ResultFileError(f"{path}: cannot be read ({error.strerror})") from None
    if not h5py.is_hdf5(path):
        raise ResultFileError(f"{path}: is not an HDF5 file; name a result of this program")
    try:
        with h5py.File(path, "r") as file:
            header = dict(file.attrs)
            if header.get("format") != FORMAT or "task" not in header:
                raise ResultFileError(f"{path}: an HDF5 file, but not written by this program")
            if int(header.get("format_version", 0)) > FORMAT_VERSION:
                raise ResultFileError(
                    f"{path}: has format version {header['format_version']}, this program reads "
                    f"{FORMAT_VERSION}; update qbxstokes"
                )
            items = {name: item for name, item in file.items() if isinstance(item, h5py.Dataset)}
            groups = {name: read_tree(file[name]) for name in file if name not in items}
            attributes = {name: _told(item) for name, item in items.items()}
            if header["task"] == "sweep":  # its datasets are read later, by name
                if "status" not in (items["table"].dtype.names or ()):
                    raise ResultFileError(f"{path}: is damaged: its table is not one of a sweep")
                _look_for_parts(path, groups.get(PARTS, {}))
                lazy = LazyArrays(path, {name: item.shape for name, item in items.items()})
                return SweepResult(path, header, lazy, attributes, groups)
            arrays = {name: item[()] for name, item in items.items()}
            if "summary" not in groups:
                raise ResultFileError(f"{path}: is incomplete: it has no summary; run it again")
    except ResultFileError:
        raise
    except Exception as error:  # h5py reports damage by errors of many kinds
        raise _damaged(path, error) from None
    return Result(path, header, arrays, attributes, groups)


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
    import h5py

    try:
        with h5py.File(path, "r") as file:
            return file.attrs.get("format") == FORMAT and PARTS in file
    except OSError:
        return False


def _told(item: h5py.Dataset) -> dict[str, Any]:
    """What a dataset, or each column of a table, says of itself."""
    return {key: item.attrs[key] for key in item.attrs if key in _ATTRIBUTES or ": " in key}
