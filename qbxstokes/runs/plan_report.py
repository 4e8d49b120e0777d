"""What a case is about and what its task needs and skips, told before the run."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from qbxstokes.case.bodies import BodyEntry
from qbxstokes.case.load import LoadedCase
from qbxstokes.case.scene import FREE, LOCKED
from qbxstokes.case.schema import Case
from qbxstokes.runs.plan import MotionPlan, Plan
from qbxstokes.runs.report import (
    Rows,
    counted,
    duration,
    flow_text,
    listed,
    quantity,
    render,
    shape_text,
    size,
    vector,
)

if TYPE_CHECKING:
    from qbxstokes.runs.command import Job

MANY = 6  # bodies that are told one by one
_TAKES = "beside start, comparison, lines and a motion's field (within a factor of 2) about"


def scene(loaded: LoadedCase, plan: Plan) -> Rows:
    """Body and flow; where the body is, or what drives it and for how long."""
    case = loaded.case
    for body in case.members[:MANY]:
        text = shape_text(body.outline)
        if case.coupled:
            text += "" if body.size == 1.0 else f", size {quantity(body.size)}"
            text += f", at ({vector(body.start.position)})"
        if case.task == "motion":
            stokes = body.stokes_number
            text += ", massless" if stokes == 0 else f", St = {quantity(stokes)}"
        elif case.field is not None and not case.coupled:
            text += f", {case.field.body}"
        yield "body", text
    if len(case.members) > MANY:
        yield "", f"and {len(case.members) - MANY} more"
    yield from around(loaded)
    if case.units is not None:
        yield "units", case.units.scales.told
    if case.coupled or isinstance(plan, MotionPlan):
        yield from _driven(case)
    if isinstance(plan, MotionPlan):
        yield "time", _span(plan)
    elif case.rheology is not None:
        yield "suspension", f"dilute, {case.rheology.protocol} flow"
    elif case.task == "body" and case.flow is not None and not case.coupled:
        place, turn = plan.simulation.position[0], plan.simulation.quaternion[0]
        yield "place", f"({vector(place)}), quaternion ({vector(turn)})"


def around(loaded: LoadedCase) -> Rows:
    """What bounds the fluid, the flow, and what acts between the bodies."""
    case, wall, push = loaded.case, loaded.case.wall, loaded.case.repulsion
    if wall is not None:
        yield "wall", f"through ({vector(wall.point)}), normal ({vector(wall.normal)})"
    if case.flow is not None:
        yield "flow", flow_text(loaded) + ("; moves with the wall on it" if wall else "")
        if loaded.flow.domain and not case.coupled:
            yield "walls", "bound the flow; their answer to the body is not in the equations"
    if push is not None:
        size = f"{quantity(push.strength)} exp(-gap/{quantity(push.range)})"
        yield "repulsion", f"{size} along the gap of every pair: no part of the hydrodynamics"


def _span(plan: MotionPlan) -> str:
    end = float(plan.times[-1])
    text = f"0 to {quantity(end)}"
    if plan.period is not None and plan.simulation.flow.steady:
        periods = counted(end / plan.period, "Jeffery period")
        text += f" ({periods} of {quantity(plan.period)})"
    return f"{text}, {len(plan.times)} samples"


def _driven(case: Case) -> Rows:
    """Loads and constraints, where there are any."""
    loads = [_loads(case, body) for body in case.members]
    if len(set(loads)) == 1:
        yield from ((("loads", loads[0]),) if loads[0] else ())
    else:
        for number, text in enumerate(loads[:MANY], 1):
            yield "loads" if number == 1 else " ", f"body {number}: {text or 'none'}"
    held = [
        f"{name} {value if value == LOCKED else 'prescribed: ' + _vector(value)}"
        for name in ("translation", "rotation")
        if (value := getattr(case.constraints, name)) != FREE
    ]
    if held:
        yield "constraints", "; ".join(held)


def _loads(case: Case, body: BodyEntry) -> str:
    """What acts on a body: its own loads, or those of the scene."""
    forces = body.forces or case.forces
    loads = [
        f"{name.replace('_', ' ')} {_vector(value)}"
        for name in ("force", "torque", "body_force", "body_torque")
        if (value := getattr(forces, name)) is not None
    ]
    if forces.gravity is not None:
        net = quantity(forces.gravity.net(body.stokes_number))
        loads.append(f"net weight {net} x volume along {_vector(forces.gravity.direction)}")
    return "; ".join(loads)


def _vector(value: Any) -> str:
    if isinstance(value, dict):
        return f"table {value['table']}" if "table" in value else "as tabulated"
    if isinstance(value, str):
        return value
    return "(" + ", ".join(v if isinstance(v, str) else quantity(v) for v in value) + ")"


def planned(job: Job) -> tuple[dict[str, Any], str]:
    """The plan as plain data and as text, of a dry run with the time that it takes."""
    loaded, plan, seconds = job.loaded, job.plan, None
    if job.options.dry_run:
        from qbxstokes.runs.cost import seconds_of

        seconds = seconds_of(loaded, plan)
    facts: dict[str, Any] = {"needs": list(plan.needs), "skips": list(plan.skips)}
    facts["output"] = str(job.target)
    if plan.points:
        facts["points"] = plan.points
    if isinstance(plan, MotionPlan):
        facts["end"], facts["samples"] = float(plan.times[-1]), len(plan.times)
        facts["bytes_on_disk"] = plan.bytes_on_disk
        if not plan.simulation.coupled:
            facts |= {"hydrodynamics": plan.simulation.kind, "jeffery_period": plan.period}
    told = {"case": str(loaded.path), "plan": {**facts, "seconds": seconds}}
    return told, plan_text(loaded, plan, job.target, seconds)


def plan_text(loaded: LoadedCase, plan: Plan, target: Path, seconds: float | None) -> str:
    """What the task needs, what it skips, where the result goes, how long it takes if known."""
    writes = "", str(target)
    if isinstance(plan, MotionPlan):
        writes = str(target), f"about {size(plan.bytes_on_disk)} of samples"
    sections: dict[str, Rows] = {
        "Scene": scene(loaded, plan),
        "Needs": listed(plan.needs),
        "Skips": listed(plan.skips),
        "Writes": [writes],
        "Takes": [] if seconds is None else [("", f"{_TAKES} {duration(seconds)}")],
    }
    title = f"Plan: {loaded.case.title or loaded.case.task}"
    return render(title, str(loaded.path), sections) + "\n"
