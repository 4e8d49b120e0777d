"""`task: field`, and the section `field` of a motion: the flow around the body, to a file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qbxstokes.bie.field import Disturbance
from qbxstokes.case.document import plain
from qbxstokes.case.load import LoadedCase
from qbxstokes.geometry import rotation
from qbxstokes.io import field as store
from qbxstokes.io.store import Work
from qbxstokes.io.writer import ResultWriter
from qbxstokes.runs.clock import Clock
from qbxstokes.runs.field_flow import FieldFlow
from qbxstokes.runs.field_targets import chosen_instants, targets_of
from qbxstokes.runs.field_work import FieldWork
from qbxstokes.runs.rows import ALONE, RowTeam
from qbxstokes.simulation.around import Instant
from qbxstokes.simulation.assembly import Assembled
from qbxstokes.simulation.from_case import pointed, start_of

Array = NDArray[np.float64]

# The service of the other ranks to a motion with a field.
FIELD = "field"


@dataclass(frozen=True)
class FieldPlan:
    """The work of a field: where the body is, and which points."""

    position: Array
    quaternion: Array
    points: int
    needs: tuple[str, ...]
    skips: tuple[str, ...] = ()


def plan_field(loaded: LoadedCase) -> FieldPlan:
    """Plan of `task: field`; raises CaseError for what the schema alone cannot see."""
    case = loaded.case
    assert case.field is not None  # the schema requires it for this task
    start = start_of(loaded)
    with pointed(loaded):
        start.check()
    targets = targets_of(loaded, case.field)
    points = sum(target.size for target in targets)
    needs = [f"integral equation of a body that is {case.field.body}"]
    if points:
        parts = ", ".join(f"{target.name} {target.size}" for target in targets)
        needs.append(f"fields at {points} points ({parts})")
    for name in ("surface", "streamlines"):
        if getattr(case.field, name) is not None:
            needs.append({"surface": "traction on the body"}.get(name, name))
    skips = []
    if "stress" not in case.field.quantities and case.field.surface is None:
        skips.append("stress: not asked for")
    if case.field.tracers is not None and case.task == "field":
        needs.append("paths of tracers around a body that stays in this state")
    return FieldPlan(start.position[0], start.quaternion[0], points, tuple(needs), tuple(skips))


def run_field(
    comm: Any,
    loaded: LoadedCase,
    plan: FieldPlan,
    folder: Work,
    clock: Clock,
    provenance: Mapping[str, Any],
    overwrite: bool,
) -> dict[str, Any]:
    """Compute the field on all ranks; rank 0 writes the file. Returns the summary.

    folder: the working folder, held by rank 0.
    """
    case = loaded.case
    section = case.field
    assert section is not None
    given = section.body != "free"
    instant = Instant(
        0.0,
        plan.position,
        plan.quaternion,
        np.array(section.velocity) if given else None,
        np.array(section.angular_velocity) if given else None,
        np.array(section.force),
        np.array(section.torque),
    )
    flow = FieldFlow(comm, loaded, section, clock)
    work = FieldWork(comm, flow, [instant], folder)
    target = folder.target
    if comm.rank != 0:
        work.write(None)
        return {}
    replace = overwrite or case.output.overwrite
    with ResultWriter(target, case.task, provenance, replace) as writer:
        facts = work.write(writer)
        around = flow.around(instant)
        disturbance = around.disturbance
        velocity = around.rotation @ disturbance.velocity
        spin = around.rotation @ disturbance.angular_velocity
        # On the body, hence opposite to those on the fluid; without negative zeros.
        force, torque = (
            0.0 - around.rotation @ vector for vector in (disturbance.force, disturbance.torque)
        )
        writer.append(
            {
                "time": np.zeros(1),
                "position": plan.position[None],
                "orientation": plan.quaternion[None],
                "axis": rotation.axis(plan.quaternion)[None],
                "velocity": velocity[None],
                "angular_velocity": spin[None],
                "force": force[None],
                "torque": torque[None],
            }
        )
        if section.tracers is not None:
            store.put_arrays(writer.file[store.GROUP], "tracers", flow.steady_tracers(instant), {})
        errors = facts.pop("errors")
        summary: dict[str, Any] = {
            "case": str(loaded.path),
            "title": case.title,
            "task": case.task,
            **facts,
            "velocity": velocity,
            "angular_velocity": spin,
            "force": force,
            "torque": torque,
            "scales": _scales(disturbance),
            "errors": errors,
            "largest_error": max(errors.values()),
            "wall_times": dict(clock.parts),
        }
        summary["files"] = export_field(loaded, clock, writer.file, target)
        summary["result"] = str(writer.finish(summary))
    summary["files"] += draw_pictures(loaded, clock, Path(summary["result"]))
    summary["wall_times"] = {**clock.parts, "total": clock.total}
    return summary


def _scales(disturbance: Disturbance) -> dict[str, float]:
    """Sizes that velocity, force and torque are made of: what rounding in them is relative to."""
    points = disturbance.grid.points
    speed = float(np.linalg.norm(disturbance.background(points), axis=-1).max())
    speed = max(speed, disturbance.scale)
    length = max(disturbance.grid.spheroid.aspect_ratio, 1.0)
    return {
        "velocity": speed,
        "angular_velocity": speed / length,
        "force": 6.0 * np.pi * length * speed,
        "torque": 8.0 * np.pi * length**2 * speed,
    }


def field_of_motion(
    loaded: LoadedCase,
    times: Array,
    samples: Mapping[str, Array],
    clock: Clock,
    writer: ResultWriter,
    assembled: Assembled,
    team: RowTeam | None,
    folder: Work,
) -> dict[str, Any]:
    """The field at the chosen instants of a motion, into its open result file; for rank 0.

    samples: quantities (T, ...) at the times (T,). team: the other ranks, which
    take part by `help_with_field`.
    """
    section = loaded.case.field
    assert section is not None
    instants = [
        Instant(
            float(times[index]),
            samples["position"][index],
            samples["orientation"][index],
            samples["velocity"][index],
            samples["angular_velocity"][index],
        )
        for index in chosen_instants(loaded, times)
    ]
    key = json.dumps(plain(section.model_dump()))
    comm = ALONE if team is None else team.join(FIELD, instants, folder.joined(0), key)
    flow = FieldFlow(comm, loaded, section, clock)
    facts = FieldWork(comm, flow, instants, folder, key).write(writer)
    if section.tracers is not None:
        paths = flow.moving_tracers(assembled.equations, assembled.initial, float(times[-1]))
        store.put_arrays(writer.file[store.GROUP], "tracers", paths, {})
    return facts


def help_with_field(
    comm: Any, loaded: LoadedCase, clock: Clock, instants: list[Instant], folder: Work, key: str
) -> None:
    """What the other ranks do for `field_of_motion`."""
    section = loaded.case.field
    assert section is not None
    flow = FieldFlow(comm, loaded, section, clock)
    FieldWork(comm, flow, instants, folder.joined(comm.rank), key).write(None)


def export_field(loaded: LoadedCase, clock: Clock, file: Any, output: Path) -> list[str]:
    """Write the file for ParaView, if asked for; the names of what was written."""
    section = loaded.case.field
    if section is None or not section.vtk:
        return []
    from qbxstokes.io.vtkhdf import export

    with clock.part("export"):
        return [str(export(file, output.with_suffix(".vtkhdf")))]


def draw_pictures(loaded: LoadedCase, clock: Clock, result: Path) -> list[str]:
    """Draw the pictures of a field, if asked for; the names of what was written."""
    section = loaded.case.field
    if section is None or not section.pictures:
        return []
    from qbxstokes.io.results import load
    from qbxstokes.plots.field import draw_field

    with clock.part("pictures"):
        return [str(name) for name in draw_field(load(result), result.with_suffix(""))]
