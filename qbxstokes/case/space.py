"""The space of a sweep: axes of swept values, and the case at any point of them."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
Key = tuple[str | int, ...]

CHUNK = 4096
ORIENTATION = ("start", "orientation")


@dataclass(frozen=True)
class Column:
    """The values of one key along one axis: numbers (n,), vectors (n, m), or words."""

    key: Key
    where: Key
    values: Array | None = None
    kind: str = ""
    size: int = 0
    seed: int = 0
    bounds: tuple[float, float] = (0.0, 1.0)

    def take(self, points: Array) -> Array:
        """Values at the given points of the axis."""
        if self.values is not None:
            return np.asarray(self.values[points])
        width = {"axes": (3,), "rotations": (4,)}.get(self.kind, ())
        taken = np.empty((len(points), *width))
        chunks = points // CHUNK
        for chunk in np.unique(chunks):
            inside = chunks == chunk
            taken[inside] = self._chunk(int(chunk))[points[inside] - chunk * CHUNK]
        return taken

    def _chunk(self, number: int) -> Array:
        """CHUNK random values; each chunk has a generator of its own."""
        generator = np.random.default_rng([self.seed, number])
        if self.kind == "uniform":
            return generator.uniform(*self.bounds, size=CHUNK)
        # A normal vector has no preferred direction: uniform on the sphere S2 or S3.
        width = 3 if self.kind == "axes" else 4
        vectors = generator.standard_normal((CHUNK, width))
        return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))

    def plain(self, point: int) -> Any:
        """The value at one point as plain data for the case."""
        value = self.take(np.array([point]))[0]
        if self.key == ORIENTATION:
            return {"axis" if len(value) == 3 else "quaternion": value.tolist()}
        return value.tolist() if isinstance(value, (np.ndarray, np.generic)) else value

    @property
    def oriented(self) -> bool:
        """Whether the values are vectors of three or four numbers."""
        return self.numeric and self.take(np.zeros(1, dtype=int)).shape[1:] in ((3,), (4,))

    @property
    def numeric(self) -> bool:
        """Whether the values are numbers or vectors of numbers."""
        return self.values is None or self.values.dtype.kind == "f"

    def extremes(self) -> list[int]:
        """Points at which a faulty value would show: all of a short axis, else the outermost."""
        if self.size <= 1000:
            return list(range(self.size))
        if self.values is None:
            return [0, self.size - 1]
        if not self.numeric:
            return [int(i) for i in np.unique(self.values, return_index=True)[1][:1000]]
        size = self.values if self.values.ndim == 1 else np.linalg.norm(self.values, axis=1)
        ends = {0, self.size - 1, int(np.argmin(size)), int(np.argmax(size))}
        ends |= {int(i) for i in np.flatnonzero(~np.isfinite(size))[:1]}
        return sorted(ends)


@dataclass(frozen=True)
class SweepAxis:
    """Columns that run side by side."""

    columns: tuple[Column, ...]
    size: int
    where: Key


@dataclass(frozen=True)
class SweepSpace:
    """All axes; trajectory `index` has the coordinates of an array element, last axis fastest."""

    axes: tuple[SweepAxis, ...]
    shape: tuple[int, ...] = field(default=())

    @property
    def size(self) -> int:
        """Number of trajectories."""
        return math.prod(self.shape)

    @property
    def columns(self) -> list[tuple[int, Column]]:
        """Every column with the number of its axis."""
        return [(number, c) for number, axis in enumerate(self.axes) for c in axis.columns]

    def values(self, index: Array) -> dict[Key, Array]:
        """The swept values of the trajectories `index` (n,)."""
        points = np.unravel_index(index, self.shape)
        return {column.key: column.take(points[axis]) for axis, column in self.columns}

    def assign(self, data: Mapping[str, Any], points: Sequence[int]) -> dict[str, Any]:
        """`data` of a case with the values at one point of every axis put in."""
        changed = dict(data)
        changed.pop("sweep", None)
        for axis, column in self.columns:
            changed = assigned(changed, column.key, column.plain(points[axis]))
        return changed


def assigned(data: Any, key: Key, value: Any) -> Any:
    """A copy of nested plain data with `key` set; what is not on the way is shared."""
    if not key:
        return value
    part = key[0]
    if isinstance(part, int):
        listed = list(data) if isinstance(data, (list, tuple)) else [0.0] * 3
        listed[part] = assigned(listed[part], key[1:], value)
        return listed
    copied = dict(data) if isinstance(data, dict) else {}
    inner = copied.get(part)
    if part == "orientation" and len(key) > 1 and isinstance(inner, dict):
        # The forms of an orientation exclude each other: the swept one replaces the case's.
        inner = {form: entry for form, entry in inner.items() if form == key[1]}
    copied[part] = assigned(inner, key[1:], value)
    return copied


_INDEX = re.compile("[0-9]{1,9}\\Z")


def parse_key(text: str) -> Key:
    """'start.position[1]' or 'start.position.1' -> ('start', 'position', 1)."""
    parts = text.strip().replace("[", ".").replace("]", "").split(".")
    return tuple(int(part) if _INDEX.match(part) else part for part in parts)


def column_name(key: Key) -> str:
    """Name of a coordinate in results: ('body', 'stokes_number') -> stokes_number."""
    parts = [str(part + 1) if isinstance(part, int) else part for part in key]
    if parts[0] == "body" and len(parts) > 1:
        parts = parts[1:]
    if tuple(parts[:2]) == ORIENTATION and len(parts) > 2:
        parts = [parts[0], *parts[2:]]
    return "_".join(parts)
