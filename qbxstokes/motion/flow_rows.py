"""The numbers of a block's flows that change in time, from instant to instant.

Flows are numbers (`taylor.pack_flow`), some of which are sums of what changes (`flows.signals`).
While a motion is followed they are polynomials in pieces of time, the same ones for all flows of
the block, the plain kernels and the compiled loop; before that the flows themselves are asked.
"""

from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from qbxstokes.errors import FlowError
from qbxstokes.flows.changing import ChangingFlow
from qbxstokes.flows.signals import Sampled, Signal
from qbxstokes.motion.lanes import PerLane
from qbxstokes.motion.taylor import pack_flow
from qbxstokes.typing import Array, Integers

_PACKED: WeakKeyDictionary[ChangingFlow, Array] = WeakKeyDictionary()


class FlowRows:
    """Rows of the table of the flows of a block, (m,) or (m, n_lanes), that change.

    rows: their places. group (n_lanes,): which of the flows that change a lane has, -1: none; None:
    all have one.
    """

    def __init__(self, flows: PerLane[Any], table: Array) -> None:
        self.group: Integers | None = None
        if not flows.shared:
            self.group = np.full(table.shape[1], -1)
        self._flows: list[ChangingFlow] = []
        for flow, lanes in flows.groups():
            if isinstance(flow, ChangingFlow):
                if self.group is not None:
                    self.group[lanes] = len(self._flows)
                self._flows.append(flow)
        packed = [_packed(flow) for flow in self._flows]
        pairs = list(zip(self._flows, packed, strict=True))
        self.rows = 4 + np.flatnonzero(
            np.any([every[4:, : len(flow.units)].any(axis=1) for flow, every in pairs], axis=0)
        )
        # The rows of a flow are still + matrix f(t).
        self._matrices = [every[self.rows, : len(flow.units)] for flow, every in pairs]
        self._still = np.stack(
            [every[self.rows, len(flow.units) :].sum(axis=1) for flow, every in pairs], axis=1
        )
        signals = [flow.signal for flow in self._flows]
        parts = [part for signal in signals for part in signal.parts]
        self._signal = signals[0] if len(signals) == 1 else Signal(parts)
        self._table = table
        self._sampled: Sampled | None = None
        self._known: tuple[Any, Array] = (None, self._still)
        # Ends of the piece asked for last, its origin and scale, and its coefficients, last first.
        self._piece: tuple[float, float, float, float, Any] = (0.0, 0.0, 0.0, 0.0, None)

    def sample(self, end: float, accuracy: float, longest: float) -> bool:
        """From now on be polynomials in time, for motions that end at `end`; whether others."""
        before, self._sampled = self._sampled, self._signal.sampled(end, accuracy, longest)
        self._piece = (0.0, 0.0, 0.0, 0.0, None)
        return before is not self._sampled

    def cover(self, begin: float, t: float) -> float:
        """Know the flows from `begin` to t, if possible; the instant up to which they are known."""
        assert self._sampled is not None
        return self._sampled.cover(t, begin)

    def near(self, t: float) -> tuple[float, float]:
        """How far a step from t may go to see what the flow does, and where the flow jumps next."""
        assert self._sampled is not None
        return self._sampled.near(t)

    def seen(self, t: float) -> tuple[Array, float]:
        """What steps from t are to see, and how far they may go (`Sampled.seen`)."""
        assert self._sampled is not None
        return self._sampled.seen(t)

    def follow(self, other: "FlowRows") -> None:
        """Be as well known as the same flows of another block."""
        self._sampled, self._signal = other._sampled, other._signal

    def at(self, t: Any) -> Any:
        """The rows at a time: numbers, or rows (n_lanes,) for lanes that differ.

        t: or times (n_lanes,), one for each lane.
        """
        if isinstance(t, np.ndarray):
            return self._of_lanes(t)
        t = min(t, self.last)
        if not self._piece[0] <= t < self._piece[1]:
            place = -1 if self._sampled is None else self._sampled.piece(t)
            if place < 0 or self._sampled is None:
                return self._placed(self._asked(t))
            known = self._sampled
            powers: Any = self._coefficients()[place, ::-1]
            if self.group is None:
                powers = powers[:, :, 0].T.tolist()
            low, high = known.edges[place : place + 2].tolist()
            self._piece = low, high, known.origins[place], known.scales[place], powers
        _, _, origin, scale, powers = self._piece
        x = float((t - origin) * scale)
        if self.group is None:
            return [_value(row, x) for row in powers]
        return self._placed(_value(powers, x))

    def _of_lanes(self, t: Array) -> list[Array]:
        """Rows (n_lanes,) at times (n_lanes,)."""
        t, known = np.minimum(t, self.last), self._sampled
        found = np.empty((len(t), len(self.rows)))
        lanes = np.arange(len(t)) if self.group is None else np.flatnonzero(self.group >= 0)
        group = np.zeros(len(t), np.int64) if self.group is None else self.group
        if known is None or min(known.piece(float(t.min())), known.piece(float(t.max()))) < 0:
            for lane in lanes:
                found[lane] = self._asked(float(t[lane]))[:, group[lane]]
        else:
            places = known.pieces(t[lanes])
            x = ((t[lanes] - known.origins[places]) * known.scales[places])[:, None]
            powers = self._coefficients()[places, ..., group[lanes]]
            found[lanes] = _value([powers[:, k] for k in range(powers.shape[1] - 1, -1, -1)], x)
        if len(lanes) < len(t):
            others = np.setdiff1d(np.arange(len(t)), lanes)
            found[others] = self._table[self.rows][:, others].T
        return list(found.T)

    def _asked(self, t: float) -> Array:
        """The rows (rows, flows) by the flows themselves."""
        pairs = zip(self._flows, self._matrices, strict=True)
        found = np.stack([matrix @ flow.signal.at(t) for flow, matrix in pairs], axis=1)
        return np.asarray(self._still + found)

    def _placed(self, values: Array) -> Any:
        """Rows (rows, flows) to the lanes."""
        if self.group is None:
            return values[:, 0].tolist()
        lanes = self.group >= 0
        found = self._table[self.rows]
        found[:, lanes] = values[:, self.group[lanes]]
        return list(found)

    def _coefficients(self) -> Array:
        """Those of the rows, (pieces, degree + 1, rows, flows)."""
        assert self._sampled is not None
        given = self._sampled.coefficients
        if self._known[0] is not given:
            ends = np.cumsum([matrix.shape[1] for matrix in self._matrices])
            parts = np.split(given, ends[:-1], axis=2)
            pairs = zip(parts, self._matrices, strict=True)
            found = np.stack([part @ matrix.T for part, matrix in pairs], axis=3)
            found[:, 0] += self._still
            self._known = given, found
        return self._known[1]

    @property
    def refusal(self) -> FlowError | None:
        """What a flow said where it is known no further."""
        return None if self._sampled is None else self._sampled.refusal

    @property
    def asked(self) -> int:
        """At how many instants functions of the flows were asked."""
        return 0 if self._sampled is None else self._sampled.asked

    @property
    def last(self) -> float:
        """The instant as of which later ones are seen (`Flow.until`)."""
        return self._flows[0].signal.last

    @property
    def pieces(self) -> tuple[Array, Array, Array, Array]:
        """Edges, origins and scales of the pieces, and coefficients of the rows."""
        known = self._sampled
        assert known is not None
        return known.edges, known.origins, known.scales, self._coefficients()


def _packed(flow: ChangingFlow) -> Array:
    """The numbers of its terms, (64, terms), made once."""
    if flow not in _PACKED:
        _PACKED[flow] = np.stack([pack_flow(term) for term in flow.polynomials], axis=1)
    return _PACKED[flow]


def _value(coefficients: Any, x: float) -> Any:
    """The polynomial of coefficients, that of the highest power first: as in the compiled loop."""
    found = coefficients[0]
    for coefficient in coefficients[1:]:
        found = found * x + coefficient
    return found
