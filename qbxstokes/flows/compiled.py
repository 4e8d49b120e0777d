"""A user's function of one point, compiled by numba, which is imported with this module."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

import numba
import numpy as np

from qbxstokes.errors import FlowError

inner = numba.njit(error_model="numpy")
_KEY = ("function",)


def compiled_function(function: Callable[..., Any], parameters: Mapping[str, Any]) -> Any:
    """point(x, y, z, t) -> (u1, u2, u3) for compiled loops, and whether it takes time.

    function: f(x, y, z) or f(x, y, z, t), and parameters after these, numbers by name; three
    numbers are returned. Python's own or one of numba's. Raises FlowError where it cannot be
    compiled.
    """
    plain = getattr(function, "py_func", function)
    names = list(inspect.signature(plain).parameters)
    places = 4 if names[3:4] in (["t"], ["time"]) else 3
    if len(names) < 3 or names[:3] != ["x", "y", "z"]:
        right = "x, y, z, then t where the flow changes in time, then its parameters"
        raise FlowError(f"a compiled function has arguments {right}, not {names}", _KEY)
    if set(names[places:]) != set(parameters):
        wrong = f"the function's parameters are {names[places:]}, and given are {list(parameters)}"
        raise FlowError(wrong, _KEY)
    own = function if hasattr(function, "py_func") else _own(plain)
    try:
        numbers = tuple(float(parameters[name]) for name in names[places:])
    except (TypeError, ValueError):
        raise FlowError("parameters of a compiled function are numbers", ("parameters",)) from None
    try:
        found = own(0.1, 0.2, 0.3, *(0.0,) * (places - 3), *numbers)
    except numba.core.errors.NumbaError as error:
        lines = [line.strip() for line in str(error).splitlines() if line.strip()]
        told = next((line for line in lines if not line.startswith("Failed in")), "")
        raise FlowError(f"the function cannot be compiled: {told}", _KEY) from None
    except ArithmeticError:
        found = 0.0, 0.0, 0.0
    if not isinstance(found, tuple) or len(found) != 3:
        raise FlowError("a compiled function returns three numbers, u1, u2, u3", _KEY)
    return _point(own, places == 4, numbers), places == 4


@cache
def _own(plain: Callable[..., Any]) -> Any:
    """A plain function, compiled once for all flows that it makes."""
    return inner(plain)


@cache
def _point(own: Any, timed: bool, numbers: tuple[float, ...]) -> Any:
    """The function with its parameters, once for all flows that are alike."""
    if timed:

        @inner
        def point(x: float, y: float, z: float, t: float) -> Any:
            return own(x, y, z, t, *numbers)

    else:

        @inner
        def point(x: float, y: float, z: float, t: float) -> Any:
            return own(x, y, z, *numbers)

    return point


@cache
def field_of(point: Any) -> Callable[[Any, float], Any]:
    """The same of many points, (n, 3) and t -> (n, 3)."""

    @inner
    def field(x: Any, t: float) -> Any:
        out = np.empty(x.shape)
        for i in range(len(x)):
            out[i, 0], out[i, 1], out[i, 2] = point(x[i, 0], x[i, 1], x[i, 2], t)
        return out

    return field  # type: ignore[no-any-return]
