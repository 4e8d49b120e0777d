"""When the surface of a body first reaches something: the edge of its flow, a singular point.

A gap is a distance between surfaces, which changes no faster than the surfaces move: between the
ends of a step it is followed as closely as is needed to miss no touch, and where it vanishes is
found as a root on the integrator's own states, for any number of lanes at once.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from qbxstokes.flows.domain import Edge
from qbxstokes.geometry import rotation
from qbxstokes.geometry.shape import Shape
from qbxstokes.motion.layout import ORIENTATION, POSITION, Step
from qbxstokes.typing import Array

# The path of the surface is taken to be at most so much longer than its chord.
_BENT = 2.0
# A piece of a step in which the surface moves by less than this part of the body is not cut.
_FINEST = 1e-3
_MOST = 60
_EPSILON = 2.0**-50

# An instant, the state there, and what is seen in it.
Moment = tuple[float, Any, Any]


def intervals(
    state: Callable[[float], Any],
    begin: Moment,
    end: Moment,
    look: Callable[[Any], Any],
    doubt: Any,
) -> Iterator[tuple[Moment, Moment]]:
    """The intervals into which one is cut so that nothing is missed inside any, in their order.

    A moment is an instant, the state there and what `look` makes of it. doubt: whether something
    may lie between two moments; those in between are asked for their states then.
    """
    todo = [end]
    while todo:
        middle = 0.5 * (begin[0] + todo[-1][0])
        if begin[0] < middle < todo[-1][0] and doubt(begin, todo[-1]):
            there = state(middle)
            todo.append((middle, there, look(there)))
            continue
        yield begin, todo[-1]
        begin = todo.pop()


def root(function: Callable[[float], float], a: float, b: float, fa: float, fb: float) -> float:
    """Zero of a function between a and b, where it has the values fa and fb of different signs.

    Inverse quadratic interpolation safeguarded by bisection (T. R. Chandrupatla 1997, Adv. Eng.
    Softw. 28, 145); to rounding of the argument.
    """
    if fa == 0.0 or fb == 0.0:
        return a if fa == 0.0 else b
    t, best = fa / (fa - fb), a  # the first guess is the secant's
    for _ in range(_MOST):
        x = a + t * (b - a)
        fx = function(x)
        if fx == 0.0:
            return x
        if (fx > 0.0) == (fa > 0.0):
            c, fc = a, fa
        else:
            c, b, fc, fb = b, a, fb, fa
        a, fa = x, fx
        best = a if abs(fa) < abs(fb) else b
        if a == b:
            return best
        nearest = (_EPSILON * abs(best) + 1e-300) / abs(b - a)
        if nearest >= 0.5:
            return best
        xi, phi = (a - b) / (c - b), (fa - fb) / (fc - fb)
        t = 0.5
        if phi * phi < xi and (1.0 - phi) ** 2 < 1.0 - xi:
            t = fa / (fb - fa) * fc / (fb - fc)
            t += (c - a) / (b - a) * fa / (fc - fa) * fb / (fc - fb)
        t = min(1.0 - nearest, max(nearest, t))
    return best


@dataclass(frozen=True)
class Gap:
    """Something that some lanes must not reach.

    name: of the event. distance: (m,) from states (m, n_state) of these lanes. room: that of their
    centres (m, 3), which is quickly found. reason: what ends a lane that reaches it. least: what is
    left of the way to the thing itself where the distance is zero.
    """

    name: str
    distance: Callable[[Array], Array]
    room: Callable[[Array], Array]
    reason: str
    lanes: slice
    least: float = 0.0


@dataclass(frozen=True)
class Contact:
    """A lane has reached something: its number, the instant, its state, event and reason."""

    lane: int
    t: float
    state: Array
    name: str
    reason: str


def edge_gap(edge: Edge, shape: Shape, lanes: slice) -> Gap:
    """The gap to an edge of the flow's domain."""

    def distance(states: Array) -> Array:
        axes = rotation.axis(rotation.normalize(states[:, ORIENTATION]))
        return edge.gap(states[:, POSITION], shape.extent(axes))

    reason = f"the body's surface reached {edge}, where its flow ends"
    return Gap("domain_exit", distance, edge.room, reason, lanes)


def singular_gap(points: Array, shape: Shape, least: float) -> Gap:
    """The gap to the singular points of a flow, of which `least` must be left."""

    def distance(states: Array) -> Array:
        axes = rotation.axis(rotation.normalize(states[:, ORIENTATION]))
        away = shape.clearance(points, states[:, POSITION], axes)
        return np.asarray(away.min(axis=-1) - least)

    def room(centres: Array) -> Array:
        away = np.linalg.norm(centres[:, None, :] - points, axis=-1)
        return np.asarray(away.min(axis=-1) - least)

    reason = f"a singular point of the flow is {least:.3g} from the surface"
    return Gap("clearance", distance, room, reason, slice(None), least)


class Contacts:
    """Watches the gaps of all lanes; call it with every step.

    arm (n,): largest distance of a surface from its centre. ended: contacts by lane, the first of
    each. nearest: of every event, the least way to the thing, if less than a body length, that was
    seen at the end of a step or of a lane, and when.
    """

    def __init__(self, gaps: Sequence[Gap], arm: Array) -> None:
        self.gaps, self._arm = tuple(gaps), arm
        self.ended: dict[int, Contact] = {}
        self.nearest: dict[str, tuple[float, float]] = {}
        self._before: tuple[float, Array] | None = None

    def distances(self, states: Array) -> Array:
        """All gaps (gaps, n); infinite for lanes that they do not concern, or that have ended."""
        found = np.full((len(self.gaps), len(states)), np.inf)
        for row, gap in zip(found, self.gaps, strict=True):
            row[gap.lanes] = gap.distance(states[gap.lanes])
        found[:, list(self.ended)] = np.inf
        return found

    def __call__(self, step: Step) -> list[Contact]:
        """The first contacts of lanes within a step, in their order."""
        if self._far(step):
            self._before = None
            return []
        if self._before is None or self._before[0] != step.before:
            self._before = step.before, self.distances(step.start)
        begin = (step.before, step.start, self._before[1])
        end = (step.after, step.end, self.distances(step.end))
        found: list[Contact] = []
        for one, other in intervals(step.state, begin, end, self.distances, self._doubt):
            found += self._crossings(step, one, other)
            other[2][:, list(self.ended)] = np.inf
        self._before = end[0], end[2]
        self._note(*self._before)
        return sorted(found, key=lambda contact: contact.t)

    def _doubt(self, begin: Moment, end: Moment) -> bool:
        """Whether something may lie between two moments of which neither is beyond."""
        travel = self._travel(begin[1], end[1])
        near = (end[2] > 0.0) & (begin[2] + end[2] < travel)
        return bool(np.any(near & (travel > _FINEST * self._arm)))

    def _far(self, step: Step) -> bool:
        """Whether every lane is a body length and its way from everything, at both ends."""
        start, end = step.start[:, POSITION], step.end[:, POSITION]
        least = 3.0 * self._arm + _BENT * np.linalg.norm(end - start, axis=1)
        least[list(self.ended)] = -np.inf
        return all(
            np.all(gap.room(centres[gap.lanes]) > least[gap.lanes])
            for gap in self.gaps
            for centres in (start, end)
        )

    def _travel(self, start: Array, end: Array) -> Array:
        """About how far the surface of each lane moves at most, (n,)."""
        axes = [rotation.axis(rotation.normalize(y[:, ORIENTATION])) for y in (start, end)]
        way = np.linalg.norm(end[:, POSITION] - start[:, POSITION], axis=1)
        turn = np.linalg.norm(axes[1] - axes[0], axis=1)
        return np.asarray(_BENT * (way + self._arm * turn))

    def _crossings(
        self, step: Step, begin: tuple[float, Array, Array], end: tuple[float, Array, Array]
    ) -> list[Contact]:
        """Lanes whose gap vanishes between two instants of the step."""
        (t0, _, before), (t1, last, after) = begin, end
        found: list[Contact] = []
        for lane in np.flatnonzero(np.any(after <= 0.0, axis=0)).tolist():
            first: tuple[float, Gap] | None = None
            for row, gap in enumerate(self.gaps):
                if not after[row, lane] <= 0.0:
                    continue

                def value(t: float, row: int = row, lane: int = lane) -> float:
                    states = last if t == t1 else step.state(t)
                    return float(self.distances(states)[row, lane])

                t = (
                    t0
                    if before[row, lane] <= 0.0
                    else root(value, t0, t1, float(before[row, lane]), float(after[row, lane]))
                )
                if first is None or t < first[0]:
                    first = t, gap
            assert first is not None
            t, gap = first
            state = (last if t == t1 else step.state(t))[lane].copy()
            found.append(Contact(lane, t, state, gap.name, gap.reason))
            self.nearest[gap.name] = gap.least, t
        for contact in found:
            self.ended[contact.lane] = contact
        return found

    def _note(self, t: float, distances: Array) -> None:
        """Remember the least gaps."""
        for gap, row in zip(self.gaps, distances, strict=True):
            lane = int(row.argmin())
            way = float(row[lane]) + gap.least
            if way < self.nearest.get(gap.name, (2.0 * self._arm[lane], t))[0]:
                self.nearest[gap.name] = way, t
