"""Section `compare`: what the result is held against."""

from __future__ import annotations

from typing import Annotated, Literal

from qbxstokes.case.base import Number
from qbxstokes.case.model import Field, Section


class Compare(Section):
    """Comparison with a closed form or a semi-analytic reference at the end of the run."""

    reference: Literal["auto", "none"] = Field(
        default="auto", description="compare with a closed form where one is known, or not at all"
    )
    tolerance: Annotated[Number, Field(gt=0)] | None = Field(
        default=None,
        description="largest error allowed, above it the run fails (exit 1); unset: no limit",
        examples=[1e-8],
    )
