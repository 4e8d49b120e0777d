"""From the events that are asked for to what watches the steps, and what it saw."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from qbxstokes.errors import SceneError
from qbxstokes.flows.check import clearance
from qbxstokes.geometry import rotation
from qbxstokes.motion.equations import RigidBodyEquations
from qbxstokes.motion.events import (
    Event,
    Events,
    Passage,
    leaving,
    meeting,
    steady,
    turning_point,
)
from qbxstokes.quantities import Quantity

if TYPE_CHECKING:
    from qbxstokes.simulation.simulation import Simulation

Array = NDArray[np.float64]

_CLEARANCE = 0.05


def build_events(scene: Simulation, equations: RigidBodyEquations, initial: Array) -> Events:
    """The watch over a motion of one lane; raises SceneError where it would end as it starts."""
    section, flow, k = scene.events, scene.flow, scene.body.aspect_ratio
    position, axis = scene.position[0], rotation.axis(scene.quaternion[0])
    passage = None
    if section.half_turns and (scene.period is not None or section.plane is not None):
        plane = None if section.plane is None else np.array(section.plane)
        passage = Passage.of(scene.gradient, k, plane)
    scale = float(np.max(equations.time_rate(0.0, initial)))
    events: list[Event] = [
        turning_point(equations, name, scale) for name in dict.fromkeys(section.turning_points)
    ]
    if section.steady is not None:
        events.append(steady(equations, section.steady, section.stop_when_steady))
    row = initial[0].tolist()
    if section.region is not None:
        event = leaving(section.region.lower, section.region.upper)
        if event.function(0.0, row) >= 0.0:
            raise SceneError("events.region", "does not hold start.position", "a larger region")
        events.append(event)
    if len(flow.singular_points):
        there = float(np.min(clearance(flow.singular_points, position, axis, k)))
        least = min(_CLEARANCE, 0.5 * there) if section.clearance is None else section.clearance
        if there <= least:
            wrong = f"is {least:g}, more than the {there:.3g} at the start"
            raise SceneError("events.clearance", wrong)
        events.append(meeting(flow.singular_points, k, least))
    return Events(equations, passage, events, scene.frame if scene.frame.simple else None)


def split_columns(rows: Array, columns: Mapping[str, Quantity]) -> dict[str, Array]:
    """Rows (n, width) as an array per column."""
    found, start = {}, 0
    for name, about in columns.items():
        width = about.size
        found[name] = rows[:, start : start + width].reshape(len(rows), *about.shape)
        start += width
    return found


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
    if events.ended[0]:
        summary |= {"ended_by": events.ended[0], "ended_because": events.ended[1]}
    return summary
