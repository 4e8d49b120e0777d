"""The numbers of a block's flows that change in time, from instant to instant.

Flows are numbers (`taylor.pack_flow`), some of which are sums of what changes (`flows.signals`).
While a motion is followed they are polynomials in pieces of time, the same ones for the plain
kernels and the compiled loop; before that the flows themselves are asked.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from qbxstokes.errors import FlowError
from qbxstokes.flows.changing import ChangingFlow
from qbxstokes.flows.signals import Sampled
from qbxstokes.motion.lanes import PerLane
from qbxstokes.motion.taylor import pack_flow

Array = NDArray[np.float64]


class FlowRows:
    """Rows of the table of the flows of a block, (m,) or (m, n_lanes), that change.

    rows: their places; single: whether all lanes share one flow.
    """

    def __init__(self, flows: PerLane[Any], table: Array) -> None:
        changing = [
            (flow, lanes, np.stack([pack_flow(term) for term in flow.polynomials], axis=1))
            for flow, lanes in flows.groups()
            if isinstance(flow, ChangingFlow)
        ]
        some = np.any(
            [matrix[4:, : len(flow.units)].any(axis=1) for flow, _, matrix in changing], 0
        )
        self.rows = 4 + np.flatnonzero(some)
        self.single = flows.shared
        self._others = table[self.rows]
        self._of: list[_RowsOfFlow] = []
        self._lanes = []
        for flow, lanes, matrix in changing:
            rows, count = matrix[self.rows], len(flow.units)
            self._of.append(_RowsOfFlow(flow, rows[:, :count], rows[:, count:].sum(axis=1)))
            self._lanes.append(lanes)

    def at(self, t: float) -> Any:
        """The rows at a time: numbers, or rows (n_lanes,) for lanes that differ."""
        if self.single:
            return self._of[0].at(t)
        values = self._others
        for own, lanes in zip(self._of, self._lanes, strict=True):
            values[:, lanes] = np.array(own.at(t))[:, None]
        return list(values)

    def sample(self, end: float, accuracy: float, longest: float) -> None:
        """From now on be polynomials in time, for motions that end at `end`."""
        for own in self._of:
            own.take(own.flow.signal.sampled(end, accuracy, longest))

    def cover(self, begin: float, t: float) -> float:
        """Know the flows from `begin` to t, if possible; the instant up to which they are known."""
        return min(own.sampled.cover(t, begin) for own in self._of if own.sampled is not None)

    @property
    def refusal(self) -> FlowError | None:
        """What a flow said where it is known no further."""
        found = (own.sampled.refusal for own in self._of if own.sampled is not None)
        return next((refusal for refusal in found if refusal is not None), None)

    @property
    def asked(self) -> int:
        """How often the flows were asked."""
        return sum(own.sampled.asked for own in self._of if own.sampled is not None)

    @property
    def last(self) -> float:
        """The instant as of which later ones are seen (`Flow.until`)."""
        return float(self._of[0].flow.signal.last)

    @property
    def pieces(self) -> tuple[Array, Array, Array, Array]:
        """Edges, origins, scales and coefficients of the rows, of one flow."""
        own = self._of[0]
        assert own.sampled is not None
        return own.sampled.edges, own.sampled.origins, own.sampled.scales, own.coefficients()


class _RowsOfFlow:
    """still + matrix f(t) of one flow."""

    def __init__(self, flow: ChangingFlow, matrix: Array, still: Array) -> None:
        self.flow, self._matrix, self._still = flow, matrix, still
        self.sampled: Sampled | None = None
        self._known: tuple[Any, Array] = (None, still)
        # Ends of the piece asked for last, its origin and scale, and its coefficients by row.
        self._piece: tuple[float, float, float, float, list[list[float]]] = (0.0, 0.0, 0.0, 0.0, [])

    def take(self, sampled: Sampled) -> None:
        """From now on be what was sampled."""
        self.sampled, self._piece = sampled, (0.0, 0.0, 0.0, 0.0, [])

    def at(self, t: float) -> list[float]:
        """The rows at an instant."""
        t = min(t, self.flow.signal.last)
        if not self._piece[0] <= t < self._piece[1]:
            place = -1 if self.sampled is None else self.sampled.piece(t)
            if place < 0 or self.sampled is None:
                asked: list[float] = (self._still + self._matrix @ self.flow.signal.at(t)).tolist()
                return asked
            edges, of = self.sampled.edges, (self.sampled.origins, self.sampled.scales)
            ends = edges[place : place + 2].tolist()
            powers = self.coefficients()[place, ::-1].T.tolist()
            self._piece = *ends, *(float(part[place]) for part in of), powers
        _, _, origin, scale, powers = self._piece
        x, found = (t - origin) * scale, []
        for row in powers:  # in the order of the compiled loop
            value = 0.0
            for coefficient in row:
                value = value * x + coefficient
            found.append(value)
        return found

    def coefficients(self) -> Array:
        """Those of the rows, (pieces, degree + 1, rows)."""
        assert self.sampled is not None
        given = self.sampled.coefficients
        if self._known[0] is not given:
            rows = given @ self._matrix.T
            rows[:, 0] += self._still
            self._known = given, rows
        return self._known[1]
