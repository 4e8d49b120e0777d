"""Events of a motion: what is watched for between steps, and where inside a step it happens.

An event is a sign change of a function of (t, y). It is bracketed by the ends of a step, or of the
pieces into which a step is cut where the axis turns far, and found as a root of the function of the
integrator's own states inside the step: to rounding in time, as accurate as the steps in place.
States are rows of one body: x, q and, for St > 0, V and W (numbers, see `equations`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from qbxstokes.geometry import rotation
from qbxstokes.motion.averages import ShearFrame
from qbxstokes.motion.contacts import Contacts, Moment, intervals, root
from qbxstokes.motion.diagnostics import orbit_constant
from qbxstokes.motion.equations import RigidBodyEquations
from qbxstokes.motion.layout import ORIENTATION, POSITION, VELOCITY, Step
from qbxstokes.motion.taylor import symmetry_axis
from qbxstokes.typing import Array

Row = Sequence[float]
Function = Callable[[float, Row], float]

# A step is cut in pieces in which the axis turns less than this (stretched angle, radians).
LARGEST_TURN = 1.0
# Axes this near to the normal of the plane of turning do not pass through any plane.
STILL = 1e-8


@dataclass(frozen=True)
class Event:
    """A function whose sign change is an event.

    direction: 1 for rising, -1 for falling, 0 for both. threshold: values of at most this size are
    rounding, and have no sign. ends: whether the run ends there, for `reason`.
    """

    name: str
    function: Function
    direction: int = 0
    threshold: float = 0.0
    ends: bool = False
    reason: str = ""


@dataclass
class Passage:
    """Passages of the axis through a plane that holds the direction `about`.

    normal: of the plane. Half-turns are followed by the angle of the axis about `about`, with the
    component along `normal` times `stretch`.
    """

    normal: Array
    about: Array
    stretch: float

    @classmethod
    def of(cls, gradient: Array, effective_ratio: float, plane: Array | None = None) -> Passage:
        """The plane through which a body in this velocity gradient swings fastest, or a given one.

        In a shear the axis of a prolate body passes the plane normal to the stream fastest, that
        of an oblate one the plane of stream and vorticity: there instants are known best.
        """
        frame = ShearFrame.of(gradient)
        stream, across, about = frame.axes
        if plane is not None:
            normal = plane / np.linalg.norm(plane)
            about = about - (about @ normal) * normal
            if np.linalg.norm(about) < 1e-6:  # a plane that the vorticity turns into itself
                about = np.eye(3)[int(np.argmin(np.abs(normal)))]
                about = about - (about @ normal) * normal
            return cls(normal, about / np.linalg.norm(about), 1.0)
        k = effective_ratio if frame.simple else 1.0
        return cls(stream, about, k) if k <= 1.0 else cls(across, about, 1.0 / k)

    def __post_init__(self) -> None:
        """Numbers for plain arithmetic."""
        a, n = self.about.tolist(), self.normal.tolist()
        across = (a[i - 2] * n[i - 1] - a[i - 1] * n[i - 2] for i in range(3))
        self.planes = (*n, *across)

    def components(self, y: Row) -> tuple[float, float]:
        """Components of the axis along the normal and across it; zero for an axis at rest."""
        d1, d2, d3 = symmetry_axis(y[ORIENTATION])
        n1, n2, n3, a1, a2, a3 = self.planes
        along, across = d1 * n1 + d2 * n2 + d3 * n3, d1 * a1 + d2 * a2 + d3 * a3
        return (along, across) if math.hypot(along, across) > STILL else (0.0, 0.0)

    def value(self, t: float, y: Row) -> float:
        """Component along the normal, which changes sign at every passage."""
        return self.components(y)[0]

    def angle(self, y: Row) -> float:
        """Stretched angle of the axis about `about`."""
        along, across = self.components(y)
        return math.atan2(across, self.stretch * along)


@dataclass(kw_only=True)
class EventLog:
    """What was seen in a run.

    found: rows by name since `take` was called last. first, last: rows of the whole run; counts:
    how many there were. ended: name and reason of what ended the run.
    """

    found: dict[str, list[list[float]]] = field(default_factory=dict)
    counts: dict[str, int] = field(default_factory=dict)
    first: dict[str, list[float]] = field(default_factory=dict)
    last: dict[str, list[float]] = field(default_factory=dict)
    ended: tuple[str, str] = ("", "")

    def state(self) -> dict[str, Any]:
        """All that is remembered from step to step, as plain data for a checkpoint."""
        return {
            "counts": dict(self.counts),
            "first": {name: list(row) for name, row in self.first.items()},
            "last": {name: list(row) for name, row in self.last.items()},
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from what `state` gave."""
        self.counts = dict(state["counts"])
        self.first, self.last = dict(state["first"]), dict(state["last"])

    def take(self) -> dict[str, Array]:
        """The rows found since the last call."""
        found = {name: np.array(rows) for name, rows in self.found.items()}
        self.found = {}
        return found

    def record(self, name: str, row: list[float]) -> None:
        """Note an event."""
        self.found.setdefault(name, []).append(row)
        self.counts[name] = self.counts.get(name, 0) + 1
        self.first.setdefault(name, row)
        self.last[name] = row


@dataclass
class Events(EventLog):
    """The events of one body's motion; call it with every step.

    frame: of the shear in which the orbit constant is meant. contacts: what the body must not
    reach, which ends the run. Rows hold time, position (3), axis (3), velocity (3), orbit constant;
    a half-turn has the time and the displacement since the last but one besides, a whole turn.
    """

    equations: RigidBodyEquations
    passage: Passage | None = None
    events: Sequence[Event] = ()
    frame: ShearFrame | None = None
    contacts: Contacts | None = None
    recent: list[list[float]] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Put the half-turns with the other events."""
        self._all = list(self.events)
        if self.passage is not None:
            self._all.insert(0, Event("half_turns", self.passage.value))
        self._signs: dict[str, float] = {}

    @property
    def idle(self) -> bool:
        """Whether there is nothing to watch for."""
        return self.seldom and self.passage is None

    @property
    def seldom(self) -> bool:
        """Whether only steps in which the axis passes a plane have to be seen, if any."""
        return not self.events and self.contacts is None

    def state(self) -> dict[str, Any]:
        """All that is remembered from step to step, as plain data for a checkpoint."""
        return super().state() | {
            "recent": [list(row) for row in self.recent],
            "signs": dict(self._signs),
            "nearest": {} if self.contacts is None else dict(self.contacts.nearest),
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from what `state` gave."""
        super().restore(state)
        self.recent = [list(row) for row in state["recent"]]
        self._signs = dict(state["signs"])
        if self.contacts is not None:
            self.contacts.nearest = {name: tuple(least) for name, least in state["nearest"].items()}

    def begin(self, t: float, y: Array) -> None:
        """Look at the start, where a body may be at rest already."""
        row = y[0].tolist()
        for event in self._all:
            if event.name == "steady" and event.function(t, row) < 0.0:
                self._record(event, t, y)

    def __call__(self, step: Step) -> float | None:
        """Events of a step, recorded in order; the instant at which the run ends, if it does."""
        reached = None if self.contacts is None else next(iter(self.contacts(step)), None)
        for (t0, y0, _), (t1, y1, _) in self._pieces(step):
            hits = []
            if reached is not None and t0 <= reached.t <= t1:
                ends = Event(reached.name, lambda t, y: 0.0, ends=True, reason=reached.reason)
                hits.append((reached.t, ends))
            for event in self._all:
                t = self._crossing(event, step, t0, y0, t1, y1)
                if t is not None:
                    hits.append((t, event))
            for t, event in sorted(hits, key=lambda hit: hit[0]):
                self._record(event, t, step.end if t >= step.after else step.state(t))
                if event.ends:
                    self.ended = (event.name, event.reason)
                    return t
        return None

    def _pieces(self, step: Step) -> Iterator[tuple[Moment, Moment]]:
        """Parts of the step, cut so that no half-turn is passed over."""
        least = 1e-9 * (step.after - step.before)

        def row(t: float) -> Row:
            return step.state(t)[0].tolist()  # type: ignore[no-any-return]

        def doubt(begin: Moment, end: Moment) -> bool:
            turn = abs(math.remainder(end[2] - begin[2], 2.0 * math.pi))
            return turn > LARGEST_TURN and end[0] - begin[0] > least

        angle = self.passage.angle if self.passage is not None else lambda y: 0.0
        first, last = step.start[0].tolist(), step.end[0].tolist()
        ends = (step.before, first, angle(first)), (step.after, last, angle(last))
        return intervals(row, *ends, angle, doubt)

    def _crossing(
        self, event: Event, step: Step, t0: float, y0: Row, t1: float, y1: Row
    ) -> float | None:
        """Instant in [t0, t1] at which the event's function changes sign, if it does."""
        function, name = event.function, event.name

        def sign_of(value: float) -> float:
            return math.copysign(1.0, value) if abs(value) > event.threshold else 0.0

        # The sign before is that of the last value that was not rounding.
        before = self._signs.get(name)
        if before is None:
            before = sign_of(function(t0, y0))
        b = function(t1, y1)
        now = sign_of(b)
        self._signs[name] = now or before
        if not now or not before or now == before:
            return None
        if event.direction and now != event.direction:
            return None
        a = function(t0, y0)
        if a == 0.0 or math.copysign(1.0, a) == now:
            return t0
        return root(lambda t: function(t, step.state(t)[0].tolist()), t0, t1, a, b)

    def _record(self, event: Event, t: float, y: Array) -> None:
        axis = rotation.axis(rotation.normalize(y[:, ORIENTATION]))[0]
        v, _ = self.equations.velocities(t, y)
        constant = math.nan
        if self.frame is not None:
            k = self.equations.model.effective_ratio
            constant = float(orbit_constant(axis, k, self.frame.axes))
        row = [t, *y[0, POSITION].tolist(), *axis.tolist(), *v[0].tolist(), constant]
        if event.name == "half_turns":
            turn = [math.nan] * 4
            if len(self.recent) == 2:
                earlier = self.recent.pop(0)
                turn = [now - then for now, then in zip(row[0:4], earlier, strict=True)]
            self.recent.append(row[0:4])
            row += turn
        self.record(event.name, row)


def turning_point(equations: RigidBodyEquations, component: str, scale: float) -> Event:
    """The instant at which a coordinate of the centre (x1 ...) or the axis (d1 ...) turns back.

    scale: size of velocities, against which rounding is told.
    """
    index = int(component[1]) - 1

    def rate(t: float, y: Row) -> float:
        v, omega = equations.velocities(t, np.array(y)[None])
        if component[0] == "x":
            return float(v[0, index])
        return float(np.cross(omega[0], symmetry_axis(y[ORIENTATION]))[index])

    return Event(f"turning_{component}", rate, threshold=1e-12 * scale)


def steady(equations: RigidBodyEquations, rate: float, ends: bool) -> Event:
    """The instant from which axis and velocity change by less than `rate` per unit of time.

    The velocity of a body without inertia follows from its axis and place; only its axis is looked
    at.
    """

    def excess(t: float, y: Row) -> float:
        _, omega = equations.velocities(t, np.array(y)[None])
        change = float(np.linalg.norm(np.cross(omega[0], symmetry_axis(y[ORIENTATION]))))
        if not equations.massless:
            change += float(np.linalg.norm(np.array(equations.rate_of_rows(t, y))[VELOCITY]))
        return change - rate

    reason = f"steady: axis and velocity change by less than {rate:g} per unit of time"
    return Event("steady", excess, direction=-1, ends=ends, reason=reason)


def leaving(lower: Sequence[float | None], upper: Sequence[float | None]) -> Event:
    """The instant at which the centre leaves a box; the function is positive outside."""
    bounds = [(i, -1.0, low) for i, low in enumerate(lower) if low is not None]
    bounds += [(i, 1.0, high) for i, high in enumerate(upper) if high is not None]

    def beyond(t: float, y: Row) -> float:
        return max((sign * (y[i] - bound) for i, sign, bound in bounds), default=-1.0)

    return Event("left_region", beyond, direction=1, ends=True, reason="the centre left the region")
