"""When bodies that share a fluid come too near to each other, to a wall, or leave their flow.

A nearness is positive while all is well and tells who is concerned; where it vanishes inside a
step is found as a root on the integrator's own states, as in `contacts`. Turning points of the
coordinates of all bodies are recorded besides.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from qbxstokes.errors import ContactError, ConvergenceError, FlowError
from qbxstokes.geometry import rotation
from qbxstokes.motion.contacts import Moment, intervals, root
from qbxstokes.motion.coupled import CoupledEquations
from qbxstokes.motion.events import EventLog
from qbxstokes.motion.layout import N_MASSLESS, ORIENTATION, POSITION, Step
from qbxstokes.typing import Array

# The paths of the surfaces are taken to be at most so much longer than their chords.
_BENT = 2.0
# A piece of a step in which the surfaces move by less than this part of a body is not cut.
_FINEST = 1e-3
# Largest value of s (1 - s)^2 on [0, 1]: how far a cubic is from its chord, for what its ends miss.
_CUBIC = 4.0 / 27.0
# Part of a step at whose ends the gap shows that it is least inside, cuts of the step by the golden
# section, and how much less than before the least gap has to be to be told.
_EDGE, _CUTS, _LESS = 0.02, 20, 0.999


@dataclass(frozen=True)
class Nearness:
    """How near the bodies may still come: room to what ends the run (scene units), and its words.

    room: negative where the run has to end; gap: the least gap itself; pair: its bodies by number
    from 1, 0 the wall. name: of the event, reason: why the run ends there, who: whose it is.
    """

    room: float
    gap: float
    pair: tuple[int, int]
    name: str
    reason: str
    who: tuple[int, int]


@dataclass
class Meetings(EventLog):
    """Watches the steps of one scene; call it with every step.

    nearness: of states (N, n_state). arm (N,): largest distance of each surface from its centre.
    normal: of a wall, towards which alone ways count; edges: whether ways count for other reasons.
    turning: coordinates ("x1", "d3", ...) whose turning points are recorded of every body. Rows
    hold time, body, other body (0: none or the wall), the least gap of the scene and the body's
    position. nearest: the least gap, whose, and when.
    """

    equations: CoupledEquations
    nearness: Callable[[Array], Nearness]
    arm: Array
    normal: Array | None = None
    edges: bool = False
    turning: Sequence[str] = ()
    nearest: tuple[float, tuple[int, int], float] | None = None
    nearest_state: Array | None = None
    _latest: tuple[float, Nearness] | None = None
    _known: tuple[float, Array] | None = None
    _speeds: dict[str, list[float]] = field(default_factory=dict)

    def state(self) -> dict[str, Any]:
        """All that is remembered from step to step, as plain data for a checkpoint."""
        return super().state() | {
            "nearest": self.nearest,
            "nearest_state": None if self.nearest_state is None else self.nearest_state.tolist(),
            "speeds": {name: list(row) for name, row in self._speeds.items()},
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from what `state` gave."""
        super().restore(state)
        if state["nearest"] is not None:
            gap, pair, t = state["nearest"]
            self.nearest = gap, (pair[0], pair[1]), t
            if state.get("nearest_state") is not None:
                self.nearest_state = np.array(state["nearest_state"])
        self._speeds = {name: list(row) for name, row in state["speeds"].items()}

    def begin(self, t: float, y: Array) -> None:
        """Look at the start."""
        self._note(t, self.nearness(y), y)
        for name in self.turning:
            self._speeds[name] = self._rates(name, t, y).tolist()

    def __call__(self, step: Step) -> float | None:
        """Events of a step; the instant at which the run ends, if it does."""
        contact = self._contact(step)
        end = step.after if contact is None else contact[0]
        for name in self.turning:
            self._turn(name, step, end)
        if contact is None:
            return None
        t, near = contact
        self.ended = (near.name, near.reason)
        state = step.end if t >= step.after else step.state(t)
        self._note(t, near, state)
        self._record(near.name, t, state, *near.who, near.gap)
        return t

    # -- contacts -----------------------------------------------------------------------------

    def _contact(self, step: Step) -> tuple[float, Nearness] | None:
        """The first instant of the step at which there is no room left."""
        known = self._latest is not None and self._latest[0] == step.before
        near_start = self._latest[1] if known and self._latest else self.nearness(step.start)
        begin = (step.before, step.start, near_start)
        end = (step.after, step.end, self.nearness(step.end))
        if step.costly and self._clear(step, near_start, end[2]):
            self._note(end[0], end[2], end[1])
        else:
            for one, other in intervals(step.state, begin, end, self.nearness, self._doubt):
                if other[2].room <= 0.0:
                    return self._crossing(step, one[0], one[2], other)
                self._note(other[0], other[2], other[1])
        self._latest = end[0], end[2]
        self._least(step, near_start.gap, end[2].gap)
        return None

    def _doubt(self, begin: Moment, end: Moment) -> bool:
        """Whether bodies may have met between two moments of which the second is well."""
        travel = self._travel(begin[1], end[1])
        near = end[2].room > 0.0 and begin[2].room + end[2].room < travel
        return bool(near and travel > _FINEST * self.arm.min())

    def _clear(self, step: Step, before: Nearness, after: Nearness) -> bool:
        """Whether the cubics that have the states and rates of a step's ends keep their distance.

        By as much as they are off the straight way, too: they follow what the step resolves far
        better than that. They cost no states inside the step.
        """
        if min(before.room, after.room) <= 0.0:
            return False
        if before.room + after.room >= self._travel(step.start, step.end):
            return True
        if (found := self._cubic(step)) is None:
            return False
        cubic, margin = found

        def doubt(begin: Moment, end: Moment) -> bool:
            rooms = begin[2].room - margin, end[2].room - margin
            return bool(min(rooms) > 0.0 and sum(rooms) < self._travel(begin[1], end[1]))

        ends = (0.0, step.start, before), (1.0, step.end, after)
        parts = intervals(cubic, *ends, self.nearness, doubt)
        return all(min(one[2].room, other[2].room) > margin for one, other in parts)

    def _cubic(self, step: Step) -> tuple[Callable[[float], Array], float] | None:
        """States at parts of a step by its ends' states and rates, and what they may be off.

        None where there are no rates at the end.
        """
        length, moving, known = step.after - step.before, self.equations.moving, self._known
        try:
            last = moving(step.after, step.end)  # which the next step starts from
            own = known is not None and known[0] == step.before
            first = known[1] if known and own else moving(step.before, step.start)
        except (FlowError, ContactError, ConvergenceError):
            return None
        self._known = step.after, last
        chord = (step.end - step.start)[:, :N_MASSLESS]
        first, last = length * first - chord, chord - length * last
        bent = sum(self._apart(*self._ways(step.start, way)) for way in (first, last))

        def cubic(s: float) -> Array:
            states = step.start.copy()
            off = s * (1.0 - s) * ((1.0 - s) * first + s * last)
            states[:, :N_MASSLESS] += s * chord + off
            return states

        return cubic, 2.0 * _CUBIC * bent

    def _least(self, step: Step, before: float, after: float) -> None:
        """Note the least gap inside a step with the gaps at its ends, where it may be the least."""
        least = self.nearest[0] if self.nearest else np.inf
        if not before + after - self._travel(step.start, step.end) < 2.0 * least:
            return
        length, cubic = step.after - step.before, None
        if step.costly:
            if (found := self._cubic(step)) is None:
                return
            cubic = found[0]

        def gap(s: float) -> float:
            return self.nearness(cubic(s) if cubic else step.state(step.before + s * length)).gap

        if gap(_EDGE) >= before or gap(1.0 - _EDGE) >= after:
            return
        low, high, part = 0.0, 1.0, 0.5 * (np.sqrt(5.0) - 1.0)
        for _ in range(_CUTS):
            one, other = high - part * (high - low), low + part * (high - low)
            low, high = (low, other) if gap(one) < gap(other) else (one, high)
        s = 0.5 * (low + high)
        if gap(s) < _LESS * least:
            t = step.before + s * length
            state = step.state(t)
            self._note(t, self.nearness(state), state)

    def _crossing(
        self, step: Step, t0: float, before: Nearness, end: tuple[float, Array, Nearness]
    ) -> tuple[float, Nearness]:
        t1, states, after = end

        def room(t: float) -> float:
            return after.room if t == t1 else self.nearness(step.state(t)).room

        t = t0 if before.room <= 0.0 else root(room, t0, t1, before.room, after.room)
        return t, self.nearness(states if t == t1 else step.state(t))

    def _travel(self, start: Array, end: Array) -> float:
        """About how far surfaces can have come together, or nearer to what is at rest."""
        before, after = (rotation.axis(y[:, ORIENTATION]) for y in (start, end))
        way = end[:, POSITION] - start[:, POSITION]
        return _BENT * self._apart(way, self.arm * np.linalg.norm(after - before, axis=1))

    def _ways(self, states: Array, off: Array) -> tuple[Array, Array]:
        """Ways (N, 3) of the centres and (N,) of the surfaces by turning, of what is off a state.

        A quaternion that is off by half an angle turns the body by that angle.
        """
        return off[:, POSITION], 2.0 * self.arm * np.linalg.norm(off[:, ORIENTATION], axis=1)

    def _apart(self, way: Array, turn: Array) -> float:
        """How much ways (N, 3) and turns (N,) of the surfaces count, of what counts most."""
        ways = [0.0]
        if self.normal is not None:
            ways.append(float((np.abs(way @ self.normal) + turn).max()))
        if self.edges:
            ways.append(float((np.linalg.norm(way, axis=1) + turn).max()))
        if len(way) > 1:
            apart = np.linalg.norm(way[:, None] - way, axis=2) + turn[:, None] + turn
            ways.append(float(apart.max(where=~np.eye(len(way), dtype=bool), initial=0.0)))
        return max(ways)

    def _note(self, t: float, near: Nearness, y: Array) -> None:
        if self.nearest is None or near.gap < self.nearest[0]:
            self.nearest, self.nearest_state = (near.gap, near.pair, t), np.array(y)

    # -- turning points -----------------------------------------------------------------------

    def _rates(self, name: str, t: float, y: Array) -> Array:
        """Rates (N,) of a coordinate of the centres, or of the axes."""
        v, omega = self.equations.velocities(t, y)
        if name[0] == "d":
            v = np.cross(omega, rotation.axis(rotation.normalize(y[:, ORIENTATION])))
        return np.asarray(v[:, int(name[1]) - 1])

    def _turn(self, name: str, step: Step, end: float) -> None:
        before = np.array(self._speeds[name])
        after = self._rates(name, step.after, step.end)
        self._speeds[name] = after.tolist()
        scale = 1e-9 * max(1.0, float(np.abs(after).max()))
        for body in range(len(after)):
            a, b = float(before[body]), float(after[body])
            if a * b >= 0.0 or min(abs(a), abs(b)) <= scale:
                continue

            def rate(t: float, body: int = body) -> float:
                return float(self._rates(name, t, step.state(t))[body])

            t = root(rate, step.before, step.after, a, b)
            if t <= end:
                state = step.state(t)
                gap = self.nearness(state).gap
                self._record(f"turning_{name}", t, state, body + 1, 0, gap)

    def _record(self, name: str, t: float, y: Array, body: int, other: int, gap: float) -> None:
        row = [t, float(body), float(other), gap, *y[body - 1, POSITION].tolist()]
        self.record(name, row)
