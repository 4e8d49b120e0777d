"""Distributions of axes on the unit sphere, as maps of equal areas.

An axis and its opposite are one orientation of a spheroid, so the half of the sphere around x3
holds all. It is drawn by Lambert's projection, seen from x3: equal areas of the sphere are equal
areas of paper, so that axes that lie evenly look even. The colour is the density over that of
isotropic axes.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from qbxstokes.plots import style
from qbxstokes.plots.style import Axes, Figure
from qbxstokes.typing import Array

_DOTS = 400  # fewer axes than this are drawn one by one
_PER_CELL = 25.0  # axes in a cell, on average


def distribution_figure(panels: Mapping[str, Array]) -> Figure:
    """A panel per set of unit axes (n, 3); all share their colours."""
    width = style.COLUMN if len(panels) == 1 else style.PAGE
    figure, drawn = style.panels(len(panels), len(panels), width, lambda _: 3.1)
    cells = {name: _cells(axes) for name, axes in panels.items() if len(axes) >= _DOTS}
    most = max([float(values.max()) for *_, values in cells.values()], default=1.0)
    for axes, (name, given) in zip(drawn, panels.items(), strict=True):
        draw_frame(axes)
        if name in cells:
            x, y, values = cells[name]
            mesh = axes.pcolormesh(x, y, values, vmin=0.0, vmax=most, rasterized=True)
        else:
            axes.plot(*_projected(given), "o", ms=2.2, color=style.BLUE, mec="none")
        axes.set_title(f"{name}, {len(given)} axes", loc="left")
    if cells:
        figure.colorbar(mesh, ax=drawn, label="density over isotropic", aspect=30)
    style.letter_panels(drawn)
    return figure


def _projected(axes: Array) -> tuple[Array, Array]:
    """Places on the unit disc of axes (n, 3), turned to the side of x3."""
    p = np.where(axes[:, 2:] < 0.0, -axes, axes)
    stretch = 1.0 / np.sqrt(1.0 + p[:, 2])
    return p[:, 0] * stretch, p[:, 1] * stretch


def _cells(given: Array) -> tuple[Array, Array, Array]:
    """Corners (m + 1, l + 1) of cells of equal area on the disc, and its density (m, l)."""
    # Six cells around for each ring make them about square.
    rings = int(np.clip(math.sqrt(len(given) / _PER_CELL / 6.0), 2, 40))
    turns = np.linspace(0.0, 2.0 * np.pi, 6 * rings + 1)
    radii = np.sqrt(np.linspace(0.0, 1.0, rings + 1))
    across, along = _projected(given)
    bins = [np.linspace(0.0, 1.0 + 1e-12, rings + 1), turns]
    around = np.arctan2(along, across) % (2.0 * np.pi)
    places: Any = np.stack([across**2 + along**2, around], axis=-1)
    counts, _ = np.histogramdd(places, bins)
    corners = radii[:, None] * np.cos(turns), radii[:, None] * np.sin(turns)
    return *corners, counts * counts.size / len(given)


def draw_frame(axes: Axes, degrees: Sequence[int] = (30, 60, 90), symbol: str = "x") -> None:
    """The rim, circles of latitude, and the names of the directions."""
    from matplotlib.patches import Circle

    for angle in degrees:
        look: dict[str, Any] = {"facecolor": "none", "zorder": 3, "linewidth": 0.5}
        look["edgecolor"] = style.GREY if angle < 90 else style.BLACK
        radius = math.sqrt(1.0 - math.cos(math.radians(angle)))
        axes.add_patch(Circle((0.0, 0.0), radius, **look))
    for name, x, y in (("1", 1.12, 0.0), ("2", 0.0, 1.12)):
        axes.text(x, y, f"${symbol}_{name}$", ha="center", va="center")
    axes.set(xlim=(-1.06, 1.2), ylim=(-1.06, 1.2), aspect="equal")
    axes.set_axis_off()
