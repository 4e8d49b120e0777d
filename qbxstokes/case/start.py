"""Section `start`: where the body is, how it lies and how it moves at time 0."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from qbxstokes.case.base import Angle, Quadruple, Vector, describe, entries, to_number
from qbxstokes.case.model import Convert, Field, Problem, Section


class EulerAngles(Section):
    """Orientation R = R3(phi) R1(theta) R3(psi)."""

    phi: Angle = Field(default=0.0, description="phi, radians or '90 deg'", examples=[0.0])
    theta: Angle = Field(
        default=0.0, description="theta, angle from e3 to D3, radians or '90 deg'", examples=[1.2]
    )
    psi: Angle = Field(default=0.0, description="psi, radians or '90 deg'", examples=[0.0])


def _orbit_constant(value: Any) -> float:
    if value in ("inf", ".inf", math.inf):
        return math.inf
    return to_number(value)


class Orbit(Section):
    """Axis on a Jeffery orbit of the shear u = (x2, 0, 0).

    D3 is along (C cos(phase), -C k sin(phase), 1); the phase of a massless body grows steadily by
    360 deg a period, and phase 0 is an axis in the plane of x1 and x3.
    """

    constant: Annotated[float, Convert(_orbit_constant), Field(ge=0)] = Field(
        description="orbit constant C = tan(theta) at phase 0: 0 is log-rolling, inf tumbling",
        examples=[1.0],
    )
    phase: Angle = Field(default=0.0, description="phase, radians or '90 deg'", examples=[0.0])


class Orientation(Section):
    """Orientation in exactly one of four forms."""

    quaternion: Quadruple | None = Field(
        default=None,
        description="[q0, q1, q2, q3], scalar first, body to space; normalised",
        examples=[[1.0, 0.0, 0.0, 0.0]],
    )
    euler: EulerAngles | None = Field(default=None, description="Euler angles phi, theta, psi")
    axis: Vector | None = Field(
        default=None,
        description="direction of the symmetry axis D3 in space; normalised",
        examples=[[0.0, 0.6, 0.8]],
    )

    orbit: Orbit | None = Field(
        default=None, description="Jeffery orbit of a shear (x2, 0, 0): constant and phase"
    )

    def _check(self) -> None:
        given = [name for name in type(self).model_fields if getattr(self, name) is not None]
        if len(given) != 1:
            wrong = f"gives {' and '.join(given)}" if given else "gives no orientation"
            raise Problem(wrong, "give exactly one of quaternion, euler, axis, orbit")
        for name in ("quaternion", "axis"):
            value = getattr(self, name)
            if value is not None and not any(value):
                raise Problem("is zero and has no direction", "any non-zero value", (name,))


def _velocity(value: Any) -> Any:
    if value == "with_flow":
        return value
    if isinstance(value, (list, tuple)):
        return tuple(to_number(entry) for entry in entries(3, "[v1, v2, v3]")(value))
    raise Problem(f"is {describe(value)}", "write with_flow or three numbers [v1, v2, v3]")


Velocity = Annotated[
    Literal["with_flow"] | tuple[float, float, float],
    Convert(_velocity, json=Literal["with_flow"] | list[float | str]),
]


class Start(Section):
    """Position, orientation and velocities at time 0."""

    position: Vector = Field(
        default=(0.0, 0.0, 0.0),
        description="centre of the body, in lengths c",
        examples=[[0.0, 0.0, 0.0]],
    )
    orientation: Orientation = Field(
        default=Orientation(axis=(0.0, 0.0, 1.0)),
        description="orientation as quaternion, euler, axis or orbit",
    )
    velocity: Velocity = Field(
        default="with_flow",
        description="[v1, v2, v3] in space, or with_flow: force-free (needs stokes_number > 0)",
        examples=["with_flow"],
    )
    angular_velocity: Velocity = Field(
        default="with_flow",
        description="[w1, w2, w3] in space, or with_flow: torque-free (needs stokes_number > 0)",
        examples=["with_flow"],
    )
