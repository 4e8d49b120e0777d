"""A sweep on any number of ranks: models, blocks handed out as ranks become free, one result file.

Every rank runs the same loop: take the number of the next block, compute it, write its rows, note
it in the rank's journal. What a block holds does not depend on who computes it, and neither do its
numbers.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import shutil
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from qbxstokes.case.document import plain
from qbxstokes.case.load import LoadedCase
from qbxstokes.case.sweep import column_name
from qbxstokes.errors import CaseError, ConvergenceError, QbxStokesError
from qbxstokes.io import sweep as store
from qbxstokes.io.cache import SharedCache
from qbxstokes.io.names import check_writable, numbered
from qbxstokes.quantities import COLUMNS, MOTION, PARAMETER, STATUS, Quantity
from qbxstokes.runs import block, handout
from qbxstokes.runs.clock import Clock
from qbxstokes.runs.compilation import compilation_told
from qbxstokes.runs.handout import HandOut
from qbxstokes.runs.interrupt import Interruption, interrupted
from qbxstokes.runs.parallel import on_root
from qbxstokes.runs.progress import Progress
from qbxstokes.runs.scenes import Scenes
from qbxstokes.runs.target import result_path
from qbxstokes.simulation.body import Body
from qbxstokes.simulation.from_case import body_of, pointed, simulation_of
from qbxstokes.simulation.hydrodynamics import Workshop
from qbxstokes.simulation.simulation import Simulation

if TYPE_CHECKING:
    from qbxstokes.runs.command import Job

Array = NDArray[Any]

_COORDINATE_PIECE = 65_536
_PATIENCE = 1.0  # seconds between what is said of the bodies


@dataclass
class Work:
    """What this run has to do: blocks by number, those of them that only mend failures, totals."""

    folder: Path
    target: Path
    blocks: list[int]
    mend: dict[int, list[int]]
    done: int
    run: int
    complete: bool = False


def sweep_command(job: Job) -> int:
    """Carry out a case with a section `sweep`; returns the exit status."""
    comm, loaded, options, clock = job.comm, job.loaded, job.options, job.clock
    speak = comm.rank == 0 and not (options.quiet or options.json)
    if options.dry_run or options.explain:
        facts = on_root(comm, lambda: _dry_run(loaded, comm.size))
        if comm.rank == 0 and options.json:
            print(json.dumps(plain(facts), indent=2))
        elif speak:
            print(facts["text"])
        if options.dry_run:
            return 0
    from qbxstokes.petsc import session
    from qbxstokes.runs.provenance import start_petsc

    PETSc, record = start_petsc(comm, loaded, job.petsc, clock)
    summary = run_sweep(comm, loaded, options, record, clock)
    if comm.rank == 0:
        summary["wall_times"] = {**clock.parts, "total": clock.total}
        summary["unused_petsc_options"] = session.unused_options(PETSc)
        if options.json:
            print(json.dumps(plain(summary), indent=2))
        elif speak and summary["complete"]:
            print(f"{summary['result']}: complete, nothing to resume")
        elif speak:
            from qbxstokes.runs.sweep_report import summary_text

            print(summary_text(Scenes(loaded), summary))
        for name in summary["unused_petsc_options"]:
            print(f"qbxstokes: PETSc option -{name} was not used by anything", file=sys.stderr)
        tell_failures(summary)
    return ConvergenceError.exit_status if summary["failed"] else 0


def _dry_run(loaded: LoadedCase, ranks: int) -> dict[str, Any]:
    """What would run, as data and as text."""
    from qbxstokes.runs.cost import estimate
    from qbxstokes.runs.sweep_report import plan_text

    scenes = Scenes(loaded)
    layout = layout_of(scenes)
    cost = estimate(scenes, layout.row_bytes)
    return {
        "trajectories": scenes.space.size,
        "shape": scenes.space.shape,
        "scenes": scenes.size,
        "blocks": scenes.blocks,
        "operators": len(scenes.bodies[1]),
        "bytes_on_disk": layout.bytes,
        "memory_per_rank": cost.memory,
        "skips": list(scenes.skips),
        "seconds": {str(p): cost.seconds(p) for p in sorted({1, ranks, 1000, 10_000})},
        "text": plan_text(scenes, layout, cost, result_path(loaded), ranks),
    }


def run_sweep(
    comm: Any,
    loaded: LoadedCase,
    options: argparse.Namespace,
    provenance: dict[str, Any],
    clock: Clock,
) -> dict[str, Any]:
    """Compute the sweep on all ranks and return its summary (on every rank)."""
    scenes = Scenes(loaded)
    layout = layout_of(scenes)
    digest = digest_of(loaded, scenes)
    made = provenance | {"digest": digest, "shape": list(scenes.space.shape)}
    with clock.part("output"):
        work = on_root(comm, lambda: _prepare(scenes, layout, digest, options, made))
    if work.complete:
        return {"result": str(work.target), "complete": True, "failed": 0}
    if work.run > 1:
        with clock.part("output"):
            _verify(comm, scenes, layout, work)
    counters = HandOut(comm)
    speak = comm.rank == 0 and not options.quiet and options.progress != "none"
    with clock.part("models"):
        models = _models(comm, scenes, work, counters, options.no_cache, speak)
    progress = None
    if comm.rank == 0 and not options.quiet:
        progress = Progress(scenes.space.size, options.progress, comm.size)
    begin = time.perf_counter()
    try:
        with Interruption() as interruption, compilation_told(comm, speak):
            interruption.listening = True
            team = Team(comm, counters, progress, interruption, work)
            _blocks(team, scenes, layout, work, models, clock)
    except OSError as error:
        raise store.full_disk(work.target, error) from None
    except KeyboardInterrupt:
        raise interrupted(work.folder, 2) from None
    with clock.part("waiting"):
        counters.wait()
    failed = counters.read(handout.FAILED)
    if progress is not None:
        progress.close(work.done + counters.read(handout.DONE), failed)
    counters.wait()
    counters.close()
    elapsed = time.perf_counter() - begin

    def finish() -> dict[str, Any]:
        return _finish(scenes, layout, work, elapsed, comm.size)

    with clock.part("output"):
        return on_root(comm, finish)


def layout_of(scenes: Scenes) -> store.Layout:
    """What the result file holds."""
    case = scenes.loaded.case
    assert case.sweep is not None
    coordinates = _coordinate_types(scenes)
    columns: list[tuple[str, Any]] = [*coordinates.items()]
    columns += [("status", "i1"), *((name, "f8") for name in COLUMNS)]
    columns += [("reason", f"S{store.REASON_LENGTH}")]
    quantities = scenes.scene(0).plan.quantities if case.sweep.store == "samples" else ()
    swept = {
        name: PARAMETER.get(name) or Quantity(name, "", "", f"swept value {name}")
        for name in coordinates
    }
    return store.Layout(
        scenes.space.size,
        scenes.samples,
        np.dtype(columns),
        quantities,
        scenes.common_times,
        tuple(coordinates),
        {**swept, **STATUS, **COLUMNS},
    )


def _coordinate_types(scenes: Scenes) -> dict[str, Any]:
    """Columns of the swept values and their types; vectors one column per component."""
    types: dict[str, Any] = {}
    for _, column in scenes.space.columns:
        name = column_name(column.key)
        sample = column.take(np.arange(min(column.size, 1)))
        if not column.numeric:
            assert column.values is not None
            words = [_word(value) for value in column.values.tolist()]
            types[name] = f"S{max(1, *(len(word) for word in words))}"
        elif sample.ndim == 1:
            types[name] = "f8"
        else:
            first = 0 if sample.shape[1] == 4 else 1
            types |= {f"{name}_{i + first}": "f8" for i in range(sample.shape[1])}
    return types


def _word(value: Any) -> bytes:
    text = value if isinstance(value, str) else json.dumps(value)
    return text.encode("ascii", "backslashreplace")


def coordinates_of(scenes: Scenes, index: Array) -> dict[str, Array]:
    """Swept values of some trajectories as columns."""
    columns: dict[str, Array] = {}
    by_key = {column.key: column for _, column in scenes.space.columns}
    for key, values in scenes.space.values(index).items():
        name = column_name(key)
        if not by_key[key].numeric:
            columns[name] = np.array([_word(value) for value in values.tolist()])
        elif values.ndim == 1:
            columns[name] = values
        else:
            first = 0 if values.shape[1] == 4 else 1
            columns |= {f"{name}_{i + first}": values[:, i] for i in range(values.shape[1])}
    return columns


def digest_of(loaded: LoadedCase, scenes: Scenes) -> str:
    """What a sweep has in common with the one that it may go on with."""
    resolved = loaded.resolved()
    for name in ("output", "title"):
        resolved.pop(name, None)
    tables = hashlib.sha256()
    for _, column in scenes.space.columns:
        if column.values is not None:
            tables.update(repr(column.values.tolist()).encode())
    text = json.dumps([resolved, tables.hexdigest(), scenes.block_size, scenes.blocks])
    return hashlib.sha256(text.encode()).hexdigest()


def _prepare(
    scenes: Scenes,
    layout: store.Layout,
    digest: str,
    options: argparse.Namespace,
    provenance: dict[str, Any],
) -> Work:
    """On rank 0: a new file laid out, or an earlier one to go on with."""
    asked = result_path(scenes.loaded)
    check_writable(asked)
    overwrite = options.overwrite or scenes.loaded.case.output.overwrite
    everything = list(range(scenes.blocks))
    if options.resume:
        found = store.unfinished(islice(numbered(asked), 1000))
        if found is not None:
            if store.digest_in(store.parts_of(found)) != digest:
                raise CaseError(
                    f"{store.parts_of(found)}: belongs to another sweep than {scenes.loaded.path} "
                    "as it is now; restore the case, or begin anew with --overwrite"
                )
            return _resumed(store.parts_of(found), found, everything)
        if asked.exists():
            return _reopened(scenes, layout, digest, asked, everything)
    target = asked
    if overwrite:
        shutil.rmtree(store.parts_of(asked), ignore_errors=True)
    else:
        target = next(name for name in numbered(asked) if not name.exists())
        if (store.parts_of(target) / store.LAYOUT).exists():
            raise CaseError(
                f"{target}: an unfinished sweep is kept in {store.parts_of(target)}; go on with "
                "--resume, or begin anew with --overwrite"
            )
        shutil.rmtree(store.parts_of(target), ignore_errors=True)
    folder = store.create(target, layout, digest, provenance, _coordinates(scenes, layout))
    return Work(folder, target, everything, {}, 0, 1)


def _coordinates(scenes: Scenes, layout: store.Layout) -> Iterator[tuple[int, dict[str, Array]]]:
    """The scales of the file in pieces."""
    for first in range(0, layout.size, _COORDINATE_PIECE):
        index = np.arange(first, min(first + _COORDINATE_PIECE, layout.size))
        columns = coordinates_of(scenes, index)
        yield (
            first,
            {
                "trajectory": index,
                **{name: values.astype(layout.dtype[name]) for name, values in columns.items()},
            },
        )
    if layout.quantities and layout.times is not None:
        yield 0, {"time": layout.times}
    elif layout.quantities:
        yield 0, {"sample": np.arange(layout.samples)}


def _resumed(folder: Path, target: Path, everything: list[int]) -> Work:
    """What the journals of an earlier run leave to do."""
    store.check_data(folder)
    found = store.read_journals(folder)
    todo = [number for number in everything if number not in found.blocks]
    mend = {number: sorted(failed) for number, failed in found.failed.items() if failed}
    return Work(folder, target, todo, mend, 0, found.run + 1)


def _reopened(
    scenes: Scenes, layout: store.Layout, digest: str, path: Path, everything: list[int]
) -> Work:
    """What a finished file with failures leaves to do; it stays until a better one is complete."""
    offsets, made_by = store.offsets_of(path)
    if made_by != digest:
        raise CaseError(
            f"{path}: is the result of another sweep than {scenes.loaded.path} as it is now; "
            "begin anew with --overwrite, or change output.file"
        )
    entries = []
    with store.WholeFile(path, offsets, layout, writable=False) as whole:
        for number in everything:
            index = scenes.block(number).index
            table = whole.read_table(index)
            lost = table["status"] != store.DONE
            entries.append(
                {
                    "run": 1,
                    "block": number,
                    "checksum": whole.checksum(index),
                    "failed": {
                        int(i): reason.decode()
                        for i, reason in zip(index[lost], table["reason"][lost], strict=True)
                    },
                    "totals": {},
                }
            )
    if not any(entry["failed"] for entry in entries):
        return Work(store.parts_of(path), path, [], {}, layout.size, 1, complete=True)
    folder = store.reopen(path, digest, offsets, entries)
    return _resumed(folder, path, everything)


def _verify(comm: Any, scenes: Scenes, layout: store.Layout, work: Work) -> None:
    """Compute again what is in the journals but not on the disk; counts what is done."""
    found = store.read_journals(work.folder)
    todo = set(work.blocks)
    bad: list[int] = []
    done = 0
    whole = store.open_layout(work.folder, layout)
    with whole:
        for number in range(comm.rank, scenes.blocks, comm.size):
            if number in todo:
                continue
            index = scenes.block(number).index
            if whole.checksum(index) != found.blocks[number]:
                bad.append(number)
            else:
                done += len(index) - len(work.mend.get(number, ()))
    for numbers, count in comm.allgather((bad, done)):
        work.blocks += numbers
        work.done += count
    for number in work.blocks:
        work.mend.pop(number, None)
    work.blocks.sort()


@dataclass
class Models:
    """The bodies of the sweep: what their operators give, and which could not be formed."""

    cache: SharedCache
    errors: dict[int, QbxStokesError]


def _models(
    comm: Any, scenes: Scenes, work: Work, counters: HandOut, no_cache: bool, speak: bool
) -> Models:
    """Form the bodies that this run needs, each by whichever rank is free, known to all.

    speak: whether to say on standard error how far it is, where it takes more than a moment. A
    body that cannot be formed is noted with the error, which its trajectories then report.
    """
    from qbxstokes.io.cache import open_cache
    from qbxstokes.petsc import session

    body, representatives = scenes.bodies
    needed = sorted(
        {int(body[s]) for number in [*work.blocks, *work.mend] for s in scenes.scenes_of(number)}
    )
    # Options of the solver want to be seen at work.
    no_cache = no_cache or bool(session.solver_options(session.start()))
    named = scenes.loaded.case.hydrodynamics.cache
    models = Models(SharedCache(open_cache(named, no_cache).folder), {})
    told = time.monotonic()
    while (place := counters.next(handout.MODELS)) < len(needed):
        number = needed[place]
        if speak and time.monotonic() > told + _PATIENCE:
            told = time.monotonic()
            text = f"qbxstokes: forming bodies, {place + 1} of {len(needed)}"
            print(text, file=sys.stderr, flush=True)
        try:
            scene = scenes.scene(representatives[number])
            with pointed(scene.loaded):
                simulation, workshop = scene.plan.simulation, Workshop(cache=models.cache)
                need = simulation.need(scenes.pushed)
                simulation.body.hydrodynamics_in(simulation.flow, need, workshop)
        except QbxStokesError as error:
            models.errors[number] = error
    counters.wait()
    for entries, errors in comm.allgather((models.cache.entries, models.errors)):
        models.cache.receive(entries)
        models.errors.update(errors)
    return models


@dataclass
class Team:
    """What a rank shares with the others while it computes."""

    comm: Any
    counters: HandOut
    progress: Progress | None
    interruption: Interruption
    work: Work

    def poke(self) -> bool:
        """Between steps: serve MPI, tell the progress, heed signals (raises Interrupted)."""
        if self.interruption.asked():
            raise interrupted(self.work.folder, self.interruption.signal)
        if self.progress is None or not self.progress.due:
            self.counters.poke()
        else:
            done = self.work.done + self.counters.read(handout.DONE)
            self.progress.update(done, self.counters.read(handout.FAILED))
        return False


def _blocks(
    team: Team,
    scenes: Scenes,
    layout: store.Layout,
    work: Work,
    models: Models,
    clock: Clock,
) -> None:
    """Compute blocks until none is left."""
    order, counters = _order(scenes, work), team.counters
    whole = store.open_layout(work.folder, layout)
    journal = store.Journal(work.folder, team.comm.rank)
    computer = _Computer(scenes, layout, models, team.poke)
    with whole:
        while (place := counters.next(handout.BLOCKS)) < len(order):
            number = order[place]
            with clock.part("blocks"):
                index, rows, entry = computer.compute(number, work.mend.get(number))
            with clock.part("output"):
                checksum = whole.write_rows(index, rows)
                block = scenes.block(number).index
                if len(index) < len(block):
                    checksum = whole.checksum(block)
                entry |= {"block": number, "checksum": checksum, "run": work.run}
                journal.record(entry)
            counters.add(handout.FAILED, len(entry["failed"]))
            counters.add(handout.DONE, len(index) - len(entry["failed"]))
            team.poke()
    journal.close()


def _order(scenes: Scenes, work: Work) -> list[int]:
    """Blocks in the order of handing out: the costliest first, so that ranks end together."""
    from qbxstokes.runs.cost import block_seconds

    numbers = sorted({*work.blocks, *work.mend})
    cost = block_seconds(scenes)[numbers]
    return [numbers[i] for i in np.argsort(-cost, kind="stable")]


class _Computer:
    """Computes blocks, keeping the bodies at hand from one to the next."""

    def __init__(self, scenes: Scenes, layout: store.Layout, models: Models, poke: Any) -> None:
        self._scenes, self._layout, self._models, self._poke = scenes, layout, models, poke
        self._workshop = Workshop(cache=models.cache)
        self._body, _ = scenes.bodies
        self._bodies: dict[int, Body] = {}

    def compute(
        self, number: int, only: list[int] | None
    ) -> tuple[Array, dict[str, Array], dict[str, Any]]:
        """Trajectory numbers, rows of the file, and the journal's entry."""
        scenes, layout = self._scenes, self._layout
        sweep = scenes.loaded.case.sweep
        assert sweep is not None
        pieces = scenes.block(number).pieces
        simulations: list[Simulation] = []
        sound: list[Array] = []
        lost: dict[int, str] = {}
        times = np.full(layout.samples, np.nan)
        for scene, members in pieces:
            chosen = members if only is None else members[np.isin(members, only)]
            if not len(chosen):
                continue
            try:
                simulations.append(self._simulation(scene, chosen))
                sound.append(chosen)
                times = scenes.scene(scene).plan.times
            except QbxStokesError as error:
                lost |= dict.fromkeys(chosen.tolist(), " ".join(str(error).split()))
        index = np.concatenate([*sound, np.array(list(lost), dtype=np.int64)]).astype(np.int64)
        n = len(index)
        result = block.compute_block(
            simulations,
            times,
            layout.quantities,
            sweep.discard,
            self._workshop,
            scenes.pushed,
            self._poke,
        )
        well = n - len(lost)
        result.failed |= {well + i: reason for i, reason in enumerate(lost.values())}
        table = np.zeros(n, dtype=layout.dtype)
        for name in layout.dtype.names or ():
            if layout.dtype[name].kind == "f":
                table[name] = np.nan
                table[name][:well] = result.summary.get(name, np.nan)
        for name, column in coordinates_of(scenes, index).items():
            table[name] = column
        table["status"] = store.DONE
        for i, reason in result.failed.items():
            table["status"][i] = store.FAILED
            table["reason"][i] = reason.encode("ascii", "replace")[: store.REASON_LENGTH]
        rows = {"table": table}
        for name in layout.quantities:
            rows[name] = np.full((n, layout.samples, *MOTION[name].shape), np.nan)
            rows[name][:well] = result.quantities[name]
        if layout.quantities and layout.times is None:
            rows["time"] = np.tile(result.times, (n, 1))
        if lost:  # in the order of the block, in which its rows are checked
            asked = np.concatenate([members for _, members in pieces])
            order = [int(np.flatnonzero(index == i)[0]) for i in asked[np.isin(asked, index)]]
            rows = {name: values[order] for name, values in rows.items()}
        entry = {
            "failed": {int(index[i]): reason for i, reason in result.failed.items()},
            "totals": {"steps": result.steps, "rhs_evaluations": result.evaluations},
        }
        return index[order] if lost else index, rows, entry

    def _simulation(self, number: int, index: Array) -> Simulation:
        """Some trajectories of a scene as the lanes of a simulation."""
        body = int(self._body[number])
        if body in self._models.errors:
            raise self._models.errors[body]
        scene = self._scenes.scene(number)
        if body not in self._bodies:
            self._bodies[body] = body_of(scene.loaded)
        starts = block.starts_of(scene.loaded, self._scenes.space.values(index), len(index))
        return simulation_of(scene.loaded, self._bodies[body], starts)


def _finish(
    scenes: Scenes,
    layout: store.Layout,
    work: Work,
    elapsed: float,
    ranks: int,
) -> dict[str, Any]:
    """On rank 0: totals, the file under its name, and the summary."""
    found = store.read_journals(work.folder)
    failed = {i: reason for part in found.failed.values() for i, reason in part.items()}
    numbers = {
        "trajectories": layout.size,
        "done": layout.size - len(failed),
        "failed": len(failed),
        **{name: found.totals.get(name, 0.0) for name in ("steps", "rhs_evaluations")},
        "wall_time": elapsed,
        "ranks": ranks,
    }
    whole = store.open_layout(work.folder, layout)
    try:
        with whole:
            path = store.finish(work.folder, work.target, whole, numbers)
    except OSError as error:
        raise store.full_disk(work.target, error) from None
    return {
        "result": str(path),
        "complete": False,
        **numbers,
        "scenes": scenes.size,
        "blocks": scenes.blocks,
        "failures": dict(sorted(failed.items())[:1000]),
    }


def tell_failures(summary: dict[str, Any]) -> None:
    """Say which trajectories failed, the first ten with their reasons."""
    failures = summary.get("failures", {})
    for index, reason in list(failures.items())[:10]:
        print(f"qbxstokes: trajectory {index} failed: {reason}", file=sys.stderr)
    if summary["failed"] > 10:
        print(
            f"qbxstokes: {summary['failed'] - 10} more failed; see table/reason in the result",
            file=sys.stderr,
        )
