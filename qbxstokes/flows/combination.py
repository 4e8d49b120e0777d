"""Sums of flows, and any flow moved, turned and scaled."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.errors import FlowError
from qbxstokes.flows.base import Array, Flow, check_keys, number, tensor
from qbxstokes.flows.polynomial import PolynomialFlow


def add_flows(flows: Iterable[Flow]) -> Flow:
    """Sum of flows: one PolynomialFlow if all are polynomial, else a SumFlow in which they are.

    Raises FlowError for no flow at all.
    """
    polynomial: PolynomialFlow | None = None
    others: list[Flow] = []
    pending = list(flows)
    if not pending:
        raise FlowError("flow 'sum' needs at least one term")
    while pending:
        flow = pending.pop(0)
        part = flow.polynomial
        if part is not None:
            polynomial = part if polynomial is None else polynomial.plus(part)
        elif isinstance(flow, SumFlow):
            pending = [*flow.terms, *pending]
        else:
            others.append(flow)
    if polynomial is not None:
        if not others:
            return polynomial
        others.insert(0, polynomial)
    return others[0] if len(others) == 1 else SumFlow(others)


class SumFlow(Flow):
    """Sum of flows of which at most one is polynomial; made by `add_flows`."""

    type_name = "sum"

    def __init__(self, terms: Sequence[Flow]) -> None:
        self.terms = tuple(terms)
        self.length = min(flow.length for flow in self.terms)

    @classmethod
    def from_spec(cls, spec: Mapping[str, Any]) -> Flow:
        """Sum of {"terms": [spec, ...]}; raises FlowError that names the term."""
        from qbxstokes.flows.registry import build_flow

        check_keys(spec, ["terms"], cls.type_name)
        terms = spec.get("terms")
        if not isinstance(terms, Sequence) or isinstance(terms, str) or not terms:
            raise FlowError(f"flow 'sum' needs 'terms', a list of flows, not {terms!r}", ("terms",))
        built = []
        for index, term in enumerate(terms):
            try:
                built.append(build_flow(term))
            except FlowError as error:
                key = ("terms", index, *error.key)
                raise FlowError(f"term {index + 1} of the sum: {error}", key) from None
        flow = add_flows(built)
        if isinstance(flow, PolynomialFlow):
            return flow.named({"type": cls.type_name, "terms": list(terms)})
        return flow

    def velocity(self, x: ArrayLike, t: float = 0.0) -> Array:
        """Velocity (..., 3)."""
        return self._total([flow.velocity(x, t) for flow in self.terms])

    def gradient(self, x: ArrayLike, t: float = 0.0) -> Array:
        """Velocity gradient (..., 3, 3)."""
        return self._total([flow.gradient(x, t) for flow in self.terms])

    def laplacian(self, x: ArrayLike, t: float = 0.0) -> Array:
        """Laplacian (..., 3)."""
        return self._total([flow.laplacian(x, t) for flow in self.terms])

    def pressure(self, x: ArrayLike, t: float = 0.0) -> Array:
        """Pressure (...)."""
        return self._total([flow.pressure(x, t) for flow in self.terms])

    def vorticity_of_laplacian(
        self, x: ArrayLike, t: float = 0.0, reach: float | None = None
    ) -> Array:
        """Curl of the Laplacian (..., 3)."""
        return self._total([flow.vorticity_of_laplacian(x, t, reach) for flow in self.terms])

    @staticmethod
    def _total(parts: list[Array]) -> Array:
        total = parts[0]
        for part in parts[1:]:
            total = total + part
        return total

    @property
    def steady(self) -> bool:
        """Whether all terms are."""
        return all(flow.steady for flow in self.terms)

    @property
    def singular_points(self) -> Array:
        """Singular points of all terms (n, 3)."""
        return np.concatenate([flow.singular_points for flow in self.terms])

    @property
    def singular_points_known(self) -> bool:
        """Whether all terms' are."""
        return all(flow.singular_points_known for flow in self.terms)

    def spec(self) -> dict[str, Any]:
        """Specification with one term for each flow of the sum."""
        return {"type": self.type_name, "terms": [flow.spec() for flow in self.terms]}

    def shifted(self, displacement: ArrayLike) -> Flow:
        """The sum of the moved terms."""
        return add_flows(flow.shifted(displacement) for flow in self.terms)

    def rotated(self, rotation: ArrayLike) -> Flow:
        """The sum of the turned terms."""
        return add_flows(flow.rotated(rotation) for flow in self.terms)

    def scaled(self, factor: float) -> Flow:
        """The sum of the scaled terms."""
        return add_flows(flow.scaled(factor) for flow in self.terms)


class TransformedFlow(Flow):
    """u'(x) = factor R u(R^T (x - position)) of any flow u, for those with no closed form of it."""

    type_name = "transformed"

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
        self.length = flow.length

    @classmethod
    def keys(cls) -> dict[str, Any]:
        """`flow` and `factor`; position and rotation are keys that every flow has."""
        known = super().keys()
        return {name: known[name] for name in ("flow", "factor")}

    @classmethod
    def from_spec(cls, spec: Mapping[str, Any]) -> Flow:
        """Flow {"flow": spec, "factor": number}, moved and turned by the keys every flow has."""
        from qbxstokes.flows.registry import build_flow

        check_keys(spec, list(cls.keys()), cls.type_name)
        if "flow" not in spec:
            raise FlowError("flow 'transformed' needs 'flow', the flow to scale, move or turn")
        try:
            flow = build_flow(spec["flow"])
        except FlowError as error:
            raise FlowError(str(error), ("flow", *error.key)) from None
        return flow.scaled(number(spec.get("factor", 1.0), "factor"))

    def _inner(self, x: ArrayLike) -> Array:
        result: Array = (np.asarray(x, dtype=float) - self.position) @ self.rotation
        return result

    def _turn_gradient(self, gradient: Array) -> Array:
        result: Array = self.factor * (self.rotation @ gradient @ self.rotation.T)
        return result

    def _turn_vector(self, vector: Array) -> Array:
        result: Array = self.factor * (vector @ self.rotation.T)
        return result

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

    @property
    def steady(self) -> bool:
        """Whether the flow is."""
        return self.flow.steady

    @property
    def singular_points(self) -> Array:
        """Singular points (n, 3), moved with the flow."""
        result: Array = self.flow.singular_points @ self.rotation.T + self.position
        return result

    @property
    def singular_points_known(self) -> bool:
        """Whether the flow's are."""
        return self.flow.singular_points_known

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
