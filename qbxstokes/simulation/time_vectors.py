"""Vectors that a case writes down: numbers, expressions in t, a table, or a user's function."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.errors import CaseError
from qbxstokes.expressions import expression_in_time
from qbxstokes.tables import read_table
from qbxstokes.typing import Array

Timed = ArrayLike | Callable[[float], ArrayLike]


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
