"""Section `constraints`: parts of the motion that are held or prescribed."""

from __future__ import annotations

from typing import Annotated, Any

from qbxstokes.case.model import Convert, Field, Section
from qbxstokes.case.timed import timed_entry

FREE, LOCKED = "free", "locked"


def _motion(value: Any) -> Any:
    return value if value in (FREE, LOCKED) else timed_entry(value)


Prescribed = Annotated[Any, Convert(_motion, json=list[float | str] | str | dict[str, Any])]


class Constraints(Section):
    """Translation and rotation: free, locked, or prescribed; force and torque are recorded."""

    translation: Prescribed = Field(
        default=FREE,
        description="free, locked, or velocity in space: numbers, expressions in t, ...",
        examples=["locked"],
    )
    rotation: Prescribed = Field(
        default=FREE,
        description="free, locked, or angular velocity in space: as above",
        examples=[[0.0, 0.0, "cos(t)"]],
    )

    @property
    def given(self) -> bool:
        """Whether there is any."""
        return self.translation != FREE or self.rotation != FREE
