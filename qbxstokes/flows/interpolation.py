"""Series of samples in time, and the polynomials between them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.errors import FlowError, FlowFunctionError
from qbxstokes.typing import Array, Integers

INTERPOLATIONS = {"sextic": 6, "linear": 2, "hold": 1}  # and the samples each one takes
OUTSIDE = "error", "clamp", "repeat"
# Samples that a step may pass where the polynomials through six of them go over into each other.
_SEEN = 8
_MANY = 20_000  # samples that are looked at together


def power_weights(times: Array, interpolation: str) -> tuple[Integers, Array]:
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


@lru_cache(maxsize=16)  # many series of one run have the same instants
def _kept_weights(times: bytes, interpolation: str) -> tuple[Integers, Array]:
    return power_weights(np.frombuffer(times), interpolation)


def within(instants: Sequence[Array], end: float) -> Array:
    """Those between 0 and `end`, in order."""
    found = np.concatenate(instants)
    return np.unique(found[(found > 0.0) & (found < end)]) if len(found) else found


class Between:
    """Which instant is asked for at a break: one just before it, or just after it."""

    last, since = math.inf, -math.inf

    def until(self, t: float, since: float = -math.inf) -> None:
        """As `Flow.until`."""
        self.last, self.since = math.nextafter(t, -math.inf), since

    def between(self, t: float) -> float:
        """The instant to ask for in the place of t."""
        return min(math.nextafter(t, math.inf) if t == self.since else t, self.last)


class Series:
    """Numbers from samples in time: times (T,), values (..., T, m), or (T,) of one number each.

    Leading axes are paths, with values of their own at the same times. Samples keep their type
    (float32 is not copied); only their last axes are looked at here.

    interpolation: "sextic", the polynomial through the six samples around an instant (its error
    goes as spacing^6), "linear" or "hold" (the sample before it). outside: "error" beyond the
    samples, "clamp" or "repeat" (the period is that of the samples).
    """

    name = "values"

    def __init__(
        self,
        times: ArrayLike,
        values: Any,
        *,
        interpolation: str = "sextic",
        outside: str = "error",
    ) -> None:
        t = np.asarray(times, dtype=np.float64)
        a = values if hasattr(values, "shape") else np.asarray(values, dtype=np.float64)
        if a.ndim == 1:
            a = a[:, None]
        for name, value, known in (
            ("interpolation", interpolation, INTERPOLATIONS),
            ("outside", outside, OUTSIDE),
        ):
            if value not in tuple(known):
                raise FlowError(f"{name} is one of {', '.join(known)}, not {value!r}", (name,))
        if t.ndim != 1 or len(t) < 2 or np.any(np.diff(t) <= 0.0) or not np.isfinite(t).all():
            raise FlowError("times of a series must be two or more finite, increasing instants")
        if a.ndim < 2 or a.shape[-2] != len(t):
            right = f"{self._shapes(len(t))} is expected"
            raise FlowError(f"{self.name} have shape {np.shape(values)}; {right}", ("gradient",))
        if interpolation == "sextic" and len(t) < 6:
            raise FlowError(
                f"{len(t)} samples are too few for six points; interpolation: linear", ("gradient",)
            )
        self.times, self.samples = t, a
        self.interpolation, self.outside = interpolation, outside

    def _shapes(self, count: int) -> str:
        return f"({count},) or (..., {count}, m)"

    @property
    def paths(self) -> tuple[int, ...]:
        """Shape of the leading axes."""
        return tuple(self.samples.shape[:-2])

    @property
    def longest_step(self) -> float:
        """Step that misses nothing: least time between samples, or what shows at six of them."""
        return float(np.diff(self.times).min()) * (_SEEN if self.interpolation == "sextic" else 1)

    def __len__(self) -> int:
        return math.prod(self.paths)

    def read(self, first: int, stop: int, begin: int = 0, end: int | None = None) -> Array:
        """Samples begin to end (stop - first, T, m) of some paths, which have to be finite."""
        a = np.array(self._rows[first:stop, begin:end], dtype=np.float64)
        if not (math.isfinite(np.max(a, initial=0.0)) and math.isfinite(np.min(a, initial=0.0))):
            path, sample, _ = np.argwhere(~np.isfinite(a))[0]
            where = f"path {first + path}, sample {begin + sample}"
            raise FlowError(f"{where} of the series is not finite")
        return a

    @property
    def _rows(self) -> Any:
        """Samples by path and instant, of which parts may be read."""
        whole = self.samples
        return whole.reshape(-1, *whole.shape[-2:]) if isinstance(whole, np.ndarray) else whole

    @cached_property
    def one(self) -> Array:
        """Samples (T, m) of a series of one path."""
        if len(self) != 1:
            raise FlowError(f"a series of {len(self)} paths; name a trajectory", ("trajectory",))
        return np.asarray(self.read(0, 1)[0])

    def like(self, other: Series) -> bool:
        """Whether another series has the same instants and rules."""
        rules = self.interpolation, self.outside
        same = rules == (other.interpolation, other.outside)
        return same and np.array_equal(self.times, other.times)

    def thinned(self) -> Series:
        """The same of every other sample."""
        rules = {"interpolation": self.interpolation, "outside": self.outside}
        return Series(self.times[::2], self._rows[0, ::2], **rules)

    @property
    def _slack(self) -> float:
        """By how much the first and the last instant may be off in single precision."""
        return 2.0**-22 * max(abs(float(self.times[0])), abs(float(self.times[-1])))

    def inside(self, t: float) -> float:
        """The instant of the samples that stands for t; raises FlowError beyond them."""
        first, last = float(self.times[0]), float(self.times[-1])
        if first <= t <= last:
            return t
        if self.outside == "clamp" or first - self._slack <= t <= last + self._slack:
            return min(max(t, first), last)
        if self.outside == "repeat":
            return first + (t - first) % (last - first)
        raise FlowFunctionError(
            f"t = {t:.6g} is outside the series, which covers {first:g} to {last:g}; "
            "outside: clamp or repeat goes on",
            ("outside",),
        )

    def knows(self, t: Array) -> int:
        """How many of increasing instants it has values at, from the first on."""
        beyond = (t < self.times[0] - self._slack) | (t > self.times[-1] + self._slack)
        return int(np.argmax(beyond)) if self.outside == "error" and np.any(beyond) else len(t)

    @cached_property
    def _roughness(self) -> Array:
        """By how much the polynomials before and after each sample part within its intervals."""
        found = np.full(len(self.times), np.inf)
        (begin, weights), lengths = self._weights, np.diff(self.times)
        powers, samples = np.arange(weights.shape[1]), np.arange(weights.shape[2])

        def at(places: Any, which: Integers) -> Array:
            """The polynomials of intervals at places of them, 0 to 1 inside."""
            rows = np.einsum("nk,nkj->nj", np.atleast_2d(places).T ** powers, weights[which])
            value: Array = np.einsum("nj,njm->nm", rows, self.one[begin[which][:, None] + samples])
            return value

        for first in range(1, len(lengths), _MANY):
            later = np.arange(first, min(first + _MANY, len(lengths)))
            early, ratio = later - 1, 0.5 * lengths[later - 1] / lengths[later]
            behind = at(-ratio, later) - at(0.5, early)
            ahead = at(1.0 + 0.25 / ratio, early) - at(0.5, later)
            found[later] = np.abs([behind, ahead]).max(axis=(0, 2))
        return found

    def breaks(self, end: float, rough: float = 0.0) -> Array:
        """The samples between 0 and `end`: between them the interpolant is a polynomial.

        rough: those alone at which it is less smooth than a gradient may be untold.
        """
        first, last = float(self.times[0]), float(self.times[-1])
        found = self.times
        if rough > 0.0 and self.interpolation == "sextic":
            found = found[self._roughness > rough]
        if self.outside == "repeat":
            turns = np.arange(math.floor(-first / (last - first)), math.ceil(end / (last - first)))
            found = np.unique(turns[:, None] * (last - first) + found[:-1])
        return found[(found > 0.0) & (found < end)]

    def values(self, t: Array) -> Array:
        """The values (n, m) at instants (n,), of a series of one path."""
        origins, scales, powers = self.powers(t, t)
        x = ((t - origins) * scales)[:, None]
        return np.asarray(np.einsum("nk,nkm->nm", x ** np.arange(powers.shape[1]), powers))

    def __call__(self, t: float) -> Array:
        """The values (m,) at an instant, of a series of one path."""
        return np.asarray(self.values(np.array([t]))[0])

    def powers(self, first: Array, last: Array) -> tuple[Array, Array, Array]:
        """Origins and scales (n,) and coefficients (n, degree + 1, m) of intervals without samples.

        The values at t are sum_k coefficients[k] ((t - origin) scale)^k.
        """
        middle = 0.5 * (first + last)
        inside = np.array([self.inside(t) for t in middle.tolist()])
        places = np.clip(np.searchsorted(self.times, inside, "right") - 1, 0, len(self.times) - 2)
        begin, weights = self._weights
        window = self.one[begin[places][:, None] + np.arange(weights.shape[2])]
        coefficients = np.einsum("nkj,njm->nkm", weights[places], window)
        for end, sample in ((0, self.times[0]), (-1, self.times[-1])):  # at an end, or clamped
            beyond = inside == sample
            coefficients[beyond] = 0.0
            coefficients[beyond, 0] = self.one[end]
        origins = middle - (inside - self.times[places])
        return origins, 1.0 / np.diff(self.times)[places], coefficients

    @cached_property
    def _weights(self) -> tuple[Integers, Array]:
        return _kept_weights(self.times.tobytes(), self.interpolation)
