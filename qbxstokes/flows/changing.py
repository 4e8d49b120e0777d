"""Linear flows whose gradient changes in time: functions, expressions and series of samples.

Positions are relative to the tracer along which the gradients were taken: the flow is A(t) x.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qbxstokes.errors import FlowError, FlowFunctionError
from qbxstokes.expressions import expression_in_time
from qbxstokes.flows.base import Build, Flow
from qbxstokes.flows.polynomial import PolynomialFlow
from qbxstokes.flows.series import GradientSeries, series_of_file
from qbxstokes.flows.transformed import Transformable
from qbxstokes.flows.user import load_function
from qbxstokes.flows.values import (
    DOUBLE,
    SINGLE,
    Array,
    check_keys,
    instants,
    number,
    settled,
    tensor,
    traceless,
)

_NOTHING = 1e-290  # the trace of a gradient whose digits are lost


class LinearInTime(Transformable):
    """u = A(t) x with a traceless gradient that changes in time.

    gradient: a function of t that returns (3, 3), three rows of numbers and expressions in t, or a
    `GradientSeries` of one path.
    """

    type_name = "linear"
    rows = slice(7, 16)  # of its numbers among those of a flow (`motion.taylor`)

    def __init__(self, gradient: Any, spec: Mapping[str, Any] | None = None) -> None:
        self._spec = None if spec is None else dict(spec)
        self._last, self._breaks = math.inf, np.empty(0)
        self._source: LinearInTime | None = None
        self.series = gradient if isinstance(gradient, GradientSeries) else None
        if isinstance(gradient, GradientSeries):
            self.spacing = gradient.spacing
            self._gradient = gradient.function()
        elif callable(gradient):
            self._gradient = gradient
        else:
            self._gradient = _of_expressions(gradient)
            self._spec = self._spec or {"type": "linear", "gradient": gradient}
        self.at(0.0)

    @classmethod
    def from_spec(cls, spec: Mapping[str, Any], build: Build) -> Flow:
        """From {"gradient": ...}: rows of expressions, a function, a series, or {"file": ...}."""
        check_keys(spec, ["gradient", "trajectory", "longest_step", "breaks"], cls.type_name)
        gradient, chosen = spec["gradient"], spec.get("trajectory")
        if isinstance(gradient, str):
            gradient = load_function(gradient)
        known = isinstance(gradient, (Mapping, GradientSeries))
        if known and chosen is not None:
            if isinstance(chosen, bool) or not isinstance(chosen, (int, float)) or chosen % 1:
                right = f"a whole number; all paths: sweep.axes: [{{flow.trajectory: {chosen}}}]"
                raise FlowError(f"trajectory is {chosen!r}; {right}", ("trajectory",))
            chosen = int(chosen)
        if isinstance(gradient, Mapping):
            single = chosen if "rows" in gradient else None
            gradient = series_of_file(gradient, single)
            chosen = None if single is not None else chosen
        if isinstance(gradient, GradientSeries) and chosen is not None:
            gradient = gradient.path(chosen)
        flow = cls(gradient, {"type": cls.type_name, **spec})
        if spec.get("longest_step") is not None:
            step = number(spec["longest_step"], "longest_step", positive=True)
            flow.spacing = min(flow.spacing, step)
        flow._breaks = instants(spec.get("breaks"))
        return flow

    def breaks(self, end: float) -> Array:
        """Those that were given, and the samples of a series."""
        if self._source is not None:
            return self._source.breaks(end)
        own = np.empty(0) if self.series is None else self.series.breaks(end)
        found: Array = np.unique(np.concatenate([self._breaks[self._breaks < end], own]))
        return found

    def until(self, t: float) -> None:
        """Show itself, from now on, as before the break t: at t as just before it."""
        self._last = math.nextafter(t, -math.inf)

    def at(self, t: float) -> Array:
        """The gradient (3, 3) at time t; raises FlowError for what is none."""
        try:
            given = self._gradient(min(t, self._last))
        except FlowError:
            raise
        except Exception as error:
            wrong = f"raised {type(error).__name__} at t = {t:.6g}: {error}"
            raise FlowFunctionError(f"the gradient {wrong}", ("gradient",)) from error
        matrix = tensor(given, f"the gradient at t = {t:.6g}", (3, 3), ("gradient",))
        trace = float(np.trace(matrix))
        if abs(trace) <= _NOTHING:
            return matrix
        if abs(trace) > SINGLE * float(np.abs(matrix).max()):
            raise FlowFunctionError(
                f"the gradient has trace {trace:.6g} at t = {t:.6g} and must have none "
                "(incompressible fluid)",
                ("gradient",),
            )
        return settled(matrix, traceless(matrix), "the gradients must have no trace (div u = 0)")

    def frozen(self, t: float) -> PolynomialFlow:
        """The flow of an instant."""
        return PolynomialFlow(gradient=self.at(t))

    def numbers(self, t: float) -> list[float]:
        """The nine numbers of the gradient at time t, by rows; raises FlowError as `at` does."""
        try:
            found: list[float] = (
                np.asarray(self._gradient(min(t, self._last)), dtype=np.float64).ravel().tolist()
            )
            trace, size = found[0] + found[4] + found[8], max(map(abs, found))
            if len(found) == 9 and abs(trace) <= DOUBLE * size + _NOTHING < math.inf:
                return found
        except Exception:
            pass
        told: list[float] = self.at(t).ravel().tolist()
        return told

    def odd_about(self, x: ArrayLike) -> NDArray[np.bool_]:
        """Whether u(x + r) = -u(x - r) for all r at all times, exactly, shape (...)."""
        return np.asarray(~np.any(np.asarray(x), axis=-1))

    def velocity(self, x: ArrayLike, t: float = 0.0) -> Array:
        """Velocity (..., 3)."""
        result: Array = np.asarray(x, dtype=float) @ self.at(t).T
        return result

    def gradient(self, x: ArrayLike, t: float = 0.0) -> Array:
        """Velocity gradient (..., 3, 3)."""
        return np.broadcast_to(self.at(t), (*np.shape(x), 3))

    def laplacian(self, x: ArrayLike, t: float = 0.0) -> Array:
        """Zero."""
        return np.zeros(np.shape(x))

    def vorticity_of_laplacian(
        self, x: ArrayLike, t: float = 0.0, reach: float | None = None
    ) -> Array:
        """Zero."""
        return np.zeros(np.shape(x))

    def pressure(self, x: ArrayLike, t: float = 0.0) -> Array:
        """Zero: that of a Stokes flow without inertia."""
        return np.zeros(np.shape(x)[:-1])

    @property
    def degree(self) -> int:
        """1."""
        return 1

    @property
    def steady(self) -> bool:
        """False."""
        return False

    def spec(self) -> dict[str, Any]:
        """The specification, where it can be written down."""
        return self._spec or {"type": self.type_name, "gradient": self._gradient}

    def rotated(self, rotation: ArrayLike) -> Flow:
        """The flow turned: A becomes R A R^T."""
        turn = tensor(rotation, "rotation", (3, 3))
        return self._mapped(lambda a: turn @ a @ turn.T)

    def scaled(self, factor: float) -> Flow:
        """The flow times a number."""
        return self._mapped(lambda a: factor * a)

    def _mapped(self, change: Callable[[Array], Array]) -> Flow:
        flow = LinearInTime(lambda t: change(self.at(t)))
        flow.spacing, flow._source = self.spacing, self
        return flow


def in_time(gradient: Any) -> bool:
    """Whether what a case or a caller gives as a gradient changes in time."""
    if callable(gradient) or isinstance(gradient, (GradientSeries, Mapping, str)):
        return True
    rows = gradient if isinstance(gradient, (list, tuple)) else ()
    return any(isinstance(e, str) for row in rows if isinstance(row, (list, tuple)) for e in row)


def _of_expressions(rows: Any) -> Callable[[float], Array]:
    if len(rows) != 3 or any(
        not isinstance(row, Sequence | np.ndarray) or len(row) != 3 for row in rows
    ):
        raise FlowError("gradient must hold 3 x 3 numbers or expressions in t", ("gradient",))
    parts = []
    for i, row in enumerate(rows):
        for j, entry in enumerate(row):
            try:
                parts.append(expression_in_time(str(entry)))
            except ValueError as error:
                key = ("gradient", i, j)
                raise FlowError(f"gradient entry {entry!r}: {error}", key) from None
    return lambda t: np.array([part(t) for part in parts]).reshape(3, 3)
