"""Section `flow`: the background flow, by type; the other keys belong to that type."""

from __future__ import annotations

from typing import Any

from pydantic import ConfigDict, Field, model_validator

from qbxstokes.config.base import Section, Text, to_angle


class FlowSection(Section):
    """The background flow: `type`, and the keys of that type."""

    model_config = ConfigDict(extra="allow", frozen=True)

    type: Text = Field(
        description="name of the flow; its own keys follow in this section", examples=["shear"]
    )

    @model_validator(mode="before")
    @classmethod
    def _angles(cls, data: Any) -> Any:
        """Angles may be written as '90 deg' in the flow's keys as elsewhere."""
        return _with_radians(data)

    def spec(self) -> dict[str, Any]:
        """The plain dictionary from which the flow is built."""
        return {"type": self.type, **(self.model_extra or {})}


def _with_radians(value: Any) -> Any:
    if isinstance(value, dict):
        return {
            key: to_angle(entry) if key == "angle" else _with_radians(entry)
            for key, entry in value.items()
        }
    return [_with_radians(entry) for entry in value] if isinstance(value, list) else value
