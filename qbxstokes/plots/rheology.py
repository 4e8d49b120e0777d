"""Pictures of a dilute suspension: material functions, Lissajous curves, maps of orientations."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from qbxstokes.errors import ResultFileError
from qbxstokes.plots import style
from qbxstokes.plots.picture_source import ResultLike
from qbxstokes.quantities import RHEOLOGY, STRAIN_TIME
from qbxstokes.typing import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_FUNCTIONS = (
    "intrinsic_viscosity",
    "first_normal_stress_difference",
    "second_normal_stress_difference",
)
_MOST_MAPS = 9
KINDS = {
    "material-functions": "intrinsic viscosity and normal stress differences",
    "lissajous": "stress of an oscillation over strain and strain rate",
    "distribution": "densities of orientations, as maps on the sphere",
}


def drawings(result: ResultLike) -> dict[str, Callable[[], Figure]]:
    """Kind and drawing of each picture that the result of a suspension calls for."""
    if result.task != "rheology":
        return {}
    found: dict[str, Callable[[], Figure]] = {
        "material-functions": lambda: functions_figure(result)
    }
    if "strain" in result.arrays:
        found["lissajous"] = lambda: lissajous_figure(result)
    if "distribution" in result.arrays:
        found["distribution"] = lambda: maps_figure(result)
    return found


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
                look, own, around = style.line_style(index), values[index], error[index]
                (line,) = axes.plot(times, own, label=_peclet(number), **look)
                if around.any():
                    shade = {"color": line.get_color(), "alpha": 0.25, "linewidth": 0}
                    axes.fill_between(times, own - around, own + around, **shade)
        heading = RHEOLOGY[name].heading
        style.set_ylabel(axes, f"${RHEOLOGY[name].symbol}$" if len(names) > 1 else heading)
    if times is not None and len(numbers) > 1:
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
        axes.axhline(values[index], color=style.GREY, linestyle=(0, (4, 2)))


def lissajous_figure(result: ResultLike) -> Figure:
    """Stress against strain and against strain rate over a cycle, for each Peclet number."""
    strain, rate = _numbers(result, "strain"), _numbers(result, "strain_rate")
    values, numbers = _numbers(result, "intrinsic_viscosity"), _numbers(result, "peclet_number")
    figure = style.new_figure(style.PAGE, 2.9)
    panels = list(figure.subplots(1, 2, sharey=True))
    for index, number in enumerate(numbers.tolist()):
        for axes, abscissa in zip(panels, (strain, rate), strict=True):
            axes.plot(abscissa, values[index], label=_peclet(number), **style.line_style(index))
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
    columns = min(3, len(shown))
    rows = -(-len(shown) // columns)
    width = style.COLUMN if columns == 1 else style.PAGE
    figure = style.new_figure(width, 0.3 + rows * (2.9 if columns == 1 else 2.05))
    panels: Sequence[Axes] = np.ravel(np.atleast_1d(figure.subplots(rows, columns))).tolist()
    upper = theta <= 0.5 * np.pi + 1e-12
    radius = np.sqrt(2.0) * np.sin(0.5 * theta[upper])
    around = np.append(phi, 2.0 * np.pi)
    x, y = np.outer(radius, np.cos(around)), np.outer(radius, np.sin(around))
    for axes in panels[len(shown) :]:
        axes.set_visible(False)
    for axes, index in zip(panels, shown, strict=False):
        values = density[index][upper]
        values = np.concatenate([values, values[:, :1]], axis=1)
        mesh = axes.pcolormesh(x, y, values, shading="gouraud", rasterized=True)
        _frame(axes)
        axes.set_title(_peclet(float(numbers[index])), loc="left")
        bar = figure.colorbar(mesh, cax=axes.inset_axes((1.04, 0.1, 0.04, 0.8)))
        bar.set_label(rf"density ${RHEOLOGY['distribution'].symbol}$")
    return figure


def _frame(axes: Axes) -> None:
    """The equator, and the names of the directions on it."""
    turn = np.linspace(0.0, 2.0 * np.pi, 361)
    axes.plot(np.cos(turn), np.sin(turn), color=style.BLACK, linewidth=0.8)
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.set_xlim(-1.18, 1.18)
    axes.set_ylim(-1.18, 1.18)
    for x, y, name in ((1.1, 0.0, "1"), (0.0, 1.1, "2")):
        axes.text(x, y, f"$e_{name}$", ha="center", va="center")


def _peclet(number: float) -> str:
    return rf"$\mathrm{{Pe}} = {number:g}$" if np.isfinite(number) else r"$\mathrm{Pe} = \infty$"


def _numbers(result: ResultLike, name: str) -> Array:
    """Dataset `name`; raises ResultFileError where it is missing or holds no numbers."""
    values: Any = result.arrays.get(name)
    if values is None or np.asarray(values).dtype.kind not in "fiu":
        raise ResultFileError(f"{result.path}: holds no numbers as {name}")
    return np.asarray(values, dtype=np.float64)
