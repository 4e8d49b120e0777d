"""What every background flow offers, and flows made of others: sums, and those moved and turned.

A background flow is a solution of the steady Stokes equations (mu = 1): div u = 0 and
grad p = Lap u. Points have their three coordinates on the last axis and any leading shape; the
gradient is A[..., i, j] = du_i/dx_j. Everything is nondimensional (length c, time tau).
"""

from __future__ import annotations

import inspect
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.errors import FlowError
from qbxstokes.flows.differences import around, curl, gradient_of
from qbxstokes.flows.domain import Domain, moved
from qbxstokes.flows.values import check_keys, number, tensor
from qbxstokes.typing import Array

if TYPE_CHECKING:
    from qbxstokes.flows.polynomial import PolynomialFlow

# What makes a flow from its specification: `qbxstokes.flows.build_flow`.
Build = Callable[[Mapping[str, Any]], "Flow"]


class Flow(ABC):
    """A background flow; subclasses supply the velocity and its derivatives.

    The arguments of a subclass's constructor are the keys of its specification (`from_spec`), so
    that a new flow needs one file and one line in `qbxstokes.flows.registry`.
    """

    type_name: ClassVar[str] = ""
    linear_in: ClassVar[tuple[str, ...]] = ()  # keys whose numbers may change in time (`changing`)
    length: float = 1.0  # over which the flow varies; the largest step of differences is a fifth
    recognise: bool = True  # as a polynomial, where a function is one (`flows.recognition`)
    spacing: float = math.inf  # longest step that misses nothing of what changes in time
    steady: bool = True  # whether it is known not to depend on time
    degree: int | None = None  # of a polynomial, None for another flow
    singular_points: Array = np.empty((0, 3))  # where it is singular
    singular_points_known: bool = True  # whether it is singular nowhere else, for certain
    signals: tuple[Any, ...] = ()  # functions and series of time in it (`flows.signals.Signal`)
    domain: Domain = ()  # surfaces inside which it is known, such as walls; none: it fills space

    @abstractmethod
    def velocity(self, x: ArrayLike, t: float = 0.0) -> Array:
        """Velocity u, shape (..., 3), at points x (..., 3) and time t."""

    @abstractmethod
    def gradient(self, x: ArrayLike, t: float = 0.0) -> Array:
        """Velocity gradient A[..., i, j] = du_i/dx_j, shape (..., 3, 3)."""

    @abstractmethod
    def laplacian(self, x: ArrayLike, t: float = 0.0) -> Array:
        """Laplacian of the velocity (= pressure gradient), shape (..., 3)."""

    @abstractmethod
    def pressure(self, x: ArrayLike, t: float = 0.0) -> Array:
        """Pressure p up to a constant, shape (...)."""

    def breaks(self, end: float, rough: float = 0.0) -> Array:
        """Instants (n,) between 0 and `end` at which the flow is not smooth in time.

        rough: by how much a gradient of samples may be rough there without being told.
        """
        return np.empty(0)

    def until(self, t: float, since: float = -math.inf) -> None:  # noqa: B027
        """Show itself, from now on, as between breaks: at t as just before, at `since` as after."""

    def stress(self, x: ArrayLike, t: float = 0.0) -> Array:
        """Stress sigma = -p I + grad u + (grad u)^T, shape (..., 3, 3)."""
        gradient = self.gradient(x, t)
        stress: Array = gradient + np.swapaxes(gradient, -1, -2)
        return stress - self.pressure(x, t)[..., None, None] * np.eye(3)

    def vorticity_of_laplacian(
        self, x: ArrayLike, t: float = 0.0, reach: float | None = None
    ) -> Array:
        """Curl of the Laplacian, shape (..., 3); zero if and only if a pressure exists.

        By extrapolated central differences of `laplacian`, with steps up to a fifth of `reach`
        (the flow's own length if not given); a subclass overrides it where it knows better.
        """
        points = np.asarray(x, dtype=float)
        steps = self.difference_step(points, reach)
        return curl(gradient_of(lambda y: self.laplacian(y, t), points, steps))

    def difference_step(self, x: Array, reach: float | None = None) -> Array:
        """Largest step, shape (...), for differences at x: kept clear of the singular points."""
        step = np.full(x.shape[:-1], 0.2 * (self.length if reach is None else reach))
        if len(self.singular_points):
            separation = np.linalg.norm(x[..., None, :] - self.singular_points, axis=-1)
            step = np.minimum(step, 0.2 * separation.min(axis=-1))
        return step

    def expansion(self, x: Array, t: float, degree: int) -> tuple[Array, Array, Array | None]:
        """Velocity (n, 3), gradient (n, 3, 3) and, for degree 2, d_j d_k u_i (n, i, j, k) at x.

        By central differences of order 6, all in one call, with steps of a hundredth of the length
        over which the flow varies: relative errors of about 1e-12.
        """
        return around(lambda y: self.velocity(y, t), x, 0.05 * self.difference_step(x), degree)

    def gradients(self, x: Array, t: Array) -> Array:
        """Velocity gradients (T, n, 3, 3) at points (n, 3) and instants (T,)."""
        return np.stack([self.gradient(x, s) for s in t.tolist()])

    @property
    def polynomial(self) -> PolynomialFlow | None:
        """The same flow as one polynomial about the space origin, where it is one."""
        return None

    @abstractmethod
    def spec(self) -> dict[str, Any]:
        """Plain dictionary from which `qbxstokes.flows.build_flow` rebuilds the flow."""

    @classmethod
    def keys(cls) -> dict[str, Any]:
        """Keys of the specification with their defaults (inspect.Parameter.empty: required)."""
        parameters = inspect.signature(cls).parameters
        return {name: parameter.default for name, parameter in parameters.items()}

    @classmethod
    def from_spec(cls, spec: Mapping[str, Any], build: Build) -> Flow:
        """Flow from its specification without the keys `type`, `position` and `rotation`.

        build: makes flows from the specifications that this one holds. Raises FlowError for a key
        that the flow does not know or that is missing.
        """
        known = cls.keys()
        check_keys(spec, list(known), cls.type_name)
        missing = [
            name
            for name, default in known.items()
            if default is inspect.Parameter.empty and name not in spec
        ]
        if missing:
            raise FlowError(f"flow {cls.type_name!r} needs {' and '.join(map(repr, missing))}")
        return cls(**{str(key): value for key, value in spec.items()})

    @classmethod
    def unchecked(cls, spec: Mapping[str, Any], build: Build) -> Flow:
        """The same without looking at whether it is a Stokes flow: one of several that add up."""
        return cls.from_spec(spec, build)

    def joined(self, other: Flow) -> Flow | None:
        """The sum as one flow of this kind, where it is one."""
        return None

    def shifted(self, displacement: ArrayLike) -> Flow:
        """The whole flow moved: u'(x) = u(x - displacement)."""
        return TransformedFlow(self).shifted(displacement)

    def rotated(self, rotation: ArrayLike) -> Flow:
        """The whole flow turned about the space origin: u'(x) = R u(R^T x), R (3, 3)."""
        return TransformedFlow(self).rotated(rotation)

    def scaled(self, factor: float) -> Flow:
        """The flow times a number."""
        return TransformedFlow(self).scaled(factor)

    @property
    def surely_stokesian(self) -> bool:
        """Whether it is known to be a Stokes flow at all times, once it is one."""
        return self.steady

    def __add__(self, other: Flow) -> Flow:
        return add_flows([self, other])

    def __mul__(self, factor: float) -> Flow:
        return self.scaled(factor)

    __rmul__ = __mul__

    def __neg__(self) -> Flow:
        return self.scaled(-1.0)

    def __sub__(self, other: Flow) -> Flow:
        return self + other.scaled(-1.0)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.spec()})"


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
        elif type(flow) is SumFlow:
            pending = [*flow.terms, *pending]
        else:
            others.append(flow)
    terms: list[Flow] = []
    for flow in (*others, *([] if polynomial is None else [polynomial])):
        for place, term in enumerate(terms):
            if (whole := term.joined(flow)) is not None:
                terms[place] = whole
                break
        else:
            terms.insert(0 if flow is polynomial else len(terms), flow)
    return terms[0] if len(terms) == 1 else SumFlow(terms)


class Composed(Flow):
    """A flow made of others, the terms: as fine in space and time, and known where they are.

    A subclass says how their values are put together.
    """

    def __init__(self, terms: Sequence[Flow]) -> None:
        self.terms = tuple(terms)
        self.length = min(flow.length for flow in self.terms)
        self.spacing = min(flow.spacing for flow in self.terms)
        self.recognise = all(flow.recognise for flow in self.terms)
        self.signals = tuple(signal for flow in self.terms for signal in flow.signals)
        self.steady = all(flow.steady for flow in self.terms)
        self.singular_points = np.concatenate([flow.singular_points for flow in self.terms])
        self.singular_points_known = all(flow.singular_points_known for flow in self.terms)
        self.domain = tuple(dict.fromkeys(edge for flow in self.terms for edge in flow.domain))

    @abstractmethod
    def _composed(self, name: str, x: ArrayLike, t: float, *more: Any) -> Array:
        """What the method `name` finds, from that of the terms."""

    def velocity(self, x: ArrayLike, t: float = 0.0) -> Array:
        """Velocity (..., 3)."""
        return self._composed("velocity", x, t)

    def gradient(self, x: ArrayLike, t: float = 0.0) -> Array:
        """Velocity gradient (..., 3, 3)."""
        return self._composed("gradient", x, t)

    def laplacian(self, x: ArrayLike, t: float = 0.0) -> Array:
        """Laplacian (..., 3)."""
        return self._composed("laplacian", x, t)

    def pressure(self, x: ArrayLike, t: float = 0.0) -> Array:
        """Pressure (...)."""
        return self._composed("pressure", x, t)

    def vorticity_of_laplacian(
        self, x: ArrayLike, t: float = 0.0, reach: float | None = None
    ) -> Array:
        """Curl of the Laplacian (..., 3)."""
        return self._composed("vorticity_of_laplacian", x, t, reach)

    def breaks(self, end: float, rough: float = 0.0) -> Array:
        """Those of all terms."""
        found = [flow.breaks(end, rough / len(self.terms)) for flow in self.terms]
        return np.concatenate(found)

    def until(self, t: float, since: float = -math.inf) -> None:
        """So do all terms."""
        for flow in self.terms:
            flow.until(t, since)

    @classmethod
    def _inner(cls, spec: Mapping[str, Any], build: Build) -> Flow:
        """The flow that a specification names as `flow`; raises FlowError that says where."""
        check_keys(spec, list(cls.keys()), cls.type_name)
        if "flow" not in spec:
            raise FlowError(f"flow {cls.type_name!r} needs 'flow', the specification of another")
        try:
            return build(spec["flow"])
        except FlowError as error:
            raise FlowError(str(error), ("flow", *error.key)) from None


class SumFlow(Composed):
    """Sum of flows of which at most one is polynomial; made by `add_flows`."""

    type_name = "sum"

    @classmethod
    def from_spec(cls, spec: Mapping[str, Any], build: Build) -> Flow:
        """Sum of {"terms": [spec, ...]}; raises FlowError that names the term."""
        check_keys(spec, ["terms"], cls.type_name)
        terms = spec.get("terms")
        if not isinstance(terms, Sequence) or isinstance(terms, str) or not terms:
            raise FlowError(f"flow 'sum' needs 'terms', a list of flows, not {terms!r}", ("terms",))
        built = []
        for index, term in enumerate(terms):
            try:
                built.append(build(term))
            except FlowError as error:
                key = ("terms", index, *error.key)
                raise FlowError(f"term {index + 1} of the sum: {error}", key) from None
        flow = add_flows(built)
        whole = flow.polynomial
        return flow if whole is None else whole.named({"type": cls.type_name, "terms": list(terms)})

    def _composed(self, name: str, x: ArrayLike, t: float, *more: Any) -> Array:
        return np.asarray(sum(getattr(flow, name)(x, t, *more) for flow in self.terms))

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


class TransformedFlow(Composed):
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
        super().__init__([flow])
        self.flow = flow
        self.rotation = tensor(np.eye(3) if rotation is None else rotation, "rotation", (3, 3))
        self.position = tensor(position, "position", (3,))
        self.factor = number(factor, "factor")
        self.singular_points = flow.singular_points @ self.rotation.T + self.position
        self.domain = moved(flow.domain, self.rotation, self.position)

    @classmethod
    def keys(cls) -> dict[str, Any]:
        """`flow` and `factor`; position and rotation are keys that every flow has."""
        known = super().keys()
        return {name: known[name] for name in ("flow", "factor")}

    @classmethod
    def from_spec(cls, spec: Mapping[str, Any], build: Build) -> Flow:
        """Flow {"flow": spec, "factor": number}, moved and turned by the keys every flow has."""
        return cls._inner(spec, build).scaled(number(spec.get("factor", 1.0), "factor"))

    def _composed(self, name: str, x: ArrayLike, t: float, *more: Any) -> Array:
        turn = self.rotation
        inside = (np.asarray(x, dtype=float) - self.position) @ turn
        found = getattr(self.flow, name)(inside, t, *more)
        if name == "gradient":
            found = turn @ found @ turn.T
        elif name != "pressure":
            found = found @ turn.T
        return np.asarray(self.factor * found)

    def breaks(self, end: float, rough: float = 0.0) -> Array:
        """Those of the flow, whose gradient may be a larger one."""
        return self.flow.breaks(end)

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
