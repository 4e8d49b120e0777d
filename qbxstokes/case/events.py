"""Section `events`: what is watched for between the samples."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from qbxstokes.case.base import Boolean, Number, Vector, describe, to_number
from qbxstokes.case.model import Convert, Field, Problem, Section

Turning = Literal["x1", "x2", "x3", "d1", "d2", "d3"]


def _corner(value: Any) -> Any:
    if not isinstance(value, (list, tuple)) or len(value) != 3:
        raise Problem(f"is {describe(value)}", "three entries, null where there is no bound")
    return tuple(None if entry is None else to_number(entry) for entry in value)


Corner = Annotated[
    tuple[float | None, float | None, float | None],
    Convert(_corner, json=list[float | str | None]),
]


class Region(Section):
    """A box in space with sides along the axes; the run ends where the centre leaves it."""

    lower: Corner = Field(
        default=(None, None, None),
        description="lower bounds of x1, x2, x3; null for none",
        examples=[[-10.0, None, None]],
    )
    upper: Corner = Field(
        default=(None, None, None),
        description="upper bounds of x1, x2, x3; null for none",
        examples=[[10.0, None, None]],
    )

    def _check(self) -> None:
        for index, (low, high) in enumerate(zip(self.lower, self.upper, strict=True)):
            if low is not None and high is not None and low >= high:
                raise Problem(f"{high:g} is not above {low:g}", "a larger bound", ("upper", index))


class Events(Section):
    """Half-turns, turning points, rest, the edge of a region, and singular points of the flow."""

    half_turns: Boolean = Field(
        default=True,
        description="record passages of the axis through a plane: period, orbit constant, drift",
    )
    plane: Vector | None = Field(
        default=None,
        description="normal of that plane; unset: stream (prolate) or gradient (oblate) direction",
        examples=[[1.0, 0.0, 0.0]],
    )
    turning_points: tuple[Turning, ...] = Field(
        default=(),
        description="record where these of x1, x2, x3 (centre) and d1, d2, d3 (axis) turn back",
        examples=[["x1", "d3"]],
    )
    steady: Annotated[Number, Field(gt=0)] | None = Field(
        default=None,
        description="record when axis and velocity change by less than this per unit of time",
        examples=[1e-6],
    )
    stop_when_steady: Boolean = Field(default=False, description="end the run at that instant")
    region: Region | None = Field(default=None, description="end the run where the centre leaves")
    clearance: Annotated[Number, Field(ge=0)] | None = Field(
        default=None,
        description="end the run where a singular point of the flow is so near to the surface (c); "
        "unset: 0.05, or half of what there is at the start",
        examples=[0.05],
    )

    def _check(self) -> None:
        if self.stop_when_steady and self.steady is None:
            raise Problem("needs steady", "a rate such as steady: 1e-6", ("stop_when_steady",))
        if self.plane is not None and not any(self.plane):
            raise Problem("is zero and has no direction", "any non-zero vector", ("plane",))
