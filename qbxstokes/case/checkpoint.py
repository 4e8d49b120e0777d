"""Section `checkpoint`: how often a run is made safe on disk."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Annotated, Any

from qbxstokes.case.base import describe, to_number
from qbxstokes.case.model import Convert, Field, Problem, Section

_UNITS = ("seconds", "steps", "periods")
_EVERY = re.compile(r"(?P<number>.*?)\s*(?P<unit>s|seconds?|steps?|periods?)\Z", re.DOTALL)


@dataclass(frozen=True)
class Interval:
    """A number of seconds of wall time, steps, or Jeffery periods."""

    number: float
    unit: str


def _interval(value: Any) -> Interval:
    match = _EVERY.match(value.strip()) if isinstance(value, str) else None
    text = match["number"] if match else value
    unit = next(name for name in _UNITS if name.startswith((match["unit"] if match else "s")[:2]))
    try:
        number = to_number(text)
    except Problem:
        raise Problem(
            f"{describe(value)} is no interval", "such as 60 s, 10000 steps or 100 periods"
        ) from None
    if number <= 0 or (unit == "steps" and number < 1):
        raise Problem(f"is {describe(value)}", "more than nothing, such as 60 s")
    return Interval(number, unit)


def _every(value: Any) -> str:
    interval = _interval(value)
    return f"{interval.number:.12g} {interval.unit}"


class Checkpoints(Section):
    """A run that is stopped goes on from its last checkpoint with --resume."""

    every: Annotated[str, Convert(_every, json=str | float)] = Field(
        default="30 seconds",
        description="time between checkpoints: 60 s of wall time, 10000 steps or 100 periods",
        examples=["60 s"],
    )

    @property
    def interval(self) -> Interval:
        """The interval as number and unit."""
        return _interval(self.every)
