"""What a person reads of a sweep: its plan (`--dry-run`) and its summary."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from qbxstokes.case.sweep import column_name
from qbxstokes.io.listing import unknown
from qbxstokes.io.names import parts_of
from qbxstokes.io.results import SweepResult, load
from qbxstokes.io.sweep_result import Layout, reading
from qbxstokes.quantities import STRESS
from qbxstokes.runs.cost import START_SECONDS, Estimate, estimate
from qbxstokes.runs.destination import result_path
from qbxstokes.runs.plan_report import around
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
from qbxstokes.runs.sweep_layout import Swept, layout_of, swept_scenes

if TYPE_CHECKING:
    from qbxstokes.runs.command import Job

_MOST_NUMBERS = 10**8  # of which means are formed when a sweep ends


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
    blocks, layout = scenes.blocks, layout_of(scenes)
    cost = estimate(scenes, layout.row_bytes)
    text = plan_text(scenes, layout, cost, result_path(loaded), ranks)
    facts = {
        "trajectories": scenes.space.size,
        "shape": scenes.space.shape,
        "scenes": scenes.size,
        "blocks": blocks,
        "operators": cost.bodies or scenes.space.size,
        "bytes_on_disk": layout.bytes,
        "memory_per_rank": cost.memory,
        "skips": list(scenes.skips),
        "seconds": {str(p): cost.seconds(p) for p in sorted({1, ranks, 1000, 10_000})},
        "text": text,
    }
    return facts, text


def plan_text(scenes: Swept, layout: Layout, cost: Estimate, target: Any, ranks: int) -> str:
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
        ("disk", f"{size(layout.bytes)} for {target}{more}"),
        ("time", seconds),
    ]
    runs = _runs(scenes, layout, cost)
    return _text(scenes, {"Runs": runs, "Skips": listed(scenes.skips), "Needs": needs}) + "\n"


def _text(scenes: Swept, sections: Mapping[str, Rows]) -> str:
    loaded = scenes.loaded
    title = f"Sweep: {loaded.case.title or loaded.path.stem}"
    scene = around(loaded) if loaded.case.coupled else ()
    return render(title, str(loaded.path), {"Scene": scene, "Varies": _axes(scenes), **sections})


def _runs(scenes: Swept, layout: Layout, cost: Estimate) -> Rows:
    """How many, in which parts, and what is kept of them."""
    shape = " x ".join(str(n) for n in scenes.space.shape)
    yield scenes.nouns[1], f"{counted(scenes.space.size, *scenes.nouns)} ({shape})"
    if scenes.turns > 1:
        yield "measured", f"each alone, once to warm up and {scenes.turns - 1} times"
    elif not scenes.alone:
        sizes = scenes.block_sizes()
        yield "scenes", f"{scenes.size}, with {counted(cost.bodies, 'operator')} to form"
        yield "blocks", f"{scenes.blocks} of {int(sizes.min())} to {int(sizes.max())}"
    stored = ", ".join(layout.quantities) if layout.quantities else "the table of summaries alone"
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
        with reading(summary["result"]) as file:
            table = file["table"][()]
        yield from unknown(table, ("period", "rotation_rate"))
