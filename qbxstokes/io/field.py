"""Fields in a result file: the group `field`, which is filled piece by piece.

Layout: `field/time` (T,); per set of points a group with `points` (T, N, 3), the quantities
(T, N, ...), `inside` (T, N) and `source` (T, N), attribute `shape` (the grid, last index fastest)
and what describes the grid; `field/surface` (of several bodies `surface_1` and so on) and
`field/wall` with points, traction and pressure (T, N, ...);
`field/streamlines` with `points` (T, lines, samples, 3); `field/tracers` with `time` and
`points` (samples, tracers, 3), and the body's `position` and `orientation` then where it moves.
Everything is in the space frame; values inside the body are NaN.

For ParaView they are written as VTKHDF files (VTK file formats, "VTKHDF", version 2), which it
opens as they are. One file holds a PartitionedDataSetCollection: a part per set of points, the
body's surface with its traction, and lines, each with its steps in time. Cells that touch a point
inside the body are left out, so that nothing is drawn where nothing flows.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from qbxstokes.io.format import describe, placed_dataset
from qbxstokes.io.writer import whole_hdf5
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


# -- for ParaView ----------------------------------------------------------------------------------


_POLYGONAL = ("Vertices", "Lines", "Polygons", "Strips")
_OFFSETS = ("PointOffsets", "CellOffsets", "ConnectivityIdOffsets")
_VERTEX, _QUAD, _HEXAHEDRON = 1, 9, 12
_ORDER_OF_STRESS = (0, 1, 2, 3, 5, 4)  # ours: 11 22 33 12 13 23; ParaView's: 11 22 33 12 23 13


def export(result: h5py.File, path: Path, folder: Path | None = None) -> Path:
    """Write the group `field` of an open result to `path`, step by step; returns the path.

    folder: where it is until it is whole; unset: beside `path`. Raises OutputError.
    """
    import h5py

    group = result["field"]
    times = group["time"][()]
    # ParaView reads files that older versions of HDF5 can read.
    with whole_hdf5(path, folder, libver=("earliest", "v110")) as file:
        root = _typed(file, "VTKHDF", "PartitionedDataSetCollection")
        assembly = root.create_group("Assembly", track_order=True)
        writers: list[tuple[str, h5py.Group, _Part]] = []
        for name, inner in group.items():
            if not isinstance(inner, h5py.Group):
                continue
            if name in ("tracers", "error"):
                continue  # on instants of their own, and a sample of the plane
            polygonal = name.startswith("surface") or name in ("wall", "streamlines")
            kind = "PolyData" if polygonal else "UnstructuredGrid"
            part = _typed(root, name, kind)
            part.attrs["Index"] = np.int64(len(writers))
            assembly.create_group(name, track_order=True)[name] = h5py.SoftLink(f"/VTKHDF/{name}")
            writers.append((name, inner, _Part(part, polygonal)))
        for step in range(len(times)):
            for name, inner, writer in writers:
                writer.add(*_piece(name, inner, step))
        for _, _, writer in writers:
            # Each part carries the steps; the reader wants none at the root.
            writer.finish(times)
    return path


def _typed(parent: h5py.Group, name: str, kind: str) -> h5py.Group:
    import h5py

    group = parent.create_group(name, track_order=True)
    group.attrs["Version"] = np.array([2, 3], dtype=np.int64)
    text = kind.encode("ascii")
    group.attrs.create("Type", text, dtype=h5py.string_dtype("ascii", len(text)))
    return group


def _piece(
    name: str, inner: h5py.Group, step: int
) -> tuple[AnyArray, AnyArray, int, dict[str, AnyArray]]:
    """Points (N, 3), cells (M, n), type of cell and point data of a part at one step."""
    if name == "streamlines":
        lines = _ended(inner["points"][step])
        index = np.arange(lines.shape[0] * lines.shape[1]).reshape(lines.shape[:2])
        number = np.repeat(np.arange(len(lines)), lines.shape[1]).astype(float)
        return lines.reshape(-1, 3), index, 0, {"line": number}
    points = inner["points"][step]
    shape = tuple(int(n) for n in inner.attrs["shape"])
    closed = name.startswith(("surface", "shells"))
    cells, kind = _cells(shape, closed)
    data = {}
    for key, values in inner.items():
        if (
            key in ("points", "source")
            or values.ndim < 2
            or values.shape[:2] != (inner["points"].shape[:2])
        ):
            continue
        array = values[step]
        if key == "stress":
            array = np.take(array, _ORDER_OF_STRESS, axis=1)
        if array.ndim > 2:  # tensors, row by row
            array = array.reshape(len(array), -1)
        data[key] = array.astype(np.uint8) if array.dtype == bool else array
    if "inside" in data:
        inside = data["inside"].astype(bool)
        kept = ~np.any([inside[corner] for corner in cells.T], axis=0)
        cells = np.compress(kept, cells, axis=0)
    return points, cells, kind, data


def _ended(lines: AnyArray) -> AnyArray:
    """Lines (N, P, 3) that are anywhere, staying where they end (NaN from there on, or before)."""
    good = ~np.isnan(lines[..., 0])
    lines, good = lines[good.any(axis=1)], good[good.any(axis=1)]
    index = np.arange(lines.shape[1])
    first = np.argmax(good, axis=1)[:, None]
    last = lines.shape[1] - 1 - np.argmax(good[:, ::-1], axis=1)[:, None]
    return np.take_along_axis(lines, np.clip(index, first, last)[..., None], axis=1)


def _cells(shape: tuple[int, ...], closed: bool) -> tuple[AnyArray, int]:
    """Corners of the cells of a structured grid; closed grids join in their last direction."""
    index = np.arange(int(np.prod(shape))).reshape(shape)
    if closed:
        index = np.concatenate([index, index[..., :1]], axis=-1)
    if len(shape) == 1 or min(shape[-2:]) < 2:
        return np.arange(int(np.prod(shape)))[:, None], _VERTEX
    flat = [index[..., :-1, :-1], index[..., 1:, :-1], index[..., 1:, 1:], index[..., :-1, 1:]]
    if len(shape) == 3 and shape[0] > 1:
        corners = [part[:-1] for part in flat] + [part[1:] for part in flat]
        return np.stack(corners, axis=-1).reshape(-1, 8), _HEXAHEDRON
    return np.stack(flat, axis=-1).reshape(-1, 4), _QUAD


class _Part:
    """One part of the collection, extended step by step."""

    def __init__(self, group: h5py.Group, polygonal: bool) -> None:
        self.group = group
        self.polygonal = polygonal
        self.offsets: dict[str, list[Any]] = {name: [] for name in _OFFSETS}
        self.held = dict.fromkeys(_OFFSETS, 0)
        self.data: list[str] = []
        if polygonal:
            for kind in _POLYGONAL:
                group.create_group(kind)

    def add(
        self, points: AnyArray, cells: AnyArray, kind: int, data: Mapping[str, AnyArray]
    ) -> None:
        """Append one step."""
        group = self.group
        begin: dict[str, Any] = dict(self.held)
        self._extend(group, "NumberOfPoints", np.array([len(points)]))
        self._extend(group, "Points", points)
        if self.polygonal:
            used = _POLYGONAL.index("Lines" if kind == 0 else "Polygons")
            for column, name in enumerate(_POLYGONAL):
                these = cells if column == used else np.zeros((0, 1), dtype=np.int64)
                self._topology(group[name], these)
            for key in ("CellOffsets", "ConnectivityIdOffsets"):
                begin[key] = [begin[key] if column == used else 0 for column in range(4)]
        else:
            self._topology(group, cells)
            self._extend(group, "Types", np.full(len(cells), kind, dtype=np.uint8))
        inner = group.require_group("PointData")
        for name, values in data.items():
            self._extend(inner, name, values)
        self.data = list(data)
        for key, more in zip(_OFFSETS, (len(points), len(cells), cells.size), strict=True):
            self.offsets[key].append(begin[key])
            self.held[key] += more

    def _topology(self, group: h5py.Group, cells: AnyArray) -> None:
        self._extend(group, "NumberOfCells", np.array([len(cells)]))
        self._extend(group, "NumberOfConnectivityIds", np.array([cells.size]))
        self._extend(group, "Connectivity", cells.astype(np.int64).ravel())
        width = cells.shape[1] if cells.ndim == 2 else 1
        self._extend(group, "Offsets", np.arange(len(cells) + 1, dtype=np.int64) * width)

    @staticmethod
    def _extend(group: h5py.Group, name: str, values: AnyArray) -> None:
        if name not in group:
            group.create_dataset(
                name,
                data=values,
                maxshape=(None, *values.shape[1:]),
                chunks=(max(1, min(len(values), 16_384)), *values.shape[1:]),
                track_times=False,
            )
            return
        data = group[name]
        held = len(data)
        data.resize(held + len(values), axis=0)
        data[held:] = values

    def finish(self, times: AnyArray) -> None:
        """Write where each step begins."""
        steps = self.group.create_group("Steps")
        n = len(times)
        steps.attrs["NSteps"] = np.int64(n)
        steps["Values"] = times
        steps["PartOffsets"] = np.arange(n, dtype=np.int64)
        steps["NumberOfParts"] = np.ones(n, dtype=np.int64)
        for key, begins in self.offsets.items():
            steps[key] = np.array(begins, dtype=np.int64)
        data = steps.create_group("PointDataOffsets")
        for name in self.data:
            data[name] = np.array(self.offsets["PointOffsets"], dtype=np.int64)
