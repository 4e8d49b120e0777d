"""Fields in a result file: the group `field`, which is filled piece by piece.

Layout: `field/time` (T,); per set of points a group with `points` (T, N, 3), the quantities
(T, N, ...), `inside` (T, N) and `source` (T, N), attribute `shape` (the grid, last index fastest)
and what describes the grid; `field/surface` (of several bodies `surface_1` and so on) and
`field/wall` with points, traction and pressure (T, N, ...);
`field/streamlines` with `points` (T, lines, samples, 3); `field/tracers` with `time` and
`points` (samples, tracers, 3), and the body's `position` and `orientation` then where it moves.
Everything is in the space frame; values inside the body are NaN.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from qbxstokes.io.format import describe, placed_dataset
from qbxstokes.quantities import FLUID, INSTANT, MOTION, POINT, SURFACE, TIME
from qbxstokes.typing import AnyArray

if TYPE_CHECKING:
    import h5py

GROUP = "field"

# What may stand at points or along the ways of tracers, and what every point has besides.
_ARRAYS = MOTION | {"time": TIME} | FLUID | POINT | SURFACE
_MARKS = ("inside", "source")
_NUMBER = np.dtype(np.float64)
_TYPES = {"inside": np.dtype(np.bool_), "source": np.dtype(np.int8)}


def create(
    file: h5py.File, times: AnyArray, sets: Mapping[str, tuple[int, ...]], names: Sequence[str]
) -> None:
    """The group `field` with room for sets of points (name -> shape of the grid).

    `put_rows` fills it.
    """
    group = file.create_group(GROUP)
    time = group.create_dataset("time", data=np.asarray(times, float), track_times=False)
    describe(time, INSTANT)
    for name, shape in sets.items():
        inner = group.create_group(name)
        inner.attrs["shape"] = np.array(shape)
        size = int(np.prod(shape))
        for quantity in ("points", *names, *_MARKS):
            about = _ARRAYS[quantity]
            whole = (len(times), size, *about.shape)
            placed_dataset(inner, quantity, whole, _TYPES.get(quantity, _NUMBER), about)


def bytes_per_point(names: Sequence[str]) -> int:
    """What a point with the quantities takes."""
    numbers = sum(_ARRAYS[name].size for name in ("points", *names))
    return _NUMBER.itemsize * numbers + sum(kind.itemsize for kind in _TYPES.values())


def put_rows(inner: h5py.Group, index: int, begin: int, rows: Mapping[str, AnyArray]) -> None:
    """Write a piece of points and quantities of a set at an instant."""
    for quantity, values in rows.items():
        inner[quantity][index, begin : begin + len(values)] = values


def put_arrays(
    group: h5py.Group, name: str, arrays: Mapping[str, AnyArray], attributes: Mapping[str, Any]
) -> None:
    """Write a group of whole arrays, those that are listed quantities with their attributes."""
    inner = group.require_group(name)
    for key, values in arrays.items():
        data = inner.create_dataset(key, data=values, track_times=False)
        if key in _ARRAYS:
            describe(data, _ARRAYS[key])
    for key, value in attributes.items():
        inner.attrs[key] = value


def pieces(size: int, piece: int) -> Iterable[tuple[int, int]]:
    """Begin and end of the pieces of `size` points."""
    return ((begin, min(begin + piece, size)) for begin in range(0, size, piece))
