"""Pictures of a sweep: what its table of summaries shows over the swept values.

One swept number: curves over it. Two: curves over the longer axis, one per value of the shorter,
or a map where both are long. Random starts: points over the orbit constant they start with.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from qbxstokes.errors import CaseError
from qbxstokes.plots.columns import figure_of
from qbxstokes.plots.source import ResultLike
from qbxstokes.quantities import column as quantity_of_column

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Summaries that are drawn unasked, where they are numbers that are not all zero.
SHOWN = (
    "period",
    "rotation_rate",
    "orbit_drift",
    "mean_velocity_1",
    "mean_velocity_2",
    "mean_velocity_3",
)
# The uncertainty of a summary, from two windows of time: the same quantity's change.
CHANGES = {f"mean_velocity_{i}": f"velocity_change_{i}" for i in (1, 2, 3)}
_CURVES = 7  # values of the shorter axis up to which curves are drawn, not a map
_RANDOM = "orbit_constant_start"
_ZERO = 1e-12


class SweepLike(ResultLike, Protocol):
    """What `qbxstokes.load` returns for a sweep."""

    coordinates: list[str]

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of points of every axis of the sweep."""


class SweepTable:
    """The summaries of a sweep as a table; trajectories that failed are left out."""

    def __init__(self, sweep: SweepLike) -> None:
        """Take the table of the sweep."""
        self._table = sweep.arrays["table"]
        self._about = sweep.attributes["table"]
        self._whole = self._table["status"] == 1

    @property
    def names(self) -> list[str]:
        """Names of the columns."""
        return list(self._table.dtype.names or ())

    def __getitem__(self, name: str) -> NDArray[Any]:
        """The column of what succeeded."""
        values = self._table[name][self._whole]
        return np.char.decode(values, "ascii") if values.dtype.kind == "S" else values

    def unit(self, name: str) -> str:
        """Unit of the column."""
        unit = str(self._about.get(f"{name}: units", ""))
        return unit or quantity_of_column(name).units


def swept_axes(sweep: SweepLike) -> list[str | None]:
    """Of every axis of the sweep with more than one point, the number that tells its points.

    The first swept column that rises or falls along this axis and does not change along others;
    None where there is none (random starts, vectors, texts).
    """
    table, shape = sweep.arrays["table"], sweep.shape
    found: list[str | None] = []
    for axis, points in enumerate(shape):
        if points < 2:
            continue
        found.append(None)
        for name in sweep.coordinates:
            column = table[name]
            if column.dtype.kind not in "if" or column.size != int(np.prod(shape)):
                continue
            lines = np.moveaxis(column.reshape(shape), axis, 0).reshape(points, -1)
            steps = np.diff(lines[:, 0])
            if np.all(lines == lines[:, :1]) and (np.all(steps > 0) or np.all(steps < 0)):
                found[-1] = name
                break
    return found


def description(sweep: SweepLike, value: str) -> dict[str, Any]:
    """How the summary `value` is best drawn over the swept numbers."""
    axes = swept_axes(sweep)
    sizes = [points for points in sweep.shape if points > 1]
    numbers = sorted(
        [(size, name) for size, name in zip(sizes, axes, strict=True) if name is not None],
        key=lambda entry: -entry[0],
    )
    names = [name for _, name in numbers]
    if len(numbers) < len(axes) or not numbers:  # a random axis: points
        over = names[0] if names else _RANDOM
        return {"x": over, "y": value, "points": True}
    error = {"error": CHANGES[value]} if value in CHANGES else {}
    if len(numbers) == 1:
        return {"x": names[0], "y": value, **error}
    if len(numbers) == 2:
        if numbers[1][0] > _CURVES:
            return {"x": names[0], "y": names[1], "value": value}
        return {"x": names[0], "y": value, "by": names[1], **error}
    if np.prod([size for size, _ in numbers[1:]]) <= _CURVES:
        return {"x": names[0], "y": value, "by": names[1:], **error}
    return {"x": names[0], "y": value, "points": True}


def drawings(
    sweep: SweepLike, kinds: Sequence[str] = (), roles: dict[str, Any] | None = None
) -> dict[str, Callable[[], Figure]]:
    """Name and drawing of each summary that says something, or of those asked for.

    roles: x, y, by, value and so on instead of what the sweep suggests.
    """
    table = SweepTable(sweep)
    if not len(table["status"]):
        raise CaseError(f"{sweep.path}: no trajectory of this sweep succeeded")
    if roles:
        drawn = roles.get("value") or roles.get("y")
        name = drawn if isinstance(drawn, str) else "-".join(drawn or ["picture"])
        return {name: partial(figure_of, table, roles)}
    for kind in kinds:
        if kind not in table.names or table[kind].dtype.kind not in "if":
            numbers = [n for n in table.names if table[n].dtype.kind in "if"]
            raise CaseError(
                f"{sweep.path}: no summary {kind!r} in this sweep; there are {', '.join(numbers)}"
            )
    wanted = kinds or [name for name in SHOWN if name in table.names and _says(table[name])]
    return {name: partial(figure_of, table, description(sweep, name)) for name in wanted}


def _says(values: NDArray[Any]) -> bool:
    """Whether there are numbers, not all of them zero but for rounding."""
    finite = values[np.isfinite(values)]
    return bool(finite.size and np.abs(finite).max() > _ZERO)
