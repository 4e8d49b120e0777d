"""Numbers that change in time: functions, expressions and samples, as piecewise polynomials.

A function is asked at Chebyshev's nodes of pieces of time, which are halved where the last
coefficients of the polynomials through them do not show that the rest is small enough (Trefethen,
Approximation Theory and Approximation Practice, 2013, chapters 3 and 8). Between samples the
interpolant is a polynomial as it is. Whoever integrates then asks polynomials alone.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.polynomial import chebyshev

from qbxstokes.errors import FlowError, FlowFunctionError, SinglePrecisionWarning
from qbxstokes.flows.interpolation import Between, Series, within
from qbxstokes.flows.values import DOUBLE, SINGLE, Key, settled, tensor, traceless
from qbxstokes.typing import Array, Indices, Integers

_NODES = 10
_ROOTS = np.sort(chebyshev.chebpts1(_NODES))
_COEFFICIENTS = np.linalg.inv(chebyshev.chebvander(_ROOTS, _NODES - 1))
_POWERS = np.array(
    [np.pad(chebyshev.cheb2poly(row), (0, _NODES))[:_NODES] for row in np.eye(_NODES)]
)
_TO_POWERS = _POWERS.T @ _COEFFICIENTS
# What rounding leaves of coefficients, relative to the numbers, and of what counts as noise.
_ROUNDING, _NOISE = 2e-15, SINGLE
# Halvings of a piece, and pieces of a window, at most; pieces asked for at a time.
_HALVINGS, _MOST, _WINDOW = 45, 20_000, 64
# Numbers of samples taken up at a time, and of coefficients that are kept.
_SAMPLES, _KEPT = 100_000, 500_000
NO_BOUND = "the rates of change grow without bound"
# Halvings within which noise is the function's, and beyond which it is that of the instants; part
# of a piece below which a function that fails is not followed up to where it does.
_ROUGH, _EDGE = 10, 1e-4
_ALTERNATE = 3  # motions whose numbers are kept besides the last one's
# Where a function is asked whether it is still what it was, as parts of a run.
_PROBES = np.array([0.0, 0.137, 0.618, 0.911])
_BREAKS = ("breaks",)  # the key that would help a function that is not smooth
_STEP = 2  # pieces of a function that a step may be long
# By how much more than they are accurate numbers of neighbouring pieces differ where they jump.
_JUMP = 100.0
_LEAST = 1e7  # steps of a run beyond which it is refused
_NOTHING = 1e-290  # the trace of a gradient whose digits are lost


@dataclass(frozen=True)
class Part:
    """Numbers of one source: a function of t or a series, the shape it has, and its key.

    gradient: whether it has to be traceless. given_breaks: instants up to one at which it is not
    smooth, besides the samples of a series. spacing: longest step that misses nothing of it.
    """

    source: Callable[[float], Any] | Series
    shape: tuple[int, ...]
    key: Key
    gradient: bool = False
    given_breaks: Callable[[float], Array] = lambda end: np.empty(0)
    spacing: float = math.inf

    def breaks(self, end: float, rough: float = 0.0) -> Array:
        """Instants up to `end` at which the numbers are not smooth, a gradient by more than so."""
        least = rough if self.gradient else 0.0
        own = self.source.breaks(end, least) if isinstance(self.source, Series) else np.empty(0)
        return np.concatenate([self.given_breaks(end), own])

    def at(self, t: float) -> Array:
        """The numbers (size,) at an instant; raises FlowError for what is none."""
        if isinstance(self.source, Series):
            found: Array = self.many(np.array([t]))[0]
            return found
        name = "the " + ".".join(map(str, self.key))
        try:
            given = self.source(t)
        except FlowError:
            raise
        except Exception as error:
            wrong = f"{name} raised {type(error).__name__} at t = {t:.6g}: {error}"
            raise FlowFunctionError(wrong, self.key) from error
        found = tensor(given, f"{name} at t = {t:.6g}", self.shape, self.key)
        if not self.gradient:
            return found.reshape(-1)
        trace = float(np.trace(found))
        if abs(trace) > _NOTHING:
            if abs(trace) > SINGLE * float(np.abs(found).max()):
                raise FlowFunctionError(
                    f"the gradient has trace {trace:.6g} at t = {t:.6g} and must have none "
                    "(incompressible fluid)",
                    self.key,
                )
            must = "the gradients must have no trace (div u = 0)"
            found = settled(found, traceless(found), must)
        return found.reshape(-1)

    def many(self, t: Array) -> Array:
        """The numbers (n, size) at instants (n,)."""
        if isinstance(self.source, Series):
            return self.source.values(t).reshape(len(t), -1)
        instants = t.tolist()
        try:
            found = np.array([self.source(s) for s in instants], dtype=np.float64)
            good = found.shape == (len(t), *self.shape) and math.isfinite(
                float(np.abs(found).max())
            )
            found = found.reshape(len(t), -1)
            if good and self.gradient:
                trace = np.abs(found[:, 0] + found[:, 4] + found[:, 8])
                good = bool(np.all(trace <= DOUBLE * np.abs(found).max(axis=1) + _NOTHING))
            if good:
                return found
        except Exception:  # told below
            pass
        return np.array([self.at(s) for s in instants])


class Signal(Between):
    """Numbers (m,) that change in time, of parts one after the other.

    spacing: longest step that misses nothing of them.
    """

    def __init__(self, parts: Sequence[Part]) -> None:
        self.parts = tuple(parts)
        self.spacing = min(part.spacing for part in parts)
        self._known: dict[Any, tuple[Array, Sampled]] = {}
        self._last: Sampled | None = None

    @cached_property
    def series(self) -> Series | None:
        """The series of all numbers, where all parts are series that are alike."""
        found = [part.source for part in self.parts if isinstance(part.source, Series)]
        if len(found) < len(self.parts) or not all(found[0].like(series) for series in found[1:]):
            return None
        if len(found) == 1:
            return found[0]
        rules = {"interpolation": found[0].interpolation, "outside": found[0].outside}
        return Series(found[0].times, np.concatenate([s.one for s in found], axis=1), **rules)

    def breaks(self, end: float, rough: float = 0.0) -> Array:
        """Instants between 0 and `end` at which the numbers are not smooth (`Part.breaks`)."""
        return within([part.breaks(end, rough) for part in self.parts], end)

    def at(self, t: float) -> Array:
        """The numbers (m,) at an instant, as between the breaks about it."""
        t = self.between(t)
        found = [part.at(t) for part in self.parts]
        return found[0] if len(found) == 1 else np.concatenate(found)

    def many(self, t: Array) -> Array:
        """The numbers (n, m) at instants (n,)."""
        return np.concatenate([part.many(t) for part in self.parts], axis=1)

    def about(self, t: Array) -> Array:
        """The same to the accuracy of the motion at hand, where one window is all of it."""
        known = self._last
        if known is None or len(known._cuts) > known._size + 1:
            return self.many(t)
        if min(known.piece(t.min()), known.piece(t.max())) < 0:
            return self.many(t)
        return known.many(t)

    def joined(self, other: Signal) -> Signal:
        """The numbers of both."""
        return Signal((*self.parts, *other.parts))

    def sampled(self, end: float, accuracy: float, longest: float) -> Sampled:
        """The numbers from 0 to `end` to an accuracy relative to them, in pieces at most so long.

        What was sampled before serves again, if the numbers have stayed what they were.
        """
        asked = end, accuracy, longest
        try:
            probes = self.many(end * _PROBES)
        except FlowError:
            probes = np.array([np.nan])  # never the same
        values, found = self._known.get(asked, (probes, None))
        if not found or found.refusal or found.edges[0] or not np.array_equal(values, probes):
            found = Sampled(self, *asked)
            self._known = dict([*self._known.items()][-_ALTERNATE:]) | {asked: (probes, found)}
        self._last = found
        return found


class Sampled:
    """A signal as polynomials in pieces of time, known as far as `cover` was asked for.

    Piece i, from edges[i] to edges[i + 1], is sum_k coefficients[i, k] x^k, x = (t - origins[i])
    scales[i].
    Windows of pieces begin at fixed instants, so that the numbers do not depend on where a motion
    begins; the accuracy is relative to the largest numbers of a window. Pieces that are over are
    forgotten where there are many. refusal: what the signal said where it is known no further.
    """

    def __init__(self, signal: Signal, end: float, accuracy: float, longest: float) -> None:
        self.signal, self.end, self.accuracy = signal, end, accuracy
        cuts = signal.breaks(end)
        self._exact = signal.series if len(cuts) else None
        if self._exact is None:
            if not end < _LEAST * longest:
                wrong = f"longest_step is {longest:g}, a run of {end / longest:.2g} steps"
                raise FlowError(wrong, ("longest_step",))
            count = max(1, math.ceil(end / longest * (1.0 - 1e-12)))
            cuts = np.union1d(cuts, np.linspace(0.0, end, count + 1)[1:-1])
        far = np.diff(cuts, prepend=0.0) > 1e-14 * end
        self._cuts = np.concatenate([[0.0], cuts[far & (cuts < end * (1.0 - 1e-14))], [end]])
        count = sum(math.prod(part.shape) for part in signal.parts)
        self._size = _WINDOW if self._exact is None else max(4, _SAMPLES // count)
        self._next, self.asked = 0, 0
        self.refusal: FlowError | None = None
        self.edges, self._jumps = np.zeros(1), np.empty(0)
        self.origins, self.scales = np.empty((2, 0))
        self.coefficients = np.empty((0, 1, count))

    def cover(self, t: float, begin: float) -> float:
        """Know the numbers from `begin` to t at least; the instant up to which they are known."""
        while self.edges[-1] < min(t, self.end) and self.refusal is None:
            self._extend(begin)
        return float(self.edges[-1])

    def piece(self, t: float) -> int:
        """The piece that holds an instant, -1 where none does."""
        if not len(self.origins) or not self.edges[0] <= t <= self.edges[-1]:
            return -1
        return min(int(np.searchsorted(self.edges, t, "right")), len(self.origins)) - 1

    def near(self, t: float) -> tuple[float, float]:
        """How far a step from t may go to see a function, and its next jump; inf for samples."""
        last = int(self.edges.searchsorted(t, "right")) + _STEP - 1
        jump = int(self._jumps.searchsorted(t, "right"))
        return (
            math.inf if self._exact is not None or last >= len(self.edges) else self.edges[last],
            math.inf if jump == len(self._jumps) else self._jumps[jump],
        )

    def seen(self, t: float) -> tuple[Array, float]:
        """The edges that end steps by `near`, and how far they are known from t without a jump."""
        known = math.inf if self.edges[-1] >= self.end else float(self.edges[-1])
        return np.empty(0) if self._exact is not None else self.edges, min(known, self.near(t)[1])

    def stops(self, longest: float) -> Array:
        """Instants at which steps end that are to see the function as far as it is known.

        Its jumps, and where steps as long as by `near` are shorter than the longest; none of
        samples. Raises FlowError for a function that is not smooth to the accuracy.
        """
        if self._exact is not None:
            return np.empty(0)
        self.cover(self.end, 0.0)
        if self.refusal is not None and self.refusal.key == _BREAKS:  # else told when it is needed
            raise self.refusal
        edges = self.edges[::_STEP]
        dense = edges[1:][np.diff(edges) < longest * (1.0 - 1e-9)]
        return np.union1d(dense[dense < self.end], self._jumps)

    def many(self, t: Array) -> Array:
        """The numbers (..., m) at instants (...) that are covered."""
        return self._of(self.pieces(t), t)

    def pieces(self, t: Array) -> Indices:
        """The pieces (...) that hold instants (...) that are covered."""
        last = len(self.origins) - 1
        return np.clip(np.searchsorted(self.edges, t, "right") - 1, 0, last)

    def _of(self, pieces: Integers, t: Array) -> Array:
        """The polynomials of pieces (...) at instants (...)."""
        x = ((t - self.origins[pieces]) * self.scales[pieces])[..., None]
        powers = x ** np.arange(self.coefficients.shape[1])
        return np.asarray(np.einsum("...k,...km->...m", powers, self.coefficients[pieces]))

    def _extend(self, begin: float) -> None:
        """One more window; those that are over by `begin` are passed over."""
        if self._exact is None and not self.asked:
            self._divide()
        cuts, size = self._cuts, self._size
        while self._next + size < len(cuts) - 1 and cuts[self._next + size] <= begin:
            self._next += size
        stop = min(self._next + size, len(cuts) - 1)
        first, last = cuts[self._next : stop], cuts[self._next + 1 : stop + 1]
        self._next = stop
        if self._exact is not None:
            middle = 0.5 * (first + last)
            count = self._exact.knows(middle)
            edges, *new = last[:count], *self._exact.powers(first[:count], last[:count])
            if count < len(first):
                self._refused(float(middle[count]))
        else:
            edges, *new = self._halved(first, last)
        kept = len(self.origins) if first[0] != self.edges[-1] else 0
        if not kept and self.coefficients.size > _KEPT:
            kept = int(np.searchsorted(self.edges, begin, "right")) - 1
        known = self.edges[kept:] if kept < len(self.edges) - 1 else first[:1]
        self.edges = np.concatenate([known, edges])
        old = self.origins, self.scales, self.coefficients
        joined = (
            np.concatenate([a[kept:], b]) if len(a) > kept else b
            for a, b in zip(old, new, strict=True)
        )
        self.origins, self.scales, self.coefficients = joined
        if self._exact is None:
            after = np.arange(max(1, len(self.origins) - len(edges)), len(self.origins))
            there = self.edges[after]
            left, right = self._of(after - 1, there), self._of(after, there)
            usual = np.maximum(abs(left), abs(right)).max(axis=0, initial=0.0)
            jump = np.abs(right - left) > _JUMP * max(self.accuracy, _ROUNDING) * usual
            self._jumps = np.append(self._jumps, there[np.any(jump, axis=1)])

    def _divide(self) -> None:
        """Divide all intervals where the first one takes many pieces: windows stay small."""
        ends, *_ = self._halved(self._cuts[:1], self._cuts[1:2])
        self.refusal = None  # told when a motion comes to it
        shares = np.arange(max(1, len(ends) // 8)) / max(1, len(ends) // 8)
        cuts = self._cuts[:-1, None] + np.diff(self._cuts)[:, None] * shares
        self._cuts = np.append(cuts.ravel(), self.end)

    def _halved(self, first: Array, last: Array) -> tuple[Array, ...]:
        """Ends, origins, scales and coefficients of the pieces that intervals take."""
        done, shortest = [], _EDGE * float(np.max(last - first))
        before: Array | None = None  # what was left of the pieces that are now in halves
        usual, known = np.zeros(0), math.inf
        for level in range(_HALVINGS + 1):
            middle, half = 0.5 * (first + last), 0.5 * (last - first)
            values, failed = self._asked(middle[:, None] + half[:, None] * _ROOTS)
            count = len(values)
            own = np.max(np.abs(values), axis=1, initial=0.0)
            if level == 0:
                usual = np.max(own, axis=0, initial=0.0)
                usual = np.maximum(usual, 1e-6 * float(usual.max())) + 1e-300
                accuracy = max(self.accuracy / max(1.0, self.end * float(usual.max())), _ROUNDING)
            parts = np.abs(np.einsum("cn,pnm->cpm", _COEFFICIENTS[-4:], values))
            late, early = np.maximum(parts[2], parts[3]), np.maximum(parts[0], parts[1])
            error, size = late * np.minimum(1.0, late / (early + 1e-300)), np.maximum(usual, own)
            # Small everywhere, or in what it comes to: a jump is well known in a short piece.
            short = error * (2e3 * half[:count, None] / self.end) <= accuracy * usual
            good, tail = np.all((error <= accuracy * size) | short, 1), np.max(late / size, 1)
            if before is not None and not failed:
                noise = (tail.reshape(-1, 2).min(axis=1) > 0.4 * before) & (before <= _NOISE)
                good |= np.repeat(noise, 2)
                if level <= _ROUGH and np.any(before[noise] > DOUBLE):
                    told = f"the flow is rough in time, by {before[noise].max():.1g} of its size"
                    warnings.warn(told, SinglePrecisionWarning, stacklevel=2)
            powers = np.einsum("kn,pnm->pkm", _TO_POWERS, values[good])
            ready = np.flatnonzero(good)
            done.append((last[ready], middle[ready], 1.0 / half[ready], powers))
            again, before = np.flatnonzero(~good), None
            if failed:
                known = float(first[count])
                if last[count] - known > shortest:
                    known, again = float(last[count]), np.append(again, count)
            else:
                before = tail[again]
            if not len(again):
                break
            if level == _HALVINGS or len(again) > _MOST:
                known = min(known, float(first[again].min()))
                what = f"near t = {known:.6g} the flow is no smooth function of time"
                right = "breaks, or a larger tolerance"
                self.refusal = FlowFunctionError(f"{what}, or {NO_BOUND} ({right})", _BREAKS)
                break
            first, middle, last = first[again], middle[again], last[again]
            first = np.stack([first, middle], axis=1).ravel()
            last = np.stack([middle, last], axis=1).ravel()
        ends, *rest = (np.concatenate(part) for part in zip(*done, strict=True))
        order = np.argsort(ends, kind="stable")
        order = order[ends[order] <= known]
        return ends[order], *(part[order] for part in rest)

    def _refused(self, t: float) -> None:
        try:
            self.signal.many(np.array([t]))
        except FlowError as error:
            self.refusal = error

    def _asked(self, nodes: Array) -> tuple[Array, bool]:
        """The numbers (pieces, nodes, m) at nodes, up to the first piece where there are none."""
        self.asked += nodes.size
        try:
            return self.signal.many(nodes.ravel()).reshape(*nodes.shape, -1), False
        except FlowError:
            pass
        found: list[Array] = []
        try:
            for row in nodes:
                found.append(self.signal.many(row))
        except FlowError as error:
            self.refusal = error
        return np.array(found).reshape(len(found), _NODES, self.coefficients.shape[2]), True
