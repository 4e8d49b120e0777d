"""Results for other programs: tables of pandas, Datasets of xarray; CSV, NPZ and netCDF files."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Mapping, Sequence
from itertools import product
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from qbxstokes.errors import CaseError, needed
from qbxstokes.io.listing import KNOWN
from qbxstokes.quantities import FLUID, POINT, SURFACE
from qbxstokes.typing import AnyArray

if TYPE_CHECKING:
    import pandas
    import xarray

    from qbxstokes.io.results import Result


_TOLD = ("units", "description")
_LEADING = ("peclet_number", "time", "lag")  # axes of which a table has its rows, as far as there


def dimensions(result: Result, name: str) -> tuple[str, ...]:
    """Names of a dataset's axes: time, trajectory, ..., and component of a vector's."""
    return tuple(result.attributes[name]["axes"])


def _labels(result: Result, name: str, axis: str, size: int) -> Sequence[Any]:
    """What tells the entries of one axis of a dataset apart."""
    components = result.attributes.get(name, {}).get("components")
    if components is not None and axis == dimensions(result, name)[-1]:
        return list(components)
    prefix = "body" if axis == "body" else ""
    return [f"{prefix}{number + 1}" for number in range(size)]


def columns(result: Result) -> tuple[list[str], dict[str, AnyArray]]:
    """The table that a result is: names of the columns that number its rows, columns by name.

    A row per instant of a motion, per trajectory of a sweep, per Peclet number and instant of a
    suspension; a single row of a body.
    """
    if "table" in result.shapes:
        return ["trajectory"], {"trajectory": np.arange(len(result.table)), **table_of(result)}
    leading = [axis for axis in _LEADING if axis in result.shapes]
    sizes = [result.shapes[axis][-1] for axis in leading]
    found: dict[str, AnyArray] = {}
    for number, axis in enumerate(leading):
        held = np.reshape(result[axis], [-1 if n == number else 1 for n in range(len(sizes))])
        found[axis] = np.broadcast_to(held, sizes).ravel()
    for name, shape in result.shapes.items():
        axes = dimensions(result, name)
        own = [axis for axis in leading if axis in axes]
        inner = axes[len(own) :]
        if name in found or list(axes[: len(own)]) != own or set(inner) & set(result.shapes):
            continue
        rows = [size if axis in own else 1 for axis, size in zip(leading, sizes, strict=True)]
        data = result[name].reshape(*rows, -1)
        data = np.broadcast_to(data, (*sizes, data.shape[-1])).reshape(prod(sizes), -1)
        pairs = zip(inner, shape[len(own) :], strict=True)
        labels = [_labels(result, name, axis, size) for axis, size in pairs]
        for place, parts in enumerate(product(*labels)):
            found["_".join([name, *parts])] = data[:, place]
    return leading, found


def table_of(result: Result) -> dict[str, AnyArray]:
    """The table of a sweep, column by column, texts decoded."""
    table = result.arrays["table"]
    return {name: texts(table[name]) for name in table.dtype.names or ()}


def texts(column: AnyArray) -> AnyArray:
    """A column as it is, or its bytes as text."""
    return np.char.decode(column, "ascii") if column.dtype.kind == "S" else column


def to_pandas(result: Result) -> pandas.DataFrame:
    """See `Result.to_pandas`."""
    frame = needed("pandas", "to_pandas()").DataFrame
    index, found = columns(result)
    table = frame(found)
    return table.set_index(index) if index else table


def to_xarray(result: Result) -> xarray.Dataset:
    """See `Result.to_xarray`."""
    variables: dict[str, Any] = {}
    coordinates: dict[str, Any] = {}
    shapes = result.shapes
    if "table" in shapes:
        about = result.attributes["table"]
        swept = set(about["coordinates"])
        for name, column in table_of(result).items():
            told = {key: about[f"{name}: {key}"] for key in _TOLD if f"{name}: {key}" in about}
            held = coordinates if name in swept else variables
            held[name] = ("trajectory", column, told)
    for name, shape in shapes.items():
        if name == "table" or name in coordinates:
            continue
        axes = dimensions(result, name)
        told = {k: v for k, v in result.attributes[name].items() if k not in ("components", "axes")}
        is_axis = axes == (name,) or name == "time"
        (coordinates if is_axis else variables)[name] = (axes, result[name], told)
        if "components" in result.attributes[name]:
            coordinates[axes[-1]] = _labels(result, name, axes[-1], shape[-1])
    title = result.provenance.get("title") or str(result.path)
    about = {"title": title, "task": result.task, "conventions": result.conventions}
    return needed("xarray", "to_xarray()").Dataset(variables, coordinates, about)


def _sets(result: Result) -> dict[str, dict[str, AnyArray]]:
    """The tables of a field: columns by name of each set of points, surface and lines."""
    about = FLUID | POINT | SURFACE
    group = result.groups.get("field", {})
    found: dict[str, dict[str, AnyArray]] = {}
    for name, held in group.items():
        if not isinstance(held, Mapping) or "points" not in held:
            continue
        lead = held["points"].shape[:-1]
        table = found[name] = {}
        if len(lead) > 1:
            times = held.get("time", group["time"])
            table["time"] = np.repeat(times, prod(lead[1:]))
        if len(lead) > 2:
            table["line"] = np.broadcast_to(np.arange(lead[1])[:, None], lead).ravel()
        for key, data in held.items():
            if isinstance(data, np.ndarray) and data.shape[: len(lead)] == lead:
                labels = about[key].components if key in about else ()
                for place, column in enumerate(data.reshape(prod(lead), -1).T):
                    table[f"{key}_{labels[place]}" if labels else key] = column
    return found


# -- files ----------------------------------------------------------------------------------------


def _csv(result: Result, path: Path) -> list[Path]:
    sets = _sets(result)
    if not sets:
        return [_rows(_headed(result, columns(result)[1]), path)]
    return [
        _rows(_headed(result, table), path.with_stem(f"{path.stem}-{name}"))
        for name, table in sets.items()
    ]


def _headed(result: Result, table: dict[str, AnyArray]) -> dict[str, AnyArray]:
    """Columns under their names, with their units where these are physical."""
    if result.converted_by is None:
        return table
    swept = result.attributes.get("table", {})
    fields, found = result.fields, {}
    for name, column in table.items():
        wholes = [whole for whole in (*result.shapes, *KNOWN) if name.startswith(whole)]
        whole = max(wholes, key=len, default="")
        units = swept.get(f"{name}: units") or fields.units(whole)
        found[f"{name} [{units}]" if units not in ("", "1") else name] = column
    return found


def _rows(table: Mapping[str, AnyArray], path: Path) -> Path:
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(table)
        writer.writerows(zip(*(column.tolist() for column in table.values()), strict=True))
    return path


def _npz(result: Result, path: Path) -> list[Path]:
    arrays = {name: result[name] for name in result.shapes if name != "table"}
    if "table" in result.shapes:
        arrays |= {f"table/{name}": column for name, column in table_of(result).items()}
    arrays |= _arrays(result.groups)
    about = result.attributes.items()
    units = {name: str(told["units"]) for name, told in about if "units" in told}
    np.savez(path, **arrays, units=np.array(json.dumps(units)))
    return [path]


def _arrays(tree: Mapping[str, Any], prefix: str = "") -> dict[str, AnyArray]:
    """The arrays of nested groups, as group/name."""
    found: dict[str, AnyArray] = {}
    for name, value in tree.items():
        if isinstance(value, Mapping):
            found |= _arrays(value, f"{prefix}{name}/")
        elif isinstance(value, np.ndarray) and value.dtype.kind in "fiub":
            found[f"{prefix}{name}"] = value
    return found


def _netcdf(result: Result, path: Path) -> list[Path]:
    needed("h5netcdf", "a netCDF file", "xarray pandas")
    to_xarray(result).to_netcdf(path, engine="h5netcdf")
    return [path]


FORMATS: dict[str, Callable[[Result, Path], list[Path]]] = {"csv": _csv, "npz": _npz, "nc": _netcdf}


def write(result: Result, path: Path) -> list[Path]:
    """Write a result in the format that the name's ending says, one of `FORMATS`; what is written.

    Of a field as .csv a file for each set of points, NAME-SET.csv. Raises CaseError for another
    format or where it cannot be written, MissingPackageError.
    """
    if path.suffix[1:] not in FORMATS:
        raise CaseError(f"{path}: results are exported as .{', .'.join(FORMATS)}")
    try:
        return FORMATS[path.suffix[1:]](result, path)
    except OSError as error:
        raise CaseError(f"{path}: cannot be written ({error.strerror or error})") from None
