"""The summary of a task: what was solved and found, errors, times, files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import inf, isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from qbxstokes.case.load import LoadedCase
from qbxstokes.quantities import BODY
from qbxstokes.runs.destination import result_path
from qbxstokes.runs.plan_report import MANY, scene
from qbxstokes.runs.plan_report import planned as planned
from qbxstokes.runs.report import (
    Rows,
    counted,
    duration,
    error_text,
    listed,
    near_edge,
    quantity,
    render,
    vector,
)

if TYPE_CHECKING:
    from qbxstokes.runs.command import Job

_NO_DRIFT = 1e-14  # displacements below are rounding
_TUMBLING = 1e8  # orbit constants above are infinite but for rounding, as in the averages
_LONG = 1.0  # a comparison that takes longer (s), and longer than the motion, says how to avoid it
# What errors are relative to, or of; a field has no reference but itself.
_CHECKS = {
    "resistance": "of the largest entry",
    "no slip": "largest slip on a surface, which bounds the error of the velocity",
    "coarser grids": "change of the velocity at points from the surfaces to far away",
    "table against QBX": "two evaluations at points from the surface to far away",
}


def summary_text(job: Job, summary: dict[str, Any]) -> str:
    """What was solved, what was found and skipped, errors, times, and the files."""
    loaded, plan = job.loaded, job.plan
    of_field = loaded.case.task == "field"
    times = summary["wall_times"]
    spent = ", ".join(f"{name} {duration(t)}" for name, t in times.items() if name != "total")
    if times.get("comparison", 0.0) > max(_LONG, times.get("motion", inf)):
        spent += " (`compare: {reference: none}` leaves it out)"
    suspension = summary.get("suspension")
    found = _law(summary) if suspension is None else _suspension(suspension)
    estimated = loaded.case.coupled and not of_field
    sections: dict[str, Rows] = {
        "Scene": scene(loaded, plan),
        "Solved": _field_solved(summary) if of_field else _solved(summary),
        "Found": _seen(summary) if "events" in summary else found,
        "Estimated errors" if estimated else "Errors": _errors(summary),
        "Skipped": () if of_field else listed(plan.skips),
        "Times": [("total", duration(times["total"])), ("parts", spent)],
        "Result": files(loaded, summary),
    }
    return render(loaded.case.title or f"Task {loaded.case.task}", str(loaded.path), sections)


def remarks(job: Job, summary: dict[str, Any]) -> Iterator[str]:
    """What standard error is told after a summary."""
    loaded = job.loaded
    time, compared = loaded.case.time, loaded.case.compare.tolerance
    if time is not None:
        text = f"time.tolerance {time.tolerance:g}"
        reachable = summary.get("integration", {}).get("reachable_error", 0.0)
        if reachable > 3.0 * time.tolerance:
            rounding = f"rounding alone leaves an error of about {reachable:.0e} at the end"
            yield f"{text} is out of reach: {rounding}"
        law = summary.get("expected_error", {}).get("law", 0.0)
        if law > 10.0 * time.tolerance:
            error = f"the error of the body's law comes to about {law:.0e} at the end"
            yield f"{text} is missed: {error}"
    of_bodies, aim = summary.get("relative_error", 0.0), loaded.case.hydrodynamics.tolerance
    if of_bodies > 3.0 * aim:
        error = f"errors come to about {of_bodies:.0e} of the largest velocity or load"
        yield f"hydrodynamics.tolerance {aim:g} is missed: {error}"
    found = summary.get("events", {})
    if "ended_by" in found:
        yield f"ended at t = {summary['end']:.6g}: {found['ended_because']}"
    near = found.get("nearest", {}).get("domain_exit")
    if near is not None:
        yield near_edge(near["gap"], near["time"])
    if loaded.case.units is not None:
        yield from loaded.case.units.scales.remarks
    if (field := loaded.case.field) is not None:
        errors = summary["errors"] | summary.get("field", {}).get("errors", {})
        own = not loaded.case.coupled or "tolerance" in field.given_keys
        asked = field.tolerance if own else aim
        if (slip := errors.get("no slip", 0.0)) > asked:
            name = "field" if own else "hydrodynamics"
            yield f"{name}.tolerance {asked:g} is missed: the slip on a surface is {slip:.1e}"
    if compared is not None and summary.get("largest_error") is None:
        why = summary.get("note") or "no closed form is known or asked for"
        yield f"compare.tolerance {compared:g} is held against nothing: {why}"


def _errors(summary: dict[str, Any]) -> Rows:
    references = summary.get("references", {})
    errors = summary.get("error_estimates") or summary.get("velocity_errors") or summary["errors"]
    for name, value in (errors | summary.get("field", {}).get("errors", {})).items():
        about = f"against {references[name]}" if name in references else _CHECKS.get(name, "")
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
    hydro = summary["hydrodynamics"]
    work = f"{counted(hydro['solves'], 'solve')}, {counted(hydro['iterations'], 'iteration')}"
    work += f", true residual <= {error_text(hydro['true_residual'])}"
    if "nodes" in hydro:
        yield "GMRES", f"{_grids(hydro['nodes'])}, {work}"
    else:
        yield "integral equation", f"{hydro['n_theta']} x {hydro['n_phi']} nodes, {work}"
        yield "table", f"spheroidal harmonics of degree {hydro['degree_of_table']}"
    yield "points", _points(summary["points"])
    for name in ("velocity", "angular_velocity", "force", "torque"):
        yield from _of_each(name, summary[name], summary["scales"][name])


def _of_each(name: str, values: Any, scale: float = 0.0) -> Rows:
    """A vector of every body (N, 3), or of one (3,)."""
    several = np.ndim(values) == 2
    for number, row in enumerate(np.atleast_2d(values)[:MANY], start=1):
        who = f"body {number}: " if several else ""
        yield name if number == 1 else " ", f"{who}{vector(row, scale)}"


def _grids(nodes: list[int]) -> str:
    """Polar nodes of the bodies."""
    least, most = min(nodes), max(nodes)
    return f"{least if least == most else f'{least} to {most}'} polar nodes"


def _points(points: Mapping[str, int]) -> str:
    """How many points of a field were evaluated in which way."""
    return ", ".join(f"{count} {name}" for name, count in points.items() if count) or "no points"


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
    """The numbers of a body's law; what bodies do where they are, in a flow or under loads."""
    for name, about in BODY.items():
        if name in summary and about.shape != (6, 6):
            value, label = summary[name], name.replace("_", " ")
            if np.ndim(value) == 2:
                yield from _of_each(label, value)
            else:
                yield label, f"{value:.9g}" if np.ndim(value) == 0 else f"({vector(value)})"


def _solved(summary: dict[str, Any]) -> Rows:
    """How the bodies were formed, and what the motion took."""
    if "hydrodynamics" in summary:
        yield from _formed(summary)
    elif "integration" not in summary:
        yield "grids", _grids(summary["nodes"])
        yield "GMRES", counted(summary["iterations"], "iteration") + " for the free bodies"
        if isfinite(summary["gap"]):
            yield "least gap", f"{quantity(summary['gap'])}: {summary['nearest']}"
    if "integration" in summary:
        yield from _integrated(summary)
    if "field" in summary:
        yield "field", _points(summary["field"]["points"])


def _formed(summary: dict[str, Any]) -> Rows:
    """The grid of a single body, what it was solved for, its resistance."""
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
        first = "coarsest_nodes" if "coarsest_nodes" in hydro else "flow_nodes"
        start, finest = (" x ".join(map(str, hydro[name])) for name in (first, "finest_nodes"))
        yield (
            "flow on the body",
            f"on {start} points" + (f" to {finest}" if finest != start else ""),
        )
    if "neglected" in hydro:
        told = ", ".join(f"{value:.1g}" for value in hydro["neglected"])
        yield "neglected", f"beyond the derivatives, U/(c |grad u|), Omega/|grad u|: {told}"
    if "recognised" in hydro:
        yield "flow", f"recognised as {hydro['recognised']}"
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


def _integrated(summary: dict[str, Any]) -> Rows:
    """What the motion took, and what its error is expected to be."""
    steps = summary["integration"]
    if layer := summary.get("relaxation_times"):
        a, b, c, d = (quantity(value) for value in layer.values())
        yield "relaxation times", f"{a} across, {b} along; axis {c}, spin {d}"
    if summary["resumed_at"] is not None:
        yield "resumed", f"from the checkpoint at t = {quantity(summary['resumed_at'])}"
    yield (
        "motion",
        f"TS {steps['method']}: {counted(steps['steps'], 'step')}, {steps['rejected']} rejected, "
        f"{steps['rhs_evaluations']} right-hand sides",
    )
    if "flow_samples" in steps:
        yield "", f"the flow was sampled at {steps['flow_samples']} instants beforehand"
    if "longest_step" in steps:
        yield (
            "",
            f"none longer than {steps['longest_step']:.3g}, for flow or loads change in time; what "
            "changes within much less needs flow.longest_step",
        )
    if "solves" in summary:  # of bodies together
        work = (
            f"{counted(summary['solves'], 'solve')}, {counted(summary['iterations'], 'iteration')}"
        )
        yield "GMRES", f"{work} in all"
    if "expected_error" in summary:
        (_, total), *parts = summary["expected_error"].items()
        made = ", ".join(f"{name} {error_text(value)}" for name, value in parts)
        whose = "centres and axes" if "solves" in summary else "the axis"
        yield "expected error", f"{error_text(total)} of {whose} at the end: {made}"
    if summary.get("sampling"):
        axis, place = (f"{summary['sampling'][name]:.2g}" for name in ("axis", "position"))
        yield "left by samples", f"{axis} of the axis at the end, {place} of the position"
    if "changed" in steps:
        yield "", steps["changed"]


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
    if "who" in (near := found.get("nearest", {})):
        yield "least gap", f"{near['gap']:.6g}: {near['who']}, at t = {quantity(near['time'])}"
    if "ended_by" in found:
        by = f", {found['ended_by']}" if "solves" in summary else ""
        yield "ended", f"at t = {quantity(summary['end'])}{by}: {found['ended_because']}"
    if "final_position" in summary:
        places = np.atleast_2d(summary["final_position"])[:MANY]
        axes = np.atleast_2d(summary["final_axis"])
        for number, (place, axis) in enumerate(zip(places, axes, strict=False)):
            at = f"centre ({vector(place)}), axis ({vector(axis)})"
            yield " " if number else "at the end", at
