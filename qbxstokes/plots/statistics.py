"""Many rows as few: averages with bands, and histograms, of the columns of a sweep."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from qbxstokes.errors import CaseError
from qbxstokes.plots import style
from qbxstokes.plots.columns import Columns, groups_of, label_of
from qbxstokes.plots.scales import is_log
from qbxstokes.plots.style import Axes, Figure
from qbxstokes.typing import AnyArray

# Which number stands for many, how far its band reaches, and what the picture says of both.
_AVERAGES = {"mean": "mean and standard deviation", "median": "median, 10 to 90 %"}


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


def histogram_figure(columns: Columns, names: Sequence[str], by: Sequence[str]) -> Figure:
    """How often each value of the columns occurs: a panel each, an outline per value of `by`.

    Shares of what is finite, in bins by Freedman and Diaconis of all groups together, of the
    logarithm where the values span decades. What is not finite is counted in the legend. Raises
    CaseError where no number is finite.
    """
    groups = groups_of(columns, by)
    if len(groups) > len(style.LINES):
        raise CaseError(
            f"{columns.name}: {len(groups)} histograms cannot be told apart; at most "
            f"{len(style.LINES)}"
        )
    figure, panels = style.panels(len(names), 1, style.COLUMN, lambda rows: 2.5 * rows)
    for axes, name in zip(panels, names, strict=True):
        _draw_histogram(axes, columns, name, groups)
    if any(str(part.get_label()) for part in panels[0].patches):
        style.legend_above(panels[0], columns=min(3, len(groups)))
    style.letter_panels(panels)
    return figure


def _draw_histogram(axes: Axes, columns: Columns, name: str, groups: Sequence[Any]) -> None:
    values = columns.numbers(name)
    finite = values[np.isfinite(values)]
    if not finite.size:
        raise CaseError(f"{columns.name}: column {name} holds no number to count")
    logarithmic = is_log(finite) and float(finite.min()) > 0.0
    edges = _edges(np.log10(finite) if logarithmic else finite, len(groups))
    edges = 10.0**edges if logarithmic else edges
    for index, group in enumerate(groups):
        own = values[group.rows]
        known = own[np.isfinite(own)]
        lost = len(own) - len(known)
        words = [group.label, f"{lost} not finite" if lost else ""]
        shares = np.histogram(known, edges)[0] / max(len(known), 1)
        axes.stairs(shares, edges, label=", ".join(filter(None, words)), **style.line_style(index))
        if len(groups) == 1:
            axes.stairs(shares, edges, fill=True, color=style.PALE_BLUE, zorder=0.5)
    axes.set_xscale("log" if logarithmic else "linear")
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel(label_of(columns, name))
    style.set_ylabel(axes, f"share of {finite.size} values" if len(groups) == 1 else "share")


def _edges(values: AnyArray, groups: int) -> AnyArray:
    """Ends of bins of values, at most 60; as if they were so many times fewer as there are groups.

    Values that differ by rounding alone are one bin.
    """
    middle, span = float(np.median(values)), float(np.ptp(values))
    if span <= 1e-9 * float(np.abs(values).max()):
        half = 0.5 * (abs(middle) or 1.0)
        return np.array([middle - half, middle + half])
    low, high = np.quantile(values, (0.25, 0.75))
    width = 2.0 * float(high - low) * (groups / len(values)) ** (1.0 / 3.0)
    bins = int(np.clip(math.ceil(span / width), 1, 60)) if width > 0.0 else 30
    return np.linspace(float(values.min()), float(values.max()), bins + 1)
