"""From the events that are asked for to what watches the steps, and what it saw."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from qbxstokes.errors import ConvergenceError, SceneError
from qbxstokes.geometry import rotation
from qbxstokes.motion.contacts import Contact, Contacts, Gap, edge_gap, singular_gap
from qbxstokes.motion.equations import RigidBodyEquations
from qbxstokes.motion.events import Event, Events, Passage, leaving, steady, turning_point
from qbxstokes.quantity import Quantity
from qbxstokes.typing import Array

if TYPE_CHECKING:
    from qbxstokes.simulation.simulation import Simulation


_CLEARANCE = 0.05


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
