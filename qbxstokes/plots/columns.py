"""Named columns of a table: numbers, units and names, rows in groups, and averages of rows."""

import difflib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby
from typing import Any

import numpy as np

from qbxstokes.errors import CaseError
from qbxstokes.plots import style
from qbxstokes.quantities import column
from qbxstokes.quantity import Quantity
from qbxstokes.typing import AnyArray, Array, Indices

_UNSET, _DEFAULT = "null", "default"  # words that are not set, and what a legend says of them
# Which number stands for many, how far its band reaches, and what the picture says of both.
_AVERAGES = {"mean": "mean and standard deviation", "median": "median, 10 to 90 %"}


@dataclass(frozen=True)
class Columns:
    """Columns of equal length, numbers or words.

    name: what messages call it. units: as the file states them. joined: whether rows follow one
    another along a curve.
    """

    name: str
    values: Mapping[str, AnyArray]
    units: Mapping[str, str] = field(default_factory=dict)
    joined: Callable[[Indices], bool] = lambda _: True

    @property
    def everything(self) -> Indices:
        """All rows."""
        return np.arange(len(next(iter(self.values.values()))))

    def words(self, name: str) -> bool:
        """Whether a column holds words."""
        return self[name].dtype.kind == "U"

    def numbers(self, name: str) -> Array:
        """A column of numbers. Raises CaseError for another."""
        if self.words(name):
            raise CaseError(f"{self.name}: column {name} holds texts, not numbers")
        return self[name].astype(float)

    def about(self, name: str) -> Quantity:
        """What a column is, with the units that the file states."""
        known = column(name)
        return replace(known, units=self.units.get(name) or known.units)

    def __getitem__(self, name: str) -> AnyArray:
        """A column by its name. Raises CaseError, which names those that are near."""
        if name in self.values:
            return self.values[name]
        raise CaseError(f"{self.name}: no column {name!r}; {self.near(name)}")

    def near(self, name: str) -> str:
        """What a message says of a name that is not there: those that are like it, or all."""
        there = list(self.values)
        parts = set(name.lower().split("_"))
        near = difflib.get_close_matches(name.lower(), there, 3, 0.6)
        near += [other for other in there if parts & set(other.split("_")) and other not in near]
        return f"did you mean {', '.join(near[:5])}?" if near else f"there are {', '.join(there)}"


@dataclass(frozen=True)
class Group:
    """Rows with the same values in the columns that part them."""

    rows: Indices
    label: str
    value: float  # of the first of these columns; nan for a word


def groups_of(columns: Columns, by: Sequence[str]) -> list[Group]:
    """Rows by the values of some columns, in the order of their first appearance."""
    if not by:
        return [Group(columns.everything, "", math.nan)]
    found: dict[tuple[Any, ...], list[int]] = {}
    for row in columns.everything.tolist():
        found.setdefault(tuple(columns[name][row].item() for name in by), []).append(row)
    groups = []
    for key, members in found.items():
        words = [value for value in key if isinstance(value, str)]
        told = [_DEFAULT] if words and set(words) == {_UNSET} else []
        pairs = [pair for pair in zip(by, key, strict=True) if pair[1] != _UNSET]
        for stem, parts in groupby(pairs, lambda pair: pair[0].rstrip("0123456789")):
            entries = list(parts)
            if len(entries) > 1 and stem.endswith("_"):  # components of one vector
                vector = ", ".join(_number(value) for _, value in entries)
                told.append(f"{stem.replace('_', ' ').strip()} = ({vector})")
            else:
                told += [_entry(columns, name, value) for name, value in entries]
        value = float(key[0]) if len(by) == 1 and not words else math.nan
        groups.append(Group(np.array(members), ", ".join(told), value))
    return groups


def _entry(columns: Columns, name: str, value: Any) -> str:
    """ "k = 0.5" for a number, the word itself."""
    if isinstance(value, str):
        return value
    told = f"{short_of(columns, name)} = {_number(value)}"
    return f"{told} {style.units_text(columns.about(name).units)}".rstrip()


def _number(value: float) -> str:
    """A number with four digits, powers of ten written as such."""
    if value == 0.0 or 1e-3 <= abs(value) < 1e4:
        return f"{value:.4g}"
    if not math.isfinite(value):
        return r"$\infty$" if value > 0.0 else f"{value:g}"
    digits, power = f"{value:.3e}".split("e")
    factor = "" if float(digits) == 1.0 else rf"{float(digits):g}\times "
    return f"${factor}10^{{{int(power)}}}$"


def short_of(columns: Columns, name: str) -> str:
    """A symbol, or words, for a column."""
    about = columns.about(name)
    return f"${about.symbol}$" if about.symbol else about.heading


def label_of(columns: Columns, name: str) -> str:
    """What stands at an axis of a column."""
    about = columns.about(name)
    return style.label(about.heading, about.units)


def averaged(columns: Columns, spec: Mapping[str, Any]) -> tuple[Columns, dict[str, Any]]:
    """Rows that share x and by (of a map: x, y and by) as one: values, the ends of bands, and spec.

    spec["average"] is mean or median. What is not finite is left out of it.
    Raises CaseError for another word.
    """
    spec = dict(spec)
    average = spec.pop("average")
    if average not in _AVERAGES:
        raise CaseError(f"{columns.name}: average is one of {', '.join(_AVERAGES)}")
    names = [spec["value"]] if "value" in spec else _list(spec["y"])
    apart = list(dict.fromkeys([spec["x"], *_list(spec.get("by")), *_list(spec["y"])]))
    apart = [name for name in apart if name not in names]
    groups = sorted(
        groups_of(columns, apart), key=lambda group: columns[spec["x"]][group.rows[0]].item()
    )
    first = np.array([group.rows[0] for group in groups])
    found: dict[str, AnyArray] = {name: columns[name][first] for name in apart}
    for name in names:
        values = columns.numbers(name)
        rows = [_spread(values[group.rows], average) for group in groups]
        ends = name, f"{name} lower", f"{name} upper"
        found |= dict(zip(ends, np.array(rows).T, strict=True))
    counts = [len(group.rows) for group in groups]
    many = f"{min(counts)}" + (f" to {max(counts)}" if max(counts) > min(counts) else "")
    text = _AVERAGES[average] if "value" not in spec else average
    spec |= {"note": f"{text} of {many}", "band": "value" not in spec}
    spec.pop("error", None)
    units = {name: columns.units.get(name, "") for name in found}
    return Columns(columns.name, found, units), spec


def _list(given: Any) -> list[str]:
    return [given] if isinstance(given, str) else list(given or ())


def _spread(values: AnyArray, average: str) -> tuple[float, float, float]:
    """An average of what is finite, and the ends of its band."""
    values = values[np.isfinite(values)]
    if not values.size:
        return math.nan, math.nan, math.nan
    if average == "median":
        low, middle, high = np.quantile(values, (0.1, 0.5, 0.9))
        return float(middle), float(low), float(high)
    mean, spread = float(values.mean()), float(values.std())
    return mean, mean - spread, mean + spread
