"""Flows whose numbers change in time: sums of flows times functions, expressions or series of t.

u = u_0(x) + sum_m f_m(t) u_m(x). Where all u are polynomial, so is the flow at every instant.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qbxstokes.errors import FlowError, FlowFunctionError
from qbxstokes.expressions import expression_in_time
from qbxstokes.flows.base import Build, Flow, SumFlow
from qbxstokes.flows.interpolation import Series
from qbxstokes.flows.polynomial import PolynomialFlow
from qbxstokes.flows.series import GradientSeries, series_of_file
from qbxstokes.flows.signals import Part, Signal
from qbxstokes.flows.singularities import Stresslet
from qbxstokes.flows.user import load_function
from qbxstokes.flows.values import Key, check_keys, instants, number
from qbxstokes.tables import TableError, read_table
from qbxstokes.typing import Array

_IN_TIME = ["trajectory", "longest_step", "breaks"]
_SERIES = {"file", "process", "times"}
# Numbers of the keys that a function or a series may stand for as a whole; one of the others.
_SHAPES: dict[str, tuple[int, ...]] = {
    **dict.fromkeys(("velocity", "angular_velocity", "value", "strength"), (3,)),
    "gradient": (3, 3),
    "hessian": (3, 3, 3),
    "third": (3, 3, 3, 3),
}


class ChangingFlow(SumFlow):
    """still + sum_m signal_m(t) units_m; polynomials are taken about one origin."""

    type_name = "changing"

    def __init__(
        self,
        signal: Signal,
        units: Sequence[Flow],
        still: Flow | None,
        spec: Mapping[str, Any],
    ) -> None:
        """spec: what it is written down as."""
        self.signal, self._spec = signal, dict(spec)
        terms = [*units, *([] if still is None else [still])]
        self._ranks: list[Array] = []
        self.polynomials: tuple[PolynomialFlow, ...] = ()
        given = [flow for flow in terms if isinstance(flow, PolynomialFlow)]
        if len(given) == len(terms):
            self.polynomials = tuple(flow.about(given[0].origin) for flow in given)
            ranks = zip(*(flow.tensors for flow in self.polynomials), strict=True)
            self._ranks, terms = [np.stack(rank) for rank in ranks], [*self.polynomials]
        super().__init__(terms)
        self.signals = (signal, *self.signals)
        self.spacing = min(self.spacing, signal.spacing)
        self.units, self.still = self.terms[: len(units)], None if still is None else terms[-1]
        self.steady = False
        if self.polynomials:
            self.degree = max(1, *(flow.degree for flow in self.polynomials))
        self.singular_points = np.unique(self.singular_points, axis=0)
        self._known: tuple[float, PolynomialFlow] | None = None
        self._factors(np.zeros(1))

    def _factors(self, t: Array) -> Array:
        """What the terms are multiplied by at instants (T,), (T, terms)."""
        factors = np.ones((len(t), len(self.terms)))
        numbers = self.signal.at(float(t[0]))[None] if len(t) == 1 else self.signal.about(t)
        factors[:, : len(self.units)] = numbers
        return factors

    def breaks(self, end: float, rough: float = 0.0) -> Array:
        """Those of the numbers and of the terms."""
        if rough > 0.0:
            linear = self.polynomials and self.degree == 1
            rough /= max(1.0, np.abs(self._ranks[1]).max()) if linear else np.inf
        return np.concatenate([self.signal.breaks(end, rough), super().breaks(end)])

    def until(self, t: float, since: float = -math.inf) -> None:
        """Show itself, from now on, as between breaks: at t as just before, at `since` as after."""
        self.signal.until(t, since)
        if not self.polynomials:
            super().until(t, since)

    def at(self, t: float) -> PolynomialFlow:
        """The polynomial that the flow is at time t."""
        t = self.signal.between(t)
        if self._known is None or self._known[0] != t:
            (factors,) = self._factors(np.array([t]))
            tensors = [np.tensordot(factors, rank, 1) for rank in self._ranks]
            origin = self.polynomials[0].origin
            self._known = t, PolynomialFlow.of(tensors, origin, self.domain)
        return self._known[1]

    def gradients(self, x: Array, t: Array) -> Array:
        """Velocity gradients (T, n, 3, 3) at points (n, 3) and instants (T,)."""
        if self.degree == 1:
            terms = np.broadcast_to(self._ranks[1][:, None], (len(self.terms), len(x), 3, 3))
        else:
            terms = np.stack([flow.gradient(x) for flow in self.terms])
        found: Array = np.tensordot(self._factors(t), terms, 1)
        return found

    @property
    def gradient_terms(self) -> tuple[Array, Array]:
        """Gradients (units, 3, 3) that the numbers multiply, and what stays, of a linear flow."""
        count = len(self.units)
        return self._ranks[1][:count], self._ranks[1][count:].sum(axis=0)

    @property
    def surely_stokesian(self) -> bool:
        """Whether it is a gradient alone, of which the trace is looked at."""
        return all(part.gradient for part in self.signal.parts) and self.degree == 1

    def _composed(self, name: str, x: ArrayLike, t: float, *more: Any) -> Array:
        if self.polynomials:
            return np.asarray(getattr(self.at(t), name)(x, t, *more))
        (factors,) = self._factors(np.array([t])).tolist()
        pairs = zip(factors, self.terms, strict=True)
        return np.asarray(sum(f * getattr(flow, name)(x, t, *more) for f, flow in pairs))

    def odd_about(self, x: ArrayLike) -> NDArray[np.bool_]:
        """Whether u(x + r) = -u(x - r) for all r at all times, exactly, shape (...)."""
        if self.degree == 1:
            arm = np.asarray(x, dtype=float) - self.polynomials[0].origin
            found = np.einsum("mij,...j->...mi", self._ranks[1], arm) + self._ranks[0]
            return np.asarray(~np.any(found, axis=(-2, -1)))
        return np.asarray(np.all([flow.odd_about(x) for flow in self.polynomials], axis=0))

    def spec(self) -> dict[str, Any]:
        """The specification, where it can be written down."""
        return dict(self._spec)

    def named(self, spec: Mapping[str, Any]) -> ChangingFlow:
        """The same flow, remembering the specification it was built from."""
        return ChangingFlow(self.signal, self.units, self.still, spec)

    def of_series(self, series: Series) -> ChangingFlow:
        """The same flow of another series, where one is all that changes."""
        part = replace(self.signal.parts[0], source=series, spacing=series.longest_step)
        return ChangingFlow(Signal([part]), self.units, self.still, self._spec)

    def _mapped(self, change: Callable[[Flow], Flow], **how: Any) -> ChangingFlow:
        still = None if self.still is None else change(self.still)
        spec = {"type": "transformed", "flow": self.spec(), **how}
        return ChangingFlow(self.signal, [change(flow) for flow in self.units], still, spec)

    def shifted(self, displacement: ArrayLike) -> Flow:
        """The flow moved."""
        way = np.asarray(displacement, dtype=float)
        return self._mapped(lambda flow: flow.shifted(way), position=way.tolist())

    def rotated(self, rotation: ArrayLike) -> Flow:
        """The flow turned about the space origin."""
        turn = np.asarray(rotation, dtype=float)
        return self._mapped(lambda flow: flow.rotated(turn), rotation=turn.tolist())

    def scaled(self, factor: float) -> Flow:
        """The flow times a number."""
        return self._mapped(lambda flow: flow.scaled(factor), factor=factor)

    def joined(self, other: Flow) -> Flow | None:
        """The sum with a polynomial, or with one that changes as well; None for other flows."""
        if not self.polynomials or other.degree is None:
            return None
        spec = {"type": "sum", "terms": [self.spec(), other.spec()]}
        stills = [flow for flow in (self.still, getattr(other, "still", other)) if flow is not None]
        still = None if not stills else stills[0] if len(stills) == 1 else stills[0] + stills[1]
        if not isinstance(other, ChangingFlow):
            return ChangingFlow(self.signal, self.units, still, spec)
        signal = self.signal.joined(other.signal)
        return ChangingFlow(signal, [*self.units, *other.units], still, spec)


def in_time(kind: type[Flow], given: Mapping[str, Any], build: Build) -> ChangingFlow | None:
    """The flow of a specification in which numbers change in time; None where none does.

    build: makes flows of specifications inside. Raises FlowError.
    """
    spec = {key: value for key, value in given.items() if key not in _IN_TIME}
    changing = [key for key in kind.linear_in if key in spec and _changes(spec[key])]
    _require_fixed(kind, spec)
    if not changing:
        return None
    rest = {key: value for key, value in spec.items() if key not in kind.linear_in}
    bound, breaks = given.get("longest_step"), instants(given.get("breaks"))
    step = math.inf if bound is None else number(bound, "longest_step", positive=True)
    parts, units = [], []
    for key in changing:
        part, filled = _part(kind, key, spec[key], given.get("trajectory"))
        spacing = min(step, part.source.longest_step if isinstance(part.source, Series) else step)
        part = replace(part, given_breaks=lambda end: breaks[breaks < end], spacing=spacing)
        parts.append(part)
        size = int(np.prod(part.shape, dtype=int))
        for row in np.eye(size):
            numbers = {**rest, key: filled(row.tolist())}
            units.append(kind.unchecked(numbers, build))
    if given.get("trajectory") is not None and not any(
        isinstance(part.source, GradientSeries) for part in parts
    ):
        raise FlowError("trajectory has no meaning without a series of gradients", ("trajectory",))
    steady = {key: spec[key] for key in kind.linear_in if key in spec and key not in changing}
    still = kind.unchecked({**rest, **steady}, build) if steady else None
    return ChangingFlow(Signal(parts), units, still, {"type": kind.type_name, **given})


def _require_fixed(kind: type[Flow], spec: Mapping[str, Any]) -> None:
    """Refuse times in what moves the walls or centres of a flow: it would be another one."""
    for key in spec if kind.linear_in else ():
        value = spec[key]
        entries = value if isinstance(value, (list, tuple)) else [value]
        if key not in kind.linear_in and any(_is_in_time(entry) for entry in entries):
            may = " and ".join(kind.linear_in)
            wrong = f"{key} of {kind.type_name} cannot change in time, as {may} can"
            raise FlowError(f"{wrong}: walls and centres that move make another flow", (key,))


def _is_in_time(value: Any) -> bool:
    """Whether something is a function, an expression or a series of t."""
    if isinstance(value, str):
        with suppress(ValueError):
            return callable(expression_in_time(value))
    return callable(value) or (isinstance(value, Mapping) and bool(_SERIES & set(value)))


def _changes(value: Any) -> bool:
    """Whether something in what a key is given changes in time."""
    if isinstance(value, Mapping) and not _SERIES & set(value):
        return any(_changes(entry) for entry in value.values())
    if isinstance(value, (list, tuple)):
        return any(_changes(entry) for entry in value)
    return isinstance(value, (str, Series, Mapping)) or callable(value)


def _part(
    kind: type[Flow], key: str, given: Any, trajectory: Any
) -> tuple[Part, Callable[[list[float]], Any]]:
    """The numbers of a key that change, and what makes the key's value of them in their order."""
    value, gradient, stresslet = given, key == "gradient", kind is Stresslet
    if isinstance(value, str) and ".py:" in value:
        value = load_function(value)
    elif isinstance(value, Mapping) and _SERIES & set(value):
        value = _series_of(key, value, trajectory)
    elif isinstance(value, GradientSeries) and trajectory is not None:
        value = value.path(_path_number(trajectory))
    if callable(value):
        shape = (3, 3) if stresslet else _SHAPES.get(key, ())
        if isinstance(value, Series):
            value.values(np.array([value.times[0]]))  # of one path
            count = 9 if isinstance(value, GradientSeries) else value.samples.shape[-1]
            if count != np.prod(shape, dtype=int):
                raise FlowError(f"{key} has {count} numbers in its series", (key,))
        value = _strength(value, key) if stresslet else value
        return Part(value, shape, (key,), gradient), lambda row: np.reshape(row, shape).tolist()
    leaves: list[Callable[[float], float]] = []
    filled = _leaves(value, (key,), leaves)
    shape = (len(leaves),)
    if gradient or stresslet:
        shape = (3, 3)
        rows = value if isinstance(value, (list, tuple)) else []
        if [len(row) if isinstance(row, (list, tuple)) else 0 for row in rows] != [3, 3, 3]:
            raise FlowError(f"{key} must hold 3 x 3 numbers or expressions in t", (key,))

    def source(t: float) -> Array:
        return np.reshape([leaf(t) for leaf in leaves], shape)

    given_in = _strength(source, key) if stresslet else source
    return Part(given_in, shape, (key,), gradient), filled


def _strength(source: Callable[[float], Any], key: str) -> Callable[[float], Any]:
    """The strength of a stresslet at every instant, symmetric and traceless; of samples as well."""

    def settled_at(t: float) -> Array:
        try:
            return Stresslet(np.reshape(source(t), (3, 3))).strength
        except FlowError as error:
            raise FlowFunctionError(f"at t = {t:.6g}: {error}", (key,)) from None

    if not isinstance(source, Series):
        return settled_at
    for t in source.times.tolist():
        settled_at(t)
    return source


def _leaves(
    value: Any, key: Key, leaves: list[Callable[[float], float]]
) -> Callable[[list[float]], Any]:
    """Functions of t of all numbers inside, added to `leaves`, and what puts numbers there."""
    if isinstance(value, Mapping) and not _SERIES & set(value):
        inner = {name: _leaves(entry, (*key, name), leaves) for name, entry in value.items()}
        return lambda row: {name: fill(row) for name, fill in inner.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        parts = [_leaves(entry, (*key, place), leaves) for place, entry in enumerate(value)]
        return lambda row: [fill(row) for fill in parts]
    place = len(leaves)
    if isinstance(value, str) and ".py:" in value:
        value = load_function(value)
    if isinstance(value, str):
        try:
            leaves.append(expression_in_time(value))
        except ValueError as error:
            what = f"{key[0]} must be a finite number or an expression in t"
            raise FlowError(f"{what}, not {value!r}: {error}", key) from None
    elif isinstance(value, (Mapping, Series)):
        raise FlowError(f"a series stands for the whole of {key[0]}", key)
    elif callable(value):
        leaves.append(lambda t: float(np.reshape(value(t), ())))
    else:
        fixed = number(value, ".".join(map(str, key)), key=key)
        leaves.append(lambda t: fixed)
    return lambda row: row[place]


def _path_number(trajectory: Any) -> int:
    kind = isinstance(trajectory, (int, float)) and not isinstance(trajectory, bool)
    if not kind or trajectory % 1:
        right = f"a whole number; all paths: sweep.axes: [{{flow.trajectory: {trajectory}}}]"
        raise FlowError(f"trajectory is {trajectory!r}; {right}", ("trajectory",))
    return int(trajectory)


def _series_of(key: str, given: Mapping[str, Any], trajectory: Any) -> Series:
    """The series of a file, of a process, or of numbers in the case."""
    chosen = None if trajectory is None else _path_number(trajectory)
    if key == "gradient":
        single = chosen if "rows" in given else None
        series = series_of_file(given, single)
        return series if chosen is None or single is not None else series.path(chosen)
    rules = {name: given[name] for name in ("interpolation", "outside") if name in given}
    try:
        check_keys(given, ["file", "times", "values", *rules], key)
        if "times" in given:
            found = Series(given["times"], np.asarray(given["values"], dtype=float), **rules)
        else:
            numbers = read_table(Path(str(given["file"]))).numbers
            found = Series(numbers[:, 0], numbers[:, 1:], **rules)
    except FlowError as error:
        inner = tuple(part for part in error.key if part != "gradient")
        raise FlowError(str(error), (key, *inner)) from None
    except (TableError, KeyError, TypeError, ValueError) as error:
        right = "{file: ...} of t and numbers, or {times: [...], values: [...]}"
        wrong = f"{error.args[0]} is missing" if isinstance(error, KeyError) else str(error)
        raise FlowError(f"{key}: {wrong}; {right} is expected", (key,)) from None
    return found
