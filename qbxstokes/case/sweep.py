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
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray

from qbxstokes.case.base import Integer, Number, describe, to_angle, to_integer
from qbxstokes.case.model import Convert, Field, Problem, Section
from qbxstokes.case.space import (
    ORIENTATION,
    Column,
    Key,
    SweepAxis,
    SweepSpace,
    column_name,
    parse_key,
)

Array = NDArray[Any]

MAX_POINTS = 10**12
TABLE = "table"
_GENERATORS = ("linspace", "logspace", "uniform", "random")
# What a sweep cannot vary: the result is one file with one set of instants.
_FIXED = ("task", "title", "sweep", "output", "compare", "time.samples", "time.at")
# Nor this, where trajectories are integrated together.
_SHARED = ("petsc",)


def _axes(value: Any) -> Any:
    if not isinstance(value, (list, tuple)):
        raise Problem(f"is {describe(value)}", "a list of axes: `- body.aspect_ratio: [1, 2]`")
    for index, axis in enumerate(value):
        if not isinstance(axis, dict) or not axis:
            raise Problem(
                f"is {describe(axis)}", "an axis such as body.aspect_ratio: [1, 2]", (index,)
            )
    return value


def _measure(value: Any) -> Any:
    """true is a section of defaults, false none."""
    return ({} if value else None) if isinstance(value, bool) else value


class Measure(Section):
    """What is measured of each trajectory, alone: times are the medians of the repeats."""

    repeats: Annotated[Integer, Field(ge=1, le=1000)] = Field(
        default=5, description="times that each is computed, after once to warm up"
    )


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
    measure: Annotated[Measure | None, Convert(_measure, json=bool | Measure)] = Field(
        default=None,
        description="compute each trajectory alone, warm and without the cache, and record set-up "
        "and wall time, iterations and error as well; PETSc options may then be swept",
        examples=[True],
    )


class SweepFault(Exception):
    """Something wrong at `key` of the document; the loader adds file and line."""

    def __init__(self, key: Key, wrong: str, right: str = "") -> None:
        super().__init__(wrong)
        self.key, self.wrong, self.right = key, wrong, right


def build_space(axes: Sequence[Mapping[str, Any]], folder: Path, alone: bool = False) -> SweepSpace:
    """The axes of the section with their values; raises SweepFault.

    alone: each trajectory is computed by itself and may have options of its own.
    """
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
            _check_key(column, alone)
            if column.key == ORIENTATION and not column.oriented:
                raise SweepFault(
                    column.where,
                    "its values are no orientations",
                    "a list of axes [d1, d2, d3] or of quaternions, or {random: axes, count: 10}; "
                    "for angles sweep start.orientation.euler.phi and its like",
                )
            for other in seen:
                short, long = sorted((column.key, other), key=len)
                clash = long[: len(short)] == short
                forms = column.key[:2] == other[:2] == ORIENTATION and column.key[2:3] != other[2:3]
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


def _check_key(column: Column, alone: bool) -> None:
    dotted = ".".join(str(part) for part in column.key)
    for fixed in _FIXED if alone else (*_FIXED, *_SHARED):
        if dotted == fixed or dotted.startswith(fixed + "."):
            right = "sweep other keys"
            if fixed in _SHARED:
                right += ", or set sweep.measure: each trajectory is then computed alone"
            raise SweepFault(column.where, f"{fixed} is the same for all trajectories", right)


def _column(name: str, given: Any, where: Key) -> Column:
    key = parse_key(name)
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
    if key != ORIENTATION:
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
