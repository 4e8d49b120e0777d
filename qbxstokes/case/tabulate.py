"""What the sections of the tasks that make tables share."""

from __future__ import annotations

from typing import Annotated, Literal

from qbxstokes.case.base import Boolean, Text
from qbxstokes.case.model import Field, Section

# Sections of a case that have no meaning where a task builds its own scenes.
SCENE_SECTIONS = (
    *("body", "flow", "start", "forces", "constraints", "time", "hydrodynamics"),
    *("field", "events", "checkpoint", "sweep", "compare"),
)


class Tables(Section):
    """Which tables, how large, and what is written beside the result file."""

    tables: Annotated[tuple[Text, ...], Field(min_length=1)] | None = Field(
        default=None, description="names of the tables to make, in this order; unset: all"
    )
    size: Literal["small", "full"] = Field(
        default="full", description="extent of the tables: small for a look, full for the record"
    )
    csv: Boolean = Field(default=True, description="write each table as CSV beside the result")
    figures: Boolean = Field(default=False, description="draw each table beside the result (PDF)")
