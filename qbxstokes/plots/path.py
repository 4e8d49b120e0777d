"""Where the centre of the body goes: its path in the plane of motion."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from qbxstokes.plots import style
from qbxstokes.plots.picture_source import ResultLike, samples, units
from qbxstokes.quantities import MOTION
from qbxstokes.typing import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes


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
