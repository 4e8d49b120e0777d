"""Results of a sweep read back: its table at once, its samples when they are asked for."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from qbxstokes.io.format import read_tree
from qbxstokes.io.result import Result

if TYPE_CHECKING:
    import h5py
    import pandas
    import xarray

_ATTRIBUTES = ("units", "description", "frame", "components")


class LazyArrays(Mapping[str, NDArray[Any]]):
    """Datasets of a file by name, each read into memory when it is first used."""

    def __init__(self, path: Path, shapes: Mapping[str, tuple[int, ...]]) -> None:
        self.path, self.shapes = path, dict(shapes)
        self._held: dict[str, NDArray[Any]] = {}

    def __getitem__(self, name: str) -> NDArray[Any]:
        """The dataset `name`."""
        if name not in self._held:
            import h5py

            if name not in self.shapes:
                raise KeyError(name)
            with h5py.File(self.path, "r") as file:
                self._held[name] = file[name][()]
        return self._held[name]

    def __iter__(self) -> Iterator[str]:
        """Names of the datasets."""
        return iter(self.shapes)

    def __len__(self) -> int:
        """Number of datasets."""
        return len(self.shapes)


class SweepResult(Result):
    """A sweep: `table` holds one row per trajectory, the quantities are (trajectory, time, ...).

    `shape` has one entry per axis of the sweep, so that `result.table["period"].reshape(shape)` is
    the period over the grid of swept values; `coordinates` names the swept columns.
    """

    coordinates: list[str]

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of points of every axis of the sweep."""
        return tuple(int(n) for n in np.atleast_1d(self.provenance["shape"]))

    def __repr__(self) -> str:
        """File and the shape of each dataset, without reading them."""
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
            told = {
                key: about[f"{name}: {key}"]
                for key in ("units", "description")
                if f"{name}: {key}" in about
            }
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


def read_sweep(path: Path, file: h5py.File, header: dict[str, Any]) -> SweepResult:
    """The result in an open file; its datasets are read later, by name."""
    import h5py

    groups = {name: read_tree(item) for name, item in file.items() if isinstance(item, h5py.Group)}
    datasets = {name: item for name, item in file.items() if isinstance(item, h5py.Dataset)}
    attributes: dict[str, dict[str, Any]] = {}
    for name, item in datasets.items():
        wanted = [key for key in item.attrs if key in _ATTRIBUTES or ": " in key]
        attributes[name] = {key: item.attrs[key] for key in wanted}
    coordinates = [str(name) for name in file["table"].attrs["coordinates"]]
    lazy = LazyArrays(path, {name: item.shape for name, item in datasets.items()})
    result = SweepResult(path, header, lazy, attributes, groups)  # type: ignore[arg-type]
    result.coordinates = coordinates
    return result
