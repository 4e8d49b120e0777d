"""The field: error over a million targets, and cost over distance against plain upsampling."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from qbxstokes.app import field_benchmark
from qbxstokes.io.tables import Column, Table

if TYPE_CHECKING:
    from qbxstokes.app.tabulate import Work


def tables(work: Work) -> Iterator[Table]:
    """Both tables of the field."""
    accuracy = Table(
        "field_accuracy",
        "Field: targets from the surface to ten body lengths",
        (
            Column("aspect_ratio", "", "k", ".3g"),
            Column("problem"),
            Column("tolerance", "", "asked for", ".0e"),
            Column("targets", "", "", "d"),
            Column("error", "", "largest, over the speed", ".0e"),
            Column("seconds", "s", "set-up and all targets", ".3g", "time"),
            Column("passed", "", "the error is below the tolerance"),
        ),
        plot={"x": "aspect_ratio", "y": "error", "by": ["problem", "tolerance"]},
    )
    work.say("field, accuracy")
    targets = work.choose(2000, 1_000_000)
    ratios = work.choose((0.5,), field_benchmark.ASPECT_RATIOS)
    tolerances = work.choose((1e-8,), field_benchmark.TOLERANCES)
    field_benchmark.uniform_accuracy(ratios[:1], tolerances[:1], 100)  # loads what is compiled
    for row in field_benchmark.uniform_accuracy(ratios, tolerances, targets):
        known = {name: row[name] for name in accuracy.names if name != "passed"}
        accuracy.add(**known, passed=row["error"] <= row["tolerance"])
    yield accuracy
    work.say("field, costs")
    distances = work.choose((1e-2, 3.0), field_benchmark.DISTANCES)
    rows = field_benchmark.costs(0.5, distances, tolerances)
    costs = Table(
        "field_costs",
        "Field: time per target over the distance (k = 1/2)",
        (
            Column("distance", "c", "from the surface", ".0e"),
            Column("tolerance", "", "asked for", ".0e"),
            Column("table", "us", "by the table of harmonics", ".3g"),
            Column("quadrature", "us", "by the quadrature chosen for the distance", ".3g"),
            Column("method", "", "of that quadrature"),
            Column("plain", "us", "by plain upsampling", ".3g"),
            Column("upsampling", "", "that it takes; none: more than 32, or impossible", ".0f"),
            Column("ratio", "", "plain upsampling over the table", ".3g"),
        ),
        plot={
            "panels": [
                {"x": "distance", "y": way, "by": "tolerance", "scale": "loglog"}
                for way in ("table", "quadrature", "plain")
            ]
        },
    )
    for row in rows:
        known = {name: _finite(row[name]) for name in costs.names if name != "ratio"}
        plain = known["plain"]
        costs.add(**known, ratio=None if plain is None else plain / row["table"])
    yield costs


def _finite(value: Any) -> Any:
    """What cannot be reached has no cost."""
    return None if isinstance(value, float) and math.isinf(value) else value
