"""Bodies that share a fluid, or one by a wall: their paths with outlines, and their motion in time.

Arrays are (T, N, ...), of a single body (T, ...).
"""

from functools import partial
from typing import Any

import numpy as np

from qbxstokes.errors import ResultFileError
from qbxstokes.plots import style
from qbxstokes.plots.series import label_plane, panel_of, plane_of_motion, stacked
from qbxstokes.plots.source import ResultLike, instants, shapes_of, smooth, units, wall_of
from qbxstokes.plots.style import Axes, Drawings, Figure
from qbxstokes.quantities import MOTION
from qbxstokes.typing import Array

_NOISE = 1e-10  # of the largest component: nothing but rounding
_MANY = 7  # bodies that are told apart by name
KINDS: dict[str, str] = {
    "scene": "paths and outlines of several bodies, or of one by a wall",
    "displacement": "displacement of each of several bodies",
}
_KINDS = {"displacement": "position", "velocity": "velocity", "rotation": "axis"}


def drawings(result: ResultLike) -> Drawings:
    """Kind and drawing of each picture; of a single body its paths alone."""
    found: Drawings = {}
    if {"position", "axis"} <= set(result.arrays):
        found["scene"] = partial(scene_figure, result)
    if result.arrays["position"].ndim == 3:
        for kind, name in _KINDS.items():
            if name in result.arrays:
                found[kind] = partial(series_figure, result, name)
    return found


def scene_figure(result: ResultLike) -> Figure:
    """The paths in the plane of motion, true to scale, with outlines from the start to the end."""
    figure = style.new_figure(style.PAGE, 4.0)
    axes = figure.add_subplot()
    _draw_scene(axes, result)
    style.fit_height(figure, axes)
    return figure


def series_figure(result: ResultLike, name: str) -> Figure:
    """The components of a vector of every body against time; of the position the displacement."""
    times, values = instants(result), _by_body(result, name)
    if name == "position":
        values = values - values[0]
    size = np.abs(values)
    values = np.where(size > _NOISE * np.nanmax(size, initial=0.0), values, 0.0)
    shown, names = values[:, :_MANY], [f"body {b + 1}" for b in range(min(values.shape[1], _MANY))]
    symbols = MOTION[name].symbols
    if name == "position":
        symbols = tuple(rf"\Delta {symbol}" for symbol in symbols)
    panels = []
    for component, symbol in enumerate(symbols):
        told = [""] * len(names) if component else names
        unit = units(result, name)
        panels.append(panel_of(times, told, shown[..., component], f"${symbol}$", unit))
    return stacked(panels)


def _by_body(result: ResultLike, name: str) -> Array:
    """Samples (T, N, 3); raises ResultFileError for other shapes."""
    values = np.asarray(result.arrays[name], dtype=np.float64)
    values = values[:, None] if values.ndim == 2 else values
    if values.ndim != 3 or values.shape[2] != 3 or len(values) != len(result.arrays["time"]):
        raise ResultFileError(f"{result.path}: {name} has shape {values.shape}, not (T, N, 3)")
    return values


def _draw_scene(axes: Axes, result: ResultLike) -> None:
    position, axis = _by_body(result, "position"), _by_body(result, "axis")
    whole = np.flatnonzero(np.isfinite(position).all(axis=(1, 2)))
    position, axis = position[whole], axis[whole]
    velocity = _by_body(result, "velocity")[whole] if "velocity" in result.arrays else None
    paths = smooth(instants(result)[whole], position, velocity)
    along, across = _plane(result, position)
    bodies = shapes_of(result, position.shape[1])
    seen = []
    for b, (shape, size) in enumerate(bodies):
        look = style.line_style(b)
        path = position[:, b, [along, across]]
        name = f"body {b + 1}" if len(bodies) > 1 and b < _MANY else None
        axes.plot(*paths[:, b, [along, across]].T, label=name, **look)
        for place in _apart(path, 2.5 * size * shape.radius):
            edge = path[place] + _edge(shape, size, axis[place, b], [along, across])
            face = look["color"] if place == len(path) - 1 else "none"
            axes.fill(*edge.T, facecolor=face, edgecolor=look["color"], alpha=0.5, linewidth=0.8)
            seen += [edge.min(axis=0), edge.max(axis=0)]
    draw_wall(axes, result, *np.eye(3)[[along, across]])
    if (wall := wall_of(result)) is not None and wall[0][across]:  # with some of what is behind
        seen.append(np.array([seen[0][0], wall[1][across] - 0.3 * wall[0][across]]))
    low, high = np.min(seen, axis=0), np.max(seen, axis=0)
    room = 0.03 * np.max(high - low)
    axes.set_xlim(low[0] - room, high[0] + room)
    axes.set_ylim(low[1] - room, high[1] + room)
    label_plane(axes, result, along, across)
    axes.set_aspect("equal", adjustable="box")
    if len(bodies) > 1:
        style.legend_above(axes)


def _apart(path: Array, distance: float) -> list[int]:
    """The first instant of a path (T, 2), the last, and those between that are apart in space."""
    places, last = [0], len(path) - 1
    for place in range(1, last):
        if min(np.linalg.norm(path[place] - path[[places[-1], last]], axis=1)) > distance:
            places.append(place)
    return [*places, last]


def _plane(result: ResultLike, position: Array) -> tuple[int, int]:
    """The coordinates that are drawn: those in which paths extend, and the wall's normal."""
    first, second = plane_of_motion(position.reshape(-1, 3))
    if (wall := wall_of(result)) is None:
        return first, second
    normal = int(np.argmax(np.abs(wall[0])))
    return second if first == normal else first, normal


def _edge(shape: Any, size: float, axis: Array, plane: list[int]) -> Array:
    """Outline (n, 2) of a body seen along the third axis: x = C m/sqrt(m C m) over directions m."""
    extent = size**2 * shape.extent(axis / np.linalg.norm(axis))
    matrix = extent[np.ix_(plane, plane)]
    turn = np.linspace(0.0, 2.0 * np.pi, 91)
    m = np.stack([np.cos(turn), np.sin(turn)])
    return np.asarray((matrix @ m / np.sqrt(np.einsum("ik,ij,jk->k", m, matrix, m))).T)


def draw_wall(
    axes: Axes, result: ResultLike, first: Array, second: Array, origin: Array | None = None
) -> None:
    """The wall where the plane that is drawn, through an origin, holds its normal."""
    wall = wall_of(result)
    if wall is None:
        return
    from matplotlib.patches import Polygon

    flat = np.array([wall[0] @ first, wall[0] @ second])
    if np.linalg.norm(flat) < 1.0 - 1e-9:
        return
    foot = ((wall[1] - (0.0 if origin is None else origin)) @ wall[0]) * flat
    axes.axline(foot, foot + np.array([-flat[1], flat[0]]), color=style.BLACK, linewidth=1.5)
    # Hatched behind, as far as is seen.
    deep = foot - 1e3 * flat
    along = 1e3 * np.array([-flat[1], flat[0]])
    corners = np.stack([foot - along, foot + along, deep + along, deep - along])
    look: Any = {"facecolor": "white", "edgecolor": style.GREY, "hatch": "///", "linewidth": 0.0}
    axes.add_artist(Polygon(corners, zorder=3.5, **look))
