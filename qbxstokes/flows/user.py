"""A background flow from a user's own Python function, named in the case as file.py:function."""

from __future__ import annotations

import ctypes
import hashlib
import inspect
import math
import re
import sys
from collections import ChainMap
from collections.abc import Callable, Mapping
from functools import cache, partial
from itertools import chain, count
from pathlib import Path
from types import ModuleType
from typing import Any
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.errors import FlowError, FlowFunctionError
from qbxstokes.flows.base import Flow
from qbxstokes.flows.differences import curl, gradient_of, laplacian_gradient_of, laplacian_of
from qbxstokes.flows.interpolation import Between, within
from qbxstokes.flows.values import instants, number, tensor
from qbxstokes.typing import Array

# Nodes of the path integral of the pressure gradient: exact to rounding for fields that are
# smooth on the straight way from the origin.
_PRESSURE_NODES = 24
# Difference of a given derivative from that of the velocity that differences may leave.
_AGREED = 1e-5
# Where functions are that no file holds, but a program has given: `hand_over`.
_GIVEN, _FUNCTION = ("parameters",), ("function",)
_PYTHON = "<python>.py"
_handed: WeakValueDictionary[str, Any] = WeakValueDictionary()
LIBRARIES = (".so", ".dylib", ".dll")  # files that functions of C are in
_kept: dict[str, Any] = {}  # what Python cannot refer to weakly, such as a function written in C


class UserFlow(Between, Flow):
    """u(x) = function(x) or function(x, t), with x an array (n, 3) and the result of that shape.

    Derivatives are extrapolated central differences (`qbxstokes.flows.differences`) with steps up
    to a fifth of `length`, the length over which the flow varies, and of the distance to the
    nearest of `singular_points`; the relative errors are about 1e-12 (gradient), 1e-10
    (Laplacian) and 1e-8 (curl of the Laplacian). A function of x alone is steady.
    `parameters` are passed on as keyword arguments. compiled: the function is one of numbers,
    f(x, y, z), or f(x, y, z, t), and its parameters after these, with three numbers returned; numba
    compiles it into the loops over the body's surface; or one of C (`compiled.compiled_function`),
    as such or of a shared library, file.so:function. breaks: instants at which it is not smooth.
    gradient, hessian: functions of the same arguments, (n, i, j) = d_j u_i and (n, i, j, k) = d_j
    d_k u_i, for bodies that are moved by derivatives at their centres. recognise: whether to try if
    it is a polynomial of degree three or less.
    """

    type_name = "user"
    singular_points_known = False  # a function cannot be looked into

    def __init__(
        self,
        function: str | Callable[..., Any],
        length: float = 1.0,
        singular_points: ArrayLike | None = None,
        parameters: Mapping[str, Any] | None = None,
        longest_step: float | None = None,
        compiled: bool = False,
        breaks: ArrayLike | None = None,
        gradient: str | Callable[..., Any] | None = None,
        hessian: str | Callable[..., Any] | None = None,
        recognise: bool = True,
    ) -> None:
        """Raises FlowError if the function cannot be found or does not return velocities."""
        self.length = number(length, "length", positive=True)
        self._breaks = instants(breaks)
        if parameters is not None and not isinstance(parameters, Mapping):
            raise FlowError(f"parameters must be names and values, not {parameters!r}", _GIVEN)
        if not all(isinstance(name, str) for name in parameters or {}):
            raise FlowError("names of parameters must be texts", _GIVEN)
        self.parameters = dict(parameters or {})
        if longest_step is not None:
            self.spacing = number(longest_step, "longest_step", positive=True)
        if not compiled and str(function).rpartition(":")[0].endswith(LIBRARIES):
            raise FlowError("a function of C needs compiled: true", ("compiled",))
        given_itself = callable(function) or (compiled and isinstance(function, int))
        found: Any = function if given_itself else load_function(str(function))
        self.function = found
        self.name = function if isinstance(function, str) else _name_of(function)
        if singular_points is not None and np.size(singular_points):
            shape = (len(np.atleast_2d(singular_points)), 3)
            self.singular_points = tensor(np.atleast_2d(singular_points), "singular_points", shape)
        self.compiled, self.point_function = compiled, None
        self.recognise = recognise
        if compiled:
            from qbxstokes.flows.compiled import compiled_function, field_of

            self.point_function, timed = compiled_function(self.function, self.parameters)
            self.steady, self._field = not timed, field_of(self.point_function)
        else:
            self.steady = not self._has_time()
            self._field = partial(self._called, self.function)
        given = {"gradient": gradient, "hessian": hessian}
        self._given = {name: value for name, value in given.items() if value is not None}
        self._known = {
            name: value if callable(value) else load_function(value)
            for name, value in self._given.items()
        }
        self._agreed = not self._known

    def _called(self, function: Callable[..., Any], x: Array, t: float) -> Any:
        time = () if self.steady else (t,)
        return function(x.copy(), *time, **self.parameters)

    def _has_time(self) -> bool:
        """Whether a second argument is the time: called t or time, or one without a default."""
        try:
            parameters = inspect.signature(self.function).parameters.values()
        except (TypeError, ValueError):
            return False
        positional = [
            parameter
            for parameter in parameters
            if parameter.kind in (parameter.POSITIONAL_ONLY, parameter.POSITIONAL_OR_KEYWORD)
            and parameter.name not in self.parameters
        ]
        return any(
            parameter.name in ("t", "time") or parameter.default is parameter.empty
            for parameter in positional[1:2]
        )

    def velocity(self, x: ArrayLike, t: float = 0.0) -> Array:
        """Velocity (..., 3); raises FlowFunctionError if the function fails, or returns others."""
        return self._found(self._field, self.name, np.asarray(x, dtype=float), t, (3,))

    def _found(self, function: Any, name: str, x: Array, t: float, of: tuple[int, ...]) -> Array:
        """What a function says at points (..., 3), of the shape (..., *of)."""
        flat = x.reshape(-1, 3)
        try:
            result = np.asarray(function(flat, self.between(t)))
        except (Exception, SystemExit) as error:
            raise FlowFunctionError(
                f"flow function {name} raised {type(error).__name__}: {error}", ("function",)
            ) from error
        if result.shape != (len(flat), *of) or result.dtype.kind not in "fiu":
            points = " of its points," if of == (3,) else ""
            raise FlowFunctionError(
                f"flow function {name} must return a real array of the shape{points} "
                f"{(len(flat), *of)}, not {result.dtype} {result.shape}",
                ("function",),
            )
        return result.astype(float, copy=False).reshape(*x.shape[:-1], *of)

    def expansion(self, x: Array, t: float, degree: int) -> tuple[Array, Array, Array | None]:
        """Velocity, gradient and second derivatives, by the functions that know them.

        What these say first is held against differences; raises FlowFunctionError.
        """
        missing = "gradient" not in self._known or (degree > 1 and "hessian" not in self._known)
        if missing or not self._agreed:
            found = super().expansion(x, t, degree)
            for name, numbers in zip(("gradient", "hessian"), found[1:], strict=True):
                if name in self._known and numbers is not None:
                    self._agree(name, self._derivative(name, x, t), numbers)
            self._agreed = True
            return found
        second = self._derivative("hessian", x, t) if degree > 1 else None
        return self.velocity(x, t), self._derivative("gradient", x, t), second

    def _derivative(self, name: str, x: Array, t: float) -> Array:
        function = partial(self._called, self._known[name])
        return self._found(function, name, x, t, (3,) * (2 if name == "gradient" else 3))

    @staticmethod
    def _agree(name: str, given: Array, differences: Array) -> None:
        size = float(np.abs(differences).max())
        off = float(np.abs(given - differences).max())
        if not off <= _AGREED * size:
            wrong = f"the {name} differs from that of the velocity by {off / (size or 1.0):.1g} of"
            raise FlowFunctionError(f"{wrong} its size", (name,))

    def breaks(self, end: float, rough: float = 0.0) -> Array:
        """Those that were given."""
        return within([self._breaks], end)

    def gradient(self, x: ArrayLike, t: float = 0.0) -> Array:
        """Velocity gradient (..., 3, 3) by extrapolated differences."""
        points = np.asarray(x, dtype=float)
        return gradient_of(lambda y: self.velocity(y, t), points, self.difference_step(points))

    def laplacian(self, x: ArrayLike, t: float = 0.0) -> Array:
        """Laplacian (..., 3) by extrapolated differences."""
        points = np.asarray(x, dtype=float)
        return laplacian_of(lambda y: self.velocity(y, t), points, self.difference_step(points))

    def vorticity_of_laplacian(
        self, x: ArrayLike, t: float = 0.0, reach: float | None = None
    ) -> Array:
        """Curl of the Laplacian (..., 3) by extrapolated differences of the velocity."""
        points = np.asarray(x, dtype=float)
        steps = self.difference_step(points, reach)
        return curl(laplacian_gradient_of(lambda y: self.velocity(y, t), points, steps))

    def pressure(self, x: ArrayLike, t: float = 0.0) -> Array:
        """Pressure (...), zero at the flow's origin: integral of Lap u along the straight way."""
        points = np.asarray(x, dtype=float)
        nodes, weights = np.polynomial.legendre.leggauss(_PRESSURE_NODES)
        way = 0.5 * (nodes[:, None] + 1.0) * points[..., None, :]
        slope = np.einsum("...ni,...i->...n", self.laplacian(way, t), points)
        result: Array = slope @ (0.5 * weights)
        return result

    def spec(self) -> dict[str, Any]:
        """Specification; `function` names a file if it was given so."""
        in_file = self.name.rpartition(":")[0].endswith((".py", *LIBRARIES))
        return {
            "type": self.type_name,
            "function": self.name if in_file else self.function,
            "length": self.length,
            "singular_points": self.singular_points.tolist(),
            "parameters": self.parameters,
            **({"longest_step": self.spacing} if self.spacing < math.inf else {}),
            **({"compiled": True} if self.compiled else {}),
            **{name: self._given[name] for name in self._given},
            **({} if self.recognise else {"recognise": False}),
            **({"breaks": self._breaks.tolist()} if len(self._breaks) else {}),
        }


def _name_of(function: Callable[..., Any]) -> str:
    named = getattr(function, "__qualname__", getattr(function, "__name__", None))
    return str(named or type(function).__name__)


def hand_over(value: Any) -> str:
    """The name, in a case, of a function or series of a program, for as long as that holds it."""
    stem = re.sub(r"\W", "", _name_of(value).rpartition(".")[2]) or "function"
    names = (f"{_PYTHON}:{stem}{end}" for end in chain([""], (f"_{n}" for n in count(2))))
    held = ChainMap(_kept, _handed)
    name = next(name for name in names if held.get(name, value) is value)
    try:
        _handed[name] = value
    except TypeError:
        _kept[name] = value
    return name


def load_function(name: str) -> Callable[..., Any]:
    """The function that "file.py:function" names, a library's, or `hand_over`; raises FlowError.

    A file is executed once in a process, however many functions are taken from it and however
    often; one that has changed since is executed anew.
    """
    if (handed := _handed.get(str(name), _kept.get(str(name)))) is not None:
        return handed  # type: ignore[no-any-return]
    path_text, separator, attribute = str(name).rpartition(":")
    path = Path(path_text)
    known = path.suffix in (".py", *LIBRARIES)
    if not separator or not known or not attribute.isidentifier():
        raise FlowError(f"function must be given as file.py:function, not {name!r}", ("function",))
    if not path.is_file():
        raise FlowError(f"there is no file {path_text!r} for the function {name!r}", ("function",))
    if path.suffix != ".py":
        try:
            return getattr(ctypes.CDLL(str(path.resolve())), attribute)  # type: ignore[no-any-return]
        except (OSError, AttributeError) as error:
            raise FlowError(
                f"{path_text} has no function {attribute!r}: {error}", _FUNCTION
            ) from None
    try:
        module = _executed(str(path.resolve()), path.read_bytes())
    except (Exception, SystemExit) as error:
        raise FlowError(
            f"{path_text} raised {type(error).__name__}: {error}", ("function",)
        ) from error
    function = getattr(module, attribute, None)
    if not callable(function) and not isinstance(function, int):
        there = [
            key
            for key, value in vars(module).items()
            if inspect.isfunction(value) and not key.startswith("_")
        ]
        raise FlowError(
            f"{path_text} has no function {attribute!r}; it has {', '.join(there) or 'none'}",
            ("function",),
        )
    return function  # type: ignore[no-any-return]


@cache
def _executed(path: str, content: bytes) -> ModuleType:
    """The module that a file is, executed."""
    # A name of its own for each, so that two files called alike do not meet.
    module = ModuleType(f"_user_{hashlib.sha256(path.encode() + content).hexdigest()[:16]}")
    module.__file__ = path
    code = compile(content, path, "exec", dont_inherit=True)
    sys.modules[module.__name__] = module  # what a data class in it asks for
    try:
        exec(code, vars(module))
    except BaseException:
        del sys.modules[module.__name__]
        raise
    return module


def resolve_paths(spec: Mapping[str, Any], directory: str | Path) -> dict[str, Any]:
    """The specification with every user function's file made absolute, relative to `directory`."""
    result = dict(spec)
    if result.get("type") == UserFlow.type_name and isinstance(result.get("function"), str):
        path, separator, attribute = result["function"].rpartition(":")
        if separator:
            result["function"] = f"{absolute(directory, path)}:{attribute}"
    for key, value in result.items():
        if key not in ("function", "terms", "flow"):
            result[key] = _with_files(value, directory)
    if isinstance(result.get("terms"), list | tuple):
        result["terms"] = [
            resolve_paths(term, directory) if isinstance(term, Mapping) else term
            for term in result["terms"]
        ]
    if isinstance(result.get("flow"), Mapping):
        result["flow"] = resolve_paths(result["flow"], directory)
    return result


def _with_files(value: Any, directory: str | Path) -> Any:
    """What a key is given, with the names of files in it made absolute."""
    if isinstance(value, str):
        return absolute(directory, value) if ".py:" in value else value
    if isinstance(value, list):
        return [_with_files(entry, directory) for entry in value]
    if not isinstance(value, Mapping):
        return value
    inner = {name: _with_files(entry, directory) for name, entry in value.items()}
    return {
        **inner,
        **({"file": absolute(directory, str(value["file"]))} if "file" in value else {}),
    }


def absolute(directory: str | Path, path: str) -> str:
    """A path made absolute; one that no file can have stays, and is told as missing."""
    if path.startswith(_PYTHON):
        return path
    try:
        return str(Path(directory, path).resolve())
    except (OSError, ValueError):
        return path
