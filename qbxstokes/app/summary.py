"""The texts of a motion: its plan before the run, its summary after it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from qbxstokes.app.plan import Plan, result_path
from qbxstokes.app.report import Rows, duration, error_text, quantity, render, size
from qbxstokes.config.load import LoadedCase


def scene(loaded: LoadedCase, plan: Plan) -> Rows:
    """Body, flow and time in three rows."""
    case, flow = loaded.case, loaded.flow
    k, stokes = case.body.aspect_ratio, case.body.stokes_number
    shape = "prolate" if k < 1 else "oblate" if k > 1 else "sphere"
    keys = ", ".join(f"{key} {_short(value)}" for key, value in case.flow.spec().items())
    degree = "" if flow.degree is None else f"; polynomial of degree {flow.degree}"
    end = f"0 to {quantity(float(plan.times[-1]))}"
    if plan.period is not None:
        periods = float(plan.times[-1]) / plan.period
        end += f" ({quantity(periods)} Jeffery periods of {quantity(plan.period)})"
    mass = "massless" if stokes == 0 else f"St = {quantity(stokes)}"
    yield "body", f"{shape} spheroid, k = {quantity(k)}, {mass}"
    yield "flow", keys.removeprefix("type ") + degree
    yield "time", f"{end}, {len(plan.times)} samples"


def plan_facts(plan: Plan) -> dict[str, Any]:
    """The plan as plain data."""
    return {
        "hydrodynamics": plan.hydrodynamics,
        "end": float(plan.times[-1]),
        "samples": len(plan.times),
        "jeffery_period": plan.period,
        "needs": list(plan.needs),
        "skips": list(plan.skips),
        "output": str(plan.output),
        "bytes_on_disk": plan.bytes_on_disk,
    }


def explain(loaded: LoadedCase, plan: Plan) -> str:
    """What the scene needs, what it skips, and where the result goes."""
    text = render(
        f"Plan: {loaded.case.title or loaded.case.task}",
        str(loaded.path),
        {
            "Scene": scene(loaded, plan),
            "Needs": [("", f"- {text}") for text in plan.needs],
            "Skips": [("", f"- {text}") for text in plan.skips],
            "Writes": [(str(plan.output), f"about {size(plan.bytes_on_disk)} of samples")],
        },
    )
    return text + "\n"


def summary_text(loaded: LoadedCase, plan: Plan, summary: dict[str, Any]) -> str:
    """What was solved, what was skipped, errors, times, and the file."""
    errors = [
        (name.replace("_", " "), f"{error_text(value):9}against {summary['references'][name]}")
        for name, value in summary["errors"].items()
    ]
    if summary["note"]:
        errors.append(("", summary["note"]))
    times = summary["wall_times"]
    spent = ", ".join(
        f"{name} {duration(value)}" for name, value in times.items() if name != "total"
    )
    return render(
        loaded.case.title or f"Task {loaded.case.task}",
        str(loaded.path),
        {
            "Scene": scene(loaded, plan),
            "Solved": _solved(summary),
            "Skipped": [("", f"- {text}") for text in plan.skips],
            "Errors": errors,
            "Times": [("total", duration(times["total"])), ("parts", spent)],
            "Result": _result(loaded, summary),
        },
    )


def _result(loaded: LoadedCase, summary: dict[str, Any]) -> Rows:
    yield "file", summary["result"]
    asked = result_path(loaded)
    if Path(summary["result"]) != asked:
        yield "", f"({asked} exists and was kept; --overwrite replaces it)"


def _solved(summary: dict[str, Any]) -> Rows:
    hydro, steps = summary["hydrodynamics"], summary["integration"]
    grid = f"{hydro['n_theta']} x {hydro['n_phi']} nodes, order {hydro['expansion_order']}"
    yield "integral equation", f"{hydro['scheme']} QBX, {grid}"
    if hydro["solves"]:
        yield (
            "GMRES",
            f"{hydro['solves']} solves, {hydro['iterations']} iterations in all, "
            f"true residual <= {error_text(hydro['true_residual'])}",
        )
    if hydro["cache"] == "found":
        yield "", "body model from the cache (--no-cache forms it anew)"
    parts = hydro.get("error_parts")
    if parts:
        text = ", ".join(f"{name} {error_text(value)}" for name, value in parts.items())
        yield "estimated error", f"{error_text(hydro['error_estimate'])} ({text})"
    across, along, turning, spinning = summary["resistance"].values()
    yield (
        "resistance",
        f"{across:.9g} across, {along:.9g} along the axis; rotation {turning:.9g}, {spinning:.9g}",
    )
    yield (
        "motion",
        f"TS {steps['method']}: {steps['steps']} steps, {steps['rejected']} rejected, "
        f"{steps['rhs_evaluations']} right-hand sides",
    )


def _short(value: Any) -> str:
    text = quantity(value) if isinstance(value, float) else str(value)
    return text if len(text) <= 48 else text[:45] + "..."
