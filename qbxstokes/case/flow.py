"""Section `flow`: the background flow, by type; the other keys belong to that type."""

from __future__ import annotations

from typing import Any

from qbxstokes.case.base import Text, to_angle, to_number
from qbxstokes.case.model import Field, Problem, Section


class FlowSection(Section):
    """The background flow: `type`, and the keys of that type."""

    model_open = True

    type: Text = Field(
        description="name of the flow; its own keys follow in this section", examples=["shear"]
    )

    @classmethod
    def _prepare(cls, data: Any) -> Any:
        """Numbers and angles may be written as '1/6' and '90 deg' here as elsewhere."""
        return _with_numbers(data)

    def spec(self) -> dict[str, Any]:
        """The plain dictionary from which the flow is built."""
        return {"type": self.type, **self.model_extra}


def _with_numbers(value: Any, key: str = "") -> Any:
    """`value` with arithmetic in strings evaluated; words stay as they are."""
    if isinstance(value, dict):
        return {name: _with_numbers(entry, name) for name, entry in value.items()}
    if isinstance(value, list):
        return [_with_numbers(entry) for entry in value]
    if key == "angle":
        return to_angle(value)
    if isinstance(value, str) and key != "type":
        try:
            return to_number(value)
        except Problem:
            return value
    return value
