"""Bodies in space as one camera sees them: shaded surfaces, paths so far, a wall, the axis's trail.

The camera is at infinity. Its parallel projection is done by hand instead of by matplotlib's 3-D
axes: what is hidden is known exactly, lengths across the line of sight are true, and vector files
stay small.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.geometry import rotation
from qbxstokes.geometry.shape import Revolution
from qbxstokes.plots import style
from qbxstokes.plots.style import Axes
from qbxstokes.typing import Array, Indices

# Ways longer than so many radii of the group are followed by the camera; lines of the wall's grid,
# each way, in each direction.
_FAR, _LINES = 4.0, 8
SHADES = ("#3f8fc0", "#d8e6ef")
_SECTORS = 4  # of longitude, in two shades, so that the turning about the axis is seen
_LIGHT = np.array([-0.45, 0.65, 0.61])  # right, up, towards the viewer


@dataclass(frozen=True)
class Camera:
    """Looks at the origin from the direction (azimuth, elevation), in degrees, with x3 upwards.

    up: another coordinate (0, 1, 2) upwards; azimuths then go round it.
    """

    azimuth: float = 25.0
    elevation: float = 22.0
    up: int = 2

    @cached_property
    def frame(self) -> Array:
        """Rows: right, up, and towards the viewer (3, 3)."""
        a, e = np.radians(self.azimuth), np.radians(self.elevation)
        right = np.array([-np.sin(a), np.cos(a), 0.0])
        towards = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
        return np.roll(np.stack([right, np.cross(towards, right), towards]), self.up - 2, axis=1)

    def project(self, points: ArrayLike) -> Array:
        """Coordinates on paper (..., 2) of points (..., 3)."""
        return np.asarray(np.asarray(points, dtype=float) @ self.frame[:2].T)

    def depth(self, points: ArrayLike) -> Array:
        """Distance towards the viewer (...) of points (..., 3); positive is in front."""
        return np.asarray(np.asarray(points, dtype=float) @ self.frame[2])


def split_at_silhouette(points: Array, depth: Array) -> tuple[list[Array], list[Array]]:
    """A curve (n, 3) as its pieces before (depth >= 0) and behind the silhouette.

    The pieces meet at the points where the depth, linear between samples, is zero.
    """
    front: list[Array] = []
    back: list[Array] = []
    if not len(points):
        return front, back
    ahead = depth >= 0.0
    changes = np.flatnonzero(ahead[1:] != ahead[:-1])
    share = depth[changes] / (depth[changes] - depth[changes + 1])
    crossing = points[changes] + share[:, None] * (points[changes + 1] - points[changes])
    edges = [0, *(changes + 1).tolist(), len(points)]
    for index, (start, stop) in enumerate(pairwise(edges)):
        parts = [points[start:stop]]
        if index > 0:
            parts.insert(0, crossing[index - 1 : index])
        if index < len(changes):
            parts.append(crossing[index : index + 1])
        (front if ahead[start] else back).append(np.concatenate(parts))
    return front, back


def lit(shade: Indices, light: Array) -> Array:
    """Colours (n, 3) of surface in the shades (n,) where light (n,) in [0, 1] falls on it."""
    from matplotlib.colors import to_rgb

    base = np.array([to_rgb(color) for color in SHADES])[shade]
    colors: Array = base * (0.5 + 0.5 * light[:, None]) + 0.25 * light[:, None] ** 12
    return np.clip(colors, 0.0, 0.96)


def colours(shade: Array, seen: Array) -> Array:
    """Colours (n, 3) of facets of a shade (n,) with normals (n, 3) as the camera sees them."""
    light = np.clip(seen @ (_LIGHT / np.linalg.norm(_LIGHT)), 0.0, 1.0)
    return lit(shade.astype(int), light)


def mesh(shape: Revolution) -> tuple[Array, Array, Array]:
    """Corners (n, 4, 3), normals (n, 3) and shade (n,) of the facets, in the body frame."""
    theta = np.linspace(0.0, np.pi, 31)
    phi = np.linspace(0.0, 2.0 * np.pi, 61)
    corners = shape.surface(theta[:, None], phi[None, :])
    facets = np.stack(
        [corners[:-1, :-1], corners[1:, :-1], corners[1:, 1:], corners[:-1, 1:]], axis=2
    ).reshape(-1, 4, 3)
    middle = 0.5 * (theta[1:] + theta[:-1]), 0.5 * (phi[1:] + phi[:-1])
    normals = shape.normal(middle[0][:, None], middle[1][None, :]).reshape(-1, 3)
    sector = np.floor(middle[1] / (2.0 * np.pi) * _SECTORS).astype(int) % 2
    return facets, normals, np.tile(sector, len(middle[0])).astype(float)


class View:
    """Bodies and the paths of their centres, from a camera that looks at `focus` (F, 3).

    bodies: shape and size of each. motions: of each, at the instants of the frames. reach: half the
    width of what is seen.
    """

    def __init__(
        self,
        axes: Axes,
        bodies: list[tuple[Revolution, float]],
        motions: list[Any],
        camera: Camera,
        focus: Array,
        reach: float,
    ) -> None:
        from matplotlib.collections import PolyCollection

        self._axes, self._motions, self._camera, self._focus = axes, motions, camera, focus
        self._meshes = [(*mesh(shape), size) for shape, size in bodies]
        axes.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal")
        axes.set_axis_off()
        self._ways = [axes.plot([], [], color=style.GREY, lw=0.9, zorder=0.8)[0] for _ in motions]
        self._facets = PolyCollection([], zorder=3, linewidths=0.6, closed=True)
        axes.add_collection(self._facets, autolim=False)
        corner = {"transform": axes.transAxes, "ha": "left", "va": "top", "zorder": 6}
        self._clock = axes.text(0.02, 0.98, "", **corner)

    def show(self, frame: int) -> None:
        """The scene at a frame."""
        focus, camera = self._focus[frame], self._camera
        corners, painted = [], []
        for (facets, normals, shade, size), motion in zip(self._meshes, self._motions, strict=True):
            turn = rotation.matrix(motion.orientation[frame])
            seen = normals @ turn.T @ camera.frame.T
            front = seen[:, 2] > -0.05
            corners.append(size * facets[front] @ turn.T + motion.position[frame] - focus)
            painted.append(colours(shade[front], seen[front]))
        where, colour = np.concatenate(corners), np.concatenate(painted)
        # From the back to the front, so that nearer facets cover those behind.
        order = np.argsort(camera.depth(where.mean(axis=1)), kind="stable")
        self._facets.set_verts(list(camera.project(where[order])))
        self._facets.set_facecolor(colour[order])
        self._facets.set_edgecolor(colour[order])
        for way, motion in zip(self._ways, self._motions, strict=True):
            way.set_data(*camera.project(self._path(motion, frame) - focus).T)
        self._clock.set_text(rf"$t = {self._motions[0].times[frame]:.2f}\,\tau$")

    def _path(self, motion: Any, frame: int) -> Array:
        """The path so far (n, 3), as far as it is drawn."""
        return np.asarray(motion.position[: frame + 1])


class GroupView(View):
    """Several bodies, or one by a wall (its normal and a point of it).

    The camera stays where the whole motion is seen, unless it goes far: then it moves with them.
    """

    def __init__(
        self,
        axes: Axes,
        bodies: list[tuple[Revolution, float]],
        motions: list[Any],
        camera: Camera,
        wall: tuple[Array, Array] | None,
    ) -> None:
        centres = np.stack([motion.position for motion in motions], axis=1)  # (F, N, 3)
        middle, arm = centres.mean(axis=1), max(shape.radius * size for shape, size in bodies)
        group = float(np.linalg.norm(centres - middle[:, None], axis=2).max()) + arm
        whole = 0.5 * (centres.max(axis=(0, 1)) + centres.min(axis=(0, 1)))
        span = float(np.linalg.norm(centres - whole, axis=2).max()) + arm
        far = span > _FAR * group
        focus = middle if far else np.broadcast_to(whole, middle.shape)
        self._wall, self._reach = wall, group if far else span
        super().__init__(axes, bodies, motions, camera, focus, 1.1 * self._reach)
        self._ground = axes.plot([], [], color=style.GREY, lw=0.5, zorder=0.5)[0]
        self.show(0)

    def show(self, frame: int) -> None:
        """The scene at a frame."""
        super().show(frame)
        if self._wall is not None:
            self._ground.set_data(*self._grid(*self._wall, self._focus[frame]))

    def _grid(self, normal: Array, point: Array, focus: Array) -> Array:
        """The wall as a grid of lines (2, n), with gaps between them, that stays in space."""
        across = np.linalg.svd(normal[None])[2][1:]
        step = self._reach / _LINES
        foot = focus - ((focus - point) @ normal) * normal
        begin = np.floor((foot - point) @ across.T / step)
        steps = np.arange(-_LINES, _LINES + 1)
        parts = []
        for one, other in ((0, 1), (1, 0)):
            for number in steps:
                ends = np.zeros((3, 2))
                ends[:, one] = step * (begin[one] + number)
                ends[:2, other] = step * (begin[other] + steps[[0, -1]])
                line = point + ends @ across - focus
                line[2] = np.nan
                parts.append(line)
        return np.asarray(self._camera.project(np.concatenate(parts)).T)


class AxisView(View):
    """One body, with its axis and the trail of its tip; the camera moves with the centre."""

    def __init__(self, axes: Axes, motion: Any, shape: Revolution, camera: Camera) -> None:
        self._tip_at = 1.35 * shape.radius
        focus, reach = motion.position, 1.12 * self._tip_at
        super().__init__(axes, [(shape, 1.0)], [motion], camera, focus, reach)
        self._trails = [
            axes.plot([], [], color=color, lw=width, zorder=zorder, solid_capstyle="butt")[0]
            for color, width, zorder in (
                ("#c9c9c9", 0.7, 1.0),  # behind, older
                (style.PALE_BLUE, 1.1, 1.1),  # behind, latest turn
                ("#c9c9c9", 0.7, 4.0),
                (style.BLUE, 1.6, 4.1),
            )
        ]
        self._pins = [axes.plot([], [], color=style.BLACK, lw=1.6)[0] for _ in range(2)]
        self._tip = axes.plot([], [], "o", ms=4, color=style.VERMILION)[0]
        self._draw_triad(0.78 * reach, 0.80 * reach, 0.16 * reach)
        self.show(0)

    def show(self, frame: int) -> None:
        """The scene at a frame."""
        super().show(frame)
        motion, camera = self._motions[0], self._camera
        axis = rotation.axis(motion.orientation[frame])
        ahead = camera.depth(axis) >= 0.0
        for pin, sign in zip(self._pins, (1.0, -1.0), strict=True):
            pin.set_data(*camera.project(np.outer([sign, sign * self._tip_at], axis)).T)
            pin.set_zorder(3.5 if ahead == (sign > 0.0) else 2.0)
        self._tip.set_data(*camera.project(self._tip_at * axis[None]).T)
        self._tip.set_zorder(4.5 if ahead else 2.1)
        # The path of the tip so far; the last turn stronger than what was before.
        shown = (motion.axis_times >= motion.times[0]) & (motion.axis_times < motion.times[frame])
        path = self._tip_at * np.concatenate([motion.axis[shown], axis[None]])
        steps = np.linalg.norm(np.diff(path, axis=0), axis=1) / self._tip_at
        latest = int(np.searchsorted(-np.cumsum(steps[::-1])[::-1], -2.0 * np.pi))
        for index, piece in enumerate((path[: latest + 1], path[latest:])):
            front, behind = split_at_silhouette(piece, camera.depth(piece))
            self._trails[index].set_data(*self._joined(behind))
            self._trails[2 + index].set_data(*self._joined(front))

    def _path(self, motion: Any, frame: int) -> Array:
        """The path near the body."""
        past = motion.position[: frame + 1]
        away = np.linalg.norm(past - past[-1], axis=1) > 4.0 * self._tip_at
        return np.asarray(past[np.flatnonzero(away)[-1] if away.any() else 0 :])

    def _joined(self, pieces: list[Array]) -> Array:
        """Projected pieces as one line with gaps (2, n)."""
        gap = np.full((1, 2), np.nan)
        parts = [part for piece in pieces for part in (self._camera.project(piece), gap)]
        return np.concatenate(parts).T if parts else np.empty((2, 0))

    def _draw_triad(self, left: float, down: float, length: float) -> None:
        """The directions of space in the lower left corner."""
        arrow = {"arrowstyle": "->", "lw": 0.7, "shrinkA": 0, "shrinkB": 0}
        start = np.array([-left, -down])
        for index, direction in enumerate(length * np.eye(3)):
            tip = self._camera.project(direction)
            self._axes.annotate("", start + tip, start, arrowprops=arrow, zorder=0.5)
            centred = {"ha": "center", "va": "center", "fontsize": 8}
            self._axes.text(*(start + 1.35 * tip), f"$x_{index + 1}$", **centred)
