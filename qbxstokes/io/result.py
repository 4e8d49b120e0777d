"""A result in memory, and as a table of pandas or a Dataset of xarray."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

if TYPE_CHECKING:
    import pandas
    import xarray


class Result:
    """A result read into memory: each dataset is an attribute holding a NumPy array.

    `provenance` and `summary` are nested dictionaries; `attributes` maps each dataset's name to
    its units, description and frame; `names` lists the datasets.
    """

    def __init__(
        self,
        path: Path,
        header: dict[str, Any],
        arrays: dict[str, NDArray[Any]],
        attributes: dict[str, dict[str, Any]],
        groups: dict[str, dict[str, Any]],
    ) -> None:
        """Collect what `load` has read."""
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
        """The dataset `name`."""
        arrays = self.__dict__.get("arrays", {})
        if name in arrays:
            return arrays[name]
        raise AttributeError(f"no dataset {name}; there are {', '.join(arrays)}")

    def __getitem__(self, name: str) -> NDArray[Any]:
        """The dataset `name`."""
        return self.arrays[name]

    def __dir__(self) -> list[str]:
        """Attributes, with the datasets among them."""
        return [*super().__dir__(), *self.arrays]

    def __repr__(self) -> str:
        """Task, file and the shape of each dataset."""
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

        variables = {
            name: (
                ("time", *(f"{name}_component" for _ in data.shape[1:])),
                data,
                self.attributes[name],
            )
            for name, data in self.arrays.items()
            if name != "time"
        }
        coordinates: dict[str, Any] = {"time": ("time", self.time, self.attributes["time"])}
        for name, data in self.arrays.items():
            if data.ndim == 2:
                coordinates[f"{name}_component"] = list(self._labels(name))
        return xr.Dataset(variables, coordinates, {"title": str(self.path), "task": self.task})

    def _labels(self, name: str) -> Sequence[str]:
        labels = self.attributes[name].get("components")
        return (
            list(labels)
            if labels is not None
            else [str(index + 1) for index in range(self.arrays[name].shape[1])]
        )
