"""What callers and cases give, checked: each fault is one line that says what to write."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.case.values import Problem
from qbxstokes.errors import CaseError, SceneError
from qbxstokes.expressions import expression_in_time
from qbxstokes.flows import Flow
from qbxstokes.tables import read_table
from qbxstokes.typing import Array

Timed = ArrayLike | Callable[[float], ArrayLike]


def numbers(name: str, values: ArrayLike, right: str) -> Array:
    """Values as floats; raises SceneError where they are none, or not finite."""
    try:
        found = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise SceneError(name, f"is {values!r}", right) from None
    if not np.isfinite(found).all():
        raise SceneError(name, "is not finite", right)
    return found


def turned(orientation: ArrayLike) -> Array:
    """Axes or quaternions as floats; raises SceneError where one is no number, or zero."""
    found = numbers("orientation", orientation, "an axis [d1, d2, d3] or a quaternion")
    if found.ndim and not np.all(np.any(found, axis=-1)):
        raise SceneError("orientation", "has a zero vector", "an axis or quaternion of any length")
    return found


def accepted(value: Any) -> float:
    """The tolerance, the error accepted at the end; raises SceneError for what is none."""
    found = numbers("tolerance", value, "more than 0, at most 0.1")
    if found.ndim or not 0.0 < found <= 0.1:
        raise SceneError("tolerance", f"is {value}", "more than 0, at most 0.1")
    return float(found)


def instants(values: ArrayLike) -> Array:
    """Increasing finite times (T,) from 0 on; raises SceneError for others."""
    found = numbers("times", values, "increasing instants (T,)")
    if found.ndim != 1 or not len(found) or np.any(np.diff(found) <= 0.0):
        raise SceneError("times", f"have shape {found.shape}", "increasing instants (T,)")
    if found[0] < 0.0:
        raise SceneError("times", f"begin at {found[0]:g}", "0 or later: a motion starts at 0")
    return found


def require_flow(flow: Any) -> None:
    """Raise SceneError for what is no flow."""
    if not isinstance(flow, Flow):
        right = "qs.flow('user', function=...)" if callable(flow) else "qs.flow('shear')"
        raise SceneError("flow", f"is {flow!r}", f"a flow such as {right}")


def require(name: str, value: Any, kind: type, right: str) -> None:
    """Raise SceneError for what is neither None nor of a kind."""
    if value is not None and not isinstance(value, kind):
        raise SceneError(name, f"is {value!r}", right)


def section(name: str, kind: Any, given: Any) -> Any:
    """A section of a case from its keys, or as it is; raises SceneError for wrong ones."""
    if isinstance(given, kind):
        return given
    try:
        return kind.read(dict(given or {}))
    except Problem as problem:
        key = ".".join([name, *map(str, problem.key)])
        raise SceneError(key, problem.wrong, problem.right) from None


# -- vectors of a case: numbers, expressions in t, a table, or a function of the user's -----------


def timed(value: Any, folder: Path, end: float) -> Timed:
    """A vector that a case writes down: an array (3,) or a function of time.

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
    from qbxstokes.flows.user import absolute, load_function

    path, _, attribute = name.rpartition(":")
    function = load_function(f"{absolute(folder, path)}:{attribute}")

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
    table = read_table(folder / value["table"], columns=4)  # t and three components
    times = np.asarray(table.numbers[:, 0], dtype=np.float64)
    if len(times) < 2:
        raise CaseError(f"{table.path}: has one row; two or more are expected")
    late = np.diff(times) <= 0.0
    if np.any(late):
        place = int(late.argmax()) + 1
        where = f"line {table.lines[place]}" if table.lines else f"row {place + 1}"
        raise CaseError(f"{table.path}: {where}, column 1: the instants must increase")
    return times, np.asarray(table.numbers[:, 1:], dtype=np.float64), str(table.path)


def _spline(times: Array, values: Array, name: str, end: float) -> Timed:
    """Cubic spline through the rows, which keeps integrators of high order at their order."""
    from scipy.interpolate import CubicSpline

    if times[0] > 0.0 or times[-1] < end:
        raise CaseError(
            f"{name}: covers t = {times[0]:g} to {times[-1]:g}; the motion needs 0 to {end:g}"
        )
    spline = CubicSpline(times, values)
    return lambda t: spline(min(t, float(times[-1])))
