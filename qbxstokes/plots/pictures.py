"""Which pictures a result calls for, one of them by its name, and those of one trajectory."""

import textwrap
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from qbxstokes.errors import CaseError
from qbxstokes.plots import bodies, field, style, suspension, sweep
from qbxstokes.plots.series import column_of, draw_path, draw_quantity, moves, panels, stacked
from qbxstokes.plots.source import ResultLike, coupled, is_motion, sampling
from qbxstokes.plots.sphere import draw_orbit, orbit_figure
from qbxstokes.plots.style import Drawings, Figure
from qbxstokes.quantities import RECORDABLE


def kinds(
    result: ResultLike, wanted: Sequence[str] = (), roles: Mapping[str, Any] | None = None
) -> Drawings:
    """Kind and drawing of each picture of a result, or of those wanted.

    A motion has those of its quantities as well, by their names. roles: x, y, by, value and scale
    of a sweep. Raises CaseError for kinds or columns that are not there.
    """
    if result.task == "sweep":
        return sweep.drawings(result, wanted, roles)  # type: ignore[arg-type]
    if roles:
        raise CaseError(f"{result.path}: is not a sweep, so it has no table whose columns to draw")
    found: Drawings = motion_drawings(result) if is_motion(result) else {}
    found |= field.drawings(result) | suspension.drawings(result)
    for kind in wanted:
        if kind in result.arrays and kind in RECORDABLE and is_motion(result):
            whole = [partial(draw_quantity, result=result, name=kind)]
            found.setdefault(kind, partial(stacked, panels(result, [kind]) or whole))
        elif kind not in found:
            there = ", ".join(found) or "no pictures"
            raise CaseError(f"{result.path}: nothing to draw as {kind!r}; there are {there}")
    if not found:
        raise CaseError(f"{result.path}: holds nothing that calls for a picture")
    return {kind: found[kind] for kind in wanted} if wanted else found


def plot(result: ResultLike, kind: str, ax: Any, roles: Mapping[str, Any]) -> Any:
    """One picture: a figure, or `ax` again, drawn into; see `Result.plot`."""
    draw = next(iter(kinds(result, [kind] if kind else [], roles).values()))
    if ax is None:
        with style.styled():
            return draw()
    axes = np.ravel(ax).tolist()
    if len(axes) == 1 and kind in RECORDABLE and is_motion(result):
        draw_quantity(axes[0], result, kind)
        return ax
    with style.into(axes):
        draw()
    return ax


# -- one trajectory ------------------------------------------------------------------------------


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
    drawn = column_of(figure, grid, 0, 0, every[:rows])
    if with_orbit:
        orbit = figure.add_subplot(grid[:taken, 1])
        draw_orbit(orbit, result)
        drawn.append(orbit)
    style.letter_panels(drawn + column_of(figure, grid, 1, taken, every[rows:]))
    return figure


def path_figure(result: ResultLike) -> Figure:
    """The path, and the displacement since the start against time."""
    side = panels(result, ["position"])
    figure = style.new_figure(style.PAGE, 2.5 if len(side) == 1 else 3.4)
    grid = figure.add_gridspec(len(side), 2)
    path = figure.add_subplot(grid[:, 0])
    draw_path(path, result)
    style.letter_panels([path, *column_of(figure, grid, 1, 0, side)])
    return figure


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


def motion_drawings(result: ResultLike) -> Drawings:
    """Kind and drawing of each picture that one trajectory calls for.

    A picture is left out where its quantity is not in the file or does nothing: the path of a
    centre at rest, the force on a massless body.
    """
    found: Drawings = {}
    if "position" in result.arrays:
        found = bodies.drawings(result) if coupled(result) else {}
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
