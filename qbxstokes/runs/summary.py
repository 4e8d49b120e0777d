"""The texts of a task: its plan before the run, its summary after it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import inf, isfinite
from pathlib import Path
from typing import Any

import numpy as np

from qbxstokes.case.load import LoadedCase
from qbxstokes.case.scene import FREE, LOCKED
from qbxstokes.case.schema import Case
from qbxstokes.quantities import BODY
from qbxstokes.runs.destination import result_path
from qbxstokes.runs.plan import CoupledPlan, FieldPlan, MotionPlan, Plan
from qbxstokes.runs.report import (
    ABOUT,
    Rows,
    counted,
    duration,
    error_text,
    expected_text,
    flow_text,
    grids,
    listed,
    near_edge,
    of_each,
    out_of_reach,
    quantity,
    render,
    shape_text,
    size,
    spent_text,
    vector,
)

_NO_DRIFT = 1e-14  # displacements below are rounding
_TUMBLING = 1e8  # orbit constants above are infinite but for rounding, as in the averages
_TAKES = "beside start, comparison, lines and a motion's field (within a factor of 2) about"
_LONG = 1.0  # a comparison that takes longer (s), and longer than the motion, says how to avoid it
# Errors of a field, which has no reference but itself.
_CHECKS = {
    **ABOUT,
    "table against QBX": "two evaluations at points from the surface to far away",
}


def scene(loaded: LoadedCase, plan: Plan) -> Rows:
    """Body and flow; where the body is, or what drives it and for how long."""
    case = loaded.case
    if case.coupled:
        from qbxstokes.runs import coupled_report

        yield from coupled_report.scene(loaded)
        return
    shape, stokes = shape_text(case.body.outline), case.body.stokes_number
    if case.task == "motion":
        shape += ", massless" if stokes == 0 else f", St = {quantity(stokes)}"
    elif case.task == "field":
        assert case.field is not None
        shape += f", {case.field.body}"
    yield "body", shape
    if case.flow is not None:
        yield "flow", flow_text(loaded)
        if loaded.flow.domain:
            yield "walls", "bound the flow; their answer to the body is not in the equations"
    if case.units is not None:
        yield "units", case.units.scales.told
    if isinstance(plan, MotionPlan):
        yield from _driven(case)
        yield "time", _span(plan)
    elif case.rheology is not None:
        yield "suspension", f"dilute, {case.rheology.protocol} flow"
    elif case.task == "body" and case.flow is not None:
        place, turn = plan.simulation.position[0], plan.simulation.quaternion[0]
        yield "place", f"({vector(place)}), quaternion ({vector(turn)})"


def _span(plan: MotionPlan) -> str:
    end = float(plan.times[-1])
    text = f"0 to {quantity(end)}"
    if plan.period is not None and plan.simulation.flow.steady:
        periods = counted(end / plan.period, "Jeffery period")
        text += f" ({periods} of {quantity(plan.period)})"
    return f"{text}, {len(plan.times)} samples"


def _driven(case: Case) -> Rows:
    """Loads and constraints, where there are any."""
    loads = []
    for name in ("force", "torque", "body_force", "body_torque"):
        value = getattr(case.forces, name)
        if value is not None:
            loads.append(f"{name.replace('_', ' ')} {_vector(value)}")
    gravity = case.forces.gravity
    if gravity is not None:
        net = gravity.net(case.body.stokes_number)
        loads.append(f"net weight {quantity(net)} x volume along {_vector(gravity.direction)}")
    if loads:
        yield "loads", "; ".join(loads)
    held = [
        f"{name} {value if value == LOCKED else 'prescribed: ' + _vector(value)}"
        for name in ("translation", "rotation")
        if (value := getattr(case.constraints, name)) != FREE
    ]
    if held:
        yield "constraints", "; ".join(held)


def _vector(value: Any) -> str:
    if isinstance(value, dict):
        return f"table {value['table']}" if "table" in value else "as tabulated"
    if isinstance(value, str):
        return value
    return "(" + ", ".join(v if isinstance(v, str) else quantity(v) for v in value) + ")"


def plan_facts(plan: Plan, target: Path) -> dict[str, Any]:
    """The plan as plain data."""
    facts: dict[str, Any] = {
        "needs": list(plan.needs),
        "skips": list(plan.skips),
        "output": str(target),
    }
    if isinstance(plan, FieldPlan):
        facts |= {"points": plan.points}
    if isinstance(plan, MotionPlan):
        facts |= {
            "end": float(plan.times[-1]),
            "samples": len(plan.times),
            "bytes_on_disk": plan.bytes_on_disk,
        }
        if not isinstance(plan, CoupledPlan):
            facts |= {"hydrodynamics": plan.simulation.kind, "jeffery_period": plan.period}
    return facts


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


def summary_text(loaded: LoadedCase, plan: Plan, summary: dict[str, Any]) -> str:
    """What was solved, what was found and skipped, errors, times, and the files."""
    of_field = loaded.case.task == "field"
    times = summary["wall_times"]
    spent = spent_text(times)
    if times.get("comparison", 0.0) > max(_LONG, times.get("motion", inf)):
        spent += " (`compare: {reference: none}` leaves it out)"
    if loaded.case.coupled and not of_field:
        from qbxstokes.runs import coupled_report

        found = coupled_report.sections(summary)
    else:
        found = {
            "Solved": _field_solved(summary) if of_field else _solved(summary),
            "Found": _found(summary),
            "Errors": _errors(summary),
        }
    sections: dict[str, Rows] = {
        "Scene": scene(loaded, plan),
        **found,
        "Skipped": () if of_field else listed(plan.skips),
        "Times": [("total", duration(times["total"])), ("parts", spent)],
        "Result": files(loaded, summary),
    }
    return render(loaded.case.title or f"Task {loaded.case.task}", str(loaded.path), sections)


def remarks(loaded: LoadedCase, summary: dict[str, Any]) -> Iterator[str]:
    """What standard error is told after a summary."""
    yield from loaded.remarks
    time, compared = loaded.case.time, loaded.case.compare.tolerance
    if time is not None:
        yield from out_of_reach(summary, time.tolerance)
    found = summary.get("events", {})
    if "ended_by" in found:
        yield f"ended at t = {summary['end']:.6g}: {found['ended_because']}"
    near = found.get("nearest", {}).get("domain_exit")
    if near is not None:
        yield near_edge(near["gap"], near["time"])
    if loaded.case.units is not None:
        yield from loaded.case.units.scales.remarks
    for name in summary["unused_petsc_options"]:
        yield f"PETSc option -{name} was not used by anything"
    if missed(loaded, summary):
        yield f"largest error {summary['largest_error']:.1e} exceeds compare.tolerance {compared:g}"


def missed(loaded: LoadedCase, summary: dict[str, Any]) -> bool:
    """Whether an error exceeds `compare.tolerance`, or is not a number."""
    limit = loaded.case.compare.tolerance
    return limit is not None and not summary["largest_error"] <= limit


def _errors(summary: dict[str, Any]) -> Rows:
    references = summary.get("references", {})
    for name, value in (summary["errors"] | summary.get("field", {}).get("errors", {})).items():
        about = f"against {references[name]}" if name in references else _CHECKS[name]
        yield name.replace("_", " "), f"{error_text(value):9}{about}"
    if summary.get("note"):
        yield "", summary["note"]


def files(loaded: LoadedCase, summary: dict[str, Any]) -> Rows:
    """The files that were written."""
    yield "file", summary["result"]
    for name in summary.get("field", summary).get("files", ()):
        yield "", name
    asked = result_path(loaded)
    if Path(summary["result"]) != asked:
        yield "", f"({asked} exists and was kept; --overwrite replaces it)"


def _field_solved(summary: dict[str, Any]) -> Rows:
    hydro, together = summary["hydrodynamics"], summary["hydrodynamics"].get("nodes")
    if together is not None:
        grid = grids(together)
    else:
        grid = f"{hydro['n_theta']} x {hydro['n_phi']} nodes"
    work = f"{counted(hydro['solves'], 'solve')}, {counted(hydro['iterations'], 'iteration')}"
    residual = f"true residual <= {error_text(hydro['true_residual'])}"
    yield "integral equation" if together is None else "GMRES", f"{grid}, {work}, {residual}"
    if together is None:
        yield "table", f"spheroidal harmonics of degree {hydro['degree_of_table']}"
    yield "points", _points(summary["points"])
    for name in ("velocity", "angular_velocity", "force", "torque"):
        yield from of_each(name, summary[name], summary["scales"][name])


def _points(points: Mapping[str, int]) -> str:
    """How many points of a field were evaluated in which way."""
    return ", ".join(f"{count} {name}" for name, count in points.items() if count) or "no points"


def _found(summary: dict[str, Any]) -> Rows:
    """What came out."""
    if "suspension" in summary:
        return _suspension(summary["suspension"])
    return _seen(summary) if "events" in summary else _law(summary)


def _suspension(found: Mapping[str, Any]) -> Rows:
    """Material functions at each Peclet number, the last instant of a transient."""
    rest, isotropic = found["viscosity_at_rest"], found["viscosity_of_isotropic"]
    yield "limits of [eta]", f"{rest:.9g} at small Pe; {isotropic:.9g} isotropic, without Brownian"
    names = {"[eta]": "intrinsic_viscosity", "N1": "first_normal_stress_difference"}
    names["N2"] = "second_normal_stress_difference"
    for place, number in enumerate(found["peclet_number"]):
        parts = []
        for symbol, name in names.items():
            value, error = found[name][place], found.get(f"{name}_standard_error")
            if isfinite(value):
                mean = f"{value:.9g}" if error is None else f"{value:.5g} +- {error[place]:.1e}"
                parts.append(f"{symbol} {mean}")
        text = ", ".join(parts)
        if "error_estimate" in found:
            text += f"; error {error_text(found['error_estimate'][place])}"
        yield f"Pe = {number:g}", text


def _law(summary: dict[str, Any]) -> Rows:
    """The numbers of a body's law; in a flow, what the body does there."""
    for name, about in BODY.items():
        if name in summary and about.shape != (6, 6):
            value = summary[name]
            text = f"{value:.9g}" if np.ndim(value) == 0 else f"({vector(value)})"
            yield name.replace("_", " "), text


def _solved(summary: dict[str, Any]) -> Rows:
    """How the body was formed, its resistance, and what the motion took."""
    hydro = summary["hydrodynamics"]
    grid = f"{hydro['n_theta']} x {hydro['n_phi']} nodes, order {hydro['expansion_order']}"
    yield "integral equation", f"{hydro['scheme']} QBX, {grid}"
    if hydro["solves"]:
        yield (
            "GMRES",
            f"{counted(hydro['solves'], 'solve')}, "
            f"{counted(hydro['iterations'], 'iteration')} in all, "
            f"true residual <= {error_text(hydro['true_residual'])}",
        )
    if "finest_nodes" in hydro:
        start, finest = (
            " x ".join(map(str, hydro[name])) for name in ("flow_nodes", "finest_nodes")
        )
        yield "flow on the body", f"{start} points at the start, at most {finest}"
    if "neglected" in hydro:
        told = ", ".join(f"{value:.1g}" for value in hydro["neglected"])
        yield "neglected", f"beyond the derivatives, U/(c |grad u|), Omega/|grad u|: {told}"
    if hydro["cache"] == "found":
        yield "", "body model from the cache (--no-cache forms it anew)"
    if hydro.get("error_parts"):
        yield "estimated error", _estimate(hydro)
    if "resistance" in summary:
        across, along, turning, spinning = (
            f"{value:.9g}" for value in summary["resistance"].values()
        )
        text = f"{across} across, {along} along the axis; rotation {turning}, {spinning}"
        yield "resistance", text
    if "integration" not in summary:
        return
    steps, layer = summary["integration"], summary["relaxation_times"]
    if layer:
        a, b, c, d = (quantity(value) for value in layer.values())
        yield "relaxation times", f"{a} across, {b} along; axis {c}, spin {d}"
    if summary["resumed_at"] is not None:
        yield "resumed", f"from the checkpoint at t = {quantity(summary['resumed_at'])}"
    yield (
        "motion",
        f"TS {steps['method']}: {counted(steps['steps'], 'step')}, {steps['rejected']} rejected, "
        f"{steps['rhs_evaluations']} right-hand sides",
    )
    if "longest_step" in steps:
        yield (
            "",
            f"none longer than {steps['longest_step']:.3g}, for flow or loads change in time; what "
            "changes within much less needs flow.longest_step",
        )
    if "expected_error" in summary:
        yield "expected error", expected_text(summary["expected_error"])
    if summary.get("sampling"):
        axis, place = (f"{summary['sampling'][name]:.2g}" for name in ("axis", "position"))
        yield "left by samples", f"{axis} of the axis at the end, {place} of the position"
    if "changed" in steps:
        yield "", steps["changed"]
    if "field" in summary:
        yield "field", _points(summary["field"]["points"])


def _estimate(hydro: Mapping[str, Any]) -> str:
    """The estimated error of the hydrodynamics, its parts, and how they make the whole."""
    parts, estimate = hydro["error_parts"], hydro["error_estimate"]
    text = ", ".join(f"{name} {error_text(value)}" for name, value in parts.items())
    # How far the model misses the law of a polynomial flow is a bound that the sum may fall below.
    whole = "sum of" if estimate <= sum(parts.values()) else "misfit of the law; besides,"
    return f"{error_text(estimate)}: {whole} {text}"


def _seen(summary: dict[str, Any]) -> Rows:
    """What was found on the way: events, and what they say of periods and drift."""
    found = summary["events"]
    counts = [
        counted(count, "half turn") if name == "half_turns" else f"{count} {name.replace('_', ' ')}"
        for name, count in found["counts"].items()
    ]
    if counts:
        yield "events", ", ".join(counts)
    if "period" in found:
        turns = f"mean of {found['turns']} whole turns" if found["turns"] > 1 else "one whole turn"
        yield "period", f"{found['period']:.12g} ({turns})"
        drift = found["drift_per_period"]
        if any(abs(part) > _NO_DRIFT for part in drift):
            yield "drift per period", f"({vector(drift)})"
        first, last = found["orbit_constant_first"], found["orbit_constant_last"]
        if min(first, last) > _TUMBLING:
            yield "orbit constant", "infinite: the body tumbles in the plane of shear"
        elif isfinite(first) and isfinite(last):
            yield "orbit constant", f"{first:.9g} to {last:.9g}"
    if "orbit_constant_drift" in summary:
        norm = error_text(summary["integration"]["quaternion_norm_drift"])
        drift = error_text(summary["orbit_constant_drift"])
        yield "drift of invariants", f"orbit constant {drift}, quaternion norm {norm}"
    if "steady_at" in found:
        yield "steady", f"from t = {quantity(found['steady_at'])} on"
    if "ended_by" in found:
        yield "ended", f"at t = {quantity(summary['end'])}: {found['ended_because']}"
