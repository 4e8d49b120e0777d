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

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np

from qbxstokes.case.document import ORIENTATION, assigned, parse_key
from qbxstokes.case.model import Reader, Section, key, number, refined, several, some, switch, whole
from qbxstokes.case.values import Key, Problem, at, describe, gathered, to_angle, with_numbers
from qbxstokes.tables import Table, TableError, fault, read_table
from qbxstokes.typing import AnyArray

CHUNK = 4096
MAX_POINTS = 10**12
MAX_VALUES = 10**8  # that are listed or spaced, not drawn
TABLE = "table"
_FORMS = (("axis", 3), ("quaternion", 4))  # of orientations as vectors
TRAJECTORY: Key = ("flow", "trajectory")
_RULES = ("linspace", "logspace", "uniform", "random")
_ONE_OF = f"one of {', '.join(_RULES)}"
# What a sweep cannot vary: the result is one file with one set of instants.
_FIXED = ("task", "title", "sweep", "output", "compare", "time.samples", "time.at")

_MAPPING = Reader(lambda value: value if isinstance(value, dict) else {}, {"type": "object"})
AXIS = refined(_MAPPING, bool, "write body.aspect_ratio: [1, 2]", "is no axis")
AXES = refined(some(AXIS), lambda axes: len(axes) <= 16, "16 axes at most", maxItems=16)
Ends = Annotated[tuple[float, float], several(number(to_angle), "[first, last]")]
Count = Annotated[int, whole(ge=1)]


class Measure(Section):
    """What is measured of each trajectory, alone: times are the medians of the repeats."""

    repeats: Annotated[int, whole(ge=1, le=1000)] = key(
        "times that each is computed, after once to warm up", 5
    )


class Sweep(Section):
    """A family of trajectories: axes that multiply, each one or several keys side by side."""

    axes: Annotated[tuple[dict[str, Any], ...], AXES] = key(
        "list of axes: key: [values], {linspace | logspace | uniform: [a, b], count}, "
        "{random: axes | rotations, count, seed} or {table: FILE}, or table: FILE of keys",
        example=[{"body.stokes_number": {"logspace": [0.1, 1000], "count": 9}}],
    )
    store: Literal["samples", "summary", "statistics"] = key(
        "keep all samples, only the table of summaries, or only the section statistics", "samples"
    )
    block: Annotated[int, whole(ge=1, le=65_536)] = key(
        "trajectories integrated together, at most", 512
    )
    discard: Annotated[float, number(ge=0, lt=1)] = key(
        "part of the time left out of averages, from the start", 0.0
    )
    measure: Annotated[Measure | None, switch(Measure)] = key(
        "compute each trajectory alone, warm and without the cache, and record set-up "
        "and wall time, iterations and error as well; PETSc options may then be swept",
        None,
        True,
    )


# -- the space of a sweep -------------------------------------------------------------------------


@dataclass(frozen=True)
class Column:
    """The values of one key along one axis: numbers (n,), vectors (n, m), or words."""

    key: Key
    values: AnyArray | None = None
    kind: str = ""
    size: int = 0
    seed: int = 0
    bounds: tuple[float, float] = (0.0, 1.0)
    where: Key = ()
    table: Table | None = None

    def told(self, point: int) -> str:
        """Which value of the axis it is, or which line of a file, for messages."""
        if self.table is None:
            return f"value {point + 1} of the axis"
        where = f"line {self.table.lines[point]}" if self.table.lines else f"row {point + 1}"
        return f"{self.table.path}, {where}"

    def take(self, points: AnyArray) -> AnyArray:
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

    def _chunk(self, number: int) -> AnyArray:
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

    def ends(self) -> list[int]:
        """Points of its least and largest values, of vectors by their lengths; none of words."""
        if self.values is None or not self.numeric:
            return []
        size = self.values if self.values.ndim == 1 else np.linalg.norm(self.values, axis=1)
        return sorted({int(np.argmin(size)), int(np.argmax(size))})

    def extremes(self) -> list[int]:
        """Points at which a faulty value would show: all of a short axis, else the outermost."""
        if self.size <= 1000:
            return list(range(self.size))
        if self.values is None:
            return [0, self.size - 1]
        if not self.numeric:
            return [int(i) for i in np.unique(self.values, return_index=True)[1][:1000]]
        size = self.values if self.values.ndim == 1 else np.linalg.norm(self.values, axis=1)
        ends = {0, self.size - 1, *self.ends()}
        ends |= {int(i) for i in np.flatnonzero(~np.isfinite(size))[:1]}
        return sorted(ends)


@dataclass(frozen=True)
class SweepSpace:
    """All axes; trajectory `index` has the coordinates of an array element, last axis fastest."""

    axes: tuple[tuple[Column, ...], ...]

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of points of each axis."""
        return tuple(columns[0].size for columns in self.axes)

    @property
    def size(self) -> int:
        """Number of trajectories."""
        return math.prod(self.shape)

    @property
    def columns(self) -> list[tuple[int, Column]]:
        """Every column with the number of its axis."""
        return [(axis, column) for axis, columns in enumerate(self.axes) for column in columns]

    def values(self, index: AnyArray) -> dict[Key, AnyArray]:
        """The swept values of the trajectories `index` (n,)."""
        points = np.unravel_index(index, self.shape)
        return {column.key: column.take(points[axis]) for axis, column in self.columns}

    def assign(self, data: Mapping[str, Any], points: Sequence[int]) -> dict[str, Any]:
        """`data` of a case with the values at one point of every axis put in."""
        changed = dict(data)
        changed.pop("sweep", None)
        for axis, column in self.columns:
            try:
                changed = assigned(changed, column.key, column.plain(points[axis]))
            except Problem as problem:
                where = ".".join(map(str, problem.key))
                raise Problem(f"{where} {problem.wrong}", problem.right, column.where) from None
        return changed


def column_name(key: Key) -> str:
    """Name of a coordinate in results: ('body', 'stokes_number') -> stokes_number."""
    parts = [str(part + 1) if isinstance(part, int) else part for part in key]
    if parts[0] == "body" and len(parts) > 1:
        parts = parts[1:]
    if tuple(parts[:2]) == ORIENTATION and len(parts) > 2:
        parts = [parts[0], *parts[2:]]
    return "_".join(parts)


class Rule(Section):
    """Values of one key made by a rule."""

    linspace: Ends | None = key("first and last of equally spaced numbers", None)
    logspace: Ends | None = key("first and last of numbers in equal proportion", None)
    uniform: Ends | None = key("bounds of random numbers", None)
    random: Literal["axes", "rotations"] | None = key("random orientations", None)
    count: Count | None = key("number of values", None)
    seed: Annotated[int, whole(ge=0)] = key("of random values", 0)
    endpoint: bool = key("whether the last of the spaced numbers is among them", True)

    @classmethod
    def _prepare(cls, data: Any) -> Any:
        kinds = [kind for kind in _RULES if kind in data]
        if len(kinds) != 1:
            if TABLE in data:
                raise Problem("has keys beside it", "table alone", (TABLE,))
            wrong = f"names {' and '.join(kinds) or 'no rule'}"
            raise Problem(wrong, f"{_ONE_OF}, or table")
        if data.get("random", "axes") not in ("axes", "rotations"):
            wrong, right = f"is {describe(data['random'])}", "axes (on the sphere) or rotations"
            raise Problem(wrong, right, ("random",))
        return data

    def column(self, name: Key) -> Column:
        """The values of the key `name`; raises Problem."""
        if self.count is None:
            raise Problem("does not say how many values", "add count, such as count: 10")
        kind = self.random or ("uniform" if self.uniform else "")
        foreign = "endpoint" if kind else "seed"
        if foreign in self.given_keys:
            raise Problem("has no meaning for this rule", "leave it out", (foreign,))
        if self.random and name != ORIENTATION:
            wrong = "random axes and rotations are values of start.orientation"
            raise Problem(wrong, "uniform: [low, high] for numbers", ("random",))
        if kind:
            return Column(name, None, kind, self.count, self.seed, self.uniform or (0.0, 1.0))
        if self.logspace and min(self.logspace) <= 0:
            wrong = f"starts or ends at {min(self.logspace):g}"
            raise Problem(wrong, "numbers > 0", ("logspace",))
        if self.count > MAX_VALUES:
            wrong = f"makes {self.count:.3g} values, which are held in memory"
            raise Problem(wrong, f"at most {MAX_VALUES:.0e}, or uniform: [low, high]", ("count",))
        spaced: Any = np.linspace if self.linspace else np.geomspace
        ends: Any = self.linspace or self.logspace
        return Column(name, spaced(*ends, self.count, endpoint=self.endpoint), size=self.count)


def build_space(axes: Sequence[Mapping[str, Any]], folder: Path, alone: bool) -> SweepSpace:
    """The axes of the section with their values; raises Problem, with keys of the section.

    alone: each trajectory is computed by itself and may have options of its own.
    """
    built: list[tuple[Column, ...]] = []
    seen: list[Key] = []

    def columns(name: str) -> list[Column]:
        made = _columns(name, axis[name], folder)
        for column in made:
            _check_column(column, seen, alone)
            seen.append(column.key)
        return [replace(column, where=("sweep", "axes", index, name)) for column in made]

    for index, axis in enumerate(axes):
        with at("axes", index):
            together = [column for made in gathered(columns, axis) for column in made]
            if len({column.size for column in together}) > 1:
                lengths = ", ".join(f"{column_name(c.key)}: {c.size}" for c in together)
                wrong = f"its keys have different numbers of values ({lengths})"
                raise Problem(wrong, "equal numbers")
        built.append(tuple(together))
    space = SweepSpace(tuple(built))
    if space.size > MAX_POINTS:
        raise Problem(f"make {space.size} trajectories", "fewer values", ("axes",))
    return space


def _columns(name: str, given: Any, folder: Path) -> list[Column]:
    """Columns of an entry of an axis."""
    if name == TABLE:
        return _table(given, folder)
    if isinstance(given, dict):
        if set(given) == {TABLE}:
            return _of_file(parse_key(name), given[TABLE], folder)
        return [Rule.read(given).column(parse_key(name))]
    if isinstance(given, (list, tuple)) and given:
        return [_listed(parse_key(name), given)]
    wrong = f"is {describe(given)}" if given != [] else "has no values"
    raise Problem(wrong, f"a list of values, {{table: FILE}}, or {_ONE_OF} with count")


def _check_column(column: Column, seen: Sequence[Key], alone: bool) -> None:
    """Refuse keys that are the same for all, that are set already, and what is no orientation."""
    # Where trajectories are integrated together they share their options too.
    for same in _FIXED if alone else (*_FIXED, "petsc"):
        if parse_key(same) == column.key[: same.count(".") + 1]:
            right = "sweep other keys"
            if same == "petsc":
                right += ", or set sweep.measure: each trajectory is then computed alone"
            raise Problem(f"{same} is the same for all trajectories", right)
    if column.key == ORIENTATION and not column.oriented:
        raise Problem(
            "its values are no orientations",
            "a list of axes [d1, d2, d3] or of quaternions, or {random: axes, count: 10}; "
            "for angles sweep start.orientation.euler.phi and its like",
        )
    for other in seen:
        short, long = sorted((column.key, other), key=len)
        forms = column.key[:2] == other[:2] == ORIENTATION and column.key[2:3] != other[2:3]
        if forms or long[: len(short)] == short:
            wrong = f"sets what {'.'.join(map(str, other))} sets already"
            raise Problem(wrong, "every key at most once, and one form of orientation")


def _listed(name: Key, given: Sequence[Any]) -> Column:
    values = [with_numbers(value) for value in given]
    if len({len(value) if isinstance(value, list) else -1 for value in values}) > 1:
        raise Problem("mixes numbers and lists of different lengths", "one kind of value")
    flat = [entry for v in values for entry in (v if isinstance(v, list) else [v])]
    if all(type(entry) in (int, float) for entry in flat):
        return Column(name, np.array(values, dtype=np.float64), size=len(values))
    column = np.empty(len(values), dtype=object)
    column[:] = values
    return Column(name, column, size=len(values))


def _read(given: Any, folder: Path, words: bool = False) -> Table:
    if not isinstance(given, str):
        raise Problem(f"is {describe(given)}", "the name of a CSV or NPY file")
    try:
        return read_table(folder / given, words=words)
    except TableError as error:
        raise Problem(str(error), "rows of numbers, below a line of names or none") from None


def _check_numbers(column: Column, place: int) -> None:
    """Raise Problem where a column of a file, whose place it is, holds words."""
    for row, value in enumerate([] if column.numeric else column.take(np.arange(column.size))):
        if not isinstance(value, float | int):
            raise Problem(f"{column.told(row)}, column {place}: {fault(value)}", "numbers")


def _of_file(name: Key, given: Any, folder: Path) -> list[Column]:
    """Values of a key from a file: a number or a vector in each row, three Euler angles."""
    table = _read(given, folder)
    if name == ORIENTATION and "theta" in table.names:
        raise Problem(f"{table.path} holds {', '.join(table.names)}", "axes: x1, x2, x3")
    numbers, (rows, width) = np.array(table.numbers, dtype=np.float64), table.numbers.shape
    if name == (*ORIENTATION, "euler") and width == 3:
        angles = zip(("phi", "theta", "psi"), numbers.T, strict=True)
        return [Column((*name, a), v.copy(), size=rows, table=table) for a, v in angles]
    return [Column(name, numbers[:, 0] if width == 1 else numbers, size=rows, table=table)]


def _table(given: Any, folder: Path) -> list[Column]:
    """Columns of a file of rows (`tables`) whose first line names the keys."""
    table = _read(given, folder, words=True)
    keys = [parse_key(name) for name in table.names]
    if not keys or ("",) in keys or len(set(keys)) != len(keys):
        right = "a header of keys, or one key with its table, such as start.orientation: {table: .}"
        raise Problem(f"the first line of {table.path} names no distinct keys", right)
    if table.words is not None:
        made = [_listed(name, [row[i] for row in table.words]) for i, name in enumerate(keys)]
    else:
        columns = table.numbers.T.astype(np.float64)
        made = [Column(*pair, size=len(pair[1])) for pair in zip(keys, columns, strict=True)]
    found = {column.key: replace(column, table=table) for column in made}
    for form, count in _FORMS:
        parts = [(*ORIENTATION, form, i) for i in range(count)]
        if all(part in found for part in parts):
            for part in parts:
                _check_numbers(found[part], keys.index(part) + 1)
            vectors = np.stack([found.pop(part).take(np.arange(made[0].size)) for part in parts], 1)
            if ORIENTATION in found:
                raise Problem(f"{table.path} gives two forms of orientation", "one of them")
            found[ORIENTATION] = Column(ORIENTATION, vectors, size=len(vectors), table=table)
    return list(found.values())
