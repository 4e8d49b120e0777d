"""Vectors that may depend on time: three numbers or expressions in t, a table, or a function."""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qbxstokes.case.base import describe, entries, to_number
from qbxstokes.case.model import Convert, Problem
from qbxstokes.errors import CaseError

Array = NDArray[np.float64]
Timed = ArrayLike | Callable[[float], ArrayLike]

_FUNCTIONS: dict[str, Callable[..., float]] = {
    name: getattr(math, name)
    for name in ("sin", "cos", "tan", "exp", "log", "sqrt", "tanh", "sinh", "cosh", "atan", "erf")
} | {"abs": abs, "min": min, "max": max}
_OPERATORS: dict[type, Callable[..., float]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: math.pow,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
}
_NAMES = {"pi": math.pi, "π": math.pi}
_LONGEST = 400
_EXAMPLE = "[1, 0, 'sin(2*pi*t)']"


def _function_of_time(node: ast.AST) -> Callable[[float], float]:
    """What a node of an expression says, as a function of t; raises ValueError."""
    if isinstance(node, ast.Constant) and type(node.value) in (int, float):
        number = float(node.value)  # type: ignore[arg-type]
        return lambda t: number
    if isinstance(node, ast.Name) and node.id == "t":
        return lambda t: t
    if isinstance(node, ast.Name) and node.id in _NAMES:
        constant = _NAMES[node.id]
        return lambda t: constant
    if isinstance(node, ast.UnaryOp) and type(node.op) in _OPERATORS:
        sign, inner = _OPERATORS[type(node.op)], _function_of_time(node.operand)
        return lambda t: sign(inner(t))
    if isinstance(node, ast.BinOp) and type(node.op) in _OPERATORS:
        act = _OPERATORS[type(node.op)]
        left, right = _function_of_time(node.left), _function_of_time(node.right)
        return lambda t: act(left(t), right(t))
    if (
        isinstance(node, ast.Call)
        and isinstance(node.func, ast.Name)
        and node.func.id in _FUNCTIONS
        and node.args
        and not node.keywords
    ):
        call = _FUNCTIONS[node.func.id]
        inputs = [_function_of_time(argument) for argument in node.args]
        return lambda t: call(*(value(t) for value in inputs))
    what = node.id if isinstance(node, ast.Name) else type(node).__name__.lower()
    raise ValueError(f"{what} is not known here")


def expression_in_time(text: str) -> Callable[[float], float]:
    """The function that an expression such as '2*sin(pi*t)' stands for; raises ValueError."""
    if len(text) > _LONGEST:
        raise ValueError("it is too long")
    try:
        tree = ast.parse(text.strip(), mode="eval")
        return _function_of_time(tree.body)
    except (SyntaxError, RecursionError, MemoryError):
        raise ValueError("it is not an expression") from None


def _component(value: Any) -> float | str:
    if not isinstance(value, str):
        return to_number(value)
    try:
        return to_number(value)
    except Problem:
        pass
    try:
        function = expression_in_time(value)
        float(function(0.0))
    except (ValueError, TypeError, ArithmeticError) as error:
        raise Problem(
            f"{describe(value)}: {error}",
            f"a number, or an expression in t of {', '.join(_FUNCTIONS)}, pi",
        ) from None
    return value


def _table(value: dict[str, Any]) -> dict[str, Any]:
    if "table" in value:
        if set(value) != {"table"}:
            raise Problem("has more keys than table", "{table: file.csv} with columns t, 1, 2, 3")
        if not isinstance(value["table"], str):
            raise Problem(f"is {describe(value['table'])}", "a file name", ("table",))
        return {"table": value["table"]}
    if set(value) != {"times", "values"}:
        raise Problem("is neither of the tables", "{table: file.csv} or {times: [...], values: []}")
    times, values = value["times"], value["values"]
    if not isinstance(times, (list, tuple)) or not isinstance(values, (list, tuple)):
        raise Problem("needs lists", "{times: [t0, t1, ...], values: [[1, 2, 3], ...]}")
    instants = [to_number(entry) for entry in times]
    rows = [[to_number(part) for part in entries(3, "[1, 0, 0]")(row)] for row in values]
    _check_table(np.array(instants), np.array(rows), ("times",))
    return {"times": instants, "values": rows}


def _check_table(times: Array, values: Array, key: tuple[str | int, ...] = ()) -> None:
    if len(times) < 2 or len(times) != len(values):
        raise Problem("has too few rows", "two rows or more, one per instant", key)
    if np.any(np.diff(times) <= 0):
        raise Problem("is not in increasing order", "instants that increase", key)


def timed_entry(value: Any) -> Any:
    """A validated entry as plain data; raises what a validator does."""
    if isinstance(value, str):
        if not value.rpartition(":")[0].endswith(".py"):
            raise Problem(
                f"is {describe(value)}",
                f"three entries such as {_EXAMPLE}, a table, or file.py:function",
            )
        return value
    if isinstance(value, dict):
        return _table(value)
    if isinstance(value, (list, tuple)):
        return tuple(_component(entry) for entry in entries(3, _EXAMPLE)(value))
    raise Problem(f"is {describe(value)}", f"three entries such as {_EXAMPLE}")


TimedVector = Annotated[
    Any,
    Convert(timed_entry, json=list[float | str] | str | dict[str, str | list[Any]]),
]


def timed(value: Any, folder: Path, end: float) -> Timed:
    """The vector of a validated entry: an array (3,) or a function of time.

    folder: what names of files are relative to. end: a table must reach from 0 to it.
    Raises CaseError for a file that cannot be used.
    """
    if isinstance(value, str):
        return _user_function(value, folder)
    if isinstance(value, dict):
        return _spline(*_read_table(value, folder), end)
    if all(isinstance(entry, float) for entry in value):
        return np.array(value)
    parts = [
        expression_in_time(entry) if isinstance(entry, str) else (lambda t, number=entry: number)
        for entry in value
    ]

    def vector(t: float) -> ArrayLike:
        try:
            return [float(part(t)) for part in parts]
        except (ValueError, ArithmeticError) as error:
            raise CaseError(f"{value} at t = {t:.6g}: {error}") from None

    return vector


def _user_function(name: str, folder: Path) -> Timed:
    from qbxstokes.flows.user import load_function

    path, _, attribute = name.rpartition(":")
    function = load_function(f"{Path(folder, path).resolve()}:{attribute}")

    def vector(t: float) -> ArrayLike:
        try:
            result = np.asarray(function(t), dtype=float)
        except Exception as error:
            raise CaseError(
                f"function {name} raised {type(error).__name__} at t = {t:.6g}: {error}"
            ) from error
        if result.shape != (3,) or not np.isfinite(result).all():
            raise CaseError(f"function {name} must return three finite numbers, at t = {t:.6g} too")
        return result

    vector(0.0)
    return vector


def _read_table(value: dict[str, Any], folder: Path) -> tuple[Array, Array, str]:
    if "times" in value:
        return np.array(value["times"]), np.array(value["values"]), "the table"
    path = Path(folder, value["table"])
    try:
        lines = path.read_text().splitlines()
        rows = [line.replace(",", " ").split() for line in lines if line.split("#")[0].strip()]
        numbers = np.array([[float(word) for word in row] for row in rows if row[0][0] not in "tT"])
        if numbers.ndim != 2 or numbers.shape[1] != 4:
            raise ValueError("four columns are expected: t and three components")
        if not np.isfinite(numbers).all():
            raise ValueError("a number is not finite")
        _check_table(numbers[:, 0], numbers[:, 1:])
    except OSError as error:
        raise CaseError(f"{path}: cannot be read ({error.strerror})") from None
    except Problem as error:
        raise CaseError(f"{path}: {error}") from None
    except ValueError as error:
        raise CaseError(f"{path}: {error}") from None
    return numbers[:, 0], numbers[:, 1:], str(path)


def _spline(times: Array, values: Array, name: str, end: float) -> Timed:
    """Cubic spline through the rows, which keeps integrators of high order at their order."""
    from scipy.interpolate import CubicSpline

    if times[0] > 0.0 or times[-1] < end:
        raise CaseError(
            f"{name}: covers t = {times[0]:g} to {times[-1]:g}; the motion needs 0 to {end:g}"
        )
    spline = CubicSpline(times, values)
    return lambda t: spline(min(t, float(times[-1])))
