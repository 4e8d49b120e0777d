"""What bounds the fluid: a plane wall, to which the flow has to stick."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.bie.multiple_scattering import Plane
from qbxstokes.errors import SceneError
from qbxstokes.flows import Flow


class Wall:
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
        self.normal, self.point = found["normal"] / length, found["point"]
        self.velocity = found["velocity"]
        through = float(self.velocity @ self.normal)
        if abs(through) > 1e-12 * float(np.abs(self.velocity).max()):
            raise SceneError(
                "surroundings.velocity", "goes through the wall", "a velocity in its plane"
            )

    @property
    def plane(self) -> Plane:
        """The wall as the coupling sees it."""
        return Plane(self.normal, self.point, self.velocity)

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
