"""`task: motion`: of one body, or of several that share the fluid, from case to result file.

Rank 0 integrates. Of one body the other ranks form rows of the operators, of several they take part
in every problem that rank 0 poses; and all share the field.
"""

from __future__ import annotations

import signal
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from qbxstokes.errors import ConvergenceError, Interrupted, QbxStokesError
from qbxstokes.io.cache import open_cache
from qbxstokes.io.store import Work
from qbxstokes.io.writer import ResultWriter
from qbxstokes.petsc import session
from qbxstokes.petsc.trajectory import Trajectory
from qbxstokes.runs.destination import identity_of, working_folder
from qbxstokes.runs.parallel import on_root
from qbxstokes.runs.progress import Advance
from qbxstokes.runs.recording import Recording
from qbxstokes.runs.sharing import RowTeam, ordered, with_team
from qbxstokes.simulation.assembly import assemble
from qbxstokes.simulation.compare import Comparison, compare_samples, shear_rate
from qbxstokes.simulation.from_case import pointed
from qbxstokes.simulation.hydrodynamics import Workshop
from qbxstokes.simulation.result import integration_facts
from qbxstokes.simulation.watching import events_summary

if TYPE_CHECKING:
    from qbxstokes.runs.command import Job


_BODIES = "bodies"  # the service of the other ranks to several bodies


def run(job: Job) -> dict[str, Any]:
    """Carry out `task: motion` on all ranks; returns the summary.

    A single trajectory has nothing to share out: rank 0 computes it, so that any number of ranks
    gives the numbers of one.
    """

    loaded, comm = job.loaded, job.comm
    # Cuts are part of the numbers; those by the clock only choose among them.
    by_clock = loaded.case.checkpoint.interval.unit == "seconds"
    cuts = None if by_clock else loaded.case.checkpoint.every
    options = session.stepper_options(job.PETSc)
    identity = identity_of(loaded, options, ("field", "sweep"), cuts=cuts)
    recordings: list[Recording] = []  # one on rank 0

    def opened(work: Work) -> None:
        recordings.append(Recording(loaded, job.plan, work))

    def help_with_field(*arguments: Any) -> None:
        from qbxstokes.runs import field

        field.help_with_field(job, *arguments)

    def compute(team: RowTeam) -> dict[str, Any]:
        follow = _of_several if loaded.case.coupled else _of_one
        return follow(job, recordings[0], team)

    job.interruption.patient = comm.rank != 0
    services = {"field": help_with_field, _BODIES: lambda: _help_with_bodies(job)}
    with working_folder(job, identity, opened) as (work, done):
        if work is None:
            return {"result": str(done), "finished_before": True}
        summary = on_root(comm, with_team(comm, compute, services))
    if summary["failure"]:
        error = ConvergenceError(
            f"{summary['failure']}; {summary['result']} holds the motion so far"
        )
        error.on_all_ranks = True
        raise error
    return summary


def _followed(
    job: Job,
    recording: Recording,
    team: RowTeam,
    assembled: Any,
    watch: Any,
    facts: Callable[[Trajectory], dict[str, Any]],
    conclude: Callable[[dict[str, Any], Mapping[str, Any]], None],
) -> dict[str, Any]:
    """Follow a motion on this process, write its result file, and return the summary.

    watch: for events. facts: what the summary says of the computation. conclude: adds to the
    summary what follows from the samples, before all ranks turn to the field. Raises Interrupted
    where a signal asks for it, after what there is has been written and made safe, and
    ConvergenceError where the motion cannot be followed at all.
    """
    case, plan, clock, interruption = job.loaded.case, job.plan, job.clock, job.interruption
    with clock.part("motion"), pointed(job.loaded):
        watch.begin(0.0, assembled.initial)
        speak = not job.options.quiet and job.options.progress != "none"
        advance = Advance(float(plan.times[-1]), speak)
        receive = recording.receiver(assembled, watch, advance)
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
        raise ConvergenceError(trajectory.failure)
    if not trajectory.finished or case.field is not None:  # which may take longer than the motion
        recording.save()
        if not recording.saved:
            raise interrupted(recording, {}, trajectory.reached, interruption.signal)
    summary = {
        **job.heading(trajectory.finished and not trajectory.failure),
        "failure": trajectory.failure,
        "resumed_at": recording.resumed_at,
        "integration": integration_facts(trajectory),
        **facts(trajectory),
        "skipped": list(plan.skips),
    }
    replace, work = job.overwrite or recording.replaces, recording.work
    record = {**job.provenance, **recording.provenance}
    with ResultWriter(work.target, case.task, record, replace, work.folder) as writer:
        with clock.part("output"):
            samples = recording.write(writer, plan.quantities)
        summary["samples"] = recording.samples
        if len(samples["time"]):
            for name in ("position", "orientation", "axis"):
                summary[f"final_{name}"] = samples[name][-1]
            summary["end"] = float(samples["time"][-1])
        conclude(summary, samples)
        if case.field is not None and summary["complete"]:
            from qbxstokes.runs.field import export_field, field_of_motion

            summary["field"] = field_of_motion(job, samples, writer, assembled, team, work)
            summary["field"]["files"] = export_field(job.loaded, clock, writer.file, work)
        with clock.part("output"):
            summary["wall_times"] = dict(clock.parts)
            summary["result"] = str(writer.finish(summary))
    if "field" in summary:
        from qbxstokes.runs.field import draw_pictures

        summary["field"]["files"] += draw_pictures(job.loaded, clock, Path(summary["result"]))
    if not trajectory.finished:
        raise interrupted(recording, summary, trajectory.reached, interruption.signal)
    return summary


def _of_one(job: Job, recording: Recording, team: RowTeam) -> dict[str, Any]:
    """The motion of a single body; returns the summary."""
    loaded, case, clock = job.loaded, job.loaded.case, job.clock
    # Options of the solver want to be seen at work.
    off = job.options.no_cache or bool(session.solver_options(job.PETSc))
    cache = open_cache(case.hydrodynamics.cache, off)
    job.plan.simulation.body.workshop = Workshop(team, cache)
    with clock.part("set-up"), pointed(loaded):
        assembled = assemble([job.plan.simulation])
        events = assembled.watch()

    def facts(trajectory: Trajectory) -> dict[str, Any]:
        body = assembled.hydrodynamics[0]
        resistance = body.model.formed_resistance
        return {
            "jeffery_period": job.plan.period,
            "hydrodynamics": body.report(),
            "cache_problems": cache.problems,
            **({"resistance": vars(resistance)} if resistance else {}),
            "relaxation_times": relaxation_times(assembled.equations),
            "events": events_summary(events),
            "expected_error": assembled.expected_errors(
                trajectory.reached, trajectory.checkpoint.reachable
            )[0],
        }

    def conclude(summary: dict[str, Any], samples: Mapping[str, Any]) -> None:
        times = samples["time"]
        conserved = not (case.body.stokes_number or case.forces.given or case.constraints.given)
        if conserved and shear_rate(loaded.flow) is not None:
            summary["orbit_constant_drift"] = float(samples["largest_orbit_drift"])
        comparison = Comparison()
        if case.compare.reference != "none" and summary["complete"] and len(times):
            with clock.part("comparison"):
                comparison = compare_samples(assembled, times, samples)
        summary |= {
            "errors": comparison.errors,
            "references": comparison.references,
            "note": comparison.note,
            "largest_error": comparison.largest,
        }
        if summary["complete"] and len(times):
            with clock.part("sampling"):
                summary["sampling"] = assembled.sampling(float(times[-1]))

    return _followed(job, recording, team, assembled, events, facts, conclude)


def _of_several(job: Job, recording: Recording, team: RowTeam) -> dict[str, Any]:
    """The motion of bodies that share the fluid, or of one by a wall; returns the summary."""
    from qbxstokes.petsc.coupled import over
    from qbxstokes.simulation import coupled_assembly

    scene = job.plan.simulation
    scene.suspension.comm = over(job.comm)
    if scene.table is not None:
        named = job.loaded.case.hydrodynamics.cache
        scene.table.cache = open_cache(named, job.options.no_cache)
    team.join(_BODIES)
    if job.comm.size > 1:
        scene.herald = lambda order: ordered(job.comm, order)

    def dismiss() -> None:
        """No more problems for the other ranks."""
        if scene.herald is not None:
            scene.herald = scene.herald(None)

    try:
        with job.clock.part("motion"), pointed(job.loaded):
            assembled = scene.assemble()
            watch = assembled.watch()
        assembled.asked = job.interruption.asked

        def facts(trajectory: Trajectory) -> dict[str, Any]:
            assembled.asked = None  # what remains is little
            if trajectory.finished:
                with job.clock.part("error estimate"):
                    assembled.estimate_along(trajectory, watch)
            return {
                **coupled_assembly.facts(assembled, trajectory),
                "events": coupled_assembly.meetings_summary(watch),
                "errors": {},
                "largest_error": None,
            }

        return _followed(job, recording, team, assembled, watch, facts, lambda *_: dismiss())
    finally:
        dismiss()


def _help_with_bodies(job: Job) -> None:
    """What the other ranks do for the motion of several bodies."""
    from qbxstokes.petsc.coupled import PAUSE, over
    from qbxstokes.simulation.from_case import coupled_of

    scene = coupled_of(job.loaded) if job.plan is None else job.plan.simulation
    scene.suspension.comm = over(job.comm)
    while (order := ordered(job.comm, pause=PAUSE)) is not None:
        try:
            scene.join(*order)
        except QbxStokesError:
            continue  # rank 0 meets the same, and tells it


def relaxation_times(equations: Any) -> dict[str, float]:
    """Time scales on which a body takes up the motion of the fluid, empty for St = 0.

    St Theta/R_t across and along the axis, St J/R_r of the axis and about it.
    """
    if equations.massless:
        return {}
    names = ("translation_across", "translation_along", "rotation_of_axis", "rotation_about_axis")
    with np.errstate(divide="ignore"):  # a part without inertia follows at once
        times = np.where(equations.relaxation_rates > 0.0, 1.0 / equations.relaxation_rates, 0.0)
    return dict(zip(names, times[:, 0].tolist(), strict=True))


def interrupted(
    recording: Recording, summary: Mapping[str, Any], reached: float, number: int
) -> Interrupted:
    """What is said of a run that a signal stopped when its steps had come to t = reached."""
    stopped = f"{signal.Signals(number).name}: stopped at t = {reached:.6g}"
    if not recording.saved:
        return Interrupted(
            f"{stopped}, within the first steps; no result was written, start again", number
        )
    return Interrupted(
        f"{stopped}; {summary['result']} holds the motion to t = {summary.get('end', 0.0):.6g}; "
        "go on with the same command and --resume",
        number,
    )
