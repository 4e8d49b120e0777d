"""Averages of trajectories over whole turns of their axis, from samples, for many bodies at once.

The axis D3 is described in the plane of shear (e_a, e_b, e_n): the flow runs along e_a and varies
along e_b. Its stretched angle tau = atan2(d_b, k d_a) grows steadily on a Jeffery orbit, so that
whole half-turns (after which a body with fore-aft symmetry looks the same) are counted exactly, and
the end of the last one is found between two samples by the cubic through values and rates there.
Arrays of samples are (T, n) or (T, n, 3).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from qbxstokes.motion.diagnostics import of_matrix, orbit_constant
from qbxstokes.typing import Array, Indices

# More than this between two samples, and the turns cannot be counted.
_LARGEST_TURN = 0.75 * np.pi
# An orbit constant above this is that of a tumbling body, up to rounding: it has no drift.
_TUMBLING = 1e8
_ITERATIONS = 60  # of bisection: to the last bit of the fraction of a step


@dataclass(frozen=True)
class ShearFrame:
    """Directions of stream, gradient and vorticity (rows, (3, 3)), and whether it is a shear."""

    axes: Array
    simple: bool

    @property
    def shear(self) -> Array | None:
        """The directions in a simple shear; None elsewhere, where no orbit constant exists."""
        return self.axes if self.simple else None

    @staticmethod
    def of(gradient: Array) -> ShearFrame:
        """Frame of the velocity gradient A[i, j] = du_i/dx_j at one point.

        For a simple shear A = rate e_a e_b^T; otherwise e_n is along the vorticity, or e3.
        """
        return _frame(gradient)


@of_matrix
def _frame(gradient: Array) -> ShearFrame:
    left, singular, right = np.linalg.svd(gradient)
    a, b = left[:, 0], right[0]
    if singular[0] > 0 and singular[1] <= 1e-10 * singular[0] and abs(a @ b) < 1e-10:
        # Signs such that e_a and e_b point along the axes of space as far as they can.
        a, b = (v * np.sign(v[np.argmax(np.abs(v))]) for v in (a, b))
        return ShearFrame(np.stack([a, b, np.cross(a, b)]), True)
    spin = np.array([gradient[1, 2] - gradient[2, 1], gradient[2, 0] - gradient[0, 2], 0.0])
    spin[2] = gradient[0, 1] - gradient[1, 0]
    length = np.linalg.norm(spin)
    n = spin / length if length > 0 else np.array([0.0, 0.0, 1.0])
    n = n * np.sign(n[np.argmax(np.abs(n))])
    a = np.eye(3)[int(np.argmin(np.abs(n)))]
    a = a - (a @ n) * n
    a /= np.linalg.norm(a)
    return ShearFrame(np.stack([a, np.cross(n, a), n]), False)


def turn_averages(
    times: Array,
    samples: dict[str, Array],
    effective_ratio: float,
    frame: ShearFrame,
    discard: float = 0.0,
) -> dict[str, Array]:
    """Averages (n,) and (n, 3) over the whole half-turns after the first `discard` of the time.

    samples: position, axis, velocity, angular_velocity (T, n, 3). Returned:
    half_turns (counted), period (of two half-turns), period_change (second half of the half-turns
    minus the first, relative), rotation_rate (mean rate of the axis about e_n, with its sign),
    mean_velocity (3), velocity_change (the same for the two halves, 3), orbit_constant_start and
    _end (first and last sample; NaN in a flow that is not a simple shear), orbit_drift (rate of
    ln C; NaN when tumbling). NaN where there is no whole half-turn; the mean velocity is then that
    of the whole window.
    """
    first = int(np.searchsorted(times, times[0] + discard * (times[-1] - times[0])))
    first = min(first, len(times) - 1)
    t = times[first:]
    axis, omega = samples["axis"][first:], samples["angular_velocity"][first:]
    x, v = samples["position"][first:], samples["velocity"][first:]
    k = effective_ratio if frame.simple else 1.0
    n = axis.shape[1]
    d = axis @ frame.axes.T
    rate = np.cross(omega, axis) @ frame.axes.T
    # Both in memory of their own: arctan2 of strided views may differ in the last bit.
    along, across = k * d[..., 0], d[..., 1].copy()
    square = along**2 + across**2
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = (along * rate[..., 1] - k * rate[..., 0] * across) / square
    raw = np.arctan2(across, along)
    angle = np.unwrap(raw, axis=0)
    steps = np.abs(np.diff(angle, axis=0)).max(axis=0, initial=0.0)
    known = (square.min(axis=0) > 1e-16) & (steps < _LARGEST_TURN) & np.isfinite(slope).all(axis=0)
    known &= _followed(t, angle, slope, d, rate)
    turned = np.where(known, angle[-1] - angle[0], 0.0)
    half_turns = np.floor(np.abs(turned) / np.pi + 1e-9)
    some = half_turns >= 1

    def moment(count: Array) -> tuple[Indices, Array]:
        """Interval and fraction of it at which `count` half-turns are complete."""
        goal = angle[0] + np.sign(turned) * np.pi * count
        beyond = np.abs(angle - angle[0]) >= np.abs(goal - angle[0]) * (1.0 - 1e-14)
        # A turn that ends with the last sample may fall short of it by rounding.
        after = np.where(beyond.any(axis=0), np.argmax(beyond, axis=0), len(t) - 1)
        after = np.clip(after, 1, max(len(t) - 1, 1))
        low, high = np.zeros(n), np.ones(n)
        for _ in range(_ITERATIONS):
            middle = 0.5 * (low + high)
            here = _hermite(t, angle, slope, after - 1, middle)
            short = np.abs(here - angle[0]) < np.abs(goal - angle[0])
            low, high = np.where(short, middle, low), np.where(short, high, middle)
        return after - 1, 0.5 * (low + high)

    result: dict[str, Array] = {"half_turns": half_turns}
    if len(t) < 2:
        some = np.zeros(n, dtype=bool)
    nothing = np.full(n, np.nan)
    start_time, start_place = np.full(n, t[0]), x[0]
    if some.any():
        where, part = moment(half_turns)
        span = t[where] + part * (t[where + 1] - t[where]) - start_time
        place = _hermite(t, x, v, where, part)
        middle_count = np.floor(0.5 * half_turns)
        where2, part2 = moment(middle_count)
        half = t[where2] + part2 * (t[where2 + 1] - t[where2]) - start_time
        place2 = _hermite(t, x, v, where2, part2)
        ending = _hermite(t, axis, np.cross(omega, axis), where, part)
        with np.errstate(divide="ignore", invalid="ignore"):
            period = 2.0 * span / half_turns
            earlier = 2.0 * half / middle_count
            later = 2.0 * (span - half) / (half_turns - middle_count)
            change = np.where(middle_count >= 1, (later - earlier) / period, np.nan)
            speed = (place - start_place) / span[:, None]
            early_speed = (place2 - start_place) / half[:, None]
            late_speed = (place - place2) / (span - half)[:, None]
            constants = [orbit_constant(d, effective_ratio, frame.axes) for d in (axis[0], ending)]
            drift = np.log(constants[1] / constants[0]) / span
            drift = np.where(np.maximum(*constants) < _TUMBLING, drift, np.nan)
    else:
        period = change = drift = span = nothing
        speed = early_speed = late_speed = np.full((n, 3), np.nan)
        middle_count = np.zeros(n)
    whole = max(float(t[-1] - t[0]), np.finfo(float).tiny)
    result["period"] = np.where(some, period, np.nan)
    result["period_change"] = np.where(some, change, np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        mean_rate = np.sign(turned) * np.pi * half_turns / span
    result["rotation_rate"] = np.where(some, mean_rate, np.nan)
    result["mean_velocity"] = np.where(some[:, None], speed, (x[-1] - x[0]) / whole)
    halves = (some & (middle_count >= 1))[:, None]
    result["velocity_change"] = np.where(halves, late_speed - early_speed, np.nan)
    for name, ends in (("start", samples["axis"][0]), ("end", axis[-1])):
        constant = orbit_constant(ends, effective_ratio, frame.axes)
        result[f"orbit_constant_{name}"] = constant if frame.simple else np.full(n, np.nan)
    drifts = some & np.isfinite(drift) & frame.simple
    result["orbit_drift"] = np.where(drifts, drift, np.nan)
    return result


def _followed(t: Array, angle: Array, slope: Array, d: Array, rate: Array) -> Array:
    """Whether the samples follow the turns of every body, (n,): between them its rate agrees.

    The stretched angle of a light body turns steadily, the angle in the plane that of a heavy one.
    """
    step = np.diff(t)[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        plain = d[..., 0] * rate[..., 1] - d[..., 1] * rate[..., 0]
        plain /= d[..., 0] ** 2 + d[..., 1] ** 2
    turned = np.unwrap(np.arctan2(d[..., 1], d[..., 0]), axis=0)
    off = [
        np.abs(np.diff(angles, axis=0) - 0.5 * step * (rates[1:] + rates[:-1]))
        for angles, rates in ((angle, slope), (turned, plain))
    ]
    return np.asarray(np.all(np.fmin(*off) < 0.5 * np.pi, axis=0))


def _hermite(t: Array, values: Array, rates: Array, interval: Indices, s: Array) -> Array:
    """Cubic through values and rates at both ends of one interval per body; s in [0, 1]."""
    bodies = np.arange(values.shape[1])
    h = t[interval + 1] - t[interval]
    y0, y1 = values[interval, bodies], values[interval + 1, bodies]
    f0, f1 = rates[interval, bodies], rates[interval + 1, bodies]
    if values.ndim == 3:
        h, s = h[:, None], s[:, None]
    s2 = s * s
    return np.asarray(
        y0
        + s * h * f0
        + s2 * (3.0 - 2.0 * s) * (y1 - y0)
        + s2 * (s - 1.0) * h * f1
        + s2 * (s - 2.0) * h * f0
    )


@dataclass(frozen=True)
class Mean:
    """Mean over time, and over motions that were drawn at random.

    mean (...) and its standard_error (...), from the spread of the motions' own means `each`
    (n, ...); NaN of a single motion. sampling_error: the largest change of `each` with every other
    sample left out, over its largest entry: what the integration over time may be off.
    """

    mean: Array
    standard_error: Array
    each: Array
    sampling_error: float


def mean_of(times: Array, values: Array, period: Array, discard: float = 0.0) -> Mean:
    """Mean of samples (T, n, ...) at times (T,) after the first part `discard` of the time.

    period (n,): of a turn, two half-turns of the axis; NaN where there is none. The time is that of
    as many whole turns as fit in, or all of it (a half-turn changes the signs of 13 and 23). Cubic
    splines through the samples are integrated. Samples that are NaN at the end, of a motion that
    ended, are left out.
    """
    first = min(int(np.searchsorted(times, times[0] + discard * np.ptp(times))), len(times) - 1)
    t, y = times[first:], values[first:]
    missing = np.isnan(y.reshape(*y.shape[:2], -1)).any(axis=(0, 2))
    each, coarse = np.full((2, *y.shape[1:]), np.nan)
    for lanes in [np.flatnonzero(~missing), *np.flatnonzero(missing)[:, None]]:
        inside = y[:, lanes]
        there = ~np.isnan(inside.reshape(len(t), -1)).any(axis=1)
        if len(lanes) and there.any():
            own = t[there], inside[there], period[lanes]
            each[lanes], coarse[lanes] = _over_turns(*own, 1), _over_turns(*own, 2)
    some = each[~np.isnan(each.reshape(len(each), -1)).any(axis=1)]
    count, size = len(some), float(np.nanmax(np.abs(each), initial=0.0))
    error = some.std(axis=0, ddof=1) / np.sqrt(count) if count > 1 else np.full(y.shape[2:], np.nan)
    change = float(np.nanmax(np.abs(each - coarse), initial=0.0)) / size if size else 0.0
    mean = some.mean(axis=0) if count else np.full(y.shape[2:], np.nan)
    return Mean(np.asarray(mean), np.asarray(error), each, change)


def _over_turns(t: Array, y: Array, period: Array, stride: int) -> Array:
    """Means (n, ...) over the whole turns that begin at t[0], by every stride-th sample."""
    from scipy.interpolate import CubicSpline

    if len(t) < 2:
        return np.asarray(y[0])
    whole = float(t[-1] - t[0])
    # A turn that ends with the last sample may fall short of it by rounding.
    with np.errstate(invalid="ignore"):
        turns = np.floor(whole / period * (1.0 + 1e-9))
    span = np.where(turns >= 1.0, np.minimum(turns * period, whole), whole)
    kept = np.unique(np.append(np.arange(0, len(t), stride), len(t) - 1))
    integral = CubicSpline(t[kept], y[kept]).antiderivative()
    place = np.clip(np.searchsorted(t[kept], t[0] + span) - 1, 0, len(kept) - 2)
    x = t[0] + span - t[kept][place]
    total = np.zeros(y.shape[1:])
    for coefficient in integral.c[:, place, np.arange(len(span))]:
        total = total * x.reshape(-1, *(1,) * (total.ndim - 1)) + coefficient
    return np.asarray(total / span.reshape(-1, *(1,) * (total.ndim - 1)))
