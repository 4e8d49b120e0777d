"""Columns against columns: curves over one of them, maps over two, bars over texts.

What is drawn is a dictionary:

    x, y     names of columns; y may be a list of columns that share an axis
    by       column, or list of columns: one curve (of a map: one panel) per value
    value    column: a map of it over x and y instead of curves
    scale    "loglog", "semilogx", "semilogy" or "linear"; chosen from the values where absent
    error    column: uncertainty of y, drawn as bars
    points   true: markers alone, not joined in the order of the rows
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from qbxstokes.errors import CaseError
from qbxstokes.plots import style
from qbxstokes.quantities import column as quantity_of_column

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

SCALES = {
    "loglog": ("log", "log"),
    "semilogx": ("log", "linear"),
    "semilogy": ("linear", "log"),
    "linear": ("linear", "linear"),
}
_CURVES = 7  # more curves than this are told apart by lightness and a colour bar
_PANELS = 6
_SPREAD = 50.0  # positive values over more than this factor are drawn on a logarithmic axis
_CONTOURS = 4  # rows and columns a map needs for contour lines


class TableLike(Protocol):
    """Named columns of equal length."""

    @property
    def names(self) -> list[str]:
        """Names of the columns."""

    def __getitem__(self, name: str) -> NDArray[Any]:
        """The column as an array."""

    def unit(self, name: str) -> str:
        """Unit of the column, "" or "1" for a pure number."""


@dataclass(frozen=True)
class _Group:
    """Rows with the same values in the columns that part a table."""

    rows: NDArray[np.intp]
    label: str
    value: float  # of the first of these columns; nan for a text


def figure_of(table: TableLike, spec: Mapping[str, Any]) -> Figure:
    """The table drawn as `spec` says.

    Raises CaseError for a column that is not there, and a text where numbers are needed.
    """
    spec = _checked(table, spec)
    parts = [_Group(np.arange(_length(table)), "", math.nan)]
    if "value" in spec and "by" in spec:
        parts = _groups(table, spec["by"], parts[0].rows)
        if len(parts) > _PANELS:
            raise CaseError(f"{len(parts)} maps by {', '.join(spec['by'])}; at most {_PANELS} fit")
    columns = min(len(parts), 3)
    rows = -(-len(parts) // columns)
    wide = style.COLUMN if columns == 1 else style.PAGE
    figure = style.new_figure(wide, rows * (2.7 if columns < 3 else 2.3))
    drawn = []
    for index, part in enumerate(parts):
        axes = figure.add_subplot(rows, columns, index + 1)
        if "value" in spec:
            draw_map(axes, table, spec, part.rows)
        else:
            draw_curves(axes, table, spec)
        if part.label:
            axes.set_title(part.label, loc="left")
        drawn.append(axes)
    style.letter_panels(drawn)
    return figure


def draw_curves(axes: Axes, table: TableLike, spec: Mapping[str, Any]) -> None:
    """Curves of y over x, one per column of y and value of `by`; bars where x is a text."""
    if table[spec["x"]].dtype.kind == "U":
        _draw_bars(axes, table, spec)
        return
    x, names = table[spec["x"]].astype(float), spec["y"]
    groups = _groups(table, spec.get("by", []), np.arange(len(x)))
    error = table[spec["error"]].astype(float) if "error" in spec else None
    shaded = len(groups) * len(names) > _CURVES
    if shaded and (len(names) > 1 or math.isnan(groups[0].value)):
        raise CaseError(
            f"{len(groups) * len(names)} curves cannot be told apart; "
            f"at most {_CURVES}, or more of one column parted by one number"
        )
    _set_scales(axes, spec, x, np.concatenate([_numbers(table, name) for name in names]))
    colours = _Shades([group.value for group in groups]) if shaded else None
    index = 0
    for name in names:
        y = _numbers(table, name)
        for group in groups:
            look = style.line_style(index, markers=True)
            if colours is not None:
                look = {"color": colours(group.value), "marker": "o", "markersize": 2}
            if spec.get("points"):
                look["linestyle"] = "none"
            words = [group.label] if group.label else []
            if len(names) > 1:
                words.insert(0, _short(name))
            rows = group.rows
            axes.plot(x[rows], y[rows], label=", ".join(words), **look)
            if error is not None:
                axes.errorbar(
                    x[rows],
                    y[rows],
                    np.abs(error[rows]),
                    fmt="none",
                    ecolor=look["color"],
                    elinewidth=0.7,
                    capsize=1.5,
                )
            index += 1
    axes.set_xlabel(_label(table, spec["x"]))
    shared = {table.unit(name) for name in names}
    if len(names) == 1:
        _label_y(axes, _words(names[0]), table.unit(names[0]))
    elif len(shared) == 1:
        _label_y(axes, _common(names), shared.pop())
    if colours is not None:
        by = spec["by"][0]
        axes.figure.colorbar(colours.mappable, ax=axes, label=_label(table, by), aspect=30)
    elif index > 1:
        longest = max(len(str(line.get_label())) for line in axes.get_lines())
        style.legend_above(axes, columns=max(1, min(4, 44 // (longest + 8))))


def draw_map(axes: Axes, table: TableLike, spec: Mapping[str, Any], rows: NDArray[np.intp]) -> None:
    """The column `value` over x and y as coloured cells with contour lines.

    All panels of one table share their colours. Cells without a value are hatched.
    """
    from matplotlib.colors import LogNorm, Normalize
    from matplotlib.patheffects import withStroke
    from matplotlib.ticker import LogLocator, MaxNLocator

    name = spec["value"]
    values = _numbers(table, name)
    x, y, grid = _pivot(table, spec["x"], spec["y"][0], values, rows)
    finite = values[np.isfinite(values)]
    if not finite.size:
        raise CaseError(f"column {name} holds no number")
    logarithmic = _is_log(finite)
    kind = LogNorm if logarithmic else Normalize
    norm = kind(float(finite.min()), float(finite.max()))
    _set_scales(axes, {k: v for k, v in spec.items() if k == "scale"}, x, y)
    edges_x, edges_y = _edges(x, axes.get_xscale()), _edges(y, axes.get_yscale())
    axes.patch.set(facecolor="#f0f0f0", hatch="////", edgecolor="#b0b0b0")
    mesh = axes.pcolormesh(
        edges_x, edges_y, np.ma.masked_invalid(grid), norm=norm, rasterized=grid.size > 4000
    )
    if min(grid.shape) >= _CONTOURS and finite.min() < finite.max():
        locator = LogLocator() if logarithmic else MaxNLocator(7)
        levels = [
            level
            for level in locator.tick_values(float(finite.min()), float(finite.max()))
            if np.nanmin(grid) < level < np.nanmax(grid)
        ]
        if levels:
            lines: Any = axes.contour(
                x, y, np.ma.masked_invalid(grid), levels, colors="white", linewidths=0.7
            )
            axes.clabel(lines, fontsize=6.5, fmt=_power if logarithmic else "%g")
            # An outline keeps white lines visible on the palest colours. Contours are one
            # artist since matplotlib 3.8, and several before.
            drawn = [lines] if hasattr(lines, "set_path_effects") else lines.collections
            for artist in (*drawn, *axes.texts):
                artist.set_path_effects([withStroke(linewidth=1.3, foreground="#00000050")])
    axes.set_xlabel(_label(table, spec["x"]))
    axes.set_ylabel(_label(table, spec["y"][0]))
    axes.set_xlim(edges_x[0], edges_x[-1])
    axes.set_ylim(edges_y[0], edges_y[-1])
    axes.figure.colorbar(mesh, ax=axes, label=_label(table, name), aspect=30)


def _checked(table: TableLike, spec: Mapping[str, Any]) -> dict[str, Any]:
    """The description with lists where lists may stand, every column in it known."""
    spec = dict(spec)
    for key in ("y", "by"):
        given = spec.get(key) or []
        spec[key] = [given] if isinstance(given, str) else list(given)
    if not spec["by"]:
        del spec["by"]
    if not isinstance(spec.get("x"), str) or not spec["y"]:
        raise CaseError("this does not say what to draw; give the columns x and y")
    text = ("x", "by") if "value" not in spec else ("by",)
    for key in ("x", "y", "by", "value", "error"):
        given = spec.get(key, [])
        for name in [given] if isinstance(given, str) else given:
            if name not in table.names:
                raise CaseError(f"no column {name!r}; there are {', '.join(table.names)}")
            if key not in text and table[name].dtype.kind not in "biuf":
                raise CaseError(f"column {name} holds texts, not numbers")
    if spec.get("scale", "linear") not in SCALES:
        raise CaseError(f"scale is one of {', '.join(SCALES)}")
    return spec


def _length(table: TableLike) -> int:
    return len(table[table.names[0]])


def _numbers(table: TableLike, name: str) -> Array:
    return np.asarray(table[name]).astype(float)


def _groups(table: TableLike, by: Sequence[str], rows: NDArray[np.intp]) -> list[_Group]:
    """Rows by the values of some columns, in the order of their first appearance."""
    if not by:
        return [_Group(rows, "", math.nan)]
    columns = [table[name] for name in by]
    found: dict[tuple[Any, ...], list[int]] = {}
    for row in rows.tolist():
        found.setdefault(tuple(column[row].item() for column in columns), []).append(row)
    groups = []
    for key, members in found.items():
        words = [_entry(table, name, value) for name, value in zip(by, key, strict=True)]
        value = float(key[0]) if not isinstance(key[0], str) and len(by) == 1 else math.nan
        groups.append(_Group(np.array(members), ", ".join(words), value))
    return groups


def _entry(table: TableLike, name: str, value: Any) -> str:
    """ "k = 0.5" for a number, the text itself for a text."""
    if isinstance(value, str):
        return value or "-"
    if isinstance(value, bool):
        return _short(name) if value else f"not {_short(name)}"
    unit = style.units_text(table.unit(name))
    return f"{_short(name)} = {value:.4g}" + (f" {unit}" if unit else "")


def _words(name: str) -> str:
    return quantity_of_column(name).heading


def _short(name: str) -> str:
    symbol = quantity_of_column(name).symbol
    return f"${symbol}$" if symbol else _words(name)


def _label(table: TableLike, name: str) -> str:
    return style.label(_words(name), table.unit(name))


def _label_y(axes: Axes, words: str, unit: str) -> None:
    if axes.get_yscale() == "log":
        axes.set_ylabel(style.label(words, unit))
    else:
        style.set_ylabel(axes, words, unit)


def _common(names: Sequence[str]) -> str:
    """The words that all of several columns end with: "error" of "force error", "torque error"."""
    texts = [_words(name).split() for name in names]
    shared: list[str] = []
    for words in zip(*(reversed(text) for text in texts), strict=False):
        if len(set(words)) > 1:
            break
        shared.insert(0, words[0])
    return " ".join(shared)


def _is_log(values: Array) -> bool:
    """Whether values are best seen on a logarithmic axis: positive, over a wide range."""
    finite = values[np.isfinite(values)]
    return bool(finite.size and finite.min() > 0.0 and finite.max() > _SPREAD * finite.min())


def _set_scales(axes: Axes, spec: Mapping[str, Any], x: Array, y: Array) -> None:
    if "scale" in spec:
        scales = SCALES[spec["scale"]]
    else:
        scales = ("log" if _is_log(x) else "linear", "log" if _is_log(y) else "linear")
    axes.set_xscale(scales[0])
    axes.set_yscale(scales[1])


def _pivot(
    table: TableLike, x: str, y: str, values: Array, rows: NDArray[np.intp]
) -> tuple[Array, Array, Array]:
    """Sorted coordinates and the values over them (len(y), len(x)), nan where there is none.

    Raises CaseError where two rows share a cell.
    """
    places_x, column = np.unique(_numbers(table, x)[rows], return_inverse=True)
    places_y, row = np.unique(_numbers(table, y)[rows], return_inverse=True)
    if len(np.unique(row * len(places_x) + column)) < len(rows):
        raise CaseError(f"several rows have the same {x} and {y}; part them with `by`")
    grid = np.full((len(places_y), len(places_x)), np.nan)
    grid[row, column] = values[rows]
    return places_x, places_y, grid


def _edges(places: Array, scale: str) -> Array:
    """Borders of cells around their centres, halfway on the scale of the axis."""
    at = np.log(places) if scale == "log" else places
    if len(at) == 1:
        half = 0.5 if scale == "log" else 0.5 * (abs(at[0]) or 1.0)
        edges = np.array([at[0] - half, at[0] + half])
    else:
        middle = 0.5 * (at[1:] + at[:-1])
        edges = np.concatenate([[2 * at[0] - middle[0]], middle, [2 * at[-1] - middle[-1]]])
    return np.exp(edges) if scale == "log" else edges


def _power(level: float) -> str:
    exponent = math.log10(level)
    return f"$10^{{{round(exponent)}}}$" if abs(exponent - round(exponent)) < 1e-9 else f"{level:g}"


class _Shades:
    """Colours of curves by a number, evenly spaced in its logarithm where it spans decades."""

    def __init__(self, values: Sequence[float]) -> None:
        from matplotlib import colormaps
        from matplotlib.cm import ScalarMappable
        from matplotlib.colors import LogNorm, Normalize

        array = np.array(values)
        kind = LogNorm if _is_log(array) else Normalize
        # The palest tenth of the colours is too light for a line on white.
        norm = kind(float(array.min()), float(array.max()))
        colours = colormaps[style.SEQUENTIAL](np.linspace(0.0, 0.9, 256))
        from matplotlib.colors import ListedColormap

        self.mappable = ScalarMappable(norm, ListedColormap(colours))

    def __call__(self, value: float) -> Any:
        """The colour of the curve for this value."""
        mappable: Any = self.mappable
        return mappable.to_rgba(value)


def _draw_bars(axes: Axes, table: TableLike, spec: Mapping[str, Any]) -> None:
    """Horizontal bars: one group per text in x, one bar per column of y (or value of `by`)."""
    texts, names = table[spec["x"]], spec["y"]
    if len(names) > 1 and "by" in spec:
        raise CaseError("bars over texts take several y or `by`, not both")
    words = list(dict.fromkeys(texts.tolist()))
    bars = [
        (group.label or _short(name), name, group.rows)
        for name in names
        for group in _groups(table, spec.get("by", []), np.arange(len(texts)))
    ]
    everything = np.concatenate([_numbers(table, name) for name in names])
    logarithmic = SCALES[spec["scale"]][1] == "log" if "scale" in spec else _is_log(everything)
    height = 0.8 / len(bars)
    for index, (name, column, rows) in enumerate(bars):
        places = np.array([words.index(text) for text in texts[rows].tolist()])
        color, _, _ = style.LINES[index % len(style.LINES)]
        axes.barh(
            places - 0.4 + (index + 0.5) * height,
            _numbers(table, column)[rows],
            0.9 * height,
            color=color,
            label=name,
        )
    axes.set_xscale("log" if logarithmic else "linear")
    axes.set_yticks(range(len(words)), words)
    axes.tick_params(axis="y", length=0)
    axes.invert_yaxis()
    units = {table.unit(name) for name in names}
    shown = _words(names[0]) if len(names) == 1 else _common(names)
    axes.set_xlabel(style.label(shown, units.pop() if len(units) == 1 else ""))
    if len(bars) > 1:
        style.legend_above(axes, columns=min(4, len(bars)))
