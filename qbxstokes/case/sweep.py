"""Section `sweep`: which keys of the case vary, and over which values.

`axes` is a list; the axes multiply, and the keys named in one axis run side by side (zip):

    sweep:
      axes:
        - body.aspect_ratio: [0.2, 0.5, 2, 5]
        - body.stokes_number: {logspace: [0.1, 1000], count: 9}
          time.end: {linspace: [50, 500], count: 9}
        - start.orientation: {random: rotations, count: 100, seed: 7}

Trajectories are numbered like the elements of an array with one dimension per axis, the last axis
fastest. Values are made in pieces as they are needed: the points of a random axis come from
independent generators, one per 4096, so that any piece of a long sweep is made on its own.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray

from qbxstokes.case.base import Integer, Number, describe, to_angle, to_integer
from qbxstokes.case.model import Convert, Field, Problem, Section

Array = NDArray[Any]
Key = tuple[str | int, ...]

MAX_POINTS = 10**12
CHUNK = 4096
TABLE = "table"
_GENERATORS = ("linspace", "logspace", "uniform", "random")
_ORIENTATION = ("start", "orientation")
# What a sweep cannot vary: the result is one file with one set of instants and one set of options.
_FIXED = ("task", "title", "sweep", "output", "compare", "petsc", "time.samples", "time.at")


def _axes(value: Any) -> Any:
    if not isinstance(value, (list, tuple)):
        raise Problem(f"is {describe(value)}", "a list of axes: `- body.aspect_ratio: [1, 2]`")
    for index, axis in enumerate(value):
        if not isinstance(axis, dict) or not axis:
            raise Problem(
                f"is {describe(axis)}", "an axis such as body.aspect_ratio: [1, 2]", (index,)
            )
    return value


class Sweep(Section):
    """A family of trajectories: axes that multiply, each one or several keys side by side."""

    axes: Annotated[
        tuple[dict[str, Any], ...], Convert(_axes), Field(min_length=1, max_length=16)
    ] = Field(
        description="list of axes: key: [values], {linspace | logspace | uniform: [a, b], count}, "
        "{random: axes | rotations, count, seed}, or table: FILE.csv",
        examples=[[{"body.stokes_number": {"logspace": [0.1, 1000], "count": 9}}]],
    )
    store: Literal["samples", "summary"] = Field(
        default="samples", description="keep all samples, or only the table of summaries"
    )
    block: Annotated[Integer, Field(ge=1, le=65_536)] = Field(
        default=512, description="trajectories integrated together, at most"
    )
    discard: Annotated[Number, Field(ge=0, lt=1)] = Field(
        default=0.0, description="part of the time left out of averages, from the start"
    )


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
        if self.key == _ORIENTATION:
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
    if tuple(parts[:2]) == _ORIENTATION and len(parts) > 2:
        parts = [parts[0], *parts[2:]]
    return "_".join(parts)


class SweepFault(Exception):
    """Something wrong at `key` of the document; the loader adds file and line."""

    def __init__(self, key: Key, wrong: str, right: str = "") -> None:
        super().__init__(wrong)
        self.key, self.wrong, self.right = key, wrong, right


def build_space(axes: Sequence[Mapping[str, Any]], folder: Path) -> SweepSpace:
    """The axes of the section with their values; raises SweepFault."""
    built: list[SweepAxis] = []
    seen: dict[Key, Key] = {}
    for number, axis in enumerate(axes):
        where: Key = ("sweep", "axes", number)
        columns: list[Column] = []
        for name, given in axis.items():
            if name == TABLE:
                columns += _table(given, folder, (*where, name))
            else:
                columns.append(_column(name, given, (*where, name)))
        sizes = {column.size for column in columns}
        if len(sizes) > 1:
            lengths = ", ".join(f"{column_name(c.key)}: {c.size}" for c in columns)
            raise SweepFault(
                where, f"its keys have different numbers of values ({lengths})", "equal numbers"
            )
        for column in columns:
            if column.key == _ORIENTATION and not column.oriented:
                raise SweepFault(
                    column.where,
                    "its values are no orientations",
                    "a list of axes [d1, d2, d3] or of quaternions, or {random: axes, count: 10}; "
                    "for angles sweep start.orientation.euler.phi and its like",
                )
            for other in seen:
                short, long = sorted((column.key, other), key=len)
                clash = long[: len(short)] == short
                forms = (
                    column.key[:2] == other[:2] == _ORIENTATION and column.key[2:3] != other[2:3]
                )
                if clash or forms:
                    raise SweepFault(
                        column.where,
                        f"sets what {'.'.join(map(str, other))} sets already",
                        "every key at most once, and one form of orientation",
                    )
            seen[column.key] = column.where
        built.append(SweepAxis(tuple(columns), sizes.pop(), where))
    shape = tuple(axis.size for axis in built)
    if math.prod(shape) > MAX_POINTS:
        raise SweepFault(("sweep", "axes"), f"make {math.prod(shape)} trajectories", "fewer values")
    return SweepSpace(tuple(built), shape)


def _check_key(key: Key, where: Key) -> None:
    dotted = ".".join(str(part) for part in key)
    for fixed in _FIXED:
        if dotted == fixed or dotted.startswith(fixed + "."):
            raise SweepFault(where, f"{fixed} is the same for all trajectories", "sweep other keys")


def _column(name: str, given: Any, where: Key) -> Column:
    key = parse_key(name)
    _check_key(key, where)
    if isinstance(given, (list, tuple)):
        if not given:
            raise SweepFault(where, "has no values", "at least one")
        return _listed(key, given, where)
    if isinstance(given, dict):
        return _generated(key, given, where)
    raise SweepFault(
        where,
        f"is {describe(given)}",
        f"a list of values, or one of {', '.join(_GENERATORS)} with count",
    )


def _listed(key: Key, given: Sequence[Any], where: Key) -> Column:
    plain = [_number_or_same(value) for value in given]
    widths = {len(v) if isinstance(v, list) else 0 for v in plain}
    if len(widths) > 1:
        raise SweepFault(where, "mixes numbers and lists of different lengths", "one kind of value")
    flat = [entry for v in plain for entry in (v if isinstance(v, list) else [v])]
    if all(type(entry) in (int, float) for entry in flat):
        values: Array = np.array(plain, dtype=np.float64)
    else:
        values = np.empty(len(plain), dtype=object)
        values[:] = plain
    return Column(key, where, values, size=len(plain))


def _number_or_same(value: Any) -> Any:
    """'90 deg' and '1/50' as numbers; words, lists of such, and everything else as it is."""
    if value in ("inf", ".inf"):
        return math.inf  # tumbling, as an orbit constant
    if isinstance(value, str):
        try:
            return to_angle(value)
        except Problem:
            return value
    if isinstance(value, list):
        return [_number_or_same(entry) for entry in value]
    return value


def _generated(key: Key, given: Mapping[str, Any], where: Key) -> Column:
    kinds = [kind for kind in _GENERATORS if kind in given]
    if len(kinds) != 1:
        raise SweepFault(
            where, f"names {' and '.join(kinds) or 'no rule'}", f"one of {', '.join(_GENERATORS)}"
        )
    kind = kinds[0]
    known = {kind, "count"} | ({"seed"} if kind in ("uniform", "random") else {"endpoint"})
    for name in given:
        if name not in known:
            raise SweepFault(
                (*where, name), "unknown key", f"known here: {', '.join(sorted(known))}"
            )
    if "count" not in given:
        raise SweepFault(where, "does not say how many values", "add count, such as count: 10")
    count = _integer(given["count"], (*where, "count"), 1)
    seed = _integer(given.get("seed", 0), (*where, "seed"), 0)
    if kind == "random":
        return _random(key, given[kind], count, seed, where)
    ends = given[kind]
    if not isinstance(ends, (list, tuple)) or len(ends) != 2:
        raise SweepFault((*where, kind), f"is {describe(ends)}", "two numbers: first and last")
    pair = []
    for index, end in enumerate(ends):
        try:
            pair.append(to_angle(end))
        except Problem as error:
            raise SweepFault((*where, kind, index), str(error).split(";")[0], "a number") from None
    if kind == "uniform":
        return Column(key, where, None, "uniform", count, seed, (pair[0], pair[1]))
    endpoint = given.get("endpoint", True)
    if not isinstance(endpoint, bool):
        raise SweepFault((*where, "endpoint"), f"is {describe(endpoint)}", "true or false")
    if kind == "logspace":
        if not min(pair) > 0:
            raise SweepFault((*where, kind), f"starts or ends at {min(pair):g}", "numbers > 0")
        values = np.geomspace(pair[0], pair[1], count, endpoint=endpoint)
    else:
        values = np.linspace(pair[0], pair[1], count, endpoint=endpoint)
    return Column(key, where, values, size=count)


def _random(key: Key, kind: Any, count: int, seed: int, where: Key) -> Column:
    if key != _ORIENTATION:
        raise SweepFault(
            (*where, "random"),
            "random axes and rotations are values of start.orientation",
            "uniform: [low, high] for numbers",
        )
    if kind not in ("axes", "rotations"):
        raise SweepFault(
            (*where, "random"), f"is {describe(kind)}", "axes (on the sphere) or rotations"
        )
    return Column(key, where, None, kind, count, seed)


def _integer(value: Any, where: Key, least: int) -> int:
    try:
        number = to_integer(value)
    except Problem as error:
        raise SweepFault(where, str(error).split(";")[0], "a whole number") from None
    if number < least:
        raise SweepFault(where, f"is {number}", f"must be >= {least}")
    return number


def _table(given: Any, folder: Path, where: Key) -> list[Column]:
    """Columns of a CSV file whose first line names the keys."""
    if not isinstance(given, str):
        raise SweepFault(where, f"is {describe(given)}", "the name of a CSV file")
    path = folder / given
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            header = next(csv.reader(stream), [])
            body = stream.read()
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise SweepFault(where, f"{path} cannot be read ({error})", "a CSV text file") from None
    names = [name.strip() for name in header]
    if not names or not all(names) or len(set(names)) != len(names):
        raise SweepFault(where, f"the first line of {path} names no distinct keys", "a header")
    keys = [parse_key(name) for name in names]
    for key in keys:
        _check_key(key, where)
    lines = body.splitlines()
    try:
        numbers = np.loadtxt(lines, delimiter=",", ndmin=2) if any(lines) else np.empty((0, 0))
        if numbers.shape[1] != len(names):
            raise ValueError
        columns: list[Array] = list(numbers.T)
    except ValueError:
        columns = _words(lines, names, path, where)
    if not len(columns[0]):
        raise SweepFault(where, f"{path} has no rows below its header", "at least one")
    return [
        Column(key, where, np.ascontiguousarray(values), size=len(values))
        for key, values in zip(keys, columns, strict=True)
    ]


def _words(lines: Sequence[str], names: Sequence[str], path: Path, where: Key) -> list[Array]:
    """Columns of a table that is not made of plain numbers alone."""
    rows = []
    for number, row in enumerate(csv.reader(lines), start=2):
        if not row or row[0].startswith("#"):
            continue
        if len(row) != len(names):
            raise SweepFault(
                where, f"line {number} of {path} has {len(row)} entries", f"{len(names)} entries"
            )
        rows.append([_number_or_same(_cell(entry.strip())) for entry in row])
    columns: list[Array] = []
    for values in zip(*rows, strict=True):
        if all(isinstance(value, float) for value in values):
            columns.append(np.array(values))
        else:
            column: Array = np.empty(len(values), dtype=object)
            column[:] = values
            columns.append(column)
    return columns or [np.empty(0)]


def _cell(text: str) -> Any:
    try:
        return float(text)
    except ValueError:
        return text
