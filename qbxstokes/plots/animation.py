"""Animations: the body as a shaded surface, its axis with a trail, and the way of its centre.

The camera moves with the centre. The path behind the body is drawn true to scale around it, and,
where the centre goes anywhere, once more whole in a panel beside it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from subprocess import CalledProcessError
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np

from qbxstokes.errors import CaseError
from qbxstokes.geometry import rotation
from qbxstokes.plots import style
from qbxstokes.plots.series import draw_path, moves, plane_of_motion
from qbxstokes.plots.source import (
    ResultLike,
    axis_path,
    between,
    coupled,
    instants,
    samples,
    shapes_of,
    vectors,
    wall_of,
)
from qbxstokes.plots.style import Figure
from qbxstokes.plots.views import SHADES, AxisView, Camera, GroupView, lit
from qbxstokes.typing import Array

if TYPE_CHECKING:
    from matplotlib.animation import FuncAnimation

FORMATS = ("gif", "mp4")
FRAMES_PER_TURN = 48
_FRAMES = (60, 360)  # least and most frames where their number is not given
_DPI = 120
_SIDE = 4.2  # inches of the picture
_VIEW = Camera(-62.0, 28.0)


@dataclass(frozen=True)
class Frames:
    """A trajectory at the instants of the frames.

    times (F,), position (F, 3), orientation (F, 4), and all the path of the axis: its times (n,)
    and points (n, 3).
    """

    times: Array
    position: Array
    orientation: Array
    axis_times: Array
    axis: Array

    @classmethod
    def of(
        cls,
        result: ResultLike,
        frames: int | None = None,
        window: tuple[float, float] | None = None,
    ) -> Frames:
        """The motion at `frames` even instants of the window of time, the whole by default.

        Without a number of frames there are `FRAMES_PER_TURN` for each turn of the axis, within
        limits. Raises CaseError where the file holds no orientation, or nothing in the window.
        """
        if "orientation" not in result.arrays:
            raise CaseError(f"{result.path}: holds no orientation to animate")
        times = instants(result)
        q = rotation.normalize(samples(result, "orientation", 4))
        # q and -q are one orientation; follow the nearer one.
        flips = np.sign(np.einsum("ij,ij->i", q[1:], q[:-1]))
        q[1:] *= np.cumprod(np.where(flips == 0.0, 1.0, flips))[:, None]
        spin = vectors(result, "angular_velocity")
        path_times, path = axis_path(times, rotation.axis(q), spin)
        low, high = window or (times[0], times[-1])
        low, high = max(low, times[0]), min(high, times[-1])
        if not low <= high:
            raise CaseError(
                f"{result.path}: has samples from {times[0]:g} to {times[-1]:g}, none in the window"
            )
        if frames is None:
            inside = (path_times >= low) & (path_times <= high)
            steps = np.linalg.norm(np.diff(path[inside], axis=0), axis=1)
            turns = float(np.sum(steps)) / (2.0 * np.pi)
            frames = int(np.clip(np.ceil(FRAMES_PER_TURN * turns), *_FRAMES))
        at = np.linspace(low, high, frames)
        rates = None
        if spin is not None:
            rates = 0.5 * rotation.multiply(np.insert(spin, 0, 0.0, axis=1), q)
        position = np.zeros((frames, 3))
        if "position" in result.arrays:
            centre = samples(result, "position", 3)
            position = between(times, centre, vectors(result, "velocity"), at)
        turned = rotation.normalize(between(times, q, rates, at))
        return cls(at, position, turned, path_times, path)


def _palette() -> list[int]:
    """The 256 colours of a GIF: the surface in all lights, and lines fading into white."""
    from matplotlib.colors import to_rgb

    light = np.linspace(0.0, 1.0, 80)
    surface = [lit(np.full(len(light), shade), light) for shade in range(len(SHADES))]
    lines = (style.BLACK, style.GREY, style.BLUE, style.PALE_BLUE, style.VERMILION)
    fade = np.linspace(0.0, 1.0, 16)[:, None]
    faded = [fade + (1.0 - fade) * np.array(to_rgb(color)) for color in lines]
    colors = np.concatenate([*surface, *faded])
    return np.rint(255.0 * colors).astype(int).ravel().tolist()


@dataclass(frozen=True)
class Film:
    """An animation: a figure, and a function that brings it to a frame."""

    figure: Figure
    show: Callable[[int], None]
    frames: int
    fps: int

    def live(self) -> FuncAnimation:
        """The animation as matplotlib's, for a notebook (`to_jshtml`) or a window."""
        from matplotlib.animation import FuncAnimation

        with style.styled():
            return FuncAnimation(
                self.figure, self.show, frames=self.frames, interval=1000 / self.fps, blit=False
            )

    def save(self, path: Path) -> Path:
        """Write a GIF (by Pillow) or an MP4 (by ffmpeg); raises CaseError where it cannot."""
        kind = path.suffix[1:]
        if kind not in FORMATS:
            raise CaseError(f"{path}: animations are written as {', '.join(FORMATS)}")
        with style.whole_file(path) as temporary, style.styled():
            (self._save_gif if kind == "gif" else self._save_mp4)(temporary)
        return path

    def _save_gif(self, path: Path) -> None:
        """One palette for all frames: files stay small and colours do not flicker."""
        from PIL import Image

        palette = Image.new("P", (1, 1))
        palette.putpalette(_palette())
        pictures = []
        canvas: Any = self.figure.canvas
        for frame in range(self.frames):
            self.show(frame)
            canvas.draw()
            picture = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
            pictures.append(picture.quantize(palette=palette, dither=Image.Dither.NONE))
        pictures[0].save(
            path,
            format="GIF",
            save_all=True,
            append_images=pictures[1:],
            duration=max(20, round(1000 / self.fps)),
            loop=0,
        )

    def _save_mp4(self, path: Path) -> None:
        from matplotlib.animation import FFMpegWriter

        if not FFMpegWriter.isAvailable():
            raise CaseError("MP4 needs the program ffmpeg; install it or take --format gif")
        writer = FFMpegWriter(fps=self.fps)
        try:
            with writer.saving(self.figure, str(path), _DPI):
                for frame in range(self.frames):
                    self.show(frame)
                    writer.grab_frame()
        except CalledProcessError as error:
            raise CaseError(
                f"ffmpeg ended with status {error.returncode}; take --format gif instead"
            ) from None


def animate(
    result: ResultLike,
    frames: int | None = None,
    fps: int = 25,
    window: tuple[float, float] | None = None,
) -> Film:
    """The animation of a motion over a window of time, the whole by default.

    Raises CaseError and ResultFileError where the file does not hold what is needed.
    """
    if coupled(result):
        return _animate_together(result, frames, fps, window)
    motion = Frames.of(result, frames, window)
    beside = moves(result)
    width = 2.0 * _SIDE if beside else _SIDE
    with style.styled():
        figure = _blank(width)
        axes = figure.add_axes((0.0, 0.0, _SIDE / width, 1.0))
        scene = AxisView(axes, motion, shapes_of(result)[0][0], _VIEW)
        place = _place_beside(figure, result, motion) if beside else None

    def show(frame: int) -> None:
        scene.show(frame)
        if place is not None:
            place(frame)

    return Film(figure, show, len(motion.times), fps)


def _animate_together(
    result: ResultLike, frames: int | None, fps: int, window: tuple[float, float] | None
) -> Film:
    """The animation of several bodies, or of one by a wall."""
    if "position" not in result.arrays or "orientation" not in result.arrays:
        raise CaseError(f"{result.path}: holds no position and orientation to animate")
    count = result.arrays["position"].shape[1] if result.arrays["position"].ndim == 3 else 1
    alone = [_one_of(result, body) for body in range(count)]
    if frames is None:
        frames = max(len(Frames.of(one, None, window).times) for one in alone)
    motions = [Frames.of(one, frames, window) for one in alone]
    wall, camera = wall_of(result), _VIEW
    if wall is not None and abs(wall[0][1]) > 0.7:  # a floor, or a ceiling, of a shear
        camera = replace(_VIEW, azimuth=_VIEW.azimuth + 90.0, up=1)
    with style.styled():
        figure = _blank(_SIDE)
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        scene = GroupView(axes, shapes_of(result, count), motions, camera, wall)
    return Film(figure, scene.show, frames, fps)


def _one_of(result: ResultLike, body: int) -> Any:
    """The motion of one of several bodies, as a result of it alone."""
    arrays = dict(result.arrays)
    for name in ("position", "orientation", "velocity", "angular_velocity", "axis"):
        if name in arrays and arrays[name].ndim == 3:
            arrays[name] = arrays[name][:, body]
    return SimpleNamespace(**{**vars(result), "arrays": arrays, "path": result.path})


def _blank(width: float) -> Figure:
    figure = style.new_figure(width, _SIDE)
    figure.set_dpi(_DPI)
    figure.set_layout_engine("none")
    return figure


def _place_beside(figure: Figure, result: ResultLike, motion: Frames) -> Callable[[int], None]:
    """The path of the centre beside the scene; returns what moves the dot on it.

    The panel does not change, so it is drawn once and put in as a picture.
    """
    box = (0.585, 0.13, 0.39, 0.78)
    still = _blank(figure.get_figwidth())
    panel = still.add_axes(box)
    draw_path(panel, result)
    canvas: Any = still.canvas
    canvas.draw()
    figure.figimage(np.asarray(canvas.buffer_rgba()), zorder=-1)
    axes = figure.add_axes(panel.get_position().bounds)
    axes.set_xlim(panel.get_xlim())
    axes.set_ylim(panel.get_ylim())
    axes.set_axis_off()
    (dot,) = axes.plot([], [], "o", color=style.VERMILION, ms=6, mec="white")
    along, across = plane_of_motion(samples(result, "position", 3))

    def place(frame: int) -> None:
        here = motion.position[frame]
        dot.set_data([here[along]], [here[across]])

    return place
