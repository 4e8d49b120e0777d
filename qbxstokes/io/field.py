"""Fields in a result file: the group `field`, which all ranks fill piece by piece.

Layout: `field/time` (T,); per set of points a group with `points` (T, N, 3), the quantities
(T, N, ...), `inside` (T, N) and `source` (T, N), attribute `shape` (the grid, last index fastest)
and what describes the grid; `field/surface` with points, traction and pressure (T, N, ...);
`field/streamlines` with `points` (T, lines, samples, 3); `field/tracers` with `time` and
`points` (samples, tracers, 3), and the body's `position` and `orientation` then where it moves.
Everything is in the space frame; values inside the body are NaN.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from qbxstokes.io.places import describe, place, placed_dataset, write_at
from qbxstokes.quantities import FLUID, INSTANT, POINT, SURFACE

if TYPE_CHECKING:
    import h5py

Array = NDArray[Any]
GROUP = "field"

# What may stand at points, and what every point has beside its quantities.
_ARRAYS = FLUID | POINT | SURFACE
_MARKS = ("inside", "source")
_NUMBER = np.dtype(np.float64)
_TYPES = {"inside": np.dtype(np.bool_), "source": np.dtype(np.int8)}


def create(
    file: h5py.File, times: Array, sets: Mapping[str, tuple[int, ...]], names: Sequence[str]
) -> dict[str, int]:
    """The group `field` with room for sets of points (name -> shape of the grid).

    Returns the place of every dataset that `FieldRows` fills, by "set/quantity".
    """
    group = file.create_group(GROUP)
    time = group.create_dataset("time", data=np.asarray(times, float), track_times=False)
    describe(time, INSTANT)
    places = {}
    for name, shape in sets.items():
        inner = group.create_group(name)
        inner.attrs["shape"] = np.array(shape)
        size = int(np.prod(shape))
        for quantity in ("points", *names, *_MARKS):
            about = _ARRAYS[quantity]
            whole = (len(times), size, *about.shape)
            data = placed_dataset(inner, quantity, whole, _TYPES.get(quantity, _NUMBER), about)
            places[f"{name}/{quantity}"] = place(data)
    return places


class FieldRows:
    """The points of a laid out field, opened by one rank for the pieces that it has evaluated."""

    def __init__(self, path: Path, places: Mapping[str, int], sizes: Mapping[str, int]) -> None:
        """Open it; sizes: number of points of every set. Raises OSError."""
        self._descriptor = os.open(path, os.O_WRONLY)
        self._places, self._sizes = places, sizes

    def put(self, name: str, index: int, begin: int, rows: Mapping[str, Array]) -> None:
        """Write a piece of points and quantities of a set at an instant; raises OSError."""
        first = index * self._sizes[name] + begin
        for quantity, values in rows.items():
            data = np.ascontiguousarray(values, dtype=_TYPES.get(quantity, _NUMBER))
            row = data.dtype.itemsize * int(np.prod(data.shape[1:]))
            offset = self._places[f"{name}/{quantity}"] + first * row
            write_at(self._descriptor, data.data.cast("B"), offset)

    def close(self) -> None:
        """Close the file."""
        os.close(self._descriptor)


def put_arrays(
    group: h5py.Group, name: str, arrays: Mapping[str, Array], attributes: Mapping[str, Any]
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
