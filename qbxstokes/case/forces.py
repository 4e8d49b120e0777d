"""Section `forces`: external force and torque on the body, and its weight."""

from __future__ import annotations

from typing import Annotated

from qbxstokes.case.base import Number, Vector
from qbxstokes.case.model import Field, Problem, Section
from qbxstokes.case.timed import TimedVector


class Gravity(Section):
    """Weight less buoyancy, Theta G e, with the volume Theta = 4 pi k^2/3 and a direction e.

    G = (rho_p - rho_f) g c tau/mu is given as `number`, or follows from the particle's Stokes
    number St = rho_p c^2/(mu tau), `acceleration` = g tau^2/c and `density_ratio` = rho_p/rho_f:
    G = St acceleration (1 - 1/density_ratio).
    """

    direction: Vector = Field(
        default=(0.0, 0.0, -1.0), description="direction of gravity in space; normalised"
    )
    number: Number | None = Field(
        default=None,
        description="G = (rho_p - rho_f) g c tau/mu, net weight per volume; may be negative",
        examples=[1.0],
    )
    acceleration: Annotated[Number, Field(ge=0)] | None = Field(
        default=None,
        description="g tau^2/c, with density_ratio in place of number (stokes_number > 0)",
        examples=[1.0],
    )
    density_ratio: Annotated[Number, Field(gt=0)] | None = Field(
        default=None, description="rho_p/rho_f, of body to fluid", examples=[2.5]
    )

    def _check(self) -> None:
        if not any(self.direction):
            raise Problem("is zero", "any non-zero vector", ("direction",))
        pair = (self.acceleration, self.density_ratio)
        if (self.number is None) == (pair == (None, None)):
            raise Problem("is not determined", "give number, or acceleration and density_ratio")
        if self.number is None and None in pair:
            missing = "acceleration" if pair[0] is None else "density_ratio"
            raise Problem("is missing", "acceleration and density_ratio go together", (missing,))

    def net(self, stokes_number: float) -> float:
        """G, the net weight per volume."""
        if self.number is not None:
            return self.number
        assert self.acceleration is not None
        assert self.density_ratio is not None
        return stokes_number * self.acceleration * (1.0 - 1.0 / self.density_ratio)


class Forces(Section):
    """External force (mu c^2/tau) and torque (mu c^3/tau); all that are given add up."""

    force: TimedVector | None = Field(
        default=None,
        description="fixed in space: 3 numbers or expressions in t, a table, or file.py:function",
        examples=[[0.0, 0.0, -1.0]],
    )
    torque: TimedVector | None = Field(
        default=None,
        description="fixed in space, about the centre",
        examples=[[0.0, 0.0, "sin(2*pi*t)"]],
    )
    body_force: TimedVector | None = Field(
        default=None, description="fixed in the body, D3 last", examples=[[0.0, 0.0, 1.0]]
    )
    body_torque: TimedVector | None = Field(
        default=None, description="fixed in the body, D3 last", examples=[[0.0, 0.0, 1.0]]
    )
    gravity: Gravity | None = Field(default=None, description="weight less buoyancy")

    @property
    def given(self) -> bool:
        """Whether there is any."""
        return any(getattr(self, name) is not None for name in type(self).model_fields)
