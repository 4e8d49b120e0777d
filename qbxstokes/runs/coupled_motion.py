"""`task: motion` of several bodies, or of one by a wall: from the case to the result file.

Rank 0 integrates; the other ranks take part in every problem that it poses, and then in its field.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from qbxstokes.errors import QbxStokesError
from qbxstokes.io.cache import open_cache
from qbxstokes.io.writer import ResultWriter
from qbxstokes.petsc.coupled import over
from qbxstokes.petsc.trajectory import Trajectory
from qbxstokes.runs.motion import followed, recorded
from qbxstokes.runs.parallel import on_root
from qbxstokes.runs.recording import Recording
from qbxstokes.runs.shared_rows import RowTeam, with_team
from qbxstokes.simulation.coupled_assembly import Together, facts, meetings_summary
from qbxstokes.simulation.from_bodies import coupled_of
from qbxstokes.simulation.from_case import pointed

if TYPE_CHECKING:
    from qbxstokes.runs.command import Job

BODIES = "bodies"  # the service of the other ranks


def run_motion(job: Job) -> dict[str, Any]:
    """Carry out the motion; returns the summary."""
    comm, loaded = job.comm, job.loaded

    def compute(team: RowTeam) -> dict[str, Any]:
        return recorded(job, lambda recording: follow(recording, team))

    def follow(recording: Recording, team: RowTeam) -> dict[str, Any]:
        scene = coupled_of(loaded, over(comm))
        if scene.table is not None:
            named = loaded.case.hydrodynamics.cache
            scene.table.cache = open_cache(named, job.options.no_cache)
        shared = team.join(BODIES)
        if comm.size > 1:
            scene.herald = shared.bcast

        def dismiss() -> None:
            """No more problems for the other ranks."""
            if scene.herald is not None:
                scene.herald = scene.herald(None)

        try:
            return _computed(job, recording, scene.assemble(), team, dismiss)
        finally:
            dismiss()

    def help_with_bodies() -> None:
        scene = coupled_of(loaded, over(comm))
        while (order := comm.bcast(None)) is not None:
            *problem, motion = order
            try:
                scene.solved(*problem, **motion)
            except QbxStokesError:
                continue  # rank 0 meets the same, and tells it

    def help_with_field(*arguments: Any) -> None:
        from qbxstokes.runs import field

        field.help_with_field(job, *arguments)

    job.interruption.patient = comm.rank != 0
    services = {BODIES: help_with_bodies, "field": help_with_field}
    return on_root(comm, with_team(comm, compute, services))


def _computed(
    job: Job,
    recording: Recording,
    assembled: Together,
    team: RowTeam,
    dismiss: Callable[[], None],
) -> dict[str, Any]:
    """The motion of the bodies; returns the summary. dismiss: ends the service of problems."""
    with job.clock.part("motion"), pointed(job.loaded):
        watch = assembled.watch()

    def told(trajectory: Trajectory) -> dict[str, Any]:
        if trajectory.finished:
            with job.clock.part("error estimate"):
                assembled.estimate(trajectory, watch)
        return {
            **facts(assembled),
            "events": meetings_summary(watch),
            "errors": {},
            "largest_error": 0.0,
        }

    def conclude(summary: dict[str, Any], samples: Mapping[str, Any], writer: ResultWriter) -> None:
        if job.loaded.case.field is None or not summary["complete"]:
            return
        from qbxstokes.runs.field import export_field, field_of_motion

        dismiss()
        times, work = samples["time"], recording.work
        found = field_of_motion(job, times, samples, writer, assembled, team, work)
        found["files"] = export_field(job.loaded, job.clock, writer.file, work)
        summary["field"] = found

    return followed(job, recording, assembled, watch, told, conclude)
