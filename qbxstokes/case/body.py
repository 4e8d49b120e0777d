"""Section `body`: shape and inertia."""

from __future__ import annotations

from typing import Annotated, Literal

from qbxstokes.case.base import Number
from qbxstokes.case.model import Field, Section


class Body(Section):
    """The spheroid: its shape and how heavy it is."""

    aspect_ratio: Annotated[Number, Field(gt=0, le=1e6, ge=1e-6)] = Field(
        description="k = a/c, equatorial over polar radius: prolate < 1, sphere 1, oblate > 1",
        examples=[0.5],
    )
    stokes_number: Annotated[Number, Field(ge=0)] = Field(
        default=0.0,
        description="St, particle inertia over viscous force; 0 is a massless body",
        examples=[10.0],
    )
    inertia: Literal["both", "translation", "rotation"] = Field(
        default="both",
        description="inertia of both motions, or of one alone: the other then follows the flow",
    )
