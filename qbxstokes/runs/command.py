"""Run a case from its file to its result: read, plan, compute, compare, write, tell."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from qbxstokes.errors import ConvergenceError
from qbxstokes.runs.clock import Clock
from qbxstokes.runs.parallel import guarded, missing_message, on_root, world

if TYPE_CHECKING:
    from qbxstokes.case.load import LoadedCase
    from qbxstokes.case.time import Time


@dataclass(frozen=True)
class Job:
    """What a task is carried out with: ranks, case, plan and target (rank 0 alone plans), words.

    petsc: the command line that is left for PETSc.
    """

    comm: Any
    loaded: LoadedCase
    plan: Any
    target: Path
    options: argparse.Namespace
    petsc: Sequence[str]
    clock: Clock


def run_case(path: Path, options: argparse.Namespace, petsc: Sequence[str]) -> int:
    """Run one case file on all ranks; returns the exit status."""
    clock = Clock()
    try:
        with clock.part("start MPI"):
            comm = world()
    except ModuleNotFoundError as error:
        print(f"qbxstokes: {missing_message(error)}", file=sys.stderr)
        return 1

    def read() -> LoadedCase:
        from qbxstokes.case.load import load_case

        return load_case(path, options.set)

    return guarded(comm, lambda: compute_case(comm, path, read, options, petsc, clock))


def compute_case(
    comm: Any,
    path: Path,
    read: Callable[[], LoadedCase],
    options: argparse.Namespace,
    petsc: Sequence[str],
    clock: Clock,
) -> int:
    """Compute the case that rank 0 reads; returns the exit status, raises QbxStokesError."""
    with clock.part("import"):
        from qbxstokes.case.load import from_document
        from qbxstokes.runs.target import target_of
        from qbxstokes.runs.tasks import plan_of

    own: list[Any] = []

    def planned() -> Any:
        loaded = read()
        own.extend([loaded, plan_of(loaded)])
        return loaded.document, loaded.space, target_of(loaded, options.overwrite)

    with clock.part("read and plan"):
        document, space, target = on_root(comm, planned)
        # Every rank makes the same of the document.
        loaded, plan = own or (from_document(document, path, space), None)
    job = Job(comm, loaded, plan, target, options, petsc, clock)
    if loaded.case.task == "field":
        from qbxstokes.runs.field_run import run_field_case

        return run_field_case(job)
    if loaded.space is not None:
        from qbxstokes.runs.sweep import sweep_command

        return sweep_command(job)
    if loaded.case.task == "body":
        from qbxstokes.runs.body import run_body_case

        return run_body_case(job)
    return run_motion_case(job)


def run_motion_case(job: Job) -> int:
    """Carry out `task: motion` of a single trajectory; returns the exit status."""
    comm, loaded, plan, options = job.comm, job.loaded, job.plan, job.options
    with job.clock.part("import"):
        from qbxstokes.runs.report import tell_plan
        from qbxstokes.runs.summary import explain, plan_facts, summary_text

    if tell_plan(
        comm,
        loaded,
        options,
        lambda: explain(loaded, plan, job.target),
        lambda: plan_facts(plan, job.target),
    ):
        return 0
    with job.clock.part("import"):
        from qbxstokes.runs.provenance import start_petsc

    PETSc, record = start_petsc(comm, loaded, job.petsc, job.clock)
    with job.clock.part("import"):
        from qbxstokes.io.cache import open_cache
        from qbxstokes.petsc import session
        from qbxstokes.runs.interrupt import Interruption
        from qbxstokes.runs.motion import run_motion
        from qbxstokes.runs.recording import Recording
        from qbxstokes.runs.rows import RowTeam, with_team
        from qbxstokes.simulation.hydrodynamics import Workshop

    # A single trajectory has nothing to share out: rank 0 computes it, so that any number of
    # ranks gives the numbers of one. Only the rows of the operators are formed by all.
    def compute(team: RowTeam) -> dict[str, Any]:
        # Options of the solver want to be seen at work.
        off = options.no_cache or bool(session.solver_options(PETSc))
        workshop = Workshop(team, open_cache(loaded.case.hydrodynamics.cache, off))
        recording = Recording(
            loaded,
            plan,
            session.stepper_options(PETSc),
            options.resume,
            options.overwrite or loaded.case.output.overwrite,
        )
        if recording.finished is not None:
            return {"result": str(recording.finished), "finished_before": True}
        try:
            return run_motion(
                loaded, plan, job.clock, record, recording, interruption, workshop, team
            )
        finally:
            recording.close()

    def help_with_field(*arguments: Any) -> None:
        from qbxstokes.runs import field

        field.help_with_field(comm, loaded, job.clock, *arguments)

    services = {"field": help_with_field}
    with Interruption(patient=comm.rank != 0) as interruption:
        summary = on_root(comm, with_team(comm, compute, services))
    speak = comm.rank == 0 and not (options.quiet or options.json)
    if "finished_before" in summary:
        if comm.rank == 0 and options.json:
            print(json.dumps(summary, indent=2))
        elif speak:
            print(f"{summary['result']}: finished already, nothing to resume")
        return 0
    if comm.rank == 0:
        for problem in summary["cache_problems"]:
            print(f"qbxstokes: cache: {problem}", file=sys.stderr)
        summary["unused_petsc_options"] = session.unused_options(PETSc)
        if options.json:
            from qbxstokes.case.document import plain

            print(json.dumps(plain(summary), indent=2))
        elif speak:
            print(summary_text(loaded, plan, summary))
        tell_of_rounding(loaded.case.time, summary["integration"]["reachable_error"])
        if "ended_by" in summary["events"]:
            because = summary["events"]["ended_because"]
            print(f"qbxstokes: ended at t = {summary['end']:.6g}: {because}", file=sys.stderr)
        for name in summary["unused_petsc_options"]:
            print(f"qbxstokes: PETSc option -{name} was not used by anything", file=sys.stderr)
    limit = loaded.case.compare.tolerance
    if limit is not None and not summary["largest_error"] <= limit:
        if comm.rank == 0:
            print(
                f"qbxstokes: largest error {summary['largest_error']:.1e} exceeds "
                f"compare.tolerance {limit:g}",
                file=sys.stderr,
            )
        return ConvergenceError.exit_status
    return 0


def tell_of_rounding(time: Time | None, reachable: float) -> None:
    """Say where the tolerance asked for is finer than rounding leaves any result."""
    if time is not None and reachable > 3.0 * time.tolerance:
        print(
            f"qbxstokes: time.tolerance {time.tolerance:g} is out of reach: rounding alone leaves "
            f"an error of about {reachable:.0e} at the end",
            file=sys.stderr,
        )
