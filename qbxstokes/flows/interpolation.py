"""Polynomials between samples: what an interpolant is in each interval, as powers of its time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

INTERPOLATIONS = {"sextic": 6, "linear": 2, "hold": 1}  # and the samples each one takes


def power_weights(times: Array, interpolation: str) -> tuple[NDArray[np.int64], Array]:
    """First sample of each interval's window (m,), and weights (m, degree + 1, samples).

    Of m + 1 instants; the interpolant in interval i is sum_k s^k (weights[i, k] @ window), s from 0
    to 1.
    """
    count = INTERPOLATIONS[interpolation]
    intervals = np.arange(len(times) - 1)
    first = np.clip(intervals - count // 2 + 1 - (count == 1), 0, len(times) - count)
    nodes = times[first[:, None] + np.arange(count)]
    s = (nodes - times[:-1, None]) / np.diff(times)[:, None]
    return first, np.linalg.inv(s[:, :, None] ** np.arange(count))
