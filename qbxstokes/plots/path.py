"""Where the centre of the body goes: its path in the plane of motion, and its drift in time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from qbxstokes.plots import style
from qbxstokes.plots.series import vector_panels
from qbxstokes.plots.source import ResultLike, samples, units
from qbxstokes.quantities import MOTION

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

_TRUE_SCALE = 6.0  # paths longer than this many times their width are stretched across


def plane_of_motion(position: Array) -> tuple[int, int]:
    """The two coordinates that change most, the larger one first: stream and cross-stream."""
    spread = np.ptp(np.where(np.isfinite(position), position, position[0]), axis=0)
    first, second = np.argsort(-spread, kind="stable")[:2].tolist()
    return first, second


def draw_path(axes: Axes, result: ResultLike) -> None:
    """The path in the plane of motion: true to scale, or said not to be where it is too long."""
    position = samples(result, "position", 3)
    along, across = plane_of_motion(position)
    x, y = position[:, along], position[:, across]
    many = len(x) > style.RASTER_LIMIT
    axes.plot(x, y, color=style.BLUE, rasterized=many, zorder=2)
    axes.plot(x[:1], y[:1], "o", mfc="white", mec=style.BLACK, label="start", zorder=3, ms=5)
    axes.plot(x[-1:], y[-1:], "o", mfc=style.BLACK, mec=style.BLACK, label="end", zorder=3, ms=5)
    parts = MOTION["position"].symbols
    axes.set_xlabel(style.label(f"${parts[along]}$", units(result, "position")))
    axes.set_ylabel(style.label(f"${parts[across]}$", units(result, "position")))
    style.legend_above(axes, handle=1.0)
    width, height = np.ptp(x), np.ptp(y)
    if width <= _TRUE_SCALE * height:
        axes.set_aspect("equal", adjustable="datalim")
    elif height <= 1e-9 * width:
        middle = 0.5 * (y.min() + y.max())
        axes.set_ylim(middle - 0.5, middle + 0.5)
    else:
        axes.set_xlabel(axes.get_xlabel() + "; not to scale")


def path_figure(result: ResultLike) -> Figure:
    """The path, and the displacement since the start against time."""
    panels = vector_panels(result, "position")
    figure = style.new_figure(style.PAGE, 2.5 if len(panels) == 1 else 3.4)
    grid = figure.add_gridspec(len(panels), 2)
    path = figure.add_subplot(grid[:, 0])
    draw_path(path, result)
    side = [figure.add_subplot(grid[index, 1]) for index in range(len(panels))]
    for axes, panel in zip(side, panels, strict=True):
        panel(axes)
    for axes in side[:-1]:
        axes.sharex(side[-1])
        axes.set_xlabel("")
        axes.tick_params(labelbottom=False)
    style.letter_panels([path, *side])
    return figure
