"""What a person reads of a sweep: its plan (`--dry-run`) and its summary."""

from __future__ import annotations

from typing import Any

from qbxstokes.case.sweep import column_name
from qbxstokes.io.sweep import Layout
from qbxstokes.runs.cost import START_SECONDS, Estimate
from qbxstokes.runs.report import Rows, counted, duration, quantity, render, size
from qbxstokes.runs.scenes import Scenes


def _axes(scenes: Scenes) -> Rows:
    for axis in scenes.space.axes:
        names = ", ".join(column_name(column.key) for column in axis.columns)
        yield names, f"{counted(axis.size, 'value')}{_range(axis.columns[0])}"


def _range(column: Any) -> str:
    if column.kind:
        return f", random ({column.kind}, seed {column.seed})"
    if column.numeric and column.values.ndim == 1:
        ends = (float(column.values.min()), float(column.values.max()))
        return f" from {quantity(ends[0])} to {quantity(ends[1])}"
    return ""


def plan_text(scenes: Scenes, layout: Layout, estimate: Estimate, target: Any, ranks: int) -> str:
    """What will run, how many, memory, disk and time."""
    sizes = scenes.block_sizes()
    stored = ", ".join(layout.quantities) if layout.quantities else "the table of summaries alone"
    count = counted(scenes.space.size, "trajectory", "trajectories")
    shape = " x ".join(str(n) for n in scenes.space.shape)
    bodies = len(scenes.bodies[1])
    return (
        render(
            f"Sweep: {scenes.loaded.case.title or scenes.loaded.path.stem}",
            str(scenes.loaded.path),
            {
                "Varies": list(_axes(scenes)),
                "Runs": [
                    ("trajectories", f"{count} ({shape})"),
                    ("scenes", f"{scenes.size}, with {counted(bodies, 'operator')} to form"),
                    ("blocks", f"{scenes.blocks} of {int(sizes.min())} to {int(sizes.max())}"),
                    ("samples", f"{scenes.samples} each; stored: {stored}"),
                ],
                "Skips": [("", f"- {text}") for text in scenes.skips],
                "Needs": [
                    ("memory", f"about {size(estimate.memory)} on each rank"),
                    ("disk", f"{size(layout.bytes)} for {target}"),
                    (
                        "time",
                        f"about {duration(estimate.seconds(ranks))} on {counted(ranks, 'rank')} "
                        f"({duration(estimate.work)} of work; a factor of 2 either way), and "
                        f"{duration(START_SECONDS)} to start",
                    ),
                ],
            },
        )
        + "\n"
    )


def summary_text(scenes: Scenes, summary: dict[str, Any]) -> str:
    """What was computed, how fast, and where it is."""
    wall = summary["wall_time"]
    rates = summary["rhs_evaluations"] / wall if wall > 0 else 0.0
    times = summary["wall_times"]
    spent = ", ".join(f"{name} {duration(value)}" for name, value in times.items())
    return render(
        f"Sweep: {scenes.loaded.case.title or scenes.loaded.path.stem}",
        str(scenes.loaded.path),
        {
            "Varies": list(_axes(scenes)),
            "Solved": [
                (
                    "trajectories",
                    f"{summary['done']} done, {summary['failed']} failed, "
                    f"in {counted(summary['blocks'], 'block')} of "
                    f"{counted(summary['scenes'], 'scene')}",
                ),
                ("right-hand sides", f"{summary['rhs_evaluations']:.4g}, {rates:.3g} per second"),
            ],
            "Times": [
                ("sweep", f"{duration(wall)} on {counted(summary['ranks'], 'rank')}"),
                ("rank 0", spent),
            ],
            "Result": [("file", summary["result"])],
        },
    )
