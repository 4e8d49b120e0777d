"""Between the samples of a motion: what the picture shows where the file has no point.

The files hold quantities together with their rates, so the cubic through both is fourth order in
the distance of the samples; orientations are put back on their unit sphere.
"""

from __future__ import annotations

import numpy as np

from qbxstokes.plots.picture_source import TURN_LIMIT
from qbxstokes.typing import Array


def between(times: Array, values: Array, rates: Array | None, at: Array) -> Array:
    """Values (m, d) at the times `at` (m,) inside `times` (n,), from samples (n, d).

    Cubic Hermite interpolation with the rates (n, d), linear where there are none.
    """
    if len(times) == 1:
        return np.repeat(values, len(at), axis=0)
    index = np.clip(np.searchsorted(times, at, side="right") - 1, 0, len(times) - 2)
    step = (times[index + 1] - times[index])[:, None]
    s = (at[:, None] - times[index, None]) / step
    change = values[index + 1] - values[index]
    point: Array = values[index] + s * change
    if rates is not None:
        first, last = step * rates[index] - change, change - step * rates[index + 1]
        point = point + s * (1.0 - s) * ((1.0 - s) * first + s * last)
    return point


def axis_path(times: Array, axis: Array, spin: Array | None, largest: float = 0.05) -> tuple:
    """Times (m,) and axes (m, 3), with steps of at most about `largest` radians.

    axis (n, 3) are unit vectors, spin (n, 3) the angular velocity in the same frame: the rate of
    the axis is their cross product. Rates are used where samples are less than a radian apart.
    """
    if len(times) < 2:
        return times, axis
    cosine = np.einsum("ij,ij->i", axis[:-1], axis[1:])
    angle = np.arctan2(np.linalg.norm(np.cross(axis[:-1], axis[1:]), axis=1), cosine)
    counts = np.clip(np.ceil(angle / largest), 1, 80).astype(int)
    index = np.repeat(np.arange(len(counts)), counts)
    part = np.arange(len(index)) - np.repeat(np.cumsum(counts) - counts, counts)
    at = times[index] + (times[index + 1] - times[index]) * part / counts[index]
    at = np.append(at, times[-1])
    point = between(times, axis, None, at)
    if spin is not None:
        smooth = between(times, axis, np.cross(spin, axis), at)
        close = np.append(angle[index] < TURN_LIMIT, True)
        point = np.where(close[:, None], smooth, point)
    length = np.linalg.norm(point, axis=1, keepdims=True)
    return at, point / np.maximum(length, 1e-12)
