"""Run a case from its file to its result: read, plan, compute, compare, write, tell."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from qbxstokes.errors import ConvergenceError
from qbxstokes.runs.clock import Clock
from qbxstokes.runs.parallel import guarded, missing_message, on_root, world

if TYPE_CHECKING:
    from qbxstokes.case.load import LoadedCase
    from qbxstokes.case.time import Time


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
        from qbxstokes.runs.report import tell_plan
        from qbxstokes.runs.summary import explain, plan_facts, summary_text
        from qbxstokes.runs.tasks import plan_of

    def planned() -> Any:
        loaded = read()
        return loaded.document, loaded.space, plan_of(loaded, options.overwrite)

    with clock.part("read and plan"):
        document, space, plan = on_root(comm, planned)
        loaded = from_document(document, path, space)
    if loaded.case.task == "field":
        from qbxstokes.runs.field_run import run_field_case

        return run_field_case(comm, loaded, plan, options, petsc, clock)
    if loaded.case.task == "study":
        from qbxstokes.app.study.run import run_studies

        return run_studies(comm, loaded, plan, options, petsc, clock)
    if loaded.case.task != "motion":
        from qbxstokes.app.tabulate import run_tables

        return run_tables(comm, loaded, plan, options, petsc, clock)
    speak = comm.rank == 0 and not (options.quiet or options.json)
    if loaded.space is not None:
        from qbxstokes.runs.sweep import sweep_command

        return sweep_command(comm, loaded, options, petsc, clock)
    if tell_plan(comm, loaded, options, lambda: explain(loaded, plan), lambda: plan_facts(plan)):
        return 0
    with clock.part("import"):
        from qbxstokes.runs.provenance import start_petsc

    PETSc, record = start_petsc(comm, loaded, petsc, clock)
    with clock.part("import"):
        from qbxstokes.petsc import session
        from qbxstokes.runs.interrupt import Interruption
        from qbxstokes.runs.motion import run_motion
        from qbxstokes.runs.recording import Recording
        from qbxstokes.runs.rows import RowTeam, with_team
        from qbxstokes.simulation.hydrodynamics import open_cache

    # A single trajectory has nothing to share out: rank 0 computes it, so that any number of
    # ranks gives the numbers of one. Only the rows of the operators are formed by all.
    def compute(team: RowTeam) -> dict[str, Any]:
        # Options of the solver want to be seen at work.
        cache = open_cache(loaded, options.no_cache or bool(session.solver_options(PETSc)))
        recording = Recording(
            loaded,
            plan,
            session.stepper_options(PETSc),
            options.resume,
            options.overwrite or loaded.case.output.overwrite,
        )
        if recording.finished is not None:
            return {"result": str(recording.finished), "finished_before": True}
        return run_motion(loaded, plan, clock, record, recording, interruption, team, cache)

    def help_with_field(*arguments: Any) -> None:
        from qbxstokes.runs import field

        field.help_with_field(comm, loaded, clock, *arguments)

    services = {"field": help_with_field}
    with Interruption(patient=comm.rank != 0) as interruption:
        summary = on_root(comm, with_team(comm, compute, services))
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
            from qbxstokes.runs.report import plain

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
