"""Pictures of many particles: distributions and means of an ensemble, a suspension's rheology."""

from functools import partial
from typing import Any

import numpy as np

from qbxstokes.errors import ResultFileError
from qbxstokes.geometry.registry import SHAPE_KEYS
from qbxstokes.plots import style
from qbxstokes.plots.source import ResultLike, units
from qbxstokes.plots.sphere import draw_frame
from qbxstokes.plots.style import Axes, Drawings, Figure
from qbxstokes.quantities import ENSEMBLE, LOOKED_AT, RHEOLOGY, STRAIN_TIME, column
from qbxstokes.typing import Array

_DRAWN = 50  # bins at least, where there are as many
_FUNCTIONS = (
    "intrinsic_viscosity",
    "first_normal_stress_difference",
    "second_normal_stress_difference",
)
_MOST_MAPS = 9


def drawings(result: ResultLike) -> Drawings:
    """Kind and drawing of each picture that an ensemble or a suspension calls for."""
    if result.task == "ensemble":
        return {
            "distributions": partial(distributions_figure, result),
            "means": partial(means_figure, result),
            "correlation": partial(correlation_figure, result),
        }
    if result.task != "rheology":
        return {}
    found: Drawings = {"material-functions": partial(functions_figure, result)}
    if "strain" in result.arrays:
        found["lissajous"] = partial(lissajous_figure, result)
    if "distribution" in result.arrays:
        found["distribution"] = partial(maps_figure, result)
    return found


# -- ensembles ---------------------------------------------------------------------------------


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
            style.draw_curve(axes, index, middle[seen] / mean, density[index][seen] * mean, text)
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
            style.draw_curve(axes, index, times, means[:, index], text, error[:, index])
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
        style.draw_curve(axes, index, result.arrays["lag"], values, text)
    axes.set_xlabel(style.label(rf"lag ${ENSEMBLE['lag'].symbol}$", units(result, "lag")))
    style.set_ylabel(axes, rf"${ENSEMBLE['correlation'].symbol}$")
    style.legend_above(axes)
    return figure


# -- rheology ----------------------------------------------------------------------------------


def functions_figure(result: ResultLike) -> Figure:
    """Material functions against the Peclet number, of a transient against time."""
    numbers = _numbers(result, "peclet_number")
    names = [name for name in _FUNCTIONS if np.isfinite(_numbers(result, name)).any()]
    figure = style.new_figure(style.COLUMN, 0.4 + 1.5 * len(names))
    panels: list[Axes] = list(np.atleast_1d(figure.subplots(len(names), 1, sharex=True)))
    times = _numbers(result, "time") if "time" in result.arrays else None
    for axes, name in zip(panels, names, strict=True):
        values = _numbers(result, name)
        error = np.zeros_like(values)  # of means over trajectories alone
        if f"{name}_standard_error" in result.arrays:
            error = _numbers(result, f"{name}_standard_error")
        if times is None:
            _over_peclet(axes, numbers, values)
            if error.any():
                axes.errorbar(numbers, values, error, fmt="none", color=style.BLACK)
        else:
            for index, number in enumerate(numbers.tolist()):
                around = error[index] if error[index].any() else None
                style.draw_curve(axes, index, times, values[index], _peclet(number), around)
        heading = RHEOLOGY[name].heading
        style.set_ylabel(axes, f"${RHEOLOGY[name].symbol}$" if len(names) > 1 else heading)
    if len(numbers) > 1 and (times is not None or np.isinf(numbers).any()):
        style.legend_above(panels[0], columns=min(3, len(numbers)))
    panels[-1].set_xlabel(
        RHEOLOGY["peclet_number"].heading if times is None else f"time ${STRAIN_TIME.symbol}$"
    )
    style.letter_panels(panels)
    return figure


def _over_peclet(axes: Axes, numbers: Array, values: Array) -> None:
    """A curve with a logarithmic abscissa, and a line for what is without Brownian motion."""
    order = np.argsort(numbers)
    finite = order[np.isfinite(numbers[order])]
    if len(finite):
        axes.semilogx(numbers[finite], values[finite], **style.line_style(0, markers=True))
    for index in order[len(finite) :].tolist():
        line = {"color": style.GREY, "linestyle": (0, (4, 2))}
        axes.axhline(values[index], label=_peclet(numbers[index]), **line)


def lissajous_figure(result: ResultLike) -> Figure:
    """Stress against strain and against strain rate over a cycle, for each Peclet number."""
    strain, rate = _numbers(result, "strain"), _numbers(result, "strain_rate")
    values, numbers = _numbers(result, "intrinsic_viscosity"), _numbers(result, "peclet_number")
    figure = style.new_figure(style.PAGE, 2.9)
    panels = list(figure.subplots(1, 2, sharey=True))
    for index, number in enumerate(numbers.tolist()):
        for axes, abscissa in zip(panels, (strain, rate), strict=True):
            style.draw_curve(axes, index, abscissa, values[index], _peclet(number))
    panels[0].set_xlabel(rf"strain ${RHEOLOGY['strain'].symbol}$")
    panels[1].set_xlabel(rf"strain rate ${RHEOLOGY['strain_rate'].symbol}$ over its amplitude")
    style.set_ylabel(panels[0], "stress over volume fraction and rate's amplitude")
    style.legend_above(panels[0])
    style.letter_panels(panels)
    return figure


def maps_figure(result: ResultLike) -> Figure:
    """Densities of orientations in the azimuthal equal-area map of both halves of the sphere.

    An axis and its opposite are the same orientation, so that the half around e3 holds all; the
    map is seen from e3, e1 to the right, e2 upwards.
    """
    density, numbers = _numbers(result, "distribution"), _numbers(result, "peclet_number")
    theta, phi = _numbers(result, "theta"), _numbers(result, "phi")
    shown = [i for i in range(len(numbers)) if np.isfinite(density[i]).all()][:_MOST_MAPS]
    wide = len(shown) > 1
    figure, panels = style.panels(
        len(shown),
        3,
        style.PAGE if wide else style.COLUMN,
        lambda rows: 0.3 + rows * (2.05 if wide else 2.9),
    )
    upper = theta <= 0.5 * np.pi + 1e-12
    radius, around = np.sqrt(2.0) * np.sin(0.5 * theta[upper]), np.append(phi, 2.0 * np.pi)
    x, y = np.outer(radius, np.cos(around)), np.outer(radius, np.sin(around))
    for axes, index in zip(panels, shown, strict=True):
        values = density[index][upper]
        values = np.concatenate([values, values[:, :1]], axis=1)
        mesh = axes.pcolormesh(x, y, values, shading="gouraud", rasterized=True)
        draw_frame(axes, (90,), "e")
        axes.set_title(_peclet(float(numbers[index])), loc="left")
        bar = figure.colorbar(mesh, cax=axes.inset_axes((1.04, 0.1, 0.04, 0.8)))
        bar.set_label(rf"density ${RHEOLOGY['distribution'].symbol}$")
    return figure


def _peclet(number: float) -> str:
    return rf"$\mathrm{{Pe}} = {number:g}$" if np.isfinite(number) else r"$\mathrm{Pe} = \infty$"


def _numbers(result: ResultLike, name: str) -> Array:
    """Dataset `name`; raises ResultFileError where it is missing or holds no numbers."""
    values: Any = result.arrays.get(name)
    if values is None or np.asarray(values).dtype.kind not in "fiu":
        raise ResultFileError(f"{result.path}: holds no numbers as {name}")
    return np.asarray(values, dtype=np.float64)
