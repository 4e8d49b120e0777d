"""Run a case from its file to its result: read, plan, compute, compare, write, tell."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from qbxstokes import folders
from qbxstokes.errors import ConvergenceError, QbxStokesError
from qbxstokes.runs.parallel import Interruption, guarded, missing_message, on_root, say, world
from qbxstokes.runs.progress import Clock, compilation_told

if TYPE_CHECKING:
    from qbxstokes.case.load import LoadedCase
    from qbxstokes.quantity import Quantity


@dataclass
class Job:
    """What a task is carried out with: ranks, case, plan and target, words.

    plan: of rank 0; of several bodies that of every rank, None on one that could not make it.
    petsc: the command line that is left for PETSc. PETSc and provenance: see `start`.
    """

    comm: Any
    loaded: LoadedCase
    plan: Any
    target: Path
    options: argparse.Namespace
    petsc: Sequence[str]
    clock: Clock
    interruption: Interruption
    PETSc: Any = None
    provenance: dict[str, Any] = field(default_factory=dict)

    @property
    def overwrite(self) -> bool:
        """Whether a result that is there is replaced."""
        return bool(self.options.overwrite or self.loaded.case.output.overwrite)

    def start(self) -> None:
        """Start PETSc by all ranks; `provenance` is what a result says of how it was made."""
        with self.clock.part("import"):
            from qbxstokes.runs.destination import asked_revision, provenance
        loaded, told = self.loaded, self.comm.rank == 0
        with self.clock.part("start PETSc"):
            from qbxstokes.petsc import session

            revision = asked_revision() if told else str  # git is asked meanwhile
            # Options that are swept hold for one trajectory at a time.
            swept = [c.key[1:] for _, c in loaded.space.columns] if loaded.space else []
            given = {k: value for k, value in loaded.case.petsc.items() if (k,) not in swept}
            self.PETSc = session.start(self.petsc, given)
        with self.clock.part("import"):
            record = self.PETSc, self.comm.size, self.petsc, revision
            self.provenance = provenance(loaded, *record) if told else {}
        self.interruption.take()

    def tells_plan(self, planned: Callable[[], tuple[dict[str, Any], str]]) -> bool:
        """Tell what is to be done, as data or text, where that is asked for; whether that is all.

        planned: says both, on rank 0.
        """
        options = self.options
        if options.dry_run or (options.explain and not options.json):
            facts, text = on_root(self.comm, planned)
            self.tell(facts, lambda: text)
        return bool(options.dry_run)

    def tell(self, data: Mapping[str, Any], text: Callable[[], str]) -> None:
        """Print data where JSON is asked for, else the text where any is, on rank 0."""
        if self.comm.rank == 0 and self.options.json:
            from qbxstokes.case.document import plain

            say(json.dumps(plain(data), indent=2))
        elif self.comm.rank == 0 and not self.options.quiet:
            say(text())

    def heading(self, complete: bool = True) -> dict[str, Any]:
        """What every summary begins with. complete: whether the result is what was asked for."""
        case = self.loaded.case
        told = {"case": str(self.loaded.path), "title": case.title, "task": case.task}
        return {**told, "complete": complete}

    def write(
        self, found: Mapping[str, Any], arrays: Mapping[str, Any], about: Mapping[str, Quantity]
    ) -> dict[str, Any]:
        """Write the result of a task that ends at once, whole arrays; returns the summary.

        found: what the summary says besides. about: what the arrays are.
        """
        from qbxstokes.io.writer import ResultWriter

        summary = {**self.heading(), **found, "skipped": list(self.plan.skips)}
        task, record = self.loaded.case.task, self.provenance
        with (
            self.clock.part("output"),
            ResultWriter(self.target, task, record, self.overwrite) as writer,
        ):
            writer.put(arrays, about)
            summary["wall_times"] = dict(self.clock.parts)
            summary["result"] = str(writer.finish(summary))
        return summary

    def conclude(self, summary: dict[str, Any], text: Callable[[], str]) -> None:
        """Tell the summary of rank 0, now with the times and the options that nothing has used."""
        if self.comm.rank == 0:
            from qbxstokes.petsc.session import unused_options

            summary["wall_times"] = {**self.clock.parts, "total": self.clock.total}
            summary["unused_petsc_options"] = unused_options(self.PETSc)
            self.tell(summary, text)
            from qbxstokes.io.names import older_pictures

            if old := older_pictures(self.target):
                names = ", ".join(map(str, old[:4])) + (" ..." if len(old) > 4 else "")
                print(f"qbxstokes: {names}: drawn before this result", file=sys.stderr)


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
    with Interruption() as interruption:
        with clock.part("import"):
            from qbxstokes.case.load import from_document
            from qbxstokes.runs.destination import target_of
            from qbxstokes.runs.plan import plan_of
        own: list[Any] = []

        def opened() -> Any:
            own.append(read())
            return own[0].document, own[0].space

        def planned() -> Path:
            own.append(plan_of(loaded))
            return target_of(loaded, options.overwrite)

        with clock.part("read and plan"):
            document, space = on_root(comm, opened)
            # Every rank makes the same of the document.
            loaded = own[0] if own else from_document(document, path, space)
        with compilation_told(comm, loaded.case.coupled and not options.quiet):
            with clock.part("read and plan"):
                plan = None
                if comm.rank and loaded.case.coupled and loaded.space is None:
                    with suppress(QbxStokesError):  # what is wrong rank 0 finds, too, and tells
                        plan = plan_of(loaded)
                target = on_root(comm, planned)
                plan = own[1] if own else plan
            job = Job(comm, loaded, plan, target, options, petsc, clock, interruption)
            return carry_out(job)


def carry_out(job: Job) -> int:
    """Plan, run and sum up what a case asks for; returns the exit status."""
    loaded, sweep = job.loaded, job.loaded.case.sweep
    name, report = str(loaded.case.task), "summary"
    if loaded.space is not None:
        name = report = "ensemble" if sweep.store == "statistics" else "sweep"
    with job.clock.part("import"):
        told = import_module(f"qbxstokes.runs.{report}")
    job.start()
    if job.tells_plan(lambda: told.planned(job)):
        return 0
    with job.clock.part("import"):
        task = import_module(f"qbxstokes.runs.{name}")
    summary: dict[str, Any] = task.run(job)
    if "finished_before" in summary:
        job.tell(summary, lambda: f"{summary['result']}: finished already, nothing to resume")
        return 0
    job.conclude(summary, lambda: told.summary_text(job, summary))
    limit, error = loaded.case.compare.tolerance, summary.get("largest_error")
    missed = limit is not None and error is not None and not error <= limit  # NaN, too
    if job.comm.rank == 0:
        caches = (*summary.get("cache_problems", ()), *folders.problems)
        remarks = [*(f"cache: {problem}" for problem in caches), *loaded.remarks]
        for name in summary["unused_petsc_options"]:
            remarks.append(f"PETSc option -{name} was not used by anything")
        remarks += told.remarks(job, summary)
        if missed:
            remarks.append(f"largest error {error:.1e} exceeds compare.tolerance {limit:g}")
        for remark in remarks:
            print(f"qbxstokes: {remark}", file=sys.stderr)
    return ConvergenceError.exit_status if missed or summary.get("failed") else 0
