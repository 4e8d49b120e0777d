"""A short-range repulsion between bodies, and of a wall, that keeps them apart on request."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from qbxstokes.bie.multiple_scattering import Placed, Plane, gaps_of
from qbxstokes.errors import SceneError
from qbxstokes.geometry.gaps import contact_point
from qbxstokes.typing import Array

_LEFT_OUT = 40.0  # ranges beyond which nothing is left but rounding


@dataclass(frozen=True)
class Repulsion:
    """Forces strength exp(-gap/range) along the least distance, at its two ends.

    strength: in mu c^2/tau; range: in units of the scene. No part of the hydrodynamics: what it
    does to a motion is of its making. Raises SceneError for other than positive numbers.
    """

    strength: float
    range: float

    def __post_init__(self) -> None:
        for name in ("strength", "range"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0.0):
                raise SceneError(f"repulsion.{name}", f"is {value!r}", "more than 0")

    def loads(self, bodies: Sequence[Placed], wall: Plane | None) -> tuple[Array, Array]:
        """Force and torque (N, 3) on the bodies, space frame, torque about each centre."""
        force, torque = np.zeros((len(bodies), 3)), np.zeros((len(bodies), 3))
        found = gaps_of(bodies, wall)
        for row in np.flatnonzero(found.gap <= _LEFT_OUT * self.range):
            # From the first body, b, to the other one.
            (b, c), direction = found.pairs[row], found.direction[row]
            size = self.strength * float(np.exp(-max(found.gap[row], 0.0) / self.range))
            for body, push in ((b, -size), (c, size)):
                if body < 0:
                    continue
                place, away = bodies[body], np.copysign(1.0, -push) * direction
                arm = contact_point(away, place.axis, place.ratio, place.size)
                force[body] += push * direction
                torque[body] += push * np.cross(arm, direction)
        return force, torque
