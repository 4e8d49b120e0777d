"""`task: body`: resistance, law and errors of one body, from its case to the result file."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from qbxstokes.case.load import LoadedCase
from qbxstokes.errors import ConvergenceError
from qbxstokes.io.writer import ResultWriter
from qbxstokes.quantities import BODY
from qbxstokes.runs.clock import Clock
from qbxstokes.runs.report import Rows, duration, error_text, render, tell_plan, vector
from qbxstokes.runs.rows import RowTeam, with_team
from qbxstokes.runs.summary import flow_text, hydrodynamics_rows, result_rows, shape_text
from qbxstokes.simulation.compare import Comparison
from qbxstokes.simulation.from_case import pointed, start_of
from qbxstokes.simulation.hydrodynamics import Workshop
from qbxstokes.simulation.law import Law, form_law
from qbxstokes.simulation.simulation import Simulation

if TYPE_CHECKING:
    from qbxstokes.runs.command import Job


@dataclass(frozen=True)
class BodyPlan:
    """The work of one body: where it is in which flow, if in any; what is left out and why."""

    simulation: Simulation
    in_flow: bool
    needs: tuple[str, ...]
    skips: tuple[str, ...]


def plan_body(loaded: LoadedCase) -> BodyPlan:
    """Plan of `task: body`; raises CaseError for what the schema alone cannot see."""
    case, in_flow = loaded.case, loaded.case.flow is not None
    with pointed(loaded):
        scene = start_of(loaded)
        if in_flow:
            scene.check()
    degree = loaded.flow.degree if in_flow else 3
    known = "any flow" if degree is None or degree > 3 else f"flows of degree <= {max(1, degree)}"
    needs = [f"resistance, and the law of free motion in {known}"]
    if in_flow:
        needs.append("velocities of the free body at its place, force and torque on the held one")
    if scene.kind == "every_step":
        needs.append("both by a solution of the integral equation each (as asked)")
    skips = ["motion: nothing is integrated"]
    skips.append("azimuths and southern half of the body: rotational and mirror symmetry give them")
    if case.hydrodynamics.scheme == "graded" and case.hydrodynamics.expansion is None:
        skips.append("outer expansions: inner ones and the jump give the surface values")
    if case.compare.reference == "none":
        skips.append("comparison with closed forms (as asked)")
    return BodyPlan(scene, in_flow, tuple(needs), tuple(skips))


def run_body_case(job: Job) -> int:
    """Carry out `task: body` of a single body; returns the exit status."""
    comm, loaded, plan, options = job.comm, job.loaded, job.plan, job.options

    def facts() -> dict[str, Any]:
        return {"needs": list(plan.needs), "skips": list(plan.skips), "output": str(job.target)}

    if tell_plan(comm, loaded, options, lambda: _explain(loaded, plan, job.target), facts):
        return 0
    from qbxstokes.petsc import session
    from qbxstokes.runs.parallel import on_root
    from qbxstokes.runs.provenance import start_petsc

    PETSc, record = start_petsc(comm, loaded, job.petsc, job.clock)

    def compute(team: RowTeam) -> dict[str, Any]:
        overwrite = options.overwrite or loaded.case.output.overwrite
        with ResultWriter(job.target, loaded.case.task, record, overwrite) as writer:
            return _compute(loaded, plan, job.clock, Workshop(team), writer)

    # Rank 0 computes, so that any number of ranks gives the numbers of one; all form the rows.
    summary = on_root(comm, with_team(comm, compute))
    limit = loaded.case.compare.tolerance
    missed = limit is not None and not summary["largest_error"] <= limit
    if comm.rank == 0:
        summary["unused_petsc_options"] = session.unused_options(PETSc)
        if options.json:
            from qbxstokes.case.document import plain

            print(json.dumps(plain(summary), indent=2))
        elif not options.quiet:
            print(_summary_text(loaded, plan, summary))
        for name in summary["unused_petsc_options"]:
            print(f"qbxstokes: PETSc option -{name} was not used by anything", file=sys.stderr)
        if missed:
            text = f"error {summary['largest_error']:.1e} exceeds compare.tolerance {limit:g}"
            print(f"qbxstokes: largest {text}", file=sys.stderr)
    return ConvergenceError.exit_status if missed else 0


def _compute(
    loaded: LoadedCase, plan: BodyPlan, clock: Clock, workshop: Workshop, writer: ResultWriter
) -> dict[str, Any]:
    """Form the body, write the result file, and return the summary."""
    with clock.part("set-up"), pointed(loaded):
        formed = form_law(plan.simulation, plan.in_flow, workshop)
    law, compared = Law(plan.simulation, formed, plan.in_flow), Comparison()
    with clock.part("law"):
        arrays = law.arrays
    if loaded.case.compare.reference != "none":
        with clock.part("comparison"):
            compared = law.errors(arrays)
    summary: dict[str, Any] = {
        "case": str(loaded.path),
        "title": loaded.case.title,
        "task": loaded.case.task,
        "complete": True,
        "hydrodynamics": formed.report(),
        "nodes": nodes_of(formed.facts),
        "setup_time": clock.parts["set-up"],
        "resistance": vars(formed.model.resistance),
        "errors": compared.errors,
        "references": compared.references,
        "largest_error": compared.largest,
        "skipped": list(plan.skips),
    }
    with clock.part("output"):
        writer.put(arrays, BODY)
        summary["wall_times"] = dict(clock.parts)
        summary["result"] = str(writer.finish(summary))
    summary |= {name: values for name, values in arrays.items() if name not in summary}
    summary["wall_times"] = {**clock.parts, "total": clock.total}
    return summary


def nodes_of(facts: Mapping[str, Any]) -> int:
    """Nodes on the surface of the grid that a body was formed on."""
    return int(facts["n_theta"]) * int(facts["n_phi"])


def _scene(loaded: LoadedCase, plan: BodyPlan) -> Rows:
    yield "body", shape_text(loaded.case)
    if plan.in_flow:
        yield "flow", flow_text(loaded)
        place, turn = plan.simulation.position[0], plan.simulation.quaternion[0]
        yield "place", f"({vector(place)}), quaternion ({vector(turn)})"


def _explain(loaded: LoadedCase, plan: BodyPlan, target: Path) -> str:
    text = render(
        f"Plan: {loaded.case.title or loaded.case.task}",
        str(loaded.path),
        {
            "Scene": _scene(loaded, plan),
            "Needs": [("", f"- {text}") for text in plan.needs],
            "Skips": [("", f"- {text}") for text in plan.skips],
            "Writes": [("", str(target))],
        },
    )
    return text + "\n"


def _summary_text(loaded: LoadedCase, plan: BodyPlan, summary: dict[str, Any]) -> str:
    times = summary["wall_times"]
    spent = ", ".join(f"{name} {duration(t)}" for name, t in times.items() if name != "total")
    return render(
        loaded.case.title or f"Task {loaded.case.task}",
        str(loaded.path),
        {
            "Scene": _scene(loaded, plan),
            "Solved": hydrodynamics_rows(summary),
            "Found": _found(summary),
            "Skipped": [("", f"- {text}") for text in plan.skips],
            "Errors": [
                (name.replace("_", " "), f"{error_text(value):9}against {reference}")
                for (name, value), reference in zip(
                    summary["errors"].items(), summary["references"].values(), strict=True
                )
            ],
            "Times": [("total", duration(times["total"])), ("parts", spent)],
            "Result": result_rows(loaded, summary),
        },
    )


def _found(summary: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """The law's numbers; in a flow, what the body does there."""
    for name, about in BODY.items():
        if name in summary and about.shape != (6, 6):
            yield name.replace("_", " "), _numbers(summary[name])


def _numbers(values: Any) -> str:
    return f"{values:.9g}" if np.ndim(values) == 0 else f"({vector(values)})"
