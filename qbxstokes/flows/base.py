"""What every background flow offers, and the validation shared by their constructors.

A background flow is a solution of the steady Stokes equations (mu = 1): div u = 0 and
grad p = Lap u. Points have their three coordinates on the last axis and any leading shape; the
gradient is A[..., i, j] = du_i/dx_j. Everything is nondimensional (length c, time tau).
"""

from __future__ import annotations

import difflib
import inspect
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qbxstokes.errors import FlowError

if TYPE_CHECKING:
    from qbxstokes.flows.polynomial import PolynomialFlow

Array = NDArray[np.float64]
Key = tuple[str | int, ...]


class Flow(ABC):
    """A background flow; subclasses supply the velocity and its derivatives.

    The arguments of a subclass's constructor are the keys of its specification (`from_spec`), so
    that a new flow needs one file and one line in `qbxstokes.flows.registry`.
    """

    type_name: ClassVar[str] = ""
    length: float = 1.0  # over which the flow varies; the largest step of differences is a fifth

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
        from qbxstokes.flows.differences import gradient_of

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

    @property
    def polynomial(self) -> PolynomialFlow | None:
        """The same flow as one polynomial about the space origin, where it is one."""
        return None

    @property
    def degree(self) -> int | None:
        """Polynomial degree, None for a flow that is not polynomial."""
        return None

    @property
    def steady(self) -> bool:
        """Whether the flow is known not to depend on time."""
        return True

    @property
    def singular_points(self) -> Array:
        """Points where the flow is singular, shape (n, 3)."""
        return np.empty((0, 3))

    @property
    def singular_points_known(self) -> bool:
        """Whether the flow is singular nowhere but at `singular_points`, for certain."""
        return True

    @abstractmethod
    def spec(self) -> dict[str, Any]:
        """Plain dictionary from which `qbxstokes.flows.build_flow` rebuilds the flow."""

    @classmethod
    def keys(cls) -> dict[str, Any]:
        """Keys of the specification with their defaults (inspect.Parameter.empty: required)."""
        parameters = inspect.signature(cls).parameters
        return {name: parameter.default for name, parameter in parameters.items()}

    @classmethod
    def from_spec(cls, spec: Mapping[str, Any]) -> Flow:
        """Flow from its specification without the keys `type`, `position` and `rotation`.

        Raises FlowError for a key that the flow does not know or that is missing.
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

    @abstractmethod
    def shifted(self, displacement: ArrayLike) -> Flow:
        """The whole flow moved: u'(x) = u(x - displacement)."""

    @abstractmethod
    def rotated(self, rotation: ArrayLike) -> Flow:
        """The whole flow turned about the space origin: u'(x) = R u(R^T x), R (3, 3)."""

    @abstractmethod
    def scaled(self, factor: float) -> Flow:
        """The flow times a number."""

    def __add__(self, other: Flow) -> Flow:
        from qbxstokes.flows.combination import add_flows

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


def curl(gradient: Array) -> Array:
    """Curl (..., 3) from the gradient A[..., i, j] = df_i/dx_j."""
    return np.stack(
        [
            gradient[..., 2, 1] - gradient[..., 1, 2],
            gradient[..., 0, 2] - gradient[..., 2, 0],
            gradient[..., 1, 0] - gradient[..., 0, 1],
        ],
        axis=-1,
    )


def check_keys(spec: Mapping[str, Any], known: list[str], type_name: str) -> None:
    """Raise FlowError naming the nearest known key if `spec` holds an unknown one."""
    for key in spec:
        if key not in known:
            near = difflib.get_close_matches(str(key), known, n=1)
            hint = f"did you mean {near[0]!r}?" if near else f"known keys: {', '.join(known)}"
            raise FlowError(f"flow {type_name!r} has no key {key!r}; {hint}", (str(key),))


def number(value: object, name: str, *, positive: bool = False, key: Key | None = None) -> float:
    """A finite (positive) float from the case, or FlowError at `key` (the name if not given)."""
    right = "a positive finite number" if positive else "a finite number"
    at = (name,) if key is None else key
    if isinstance(value, bool | np.bool_) or not isinstance(value, int | float | np.number):
        raise FlowError(f"{name} must be {right}, not {value!r}", at)
    result = float(value)
    if not np.isfinite(result) or (positive and result <= 0.0):
        raise FlowError(f"{name} must be {right}, not {value!r}", at)
    return result


def tensor(value: Any, name: str, shape: tuple[int, ...], key: Key | None = None) -> Array:
    """A finite float array of the given shape, or FlowError at `key` (the name if not given)."""
    right = f"must hold {' x '.join(map(str, shape))} finite numbers"
    at = (name,) if key is None else key
    try:
        result = np.array(value, dtype=float)
    except (TypeError, ValueError):
        raise FlowError(f"{name} {right}, not {value!r}", at) from None
    if result.shape != shape:
        raise FlowError(f"{name} {right}, got shape {result.shape}", at)
    if not np.all(np.isfinite(result)):
        raise FlowError(f"{name} {right}, not {value!r}", at)
    return result


def rotation_matrix(value: Any, name: str = "rotation") -> Array:
    """Rotation matrix (3, 3) from a quaternion, an axis and angle, or a matrix, or FlowError.

    A quaternion (q0, q1, q2, q3) has its scalar first and is normalised; {axis, angle} is in
    radians; a matrix must be orthogonal with determinant +1.
    """
    right = (
        f"{name} must be a quaternion of four numbers, {{axis: [..], angle: ..}} with the "
        "angle in radians, or an orthogonal 3 x 3 matrix of determinant +1"
    )
    if isinstance(value, Mapping):
        if set(value) != {"axis", "angle"}:
            raise FlowError(f"{right}; got keys {sorted(map(str, value))}", (name,))
        axis = tensor(value["axis"], f"{name} axis", (3,), (name, "axis"))
        length = float(np.linalg.norm(axis))
        if length == 0.0:
            raise FlowError(f"{name} axis must not be zero", (name, "axis"))
        half = 0.5 * number(value["angle"], f"{name} angle", key=(name, "angle"))
        value = np.concatenate([[np.cos(half)], np.sin(half) * axis / length])
    if np.shape(value) == (4,):
        quaternion = tensor(value, name, (4,))
        length = float(np.linalg.norm(quaternion))
        if length == 0.0:
            raise FlowError(f"{right}; a zero quaternion is no rotation", (name,))
        scalar, a, b, c = quaternion / length
        cross = np.array([[0.0, -c, b], [c, 0.0, -a], [-b, a, 0.0]])
        turned: Array = np.eye(3) + 2.0 * (scalar * cross + cross @ cross)
        return turned
    if np.shape(value) != (3, 3):
        raise FlowError(f"{right}; got shape {np.shape(value)}", (name,))
    matrix = tensor(value, name, (3, 3))
    if np.abs(matrix @ matrix.T - np.eye(3)).max() > 1e-10 or np.linalg.det(matrix) < 0.0:
        raise FlowError(right, (name,))
    return matrix
