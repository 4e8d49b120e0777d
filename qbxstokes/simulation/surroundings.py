"""What is beside the bodies of a fluid: a plane wall, and a repulsion that keeps them apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.bie.multiple_scattering import Placed, Plane, gaps_of
from qbxstokes.errors import SceneError
from qbxstokes.flows import Flow
from qbxstokes.geometry.gaps import contact_point
from qbxstokes.typing import Array

_LEFT_OUT = 40.0  # ranges beyond which nothing is left of a repulsion but rounding


class Wall(Plane):
    """A plane wall: normal (3,) into the fluid, a point of it, and its own velocity, in its plane.

    >>> import qbxstokes as qs
    >>> qs.Wall(normal=[0, 2, 0]).normal
    array([0., 1., 0.])
    """

    def __init__(
        self,
        normal: ArrayLike = (0.0, 1.0, 0.0),
        point: ArrayLike = (0.0, 0.0, 0.0),
        velocity: ArrayLike = (0.0, 0.0, 0.0),
    ) -> None:
        vectors = {"normal": normal, "point": point, "velocity": velocity}
        found = {}
        for name, given in vectors.items():
            vector = np.asarray(given, dtype=np.float64)
            if vector.shape != (3,) or not np.all(np.isfinite(vector)):
                raise SceneError(f"surroundings.{name}", f"is {given!r}", "three finite numbers")
            found[name] = vector
        length = float(np.linalg.norm(found["normal"]))
        if length == 0.0:
            raise SceneError("surroundings.normal", "has no direction", "a vector into the fluid")
        super().__init__(found["normal"] / length, found["point"], found["velocity"])
        through = float(self.velocity @ self.normal)
        if abs(through) > 1e-12 * float(np.abs(self.velocity).max()):
            raise SceneError(
                "surroundings.velocity", "goes through the wall", "a velocity in its plane"
            )

    def check(self, flow: Flow, t: float = 0.0) -> None:
        """Refuse a flow that has not the wall's velocity on the wall."""
        across = np.linalg.svd(self.normal[None, :])[2][1:]
        grid = np.stack(np.meshgrid([-7.0, -1.3, 0.0, 0.9, 4.0], [-5.0, -0.7, 0.4, 6.0]), axis=-1)
        points = self.point + grid.reshape(-1, 2) @ across
        slip = np.linalg.norm(flow.velocity(points, t) - self.velocity, axis=-1)
        inside = np.linalg.norm(flow.velocity(points + self.normal, t), axis=-1).max()
        scale = max(float(np.linalg.norm(self.velocity)), float(inside))
        worst = int(np.argmax(slip))
        if slip[worst] > 1e-9 * scale:
            raise SceneError(
                "flow",
                f"slips on the wall: at {np.round(points[worst], 6).tolist()} its velocity differs "
                f"by {slip[worst]:.3g} from the wall's",
                "a flow with the wall's velocity on the wall, such as shear above the plane x2 = 0",
            )


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
