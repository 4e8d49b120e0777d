"""The pictures of one trajectory: which kinds there are, and which a result calls for."""

import textwrap
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from qbxstokes.plots import bodies, style
from qbxstokes.plots.orbit import draw_orbit, orbit_figure
from qbxstokes.plots.picture_source import ResultLike, sampling
from qbxstokes.plots.series import Panel, draw_path, moves, panels
from qbxstokes.plots.style import Axes, Drawings, Figure


def stacked(drawn: Sequence[Panel]) -> Figure:
    """Panels over one time axis, one above the other."""
    figure = style.new_figure(style.COLUMN, 0.35 + 1.55 * len(drawn))
    grid = figure.add_gridspec(len(drawn), 1)
    style.letter_panels(_column(figure, grid, 0, 0, drawn))
    return figure


def overview_figure(result: ResultLike) -> Figure:
    """All that changes in time on one page, with the orbit."""
    every = panels(result, _ALL)
    with_orbit = "axis" in result.arrays
    taken = 0
    if with_orbit:  # rows of the second column, so that both columns end on the same row
        taken = 2 if len(every) % 2 == 0 else 3 if len(every) > 4 else 1
    rows = -(-(len(every) + taken) // 2)
    figure = style.new_figure(style.PAGE, min(0.35 + 1.55 * rows, style.TALL))
    grid = figure.add_gridspec(rows, 2)
    drawn = _column(figure, grid, 0, 0, every[:rows])
    if with_orbit:
        orbit = figure.add_subplot(grid[:taken, 1])
        draw_orbit(orbit, result)
        drawn.append(orbit)
    style.letter_panels(drawn + _column(figure, grid, 1, taken, every[rows:]))
    return figure


def path_figure(result: ResultLike) -> Figure:
    """The path, and the displacement since the start against time."""
    side = panels(result, ["position"])
    figure = style.new_figure(style.PAGE, 2.5 if len(side) == 1 else 3.4)
    grid = figure.add_gridspec(len(side), 2)
    path = figure.add_subplot(grid[:, 0])
    draw_path(path, result)
    style.letter_panels([path, *_column(figure, grid, 1, 0, side)])
    return figure


def _column(
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


_ROTATION = ("axis", "euler_angles", "angular_velocity")
_STACKS = {
    "rotation": _ROTATION,
    "constant": ("orbit_constant",),
    "velocity": ("velocity",),
    "loads": ("force", "torque"),
    "stress": ("stresslet", "particle_stress"),
}
_ALL = ("position", "velocity", *_ROTATION, "orbit_constant", "force", "torque")
KINDS: dict[str, str] = {
    "orbit": "path of the axis on the unit sphere",
    "rotation": "axis, Euler angles and angular velocity against time",
    "constant": "orbit constant and its drift",
    "path": "path and drift of the centre",
    "velocity": "velocity of the centre",
    "loads": "force and torque",
    "stress": "stresslet and particle stress",
    "overview": "all that changes in time on one page",
}


def drawings(result: ResultLike) -> Drawings:
    """Kind and drawing of each picture that this result calls for.

    A picture is left out where its quantity is not in the file or does nothing: the path of a
    centre at rest, the force on a massless body.
    """
    found: Drawings = {}
    if "position" in result.arrays:
        found = bodies.drawings(result) if bodies.coupled(result) else {}
        if result.arrays["position"].ndim == 3:
            return found
    if "axis" in result.arrays:
        found["orbit"] = partial(orbit_figure, result)
    if moves(result):
        found["path"] = partial(path_figure, result)
    for kind, names in _STACKS.items():
        drawn = panels(result, names)
        if drawn:
            found[kind] = partial(stacked, drawn)
    if panels(result, _ALL):
        found["overview"] = partial(overview_figure, result)
    if note := sampling(result):
        found = {kind: partial(_noted, draw, note) for kind, draw in found.items()}
    return {kind: found[kind] for kind in (*bodies.KINDS, *KINDS) if kind in found}


def _noted(draw: Callable[[], Figure], note: str) -> Figure:
    """A picture that says below what it may hide."""
    figure = draw()
    wide = int(18 * figure.get_figwidth())
    figure.supxlabel(textwrap.fill(note, wide), fontsize=7, color=style.VERMILION)
    return figure
