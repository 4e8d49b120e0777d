"""Section `time`: how long, which instants are stored, how accurately."""

from __future__ import annotations

from typing import Annotated

from qbxstokes.case.base import Integer, Number
from qbxstokes.case.model import Field, Problem, Section


class Time(Section):
    """End (or periods), stored instants and tolerance of the time integration."""

    end: Annotated[Number, Field(gt=0)] | None = Field(
        default=None, description="end of the motion, in time units", examples=[50.0]
    )
    periods: Annotated[Number, Field(gt=0)] | None = Field(
        default=None,
        description="end of the motion in Jeffery periods of the flow's gradient at the start",
        examples=[3],
    )
    samples: Annotated[Integer, Field(ge=2, le=100_000_000)] = Field(
        default=201, description="number of equally spaced instants stored, ends included"
    )
    at: Annotated[tuple[Number, ...], Field(min_length=1)] | None = Field(
        default=None,
        description="explicit instants to store, increasing; replaces end, periods and samples",
        examples=[[0.0, 0.5, 2.0]],
    )
    tolerance: Annotated[Number, Field(gt=0, le=0.1)] = Field(
        default=1e-10, description="error control of the time integration, relative and absolute"
    )

    def _check(self) -> None:
        given = [name for name in ("end", "periods", "at") if getattr(self, name) is not None]
        if len(given) != 1:
            wrong = f"gives {' and '.join(given)}" if given else "does not say when to end"
            raise Problem(wrong, "give exactly one of end, periods, at")
        if self.at is not None:
            if "samples" in self.model_fields_set:
                raise Problem("conflicts with at", "give one of them", ("samples",))
            if self.at[0] < 0:
                raise Problem("is before the start", "instants from 0 on", ("at", 0))
            if self.at[-1] == 0:
                raise Problem("has no instant after 0", "at least one positive instant", ("at",))
            for index in range(1, len(self.at)):
                if self.at[index] <= self.at[index - 1]:
                    raise Problem(
                        f"{self.at[index]:g} does not follow {self.at[index - 1]:g}",
                        "instants in increasing order",
                        ("at", index),
                    )
