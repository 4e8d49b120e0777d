"""Carry out studies: blocks on all ranks, tables and figures on rank 0; goes on when stopped."""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import shutil
import sys
import time
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from qbxstokes import __version__
from qbxstokes.app import handout
from qbxstokes.app.clock import Clock
from qbxstokes.app.handout import HandOut
from qbxstokes.app.parallel import on_root
from qbxstokes.app.progress import Progress
from qbxstokes.app.report import WIDTH, duration, headline, render
from qbxstokes.app.tabulate import (
    TablesPlan,
    explain_tables,
    failed_rows,
    json_table,
    made_by,
)
from qbxstokes.config.load import LoadedCase
from qbxstokes.errors import CaseError, ConvergenceError, QbxStokesError
from qbxstokes.io.results import ResultWriter
from qbxstokes.io.sweep import parts_of
from qbxstokes.io.tables import Table

Block = tuple[str, dict[str, Any]]  # study, parameters
_HEAD = "study.json"
_RESOLUTION, _COLOURS = 200.0, 64  # of the pictures for the web: sharp, and below 150 kB
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
    if speak and (options.explain or options.dry_run):
        print(explain_tables(loaded, plan))
        print(f"  {len(blocks)} blocks")
    if options.dry_run:
        if comm.rank == 0 and options.json:
            facts = {
                "tables": list(plan.makers),
                "blocks": len(blocks),
                "output": str(plan.output),
            }
            print(json.dumps({"case": str(loaded.path), "plan": facts}, indent=2))
        return 0
    from qbxstokes.app.provenance import start_petsc

    _, record = start_petsc(comm, loaded, petsc, clock)
    folder = on_root(comm, lambda: _folder(loaded, plan, blocks, options))
    errors = _compute(comm, plan, blocks, folder, options, clock)

    def finish() -> list[str]:
        return _finish(loaded, plan, blocks, folder, errors, options, record, clock)

    failures = on_root(comm, finish)
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


def _finish(
    loaded: LoadedCase,
    plan: TablesPlan,
    blocks: list[Block],
    folder: Path,
    failures: list[str],
    options: argparse.Namespace,
    record: dict[str, Any],
    clock: Clock,
) -> list[str]:
    """On rank 0: everything that is made of the rows. Failed blocks leave the folder for later."""
    section = loaded.case.study
    speak = not (options.quiet or options.json)
    replace = options.overwrite or loaded.case.output.overwrite
    parts = [
        json.loads(path.read_text())
        for path in (_part(folder, number) for number in range(len(blocks)))
        if path.exists()
    ]
    if speak:
        print(headline(loaded.case.title or "Studies", str(loaded.path)))
    files: list[str] = []
    made: list[Table] = []
    with ResultWriter(plan.output, "study", record, replace) as writer:
        for name, module in plan.makers.items():
            study = import_module(module)
            chosen = [part for part in parts if part["study"] == name]
            spent = sum(part["seconds"] for part in chosen)
            rows = [row for part in chosen for row in part["rows"]]
            tables: list[Table] = study.tables(rows)
            for table in tables:
                table.provenance = {
                    **made_by(record, loaded),
                    "cost of the blocks": f"{spent:.3g} s on one core",
                }
                table.write_hdf5(writer.file)
                if section.csv:
                    stem = plan.output.with_name(f"{plan.output.stem}_{table.name}.csv")
                    files.append(str(table.write_csv(stem)))
                failures = failures + [f"study {reason}" for reason in failed_rows(table)]
                if speak and len(table) <= _LONGEST:
                    print(f"\n{table.to_text(WIDTH)}", flush=True)
                elif speak:
                    print(f"\n{table.title}\n{len(table)} rows, in the result", flush=True)
            made += tables
            if section.figures:
                files += _draw(study, {table.name: table for table in tables}, plan.output)
        summary: dict[str, Any] = {
            "tables": [table.name for table in made],
            "failures": failures,
            "files": files,
            "wall_times": {**clock.parts, "total": clock.total},
        }
        result = writer.finish(summary)
    if all(_part(folder, number).exists() for number in range(len(blocks))):
        shutil.rmtree(folder, ignore_errors=True)
    if options.json:
        facts = {**summary, "result": str(result), "tables": [json_table(t) for t in made]}
        print(json.dumps(facts, indent=2))
    elif speak:
        times = ", ".join(
            f"{name} {duration(value)}" for name, value in summary["wall_times"].items()
        )
        blocks_text = {
            "Times": [("", times)],
            "Result": [("file", str(result)), ("", f"and {len(files)} files beside it")],
        }
        print(f"\n{render('Done' if not failures else 'Done, with failures', '', blocks_text)}")
    return failures


def _draw(study: Any, tables: dict[str, Table], output: Path) -> list[str]:
    from qbxstokes.plots import style

    files = []
    with style.styled():
        for name, figure in study.figures(tables).items():
            for kind in ("pdf", "png"):  # for papers, and for pages on the web
                target = output.with_name(f"{output.stem}_{name}.{kind}")
                files.append(str(style.save(figure, target, _RESOLUTION, _COLOURS)))
    return files
