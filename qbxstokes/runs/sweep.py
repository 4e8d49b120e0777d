"""A sweep on any number of ranks: its plan, its run from case to result, its summary."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from qbxstokes.case.sweep import column_name
from qbxstokes.io import sweep_result as store
from qbxstokes.io.listing import unknown
from qbxstokes.io.names import parts_of
from qbxstokes.io.results import SweepResult, load, shows_parts
from qbxstokes.io.store import Work, open_work, reopen
from qbxstokes.quantities import STRESS
from qbxstokes.runs.cost import START_SECONDS, Estimate, estimate
from qbxstokes.runs.destination import identity_of, result_path, working_folder
from qbxstokes.runs.parallel import interrupted
from qbxstokes.runs.plan_report import around
from qbxstokes.runs.progress import compilation_told
from qbxstokes.runs.report import (
    Rows,
    counted,
    duration,
    listed,
    near_edge,
    quantity,
    render,
    size,
    vector,
)
from qbxstokes.runs.sharing import ALONE, Crew, Gathering, Item, read_whole, seconds_between
from qbxstokes.runs.sweep_blocks import swept_scenes
from qbxstokes.runs.sweep_layout import Swept
from qbxstokes.runs.sweep_work import BLOCKS, Todo, form_models, todo_of, work_on_blocks

if TYPE_CHECKING:
    from qbxstokes.runs.command import Job

_MOST_NUMBERS = 10**8  # of which means are formed when a sweep ends


def run(job: Job) -> dict[str, Any]:
    """Compute the sweep on all ranks and return its summary (on every rank)."""
    from qbxstokes.petsc.session import stepper_options

    loaded = job.loaded
    scenes = swept_scenes(loaded)
    seconds_between(loaded)
    merge = loaded.case.output.merge
    cut = [scenes.block_size, scenes.blocks]
    identity = identity_of(loaded, stepper_options(job.PETSc), blocks=cut)

    def left(work: Work) -> Todo:
        store.check_room(work.target, scenes.layout, merge)
        return todo_of(scenes, work)

    def reopened(done: Path) -> Work | None:
        if shows_parts(done):  # its parts are all there is: what they lack is to be done
            lacking = todo_of(scenes, Work(done, {}, 2)).numbers
            return reopen(done, identity) if lacking or merge else None
        with store.reading(done) as file:
            if np.all(file["table"].fields("status")[()] == store.DONE):
                return None
        work = open_work(done, identity, overwrite=True)
        _take_apart(scenes, work)
        return work

    with working_folder(job, identity, left, reopened) as (work, found):
        if work is None:
            return {"result": str(found), "complete": True, "failed": 0, "finished_before": True}
        return _computed(job, scenes, work, found)


def _take_apart(scenes: Swept, work: Work) -> None:
    """Make parts of a finished result, as of a run that is to go on with what has failed.

    The result stays until a better one takes its place.
    """
    gathering, layout = Gathering(ALONE, work, BLOCKS, joined=True), scenes.layout
    names = ["table", *layout.quantities]
    names += ["time"] if layout.quantities and layout.times is None else []
    with store.reading(work.target) as file:
        for number in range(scenes.blocks):
            index = np.sort(scenes.block(number).index)
            rows = {name: file[name][index] for name in names}
            lost = np.flatnonzero(rows["table"]["status"] != store.DONE)
            failed = {str(index[i]): rows["table"]["reason"][i].decode() for i in lost}
            note = {"block": number, "mended": [], "failed": failed, "totals": {}}
            gathering.add({"index": index, **rows}, {**note, "nearest": math.inf})
    gathering.save()


def _computed(job: Job, scenes: Swept, work: Work, todo: Todo) -> dict[str, Any]:
    """What is to be done, done by all ranks and merged by rank 0."""
    comm, options, clock = job.comm, job.options, job.clock
    merge = scenes.loaded.case.output.merge
    gathering = Gathering(comm, work, BLOCKS, joined=True, every=seconds_between(scenes.loaded))
    speak = comm.rank == 0 and not options.quiet and options.progress != "none"
    try:
        with clock.part("models"):
            models = form_models(comm, scenes, todo, options.no_cache, speak)
        crew = Crew(job, gathering, scenes.space.size, scenes.nouns[1], todo.done)
        begin = time.perf_counter()
        with compilation_told(comm, speak):
            job.interruption.listening = True
            work_on_blocks(crew, scenes, todo, models, clock)
    except KeyboardInterrupt as stop:
        raise interrupted(work.folder, *stop.args or (2,)) from None
    if not merge:
        with clock.part("output"):
            gathering.save()
    crew.end()
    elapsed = time.perf_counter() - begin
    with clock.part("output"):
        return gathering.concluded(lambda items: _finished(job, scenes, work, items, elapsed))


def _finished(
    job: Job, scenes: Swept, work: Work, items: Iterator[Item], elapsed: float
) -> dict[str, Any]:
    """On rank 0: the result under its name, with all rows or showing the parts; the summary."""
    found, merge = Todo([]), scenes.loaded.case.output.merge
    about = {"identity": json.dumps(work.identity), "shape": list(scenes.space.shape)}
    shown = None if merge else _shown(scenes.space.size, work, found)
    layout, record = scenes.layout, job.provenance | about
    with store.SweepWriter(work, layout, record, scenes.scales(), shown) as whole:
        for rows, note in items if merge else ():
            whole.write_rows(rows.pop("index"), rows)
            for told in note.get("items", [note]):
                found.learn(told)
        failed = {i: why for part in found.failed.values() for i, why in part.items()}
        totals = ("steps", "rhs_evaluations", "ended")
        numbers = {
            "trajectories": scenes.space.size,
            "done": scenes.space.size - len(failed),
            "failed": len(failed),
            **{name: found.totals.get(name, 0.0) for name in totals},
            "wall_time": elapsed,
            "ranks": job.comm.size,
        }
        whole.finish({"complete": True, **numbers})
    summary = {
        "result": str(work.target),
        "complete": False,
        **numbers,
        "scenes": scenes.size,
        "blocks": scenes.blocks,
        "failures": dict(sorted(failed.items())[:1000]),
        "nearest": found.nearest,
    }
    if merge:
        return summary
    for state in work.parts("state"):
        state.unlink(missing_ok=True)
    work.note_run(finished=True)
    return {**summary, "parts": str(work.folder)}


def _shown(total: int, work: Work, found: Todo) -> list[store.Shown]:
    """Which rows of which part the result shows, the latest of each; `found` learns the notes."""
    parts, indices = work.parts(BLOCKS), []
    latest = np.full(total, -1, dtype=np.int32)  # the part that holds a trajectory
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


# -- what is told ---------------------------------------------------------------------------------


def _axes(scenes: Swept) -> Rows:
    for columns in scenes.space.axes:
        first, told = columns[0], counted(columns[0].size, "value")
        if first.values is None:
            told += f", random ({first.kind}, seed {first.seed})"
        elif first.numeric and first.values.ndim == 1:
            low, high = float(first.values.min()), float(first.values.max())
            told += f" from {quantity(low)} to {quantity(high)}"
        yield ", ".join(column_name(column.key) for column in columns), told


def planned(job: Job) -> tuple[dict[str, Any], str]:
    """What would run, as data and as text."""
    loaded, ranks = job.loaded, job.comm.size
    scenes = swept_scenes(loaded)
    layout = scenes.layout
    cost = estimate(scenes)
    text = plan_text(scenes, cost, result_path(loaded), ranks)
    facts = {
        "trajectories": scenes.space.size,
        "shape": scenes.space.shape,
        "scenes": scenes.size,
        "blocks": scenes.blocks,
        "operators": cost.bodies or scenes.space.size,
        "bytes_on_disk": layout.bytes,
        "memory_per_rank": cost.memory,
        "skips": list(scenes.skips),
        "seconds": {str(p): cost.seconds(p) for p in sorted({1, ranks, 1000, 10_000})},
        "text": text,
    }
    return facts, text


def plan_text(scenes: Swept, cost: Estimate, target: Any, ranks: int) -> str:
    """What will run, how many, memory, disk and time."""
    seconds = (
        f"about {duration(cost.seconds(ranks))} on {counted(ranks, 'rank')} "
        f"({duration(cost.seconds(1))} of work; a factor of 2 either way), and "
        f"{duration(START_SECONDS)} to start"
    )
    more = ", and as much again while it runs"
    if not scenes.loaded.case.output.merge:
        more = f", in parts that stay in {parts_of(target).name}"
    needs = [
        ("memory", f"about {size(cost.memory)} on each rank"),
        ("disk", f"{size(scenes.layout.bytes)} for {target}{more}"),
        ("time", seconds),
    ]
    runs = _runs(scenes, cost)
    return _text(scenes, {"Runs": runs, "Skips": listed(scenes.skips), "Needs": needs}) + "\n"


def _text(scenes: Swept, sections: Mapping[str, Rows]) -> str:
    loaded = scenes.loaded
    title = f"Sweep: {loaded.case.title or loaded.path.stem}"
    scene = around(loaded) if loaded.case.coupled else ()
    return render(title, str(loaded.path), {"Scene": scene, "Varies": _axes(scenes), **sections})


def _runs(scenes: Swept, cost: Estimate) -> Rows:
    """How many, in which parts, and what is kept of them."""
    shape = " x ".join(str(n) for n in scenes.space.shape)
    yield scenes.nouns[1], f"{counted(scenes.space.size, *scenes.nouns)} ({shape})"
    if scenes.turns > 1:
        yield "measured", f"each alone, once to warm up and {scenes.turns - 1} times"
    elif not scenes.alone:
        sizes = scenes.block_sizes()
        yield "scenes", f"{scenes.size}, with {counted(cost.bodies, 'operator')} to form"
        yield "blocks", f"{scenes.blocks} of {int(sizes.min())} to {int(sizes.max())}"
    stored = ", ".join(scenes.quantities) if scenes.quantities else "the table of summaries alone"
    yield "samples", f"{scenes.samples} each; stored: {stored}"


def summary_text(job: Job, summary: dict[str, Any]) -> str:
    """What was computed, how fast, and where it is."""
    scenes = swept_scenes(job.loaded)
    wall = summary["wall_time"]
    rates = summary["rhs_evaluations"] / wall if wall > 0 else 0.0
    evaluated = f"{summary['rhs_evaluations']:.4g}, {rates:.3g} per second"
    done = f"{summary['done']} done, {summary['failed']} failed"
    if scenes.alone:
        done += ", each alone"
    else:
        parts = counted(summary["blocks"], "block"), counted(summary["scenes"], "scene")
        done += ", in {} of {}".format(*parts)
    times = summary["wall_times"]
    spent = ", ".join(f"{name} {duration(value)}" for name, value in times.items())
    solved = [(scenes.nouns[1], done)]
    if summary["rhs_evaluations"]:
        solved.append(("right-hand sides", evaluated))
    means = list(_means(scenes, summary["result"]))
    spans = [("sweep", f"{duration(wall)} on {counted(summary['ranks'], 'rank')}")]
    spans.append(("rank 0", spent))
    result = [("file", summary["result"])]
    if "parts" in summary:
        result.append(("", f"which shows what stands in {summary['parts']}: keep both together"))
    return _text(scenes, {"Solved": solved, "Means": means, "Times": spans, "Result": result})


def _means(scenes: Swept, path: str) -> Rows:
    """Stresses over time and trajectories with their errors, where they were recorded."""
    result = load(path)
    stored = [name for name in STRESS if name in result.names]
    if not stored or not isinstance(result, SweepResult):
        return
    section = scenes.loaded.case.sweep
    yield "components", " ".join(STRESS[stored[0]].components)
    for name in stored:
        if math.prod(result.shapes[name]) > _MOST_NUMBERS:
            yield name.replace("_", " "), "not formed: too many; SweepResult.mean does"
            continue
        found = result.mean(name, section.discard)
        yield name.replace("_", " "), vector(found.mean)
        if math.isfinite(found.standard_error[0]):
            yield "its error", f"{vector(found.standard_error)}, if drawn at random"


def remarks(job: Job, summary: dict[str, Any]) -> Iterator[str]:
    """Which trajectories failed, the first ten with their reasons, and what else is not known."""
    if summary["ended"]:
        which = f"{summary['ended']:g} of the trajectories ended at an edge of their flow"
        yield f"{which}: see end and reason in the table"
    if summary["nearest"] < math.inf:
        yield near_edge(summary["nearest"])
    for index, reason in list(summary["failures"].items())[:10]:
        yield f"trajectory {index} failed: {reason}"
    if summary["failed"] > 10:
        yield f"{summary['failed'] - 10} more failed; see table/reason in the result"
    if not job.options.quiet:
        with store.reading(summary["result"]) as file:
            table = file["table"][()]
        yield from unknown(table, ("period", "rotation_rate"))
