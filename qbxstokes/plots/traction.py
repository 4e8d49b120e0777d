"""The traction on the bodies of a field, from two sides."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from qbxstokes.plots import style
from qbxstokes.plots.bodies import draw_wall
from qbxstokes.plots.instant import members_of, name_of, surfaces_of, view_of
from qbxstokes.plots.picture_source import ResultLike
from qbxstokes.plots.style import Figure
from qbxstokes.typing import Array

# Arrows of the traction: distance between them over the half width of the picture, and the least
# length over the longest.
_SPACING, _SHORTEST = 0.12, 0.1
# Median over largest traction below which colours are logarithmic, and their range then.
_PEAKED, _RANGE = 0.12, 1e-2


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
