"""Axes on the unit sphere: the orbit of one, and how many of them are distributed.

What lies behind the sphere is lighter. An axis and its opposite are one orientation of a spheroid,
so the half of the sphere around x3 holds all of a distribution. It is drawn by Lambert's
projection, seen from x3: equal areas of the sphere are equal areas of paper, so that axes that lie
evenly look even. The colour is the density over that of isotropic axes.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from qbxstokes.plots import style
from qbxstokes.plots.source import ResultLike, axis_path, instants, samples, vectors
from qbxstokes.plots.style import Axes, Figure
from qbxstokes.plots.views import Camera, split_at_silhouette
from qbxstokes.typing import Array

_REACH = 1.32  # how far the coordinate axes stick out of the sphere
_CLOSED = 0.05  # an orbit that keeps within this of itself is drawn in one colour
_TRIED, _PIECE = 400, 10_000  # points whose distance is looked at, and at once to how many
_MANY = 40_000  # points of a path; longer ones are drawn as pixels
_DOTS = 400  # fewer axes than this are drawn one by one
_PER_CELL = 25.0  # axes in a cell, on average


def orbit_figure(result: ResultLike) -> Figure:
    """The path of the axis D3 on the unit sphere."""
    figure = style.new_figure(style.COLUMN, 3.3)
    draw_orbit(figure.add_subplot(), result)
    return figure


def draw_orbit(axes: Axes, result: ResultLike) -> None:
    """The orbit, in one colour where it closes on itself, coloured by time where it drifts."""
    spin = vectors(result, "angular_velocity")
    at, path = axis_path(instants(result), samples(result, "axis", 3), spin)
    camera = Camera()
    draw_sphere(axes, camera)
    if drifts(path):
        _draw_coloured(axes, camera, at, path)
    else:
        _draw_path(axes, camera, path)
    # The end lies inside the ring of the start where the two coincide.
    for point, name, face, size in (
        (path[0], "start", "white", 6.5),
        (path[-1], "end", style.BLACK, 3.5),
    ):
        front = camera.depth(point) >= 0.0
        axes.plot(
            *camera.project(point)[:, None],
            "o",
            markersize=size,
            markerfacecolor=face,
            markeredgecolor=style.BLACK if front else style.GREY,
            label=name,
            zorder=6 if front else 2.5,
        )
    style.legend_above(axes, handle=1.0)


def drifts(path: Array) -> bool:
    """Whether a path (n, 3) ends elsewhere than it began, and not just at another phase.

    The points of the last quarter are compared with all of the first half, and the first quarter
    with the last half: a closed orbit passed at least twice keeps within its own line.
    """
    if len(path) < 40:
        return False
    half, quarter = len(path) // 2, len(path) // 4
    late, early = _farthest(path[-quarter:], path[:half]), _farthest(path[:quarter], path[half:])
    return max(late, early) > _CLOSED


def _farthest(some: Array, others: Array) -> float:
    """The largest distance of some points (at most `_TRIED` of them) to the nearest of others."""
    tried = some[:: -(-len(some) // _TRIED)]
    nearest = np.full(len(tried), np.inf)
    for begin in range(0, len(others), _PIECE):
        piece = others[begin : begin + _PIECE]
        apart = 2.0 - 2.0 * (tried @ piece.T)  # squared, on the unit sphere
        nearest = np.minimum(nearest, apart.min(axis=1))
    return float(np.sqrt(max(0.0, nearest.max())))


def draw_sphere(axes: Axes, camera: Camera) -> None:
    """The unit sphere with its graticule, the plane of x1 and x2, and the coordinate axes."""
    from matplotlib.patches import Circle

    axes.add_patch(Circle((0.0, 0.0), 1.0, facecolor="#f7f7f7", edgecolor="none", zorder=0))
    axes.add_patch(
        Circle((0.0, 0.0), 1.0, facecolor="none", edgecolor=style.GREY, linewidth=0.8, zorder=3)
    )
    turn = np.linspace(0.0, 2.0 * np.pi, 181)
    circle = np.stack([np.cos(turn), np.sin(turn), np.zeros_like(turn)], axis=-1)
    rings = [
        circle * np.cos(latitude) + [0.0, 0.0, np.sin(latitude)]
        for latitude in np.radians([-60.0, -30.0, 30.0, 60.0])
    ]
    for longitude in np.radians(np.arange(0.0, 180.0, 30.0)):
        across = np.array([np.cos(longitude), np.sin(longitude), 0.0])
        rings.append(circle[:, :1] * across + circle[:, 1:2] * [0.0, 0.0, 1.0])
    for ring in rings:
        _draw_curve(axes, camera, ring, {"color": style.PALE, "zorder": 1}, None, linewidth=0.4)
    ahead, behind = {"color": style.GREY, "zorder": 1}, {"color": style.PALE, "zorder": 0.5}
    _draw_curve(axes, camera, circle, ahead, behind, linewidth=0.6)
    for index, direction in enumerate(np.eye(3)):
        _draw_arrow(axes, camera, direction, f"$x_{index + 1}$")
    axes.set_aspect("equal")
    axes.set_xlim(-1.28, 1.28)
    axes.set_ylim(-1.12, 1.36)
    axes.set_axis_off()


def _draw_arrow(axes: Axes, camera: Camera, direction: Array, name: str) -> None:
    """A coordinate axis from where it leaves the sphere, or comes out from behind it."""
    tip = camera.project(_REACH * direction)
    front = camera.depth(direction) >= 0.0
    length = float(np.linalg.norm(tip))
    start = camera.project(direction) if front else tip / max(length, 1e-12)
    if front or length > 1.02:
        axes.annotate(
            "",
            xy=(tip[0], tip[1]),
            xytext=(start[0], start[1]),
            arrowprops={
                "arrowstyle": "-|>,head_length=0.35,head_width=0.13",
                "color": style.BLACK,
                "linewidth": 0.7,
                "shrinkA": 0,
                "shrinkB": 0,
            },
            zorder=5 if front else 0.2,
        )
    towards = tip / max(length, 1e-12)
    x, y = tip + 0.08 * towards
    axes.text(x, y, name, ha="center", va="center", zorder=5)


def _draw_path(axes: Axes, camera: Camera, path: Array) -> None:
    before = {"color": style.BLUE, "linewidth": 1.4, "zorder": 4, "gid": "before"}
    behind = {"color": style.PALE_BLUE, "linewidth": 0.8, "zorder": 2, "gid": "behind"}
    _draw_curve(axes, camera, path, before, behind, rasterized=len(path) > _MANY)


def _draw_curve(
    axes: Axes, camera: Camera, curve: Array, before: Any, behind: Any, **look: Any
) -> None:
    """A curve on the sphere, what is before it and what is behind in looks of their own, or not."""
    for pieces, own in zip(
        split_at_silhouette(curve, camera.depth(curve)), (before, behind), strict=True
    ):
        for piece in pieces if own else ():
            axes.plot(*camera.project(piece).T, **own, **look)


def _draw_coloured(axes: Axes, camera: Camera, at: Array, path: Array) -> None:
    from matplotlib.collections import LineCollection

    many = len(path) > _MANY
    flat = camera.project(path)
    segments = np.stack([flat[:-1], flat[1:]], axis=1)
    middle = 0.5 * (at[:-1] + at[1:])
    ahead = camera.depth(path[:-1] + path[1:]) >= 0.0
    for chosen, width, fade, zorder in ((~ahead, 0.8, 0.35, 2), (ahead, 1.4, 1.0, 4)):
        lines = LineCollection(
            segments[chosen],
            cmap=style.SEQUENTIAL,
            linewidths=width,
            alpha=fade,
            zorder=zorder,
            rasterized=many,
            capstyle="round" if fade == 1.0 else "butt",
        )
        lines.set_array(middle[chosen])
        lines.set_clim(at[0], at[-1])
        axes.add_collection(lines)
    bar = axes.figure.colorbar(lines, ax=axes, location="bottom", shrink=0.6, aspect=30, pad=0.0)
    bar.set_label(style.label("time $t$", "tau"))


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
