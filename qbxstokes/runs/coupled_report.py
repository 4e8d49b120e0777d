"""Plan and summary of a scene with several bodies or a wall."""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite
from typing import Any

import numpy as np

from qbxstokes.case.load import LoadedCase
from qbxstokes.runs.report import (
    ABOUT,
    MANY,
    Rows,
    counted,
    error_text,
    flow_text,
    grids,
    of_each,
    quantity,
    shape_text,
    vector,
)


def scene(loaded: LoadedCase) -> Rows:
    """The bodies, what bounds the fluid, the flow."""
    case = loaded.case
    members = case.members
    for body in members[:MANY]:
        size = "" if body.size == 1.0 else f", size {quantity(body.size)}"
        yield "body", f"{shape_text(body.outline)}{size}, at ({vector(body.start.position)})"
    if len(members) > MANY:
        yield "", f"and {len(members) - MANY} more"
    yield from around(loaded)


def around(loaded: LoadedCase) -> Rows:
    """What bounds the fluid, the flow, and what acts between the bodies."""
    case = loaded.case
    if case.wall is not None:
        wall = case.wall
        yield "wall", f"through ({vector(wall.point)}), normal ({vector(wall.normal)})"
    if case.flow is not None:
        checked = "; moves with the wall on it" if case.wall is not None else ""
        yield "flow", flow_text(loaded) + checked
    if case.repulsion is not None:
        push = case.repulsion
        size = f"{quantity(push.strength)} exp(-gap/{quantity(push.range)})"
        yield "repulsion", f"{size} along the gap of every pair: no part of the hydrodynamics"


def sections(summary: Mapping[str, Any]) -> dict[str, Rows]:
    """What was solved and found, and the estimated errors."""
    return {
        "Solved": _solved(summary),
        "Found": _found(summary),
        "Estimated errors": _errors(
            (summary.get("error_estimates") or summary["velocity_errors"])
            | summary.get("field", {}).get("errors", {})
        ),
    }


def _solved(summary: Mapping[str, Any]) -> Rows:
    if "integration" in summary:
        steps = summary["integration"]
        if summary["resumed_at"] is not None:
            yield "resumed", f"from the checkpoint at t = {quantity(summary['resumed_at'])}"
        yield (
            "motion",
            f"TS {steps['method']}: {counted(steps['steps'], 'step')}, {steps['rejected']} "
            f"rejected, {steps['rhs_evaluations']} right-hand sides",
        )
        solves = counted(summary["solves"], "solve")
        yield "GMRES", f"{solves}, {counted(summary['iterations'], 'iteration')} in all"
        if "field" in summary:
            yield "field", ", ".join(f"{n} {p}" for p, n in summary["field"]["points"].items() if n)
        return
    yield "grids", grids(summary["nodes"])
    yield "GMRES", counted(summary["iterations"], "iteration") + " for the free bodies"
    if isfinite(summary["gap"]):
        yield "least gap", f"{quantity(summary['gap'])}: {summary['nearest']}"


def _found(summary: Mapping[str, Any]) -> Rows:
    if "events" in summary:
        yield from _seen(summary)
    names = "free_velocity", "free_angular_velocity", "held_force", "held_torque"
    for name in names:
        if summary.get(name) is not None:
            yield from of_each(name.replace("_", " "), summary[name])


def _seen(summary: Mapping[str, Any]) -> Rows:
    """Where the bodies are at the end, and what happened on the way."""
    found = summary["events"]
    if found["counts"]:
        counts = (f"{count} {name.replace('_', ' ')}" for name, count in found["counts"].items())
        yield "events", ", ".join(counts)
    if "nearest" in found:
        near = found["nearest"]
        yield "least gap", f"{near['gap']:.6g}: {near['who']}, at t = {quantity(near['time'])}"
    if "ended_by" in found:
        text = f"at t = {quantity(summary['end'])}, {found['ended_by']}: {found['ended_because']}"
        yield "ended", text
    place = summary.get("final_position")
    for number, row in enumerate([] if place is None else np.atleast_2d(place)[:MANY], start=1):
        yield "at the end" if number == 1 else " ", f"({vector(row)})"


def _errors(errors: Mapping[str, float]) -> Rows:
    for name, value in errors.items():
        about = ABOUT.get(name, "")
        yield name.replace("_", " "), f"{error_text(value):9}{about}"
