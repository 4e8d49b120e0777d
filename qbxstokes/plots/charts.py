"""Columns as pictures: curves over another, maps over two, bars over words, histograms.

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

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from qbxstokes.errors import CaseError
from qbxstokes.plots import style
from qbxstokes.plots.columns import Columns, Group, groups_of, label_of, short_of
from qbxstokes.plots.style import Axes, Figure
from qbxstokes.typing import AnyArray, Indices

CURVES = 7  # more curves than this are told apart by lightness and a colour bar
_PANELS = 6
_CONTOURS = 4  # rows and columns a map needs for contour lines
_SAME = 1e-7  # relative differences of values that are one value
SCALES = {
    "loglog": ("log", "log"),
    "semilogx": ("log", "linear"),
    "semilogy": ("linear", "log"),
    "linear": ("linear", "linear"),
}
_SPREAD = 50.0  # positive values over more than this factor are drawn on a logarithmic axis


def figure_of(columns: Columns, spec: Mapping[str, Any]) -> Figure:
    """The columns as `spec` says; raises CaseError for what is not there, or no number."""
    spec = _checked(columns, spec)
    parts = [Group(columns.everything, "", math.nan)]
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


def _told(columns: Columns, names: Sequence[str], name: str, group: Group) -> str:
    """What a legend says: the column, where there are several, and the group."""
    words = [short_of(columns, name) if len(names) > 1 else "", group.label]
    return ", ".join(word for word in words if word)


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


# -- histograms ----------------------------------------------------------------------------------


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
    edges = bins_of(np.log10(finite) if logarithmic else finite, len(groups))
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


def bins_of(values: AnyArray, groups: int) -> AnyArray:
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


# -- scales of axes and colours, and the cells of maps ---------------------------------------------


def is_log(values: AnyArray) -> bool:
    """Whether values are best seen on a logarithmic axis: none negative, over a wide range."""
    finite = values[np.isfinite(values)]
    positive = finite[finite > 0.0]
    wide = bool(positive.size and positive.max() > _SPREAD * positive.min())
    return wide and 2 * positive.size > finite.size and not np.any(finite < 0.0)


def set_scales(axes: Axes, spec: Mapping[str, Any], x: AnyArray, y: AnyArray) -> None:
    """Scales of both axes: those of the description, or what suits the values."""
    chosen = ["log" if is_log(values) else "linear" for values in (x, y)]
    scale_x, scale_y = SCALES[spec["scale"]] if "scale" in spec else chosen
    axes.set_xscale(scale_x)
    axes.set_yscale(scale_y)


def edges(places: AnyArray, scale: str) -> AnyArray:
    """Borders of cells around their centres, halfway on the scale of the axis."""
    at = np.log(places) if scale == "log" else places
    if len(at) == 1:
        half = 0.5 if scale == "log" else 0.5 * (abs(at[0]) or 1.0)
        edges = np.array([at[0] - half, at[0] + half])
    else:
        middle = 0.5 * (at[1:] + at[:-1])
        edges = np.concatenate([[2 * at[0] - middle[0]], middle, [2 * at[-1] - middle[-1]]])
    return np.exp(edges) if scale == "log" else edges


def power(level: float) -> str:
    """A level of contour lines on a logarithmic scale."""
    exponent = math.log10(level)
    return f"$10^{{{round(exponent)}}}$" if abs(exponent - round(exponent)) < 1e-9 else f"{level:g}"


def shades(values: Sequence[float]) -> Any:
    """Colours of curves by a number, evenly spaced in its logarithm where it spans decades."""
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import ListedColormap

    # The palest tenth of the colours is too light for a line on white.
    colours = colormaps[style.SEQUENTIAL](np.linspace(0.0, 0.9, 256))
    return ScalarMappable(colours_of(np.array(values))[0], ListedColormap(colours))


def colours_of(values: AnyArray) -> tuple[Any, bool]:
    """How values become colours, and whether by their logarithm."""
    from matplotlib.colors import LogNorm, Normalize

    low, high = float(values.min()), float(values.max())
    logarithmic = is_log(values) and low > 0.0
    return (LogNorm if logarithmic else Normalize)(low, high), logarithmic
