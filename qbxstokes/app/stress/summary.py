"""The worst of every table of a stress run, each in one row."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import takewhile

import numpy as np

from qbxstokes.io.tables import Column, Table


def summary(made: Sequence[Table]) -> Table:
    """One row per table of checks: the value that came nearest to its bound, or went beyond it."""
    worst = Table(
        "worst_cases",
        "The worst of every table",
        (
            Column("table"),
            Column("checks", "", "rows of the table", "d"),
            Column("worst", "", "value that uses most of its bound", ".1e"),
            Column("bound", "", "what it must not exceed", ".0e"),
            Column("passed", "", "whether every row of the table does"),
            Column("met", "", "where"),
            Column("measured", "", "what is bounded"),
        ),
    )
    for table in made:
        rows = list(table.records())
        index = int(np.argmax(table["worst"] / table["bound"]))
        row = rows[index]
        keys = zip(table.columns, table.cells()[index], strict=True)
        known = list(takewhile(lambda key: key[0].name != "worst", keys))
        places = [f"{' '.join(column.words)} {text}" for column, text in known]
        worst.add(
            table=table.name,
            checks=len(rows),
            measured=table.column("worst").description,
            worst=row["worst"],
            bound=row["bound"],
            met=", ".join([*places, *([str(row["at"])] if row.get("at") else [])]),
            passed=bool(table["passed"].all()),
        )
    return worst
