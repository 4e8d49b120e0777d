"""Scalar functions specialised to the constants of a scene.

The kernels are general: a shear has one gradient of nine, a body in it no second derivatives, a
sphere no axis, and most bodies no load, but the kernels multiply by every zero. Here a function of
plain numbers is run once on quantities that record what is done with them. What is known (products
with 0 and 1, sums with 0, arithmetic of constants) is left out, what occurs twice is kept once, and
the rest is written as one Python function without calls. The order of the operations stays, so that
the numbers are those of the kernels to the last bit (but for the sign of a zero).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Hashable, Sequence
from typing import Any

# Operations written into one expression, one inside the other; the parser has a limit.
_DEEPEST = 20
# Functions that are remembered, and how many at most.
_KNOWN: dict[Any, Callable[..., tuple[Any, ...]]] = {}
_MOST_KNOWN = 100


class Traced:
    """A number that is known when the function runs: the outcome of a recorded operation."""

    __slots__ = ("place", "record")

    def __init__(self, record: _Record, place: int) -> None:
        self.record, self.place = record, place

    def __add__(self, other: Any) -> Any:
        return self.record.add(self, other)

    def __radd__(self, other: Any) -> Any:
        return self.record.add(other, self)

    def __sub__(self, other: Any) -> Any:
        return self.record.subtract(self, other)

    def __rsub__(self, other: Any) -> Any:
        return self.record.subtract(other, self)

    def __mul__(self, other: Any) -> Any:
        return self.record.multiply(self, other)

    def __rmul__(self, other: Any) -> Any:
        return self.record.multiply(other, self)

    def __truediv__(self, other: Any) -> Any:
        return self.record.operation("/", self, other)

    def __rtruediv__(self, other: Any) -> Any:
        return self.record.operation("/", other, self)

    def __neg__(self) -> Any:
        return self.record.negative(self)


class _Record:
    """The operations done so far, each once: entries (operator, operand, operand)."""

    def __init__(self, inputs: Sequence[str]) -> None:
        self.entries: list[tuple[Any, ...]] = [("input", name) for name in inputs]
        self._known: dict[tuple[Any, ...], Traced] = {}
        self.inputs = [Traced(self, place) for place in range(len(inputs))]

    def operation(self, operator: str, *operands: Any) -> Traced:
        """The outcome of an operation, recorded unless it was done before."""
        key = (
            operator,
            *(value.place if isinstance(value, Traced) else float(value) for value in operands),
        )
        # 0.0 and -0.0, or a place and a constant of its value, must not be taken for each other.
        kind = tuple(repr(value) for value in key)
        if operator in "+*":
            kind = (kind[0], *sorted(kind[1:]))
        if kind not in self._known:
            self._known[kind] = Traced(self, len(self.entries))
            self.entries.append(key)
        return self._known[kind]

    def negated(self, value: Any) -> Any:
        """What `value` is the negative of, or None."""
        if (
            isinstance(value, Traced)
            and self.entries[value.place][0] == "-"
            and (len(self.entries[value.place]) == 2)
        ):
            inner = self.entries[value.place][1]
            return Traced(self, inner)
        return None

    def negative(self, a: Any) -> Any:
        if not isinstance(a, Traced):
            return -a
        inner = self.negated(a)
        return self.operation("-", a) if inner is None else inner

    def add(self, a: Any, b: Any) -> Any:
        if _is(a, 0.0):
            return b
        if _is(b, 0.0):
            return a
        if (inner := self.negated(b)) is not None:
            return self.subtract(a, inner)
        if (inner := self.negated(a)) is not None:
            return self.subtract(b, inner)
        return self.operation("+", a, b)

    def subtract(self, a: Any, b: Any) -> Any:
        if _is(b, 0.0):
            return a
        if _is(a, 0.0):
            return self.negative(b)
        if (inner := self.negated(b)) is not None:
            return self.add(a, inner)
        return self.operation("-", a, b)

    def multiply(self, a: Any, b: Any) -> Any:
        for one, other in ((a, b), (b, a)):
            if _is(one, 0.0):
                return 0.0
            if _is(one, 1.0):
                return other
            if _is(one, -1.0):
                return self.negative(other)
            if (inner := self.negated(one)) is not None:
                return self.negative(self.multiply(inner, other))
        return self.operation("*", a, b)


def _is(value: Any, constant: float) -> bool:
    return not isinstance(value, Traced) and value == constant


def specialise(
    function: Callable[[list[Any], list[Any]], Sequence[Any]],
    n_rows: int,
    n_more: int = 0,
    key: Hashable = None,
) -> Callable[..., tuple[Any, ...]]:
    """The function (t, rows, more) -> values that does what `function(rows, more)` does.

    function: of lists of n_rows and n_more numbers; it may use +, -, *, / and unary minus on them,
    and branch on constants alone. The time is not read: every right-hand side is handed it. key:
    all that the function depends on, under which it is remembered; None: it is not.
    """
    if key is not None and (known := _KNOWN.get((key, n_rows, n_more))) is not None:
        return known
    rows, more = [f"y{i}" for i in range(n_rows)], [f"p{i}" for i in range(n_more)]
    record = _Record([*rows, *more])
    values = function(record.inputs[:n_rows], record.inputs[n_rows:])
    lines, results = _written(record.entries, values)
    if more:
        lines.insert(0, f"{', '.join(more)}, = more")
    lines = [f"{', '.join(rows)}, = rows", *lines, f"return ({', '.join(results)},)"]
    source = "\n    ".join(["def specialised(t, rows, more=()):", *lines])
    namespace: dict[str, Any] = {"inf": math.inf, "nan": math.nan}
    exec(compile(source, "<specialised right-hand side>", "exec"), namespace)
    specialised: Callable[..., tuple[Any, ...]] = namespace["specialised"]
    if key is not None:
        if len(_KNOWN) >= _MOST_KNOWN:
            _KNOWN.clear()
        _KNOWN[key, n_rows, n_more] = specialised
    return specialised


def _written(entries: list[tuple[Any, ...]], values: Sequence[Any]) -> tuple[list[str], list[str]]:
    """Assignments, and an expression for each value; an entry used once is written in place."""
    uses = Counter(value.place for value in values if isinstance(value, Traced))
    for place in range(len(entries) - 1, -1, -1):
        if uses[place]:
            uses.update(operand for operand in entries[place][1:] if isinstance(operand, int))
    texts: dict[int, str] = {}
    depths: dict[int, int] = {}
    lines = []

    def text(operand: Any) -> str:
        return texts[operand] if isinstance(operand, int) else repr(operand)

    for place, (operator, *operands) in enumerate(entries):
        if not uses[place]:
            continue
        if operator == "input":
            texts[place], depths[place] = operands[0], 0
            continue
        parts = [text(operand) for operand in operands]
        texts[place] = f"({parts[0]} {operator} {parts[1]})" if parts[1:] else f"(-{parts[0]})"
        depths[place] = 1 + max(depths.get(operand, 0) for operand in operands)
        if uses[place] > 1 or depths[place] > _DEEPEST:
            lines.append(f"a{place} = {texts[place]}")
            texts[place], depths[place] = f"a{place}", 0
    return lines, [
        text(value.place if isinstance(value, Traced) else float(value)) for value in values
    ]
