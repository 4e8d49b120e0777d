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
        ),
    )
    work.say("field, accuracy")
    targets = work.choose(2000, 1_000_000)
    ratios = work.choose((0.5,), field_benchmark.ASPECT_RATIOS)
    tolerances = work.choose((1e-8,), field_benchmark.TOLERANCES)
    for row in field_benchmark.uniform_accuracy(ratios, tolerances, targets):
        accuracy.add(**{name: row[name] for name in accuracy.names})
    yield accuracy
    work.say("field, costs")
    distances = work.choose((1e-2, 3.0), field_benchmark.DISTANCES)
    rows = field_benchmark.costs(0.5, distances, tolerances)
    columns = [Column(name, **_COSTS.get(name, {})) for name in rows[0]]
    costs = Table("field_costs", "Field: microseconds per target (k = 1/2)", tuple(columns))
    for row in rows:
        costs.add(**{name: _finite(value) for name, value in row.items()})
    yield costs


def _finite(value: Any) -> Any:
    """What cannot be reached has no cost."""
    return None if isinstance(value, float) and math.isinf(value) else value


_COSTS = {
    "distance": {"unit": "c", "format": ".0e", "description": "from the surface"},
    "tolerance": {"format": ".0e", "description": "asked for"},
    "table": {"unit": "us", "description": "by the table of harmonics"},
    "quadrature": {"unit": "us", "description": "by quadrature chosen per target"},
    "plain": {"unit": "us", "description": "by plain upsampling"},
}
