"""Pictures of the flow around a body: velocity in a plane, traction on the body, and errors."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from qbxstokes.geometry import rotation
from qbxstokes.plots import style
from qbxstokes.plots.source import ResultLike, shape_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

_LEAST_ERROR = 1e-17  # what an error of zero is drawn as
# Arrows of the traction: distance between them over the half width of the picture, and the least
# length over the longest.
_SPACING, _SHORTEST = 0.12, 0.1
# Median over largest traction below which colours are logarithmic, and their range then.
_PEAKED, _RANGE = 0.12, 1e-2
_SHEET = 9  # panels of a sheet of instants at most
_SPEED = (
    style.label(r"speed $|\mathbf{u} - \mathbf{V}|$", "c/tau"),
    style.label(r"speed $|\mathbf{u}|$ in space", "c/tau"),
)


def drawings(result: ResultLike) -> dict[str, Callable[[], Figure]]:
    """Kind and drawing of each picture of the result's group `field`, at its last instant.

    Where it has several, `instants` shows the flow at up to nine of them.
    """
    field = result.groups.get("field", {})
    found: dict[str, Callable[[], Figure]] = {}
    if "velocity" in field.get("plane", {}):
        found["velocity-field"] = partial(velocity_figure, result)
        if np.any(_state(result, -1, "velocity")):  # else it is the same
            found["lab-field"] = partial(velocity_figure, result, lab=True)
        if len(field["time"]) > 1:
            found["instants"] = partial(instants_figure, result)
    if "surface" in field:
        found["traction"] = partial(traction_figure, result)
    if "error" in field:
        found["error"] = partial(error_figure, result)
    return found


def draw_field(result: ResultLike, stem: Path, kind: str = "pdf") -> list[Path]:
    """Draw what the result's group `field` holds, at its last instant; the files written.

    stem: path of the pictures without the ending, to which the kind of each is added. Raises
    CaseError where a picture cannot be written.
    """
    written = []
    for name, draw in drawings(result).items():
        with style.styled():
            written.append(style.save(draw(), Path(f"{stem}-{name}.{kind}")))
    return written


def velocity_figure(result: ResultLike, step: int = -1, lab: bool = False) -> Figure:
    """Speed in the plane, and streamlines: of the velocity relative to the body's centre, or of
    that in space (`lab`)."""
    plane = result.groups["field"]["plane"]
    figure, axes = _plane_axes(plane)
    mesh = _velocity(axes, result, step, *_relative(result, step, lab))
    _bar(figure, axes, mesh, _SPEED[lab])
    return figure


def instants_figure(result: ResultLike) -> Figure:
    """The flow in space at several instants, from the first to the last, with one scale."""
    from matplotlib.colors import Normalize

    field = result.groups["field"]
    count = len(field["time"])
    steps = np.unique(np.linspace(0, count - 1, min(count, _SHEET)).round().astype(int))
    columns = min(len(steps), 2 if len(steps) == 4 else 3)
    rows = -(-len(steps) // columns)
    plane = field["plane"]
    a, b = plane["first_coordinate"], plane["second_coordinate"]
    height = 0.8 * style.PAGE / columns * (b[-1] - b[0]) / (a[-1] - a[0]) + 0.65
    figure = style.new_figure(style.PAGE, min(rows * height, style.TALL))
    panels = np.ravel(figure.subplots(rows, columns, sharex=True, sharey=True))
    flows = [_relative(result, int(step), lab=True) for step in steps]
    norm = Normalize(0.0, max(float(speed.max()) for _, speed in flows) or 1.0)
    for axes, step, flow in zip(panels, steps, flows, strict=False):
        axes.set_aspect("equal")
        mesh = _velocity(axes, result, int(step), *flow, norm=norm, density=0.7)
        axes.set_title(f"$t = {field['time'][step]:.4g}$", loc="left", pad=4)
    for axes in panels[len(steps) :]:
        axes.set_visible(False)
    for place, axes in enumerate(panels[: len(steps)]):
        if place + columns >= len(steps):
            axes.tick_params(labelbottom=True)
            axes.set_xlabel(style.label(_name(plane, "first"), "c"))
        if place % columns == 0:
            axes.set_ylabel(style.label(_name(plane, "second"), "c"))
    style.letter_panels(list(panels[: len(steps)]))
    colours = figure.colorbar(mesh, ax=list(panels), fraction=0.04, pad=0.02)
    colours.set_label(_SPEED[True])
    return figure


def _relative(result: ResultLike, step: int, lab: bool) -> tuple[Array, Array]:
    """Velocity (2, second, first) in the plane, NaN in the body, and speed (second, first)."""
    plane = result.groups["field"]["plane"]
    centre = _state(result, step, "velocity")
    velocity = plane["velocity"][step] - (0.0 if lab else centre)
    shape = tuple(plane["shape"])
    directions = _directions(result, plane, step)
    along = np.stack([(velocity @ direction).reshape(shape).T for direction in directions])
    # Inside the body its own motion, so that colours reach the outline; the body covers it.
    arms = plane["points"][step] - _state(result, step, "position")
    rigid = np.cross(_state(result, step, "angular_velocity"), arms) + (centre if lab else 0.0)
    filled = np.where(np.isnan(velocity), rigid, velocity)
    return along, np.linalg.norm(filled, axis=-1).reshape(shape).T


def _velocity(
    axes: Axes,
    result: ResultLike,
    step: int,
    along: Array,
    speed: Array,
    norm: Any = None,
    density: float = 1.3,
) -> Any:
    """Draw speed, streamlines and the body; returns what has the colours."""
    plane = result.groups["field"]["plane"]
    a, b = plane["first_coordinate"], plane["second_coordinate"]
    mesh = axes.pcolormesh(
        a, b, speed, norm=norm, shading="gouraud", cmap=style.SEQUENTIAL, rasterized=True
    )
    u, v = (np.ma.masked_invalid(part) for part in along)
    if np.ma.maximum(np.abs(u).max(), np.abs(v).max()) > 0.0:
        lines = axes.streamplot(
            a, b, u, v, color="white", linewidth=0.5, density=density, arrowsize=0.6
        )
        lines.lines.set_capstyle("round")
        axes.set_xlim(a[0], a[-1])
        axes.set_ylim(b[0], b[-1])
    _body_section(axes, result, plane, a, b, step)
    return mesh


def traction_figure(result: ResultLike, step: int = -1) -> Figure:
    """Magnitude of the traction on the body from two sides, with its part in the view as arrows."""
    from matplotlib.collections import PolyCollection
    from matplotlib.colors import LogNorm, Normalize

    field = result.groups["field"]
    surface = field["surface"]
    n_theta, n_phi = (int(n) for n in surface["shape"])
    first, second = _view(result, field, step)
    view = np.cross(first, second)
    points = (surface["points"][step] - _state(result, step, "position")).reshape(n_theta, n_phi, 3)
    traction = surface["traction"][step].reshape(n_theta, n_phi, 3)
    normals = surface["normals"][step].reshape(n_theta, n_phi, 3)
    size = np.linalg.norm(traction, axis=-1)
    index = np.arange(n_phi)
    after = np.roll(index, -1)
    corners = [(slice(0, -1), index), (slice(1, None), index), (slice(1, None), after)]
    corners.append((slice(0, -1), after))
    depth = sum(normals[corner] @ view for corner in corners)
    value = sum(size[corner] for corner in corners) / 4.0
    names = ["along the axis", "across it"]
    if "plane" in field:
        names = [_name(field["plane"], name) for name in ("first", "second")]
    figure = style.new_figure(style.PAGE, 0.46 * style.PAGE)
    panels = figure.subplots(1, 2, sharex=True, sharey=True)
    reach = 1.3 * float(np.abs(points @ np.stack([first, second], axis=-1)).max())
    longest = float(size.max()) or 1.0
    # On a slender or flat body nearly all of it would have one colour.
    peaked = np.median(size) < _PEAKED * longest
    norm = LogNorm(_RANGE * longest, longest, clip=True) if peaked else Normalize(0.0, longest)
    for axes, side, name in zip(panels, (1.0, -1.0), ("front", "back"), strict=True):
        # Seen from behind, the first coordinate runs the other way.
        flat = np.stack([side * (points @ first), points @ second], axis=-1)
        seen = side * depth > 0.0
        polygons = np.stack([flat[corner] for corner in corners], axis=-2)[seen]
        mesh = PolyCollection(
            list(polygons),
            array=value[seen],
            cmap=style.SEQUENTIAL,
            edgecolors="face",
            linewidths=0.2,
        )
        mesh.set_norm(norm)
        mesh.set_rasterized(True)
        axes.add_collection(mesh)
        facing = side * (normals @ view) > 0.1
        flat_arrows = np.stack([side * (traction @ first), traction @ second], axis=-1)
        chosen = _spread(flat[facing], flat_arrows[facing], _SPACING * reach)
        axes.quiver(
            *flat[facing][chosen].T,
            *flat_arrows[facing][chosen].T,
            color="white",
            edgecolor=style.BLACK,
            linewidth=0.3,
            angles="xy",
            scale_units="xy",
            scale=5.0 * longest / reach,
            width=0.007,
        )
        axes.set(aspect="equal", xlim=(-reach, reach), ylim=(-reach, reach))
        axes.set_title(name, loc="left", pad=4)
        across = names[0]
        if side < 0:
            across = f"$-({across[1:-1]})$" if across.startswith("$") else f"minus {across}"
        axes.set_xlabel(style.label(across, "c"))
    panels[0].set_ylabel(style.label(names[1], "c"))
    style.letter_panels(list(panels))
    colours = figure.colorbar(mesh, ax=list(panels), fraction=0.05, pad=0.02)
    colours.set_label(style.label(r"traction $|\mathbf{\sigma}\mathbf{n}|$", "mu/tau"))
    return figure


def _spread(points: Array, arrows: Array, spacing: float) -> list[int]:
    """Numbers of points (N, 2) that keep a distance in the view, those of large arrows first.

    Arrows (N, 2) too short to be seen are left out.
    """
    length = np.linalg.norm(arrows, axis=-1)
    chosen: list[int] = []
    for number in np.argsort(-length, kind="stable"):
        if length[number] < _SHORTEST * length.max(initial=0.0):
            break
        taken = points[chosen]
        if np.all(np.sum((taken - points[number]) ** 2, axis=-1) > spacing**2):
            chosen.append(int(number))
    return chosen


def error_figure(result: ResultLike) -> Figure:
    """Difference between table and quadrature at points of the plane, relative."""
    from matplotlib.colors import LogNorm

    field = result.groups["field"]
    plane, error = field["plane"], field["error"]
    a, b = plane["first_coordinate"], plane["second_coordinate"]
    figure, axes = _plane_axes(plane)
    size = np.maximum(error["error"], _LEAST_ERROR)
    i, j = np.unravel_index(error["index"], tuple(plane["shape"]))
    first, second = np.unique(i), np.unique(j)
    values = np.full((len(second), len(first)), np.nan)
    values[np.searchsorted(second, j), np.searchsorted(first, i)] = size
    norm = LogNorm(float(np.nanmin(size)), max(float(np.nanmax(size)), 1.1 * _LEAST_ERROR))
    mesh = axes.pcolormesh(
        a[first],
        b[second],
        values,
        norm=norm,
        shading="nearest",
        cmap=style.SEQUENTIAL,
        rasterized=True,
    )
    axes.set_facecolor(style.PALE)  # cells whose point lies in the body
    _body_section(axes, result, plane, a, b, -1)
    axes.set_xlim(a[0], a[-1])
    axes.set_ylim(b[0], b[-1])
    _bar(figure, axes, mesh, "relative error of the velocity")
    return figure


def _plane_axes(plane: Mapping[str, Any]) -> tuple[Figure, Axes]:
    """Figure and axes of the plane's shape, with room for the colour bar."""
    a, b = plane["first_coordinate"], plane["second_coordinate"]
    shape = (b[-1] - b[0]) / (a[-1] - a[0])
    width = style.COLUMN if shape > 1.5 else 1.35 * style.COLUMN
    figure = style.new_figure(width, min(max(0.74 * width * shape + 0.45, 1.6), 8.0))
    axes = figure.subplots()
    axes.set_aspect("equal")
    axes.set_xlabel(style.label(_name(plane, "first"), "c"))
    axes.set_ylabel(style.label(_name(plane, "second"), "c"))
    return figure, axes


def _name(plane: Mapping[str, Any], which: str) -> str:
    """How a coordinate of the plane is called: by the axis it runs along, where it does."""
    direction = plane[which]
    for index in range(3):
        if abs(direction[index] - 1.0) < 1e-12:
            frame = plane["frame"]
            if frame == "body":
                return rf"$\tilde{{x}}_{index + 1}$"
            place = f" - X_{index + 1}" if frame == "centre" else ""
            return f"$x_{index + 1}{place}$"
    return f"{which} coordinate"


def _bar(figure: Figure, axes: Axes, mesh: Any, text: str) -> None:
    """A colour bar as high as the axes."""
    figure.colorbar(mesh, cax=axes.inset_axes((1.03, 0.0, 0.035, 1.0))).set_label(text)


def _state(result: ResultLike, step: int, name: str) -> Array:
    """Quantity of the body at an instant of the field."""
    times = np.asarray(result.arrays["time"])
    instant = result.groups["field"]["time"][step]
    value: Array = np.asarray(result.arrays[name])[int(np.abs(times - instant).argmin())]
    return value


def _view(result: ResultLike, field: Mapping[str, Any], step: int) -> tuple[Array, Array]:
    """Directions across and up the picture of the body: those of the plane, if there is one."""
    if "plane" in field:
        return _directions(result, field["plane"], step)
    axis = _state(result, step, "axis")
    across = np.eye(3)[int(np.abs(axis).argmin())]
    second = np.cross(axis, across)
    return axis, second / np.linalg.norm(second)


def _directions(result: ResultLike, plane: Mapping[str, Any], step: int) -> tuple[Array, Array]:
    """Directions of the plane's coordinates in space."""
    first, second = plane["first"], plane["second"]
    if plane["frame"] == "body":
        turn = rotation.matrix(_state(result, step, "orientation"))
        return turn @ first, turn @ second
    return first, second


def _body_section(
    axes: Axes, result: ResultLike, plane: Mapping[str, Any], a: Array, b: Array, step: int
) -> None:
    """Fill the section of the body by the plane, and draw its outline."""
    shape = shape_of(result)
    turn = rotation.matrix(_state(result, step, "orientation"))
    # On a grid of its own, fine enough for the outline of any section.
    fine_a, fine_b = np.linspace(a[0], a[-1], 801), np.linspace(b[0], b[-1], 801)
    offsets = (
        fine_a[None, :, None] * plane["first"] + fine_b[:, None, None] * plane["second"]
    ) + plane["origin"]
    if plane["frame"] == "space":
        offsets = offsets - _state(result, step, "position")
    body = offsets if plane["frame"] == "body" else offsets @ turn
    level = shape.level(body)
    if level.min() < 1.0 < level.max():
        axes.contourf(fine_a, fine_b, level, levels=[-1.0, 1.0], colors=[style.PALE], zorder=3)
        axes.contour(
            fine_a, fine_b, level, levels=[1.0], colors=[style.BLACK], linewidths=0.8, zorder=4
        )
