"""Names of the axes of datasets, and the dimension scales that tell them to other programs.

Files are opened as they are by `xarray.open_dataset` and other readers of netCDF-4: every axis of a
dataset has a scale. It is the dataset of that name, such as `time`, or one without numbers that
marks a dimension alone, as netCDF-4 writes it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from qbxstokes.io.format import DIMENSION
from qbxstokes.quantities import FLUID, INSTANT, POINT, SURFACE

if TYPE_CHECKING:
    import h5py

_VECTORS = ("origin", "first", "second")  # of a plane
_OF_POINTS = {1: ("point",), 2: ("time", "point"), 3: ("time", "line", "sample")}


def name_axes(file: h5py.File, axes: Mapping[str, Sequence[str]]) -> None:
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
