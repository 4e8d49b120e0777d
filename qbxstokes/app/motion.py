"""`task: motion`: one body, from its hydrodynamics to the result file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qbxstokes.app.body import form_hydrodynamics
from qbxstokes.app.clock import Clock
from qbxstokes.app.compare import Comparison, compare
from qbxstokes.app.plan import Plan
from qbxstokes.app.rows import RowTeam
from qbxstokes.config.load import LoadedCase
from qbxstokes.geometry import rotation
from qbxstokes.io.cache import Cache
from qbxstokes.io.results import ResultWriter
from qbxstokes.motion.equations import RigidBodyEquations
from qbxstokes.petsc.stepper import integrate
from qbxstokes.qbx.operator import layer_rows
from qbxstokes.reference.jeffery import orbit_constant

Array = NDArray[np.float64]


def run_motion(
    loaded: LoadedCase,
    plan: Plan,
    clock: Clock,
    provenance: Mapping[str, Any],
    overwrite: bool,
    team: RowTeam | None = None,
    cache: Cache | None = None,
) -> dict[str, Any]:
    """Compute the motion on this process, write the result file, and return the summary.

    team: the ranks that share the set-up. cache: where operators are kept.
    """
    case = loaded.case
    assert case.time is not None
    with clock.part("set-up"):
        body = form_hydrodynamics(loaded, plan, team or layer_rows, cache)
        if team is not None:
            team.dismiss()
    start = case.start
    equations = RigidBodyEquations(body.model, body.provider, case.body.stokes_number)
    initial = equations.initial_state(
        plan.position,
        plan.quaternion,
        None if start.velocity == "with_flow" else start.velocity,
        None if start.angular_velocity == "with_flow" else start.angular_velocity,
    )
    with clock.part("motion"):
        trajectory = integrate(equations, initial, plan.times, case.time.tolerance)
    with clock.part("quantities"):
        states = trajectory.states[:, 0, :]
        samples = quantities(equations, body.provider, plan.times, states, loaded.flow.steady)
        v0, w0 = equations.velocities(0.0, initial)
        known = {
            "start_position": plan.position,
            "start_quaternion": plan.quaternion,
            "start_axis": rotation.axis(plan.quaternion),
            "start_velocity": v0[0],
            "start_angular_velocity": w0[0],
        }
    comparison = Comparison()
    if case.compare.reference != "none":
        with clock.part("comparison"):
            comparison = compare(case, loaded.flow, body.model, plan.times, {**samples, **known})
    summary = {
        "case": str(loaded.path),
        "title": case.title,
        "task": case.task,
        "end": float(plan.times[-1]),
        "jeffery_period": plan.period,
        "samples": len(plan.times),
        "hydrodynamics": {
            **body.facts,
            **body.solves(),
            "error_estimate": body.model.error_estimate,
        },
        "cache_problems": body.problems,
        "resistance": vars(body.model.resistance),
        "integration": {
            "method": trajectory.method,
            "steps": trajectory.steps,
            "rejected": trajectory.rejections,
            "rhs_evaluations": trajectory.evaluations,
            "jacobians": trajectory.jacobians,
            "local_tolerance": trajectory.local_tolerance,
            "quaternion_norm_drift": trajectory.norm_drift,
        },
        "errors": comparison.errors,
        "references": comparison.references,
        "note": comparison.note,
        "largest_error": comparison.largest,
        "skipped": list(plan.skips),
        "final_position": samples["position"][-1],
        "final_orientation": samples["orientation"][-1],
        "final_axis": samples["axis"][-1],
    }
    replace = overwrite or case.output.overwrite
    with ResultWriter(plan.output, case.task, provenance, replace) as writer:
        with clock.part("output"):
            writer.append({"time": plan.times, **{name: samples[name] for name in plan.fields}})
        if case.field is not None:
            from qbxstokes.app.field import export_field, field_of_motion

            summary["field"] = field_of_motion(
                loaded, plan.times, samples, clock, writer.file, equations, initial
            )
            summary["field"]["files"] = export_field(loaded, clock, writer.file, plan.output)
        with clock.part("output"):
            summary["wall_times"] = dict(clock.parts)
            summary["result"] = str(writer.finish(summary))
    if case.field is not None:
        from qbxstokes.app.field import draw_pictures

        summary["field"]["files"] += draw_pictures(loaded, clock, Path(summary["result"]))
    summary["wall_times"] = {**clock.parts, "total": clock.total}
    return summary


def quantities(
    equations: RigidBodyEquations, provider: Any, times: Array, states: Array, steady: bool
) -> dict[str, Array]:
    """Everything a motion file holds, from the states (T, n_state) at the times (T,)."""
    if steady:
        # The samples of one body are as many bodies at one instant.
        many = RigidBodyEquations(equations.model, provider, equations.stokes_number[0], len(times))
        velocity, spin = many.velocities(0.0, states)
        force, torque = many.force_torque(0.0, states)
    else:
        parts = [
            [*equations.velocities(t, state[None]), *equations.force_torque(t, state[None])]
            for t, state in zip(times.tolist(), states, strict=True)
        ]
        velocity, spin, force, torque = np.concatenate(parts, axis=1)
    orientation = rotation.normalize(states[:, 3:7])
    axis = rotation.axis(orientation)
    return {
        "position": states[:, 0:3],
        "orientation": orientation,
        "axis": axis,
        "velocity": velocity,
        "angular_velocity": spin,
        "force": force,
        "torque": torque,
        "euler_angles": rotation.to_euler(orientation),
        "orbit_constant": orbit_constant(equations.model.aspect_ratio, axis),
    }
