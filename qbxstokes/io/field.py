"""Fields in a result file: the group `field`, written block by block.

Layout: `field/time` (T,); per set of points a group with `points` (T, N, 3), the quantities
(T, N, ...), `inside` (T, N) and `source` (T, N), attribute `shape` (the grid, last index fastest)
and what describes the grid; `field/surface` with points, traction and pressure (T, N, ...);
`field/streamlines` with `points` (T, lines, samples, 3); `field/tracers` with `time` and
`points` (samples, tracers, 3). Everything is in the space frame; values inside the body are NaN.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from qbxstokes.io.results import Field

if TYPE_CHECKING:
    import h5py

Array = NDArray[Any]
GROUP = "field"

_XYZ = ("1", "2", "3")
FIELD_FIELDS: dict[str, Field] = {
    "points": Field((3,), "c", "space", "points", _XYZ),
    "velocity": Field((3,), "c/tau", "space", "velocity of the fluid", _XYZ),
    "disturbance_velocity": Field(
        (3,), "c/tau", "space", "velocity minus that of the background flow", _XYZ
    ),
    "pressure": Field((), "mu/tau", "", "pressure, with that of the background flow"),
    "stress": Field((6,), "mu/tau", "space", "stress tensor", ("11", "22", "33", "12", "13", "23")),
    "traction": Field((3,), "mu/tau", "space", "force of the fluid on the body per area", _XYZ),
    "normals": Field((3,), "1", "space", "outward unit normals", _XYZ),
}


def create(
    file: h5py.File, times: Array, sets: Mapping[str, tuple[int, ...]], names: Sequence[str]
) -> h5py.Group:
    """The group `field` with empty datasets for the sets of points (name -> shape of the grid)."""
    group = file.create_group(GROUP)
    time = group.create_dataset("time", data=np.asarray(times, float), track_times=False)
    time.attrs.update(units="tau", description="instants of the field", frame="")
    for name, shape in sets.items():
        inner = group.create_group(name)
        inner.attrs["shape"] = np.array(shape)
        size = int(np.prod(shape))
        for quantity in ("points", *names):
            field = FIELD_FIELDS[quantity]
            _empty(inner, quantity, (len(times), size, *field.shape), "f8", field)
        _empty(inner, "inside", (len(times), size), "?", Field((), "1", "", "point in the body"))
        _empty(
            inner,
            "source",
            (len(times), size),
            "i1",
            Field((), "1", "", "0 plain, 1 graded quadrature, 2 QBX, 3 table; -1 in the body"),
        )
    return group


def _empty(
    group: h5py.Group, name: str, shape: tuple[int, ...], kind: str, field: Field
) -> h5py.Dataset:
    chunk = (1, min(max(shape[1], 1), 8192), *shape[2:])
    data = group.create_dataset(name, shape, kind, chunks=chunk, fletcher32=True, track_times=False)
    describe(data, field)
    return data


def describe(data: h5py.Dataset, field: Field) -> None:
    """Attach units, description, frame and components."""
    data.attrs.update(units=field.units, description=field.description, frame=field.frame)
    if field.components:
        data.attrs["components"] = list(field.components)


def put(group: h5py.Group, name: str, index: int, begin: int, block: Mapping[str, Array]) -> None:
    """Write a block of points and quantities of the set `name` at the instant `index`."""
    for quantity, values in block.items():
        group[name][quantity][index, begin : begin + len(values)] = values


def put_arrays(
    group: h5py.Group, name: str, arrays: Mapping[str, Array], attributes: Mapping[str, Any]
) -> None:
    """Write a group of whole arrays, those with a name of FIELD_FIELDS with their attributes."""
    inner = group.require_group(name)
    for key, values in arrays.items():
        data = inner.create_dataset(key, data=values, track_times=False)
        if key in FIELD_FIELDS:
            describe(data, FIELD_FIELDS[key])
    for key, value in attributes.items():
        inner.attrs[key] = value


def blocks(size: int, block: int) -> Iterable[tuple[int, int]]:
    """Begin and end of the blocks of `size` points."""
    return ((begin, min(begin + block, size)) for begin in range(0, size, block))
