"""`task: motion`: one body, from its hydrodynamics to the result file."""

from __future__ import annotations

import signal
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qbxstokes.case.load import LoadedCase
from qbxstokes.errors import ConvergenceError, Interrupted
from qbxstokes.geometry import rotation
from qbxstokes.io.cache import Cache
from qbxstokes.io.results import ResultWriter
from qbxstokes.motion.equations import RigidBodyEquations
from qbxstokes.motion.events import Events
from qbxstokes.petsc.stepper import integrate
from qbxstokes.petsc.trajectory import Trajectory
from qbxstokes.qbx.operator import layer_rows
from qbxstokes.runs.clock import Clock
from qbxstokes.runs.compare import Comparison, compare, shear_rate
from qbxstokes.runs.interrupt import Interruption
from qbxstokes.runs.plan import Plan
from qbxstokes.runs.recording import Recording
from qbxstokes.runs.rows import RowTeam
from qbxstokes.runs.watch import build_events, events_summary
from qbxstokes.simulation.hydrodynamics import Hydrodynamic, form_hydrodynamics
from qbxstokes.simulation.loads import loads_and_constraints

Array = NDArray[np.float64]


def run_motion(
    loaded: LoadedCase,
    plan: Plan,
    clock: Clock,
    provenance: Mapping[str, Any],
    recording: Recording,
    interruption: Interruption,
    team: RowTeam | None = None,
    cache: Cache | None = None,
) -> dict[str, Any]:
    """Compute the motion on this process, write the result file, and return the summary.

    team: the ranks that share the set-up and the field. cache: where operators are kept. Raises
    Interrupted where a signal asks for it, after what there is has been written and made safe, and
    ConvergenceError where the motion cannot be followed further, after what there is was written.
    """
    case = loaded.case
    assert case.time is not None
    with clock.part("set-up"):
        loads, constraints = loads_and_constraints(loaded, float(plan.times[-1]))
        body = form_hydrodynamics(loaded, plan, team or layer_rows, cache)
    start, stokes = case.start, case.body.stokes_number
    equations = RigidBodyEquations(
        body.model,
        body.provider,
        stokes,
        loads=loads,
        constraints=constraints,
        inertia=case.body.inertia,
    )
    initial = equations.initial_state(
        plan.position,
        plan.quaternion,
        None if start.velocity == "with_flow" else start.velocity,
        None if start.angular_velocity == "with_flow" else start.angular_velocity,
    )
    events = build_events(loaded, plan, equations, initial)
    with clock.part("motion"):
        events.begin(0.0, initial)
        receive = recording.receiver(equations, events)
        interruption.listening = True
        trajectory = integrate(
            equations,
            recording.start or initial,
            plan.times,
            case.time.tolerance,
            on_chunk=receive,
            interrupted=interruption.asked,
            observe=events,
            longest_step=None if equations.steady else float(plan.times[-1]) / 50.0,
            **recording.limits,
        )
        if trajectory.refusal:
            events.ended = ("met_singularity", trajectory.refusal)
    if trajectory.failure and not trajectory.steps:  # there is nothing to keep
        recording.journal.close(remove=True)
        raise ConvergenceError(trajectory.failure)
    if not trajectory.finished:
        recording.save()
        if not recording.saved:
            raise _interrupted(recording, {}, interruption.signal)
    summary = _facts(loaded, plan, body, equations, trajectory, events, recording)
    replace = recording.overwrite or recording.replaces(recording.target)
    record = {**provenance, **recording.provenance}
    with ResultWriter(recording.target, case.task, record, replace) as writer:
        _conclude(loaded, plan, clock, recording, writer, summary, body, equations, initial, team)
    if case.field is not None and summary["complete"]:
        from qbxstokes.runs.field import draw_pictures

        summary["field"]["files"] += draw_pictures(loaded, clock, Path(summary["result"]))
    recording.journal.close(remove=trajectory.finished)
    if not trajectory.finished:
        raise _interrupted(recording, summary, interruption.signal)
    if trajectory.failure:
        raise ConvergenceError(f"{trajectory.failure}; {summary['result']} holds the motion so far")
    summary["wall_times"] = {**clock.parts, "total": clock.total}
    return summary


def _conclude(
    loaded: LoadedCase,
    plan: Plan,
    clock: Clock,
    recording: Recording,
    writer: ResultWriter,
    summary: dict[str, Any],
    body: Hydrodynamic,
    equations: RigidBodyEquations,
    initial: Array,
    team: RowTeam | None,
) -> None:
    """Samples, comparison, field and summary into the result file."""
    case = loaded.case
    with clock.part("output"):
        samples = recording.write(writer, plan.fields)
    times = samples["time"]
    summary["samples"] = recording.samples
    if len(times):
        for name in ("position", "orientation", "axis"):
            summary[f"final_{name}"] = samples[name][-1]
        summary["end"] = float(times[-1])
    conserved = not (case.body.stokes_number or case.forces.given or case.constraints.given)
    if conserved and shear_rate(loaded.flow) is not None:
        summary["orbit_constant_drift"] = float(samples["largest_orbit_drift"])
    comparison = Comparison()
    if case.compare.reference != "none" and summary["complete"] and len(times):
        with clock.part("comparison"):
            v0, w0 = equations.velocities(0.0, initial)
            known = {
                "start_position": plan.position,
                "start_quaternion": plan.quaternion,
                "start_axis": rotation.axis(plan.quaternion),
                "start_velocity": v0[0],
                "start_angular_velocity": w0[0],
            }
            held = loads_and_constraints(loaded, float(plan.times[-1]))
            comparison = compare(case, loaded.flow, body.model, times, {**samples, **known}, *held)
    summary |= {
        "errors": comparison.errors,
        "references": comparison.references,
        "note": comparison.note,
        "largest_error": comparison.largest,
    }
    if case.field is not None and summary["complete"]:
        from qbxstokes.runs.field import export_field, field_of_motion

        summary["field"] = field_of_motion(
            loaded, times, samples, clock, writer, equations, initial, team
        )
        summary["field"]["files"] = export_field(loaded, clock, writer.file, recording.target)
    with clock.part("output"):
        summary["wall_times"] = dict(clock.parts)
        summary["result"] = str(writer.finish(summary))


def _facts(
    loaded: LoadedCase,
    plan: Plan,
    body: Hydrodynamic,
    equations: RigidBodyEquations,
    trajectory: Trajectory,
    events: Events,
    recording: Recording,
) -> dict[str, Any]:
    """What the summary says of the computation itself."""
    case = loaded.case
    finest = getattr(body.provider, "finest", None)
    return {
        "case": str(loaded.path),
        "title": case.title,
        "task": case.task,
        "complete": trajectory.finished and not trajectory.failure,
        "failure": trajectory.failure,
        "resumed_at": recording.resumed_at,
        "jeffery_period": plan.period,
        "hydrodynamics": {
            **body.facts,
            **body.solves(),
            **({"finest_nodes": list(finest)} if finest else {}),
            "error_estimate": body.model.error_estimate,
        },
        "cache_problems": body.problems,
        **({"resistance": vars(formed)} if (formed := body.model.formed_resistance) else {}),
        "relaxation_times": relaxation_times(equations),
        "integration": {
            "method": trajectory.method,
            "steps": trajectory.steps,
            "rejected": trajectory.rejections,
            "rhs_evaluations": trajectory.evaluations,
            "jacobians": trajectory.jacobians,
            "local_tolerance": trajectory.local_tolerance,
            "reachable_error": trajectory.reachable,
            "quaternion_norm_drift": trajectory.norm_drift,
        },
        "events": events_summary(events),
        "skipped": list(plan.skips),
    }


def relaxation_times(equations: RigidBodyEquations) -> dict[str, float]:
    """Time scales on which a body takes up the motion of the fluid, empty for St = 0.

    St Theta/R_t across and along the axis, St J/R_r of the axis and about it.
    """
    if equations.massless:
        return {}
    names = ("translation_across", "translation_along", "rotation_of_axis", "rotation_about_axis")
    return dict(zip(names, (1.0 / equations.relaxation_rates[:, 0]).tolist(), strict=True))


def _interrupted(recording: Recording, summary: Mapping[str, Any], number: int) -> Interrupted:
    name = signal.Signals(number).name
    if not recording.saved:
        return Interrupted(
            f"{name}: stopped within the first steps; no result was written, start again", number
        )
    return Interrupted(
        f"{name}: stopped at t = {summary.get('end', 0.0):.6g}; {summary['result']} holds what "
        "there is; go on with the same command and --resume",
        number,
    )
