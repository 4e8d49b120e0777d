"""Names of the axes of datasets, and the dimension scales that tell them to other programs.

Files are opened as they are by `xarray.open_dataset` and other readers of netCDF-4: every axis of a
dataset has a scale. It is the dataset of that name, such as `time`, or one without numbers that
marks a dimension alone, as netCDF-4 writes it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from qbxstokes.io.format import DIMENSION
from qbxstokes.quantities import FLUID, POINT, SURFACE

if TYPE_CHECKING:
    import h5py

# The axes that datasets of a task have before those of their components, as far as they have them.
LEADING = {
    "motion": ("time", "body"),
    "field": ("time", "body"),
    "sweep": ("trajectory", "time", "sample", "body"),
    "rheology": ("peclet_number", "time"),
    "ensemble": ("time", "lag", "body"),
    "body": ("body",),
}
_KNOWN = {
    "distribution": ("peclet_number", "theta", "phi"),
    "strain": ("time",),
    "strain_rate": ("time",),
    "paths": ("peclet_number", "time", "path", "component"),
    "samples": ("peclet_number", "sample", "component"),
}
# Of an ensemble, by the ends of their names.
_STATISTICS = {
    "correlation": ("lag", "body"),
    "counts": ("body", "bin"),
    "edges": ("edge",),
    "moments": ("body", "power"),
    "moments_error": ("body", "power"),
    "in_time": ("time", "body"),
    "axis": ("path", "sample", "body", "component"),
}
# Components that many quantities have share an axis, so that products go by component.
_SHARED = {("1", "2", "3"): "component", ("11", "22", "33", "12", "13", "23"): "pair"}
_VECTORS = ("origin", "first", "second")  # of a plane
_OF_POINTS = {1: ("point",), 2: ("time", "point"), 3: ("time", "line", "sample")}


def component_axis(name: str, components: Sequence[str]) -> str:
    """The axis along which a quantity has its components."""
    return _SHARED.get(tuple(components), f"{name}_component")


def dimensions(
    task: str,
    shapes: Mapping[str, tuple[int, ...]],
    attributes: Mapping[str, Mapping[str, Any]],
    name: str,
) -> tuple[str, ...]:
    """Names of a dataset's axes: time, trajectory, ..., and component of a vector's."""
    shape = shapes[name]
    if name in _KNOWN:
        return _KNOWN[name]
    known = [axis for axis in LEADING.get(task, ()) if axis in shapes or axis == "body"]
    leading = [axis for axis in known if len(shapes.get(axis, (0,))) == 1]
    if len(shape) == 1 and name in leading:
        return (name,)
    if task == "ensemble":
        ends = [axes for end, axes in _STATISTICS.items() if name.endswith(end)]
        return next(iter(ends), ("body", "row", "column")[: len(shape)])
    if task == "sweep" and len(shape) == 1:
        return ("trajectory",)
    tensor = len(shape) > 1 and shape[-1] == shape[-2] and (shape[-1] in (3, 6) or task == "body")
    if "components" in attributes.get(name, {}):
        last: tuple[str, ...] = (component_axis(name, attributes[name]["components"]),)
    else:
        named = ("row", "column") if shape[-1:] == (3,) else (f"{name}_row", f"{name}_column")
        last = named if tensor else ()
    found: list[str] = []
    for size in shape[: len(shape) - len(last)]:
        fitting = [axis for axis in leading if shapes.get(axis, (size,)) == (size,)]
        if axis := next(iter(fitting), ""):
            leading = leading[leading.index(axis) + 1 :]
        found.append(axis or (name if len(shape) == 1 else f"{name}_{len(found)}"))
    return (*found, *last)


def name_axes(file: h5py.File) -> None:
    """Give every axis of a result's datasets its scale, those of events and fields as well."""
    import h5py

    def datasets(group: h5py.Group) -> dict[str, h5py.Dataset]:
        return {name: data for name, data in group.items() if isinstance(data, h5py.Dataset)}

    held, task = datasets(file), str(file.attrs["task"])
    shapes = {name: data.shape for name, data in held.items()}
    attributes = {name: dict(data.attrs) for name, data in held.items()}
    for name, data in held.items():
        _scale(file, data, dimensions(task, shapes, attributes, name))
    for group in file.get("events", {}).values():
        for name, data in datasets(group).items():
            components = data.attrs.get("components", ())
            last = (component_axis(name, components),) * (data.ndim - 1)
            _scale(group, data, ("time", *last))
    about = FLUID | POINT | SURFACE
    for group in file.get("field", {}).values():
        if not isinstance(group, h5py.Group) or "points" not in group:
            continue
        lead = group["points"].shape[:-1]
        axes = ("time", "line") if "time" in group else _OF_POINTS[len(lead)]
        for name, data in datasets(group).items():
            if name == "time" or data.shape[: len(lead)] == lead:
                rest = data.shape[len(lead) :]
                last = (component_axis(name, about[name].components),) * len(rest) if rest else ()
                _scale(group, data, ("time",) if name == "time" else (*axes, *last))
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
