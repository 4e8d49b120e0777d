"""Pictures of an ensemble: distributions, means over paths in time, correlation of the axis."""

from functools import partial

import numpy as np

from qbxstokes.geometry.registry import SHAPE_KEYS
from qbxstokes.plots import style
from qbxstokes.plots.picture_source import ResultLike, units
from qbxstokes.plots.style import Axes, Drawings, Figure
from qbxstokes.quantities import ENSEMBLE, LOOKED_AT, column

_DRAWN = 50  # bins at least, where there are as many


def drawings(result: ResultLike) -> Drawings:
    """Kind and drawing of each picture that an ensemble calls for."""
    if result.task != "ensemble":
        return {}
    return {
        "distributions": partial(distributions_figure, result),
        "means": partial(means_figure, result),
        "correlation": partial(correlation_figure, result),
    }


def _bodies(result: ResultLike) -> list[str]:
    """What tells the bodies apart, in a legend."""
    names = [name for name in SHAPE_KEYS if name in result.arrays]
    if len(set(result.arrays["stokes_number"].tolist())) > 1:
        names.append("stokes_number")
    rows = zip(*(result.arrays[name].tolist() for name in names), strict=True)
    symbols = [column(name).symbol for name in names]
    return [
        ", ".join(f"${symbol} = {value:g}$" for symbol, value in zip(symbols, row, strict=True))
        for row in rows
    ]


def _panels(result: ResultLike) -> tuple[Figure, dict[str, Axes]]:
    """A panel for each quantity."""
    names = [name for name in LOOKED_AT if f"{name}_counts" in result.arrays]
    figure, drawn = style.panels(len(names), 3, style.PAGE, lambda rows: 0.5 + 2.0 * rows)
    return figure, dict(zip(names, drawn, strict=True))


def _finished(figure: Figure, panels: list[Axes]) -> Figure:
    style.legend_on_top(figure, panels)
    style.letter_panels(panels)
    return figure


def distributions_figure(result: ResultLike) -> Figure:
    """The density of each quantity: of rates squared over their mean, in logarithmic axes."""
    figure, panels = _panels(result)
    for name, axes in panels.items():
        counts, edges = result.arrays[f"{name}_counts"], result.arrays[f"{name}_edges"]
        width = max(1, (len(edges) - 1) // _DRAWN)  # bins that are drawn as one
        starts = np.arange(0, len(edges) - 1, width)
        edges = edges[np.append(starts, len(edges) - 1)]
        share = np.add.reduceat(counts[:, 1:-1], starts, axis=1)
        density = share / counts.sum(axis=1, keepdims=True) / np.diff(edges)
        symbol, rate = LOOKED_AT[name].symbol, not name.startswith("cos")
        for index, text in enumerate(_bodies(result)):
            mean = float(result.arrays[f"{name}_moments"][index, 0]) if rate else 1.0
            middle = np.sqrt(edges[1:] * edges[:-1]) if rate else 0.5 * (edges[1:] + edges[:-1])
            seen = density[index] > 0.0
            look = style.line_style(index)
            axes.plot(middle[seen] / mean, density[index][seen] * mean, label=text, **look)
        if rate:
            axes.set_xscale("log")
            axes.set_yscale("log")
            symbol = rf"{symbol}/\langle {symbol}\rangle"
        else:
            axes.set_ylim(bottom=0.0)
        axes.set_xlabel(f"${symbol}$")
    style.set_ylabel(next(iter(panels.values())), "density")
    return _finished(figure, list(panels.values()))


def means_figure(result: ResultLike) -> Figure:
    """Means over paths against time, within twice their standard errors."""
    figure, panels = _panels(result)
    times, paths = result.arrays["time"], int(result.summary["paths"])
    for name, axes in panels.items():
        means, spread = result.arrays[f"{name}_in_time"], result.arrays[f"{name}_spread_in_time"]
        error = 2.0 * spread / np.sqrt(max(paths, 1))
        for index, text in enumerate(_bodies(result)):
            look = style.line_style(index)
            axes.plot(times, means[:, index], label=text, **look)
            low, high = means[:, index] - error[:, index], means[:, index] + error[:, index]
            axes.fill_between(times, low, high, color=look["color"], alpha=0.25, linewidth=0)
        axes.set_xlabel(style.label(f"time ${ENSEMBLE['time'].symbol}$", units(result, "time")))
        unit = units(result, f"{name}_in_time")
        style.set_ylabel(axes, rf"$\langle {LOOKED_AT[name].symbol}\rangle$", unit)
    return _finished(figure, list(panels.values()))


def correlation_figure(result: ResultLike) -> Figure:
    """The axis's correlation against the lag."""
    figure = style.new_figure(style.COLUMN, 2.6)
    axes = figure.subplots()
    for index, text in enumerate(_bodies(result)):
        values = result.arrays["correlation"][:, index]
        axes.plot(result.arrays["lag"], values, label=text, **style.line_style(index))
    axes.set_xlabel(style.label(rf"lag ${ENSEMBLE['lag'].symbol}$", units(result, "lag")))
    style.set_ylabel(axes, rf"${ENSEMBLE['correlation'].symbol}$")
    style.legend_above(axes)
    return figure
