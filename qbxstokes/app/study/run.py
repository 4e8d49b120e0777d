"""Carry out studies: blocks and figures on all ranks, tables on rank 0; goes on when stopped."""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import shutil
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from signal import SIGINT
from typing import Any

from qbxstokes import __version__
from qbxstokes.app.tabulate import (
    TablesPlan,
    explain_tables,
    failed_rows,
    json_table,
    made_by,
)
from qbxstokes.case.load import LoadedCase
from qbxstokes.errors import CaseError, ConvergenceError, QbxStokesError
from qbxstokes.io.sweep import parts_of
from qbxstokes.io.tables import Table
from qbxstokes.io.writer import ResultWriter
from qbxstokes.runs import handout
from qbxstokes.runs.clock import Clock
from qbxstokes.runs.handout import HandOut
from qbxstokes.runs.interrupt import Interruption, interrupted
from qbxstokes.runs.parallel import agree, on_root
from qbxstokes.runs.progress import Progress
from qbxstokes.runs.report import WIDTH, duration, headline, render, tell_plan

Block = tuple[str, dict[str, Any]]  # study, parameters
_HEAD = "study.json"
_RESOLUTION, _COLOURS = 200.0, 64  # of the pictures for the web: sharp, and below 150 kB
_KINDS = ("pdf", "png")  # for papers, and for pages on the web
_LONGEST = 120  # rows of a table that is printed as well as stored


def run_studies(
    comm: Any,
    loaded: LoadedCase,
    plan: TablesPlan,
    options: argparse.Namespace,
    petsc: Sequence[str],
    clock: Clock,
) -> int:
    """Compute the blocks, make, print and store the tables and figures; returns the exit status."""
    speak = comm.rank == 0 and not (options.quiet or options.json)
    full = loaded.case.study.size == "full"
    blocks: list[Block] = [
        (name, parameters)
        for name, module in plan.makers.items()
        for parameters in import_module(module).blocks(full)
    ]

    def text() -> str:
        return f"{explain_tables(loaded, plan)}\n  {len(blocks)} blocks"

    def facts() -> dict[str, Any]:
        return {"tables": list(plan.makers), "blocks": len(blocks), "output": str(plan.output)}

    if tell_plan(comm, loaded, options, text, facts):
        return 0
    from qbxstokes.runs.provenance import start_petsc

    _, record = start_petsc(comm, loaded, petsc, clock)
    folder = on_root(comm, lambda: _folder(loaded, plan, blocks, options))
    files: dict[str, list[str]] = {}
    try:
        with Interruption(patient=comm.rank != 0):
            failures = _compute(comm, plan, blocks, folder, options, clock)
            if failures:  # tables and figures are of whole studies
                failures.append(f"{folder} keeps the other blocks: --resume computes these again")
                return _ended(comm, failures)
            with clock.part("tables"):
                made = on_root(comm, lambda: _tables(plan, blocks, folder))
            if speak:
                _print(made, loaded)
            if loaded.case.study.figures:
                files = _draw(comm, plan, made, clock)

            def store() -> list[str]:
                return _store(loaded, plan, made, files, options, record, clock)

            failures = on_root(comm, store)
    except KeyboardInterrupt:
        raise interrupted(folder, SIGINT) from None
    if comm.rank == 0:
        shutil.rmtree(folder, ignore_errors=True)
    return _ended(comm, failures)


def _ended(comm: Any, failures: list[str]) -> int:
    """Tell the failures, the same on all ranks; returns the exit status."""
    if comm.rank == 0:
        for failure in failures:
            print(f"qbxstokes: {failure}", file=sys.stderr)
    return ConvergenceError.exit_status if failures else 0


# -- blocks ---------------------------------------------------------------------------------------


def _digest(blocks: list[Block]) -> str:
    text = json.dumps([__version__, blocks], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def _folder(
    loaded: LoadedCase, plan: TablesPlan, blocks: list[Block], options: argparse.Namespace
) -> Path:
    """The folder of finished blocks: that of an interrupted run to go on with, or a new one."""
    folder = parts_of(plan.output)
    head, digest = folder / _HEAD, _digest(blocks)
    overwrite = options.overwrite or loaded.case.output.overwrite
    if head.exists() and not (overwrite and not options.resume):
        if not options.resume:
            raise CaseError(
                f"{plan.output}: an unfinished study is kept in {folder}; go on with --resume, "
                "or begin anew with --overwrite"
            )
        if json.loads(head.read_text())["digest"] != digest:
            raise CaseError(
                f"{folder}: belongs to another study than {loaded.path} as it is now; restore "
                "the case, or begin anew with --overwrite"
            )
        return folder
    shutil.rmtree(folder, ignore_errors=True)
    try:
        folder.mkdir()
        _write(head, {"digest": digest})
    except OSError as error:
        raise CaseError(f"{folder}: cannot be written ({error.strerror})") from None
    return folder


def _write(path: Path, content: Any) -> None:
    """A whole file or none."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    temporary.write_text(json.dumps(content))
    os.replace(temporary, path)


def _part(folder: Path, number: int) -> Path:
    return folder / f"block-{number:05d}.json"


def _compute(
    comm: Any,
    plan: TablesPlan,
    blocks: list[Block],
    folder: Path,
    options: argparse.Namespace,
    clock: Clock,
) -> list[str]:
    """Compute what is not there yet; returns the failures of all ranks."""
    todo = on_root(comm, lambda: [n for n in range(len(blocks)) if not _part(folder, n).exists()])
    todo.reverse()  # the dear ones stand late: done first, they leave no rank alone at the end
    counters = HandOut(comm)
    progress = None
    if comm.rank == 0 and not options.quiet:
        progress = Progress(len(blocks), options.progress, comm.size, "blocks")
    done = len(blocks) - len(todo)
    failures: list[str] = []
    while (place := counters.next(handout.BLOCKS)) < len(todo):
        number = todo[place]
        name, parameters = blocks[number]
        begin = time.perf_counter()
        with clock.part("blocks"):
            try:
                rows = import_module(plan.makers[name]).compute(**parameters)
            except QbxStokesError as error:
                failures.append(f"study {name}, block {parameters}: {error}")
                counters.add(handout.FAILED, 1)
                continue
        content = {"study": name, "rows": rows, "seconds": time.perf_counter() - begin}
        try:
            _write(_part(folder, number), content)
        except OSError as error:
            raise CaseError(f"{folder}: cannot be written ({error.strerror})") from None
        counters.add(handout.DONE, 1)
        if progress is not None:
            progress.update(done + counters.read(handout.DONE), counters.read(handout.FAILED))
    with clock.part("waiting"):
        counters.wait()
    if progress is not None:
        progress.close(done + counters.read(handout.DONE), counters.read(handout.FAILED))
    counters.close()
    return [failure for part in comm.allgather(failures) for failure in part]


# -- tables and figures ---------------------------------------------------------------------------


@dataclass
class _Made:
    """Tables of one study, with the time that its blocks took."""

    name: str
    tables: list[Table]
    seconds: float


def _tables(plan: TablesPlan, blocks: list[Block], folder: Path) -> list[_Made]:
    """The tables of all studies."""
    parts = [json.loads(_part(folder, number).read_text()) for number in range(len(blocks))]
    made = []
    for name, module in plan.makers.items():
        chosen = [part for part in parts if part["study"] == name]
        rows = [row for part in chosen for row in part["rows"]]
        tables: list[Table] = import_module(module).tables(rows)
        made.append(_Made(name, tables, sum(part["seconds"] for part in chosen)))
    return made


def _print(made: Sequence[_Made], loaded: LoadedCase) -> None:
    print(headline(loaded.case.title or "Studies", str(loaded.path)))
    for table in (table for study in made for table in study.tables):
        if len(table) <= _LONGEST:
            print(f"\n{table.to_text(WIDTH)}", flush=True)
        else:
            print(f"\n{table.title}\n{len(table)} rows, in the result", flush=True)


def _draw(comm: Any, plan: TablesPlan, made: Sequence[_Made], clock: Clock) -> dict[str, list[str]]:
    """Draw every figure on whichever rank is free; the files of each study, on every rank."""
    from qbxstokes.plots import style

    tasks = []
    files: dict[str, list[str]] = {}
    for study in made:
        for name, draw in import_module(plan.makers[study.name]).FIGURES.items():
            stem = f"{plan.output.stem}_{name}"
            targets = [plan.output.with_name(f"{stem}.{kind}") for kind in _KINDS]
            files.setdefault(study.name, []).extend(map(str, targets))
            tasks.append((draw, study.tables, targets))
    tasks.reverse()  # as the blocks: the richest figures come last
    failure: QbxStokesError | None = None
    counters = HandOut(comm)
    with clock.part("figures"):
        while failure is None and (number := counters.next(handout.BLOCKS)) < len(tasks):
            draw, tables, targets = tasks[number]
            try:
                with style.styled():
                    figure = draw({table.name: table for table in tables})
                    style.lay_out(figure)
                    for target in targets:
                        style.save(figure, target, _RESOLUTION, _COLOURS)
            except QbxStokesError as error:
                failure = error
                counters.add(handout.BLOCKS, len(tasks))
    with clock.part("waiting"):
        counters.wait()
    counters.close()
    agree(comm, failure)
    return files


def _store(
    loaded: LoadedCase,
    plan: TablesPlan,
    made: Sequence[_Made],
    figures: dict[str, list[str]],
    options: argparse.Namespace,
    record: dict[str, Any],
    clock: Clock,
) -> list[str]:
    """On rank 0: the result, the CSV files and the last words; returns the failed rows."""
    replace = options.overwrite or loaded.case.output.overwrite
    files: list[str] = []
    failures: list[str] = []
    with ResultWriter(plan.output, "study", record, replace) as writer:
        for study in made:
            for table in study.tables:
                table.provenance = {
                    **made_by(record, loaded),
                    "cost of the blocks": f"{study.seconds:.3g} s on one core",
                }
                table.write_hdf5(writer.file)
                if loaded.case.study.csv:
                    stem = plan.output.with_name(f"{plan.output.stem}_{table.name}.csv")
                    files.append(str(table.write_csv(stem)))
                failures += [f"study {reason}" for reason in failed_rows(table)]
            files += figures.get(study.name, [])
        summary: dict[str, Any] = {
            "tables": [table.name for study in made for table in study.tables],
            "failures": failures,
            "files": files,
            "wall_times": {**clock.parts, "total": clock.total},
        }
        result = writer.finish(summary)
    if options.json:
        tables = [json_table(table) for study in made for table in study.tables]
        print(json.dumps({**summary, "result": str(result), "tables": tables}, indent=2))
    elif not options.quiet:
        times = ", ".join(
            f"{name} {duration(value)}" for name, value in summary["wall_times"].items()
        )
        blocks_text = {
            "Times": [("", times)],
            "Result": [("file", str(result)), ("", f"and {len(files)} files beside it")],
        }
        print(f"\n{render('Done' if not failures else 'Done, with failures', '', blocks_text)}")
    return failures
