"""`task: motion` of several bodies, or of one by a wall: from the case to the result file.

Rank 0 integrates; the other ranks take part in every problem that it poses (`Crew`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from qbxstokes.errors import ConvergenceError, QbxStokesError
from qbxstokes.io.writer import ResultWriter
from qbxstokes.petsc import session
from qbxstokes.petsc.coupled import over
from qbxstokes.runs.motion import interrupted
from qbxstokes.runs.parallel import on_root
from qbxstokes.runs.recording import Recording
from qbxstokes.runs.rows import RowTeam, with_team
from qbxstokes.simulation.from_bodies import coupled_of
from qbxstokes.simulation.from_case import pointed
from qbxstokes.simulation.result import integration_facts
from qbxstokes.simulation.together import Together, facts, meetings_summary

if TYPE_CHECKING:
    from qbxstokes.runs.command import Job

BODIES = "bodies"  # the service of the other ranks


def run_motion(job: Job) -> dict[str, Any]:
    """Carry out the motion; returns the summary."""
    comm, loaded = job.comm, job.loaded

    def compute(team: RowTeam) -> dict[str, Any]:
        options = session.stepper_options(job.PETSc)
        recording = Recording(loaded, job.plan, options, job.options.resume, job.overwrite)
        if recording.finished is not None:
            return {"result": str(recording.finished), "finished_before": True}
        scene = coupled_of(loaded, over(comm))
        shared = team.join(BODIES)
        if comm.size > 1:
            scene.herald = shared.bcast
        try:
            return _computed(job, recording, scene.assemble())
        finally:
            if comm.size > 1:
                shared.bcast(None)
            recording.close()

    def help_with_bodies() -> None:
        scene = coupled_of(loaded, over(comm))
        while (order := comm.bcast(None)) is not None:
            *problem, motion = order
            try:
                scene.solved(*problem, **motion)
            except QbxStokesError:
                continue  # rank 0 meets the same, and tells it

    job.interruption.patient = comm.rank != 0
    return on_root(comm, with_team(comm, compute, {BODIES: help_with_bodies}))


def _computed(job: Job, recording: Recording, assembled: Together) -> dict[str, Any]:
    """Integrate, write the result file, and return the summary; see `runs.motion`."""
    case, plan, clock, interruption = job.loaded.case, job.plan, job.clock, job.interruption
    with clock.part("motion"):
        with pointed(job.loaded):
            watch = assembled.watch()
        watch.begin(0.0, assembled.initial)
        receive = recording.receiver(assembled, watch)
        interruption.listening = True
        trajectory = assembled.trajectory(
            plan.times,
            recording.start,
            on_chunk=receive,
            interrupted=interruption.asked,
            observe=watch,
            **recording.limits,
        )
        if trajectory.refusal:
            watch.ended = ("clearance", trajectory.refusal)
    if trajectory.failure and not trajectory.checkpoint.steps:  # there is nothing to keep
        recording.close(remove=True)
        raise ConvergenceError(trajectory.failure)
    if not trajectory.finished:
        recording.save()
        if not recording.saved:
            raise interrupted(recording, {}, trajectory.reached, interruption.signal)
    else:
        with clock.part("error estimate"):
            assembled.estimate(trajectory, watch)
    summary: dict[str, Any] = {
        "case": str(job.loaded.path),
        "title": case.title,
        "task": case.task,
        "complete": trajectory.finished and not trajectory.failure,
        "failure": trajectory.failure,
        "resumed_at": recording.resumed_at,
        "integration": integration_facts(trajectory),
        **facts(assembled),
        "events": meetings_summary(watch),
        "skipped": list(plan.skips),
        "errors": {},
        "largest_error": 0.0,
    }
    replace = recording.overwrite or recording.replaces(recording.target)
    record = {**job.provenance, **recording.provenance}
    with ResultWriter(
        recording.target, case.task, record, replace, recording.work.folder
    ) as writer:
        with clock.part("output"):
            samples = recording.write(writer, plan.quantities)
        summary["samples"] = recording.samples
        if len(samples["time"]):
            for name in ("position", "axis"):
                summary[f"final_{name}"] = np.asarray(samples[name][-1])
            summary["end"] = float(samples["time"][-1])
        with clock.part("output"):
            summary["wall_times"] = dict(clock.parts)
            summary["result"] = str(writer.finish(summary))
    recording.close(remove=trajectory.finished)
    if not trajectory.finished:
        raise interrupted(recording, summary, trajectory.reached, interruption.signal)
    if trajectory.failure:
        raise ConvergenceError(f"{trajectory.failure}; {summary['result']} holds the motion so far")
    return summary
