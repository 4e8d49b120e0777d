"""Means of what was recorded along motions, over whole turns of each and over all of them."""

from dataclasses import dataclass

import numpy as np

from qbxstokes.typing import Array


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
