"""`task: body`: resistance, law and errors of one body, from its case to the result file."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from qbxstokes.quantities import BODY
from qbxstokes.runs.parallel import on_root
from qbxstokes.runs.shared_rows import RowTeam, with_team
from qbxstokes.simulation.compare import Comparison
from qbxstokes.simulation.from_case import pointed
from qbxstokes.simulation.hydrodynamics import Workshop
from qbxstokes.simulation.law import Law, form_law
from qbxstokes.simulation.stresses import form_stresslet

if TYPE_CHECKING:
    from qbxstokes.runs.command import Job


def run_body(job: Job) -> dict[str, Any]:
    """Compute a single body and write its result; returns the summary.

    Rank 0 computes, so that any number of ranks gives the numbers of one; all form the rows.
    """

    def compute(team: RowTeam) -> dict[str, Any]:
        return _computed(job, Workshop(team))

    return on_root(job.comm, with_team(job.comm, compute))


def _computed(job: Job, workshop: Workshop) -> dict[str, Any]:
    """Form the body, write the result file, and return the summary."""
    loaded, scene, clock = job.loaded, job.plan.simulation, job.clock
    in_flow = loaded.case.flow is not None
    with clock.part("set-up"), pointed(loaded):
        formed = form_law(scene, in_flow, workshop)
    with clock.part("stresslet"):
        stresslet = form_stresslet(scene.body, workshop)
    law, compared = Law(scene, formed, in_flow, stresslet), Comparison()
    with clock.part("law"):
        arrays = law.arrays
    if loaded.case.compare.reference != "none":
        with clock.part("comparison"):
            compared = law.errors(arrays)
            compared.add("stresslet", "Jeffery, Kim and Karrila", law.stresslet_error())
    found = {
        "hydrodynamics": formed.report(),
        "nodes": int(formed.facts["n_theta"]) * int(formed.facts["n_phi"]),
        "setup_time": clock.parts["set-up"],
        "resistance": vars(formed.model.resistance),
        "stresslet_error_estimate": stresslet.error_estimate,
        "errors": compared.errors,
        "references": compared.references,
        "largest_error": compared.largest,
    }
    return {**arrays, **job.write(found, arrays, BODY)}
