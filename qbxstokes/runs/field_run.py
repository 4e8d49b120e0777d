"""Run `task: field` from its plan to its summary, on all ranks."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from qbxstokes.case.load import LoadedCase
from qbxstokes.errors import ConvergenceError
from qbxstokes.io.store import Work, holds_work, open_work
from qbxstokes.runs.compilation import compilation_told
from qbxstokes.runs.field import FieldPlan, plan_field, run_field
from qbxstokes.runs.gathering import seconds_between
from qbxstokes.runs.identity import finished_result, identity_of
from qbxstokes.runs.parallel import on_root
from qbxstokes.runs.report import (
    Rows,
    counted,
    described_points,
    duration,
    error_text,
    field_errors,
    render,
    tell_plan,
    vector,
)
from qbxstokes.runs.summary import flow_text, shape_text
from qbxstokes.runs.target import result_path

if TYPE_CHECKING:
    from qbxstokes.runs.command import Job


def run_field_case(job: Job) -> int:
    """Compute, write and tell; returns the exit status."""
    comm, loaded, options, clock = job.comm, job.loaded, job.options, job.clock
    # The other ranks plan as rank 0 did, which has found nothing wrong.
    plan = job.plan or plan_field(loaded)

    def facts() -> dict[str, Any]:
        return {"points": plan.points, "needs": list(plan.needs), "output": str(job.target)}

    if tell_plan(comm, loaded, options, lambda: explain_field(loaded, plan, job.target), facts):
        return 0
    from qbxstokes.petsc import session
    from qbxstokes.runs.provenance import start_petsc

    PETSc, record = start_petsc(comm, loaded, job.petsc, clock)
    overwrite = options.overwrite or loaded.case.output.overwrite
    identity = identity_of(loaded, [])
    seconds_between(loaded)
    own: list[Work] = []

    def opened() -> tuple[Any, Path | None]:
        done = None if overwrite or not options.resume else finished_result(loaded, identity)
        if done is None:
            own.append(
                open_work(result_path(loaded), identity, resume=options.resume, overwrite=overwrite)
            )
            own[0].note_run()
        return (own[0].joined(0) if own else None), done

    folder, done = on_root(comm, opened)
    if done is not None:
        if comm.rank == 0 and not options.quiet:
            print(f"{done}: finished already, nothing to resume")
        return 0
    try:
        with compilation_told(comm, not options.quiet):
            folder = own[0] if own else folder.joined(comm.rank)
            summary = run_field(comm, loaded, plan, folder, clock, record, overwrite)
    except BaseException:
        folder.close(remove=not holds_work(folder.folder) and comm.rank == 0)
        raise
    folder.close(remove=comm.rank == 0)
    unused = session.unused_options(PETSc)
    error = comm.bcast(summary.get("largest_error"))
    if comm.rank == 0:
        summary["unused_petsc_options"] = unused
        if options.json:
            from qbxstokes.case.document import plain

            print(json.dumps(plain(summary), indent=2))
        elif not options.quiet:
            print(field_summary(loaded, summary))
        for name in unused:
            print(f"qbxstokes: PETSc option -{name} was not used by anything", file=sys.stderr)
    limit = loaded.case.compare.tolerance
    if limit is not None and not error <= limit:
        if comm.rank == 0:
            text = f"largest error {error:.1e} exceeds compare.tolerance {limit:g}"
            print(f"qbxstokes: {text}", file=sys.stderr)
        return ConvergenceError.exit_status
    return 0


def _scene(loaded: LoadedCase) -> Rows:
    assert loaded.case.field is not None
    yield "body", f"{shape_text(loaded.case)}, {loaded.case.field.body}"
    yield "flow", flow_text(loaded)


def explain_field(loaded: LoadedCase, plan: FieldPlan, target: Path) -> str:
    """What is computed, what is skipped, and where the result goes."""
    return render(
        f"Plan: {loaded.case.title or loaded.case.task}",
        str(loaded.path),
        {
            "Scene": _scene(loaded),
            "Needs": [("", f"- {text}") for text in plan.needs],
            "Skips": [("", f"- {text}") for text in plan.skips],
            "Writes": [("", str(target))],
        },
    )


def field_summary(loaded: LoadedCase, summary: dict[str, Any]) -> str:
    """What was computed, its errors, times, and the files."""
    hydro, points, times = summary["hydrodynamics"], summary["points"], summary["wall_times"]
    vectors = ("velocity", "angular_velocity", "force", "torque")
    scales = summary["scales"]
    spent = ", ".join(f"{name} {duration(t)}" for name, t in times.items() if name != "total")
    files = [("file", summary["result"])] + [("", name) for name in summary["files"]]
    asked = result_path(loaded)
    if Path(summary["result"]) != asked:
        files.append(("", f"({asked} exists and was kept; --overwrite replaces it)"))
    return render(
        loaded.case.title or f"Task {loaded.case.task}",
        str(loaded.path),
        {
            "Scene": _scene(loaded),
            "Solved": [
                (
                    "integral equation",
                    f"{hydro['n_theta']} x {hydro['n_phi']} nodes, "
                    f"{counted(hydro['solves'], 'solve')}, "
                    f"{counted(hydro['iterations'], 'iteration')}, true residual <= "
                    f"{error_text(hydro['true_residual'])}",
                ),
                ("table", f"spheroidal harmonics of degree {hydro['degree_of_table']}"),
                ("points", described_points(points)),
                *((name, vector(summary[name], scales[name])) for name in vectors),
            ],
            "Errors": field_errors(summary["errors"]),
            "Times": [("total", duration(times["total"])), ("parts", spent)],
            "Result": files,
        },
    )
