"""Quantities of one trajectory against time, and its path: each function fills one panel.

Components of very different size are drawn in panels of their own, so that a drift across the
stream is not flattened by the motion along it.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from qbxstokes.plots import style
from qbxstokes.plots.source import ResultLike, instants, samples, smooth, units, vectors
from qbxstokes.plots.style import Axes, Figure
from qbxstokes.quantities import RECORDABLE, STRESS
from qbxstokes.typing import Array

Panel = Callable[[Axes], None]

_APART = 20.0  # components whose sizes differ by more than this do not share a panel
_NOISE = 1e-10  # of the largest component: nothing but rounding
_POLE = 1e-8  # orbit constants below this, or above its inverse, are 0 or infinite but for rounding
_TRUE_SCALE = 6.0  # paths longer than this many times their width are stretched across
_CONSTANT = 1e-3  # largest relative drift of an orbit constant that counts as kept


def draw_lines(axes: Axes, times: Array, curves: Sequence[tuple[str, Array]]) -> None:
    """Named curves over time, each in its own style, the legend above them."""
    for index, (name, values) in enumerate(curves):
        look = style.line_style(index)
        if len(times) == 1:
            look |= {"marker": style.LINES[index % len(style.LINES)][2]}
        many = len(times) > style.RASTER_LIMIT
        axes.plot(times, values, label=name, rasterized=many, **look)
    axes.set_xlabel(style.label("time $t$", "tau"))
    if len(curves) > 1:
        style.legend_above(axes)


def alike(sizes: Array) -> list[list[int]]:
    """Indices of components grouped so that sizes in a group are within a factor of each other.

    Components that vanish (against the largest) go with the smallest of the others.
    """
    order = np.argsort(-sizes, kind="stable")
    groups = [[int(order[0])]]
    for index in order[1:].tolist():
        head = sizes[groups[-1][0]]
        if sizes[index] <= _NOISE * sizes[order[0]] or sizes[index] * _APART >= head:
            groups[-1].append(index)
        else:
            groups.append([index])
    return [sorted(group) for group in groups]


def panel_of(
    times: Array,
    names: Sequence[str],
    values: Array,
    label: str,
    unit: str = "",
    limits: tuple[float, float] | None = None,
) -> Panel:
    """A panel of components (T, m) against time, by names, formulas or nothing."""

    def draw(axes: Axes) -> None:
        draw_lines(axes, times, list(zip(names, values.T, strict=True)))
        if limits is not None:
            axes.set_ylim(*limits)
        style.set_ylabel(axes, label, unit)

    return draw


def formulas(symbols: Sequence[str]) -> list[str]:
    """Symbols as matplotlib sets them."""
    return [f"${symbol}$" for symbol in symbols]


def draw_quantity(axes: Axes, result: ResultLike, name: str) -> None:
    """All components of a quantity in one panel, as the file holds them."""
    times, about = instants(result), RECORDABLE[name]
    values = np.asarray(result.arrays[name]).reshape(len(times), -1)
    names = formulas(about.symbols or (about.symbol,))
    panel_of(times, names, values, about.heading, units(result, name))(axes)


def vector_panels(result: ResultLike, name: str) -> list[Panel]:
    """Panels of a vector's components; of the position, the displacement since the start.

    One of the axis, and of the Euler angles in half turns, continuous in time.
    """
    times, values = instants(result), samples(result, name, 3)
    symbol, parts = RECORDABLE[name].symbol, RECORDABLE[name].symbols
    if name == "axis":
        return [panel_of(times, formulas(parts), values, f"axis ${symbol}$", limits=(-1.08, 1.08))]
    if name == "euler_angles":
        turns = np.unwrap(values, axis=0) / np.pi
        return [panel_of(times, formulas(parts), turns, r"Euler angles$\,/\,\pi$")]
    if name == "position":
        values = values - values[0]
        symbol, parts = rf"\Delta {symbol}", tuple(rf"\Delta {part}" for part in parts)
    groups = alike(np.nanmax(np.abs(np.where(np.isfinite(values), values, np.nan)), axis=0))
    found = []
    for group in sorted(groups):
        shown = [parts[i] for i in group]
        label = f"${shown[0] if len(group) == 1 else symbol}$"
        found.append(panel_of(times, formulas(shown), values[:, group], label, units(result, name)))
    return found


def stress_panels(result: ResultLike, name: str) -> list[Panel]:
    """Panels of a symmetric tensor's normal and of its other components."""
    times, values, about = instants(result), samples(result, name, 6), RECORDABLE[name]
    names, unit = formulas(about.symbols), units(result, name)
    return [
        panel_of(times, names[part], values[:, part], about.heading, unit)
        for part in (slice(0, 3), slice(3, 6))
    ]


def constant_panels(result: ResultLike) -> list[Panel]:
    """The orbit constant, and how far it has gone from its value at the start.

    C/(1+C) is 0 for log-rolling and 1 for tumbling, where the orbit constant C itself is infinite.
    The drift is shown on a logarithmic scale where it is tiny (an error), as ln(C/C0), whose
    slope is the rate of drift, where it is not; not at all where C starts as 0 or infinite.
    """
    times, constant = instants(result), samples(result, "orbit_constant")
    finite = np.isfinite(constant)
    bounded = np.where(finite, constant / (1.0 + np.where(finite, constant, 0.0)), 1.0)

    orbit = panel_of(times, [""], bounded[:, None], "orbit $C/(1+C)$", limits=(-0.04, 1.04))
    usable = finite & (constant > 0.0)
    if not _POLE < constant[0] < 1.0 / _POLE or usable.sum() < 2:
        return [orbit]
    drift = np.full_like(constant, np.nan)
    drift[usable] = np.log(constant[usable] / constant[0])

    def draw_drift(axes: Axes) -> None:
        if np.nanmax(np.abs(drift)) > _CONSTANT:
            draw_lines(axes, times, [("", drift)])
            axes.axhline(0.0, color=style.GREY, linewidth=0.5, zorder=0)
            style.set_ylabel(axes, "drift $\\ln(C/C_0)$")
            return
        size = np.abs(np.expm1(drift))
        draw_lines(axes, times, [("", np.where(size > 0.0, size, np.nan))])
        axes.set_yscale("log")
        axes.set_ylabel("drift $|C/C_0-1|$")

    return [orbit, draw_drift]


def moves(result: ResultLike) -> bool:
    """Whether the centre goes anywhere: by more than a thousandth of the polar radius."""
    if "position" not in result.arrays:
        return False
    position = samples(result, "position", 3)
    return bool(np.nanmax(np.abs(position - position[0])) > 1e-3)


def _worth_drawing(result: ResultLike, name: str) -> bool:
    """Whether the file holds a quantity that does anything: a centre at rest has no path."""
    if name not in result.arrays:
        return False
    if name in ("force", "torque"):  # more than rounding
        return bool(np.nanmax(np.abs(samples(result, name, 3))) > 1e-9)
    return name not in ("position", "velocity") or moves(result)


def panels(result: ResultLike, names: Sequence[str]) -> list[Panel]:
    """Panels of quantities against time, as far as the file holds them and they do anything."""
    found: list[Panel] = []
    for name in names:
        if _worth_drawing(result, name):
            if name == "orbit_constant":
                found += constant_panels(result)
            elif name in STRESS:
                found += stress_panels(result, name)
            elif RECORDABLE[name].shape != (3,):
                found.append(partial(draw_quantity, result=result, name=name))
            else:
                found += vector_panels(result, name)
    return found


def stacked(drawn: Sequence[Panel]) -> Figure:
    """Panels over one time axis, one above the other."""
    figure = style.new_figure(style.COLUMN, 0.35 + 1.55 * len(drawn))
    grid = figure.add_gridspec(len(drawn), 1)
    style.letter_panels(column_of(figure, grid, 0, 0, drawn))
    return figure


def column_of(
    figure: Figure, grid: Any, column: int, first: int, contents: Sequence[Panel]
) -> list[Axes]:
    """Panels in a column of the grid from row `first` on, the time axis labelled at the last."""
    drawn: list[Axes] = []
    for index, panel in enumerate(contents):
        axes = figure.add_subplot(grid[first + index, column], sharex=drawn[0] if drawn else None)
        panel(axes)
        if index < len(contents) - 1:
            axes.set_xlabel("")
            axes.tick_params(labelbottom=False)
        drawn.append(axes)
    return drawn


def plane_of_motion(position: Array) -> tuple[int, int]:
    """The two coordinates that change most, the larger one first: stream and cross-stream."""
    spread = np.ptp(np.where(np.isfinite(position), position, position[0]), axis=0)
    first, second = np.argsort(-spread, kind="stable")[:2].tolist()
    return first, second


def label_plane(axes: Axes, result: ResultLike, along: int, across: int) -> None:
    """Name the coordinates that are drawn."""
    for name, place in (("x", along), ("y", across)):
        symbol = f"${RECORDABLE['position'].symbols[place]}$"
        axes.set(**{f"{name}label": style.label(symbol, units(result, "position"))})


def draw_path(axes: Axes, result: ResultLike) -> None:
    """The path in the plane of motion: true to scale, or said not to be where it is too long."""
    position = samples(result, "position", 3)
    along, across = plane_of_motion(position)
    x, y = smooth(instants(result), position, vectors(result, "velocity"))[:, [along, across]].T
    many = len(x) > style.RASTER_LIMIT
    axes.plot(x, y, color=style.BLUE, rasterized=many, zorder=2)
    for place, name, face in ((0, "start", "white"), (-1, "end", style.BLACK)):
        look = {"mfc": face, "mec": style.BLACK, "ms": 5, "zorder": 3, "label": name}
        axes.plot(x[place], y[place], "o", **look)
    label_plane(axes, result, along, across)
    style.legend_above(axes, handle=1.0)
    width, height = np.ptp(x), np.ptp(y)
    if width <= _TRUE_SCALE * height:
        axes.set_aspect("equal", adjustable="datalim")
    elif height <= 1e-9 * width:
        middle = 0.5 * (y.min() + y.max())
        axes.set_ylim(middle - 0.5, middle + 0.5)
    else:
        axes.set_xlabel(axes.get_xlabel() + "; not to scale")
