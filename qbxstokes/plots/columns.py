"""Named columns as pictures: curves of some over another, maps over two, bars over words.

What is drawn is told by a mapping:

    x, y     names of columns; y may be a list of columns that share an axis
    by       list of columns: one curve (of a map: one panel) per value
    value    column: a map of it over x and y instead of curves
    scale    "loglog", "semilogx", "semilogy" or "linear"; chosen from the values where absent
    error    column: uncertainty of y, drawn as bars
    points   true: markers alone, where the order of the rows means nothing
    band     true: columns "y lower" and "y upper" are the ends of a band around y
    note     what is said below the name of y, or of value
"""

import difflib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby
from typing import Any

import numpy as np

from qbxstokes.errors import CaseError
from qbxstokes.plots import style
from qbxstokes.plots.scales import SCALES, colours_of, edges, is_log, power, set_scales, shades
from qbxstokes.plots.style import Axes, Figure
from qbxstokes.quantities import column
from qbxstokes.quantity import Quantity
from qbxstokes.typing import AnyArray, Array, Indices

CURVES = 7  # more curves than this are told apart by lightness and a colour bar
_PANELS = 6
_UNSET, _DEFAULT = "null", "default"  # words that are not set, and what a legend says of them
_CONTOURS = 4  # rows and columns a map needs for contour lines
_SAME = 1e-7  # relative differences of values that are one value


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
class _Group:
    """Rows with the same values in the columns that part them."""

    rows: Indices
    label: str
    value: float  # of the first of these columns; nan for a word


def figure_of(columns: Columns, spec: Mapping[str, Any]) -> Figure:
    """The columns as `spec` says; raises CaseError for what is not there, or no number."""
    spec = _checked(columns, spec)
    parts = [_Group(columns.everything, "", math.nan)]
    if "value" in spec:
        parts = groups_of(columns, spec["by"])
        if len(parts) > _PANELS:
            by = ", ".join(spec["by"])
            raise CaseError(f"{columns.name}: {len(parts)} maps by {by}; at most {_PANELS} fit")
    across = min(len(parts), 3)
    width, height = style.COLUMN if across == 1 else style.PAGE, 2.7 if across < 3 else 2.3
    figure, panels = style.panels(len(parts), 3, width, lambda rows: rows * height)
    for axes, part in zip(panels, parts, strict=True):
        if "value" in spec:
            _draw_map(axes, columns, spec, part.rows)
        elif columns.words(spec["x"]):
            _draw_bars(axes, columns, spec)
        else:
            _draw_curves(axes, columns, spec)
        if part.label:
            axes.set_title(part.label, loc="left")
    style.letter_panels(panels)
    return figure


def _checked(columns: Columns, spec: Mapping[str, Any]) -> dict[str, Any]:
    """The description with lists where lists may stand, every name in it known."""
    spec = dict(spec)
    for key in ("y", "by"):
        given = spec.get(key) or []
        spec[key] = [given] if isinstance(given, str) else list(given)
    if not spec.get("x") or not spec["y"]:
        raise CaseError(f"{columns.name}: this does not say what to draw; give the columns x and y")
    numbers = [*spec["y"], *(spec[key] for key in ("value", "error") if key in spec)]
    for name in numbers if "value" not in spec else [*numbers, spec["x"]]:
        columns.numbers(name)
    for name in (spec["x"], *spec["by"]):
        columns[name]
    if spec.get("scale", "linear") not in SCALES:
        raise CaseError(f"{columns.name}: scale is one of {', '.join(SCALES)}")
    return spec


def _draw_curves(axes: Axes, columns: Columns, spec: Mapping[str, Any]) -> None:
    """Curves of y over x, one per column of y and value of `by`."""
    x, names = columns.numbers(spec["x"]), spec["y"]
    groups = groups_of(columns, spec["by"])
    error = columns.numbers(spec["error"]) if "error" in spec else None
    shaded = len(groups) * len(names) > CURVES
    if shaded and (len(names) > 1 or math.isnan(groups[0].value)):
        raise CaseError(
            f"{columns.name}: {len(groups) * len(names)} curves cannot be told apart; "
            f"at most {CURVES}, or more of one column parted by one number"
        )
    set_scales(axes, spec, x, np.concatenate([columns.numbers(name) for name in names]))
    colours = shades([group.value for group in groups]) if shaded else None
    drawn = [(name, group) for name in names for group in groups]
    for index, (name, group) in enumerate(drawn):
        y, rows = columns.numbers(name), group.rows
        look = style.line_style(index, markers=True)
        if colours is not None:
            look = {"color": colours.to_rgba(group.value), "marker": "o", "markersize": 2}
        if spec.get("points") or not columns.joined(rows):
            look["linestyle"] = "none"
        axes.plot(x[rows], y[rows], label=_told(columns, names, name, group), **look)
        if spec.get("band"):
            low, high = (columns[f"{name} {end}"][rows] for end in ("lower", "upper"))
            axes.fill_between(x[rows], low, high, color=look["color"], alpha=0.18, linewidth=0)
        if error is not None:
            bars = {"fmt": "none", "ecolor": look["color"], "elinewidth": 0.7, "capsize": 1.5}
            axes.errorbar(x[rows], y[rows], np.abs(error[rows]), **bars)
    axes.set_xlabel(label_of(columns, spec["x"]))
    words, units = _shared(columns, names)
    if axes.get_yscale() == "log":
        axes.set_ylabel(style.label(words, units))
    else:
        _widen(axes, np.concatenate([columns.numbers(name) for name in names]))
        style.set_ylabel(axes, words, units)
    if "note" in spec:
        axes.set_ylabel(f"{axes.get_ylabel()}\n{spec['note']}")
    if colours is not None:
        label = label_of(columns, spec["by"][0])
        axes.figure.colorbar(colours, ax=axes, label=label, aspect=30)
    elif len(drawn) > 1:
        longest = max(len(str(line.get_label())) for line in axes.get_lines())
        style.legend_above(axes, columns=max(1, min(4, 44 // (longest + 8))))


def _widen(axes: Axes, values: AnyArray) -> None:
    """Show what is constant but for an error as constant: a hundredth of it is the least height."""
    finite = values[np.isfinite(values)]
    size = float(np.abs(finite).max(initial=0.0))
    if finite.size and np.ptp(finite) < _SAME * size:
        axes.set_ylim(float(finite.mean()) - 0.01 * size, float(finite.mean()) + 0.01 * size)


def _draw_bars(axes: Axes, columns: Columns, spec: Mapping[str, Any]) -> None:
    """Horizontal bars: one group per word in x, one bar per column of y and value of `by`."""
    words, names = columns[spec["x"]], spec["y"]
    places = list(dict.fromkeys(words.tolist()))
    bars = [(name, group) for name in names for group in groups_of(columns, spec["by"])]
    everything = np.concatenate([columns.numbers(name) for name in names])
    logarithmic = SCALES[spec["scale"]][1] == "log" if "scale" in spec else is_log(everything)
    height = 0.8 / len(bars)
    for index, (name, group) in enumerate(bars):
        at = np.array([places.index(word) for word in words[group.rows].tolist()])
        axes.barh(
            at - 0.4 + (index + 0.5) * height,
            columns.numbers(name)[group.rows],
            0.9 * height,
            color=style.LINES[index % len(style.LINES)][0],
            label=_told(columns, names, name, group),
        )
    axes.set_xscale("log" if logarithmic else "linear")
    axes.set_yticks(range(len(places)), places)
    axes.tick_params(axis="y", length=0)
    axes.invert_yaxis()
    axes.set_xlabel(style.label(*_shared(columns, names)))
    if len(bars) > 1:
        style.legend_above(axes, columns=min(4, len(bars)))


def _draw_map(axes: Axes, columns: Columns, spec: Mapping[str, Any], rows: Indices) -> None:
    """The column `value` over x and y as coloured cells with contour lines.

    All panels share their colours. Cells without a value are hatched.
    """
    from matplotlib.patheffects import withStroke
    from matplotlib.ticker import LogLocator, MaxNLocator

    name = spec["value"]
    values = columns.numbers(name)
    x, y, grid = _pivot(columns, spec["x"], spec["y"][0], values, rows)
    finite = values[np.isfinite(values)]
    if not finite.size:
        raise CaseError(f"{columns.name}: column {name} holds no number")
    norm, logarithmic = colours_of(finite)
    set_scales(axes, spec, x, y)
    edges_x, edges_y = edges(x, axes.get_xscale()), edges(y, axes.get_yscale())
    axes.patch.set(facecolor="#f0f0f0", hatch="////", edgecolor="#b0b0b0")
    cells = np.ma.masked_invalid(grid)
    mesh = axes.pcolormesh(edges_x, edges_y, cells, norm=norm, rasterized=grid.size > 4000)
    if min(grid.shape) >= _CONTOURS and finite.min() < finite.max():
        locator = LogLocator() if logarithmic else MaxNLocator(7)
        ticks = locator.tick_values(float(finite.min()), float(finite.max()))
        levels = [level for level in ticks if np.nanmin(grid) < level < np.nanmax(grid)]
        if levels:
            lines: Any = axes.contour(x, y, cells, levels, colors="white", linewidths=0.7)
            axes.clabel(lines, fontsize=6.5, fmt=power if logarithmic else "%g")
            # An outline keeps white lines visible on the palest colours. Contours are one
            # artist since matplotlib 3.8, and several before.
            drawn = [lines] if hasattr(lines, "set_path_effects") else lines.collections
            for artist in (*drawn, *axes.texts):
                artist.set_path_effects([withStroke(linewidth=1.3, foreground="#00000050")])
    axes.set_xlabel(label_of(columns, spec["x"]))
    axes.set_ylabel(label_of(columns, spec["y"][0]))
    told_below = [label_of(columns, name), *([spec["note"]] if "note" in spec else [])]
    axes.set_xlim(edges_x[0], edges_x[-1])
    axes.set_ylim(edges_y[0], edges_y[-1])
    axes.figure.colorbar(mesh, ax=axes, label="\n".join(told_below), aspect=30)


# -- groups and labels ------------------------------------------------------------------------


def groups_of(columns: Columns, by: Sequence[str]) -> list[_Group]:
    """Rows by the values of some columns, in the order of their first appearance."""
    if not by:
        return [_Group(columns.everything, "", math.nan)]
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
        groups.append(_Group(np.array(members), ", ".join(told), value))
    return groups


def _told(columns: Columns, names: Sequence[str], name: str, group: _Group) -> str:
    """What a legend says: the column, where there are several, and the group."""
    words = [_short(columns, name) if len(names) > 1 else "", group.label]
    return ", ".join(word for word in words if word)


def _entry(columns: Columns, name: str, value: Any) -> str:
    """ "k = 0.5" for a number, the word itself."""
    if isinstance(value, str):
        return value
    told = f"{_short(columns, name)} = {_number(value)}"
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


def _short(columns: Columns, name: str) -> str:
    about = columns.about(name)
    return f"${about.symbol}$" if about.symbol else about.heading


def label_of(columns: Columns, name: str) -> str:
    """What stands at an axis of a column."""
    about = columns.about(name)
    return style.label(about.heading, about.units)


def _shared(columns: Columns, names: Sequence[str]) -> tuple[str, str]:
    """Words and units that several columns share: those that their headings begin or end with."""
    texts = [columns.about(name).heading.split() for name in names]
    units = {columns.about(name).units for name in names}
    if len(texts) == 1:
        return " ".join(texts[0]), units.pop()
    common = []
    for turn in (1, -1):
        shared = []
        for words in zip(*(text[::turn] for text in texts), strict=False):
            if len(set(words)) > 1:
                break
            shared.append(words[0])
        common.append(" ".join(shared[::turn]))
    return max(common, key=len), units.pop() if len(units) == 1 else ""


def _pivot(
    columns: Columns, x: str, y: str, values: AnyArray, rows: Indices
) -> tuple[AnyArray, AnyArray, AnyArray]:
    """Sorted coordinates and the values over them (len(y), len(x)), nan where there is none.

    Raises CaseError where two rows share a cell.
    """
    places_x, across = np.unique(columns.numbers(x)[rows], return_inverse=True)
    places_y, down = np.unique(columns.numbers(y)[rows], return_inverse=True)
    if len(np.unique(down * len(places_x) + across)) < len(rows):
        raise CaseError(
            f"{columns.name}: several rows have the same {x} and {y}; part "
            "them by one, or average them (--average mean)"
        )
    grid = np.full((len(places_y), len(places_x)), np.nan)
    grid[down, across] = values[rows]
    return places_x, places_y, grid
