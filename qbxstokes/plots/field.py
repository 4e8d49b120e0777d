"""Pictures of the flow around bodies: velocity in a plane, traction on the bodies, and errors."""

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from qbxstokes.plots import style
from qbxstokes.plots.bodies import draw_wall
from qbxstokes.plots.source import (
    ResultLike,
    directions,
    members_of,
    name_of,
    state,
    surfaces_of,
    view_of,
)
from qbxstokes.plots.style import Axes, Drawings, Figure
from qbxstokes.typing import Array

_LEAST_ERROR = 1e-17  # what an error of zero is drawn as
_SHEET = 9  # panels of a sheet of instants at most
_SPEED = (
    style.label(r"speed $|\mathbf{u} - \mathbf{V}|$", "c/tau"),
    style.label(r"speed $|\mathbf{u}|$ in space", "c/tau"),
)
# Arrows of the traction: distance between them over the half width of the picture, and the least
# length over the longest.
_SPACING, _SHORTEST = 0.12, 0.1
# Median over largest traction below which colours are logarithmic, and their range then.
_PEAKED, _RANGE = 0.12, 1e-2


def drawings(result: ResultLike) -> Drawings:
    """Kind and drawing of each picture of the result's group `field`, at its last instant.

    Where it has several, `instants` shows the flow at up to nine of them.
    """
    field = result.groups.get("field", {})
    found: Drawings = {}
    if "velocity" in field.get("plane", {}):
        alone = len(members_of(result, -1)) == 1
        if alone:
            found["velocity-field"] = partial(velocity_figure, result)
        if not alone or np.any(state(result, -1, "velocity")):  # else it is the same
            found["lab-field"] = partial(velocity_figure, result, lab=True)
        if len(field["time"]) > 1:
            found["instants"] = partial(instants_figure, result)
    if surfaces_of(field):
        found["traction"] = partial(traction_figure, result)
    if "error" in field:
        found["error"] = partial(error_figure, result)
    return found


def draw_field(result: ResultLike, stem: Path) -> list[Path]:
    """Draw what the result's group `field` holds, at its last instant; the files written.

    stem: path of the pictures without what they show and .pdf. Raises CaseError where one cannot be
    written.
    """
    with style.styled():
        return [
            style.save(draw(), Path(f"{stem}-{name}.pdf"))
            for name, draw in drawings(result).items()
        ]


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
    plane = field["plane"]
    a, b = plane["first_coordinate"], plane["second_coordinate"]
    height = 0.8 * style.PAGE / columns * (b[-1] - b[0]) / (a[-1] - a[0]) + 0.65
    figure, panels = style.panels(
        len(steps), columns, style.PAGE, lambda rows: min(rows * height, style.TALL), shared=True
    )
    flows = [_relative(result, int(step), lab=True) for step in steps]
    norm = Normalize(0.0, max(float(speed.max()) for _, speed in flows) or 1.0)
    for place, (axes, step, flow) in enumerate(zip(panels, steps, flows, strict=True)):
        axes.set_aspect("equal")
        mesh = _velocity(axes, result, int(step), *flow, norm=norm, density=0.7)
        axes.set_title(f"$t = {field['time'][step]:.4g}$", loc="left", pad=4)
        if place + columns >= len(steps):
            axes.set_xlabel(style.label(name_of(plane, "first"), "c"))
        if place % columns == 0:
            axes.set_ylabel(style.label(name_of(plane, "second"), "c"))
    style.letter_panels(panels)
    colours = figure.colorbar(mesh, ax=panels, fraction=0.04, pad=0.02)
    colours.set_label(_SPEED[True])
    return figure


def _relative(result: ResultLike, step: int, lab: bool) -> tuple[Array, Array]:
    """Velocity (2, second, first) in the plane, and speed (second, first).

    In the bodies their own, so that colours and lines reach the outlines; the bodies cover it.
    """
    plane, members = result.groups["field"]["plane"], members_of(result, step)
    centre = 0.0 if lab else members[0].velocity
    velocity = plane["velocity"][step] - centre
    shape = tuple(plane["shape"])
    filled = np.where(plane["inside"][step][:, None], 0.0, velocity)
    for one in members:
        arms = plane["points"][step] - one.position
        within = one.shape.level(arms @ one.turn / one.size) < 1.0
        rigid = np.cross(one.angular_velocity, arms) + one.velocity - centre
        filled[within] = rigid[within]
    along_plane = directions(result, plane, step)
    along = np.stack([(filled @ direction).reshape(shape).T for direction in along_plane])
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
    if np.any(along):
        look: Any = {"color": "white", "linewidth": 0.5, "arrowsize": 0.6}
        lines = axes.streamplot(a, b, *along, density=density, **look)
        lines.lines.set_capstyle("round")
        axes.set_xlim(a[0], a[-1])
        axes.set_ylim(b[0], b[-1])
    _body_sections(axes, result, plane, a, b, step)
    return mesh


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
    _body_sections(axes, result, plane, a, b, -1)
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
    axes.set_xlabel(style.label(name_of(plane, "first"), "c"))
    axes.set_ylabel(style.label(name_of(plane, "second"), "c"))
    return figure, axes


def _bar(figure: Figure, axes: Axes, mesh: Any, text: str) -> None:
    """A colour bar as high as the axes."""
    figure.colorbar(mesh, cax=axes.inset_axes((1.03, 0.0, 0.035, 1.0))).set_label(text)


def _body_sections(
    axes: Axes, result: ResultLike, plane: Mapping[str, Any], a: Array, b: Array, step: int
) -> None:
    """Fill the sections of the bodies by the plane, and draw their outlines and the wall."""
    # On a grid of its own, fine enough for the outline of any section.
    fine_a, fine_b = np.linspace(a[0], a[-1], 801), np.linspace(b[0], b[-1], 801)
    points = (
        fine_a[None, :, None] * plane["first"] + fine_b[:, None, None] * plane["second"]
    ) + plane["origin"]
    if plane["frame"] != "body":
        draw_wall(axes, result, plane["first"], plane["second"], _origin(result, plane, step))
    for one in members_of(result, step):
        offsets = points - one.position if plane["frame"] == "space" else points
        body = (offsets if plane["frame"] == "body" else offsets @ one.turn) / one.size
        level = one.shape.level(body)
        if level.min() < 1.0 < level.max():
            axes.contourf(fine_a, fine_b, level, levels=[-1.0, 1.0], colors=[style.PALE], zorder=3)
            axes.contour(
                fine_a, fine_b, level, levels=[1.0], colors=[style.BLACK], linewidths=0.8, zorder=4
            )


def _origin(result: ResultLike, plane: Mapping[str, Any], step: int) -> Array:
    """The plane's origin in space."""
    centre = 0.0 if plane["frame"] == "space" else members_of(result, step)[0].position
    return np.asarray(plane["origin"] + centre)


def traction_figure(result: ResultLike, step: int = -1) -> Figure:
    """Magnitude of the traction on the body from two sides, with its part in the view as arrows."""
    from matplotlib.collections import PolyCollection
    from matplotlib.colors import LogNorm, Normalize

    field = result.groups["field"]
    first, second = view_of(result, field, step)
    view = np.cross(first, second)
    surfaces, members = surfaces_of(field), members_of(result, step)
    middle = np.mean([one.position for one in members], axis=0)
    # Coordinates are as the plane names them: in space, or about the bodies.
    seen_at = middle if "plane" in field and field["plane"]["frame"] == "space" else 0.0 * middle
    points, traction, normals, quads = (
        np.concatenate(parts)
        for parts in zip(*(_facets(surface, step) for surface in surfaces), strict=True)
    )
    offsets = np.cumsum([0] + [len(surface["points"][step]) for surface in surfaces[:-1]])
    quads += np.repeat(offsets, [len(quads) // len(surfaces)] * len(surfaces))[:, None]
    points = points - middle
    size = np.linalg.norm(traction, axis=-1)
    depth, value = normals[quads].sum(axis=1) @ view, size[quads].mean(axis=1)
    names = ["along the axis", "across it"]
    if "plane" in field:
        names = [name_of(field["plane"], name) for name in ("first", "second")]
    wide, high = 1.3 * np.abs(points @ np.stack([first, second], axis=-1)).max(axis=0)
    reach = float(max(wide, high))
    wide, high = max(wide, 0.3 * reach), max(high, 0.3 * reach)
    figure = style.new_figure(style.PAGE, style.PAGE * min(0.46, 0.12 + 0.4 * high / wide))
    panels = figure.subplots(1, 2, sharey=True)
    points = points + seen_at
    longest = float(size.max()) or 1.0
    # On a slender or flat body nearly all of it would have one colour.
    peaked = np.median(size) < _PEAKED * longest
    norm = LogNorm(_RANGE * longest, longest, clip=True) if peaked else Normalize(0.0, longest)
    for axes, side, name in zip(panels, (1.0, -1.0), ("front", "back"), strict=True):
        # Seen from behind, the first coordinate runs the other way.
        flat = np.stack([side * (points @ first), points @ second], axis=-1)
        seen = np.flatnonzero(side * depth > 0.0)
        # Nearer bodies cover those behind.
        seen = seen[np.argsort(side * (points[quads[seen]].mean(axis=1) @ view), kind="stable")]
        mesh = PolyCollection(
            list(flat[quads[seen]]),
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
        draw_wall(axes, result, side * first, second, middle - seen_at)
        across, up = side * (seen_at @ first), seen_at @ second
        axes.set(aspect="equal", xlim=(across - wide, across + wide), ylim=(up - high, up + high))
        axes.set_title(name, loc="left", pad=4)
        name = names[0]
        if side < 0:
            plain = name[1:-1] if " " not in name else f"({name[1:-1]})"
            name = f"$-{plain}$" if name.startswith("$") else f"minus {name}"
        axes.set_xlabel(style.label(name, "c"))
    panels[0].set_ylabel(style.label(names[1], "c"))
    style.letter_panels(list(panels))
    colours = figure.colorbar(mesh, ax=list(panels), fraction=0.05, pad=0.02)
    colours.set_label(style.label(r"traction $|\mathbf{\sigma}\mathbf{n}|$", "mu/tau"))
    return figure


def _facets(surface: Mapping[str, Any], step: int) -> tuple[Array, Array, Array, Array]:
    """Points, tractions and normals (n, 3) of a surface, and the corners (m, 4) of its facets."""
    index = np.arange(len(surface["points"][step])).reshape([int(n) for n in surface["shape"]])
    after = np.roll(index, -1, axis=1)
    corners = index[:-1], index[1:], after[1:], after[:-1]
    quads = np.stack(corners, axis=-1).reshape(-1, 4)
    return *(surface[name][step] for name in ("points", "traction", "normals")), quads


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
