"""The pictures of one trajectory: which kinds there are, and which a result calls for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from qbxstokes.plots import style
from qbxstokes.plots.orbit import draw_orbit, orbit_figure
from qbxstokes.plots.path import path_figure
from qbxstokes.plots.series import (
    Panel,
    axis_panel,
    constant_panels,
    euler_panel,
    loaded,
    moves,
    vector_panels,
)
from qbxstokes.plots.source import ResultLike

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def stacked(panels: Sequence[Panel]) -> Figure:
    """Panels over one time axis, one above the other."""
    figure = style.new_figure(style.COLUMN, 0.35 + 1.55 * len(panels))
    grid = figure.add_gridspec(len(panels), 1)
    _finish(figure, _column(figure, grid, 0, 0, panels))
    return figure


def overview_figure(result: ResultLike) -> Figure:
    """All that changes in time on one page, with the orbit."""
    panels = overview_panels(result)
    with_orbit = "axis" in result.arrays
    taken = 0
    if with_orbit:  # rows of the second column, so that both columns end on the same row
        taken = 2 if len(panels) % 2 == 0 else 3 if len(panels) > 4 else 1
    rows = -(-(len(panels) + taken) // 2)
    figure = style.new_figure(style.PAGE, 0.35 + 1.55 * rows)
    grid = figure.add_gridspec(rows, 2)
    drawn = _column(figure, grid, 0, 0, panels[:rows])
    if with_orbit:
        orbit = figure.add_subplot(grid[:taken, 1])
        draw_orbit(orbit, result)
        drawn.append(orbit)
    _finish(figure, drawn + _column(figure, grid, 1, taken, panels[rows:]))
    return figure


def _column(
    figure: Figure, grid: Any, column: int, first: int, panels: Sequence[Panel]
) -> list[Axes]:
    """Panels in a column of the grid from row `first` on, the time axis labelled at the last."""
    drawn: list[Axes] = []
    for index, panel in enumerate(panels):
        axes = figure.add_subplot(grid[first + index, column], sharex=drawn[0] if drawn else None)
        panel(axes)
        if index < len(panels) - 1:
            axes.set_xlabel("")
            axes.tick_params(labelbottom=False)
        drawn.append(axes)
    return drawn


def _finish(figure: Figure, drawn: Sequence[Axes]) -> None:
    style.letter_panels(drawn)
    figure.align_ylabels(list(drawn))


def rotation_panels(result: ResultLike) -> list[Panel]:
    """Axis, Euler angles and angular velocity, as far as the file holds them."""
    panels: list[Panel] = []
    if "axis" in result.arrays:
        panels.append(axis_panel(result))
    if "euler_angles" in result.arrays:
        panels.append(euler_panel(result))
    if "angular_velocity" in result.arrays:
        panels += vector_panels(result, "angular_velocity")
    return panels


def load_panels(result: ResultLike) -> list[Panel]:
    """Force and torque, where they are more than rounding."""
    return [
        panel
        for name in ("force", "torque")
        if loaded(result, name)
        for panel in vector_panels(result, name)
    ]


def overview_panels(result: ResultLike) -> list[Panel]:
    """Everything about the motion that changes, for one page."""
    panels: list[Panel] = []
    if moves(result):
        panels += vector_panels(result, "position")
        if "velocity" in result.arrays:
            panels += vector_panels(result, "velocity")
    panels += rotation_panels(result)
    if "orbit_constant" in result.arrays:
        panels += constant_panels(result)
    return panels + load_panels(result)


def velocity_panels(result: ResultLike) -> list[Panel]:
    """Velocity of a centre that moves."""
    wanted = "velocity" in result.arrays and moves(result)
    return vector_panels(result, "velocity") if wanted else []


def orbit_constant_panels(result: ResultLike) -> list[Panel]:
    """The orbit constant, where the file holds it."""
    return constant_panels(result) if "orbit_constant" in result.arrays else []


_STACKS: dict[str, Callable[[ResultLike], list[Panel]]] = {
    "rotation": rotation_panels,
    "constant": orbit_constant_panels,
    "velocity": velocity_panels,
    "loads": load_panels,
}
KINDS: dict[str, str] = {
    "orbit": "path of the axis on the unit sphere",
    "rotation": "axis, Euler angles and angular velocity against time",
    "constant": "orbit constant and its drift",
    "path": "path and drift of the centre",
    "velocity": "velocity of the centre",
    "loads": "force and torque",
    "overview": "all that changes in time on one page",
}


def drawings(result: ResultLike) -> dict[str, Callable[[], Figure]]:
    """Kind and drawing of each picture that this result calls for.

    A picture is left out where its quantity is not in the file or does nothing: the path of a
    centre at rest, the force on a massless body.
    """
    found: dict[str, Callable[[], Figure]] = {}
    if "axis" in result.arrays:
        found["orbit"] = partial(orbit_figure, result)
    if moves(result):
        found["path"] = partial(path_figure, result)
    for kind, collect in _STACKS.items():
        panels = collect(result)
        if panels:
            found[kind] = partial(stacked, panels)
    if overview_panels(result):
        found["overview"] = partial(overview_figure, result)
    return {kind: found[kind] for kind in KINDS if kind in found}
