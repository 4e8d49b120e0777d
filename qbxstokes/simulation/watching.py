"""What is watched for in a run: events and contacts, and what its flows are on the way."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from qbxstokes.errors import ConvergenceError, FlowError, FlowFunctionError, SceneError
from qbxstokes.flows.check import check_stokesian, seems_stokesian
from qbxstokes.flows.interpolation import within
from qbxstokes.geometry import rotation
from qbxstokes.motion.contacts import Contact, Contacts, Gap, edge_gap, singular_gap
from qbxstokes.motion.equations import RigidBodyEquations
from qbxstokes.motion.events import Event, Events, Passage, leaving, steady, turning_point
from qbxstokes.motion.layout import ORIENTATION, POSITION
from qbxstokes.petsc.trajectory import Watch
from qbxstokes.quantity import Quantity
from qbxstokes.typing import Array

if TYPE_CHECKING:
    from qbxstokes.flows import Flow
    from qbxstokes.simulation.assembly import Assembled
    from qbxstokes.simulation.simulation import Simulation


_CLEARANCE = 0.05  # from singular points, where nobody says; half of what there is at most
# Accepted steps between looks at whether a flow is Stokesian, and how many of these in a run.
_STEPS_BETWEEN_CHECKS, _MOST_LOOKS = 10, 50.0
# Share of the tolerance of a run that the grid on the surface may take.
_SHARE = 0.1
# What the roughness of samples may come to in a step, in the error that falls to it: it changes its
# sign from sample to sample, and a step as long as it may be passes several of them.
_ROUGH = 2.0


# -- events --------------------------------------------------------------------------------------


def watched(assembled: Any, instants: Array) -> tuple[Any, Any]:
    """The trajectory of what is assembled, and the watch over it; raises ConvergenceError."""
    watch = assembled.watch()
    watch.begin(0.0, assembled.initial)
    trajectory = assembled.trajectory(instants, observe=watch)
    if trajectory.failure:
        raise ConvergenceError(trajectory.failure)
    if trajectory.refusal:
        watch.ended = ("clearance", trajectory.refusal)
    return trajectory, watch


def build_events(scene: Simulation, equations: RigidBodyEquations, initial: Array) -> Events:
    """The watch over a motion of one lane; raises SceneError where it would end as it starts."""
    section, flow, shape = scene.events, scene.flow, scene.body.shape
    position, axis = scene.position[0], rotation.axis(scene.quaternion[0])
    passage = None
    if section.half_turns and (scene.period is not None or section.plane is not None):
        plane = None if section.plane is None else np.array(section.plane)
        passage = Passage.of(scene.gradient, scene.body.effective_ratio, plane)
    named = list(dict.fromkeys(section.turning_points))
    scale = float(np.max(equations.time_rate(0.0, initial))) if named else 0.0
    events: list[Event] = [turning_point(equations, name, scale) for name in named]
    if section.steady is not None:
        events.append(steady(equations, section.steady, section.stop_when_steady))
    row = initial[0].tolist()
    if section.region is not None:
        event = leaving(section.region.lower, section.region.upper)
        if event.function(0.0, row) >= 0.0:
            raise SceneError("events.region", "does not hold start.position", "a larger region")
        events.append(event)
    gaps: list[Gap] = [edge_gap(edge, shape, slice(None)) for edge in flow.domain]
    if len(flow.singular_points):
        there = float(np.min(shape.clearance(flow.singular_points, position, axis)))
        least = min(_CLEARANCE, 0.5 * there) if section.clearance is None else section.clearance
        if there <= least:
            wrong = f"is {least:g}, more than the {there:.3g} at the start"
            raise SceneError("events.clearance", wrong)
        gaps.append(singular_gap(flow.singular_points, shape, least))
    contacts = Contacts(gaps, np.array([shape.radius])) if gaps else None
    frame = scene.frame if scene.frame.simple else None
    return Events(equations, passage, events, frame, contacts)


def lane_contacts(parts: Sequence[Simulation]) -> Contacts | None:
    """The watch over the edges of the flows of many lanes; None where no flow has any."""
    gaps: list[Gap] = []
    first = 0
    for part in parts:
        lanes = slice(first, first + len(part))
        gaps += [edge_gap(edge, part.body.shape, lanes) for edge in part.flow.domain]
        first += len(part)
    arms = [np.full(len(part), part.body.shape.radius) for part in parts]
    return Contacts(gaps, np.concatenate(arms)) if gaps else None


def split_columns(rows: Array, columns: Mapping[str, Quantity]) -> dict[str, Array]:
    """Rows (n, width) as an array per column."""
    found, start = {}, 0
    for name, about in columns.items():
        width = about.size
        found[name] = rows[:, start : start + width].reshape(len(rows), *about.shape)
        start += width
    return found


def ending(contact: Contact) -> dict[str, Any]:
    """When and why a lane ended."""
    return {"by": contact.name, "because": contact.reason, "time": contact.t}


def events_summary(events: Events) -> dict[str, Any]:
    """What was seen, in a few numbers."""
    summary: dict[str, Any] = {"counts": dict(events.counts)}
    if events.counts.get("half_turns", 0) >= 3:
        first, last = events.first["half_turns"], events.last["half_turns"]
        # Whole turns only: a body that drifts need not take the same time for both halves.
        odd = (events.counts["half_turns"] - 1) % 2
        turns = (events.counts["half_turns"] - 1) // 2
        end = events.recent[0] if odd else events.recent[-1]
        drift = [(b - a) / turns for a, b in zip(first[1:4], end[1:4], strict=True)]
        summary |= {
            "turns": turns,
            "period": (end[0] - first[0]) / turns,
            "last_period": last[11],
            "orbit_constant_first": first[10],
            "orbit_constant_last": last[10],
            "drift_per_period": drift,
        }
    if "steady" in events.counts:
        summary["steady_at"] = events.first["steady"][0]
    if events.contacts is not None:
        summary["nearest"] = {
            name: {"gap": gap, "time": t} for name, (gap, t) in events.contacts.nearest.items()
        }
    if events.ended[0]:
        summary |= {"ended_by": events.ended[0], "ended_because": events.ended[1]}
    return summary


# -- flows ---------------------------------------------------------------------------------------


def breaks_of(flows: Sequence[Flow], end: float, error: float) -> Array:
    """Instants at which some flow is not smooth: steps end there.

    error: that falls to a step over the longest one, as rough as which a gradient may be.
    """
    return within([flow.breaks(end, _ROUGH * error) for flow in flows], end)


def stops_of(flows: Sequence[Flow], end: float, accuracy: float, longest: float) -> Array:
    """Instants at which steps end that are to see functions of time which nobody follows.

    accuracy: to which they are sampled. Raises SceneError where one is not smooth to it.
    """
    found = [np.empty(0)]
    for signal in (signal for flow in flows for signal in flow.signals):
        try:
            found.append(signal.sampled(end, accuracy, longest).stops(longest))
        except FlowError as refusal:
            raise SceneError("flow", str(refusal)) from None
    return np.unique(np.concatenate(found))


class FlowWatch(Watch):
    """As `petsc.trajectory.Watch`, of all scenes that are integrated together up to `end`.

    Functions that were recognised as polynomials are held against these where a step has ended,
    and the others are to be Stokesian there: around one lane after another, every so many steps.
    A motion on grids (`bie.providers.MonitoredGridMotion`) may miss a share of the tolerance: an
    error of Omega grows with time, by max(k, 1/k)^2 besides where an axis lingers
    (`RigidBodyEquations.sensitivity`).
    """

    def __init__(self, assembled: Assembled, end: float) -> None:
        self._parts = list(zip(assembled.parts, assembled.slices(), strict=True))
        parts = assembled.parts
        flows = (flow for part in parts for flow in (part.flow, part.carrier))
        self._flows = list({id(flow): flow for flow in flows}.values())
        self._users = [entry for entry in self._parts if not entry[0].flow.singular_points_known]
        self._motions: list[tuple[Any, slice, tuple[float, float]]] = []
        for (part, lanes), formed in zip(self._parts, assembled.hydrodynamics, strict=True):
            if hasattr(formed.provider, "accept"):
                k = formed.model.effective_ratio
                allowed = _SHARE * part.tolerance / end
                slower = allowed / max(k, 1.0 / k) ** 2 if k > 0.0 else 0.0
                self._motions.append((formed.provider, lanes, (allowed, slower)))
        self._count, self._looks, self._looked, self._apart = 0, 0, 0.0, end / _MOST_LOOKS
        self.looks = bool(self._users or self._motions)

    def until(self, t: float, since: float = -math.inf) -> None:
        """Let all flows show themselves as before the break t, and after one at `since`."""
        for flow in self._flows:
            flow.until(t, since)

    def begin(self, t: float, states: Array) -> None:
        """Choose the grids of the steps to come."""
        for motion, lanes, allowed in self._motions:
            motion.begin(t, *_places(states[lanes]), allowed)

    def rest(self) -> None:
        """Let motions be found to the tolerance of the body's hydrodynamics again."""
        for motion, _, _ in self._motions:
            motion.rest()

    def accept(self, t: float, states: Array) -> bool:
        """Whether a step that has ended in states (n, n_state) stands; raises FlowError."""
        self._count += 1
        due = self._count >= _STEPS_BETWEEN_CHECKS and t > self._looked + self._apart
        if due:
            self._count, self._looked, self._looks = 0, t, self._looks + 1
        for part, lanes in self._users:
            places = states[lanes, POSITION]
            if part.recognised is not None:
                part.recognised.check(t, places, part.body.shape.radius)
            if due or part.recognised is not None:
                require_stokesian(part, places[self._looks % len(places)], t)
        stands = [m.accept(t, *_places(states[lanes])) for m, lanes, _ in self._motions]
        return all(stands)


def _places(states: Array) -> tuple[Array, Array]:
    return states[:, POSITION], states[:, ORIENTATION]


def require_stokesian(part: Simulation, place: Array, t: float) -> None:
    """Refuse a flow that is not Stokesian around a place at time t; raises SceneError.

    A function that fails is left to the equations, which tell when and where they needed it.
    """
    radius = 2.0 * part.body.shape.radius
    try:
        if part.recognised is not None:
            part.recognised.require_stokesian(t, radius)
            return
        local = part.body.settings.derivatives is not None
        if not seems_stokesian(part.flow, place, radius, t, local):
            check_stokesian(part.flow, place, radius=radius, t=t, local=local)
    except FlowFunctionError:
        return
    except FlowError as error:
        if part.flow.singular_points_known or "not Stokesian" in str(error):
            raise SceneError("flow", f"at t = {t:.6g}: {error}") from None
