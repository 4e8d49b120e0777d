"""Polynomial Stokes flows of degree <= 3, held as Taylor tensors about an origin of their own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from itertools import permutations, product
from math import factorial
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.errors import FlowError
from qbxstokes.flows.base import Build, Flow
from qbxstokes.flows.differences import curl
from qbxstokes.flows.domain import Domain, moved
from qbxstokes.flows.values import (
    Exponents,
    check_keys,
    number,
    parse_monomial,
    rotation_matrix,
    settled,
    tensor,
)
from qbxstokes.flows.values import traceless as solenoidal
from qbxstokes.typing import Array, Booleans

_TENSOR_KEYS = ("value", "gradient", "hessian", "third")
# Traces and antisymmetric parts below this, relative to the tensor, are rounding.


class PolynomialFlow(Flow):
    """u_i(x) = value_i + A_ij y_j + B_ijk y_j y_k / 2 + C_ijkl y_j y_k y_l / 6, y = x - origin.

    value (3,), gradient_tensor A (3, 3), hessian B (3, 3, 3), third C (3, 3, 3, 3) are the
    derivatives at `origin` (3,), B and C symmetric in their derivative indices. The sums hold
    only terms that are present, so that a coordinate on which the flow does not depend costs no
    digits however large it grows (a body carried 1e6 lengths downstream). A flow that is moved
    takes its origin along and keeps its tensors: none of its digits are lost either.

    The constructor takes tensors as they are; `from_spec` refuses those of no Stokes flow.
    """

    type_name = "polynomial"
    linear_in: ClassVar[tuple[str, ...]] = ("coefficients", *_TENSOR_KEYS)
    degree: int  # 0 to 3; terms that are exactly zero do not count

    def __init__(
        self,
        value: ArrayLike | None = None,
        gradient: ArrayLike | None = None,
        hessian: ArrayLike | None = None,
        third: ArrayLike | None = None,
        origin: ArrayLike = (0.0, 0.0, 0.0),
        domain: Domain = (),
    ) -> None:
        """Taylor tensors at the origin; a missing one is zero. Raises FlowError.

        domain: the surfaces inside which the flow is known, in space.
        """
        self.domain = domain
        tensors = []
        for rank, (name, given) in enumerate(
            zip(_TENSOR_KEYS, (value, gradient, hessian, third), strict=True), start=1
        ):
            shape = (3,) * rank
            array = np.zeros(shape) if given is None else tensor(given, name, shape)
            if rank > 2 and given is not None:
                must = f"{name} must be symmetric in its derivative indices (all but the first)"
                orders = [(0, *order) for order in permutations(range(1, rank))]
                mean = np.mean([array.transpose(order) for order in orders], axis=0)
                array = settled(array, mean, must, (name,))
            array.flags.writeable = False
            tensors.append(array)
        self.value: Array = tensors[0]
        self.gradient_tensor: Array = tensors[1]
        self.hessian: Array = tensors[2]
        self.third: Array = tensors[3]
        self.origin: Array = tensor(origin, "origin", (3,))
        self.degree = max([rank for rank in (1, 2, 3) if tensors[rank].any()], default=0)
        self._spec: dict[str, Any] | None = None

    # -- construction -----------------------------------------------------------------------

    @classmethod
    def of(cls, tensors: Sequence[Array], origin: Array, domain: Domain) -> PolynomialFlow:
        """The flow of four tensors that are known to be right."""
        flow = PolynomialFlow.__new__(PolynomialFlow)
        flow.value, flow.gradient_tensor, flow.hessian, flow.third = tensors
        flow.origin, flow.domain, flow._spec = origin, domain, None
        flow.degree = max([rank for rank in (1, 2, 3) if tensors[rank].any()], default=0)
        return flow

    @classmethod
    def keys(cls) -> dict[str, Any]:
        """Keys of the specification with their defaults; `coefficients` or tensors."""
        if cls is not PolynomialFlow:
            return super().keys()
        keys = {"coefficients": None, **super().keys()}
        del keys["origin"], keys["domain"]  # the key `position`, which every flow has; all space
        return keys

    @classmethod
    def from_spec(cls, spec: Mapping[str, Any], build: Build) -> Flow:
        """Polynomial flow from `coefficients` per monomial or from its Taylor tensors.

        {"coefficients": {"u1": {"x2^2": 1.0, "x3^2": 1.0}}} or any of {"value", "gradient",
        "hessian", "third"} as nested lists of derivatives at the origin. Named flows, which
        derive from this class, take their constructor's arguments instead.
        Raises FlowError if the result is not a Stokes flow.
        """
        flow = cls.unchecked(spec, build)
        return flow.stokesian() if cls is PolynomialFlow else flow

    @classmethod
    def unchecked(cls, spec: Mapping[str, Any], build: Build) -> PolynomialFlow:
        """The same, Stokesian or not."""
        if cls is not PolynomialFlow:
            flow = super().from_spec(spec, build)
            assert isinstance(flow, PolynomialFlow)
            return flow
        check_keys(spec, list(cls.keys()), cls.type_name)
        if "coefficients" in spec:
            if len(spec) > 1:
                raise FlowError(
                    "flow 'polynomial' takes either 'coefficients' or tensors "
                    f"({', '.join(_TENSOR_KEYS)}), not both",
                    ("coefficients",),
                )
            return cls.from_coefficients(spec["coefficients"])
        if not spec:
            raise FlowError(
                "flow 'polynomial' needs 'coefficients', e.g. "
                "{u1: {x2^2: 1.0, x3^2: 1.0}}, or tensors "
                f"({', '.join(_TENSOR_KEYS)})"
            )
        return cls(**{str(key): value for key, value in spec.items()})

    @classmethod
    def from_coefficients(cls, coefficients: Mapping[str, Any]) -> PolynomialFlow:
        """Flow from {"u1": {"x2^2": 1.0, "x2*x3": 2.0}, ...}; raises FlowError.

        Monomials are products of x1, x2, x3 with optional powers (x2^2, x1*x3, x1 x3^2) or 1, of
        total degree at most 3; a component that is not named is zero.
        """
        if not isinstance(coefficients, Mapping):
            raise FlowError(
                "coefficients must map u1, u2, u3 to monomials, e.g. "
                f"{{u1: {{x2^2: 1.0}}}}, not {coefficients!r}",
                ("coefficients",),
            )
        for name in coefficients:
            if name not in ("u1", "u2", "u3"):
                raise FlowError(
                    f"coefficients are of u1, u2 and u3, not {name!r}", ("coefficients", str(name))
                )
        tensors = [np.zeros((3,) * rank) for rank in (1, 2, 3, 4)]
        for name, terms in coefficients.items():
            component = int(name[1]) - 1
            if not isinstance(terms, Mapping):
                raise FlowError(
                    f"coefficients of {name} must map monomials to numbers, e.g. "
                    f"{{x2^2: 1.0}}, not {terms!r}",
                    ("coefficients", name),
                )
            for monomial, given in terms.items():
                key = ("coefficients", name, monomial)
                try:
                    exponents = parse_monomial(str(monomial))
                except FlowError as error:
                    raise FlowError(str(error), key) from None
                coefficient = number(given, f"coefficient of {monomial} in {name}", key=key)
                # d^alpha of c x^alpha is c alpha!, for every order of the derivative indices.
                derivative = coefficient * float(np.prod([factorial(n) for n in exponents]))
                degree = sum(exponents)
                for index in product(range(3), repeat=degree):
                    if all(index.count(j) == exponents[j] for j in range(3)):
                        tensors[degree][(component, *index)] += derivative
        value, gradient, hessian, third = tensors
        return cls(value, gradient, hessian, third)

    def coefficients(self) -> dict[Exponents, Array]:
        """Monomial exponents of x - origin -> coefficients (3,) of the components, no zeros."""
        result: dict[Exponents, Array] = {}
        for degree, derivatives in enumerate(self.tensors[: self.degree + 1]):
            for index in product(range(3), repeat=degree):
                if list(index) != sorted(index):
                    continue
                exponents = (index.count(0), index.count(1), index.count(2))
                alpha = np.prod([factorial(n) for n in exponents])
                coefficient = np.moveaxis(derivatives, 0, -1)[index] / alpha
                if coefficient.any():
                    result[exponents] = coefficient
        return result

    def stokesian(self) -> PolynomialFlow:
        """The flow, if div u = 0 and curl Lap u = 0 to rounding, term by term; or FlowError.

        Numbers of single precision make way for the nearest that are right (`values.settled`).
        """
        tensors = [self.value]
        for derivatives in self.tensors[1:]:
            trace = np.einsum("ii...->...", derivatives)
            worst = np.unravel_index(np.abs(trace).argmax(), trace.shape) if trace.ndim else ()
            monomial = "*".join(f"x{j + 1}" for j in worst) or "1"
            must = (
                f"flow is not solenoidal: its terms of degree {trace.ndim + 1} give div u the "
                f"term {monomial} (residual {np.abs(trace).max():.6g}), which must vanish"
            )
            tensors.append(settled(derivatives, solenoidal(derivatives), must))
        pull = np.einsum("ijkk->ij", tensors[3])
        must = (
            "flow is not Stokesian: the curl of the Laplacian of its cubic terms is "
            f"{curl(pull).tolist()} and must vanish, so that a pressure exists"
        )
        turning = np.multiply.outer(0.1 * (pull - pull.T), np.eye(3))
        turning = turning + turning.swapaxes(1, 2) + turning.swapaxes(1, 3)
        tensors[3] = settled(tensors[3], tensors[3] - turning, must)
        value, gradient, hessian, third = tensors
        return PolynomialFlow(value, gradient, hessian, third, self.origin)

    # -- evaluation -------------------------------------------------------------------------

    def velocity(self, x: ArrayLike, t: float = 0.0) -> Array:
        """Velocity (..., 3): one product of the monomials present with their coefficients."""
        points = self._from_origin(x)
        if self.degree <= 1:
            return np.asarray(points @ self.gradient_tensor.T + self.value)
        powers, matrix = self._monomials
        monomials = np.empty((*points.shape[:-1], len(powers)))
        for column, exponents in enumerate(powers):
            out = monomials[..., column]
            first = True
            for axis, power in enumerate(exponents):
                for _ in range(power):
                    if first:
                        out[...] = points[..., axis]
                        first = False
                    else:
                        out *= points[..., axis]
            if first:
                out[...] = 1.0
        return np.asarray(monomials @ matrix)

    @cached_property
    def _monomials(self) -> tuple[list[Exponents], Array]:
        """Exponents of the terms present, and their coefficients (n, 3)."""
        found = self.coefficients()
        return list(found), np.array(list(found.values())).reshape(-1, 3)

    def derivatives(self, x: ArrayLike) -> tuple[Array, Array, Array, Array]:
        """(u, A, B, C) at the points: (..., 3), (..., 3, 3), (..., 3, 3, 3), (..., 3, 3, 3, 3).

        The highest derivatives are constant; constant ones are read-only broadcast views.
        """
        points = self._from_origin(x)
        lead = points.shape[:-1]
        third = np.broadcast_to(self.third, (*lead, 3, 3, 3, 3))
        hessian = np.broadcast_to(self.hessian, (*lead, 3, 3, 3))
        gradient = np.broadcast_to(self.gradient_tensor, (*lead, 3, 3))
        if self.degree >= 2:
            gradient = gradient + (points @ self.hessian.reshape(9, 3).T).reshape(*lead, 3, 3)
        if self.degree >= 3:
            slope = (points @ self.third.reshape(27, 3).T).reshape(*lead, 3, 3, 3)
            hessian = hessian + slope
            gradient = gradient + 0.5 * np.matmul(slope, points[..., None, :, None])[..., 0]
        return self.velocity(x), gradient, hessian, third

    def gradient(self, x: ArrayLike, t: float = 0.0) -> Array:
        """Velocity gradient (..., 3, 3)."""
        if self.degree <= 1:
            return np.broadcast_to(self.gradient_tensor, (*np.shape(x)[:-1], 3, 3))
        return self.derivatives(x)[1]

    def odd_about(self, x: ArrayLike) -> Booleans:
        """Whether u(x + r) = -u(x - r) for all r, exactly, shape (...)."""
        if self.degree <= 1:
            return np.asarray(~np.any(self.velocity(x), axis=-1))
        u, _, hessian, _ = self.derivatives(x)
        return np.asarray(~(np.any(u, axis=-1) | np.any(hessian, axis=(-3, -2, -1))))

    def laplacian(self, x: ArrayLike, t: float = 0.0) -> Array:
        """Laplacian B_ikk + C_ijkk y_j, shape (..., 3)."""
        points = self._from_origin(x)
        slope = np.einsum("ijkk->ij", self.third)
        return np.asarray(np.einsum("ikk->i", self.hessian) + points @ slope.T)

    def pressure(self, x: ArrayLike, t: float = 0.0) -> Array:
        """Pressure B_ikk y_i + C_ijkk y_i y_j / 2, zero at the origin, shape (...)."""
        points = self._from_origin(x)
        slope = np.einsum("ijkk->ij", self.third)
        mean = np.einsum("ikk->i", self.hessian) + 0.5 * points @ slope.T
        return np.asarray(np.sum(points * mean, axis=-1))

    def vorticity_of_laplacian(
        self, x: ArrayLike, t: float = 0.0, reach: float | None = None
    ) -> Array:
        """Curl of the Laplacian, a constant of the cubic terms, shape (..., 3)."""
        constant = curl(np.einsum("ijkk->ij", self.third))
        return np.broadcast_to(constant, np.shape(x)).copy()

    # -- structure --------------------------------------------------------------------------

    @property
    def polynomial(self) -> PolynomialFlow:
        """The flow itself."""
        return self

    def spec(self) -> dict[str, Any]:
        """Specification; without a name of its own, the tensors of the flow."""
        if self._spec is not None:
            return dict(self._spec)
        kept = {
            key: array.tolist()
            for rank, (key, array) in enumerate(zip(_TENSOR_KEYS, self.tensors, strict=True))
            if rank == 0 or array.any()
        }
        place = {"position": self.origin.tolist()} if self.origin.any() else {}
        return {"type": "polynomial", **kept, **place}

    def shifted(self, displacement: ArrayLike) -> PolynomialFlow:
        """The flow moved, u'(x) = u(x - displacement): its origin moves."""
        way = tensor(displacement, "position", (3,))
        flow = self.of(self.tensors, self.origin + way, moved(self.domain, np.eye(3), way))
        return self._carried(flow, np.eye(3), way)

    def about(self, origin: ArrayLike) -> PolynomialFlow:
        """The same flow by its derivatives at another origin."""
        place = tensor(origin, "origin", (3,))
        return (
            self
            if np.array_equal(place, self.origin)
            else self.of(self.derivatives(place), place, self.domain)
        )

    def rotated(self, rotation: ArrayLike) -> PolynomialFlow:
        """The flow turned about the space origin, u'(x) = R u(R^T x): tensors turned by R."""
        turn = tensor(rotation, "rotation", (3, 3))
        hessian = np.einsum("ai,bj,ck,ijk->abc", turn, turn, turn, self.hessian, optimize=True)
        third = np.einsum(
            "ai,bj,ck,dl,ijkl->abcd", turn, turn, turn, turn, self.third, optimize=True
        )
        tensors = (turn @ self.value, turn @ self.gradient_tensor @ turn.T, hessian, third)
        flow = self.of(tensors, turn @ self.origin, moved(self.domain, turn, np.zeros(3)))
        return self._carried(flow, turn, np.zeros(3))

    def scaled(self, factor: float) -> PolynomialFlow:
        """The flow times a number."""
        s = number(factor, "factor")
        tensors = [s * derivatives for derivatives in self.tensors]
        flow = self.of(tensors, self.origin, self.domain)
        spec = {"type": "transformed", "flow": self.spec(), "factor": s}
        return flow.named(spec) if self.domain else flow

    def _carried(self, flow: PolynomialFlow, turn: Array, way: Array) -> PolynomialFlow:
        """This flow turned and moved, with a specification that tells of its walls.

        Tensors alone would leave them out; a flow without walls is written down as its tensors.
        """
        if self.domain and self._spec is not None:
            rotation = turn @ rotation_matrix(self._spec.get("rotation", np.eye(3)))
            position = (
                turn @ tensor(self._spec.get("position", np.zeros(3)), "position", (3,)) + way
            )
            moves = {"rotation": rotation.tolist(), "position": position.tolist()}
            return flow.named({**self._spec, **moves})
        return flow

    def plus(self, other: PolynomialFlow) -> PolynomialFlow:
        """Sum of two polynomial flows as one, about the origin of the first."""
        pairs = zip(self.tensors, other.about(self.origin).tensors, strict=True)
        domain = self.domain + other.domain
        flow = self.of([one + two for one, two in pairs], self.origin, domain)
        return flow.named({"type": "sum", "terms": [self.spec(), other.spec()]}) if domain else flow

    def named(self, spec: Mapping[str, Any]) -> PolynomialFlow:
        """The same flow, remembering the specification it was built from."""
        flow = self.of(self.tensors, self.origin, self.domain)
        flow._spec = dict(spec)
        return flow

    @property
    def tensors(self) -> tuple[Array, Array, Array, Array]:
        """Value, gradient, second and third derivatives at the origin."""
        return self.value, self.gradient_tensor, self.hessian, self.third

    def _from_origin(self, x: ArrayLike) -> Array:
        """Points relative to the origin."""
        points = np.asarray(x, dtype=float)
        return points - self.origin if self.origin.any() else points
