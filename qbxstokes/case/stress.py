"""Section `stress`: numerical stability, each table with bounds that are checked."""

from __future__ import annotations

from typing import Annotated

from qbxstokes.case.base import Integer
from qbxstokes.case.model import Field
from qbxstokes.case.tabulate import Tables


class Stress(Tables):
    """Stability tables of `task: stress`; a bound that is exceeded makes the run fail."""

    seed: Annotated[Integer, Field(ge=0, le=2**31 - 1)] = Field(
        default=0, description="seed of the random scenes"
    )
