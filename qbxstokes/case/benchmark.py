"""Section `benchmark`: tables of run time against error."""

from __future__ import annotations

from typing import Annotated

from qbxstokes.case.base import Integer
from qbxstokes.case.model import Field
from qbxstokes.case.tabulate import Tables


class Benchmark(Tables):
    """Work-precision tables of `task: benchmark`."""

    repeats: Annotated[Integer, Field(ge=1, le=1000)] = Field(
        default=5, description="times each timing is repeated; the median counts"
    )
