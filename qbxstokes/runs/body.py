"""`task: body`: resistance, law and errors of a body, or of several, from case to result file."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from qbxstokes.errors import QbxStokesError
from qbxstokes.geometry import rotation
from qbxstokes.geometry.symmetric import components
from qbxstokes.quantities import BODY, COUPLED
from qbxstokes.runs.parallel import agree, on_root
from qbxstokes.runs.sharing import RowTeam, with_team
from qbxstokes.simulation.compare import Comparison
from qbxstokes.simulation.from_case import pointed
from qbxstokes.simulation.hydrodynamics import Workshop
from qbxstokes.simulation.law import Law
from qbxstokes.typing import Array

if TYPE_CHECKING:
    from qbxstokes.runs.command import Job
    from qbxstokes.simulation.coupled import CoupledSimulation


def run(job: Job) -> dict[str, Any]:
    """Compute a body, or bodies that share a fluid, and write the result; returns the summary.

    Of one body rank 0 computes, so that any number of ranks gives its numbers; all form the rows.
    """
    if job.loaded.case.coupled:
        return _of_several(job)

    def compute(team: RowTeam) -> dict[str, Any]:
        job.plan.simulation.body.workshop = Workshop(team)
        return _computed(job)

    return on_root(job.comm, with_team(job.comm, compute))


def _computed(job: Job) -> dict[str, Any]:
    """Form the body, write the result file, and return the summary."""
    loaded, scene, clock = job.loaded, job.plan.simulation, job.clock
    in_flow = loaded.case.flow is not None
    with clock.part("set-up"), pointed(loaded):
        law, compared = Law(scene, in_flow), Comparison()
    with clock.part("stresslet"):
        stresslet = scene.body.stress
    with clock.part("law"):
        arrays = law.arrays
    if loaded.case.compare.reference != "none":
        with clock.part("comparison"):
            compared = law.errors(arrays)
            compared.add("stresslet", "Jeffery, Kim and Karrila", law.stresslet_error())
    formed = law.formed
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


def _of_several(job: Job) -> dict[str, Any]:
    """Resistance and, where a flow or loads drive them, motion of the bodies; the summary.

    The bodies are dealt to the ranks (`petsc.coupled`), which all go through the same solves.
    """
    from qbxstokes.petsc.coupled import over
    from qbxstokes.simulation.from_case import coupled_of

    loaded, comm = job.loaded, job.comm
    failure: QbxStokesError | None = None
    arrays: dict[str, Array] = {}
    summary: dict[str, Any] = {}
    try:
        with job.clock.part("bodies"), pointed(loaded):
            arrays, summary = computed(coupled_of(loaded, over(comm)))
    except QbxStokesError as error:
        failure = error
    agree(comm, failure)

    return on_root(comm, lambda: {**arrays, **job.write(summary, arrays, COUPLED)})


def computed(scene: CoupledSimulation) -> tuple[dict[str, Array], dict[str, Any]]:
    """What bodies do at the start: arrays by name, and what is told of them."""
    suspension, x, q = scene.suspension, scene.position, scene.quaternion
    resistance, error = suspension.resistance_and_error(x, q)
    arrays = {
        "position": x,
        "axis": rotation.axis(q),
        "resistance": resistance,
        "mobility": np.linalg.inv(resistance),
    }
    errors, relative = {"resistance": error}, [error]
    gap, who = scene.closest(scene.places)
    summary: dict[str, Any] = {"gap": gap, "nearest": who}
    free = scene.solved("free", 0.0, x, q)
    if any(part is not None for part in (scene.flow, scene.loads, scene.repulsion)):
        arrays |= {"free_velocity": free.velocity, "free_angular_velocity": free.angular_velocity}
        arrays["stresslet"] = components(free.stresslet)
        names = {"velocity": "free_velocity", "angular_velocity": "free_angular_velocity"}
        told = free.error_estimate
        errors |= {names.get(n, n): told[n] for n in (*names, "stresslet")}
        relative += free.relative_errors.values()
    if scene.flow is not None:
        held = suspension.held(scene.flow, x, q)
        arrays |= {"held_force": -held.force, "held_torque": -held.torque}
        errors |= {f"held_{name}": held.error_estimate[name] for name in ("force", "torque")}
        relative += held.relative_errors.values()
    if not scene.several:
        one = ("resistance", "mobility")
        arrays = {name: a if name in one else a[0] for name, a in arrays.items()}
    summary |= {"nodes": free.nodes, "iterations": free.iterations, "error_estimates": errors}
    summary["relative_error"] = max(relative)
    return arrays, summary
