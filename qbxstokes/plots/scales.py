"""Scales of axes and colours, and the cells of maps."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from qbxstokes.plots import style
from qbxstokes.plots.style import Axes
from qbxstokes.typing import AnyArray

SCALES = {
    "loglog": ("log", "log"),
    "semilogx": ("log", "linear"),
    "semilogy": ("linear", "log"),
    "linear": ("linear", "linear"),
}
_SPREAD = 50.0  # positive values over more than this factor are drawn on a logarithmic axis


def is_log(values: AnyArray) -> bool:
    """Whether values are best seen on a logarithmic axis: none negative, over a wide range."""
    finite = values[np.isfinite(values)]
    positive = finite[finite > 0.0]
    wide = bool(positive.size and positive.max() > _SPREAD * positive.min())
    return wide and 2 * positive.size > finite.size and not np.any(finite < 0.0)


def set_scales(axes: Axes, spec: Mapping[str, Any], x: AnyArray, y: AnyArray) -> None:
    """Scales of both axes: those of the description, or what suits the values."""
    chosen = ["log" if is_log(values) else "linear" for values in (x, y)]
    scale_x, scale_y = SCALES[spec["scale"]] if "scale" in spec else chosen
    axes.set_xscale(scale_x)
    axes.set_yscale(scale_y)


def edges(places: AnyArray, scale: str) -> AnyArray:
    """Borders of cells around their centres, halfway on the scale of the axis."""
    at = np.log(places) if scale == "log" else places
    if len(at) == 1:
        half = 0.5 if scale == "log" else 0.5 * (abs(at[0]) or 1.0)
        edges = np.array([at[0] - half, at[0] + half])
    else:
        middle = 0.5 * (at[1:] + at[:-1])
        edges = np.concatenate([[2 * at[0] - middle[0]], middle, [2 * at[-1] - middle[-1]]])
    return np.exp(edges) if scale == "log" else edges


def power(level: float) -> str:
    """A level of contour lines on a logarithmic scale."""
    exponent = math.log10(level)
    return f"$10^{{{round(exponent)}}}$" if abs(exponent - round(exponent)) < 1e-9 else f"{level:g}"


def shades(values: Sequence[float]) -> Any:
    """Colours of curves by a number, evenly spaced in its logarithm where it spans decades."""
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import ListedColormap

    # The palest tenth of the colours is too light for a line on white.
    colours = colormaps[style.SEQUENTIAL](np.linspace(0.0, 0.9, 256))
    return ScalarMappable(colours_of(np.array(values))[0], ListedColormap(colours))


def colours_of(values: AnyArray) -> tuple[Any, bool]:
    """How values become colours, and whether by their logarithm."""
    from matplotlib.colors import LogNorm, Normalize

    low, high = float(values.min()), float(values.max())
    logarithmic = is_log(values) and low > 0.0
    return (LogNorm if logarithmic else Normalize)(low, high), logarithmic
