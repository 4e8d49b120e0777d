"""The texts of a motion: its plan before the run, its summary after it."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from math import isfinite
from pathlib import Path
from typing import Any

from qbxstokes.case.constraints import FREE, LOCKED
from qbxstokes.case.load import LoadedCase
from qbxstokes.case.schema import Case
from qbxstokes.runs.plan import Plan
from qbxstokes.runs.report import (
    Rows,
    counted,
    described_points,
    duration,
    error_text,
    field_errors,
    quantity,
    render,
    size,
    vector,
)
from qbxstokes.runs.target import result_path

_NO_DRIFT = 1e-14  # displacements below are rounding
_TUMBLING = 1e8  # orbit constants above are infinite but for rounding, as in the averages


_LONG = 1.0  # a comparison that takes longer (s), and longer than the motion, says how to avoid it


def scene(loaded: LoadedCase, plan: Plan) -> Rows:
    """Body, flow and time in three rows."""
    case = loaded.case
    stokes = case.body.stokes_number
    end = f"0 to {quantity(float(plan.times[-1]))}"
    if plan.period is not None:
        periods = float(plan.times[-1]) / plan.period
        end += f" ({counted(periods, 'Jeffery period')} of {quantity(plan.period)})"
    mass = "massless" if stokes == 0 else f"St = {quantity(stokes)}"
    yield "body", f"{shape_text(case)}, {mass}"
    yield "flow", flow_text(loaded)
    yield from _driven(case)
    yield "time", f"{end}, {len(plan.times)} samples"


def shape_text(case: Case) -> str:
    """The body's shape and aspect ratio."""
    k = case.body.aspect_ratio
    if k == 1:
        return "sphere, k = 1"
    return f"{'prolate' if k < 1 else 'oblate'} spheroid, k = {quantity(k)}"


def flow_text(loaded: LoadedCase) -> str:
    """The flow's name, its keys with their values, given or not, and its degree."""
    from qbxstokes.flows import REGISTRY

    assert loaded.case.flow is not None
    given = loaded.case.flow.spec()
    name = given.pop("type")
    defaults = {key: value for key, value in REGISTRY[name].keys().items() if _stated(value)}
    parts = [name, *(f"{key} {_short(value)}" for key, value in {**defaults, **given}.items())]
    degree = loaded.flow.degree
    return ", ".join(parts) + ("" if degree is None else f"; polynomial of degree {degree}")


def _stated(default: Any) -> bool:
    """Whether a key has a default that says something."""
    return default is not None and default is not inspect.Parameter.empty


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
    return {
        "hydrodynamics": plan.simulation.kind,
        "end": float(plan.times[-1]),
        "samples": len(plan.times),
        "jeffery_period": plan.period,
        "needs": list(plan.needs),
        "skips": list(plan.skips),
        "output": str(target),
        "bytes_on_disk": plan.bytes_on_disk,
    }


def explain(loaded: LoadedCase, plan: Plan, target: Path) -> str:
    """What the scene needs, what it skips, and where the result goes."""
    text = render(
        f"Plan: {loaded.case.title or loaded.case.task}",
        str(loaded.path),
        {
            "Scene": scene(loaded, plan),
            "Needs": [("", f"- {text}") for text in plan.needs],
            "Skips": [("", f"- {text}") for text in plan.skips],
            "Writes": [(str(target), f"about {size(plan.bytes_on_disk)} of samples")],
        },
    )
    return text + "\n"


def summary_text(loaded: LoadedCase, plan: Plan, summary: dict[str, Any]) -> str:
    """What was solved, what was skipped, errors, times, and the file."""
    errors = [
        (name.replace("_", " "), f"{error_text(value):9}against {summary['references'][name]}")
        for name, value in summary["errors"].items()
    ]
    errors += field_errors(summary.get("field", {}).get("errors", {}))
    if summary["note"]:
        errors.append(("", summary["note"]))
    times = summary["wall_times"]
    spent = ", ".join(
        f"{name} {duration(value)}" for name, value in times.items() if name != "total"
    )
    if times.get("comparison", 0.0) > max(_LONG, times["motion"]):
        spent += " (`compare: {reference: none}` leaves it out)"
    return render(
        loaded.case.title or f"Task {loaded.case.task}",
        str(loaded.path),
        {
            "Scene": scene(loaded, plan),
            "Solved": _solved(summary),
            "Found": _seen(summary),
            "Skipped": [("", f"- {text}") for text in plan.skips],
            "Errors": errors,
            "Times": [("total", duration(times["total"])), ("parts", spent)],
            "Result": result_rows(loaded, summary),
        },
    )


def result_rows(loaded: LoadedCase, summary: dict[str, Any]) -> Rows:
    """The files that were written."""
    yield "file", summary["result"]
    for name in summary.get("field", {}).get("files", ()):
        yield "", name
    asked = result_path(loaded)
    if Path(summary["result"]) != asked:
        yield "", f"({asked} exists and was kept; --overwrite replaces it)"


def hydrodynamics_rows(summary: dict[str, Any]) -> Rows:
    """How the body was formed, and its resistance."""
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


def _solved(summary: dict[str, Any]) -> Rows:
    steps = summary["integration"]
    yield from hydrodynamics_rows(summary)
    layer = summary["relaxation_times"]
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
    if "field" in summary:
        yield "field", described_points(summary["field"]["points"])


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


def _short(value: Any) -> str:
    text = _text(value)
    return text if len(text) <= 48 else text[:45] + "..."


def _text(value: Any) -> str:
    """A value as in a case file, numbers alike whether or not they were written with a point."""
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(_text, value))}]"
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{key}: {_text(entry)}' for key, entry in value.items())}}}"
    return quantity(value) if isinstance(value, float) else str(value)
