"""A user's function of one point, compiled by numba, which is imported with this module."""

import ctypes
import inspect
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from qbxstokes.errors import FlowError

inner = numba.njit(error_model="numpy")
_KEY = ("function",)
_POINTER: type = type(ctypes.CFUNCTYPE(None)()).__mro__[1]  # of all functions of ctypes
_IN_C = (types.void, *[types.float64] * 4, *[types.CPointer(types.float64)] * 2)
_IN_C_TEXT = "void(float64, float64, float64, float64, CPointer(float64), CPointer(float64))"


def compiled_function(function: Any, parameters: Mapping[str, Any]) -> Any:
    """point(x, y, z, t) -> (u1, u2, u3) for compiled loops, and whether it takes time.

    function: f(x, y, z) or f(x, y, z, t), and parameters after these, numbers by name; three
    numbers are returned. Python's own or one of numba's. Or a function of C, from ctypes, numba's
    cfunc, or by its address: void f(double x, double y, double z, double t, const double *p,
    double *u), with the parameters p in the order that they are given in. Raises FlowError where it
    cannot be compiled.
    """
    if (address := _address_of(function)) is not None:
        return _point_at(address, _numbers(parameters, list(parameters))), True
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
    numbers = _numbers(parameters, names[places:])
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


def _numbers(parameters: Mapping[str, Any], names: list[str]) -> tuple[float, ...]:
    try:
        return tuple(float(parameters[name]) for name in names)
    except (TypeError, ValueError):
        raise FlowError("parameters of a compiled function are numbers", ("parameters",)) from None


def _address_of(function: Any) -> int | None:
    """The address of a function of C, None for others; raises FlowError for what can be none."""
    given: Any = function
    if isinstance(function, _POINTER):
        return ctypes.cast(given, ctypes.c_void_p).value
    found = getattr(function, "address", function if isinstance(function, int) else None)
    signature = getattr(function, "_sig", None)
    if signature is not None and (signature.return_type, *signature.args) != _IN_C:
        raise FlowError(f"a C function of a flow is {_IN_C_TEXT}, not {signature}", _KEY)
    return None if found is None else int(found)


@intrinsic
def _call(context, address, x, y, z, t, parameters):  # type: ignore[no-untyped-def]
    """The three numbers that a function of C writes."""
    three = types.UniTuple(types.float64, 3)

    def generate(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        real, pointer = ir.DoubleType(), ir.DoubleType().as_pointer()
        kind = ir.FunctionType(ir.VoidType(), [real] * 4 + [pointer] * 2)
        place, *given, numbers = arguments
        out = cgutils.alloca_once(builder, real, size=3)
        function = builder.inttoptr(place, kind.as_pointer())
        builder.call(function, [*given, builder.inttoptr(numbers, pointer), out])
        u = [builder.load(builder.gep(out, [ir.IntType(32)(i)])) for i in range(3)]
        return context.make_tuple(builder, three, u)

    return three(types.intp, *[types.float64] * 4, types.intp), generate


@cache
def _point_at(address: int, numbers: tuple[float, ...]) -> Any:
    """A function of C with its parameters."""
    held = np.array([*numbers, 0.0])
    place = held.ctypes.data

    @inner
    def point(x: float, y: float, z: float, t: float) -> Any:
        return _call(address, x, y, z, t, place)

    point.held = held
    return point


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
