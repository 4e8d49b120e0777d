"""Tasks that make tables: run their makers, print and store what they give, check the bounds.

A maker is a module with a function `tables(work)` that yields tables; its registry (one dictionary
per task) names it. Beside the registry, `SUMMARY` may name a module with a function
`summary(tables)`, which makes the last table where a run has several. A table may have a column
`passed`: a row where it is false fails the run, and the text of its first columns says which.
"""

from __future__ import annotations

import argparse
import inspect
import json
import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from qbxstokes.case.load import LoadedCase, nearest
from qbxstokes.case.tabulate import Tables
from qbxstokes.errors import CaseError, ConvergenceError, QbxStokesError
from qbxstokes.io.names import check_writable, free_name
from qbxstokes.io.tables import Table
from qbxstokes.io.writer import ResultWriter
from qbxstokes.runs.clock import Clock
from qbxstokes.runs.parallel import on_root
from qbxstokes.runs.report import WIDTH, Rows, duration, headline, render, section, tell_plan
from qbxstokes.runs.target import result_path


@dataclass(frozen=True)
class Work:
    """What a maker is asked for.

    section: that of the task in the case. ranks: number of MPI ranks of this run (a maker runs on
    rank 0). say: a line of progress.
    """

    section: Any
    ranks: int
    say: Callable[[str], None]

    @property
    def full(self) -> bool:
        """Whether the whole extent is asked for."""
        return self.section.size == "full"

    def choose(self, small: Any, full: Any) -> Any:
        """One of two extents."""
        return full if self.full else small


Maker = Callable[[Work], Iterator[Table]]


@dataclass(frozen=True)
class TablesPlan:
    """Makers by name, where the result goes, and the module of a summary ("" for none)."""

    makers: dict[str, str]
    output: Path
    summary: str = ""


def plan_tables(loaded: LoadedCase, overwrite: bool) -> TablesPlan:
    """The makers that the case asks for; raises CaseError for names that are none."""
    task = loaded.case.task
    section: Tables = getattr(loaded.case, task)
    package = import_module(f"qbxstokes.app.{task}")
    known: dict[str, str] = package.MAKERS
    for index, name in enumerate(section.tables or ()):
        if name not in known:
            close = nearest(name, list(known))
            right = f"did you mean {close}?" if close else f"one of {', '.join(known)}"
            raise loaded.error((task, "tables", index), f"{name!r} is not a table", right)
    output = result_path(loaded)
    overwrite = overwrite or loaded.case.output.overwrite
    try:
        check_writable(output, overwrite)
    except CaseError as error:
        raise loaded.error("output.file", str(error)) from None
    if not overwrite:
        output = free_name(output)
    makers = {name: known[name] for name in section.tables or known}
    return TablesPlan(makers, output, getattr(package, "SUMMARY", ""))


def run_tables(
    comm: Any,
    loaded: LoadedCase,
    plan: TablesPlan,
    options: argparse.Namespace,
    petsc: Sequence[str],
    clock: Clock,
) -> int:
    """Make the tables on rank 0, print and store them; returns the exit status."""

    def facts() -> dict[str, Any]:
        return {"tables": list(plan.makers), "output": str(plan.output)}

    if tell_plan(comm, loaded, options, lambda: explain_tables(loaded, plan), facts):
        return 0
    from qbxstokes.runs.provenance import start_petsc

    _, record = start_petsc(comm, loaded, petsc, clock)

    def compute() -> list[str]:
        return _compute(comm.size, loaded, plan, options, record, clock)

    failures = on_root(comm, compute)
    if comm.rank == 0:
        for failure in failures:
            print(f"qbxstokes: {failure}", file=sys.stderr)
    return ConvergenceError.exit_status if failures else 0


def _compute(
    ranks: int,
    loaded: LoadedCase,
    plan: TablesPlan,
    options: argparse.Namespace,
    record: dict[str, Any],
    clock: Clock,
) -> list[str]:
    task = loaded.case.task
    section: Tables = getattr(loaded.case, task)
    speak = not (options.quiet or options.json)

    def say(line: str) -> None:
        if speak and options.progress != "none":
            print(f"  ... {line}", file=sys.stderr, flush=True)

    if speak:
        print(headline(loaded.case.title or f"Task {task}", str(loaded.path)), flush=True)
    made: list[Table] = []
    failures: list[str] = []
    files: list[str] = []
    replace = options.overwrite or loaded.case.output.overwrite
    with ResultWriter(plan.output, task, record, replace) as writer:

        def keep(table: Table) -> None:
            if speak:  # the provenance, the same for all, comes at the end
                print(f"\n{table.to_text(WIDTH)}", flush=True)
            table.provenance = made_by(record, loaded)
            made.append(table)
            table.write_hdf5(writer.file)
            files.extend(_beside(plan.output, section, table))

        for name, module in plan.makers.items():
            with clock.part(name):
                maker: Maker = import_module(module).tables
                try:
                    for table in maker(Work(section, ranks, say)):
                        keep(table)
                        failures += [f"{task} {reason}" for reason in failed_rows(table)]
                except QbxStokesError as error:
                    failures.append(f"{task} {name}: {error}")
                except Exception as error:  # the other tables are still wanted
                    print(traceback.format_exc(), file=sys.stderr, flush=True)
                    failures.append(f"{task} {name}: {type(error).__name__}: {error}")
        if plan.summary and len(made) > 1:
            keep(import_module(plan.summary).summary(made))
        summary: dict[str, Any] = {
            "tables": [table.name for table in made],
            "failures": failures,
            "files": files,
        }
        summary["wall_times"] = {**clock.parts, "total": clock.total}
        result = writer.finish(summary)
    if options.json:
        tables = [json_table(table) for table in made]
        print(json.dumps({**summary, "result": str(result), "tables": tables}, indent=2))
    elif speak:
        print(f"\n{_closing(summary, result, made_by(record, loaded))}")
    return failures


def _beside(result: Path, section: Tables, table: Table) -> list[str]:
    """Write the CSV file and the figure of a table beside the result; their names."""
    stem = result.with_name(f"{result.stem}_{table.name}")
    files = []
    if section.csv:
        files.append(str(table.write_csv(stem.with_suffix(".csv"))))
    if section.figures and table.plot:
        from qbxstokes.plots import style
        from qbxstokes.plots.table import figure_of

        with style.styled():
            files.append(str(style.save(figure_of(table), stem.with_suffix(".pdf"))))
    return files


def failed_rows(table: Table) -> Iterator[str]:
    """One line for every row of a table whose bound was exceeded."""
    if "passed" not in table.names:
        return
    shown = [column for column in table.columns if column.name != "passed"]
    for row in table.records():
        if row["passed"] is False:
            texts = (
                f"{' '.join(column.words)} {format(row[column.name], column.format or '')}"
                for column in shown
                if row[column.name] is not None
            )
            yield f"{table.name}: bound exceeded: {', '.join(texts)}"


def made_by(record: dict[str, Any], loaded: LoadedCase) -> dict[str, str]:
    """Provenance of a table: the machine, the command and the version."""
    return {
        "machine": str(record["machine"]),
        "command": f"python -m qbxstokes {loaded.path}",
        "version": " ".join(filter(None, (record["version"], record["git_revision"]))),
    }


def json_table(table: Table) -> dict[str, Any]:
    """A table as plain data."""
    return {
        "name": table.name,
        "title": table.title,
        "columns": [vars(column) for column in table.columns],
        "rows": list(table.records()),
        "notes": table.notes,
    }


def explain_tables(loaded: LoadedCase, plan: TablesPlan) -> str:
    """What will be made, in a line per table."""
    rows = [
        (f"{name} ", (inspect.getdoc(import_module(module)) or "").split("\n\n")[0])
        for name, module in plan.makers.items()
    ]
    blocks: dict[str, Rows] = {"Tables": rows, "Writes": [(f"{plan.output} ", "")]}
    return render(f"Plan: {loaded.case.title or loaded.case.task}", str(loaded.path), blocks)


def _closing(summary: dict[str, Any], result: Path, made: dict[str, str]) -> str:
    times = summary["wall_times"]
    spent = ", ".join(f"{name} {duration(value)}" for name, value in times.items())
    rows = [("file", str(result)), *((f"{name} ", text) for name, text in made.items())]
    if summary["files"]:
        rows.insert(1, ("", f"and {len(summary['files'])} files beside it"))
    return "\n".join([section("Times", [("", spent)]), section("Result", rows)])
