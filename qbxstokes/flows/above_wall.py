"""A flow with what a plane wall answers to it, such as a stokeslet with its images."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.errors import FlowError
from qbxstokes.flows.base import Build, Flow
from qbxstokes.flows.differences import gradient_of, laplacian_of
from qbxstokes.flows.domain import Plane
from qbxstokes.flows.transformed import Transformable
from qbxstokes.flows.values import check_keys
from qbxstokes.typing import Array

_UP = np.array([0.0, 1.0, 0.0])
_MIRROR = np.array([1.0, -1.0, 1.0])


class AboveWall(Transformable):
    """Any flow that is regular below x2 = 0, held at rest on that plane by its images.

    With ^ for the value at the mirrored point, h = x2 and J = diag(1, -1, 1), Lorentz's reflection
    (Kim & Karrila 1991, section 12.1) adds

        -u^ + 2 h J (grad u_2)^ + h^2 J (grad p)^,   p^ - 2 h (d_2 p)^ - 4 (d_2 u_2)^

    which makes of a stokeslet that of J. R. Blake 1971. The derivatives of the image are taken by
    extrapolated differences.
    """

    type_name = "above_wall"

    def __init__(self, flow: Flow) -> None:
        points = flow.singular_points
        if not flow.singular_points_known or not len(points):
            raise FlowError("flow 'above_wall' needs a singular flow, such as a stokeslet")
        if points[:, 1].min() <= 0.0:
            raise FlowError("flow 'above_wall' needs its singular points above x2 = 0")
        self.flow, self.length, self.spacing = flow, flow.length, flow.spacing
        self.signals = flow.signals
        self.steady, self.domain = flow.steady, (*flow.domain, Plane(np.zeros(3), _UP))
        self.singular_points = points  # those of its image are behind the wall

    @classmethod
    def from_spec(cls, spec: Mapping[str, Any], build: Build) -> Flow:
        """Flow {"flow": spec}; its wall is x2 = 0, moved and turned by the keys every flow has."""
        check_keys(spec, list(cls.keys()), cls.type_name)
        if "flow" not in spec:
            raise FlowError("flow 'above_wall' needs 'flow', such as a stokeslet")
        try:
            return cls(build(spec["flow"]))
        except FlowError as error:
            raise FlowError(str(error), ("flow", *error.key)) from None

    def breaks(self, end: float, rough: float = 0.0) -> Array:
        """Those of the flow."""
        return self.flow.breaks(end)

    def until(self, t: float, since: float = -math.inf) -> None:
        """So does the flow."""
        self.flow.until(t, since)

    def velocity(self, x: ArrayLike, t: float = 0.0) -> Array:
        """Velocity (..., 3)."""
        x = np.asarray(x, dtype=float)
        there, h, flow = x * _MIRROR, x[..., 1, None], self.flow
        lift = 2.0 * h * flow.gradient(there, t)[..., 1, :] + h * h * flow.laplacian(there, t)
        image = lift * _MIRROR - flow.velocity(there, t)
        return np.asarray(flow.velocity(x, t) + image)

    def pressure(self, x: ArrayLike, t: float = 0.0) -> Array:
        """Pressure (...)."""
        x = np.asarray(x, dtype=float)
        there, flow = x * _MIRROR, self.flow
        image = flow.pressure(there, t) - 4.0 * flow.gradient(there, t)[..., 1, 1]
        image = image - 2.0 * x[..., 1] * flow.laplacian(there, t)[..., 1]
        return np.asarray(flow.pressure(x, t) + image)

    def _image(self, x: Array, t: float) -> Array:
        return self.velocity(x, t) - self.flow.velocity(x, t)

    def _step(self, x: Array) -> Array:
        mirrored = self.flow.singular_points * _MIRROR
        away = np.linalg.norm(x[..., None, :] - mirrored, axis=-1).min(axis=-1)
        return np.asarray(0.2 * away)

    def gradient(self, x: ArrayLike, t: float = 0.0) -> Array:
        """Velocity gradient (..., 3, 3)."""
        x = np.asarray(x, dtype=float)
        image = gradient_of(lambda y: self._image(y, t), x, self._step(x))
        return np.asarray(self.flow.gradient(x, t) + image)

    def laplacian(self, x: ArrayLike, t: float = 0.0) -> Array:
        """Laplacian (..., 3)."""
        x = np.asarray(x, dtype=float)
        image = laplacian_of(lambda y: self._image(y, t), x, self._step(x))
        return np.asarray(self.flow.laplacian(x, t) + image)

    def vorticity_of_laplacian(
        self, x: ArrayLike, t: float = 0.0, reach: float | None = None
    ) -> Array:
        """Zero: the image is a Stokes flow where the flow is one."""
        return self.flow.vorticity_of_laplacian(x, t, reach)

    def spec(self) -> dict[str, Any]:
        """Specification with that of the flow."""
        return {"type": self.type_name, "flow": self.flow.spec()}
