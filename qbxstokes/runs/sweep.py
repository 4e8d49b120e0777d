"""A sweep on any number of ranks, from its case to its result."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from qbxstokes.io import sweep_result as store
from qbxstokes.io.results import shows_parts
from qbxstokes.io.store import Work, open_work, reopen
from qbxstokes.runs.destination import identity_of, working_folder
from qbxstokes.runs.gathering import Crew, Gathering, read_whole, seconds_between
from qbxstokes.runs.parallel import interrupted, on_root
from qbxstokes.runs.progress import compilation_told
from qbxstokes.runs.sweep_layout import Swept, layout_of, scales_of, swept_scenes
from qbxstokes.runs.sweep_work import BLOCKS, Todo, form_models, todo_of, work_on_blocks

if TYPE_CHECKING:
    from qbxstokes.runs.command import Job


def run(job: Job) -> dict[str, Any]:
    """Compute the sweep on all ranks and return its summary (on every rank)."""
    from qbxstokes.petsc.session import stepper_options

    loaded = job.loaded
    scenes = swept_scenes(loaded)
    seconds_between(loaded)
    layout, merge = layout_of(scenes), loaded.case.output.merge
    cut = [scenes.block_size, scenes.blocks]
    identity = identity_of(loaded, stepper_options(job.PETSc), blocks=cut)

    def left(work: Work) -> Todo:
        store.check_room(work.target, layout, merge)
        todo = todo_of(scenes, work, failures_of(scenes, work.target) if work.mends else None)
        todo.merges = work.mends or merge
        return todo

    def reopened(done: Path) -> Work | None:
        if shows_parts(done):  # its parts are all there is: what they lack is to be done
            lacking = todo_of(scenes, Work(done, {}, 2), None).numbers
            return reopen(done, identity) if lacking or merge else None
        if not failures_of(scenes, done).mend:
            return None
        work = open_work(done, identity, overwrite=True)  # which stays until a better one is there
        work.mends = True
        return work

    with working_folder(job, identity, left, reopened) as (work, found):
        if work is None:
            return {"result": str(found), "complete": True, "failed": 0, "finished_before": True}
        return _computed(job, scenes, layout, work, found)


def failures_of(scenes: Swept, result: Path) -> Todo:
    """What a finished result leaves to do."""
    todo = Todo([])
    with store.reading(result) as file:
        for number in range(scenes.blocks):
            index = np.sort(scenes.block(number).index)
            table = file["table"][index]
            lost = table["status"] != store.DONE
            todo.failed[number] = {
                int(i): reason.decode()
                for i, reason in zip(index[lost], table["reason"][lost], strict=True)
            }
            todo.done += len(index) - int(lost.sum())
    todo.mend = {number: sorted(failed) for number, failed in todo.failed.items() if failed}
    return todo


def _computed(
    job: Job, scenes: Swept, layout: store.Layout, work: Work, todo: Todo
) -> dict[str, Any]:
    """What is to be done, done by all ranks and merged by rank 0."""
    comm, options, clock = job.comm, job.options, job.clock
    gathering = Gathering(comm, work, BLOCKS, joined=True, every=seconds_between(scenes.loaded))
    speak = comm.rank == 0 and not options.quiet and options.progress != "none"
    try:
        with clock.part("models"):
            models = form_models(comm, scenes, todo, options.no_cache, speak)
        crew = Crew(job, gathering, scenes.space.size, scenes.nouns[1], todo.done)
        begin = time.perf_counter()
        with compilation_told(comm, speak):
            job.interruption.listening = True
            work_on_blocks(crew, scenes, layout, todo, models, clock)
    except KeyboardInterrupt as stop:
        raise interrupted(work.folder, *stop.args or (2,)) from None
    crew.end()
    about = {"identity": json.dumps(work.identity), "shape": list(scenes.space.shape)}
    elapsed = time.perf_counter() - begin
    with clock.part("output"):
        if not todo.merges:
            gathering.save()
        if comm.rank:
            list(gathering.collect())
        told = scenes, layout, gathering, job.provenance | about, todo.merges, elapsed, comm.size
        return on_root(comm, lambda: _finished(*told))


def _finished(
    scenes: Swept,
    layout: store.Layout,
    gathering: Gathering,
    provenance: dict[str, Any],
    merges: bool,
    elapsed: float,
    ranks: int,
) -> dict[str, Any]:
    """On rank 0: the result under its name, with all rows or showing the parts; the summary."""
    work, found = gathering.work, Todo([])
    if not merges:
        gathering.drain()  # the other ranks have made safe what they had
    try:
        shown = None if merges else _shown(layout, work, found)
        scales = scales_of(scenes, layout)
        with store.SweepWriter(work, layout, provenance, scales, shown) as whole:
            if merges:
                found = _merge(scenes, layout, whole, gathering)
            numbers, told = _sum_up(scenes, found, elapsed, ranks)
            whole.finish({"complete": True, **numbers})
    finally:
        gathering.drain()
    summary = {"result": str(work.target), "complete": False, **numbers, **told}
    if merges:
        return summary
    for state in work.parts("state"):
        state.unlink(missing_ok=True)
    work.note_run(finished=True)
    return {**summary, "parts": str(work.folder)}


def _merge(
    scenes: Swept, layout: store.Layout, whole: store.SweepWriter, gathering: Gathering
) -> Todo:
    """Put the rows of all ranks, and those of a result that is mended, into the file."""
    found = Todo([])
    base = gathering.work.target
    if gathering.work.mends:
        found = failures_of(scenes, base)
        names = ["table", *layout.quantities]
        names += ["time"] if layout.quantities and layout.times is None else []
        with store.reading(base) as old:
            for number in range(scenes.blocks):
                index = np.sort(scenes.block(number).index)
                whole.write_rows(index, {name: old[name][index] for name in names})
    for rows, note in gathering.collect():
        whole.write_rows(rows.pop("index"), rows)
        for told in note.get("items", [note]):
            found.learn(told)
    return found


def _shown(layout: store.Layout, work: Work, found: Todo) -> list[store.Shown]:
    """Which rows of which part the result shows, the latest of each; `found` learns the notes."""
    parts, indices = work.parts(BLOCKS), []
    latest = np.full(layout.size, -1, dtype=np.int32)  # the part that holds a trajectory
    for number, path in enumerate(parts):
        arrays, note = read_whole(path, ["index"])
        indices.append(arrays["index"])
        latest[arrays["index"]] = number
        for told in note["items"]:
            found.learn(told)
    shown = []
    for number, (path, index) in enumerate(zip(parts, indices, strict=True)):
        places = np.flatnonzero(latest[index] == number)
        shown.append(store.Shown(path, len(index), index[places], places))
    return shown


def _sum_up(
    scenes: Swept, found: Todo, elapsed: float, ranks: int
) -> tuple[dict[str, Any], dict[str, Any]]:
    """The totals, which the file holds too, and what else is told."""
    failed = {i: why for part in found.failed.values() for i, why in part.items()}
    numbers = {
        "trajectories": scenes.space.size,
        "done": scenes.space.size - len(failed),
        "failed": len(failed),
        **{name: found.totals.get(name, 0.0) for name in ("steps", "rhs_evaluations", "ended")},
        "wall_time": elapsed,
        "ranks": ranks,
    }
    return numbers, {
        "scenes": scenes.size,
        "blocks": scenes.blocks,
        "failures": dict(sorted(failed.items())[:1000]),
        "nearest": found.nearest,
    }
