"""Any flow moved, turned and scaled."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.errors import FlowError
from qbxstokes.flows.base import Build, Flow
from qbxstokes.flows.domain import moved
from qbxstokes.flows.values import check_keys, number, tensor
from qbxstokes.typing import Array


class TransformedFlow(Flow):
    """u'(x) = factor R u(R^T (x - position)) of any flow u, for those with no closed form of it."""

    type_name = "transformed"
    linear_in = ("factor",)

    def __init__(
        self,
        flow: Flow,
        rotation: ArrayLike | None = None,
        position: ArrayLike = (0.0, 0.0, 0.0),
        factor: float = 1.0,
    ) -> None:
        self.flow = flow
        self.rotation: Array = (
            np.eye(3) if rotation is None else tensor(rotation, "rotation", (3, 3))
        )
        self.position = tensor(position, "position", (3,))
        self.factor = number(factor, "factor")
        self.length, self.spacing, self.signals = flow.length, flow.spacing, flow.signals
        self.recognise, self.steady = flow.recognise, flow.steady
        self.singular_points = flow.singular_points @ self.rotation.T + self.position
        self.singular_points_known = flow.singular_points_known
        self.domain = moved(flow.domain, self.rotation, self.position)

    @classmethod
    def keys(cls) -> dict[str, Any]:
        """`flow` and `factor`; position and rotation are keys that every flow has."""
        known = super().keys()
        return {name: known[name] for name in ("flow", "factor")}

    @classmethod
    def from_spec(cls, spec: Mapping[str, Any], build: Build) -> Flow:
        """Flow {"flow": spec, "factor": number}, moved and turned by the keys every flow has."""
        check_keys(spec, list(cls.keys()), cls.type_name)
        if "flow" not in spec:
            raise FlowError("flow 'transformed' needs 'flow', the flow to scale, move or turn")
        try:
            flow = build(spec["flow"])
        except FlowError as error:
            raise FlowError(str(error), ("flow", *error.key)) from None
        return flow.scaled(number(spec.get("factor", 1.0), "factor"))

    def _inner(self, x: ArrayLike) -> Array:
        return np.asarray((np.asarray(x, dtype=float) - self.position) @ self.rotation)

    def _turn_gradient(self, gradient: Array) -> Array:
        return np.asarray(self.factor * (self.rotation @ gradient @ self.rotation.T))

    def _turn_vector(self, vector: Array) -> Array:
        return np.asarray(self.factor * (vector @ self.rotation.T))

    def breaks(self, end: float, rough: float = 0.0) -> Array:
        """Those of the flow."""
        return self.flow.breaks(end)

    def until(self, t: float, since: float = -math.inf) -> None:
        """So does the flow."""
        self.flow.until(t, since)

    def velocity(self, x: ArrayLike, t: float = 0.0) -> Array:
        """Velocity (..., 3)."""
        return self._turn_vector(self.flow.velocity(self._inner(x), t))

    def gradient(self, x: ArrayLike, t: float = 0.0) -> Array:
        """Velocity gradient (..., 3, 3)."""
        return self._turn_gradient(self.flow.gradient(self._inner(x), t))

    def laplacian(self, x: ArrayLike, t: float = 0.0) -> Array:
        """Laplacian (..., 3)."""
        return self._turn_vector(self.flow.laplacian(self._inner(x), t))

    def pressure(self, x: ArrayLike, t: float = 0.0) -> Array:
        """Pressure (...)."""
        return self.factor * self.flow.pressure(self._inner(x), t)

    def vorticity_of_laplacian(
        self, x: ArrayLike, t: float = 0.0, reach: float | None = None
    ) -> Array:
        """Curl of the Laplacian (..., 3)."""
        return self._turn_vector(self.flow.vorticity_of_laplacian(self._inner(x), t, reach))

    def spec(self) -> dict[str, Any]:
        """Specification that moves, turns and scales that of the flow."""
        return {
            "type": self.type_name,
            "flow": self.flow.spec(),
            "factor": self.factor,
            "rotation": self.rotation.tolist(),
            "position": self.position.tolist(),
        }

    def shifted(self, displacement: ArrayLike) -> TransformedFlow:
        """The flow moved further."""
        position = self.position + tensor(displacement, "position", (3,))
        return TransformedFlow(self.flow, self.rotation, position, self.factor)

    def rotated(self, rotation: ArrayLike) -> TransformedFlow:
        """The flow turned further about the space origin."""
        turn = tensor(rotation, "rotation", (3, 3))
        return TransformedFlow(self.flow, turn @ self.rotation, turn @ self.position, self.factor)

    def scaled(self, factor: float) -> TransformedFlow:
        """The flow times a further number."""
        return TransformedFlow(self.flow, self.rotation, self.position, self.factor * factor)


class Transformable(Flow):
    """A flow with no closed form of what it becomes moved, turned or scaled."""

    def shifted(self, displacement: ArrayLike) -> Flow:
        """The flow moved."""
        return TransformedFlow(self).shifted(displacement)

    def rotated(self, rotation: ArrayLike) -> Flow:
        """The flow turned about the space origin."""
        return TransformedFlow(self).rotated(rotation)

    def scaled(self, factor: float) -> Flow:
        """The flow times a number."""
        return TransformedFlow(self).scaled(factor)
