"""Animations of several bodies, or of one by a wall: all surfaces, the wall and the paths so far.

The camera stays where the whole motion is seen, unless it goes far: then it moves with the bodies.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np

from qbxstokes.geometry import rotation
from qbxstokes.plots import style
from qbxstokes.plots.bodies import outlines, wall_of
from qbxstokes.plots.camera import Camera
from qbxstokes.plots.picture_source import ResultLike
from qbxstokes.plots.surfaces import colours, mesh
from qbxstokes.typing import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from qbxstokes.plots.animation import Frames


# Ways longer than so many radii of the group are followed by the camera.
_FAR = 4.0
_LINES = 8  # of the wall's grid, each way, in each direction


def one_of(result: ResultLike, body: int) -> Any:
    """The motion of one of several bodies, as a result of it alone."""
    arrays = dict(result.arrays)
    for name in ("position", "orientation", "velocity", "angular_velocity", "axis"):
        if name in arrays and arrays[name].ndim == 3:
            arrays[name] = arrays[name][:, body]
    return SimpleNamespace(**{**vars(result), "arrays": arrays, "path": result.path})


class SceneView:
    """All bodies and the wall seen by one camera; `show` puts them at a frame.

    motions: of each body, at the same instants.
    """

    def __init__(
        self,
        axes: Axes,
        result: ResultLike,
        motions: list[Frames],
        camera: Camera,
    ) -> None:
        """Draw everything once, at the first frame."""
        from matplotlib.collections import PolyCollection

        self._motions, self._camera = motions, camera
        self._bodies = outlines(result, len(motions))
        self._meshes = [mesh(shape) for shape, _ in self._bodies]
        self._wall = wall_of(result)
        centres = np.stack([motion.position for motion in motions], axis=1)  # (F, N, 3)
        middle, arm = centres.mean(axis=1), max(s.radius * size for s, size in self._bodies)
        group = float(np.linalg.norm(centres - middle[:, None], axis=2).max()) + arm
        whole = 0.5 * (centres.max(axis=(0, 1)) + centres.min(axis=(0, 1)))
        span = float(np.linalg.norm(centres - whole, axis=2).max()) + arm
        self._focus = middle if span > _FAR * group else np.broadcast_to(whole, middle.shape)
        self._reach = group if span > _FAR * group else span
        limit = 1.1 * self._reach
        axes.set(xlim=(-limit, limit), ylim=(-limit, limit), aspect="equal")
        axes.set_axis_off()
        self._ground = axes.plot([], [], color=style.GREY, lw=0.5, zorder=0.5)[0]
        self._ways = [axes.plot([], [], color=style.GREY, lw=0.9, zorder=0.8)[0] for _ in motions]
        facets: Any = PolyCollection([], zorder=3, linewidths=0.5, closed=True)
        axes.add_collection(facets, autolim=False)
        self._facets = facets
        self._clock = axes.text(
            0.02, 0.98, "", transform=axes.transAxes, ha="left", va="top", zorder=6
        )
        self.show(0)

    def show(self, frame: int) -> None:
        """The scene at a frame."""
        focus, camera = self._focus[frame], self._camera
        corners, painted, depth = [], [], []
        for (facets, normals, shade), motion, (_, size) in zip(
            self._meshes, self._motions, self._bodies, strict=True
        ):
            turn, place = rotation.matrix(motion.orientation[frame]), motion.position[frame] - focus
            seen = normals @ turn.T @ camera.frame.T
            front = seen[:, 2] > -0.05
            where = size * facets[front] @ turn.T + place
            corners.append(where)
            painted.append(colours(shade[front], seen[front]))
            depth.append(camera.depth(where.mean(axis=1)))
        order = np.argsort(np.concatenate(depth), kind="stable")
        colour = np.concatenate(painted)[order]
        self._facets.set_verts(list(camera.project(np.concatenate(corners)[order])))
        self._facets.set_facecolor(colour)
        self._facets.set_edgecolor(colour)
        for way, motion in zip(self._ways, self._motions, strict=True):
            way.set_data(*camera.project(motion.position[: frame + 1] - focus).T)
        if self._wall is not None:
            self._ground.set_data(*self._grid(focus))
        self._clock.set_text(rf"$t = {self._motions[0].times[frame]:.2f}\,\tau$")

    def _grid(self, focus: Array) -> Array:
        """The wall as a grid of lines (2, n), with gaps between them, that stays in space."""
        assert self._wall is not None
        normal, point = self._wall
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
