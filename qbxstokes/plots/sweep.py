"""Pictures of a sweep: any column of its table over any other, or what the table suggests.

Of a measured sweep that is the error over the time it took. Of any other, summaries over the swept
values. One swept number: curves over it. Two: curves over the longer axis, one per value of the
shorter, or a map where both are long. Random starts beside these: averages over them, with bands.
Random starts alone: points over the orbit constant they start with, and axes on the sphere.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, Protocol

import numpy as np

from qbxstokes.errors import CaseError
from qbxstokes.geometry import rotation
from qbxstokes.plots.charts import CURVES, figure_of, histogram_figure
from qbxstokes.plots.columns import Columns, averaged
from qbxstokes.plots.source import ResultLike, resolved_case
from qbxstokes.plots.sphere import distribution_figure
from qbxstokes.plots.style import Drawings, Figure
from qbxstokes.typing import Indices

# Summaries that are drawn unasked, where they are numbers that are not all zero.
SHOWN = (
    "period",
    "rotation_rate",
    "orbit_drift",
    "mean_velocity_1",
    "mean_velocity_2",
    "mean_velocity_3",
    *(f"resistance_translation_{direction}" for direction in ("transverse", "axial")),
    *(f"resistance_rotation_{direction}" for direction in ("transverse", "axial")),
    "linear",
    "error",
    "gap",
)
# The uncertainty of a summary, from two windows of time: the same quantity's change.
CHANGES = {f"mean_velocity_{i}": f"velocity_change_{i}" for i in (1, 2, 3)}
_RANDOM = "orbit_constant_start"
_ZERO = 1e-12
ORIENTATIONS = "orientations"
_CLOUD = 20  # trajectories of random starts whose axes are worth a picture


class SweepLike(ResultLike, Protocol):
    """What `qbxstokes.load` returns for a sweep."""

    @property
    def coordinates(self) -> list[str]:
        """Names of the swept columns."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of points of every axis of the sweep."""


class _Axis:
    """An axis of the sweep with more than one point: its columns, those that are words, a number.

    number: the first column that rises or falls along the axis, None where there is none (random
    starts, vectors, words). random: whether its values are.
    """

    def __init__(self, sweep: SweepLike, axis: int) -> None:
        rules = (resolved_case(sweep).get("sweep") or {}).get("axes") or [{}] * len(sweep.shape)
        made = [rule for rule in rules[axis].values() if isinstance(rule, dict)]
        self.random = any("random" in rule or "uniform" in rule for rule in made)
        table, shape = sweep.arrays["table"], sweep.shape
        self.axis, self.size = axis, shape[axis]
        self.columns: list[str] = []
        self.words: list[str] = []
        self.number: str | None = None
        for name in sweep.coordinates:
            values = table[name]
            lines = np.moveaxis(values.reshape(shape), axis, 0).reshape(self.size, -1)
            if np.any(lines != lines[:, :1]) or np.all(lines == lines[0]):
                continue
            self.columns.append(name)
            if values.dtype.kind not in "if":
                self.words.append(name)
            elif self.number is None and not self.random:  # a few of these may rise by chance
                steps = np.diff(lines[:, 0])
                if np.all(steps > 0) or np.all(steps < 0):
                    self.number = name

    @property
    def parting(self) -> list[str]:
        """Columns that tell its points apart in a legend; none of random ones."""
        if self.random:
            return []
        return [self.number] if self.number is not None else self.words or self.columns


def swept_axes(sweep: SweepLike) -> list[_Axis]:
    """The axes of a sweep that have more than one point."""
    return [_Axis(sweep, axis) for axis, points in enumerate(sweep.shape) if points > 1]


def columns_of(sweep: SweepLike) -> Columns:
    """The table of the sweep; trajectories that failed are left out.

    Raises CaseError where none is left.
    """
    table, about = sweep.arrays["table"], sweep.attributes["table"]
    whole = np.flatnonzero(table["status"] == 1)
    if not len(whole):
        raise CaseError(f"{sweep.path}: no trajectory of this sweep succeeded")
    numbers = [axis.axis for axis in swept_axes(sweep) if axis.number is not None]

    def joined(rows: Indices) -> bool:
        """Whether rows follow one another along one axis of numbers."""
        places = np.array(np.unravel_index(whole[rows], sweep.shape))
        varying = np.flatnonzero(np.any(places != places[:, :1], axis=1))
        return len(varying) == 0 or (len(varying) == 1 and varying[0] in numbers)

    values = {}
    for name in table.dtype.names or ():
        column = table[name][whole]
        values[name] = np.char.decode(column, "ascii") if column.dtype.kind == "S" else column
    units = {name: str(about.get(f"{name}: units", "")) for name in values}
    return Columns(str(sweep.path), values, units, joined)


def description(sweep: SweepLike, value: str) -> dict[str, Any]:
    """How the summary `value` is best drawn over the swept numbers."""
    axes = swept_axes(sweep)
    numbers = sorted((axis for axis in axes if axis.number), key=lambda axis: -axis.size)
    names = [str(axis.number) for axis in numbers]
    words = [axis for axis in axes if not axis.number and axis.words]
    if not numbers and len(words) == len(axes) == 1:
        return {"x": words[0].words[0], "y": value}
    if not numbers:  # random starts alone: points
        return {"x": _RANDOM, "y": value, "points": True}
    error: dict[str, Any] = {"error": CHANGES[value]} if value in CHANGES else {}
    if len(numbers) + len(words) < len(axes):  # over a random axis
        error = {"average": "median"}
    if len(names) == 2 and numbers[1].size > CURVES and not words:
        over = {"average": "mean"} if "average" in error else {}
        return {"x": names[0], "y": names[1], "value": value, **over}
    return {"x": names[0], "y": value, "by": parted(axes, names[0]), **error}


def parted(axes: Sequence[_Axis], x: str) -> list[str]:
    """Columns that part the rows into curves over x, as far as so many can be told apart.

    A curve runs along the axis of x, or else along that of a tolerance, or the longest of numbers.
    """

    def suits(axis: _Axis) -> tuple[bool, bool, int]:
        return x in axis.columns, str(axis.number).endswith("tolerance"), axis.size

    along = max((axis for axis in axes if axis.number), key=suits, default=None)
    by, curves = [], 1
    for axis in axes:
        curves *= 1 if axis is along else axis.size
        if axis is not along and curves <= CURVES:
            by += axis.parting
    return by


def drawings(
    sweep: SweepLike, kinds: Sequence[str] = (), roles: Mapping[str, Any] | None = None
) -> Drawings:
    """Name and drawing of each picture: those asked for, or those that say something.

    roles: x, y, by, value and scale instead of what the sweep suggests.
    """
    columns = columns_of(sweep)
    if roles:
        return _asked(sweep, columns, roles)
    for kind in kinds:
        if kind != ORIENTATIONS and (kind not in columns.values or columns.words(kind)):
            raise CaseError(
                f"{sweep.path}: no summary {kind!r} in this sweep; {columns.near(kind)}"
            )
    if not kinds and (measured := _measured(sweep, columns)):
        return measured
    wanted = kinds or [name for name in SHOWN if name in columns.values and _says(columns, name)]
    found: Drawings = {
        name: partial(_figure, columns, description(sweep, name))
        for name in wanted
        if name != ORIENTATIONS
    }
    random = any(axis.number is None and not axis.words for axis in swept_axes(sweep))
    many = random and len(columns.everything) >= _CLOUD and "final_orientation_0" in columns.values
    if ORIENTATIONS in kinds or (many and not kinds):
        found[ORIENTATIONS] = partial(orientations, sweep)
    if not found:
        right = "--x and --y draw columns of its table, --trajectory N a motion"
        raise CaseError(f"{sweep.path}: no summary calls for a picture; {right}")
    return found


def _figure(columns: Columns, spec: Mapping[str, Any]) -> Figure:
    """The columns as `spec` says, averaged where it asks for that."""
    return figure_of(*averaged(columns, spec)) if "average" in spec else figure_of(columns, spec)


def orientations(sweep: SweepLike) -> Figure:
    """Where the axes of all trajectories start and end, on the sphere."""
    table = sweep.arrays["table"]
    done = table["status"] == 1
    if "axis" in sweep.arrays:
        axes = sweep.arrays["axis"][done]
        return distribution_figure({"start": axes[:, 0], "end": axes[:, -1]})
    names = [f"final_orientation_{i}" for i in range(4)]
    if names[0] not in (table.dtype.names or ()):
        raise CaseError(f"{sweep.path}: its table has no orientations")
    q = np.stack([table[name][done] for name in names], axis=-1)
    return distribution_figure({"end": rotation.axis(q)})


def _asked(sweep: SweepLike, columns: Columns, roles: Mapping[str, Any]) -> Drawings:
    """The one picture that the roles tell of, completed where they leave something open."""
    spec = dict(roles)
    if counted := spec.pop("histogram", None):
        if set(spec) - {"by"}:
            raise CaseError(f"{sweep.path}: --histogram goes with --by alone")
        name = f"histogram-{'-'.join(counted)}"
        return {name: partial(histogram_figure, columns, counted, spec.get("by") or ())}
    drawn = spec.get("value") or spec.get("y")
    if not drawn:
        raise CaseError(f"{sweep.path}: say which column to draw with --y, or --value for a map")
    names = [drawn] if isinstance(drawn, str) else list(drawn)
    for name in names:
        columns.numbers(name)
    if "x" not in spec:
        spec = description(sweep, names[0]) | spec
    if "by" not in spec and "value" not in spec and not columns.words(spec["x"]):
        axes = swept_axes(sweep)
        spec["by"] = parted(axes, spec["x"])
        if spec["x"] in [axis.number for axis in axes] and any(axis.random for axis in axes):
            spec.setdefault("average", "median")
    if roles.get("by") and "average" not in roles:
        spec.pop("average", None)  # rows that are parted need none
    return {"-".join(names): partial(_figure, columns, spec)}


def _measured(sweep: SweepLike, columns: Columns) -> Drawings:
    """Of a measured sweep the error over the time; nothing where there is no error."""
    section = resolved_case(sweep).get("sweep") or {}
    time = "wall_time" if "wall_time" in columns.values else "setup_time"
    if not section.get("measure") or not np.isfinite(columns["error"]).any():
        return {}
    spec: dict[str, Any] = {"x": time, "y": "error", "by": parted(swept_axes(sweep), time)}
    if np.nanmin(columns["error"]) > 0.0:
        spec["scale"] = "loglog"
    return {"error": partial(figure_of, columns, spec)}


def _says(columns: Columns, name: str) -> bool:
    """Whether there are numbers, not all of them zero but for rounding, which errors may be."""
    values = columns[name]
    finite = np.abs(values[np.isfinite(values)])
    return bool(finite.size and finite.max() > (0.0 if name == "error" else _ZERO))
