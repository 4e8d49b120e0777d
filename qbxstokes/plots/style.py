"""How all pictures look: fonts, sizes, colours, line styles, labels, and how they are saved.

Sizes are those of printed columns, so that a figure goes into a paper without being scaled. The
colours are those of Okabe and Ito (2008, Color Universal Design), told apart by people with any
colour vision; every line also has its own dashes and lightness, for print in grey. Figures are
made without pyplot: no window, no backend is chosen, no global state is touched.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from io import BytesIO
from math import floor, inf, log10
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from qbxstokes import __version__
from qbxstokes.errors import CaseError
from qbxstokes.typing import Array

FORMATS = ("pdf", "svg", "png")
# What matplotlib calls so: annotations alone name them, so that nothing imports it without drawing.
Axes: TypeAlias = Any
Figure: TypeAlias = Any
# Pictures by their kind, each made when it is called.
Drawings = dict[str, Callable[[], Figure]]

# Widths of a column and of a page in inches (86 mm and 178 mm, common to physics journals).
COLUMN = 3.4
PAGE = 7.0
TALL = 10.6  # what A4 leaves of its 11.7 inches

BLACK = "#000000"
GREY = "#8c8c8c"
PALE = "#d9d9d9"
BLUE = "#0072b2"
PALE_BLUE = "#9cc3dc"  # what lies behind
VERMILION = "#d55e00"
SKY = "#56b4e9"
GREEN = "#009e73"
PURPLE = "#cc79a7"
ORANGE = "#e69f00"
SEQUENTIAL = "viridis"  # lightness rises evenly: readable in grey and with any colour vision

# Axes that pictures are drawn into, see `into`.
_given: ContextVar[_Given | None] = ContextVar("given", default=None)

# One line style per curve: colour, dashes, marker.
LINES: tuple[tuple[str, Any, str], ...] = (
    (BLUE, "solid", "o"),
    (VERMILION, (0, (5, 1.5)), "s"),
    (SKY, (0, (5, 1.2, 1, 1.2)), "^"),
    (BLACK, (0, (1, 1.2)), "D"),
    (GREEN, (0, (7, 1.2, 1, 1.2, 1, 1.2)), "v"),
    (PURPLE, (0, (3, 1)), "P"),
    (ORANGE, (0, (9, 2)), "X"),
)
# More samples than this are drawn as pixels inside vector files, which stay small.
RASTER_LIMIT = 20_000

_TICKS = {
    "labelsize": 8,
    "direction": "in",
    "major.width": 0.6,
    "major.size": 3,
    "minor.width": 0.4,
    "minor.size": 1.6,
}
_SETTINGS: dict[str, Any] = {
    "font.family": "serif",
    "font.serif": ["STIXGeneral"],  # comes with matplotlib, so every machine has it
    "mathtext.fontset": "stix",
    "font.size": 9,
    "axes.titlesize": 9,
    "axes.labelsize": 9,
    "legend.fontsize": 8,
    "legend.frameon": False,
    "legend.borderaxespad": 0.3,
    "legend.handlelength": 2.6,
    "legend.columnspacing": 1.4,
    "lines.linewidth": 1.1,
    "lines.markersize": 3.5,
    "lines.solid_capstyle": "round",
    "axes.linewidth": 0.6,
    "axes.formatter.limits": (-3, 4),
    "axes.formatter.useoffset": False,
    "axes.formatter.use_mathtext": True,
    "axes.titley": 1.0,  # else looked for at every layout
    "axes.xmargin": 0.02,
    "axes.grid": False,
    "grid.linewidth": 0.4,
    "grid.color": PALE,
    "xtick.top": True,
    "ytick.right": True,
    **{f"{axis}tick.{key}": value for axis in "xy" for key, value in _TICKS.items()},
    "image.cmap": SEQUENTIAL,
    "figure.dpi": 72,  # as of vector files
    "figure.constrained_layout.use": True,
    "savefig.dpi": 300,
    "savefig.facecolor": "white",
    "pdf.fonttype": 42,  # real fonts: text can be selected and edited
    "svg.fonttype": "path",  # looks the same where the fonts are missing
    "svg.hashsalt": "qbxstokes",  # the same picture is the same file
    "path.simplify_threshold": 0.05,
    "agg.path.chunksize": 20_000,
}


@contextmanager
def styled() -> Iterator[None]:
    """Everything drawn or saved inside the block follows this module.

    All its renderers share one parser of formulas, where each of matplotlib's would parse them all
    anew, which is a third of the time of a picture.

    >>> with styled():  # doctest: +SKIP
    ...     drawn = new_figure(COLUMN, 2.4)
    """
    import matplotlib
    from matplotlib import text, textpath

    own = text.TextToPath
    with matplotlib.rc_context():
        matplotlib.rcdefaults()  # nobody's matplotlibrc changes the pictures
        matplotlib.rcParams.update(_SETTINGS)
        text.TextToPath = lambda: textpath.text_to_path  # type: ignore[assignment, misc]
        try:
            yield
        finally:
            text.TextToPath = own  # type: ignore[misc]


def new_figure(width: float, height: float) -> Figure:
    """An empty figure of the given size in inches, drawn by Agg and laid out by itself."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    if axes := _given.get():
        return axes
    figure: Figure = _picture()(figsize=(width, height))
    FigureCanvasAgg(figure)
    return figure


def panels(
    count: int, columns: int, width: float, height: Callable[[int], float], shared: bool = False
) -> tuple[Figure, list[Axes]]:
    """A figure with panels in rows of so many, whose height follows from the number of rows.

    shared: all have the axes of the first, which only those at the edges name.
    """
    columns = min(columns, count)
    rows = -(-count // columns)
    figure, drawn = new_figure(width, height(rows)), list[Axes]()
    for place in range(count):
        with_first = drawn[0] if shared and drawn else None
        axes = figure.add_subplot(rows, columns, place + 1, sharex=with_first, sharey=with_first)
        if shared:
            axes.tick_params(labelbottom=place + columns >= count, labelleft=place % columns == 0)
        drawn.append(axes)
    return figure, drawn


@cache
def _picture() -> Any:
    from matplotlib import figure

    class Picture(figure.Figure):
        """A figure that a notebook shows."""

        def _repr_png_(self) -> bytes:
            with styled(), BytesIO() as stream:
                _lay_out(self)
                self.savefig(stream, format="png", dpi=150)
                return stream.getvalue()

    return Picture


class _Given:
    """Axes of the user's in the place of a figure: it gives them out where one makes its own."""

    def __init__(self, axes: Sequence[Axes]) -> None:
        self._axes, self._left = axes, list(axes)

    def add_subplot(self, *_: Any, **__: Any) -> Axes:
        if not self._left:
            raise CaseError(f"the picture has more panels than the axes given, {len(self._axes)}")
        return self._left.pop(0)

    def subplots(self, rows: int = 1, columns: int = 1, **_: Any) -> Any:
        found = [self.add_subplot() for _ in range(rows * columns)]
        return found[0] if len(found) == 1 else found

    def __getattr__(self, name: str) -> Any:
        return getattr(self._axes[0].figure, name)


@contextmanager
def into(axes: Sequence[Axes]) -> Iterator[None]:
    """Within it pictures are drawn into these axes, and no figure is made."""
    token = _given.set(_Given(axes))
    try:
        yield
    finally:
        _given.reset(token)


def fit_height(figure: Figure, axes: Axes) -> None:
    """Give a figure of one panel, true to scale, the height it needs; never one of the user's."""
    if not isinstance(figure, _Given):
        legend = 0.2 if axes.get_legend() else 0.0
        height = (PAGE - 0.5) * np.ptp(axes.get_ylim()) / np.ptp(axes.get_xlim())
        figure.set_figheight(float(np.clip(height, 0.5, 6.0)) + 0.5 + legend)


def line_style(index: int, markers: bool = False) -> dict[str, Any]:
    """Keywords of the curve number `index`: colour, dashes, and a marker where asked for."""
    color, dashes, marker = LINES[index % len(LINES)]
    style: dict[str, Any] = {"color": color, "linestyle": dashes}
    if markers:
        style |= {"marker": marker, "markerfacecolor": "white", "markeredgewidth": 0.9}
    return style


def draw_curve(
    axes: Axes, number: int, x: Array, y: Array, name: str, around: Array | None = None
) -> None:
    """The curve of that number in its own style, with a band of a half width around it."""
    look = line_style(number)
    axes.plot(x, y, label=name, **look)
    if around is not None:
        band = {"color": look["color"], "alpha": 0.25, "linewidth": 0}
        axes.fill_between(x, y - around, y + around, **band)


def units_text(units: str) -> str:
    """Units as a formula: "mu c^2/tau" becomes "$\\mu c^2/\\tau$"; nothing for a pure number."""
    if units in ("", "1"):
        return ""
    if units in ("rad", "deg", "s", "B"):
        return units
    shown = re.sub(r"^1/tau\^?(\d?)$", lambda power: f"tau^{{-{power[1] or 1}}}", units)
    return "$" + re.sub(r"\b(mu|tau)\b", r"\\\1", shown) + "$"


def label(text: str, units: str = "") -> str:
    """An axis label: the quantity, and its units in parentheses where it has some."""
    shown = units_text(units)
    return f"{text} ({shown})" if text and shown else text or shown


def set_ylabel(axes: Axes, text: str, unit: str = "") -> None:
    """Label a linear ordinate; a power of ten stands beside the units, where legends leave it.

    To be called when everything is drawn.
    """
    low, high = axes.get_ylim()
    size = max(abs(low), abs(high))
    power = floor(log10(size)) if 0.0 < size < inf else 0
    if -3 < power < 4:
        axes.set_ylabel(label(text, unit))
        return
    factor = rf"10^{{{power}}}"
    shown = units_text(unit).strip("$")
    axes.set_ylabel(f"{text} (${factor}\\,{shown}$)" if shown else f"{text} (${factor}$)")
    axes.yaxis.set_major_formatter(
        lambda value, _: f"{round(value / 10.0**power, 9):g}".replace("-", "\u2212")
    )


def legend_above(axes: Axes, columns: int | None = None, handle: float | None = None) -> None:
    """A legend above the axes, where it cannot cover data; in as many columns as there is room for.

    `handle` is the length of a sample, shorter for mere markers.
    """
    handles, names = axes.get_legend_handles_labels()
    if handles:
        place = axes.get_subplotspec()
        share = 1.0 if place is None else len(place.colspan) / place.get_gridspec().ncols
        width = share * axes.figure.bbox.width / axes.figure.dpi
        axes.legend(
            handles,
            names,
            loc="lower left",
            bbox_to_anchor=(0.0, 1.0),
            ncol=columns or _fitting(names, width),
            handlelength=handle,
        )


def legend_on_top(figure: Figure, panels: Sequence[Axes]) -> None:
    """One legend for all panels of a figure, above them; above the first of axes of the user's."""
    handles, names = panels[0].get_legend_handles_labels()
    engine = None if isinstance(figure, _Given) else figure.get_layout_engine()
    if engine is None:
        legend_above(panels[0])
    elif len(handles) > 1:
        columns = _fitting(names, figure.get_figwidth())
        figure.legend(handles, names, loc="upper left", ncol=columns)
        room = 0.19 * -(-len(names) // columns) / figure.get_figheight()
        engine.set(rect=(0.0, 0.0, 1.0, 1.0 - room))


def _fitting(names: Sequence[str], width: float) -> int:
    """Columns of a legend with these names that fit into a width in inches."""
    signs = (re.sub(r"\\\w+|[${}^_\\]", "", name) for name in names)
    return max(1, min(len(names), int(22.0 * width) // (max(map(len, signs)) + 12)))


def letter_panels(panels: Sequence[Axes]) -> None:
    """(a), (b), ... at the upper right, above the axes, where there is more than one panel."""
    if len(panels) > 1:
        for index, axes in enumerate(panels):
            axes.set_title(f"({chr(ord('a') + index)})", loc="right", pad=4)


def save(figure: Figure, path: Path, dpi: float = 300.0) -> Path:
    """Write the figure in the format of the name's ending; raises CaseError where it cannot.

    The file appears under its name only when it is whole. An older picture is replaced.
    """
    kind = path.suffix[1:]
    if kind not in FORMATS:
        raise CaseError(f"{path}: pictures are written as {', '.join(FORMATS)}")
    metadata: dict[str, dict[str, str | None]] = {
        "pdf": {"Creator": f"qbxstokes {__version__}", "CreationDate": None},
        "svg": {"Creator": f"qbxstokes {__version__}", "Date": None},
        "png": {"Software": f"qbxstokes {__version__}"},
    }
    drawn = BytesIO()  # on a full disk matplotlib's own files end in errors of many kinds
    with styled():
        _lay_out(figure)
        figure.savefig(drawn, format=kind, metadata=metadata[kind], dpi=dpi)
    with whole_file(path) as temporary:
        temporary.write_bytes(drawn.getbuffer())
    return path


def _lay_out(figure: Figure) -> None:
    """Find the places of all parts once, and spare numbers without a power the parser of formulas.

    Labels of panels above one another are aligned afterwards: matplotlib looks at all others for
    each of them. Together this was two thirds of the time of a picture.
    """
    import matplotlib
    from matplotlib.ticker import ScalarFormatter

    low, high = (10.0**power for power in _SETTINGS["axes.formatter.limits"])
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            formatter = axis.get_major_formatter()
            size = max(map(abs, axis.get_view_interval()))
            if isinstance(formatter, ScalarFormatter) and low <= size < high:
                formatter.set_useMathText(False)
    engine = figure.get_layout_engine()
    if engine is None:
        return
    engine.execute(figure)
    with matplotlib.rc_context({"figure.constrained_layout.use": False}):
        figure.set_layout_engine(None)  # with "none", saving draws it once more for its layout
    renderer = figure.canvas.get_renderer()
    left: dict[float, list[Axes]] = {}
    for axes in figure.axes:
        if axes.get_ylabel() and axes.yaxis.label_position == "left":
            axes.apply_aspect()
            axes.yaxis.get_tightbbox(renderer)  # puts the label where the ticks leave off
            left.setdefault(round(axes.get_position().x0, 6), []).append(axes)
    for column in left.values():
        labels = [axes.yaxis.label for axes in column]
        # In pixels, also where an earlier file has put the label at a part of the axes.
        place = min(t.get_transform().transform(t.get_position())[0] for t in labels)
        for axes in column:
            axes.yaxis.set_label_coords((place - axes.bbox.x0) / axes.bbox.width, 0.5)


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """A temporary name beside `path` that becomes `path` when the block succeeds."""
    temporary = path.with_name(f".{path.stem}.{os.getpid()}.part{path.suffix}")
    try:
        yield temporary
        os.replace(temporary, path)
    except OSError as error:
        raise CaseError(f"{path}: cannot be written ({error.strerror or error})") from None
    finally:
        temporary.unlink(missing_ok=True)
