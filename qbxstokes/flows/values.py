"""Numbers, tensors, rotations and keys of a flow's specification, checked as they are read."""

import re
import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from qbxstokes.errors import FlowError, SinglePrecisionWarning, nearest
from qbxstokes.expressions import LARGEST
from qbxstokes.typing import Array

Key = tuple[str | int, ...]
Exponents = tuple[int, int, int]

_FACTOR = re.compile(r"x([123])(?:\^([0-9]))?")
# What rounding leaves of numbers of double and of single precision, relative to the largest.
DOUBLE, SINGLE = 1e-12, 1e-6


def instants(given: Any) -> Array:
    """Increasing instants (n,), none where nothing is given; raises FlowError."""
    try:
        found = np.atleast_1d(np.asarray([] if given is None else given, dtype=np.float64))
    except (TypeError, ValueError):
        found = np.array([np.nan])
    if found.ndim != 1 or not np.isfinite(found).all() or np.any(np.diff(found) <= 0.0):
        raise FlowError(f"breaks are increasing instants, not {given!r}", ("breaks",))
    return found


def check_keys(spec: Mapping[str, Any], known: list[str], type_name: str) -> None:
    """Raise FlowError naming the nearest known key if `spec` holds an unknown one."""
    for key in spec:
        if key not in known:
            hint = nearest(str(key), known, f"known keys: {', '.join(known)}")
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
    if abs(result) > LARGEST or (positive and result < 1.0 / LARGEST):
        raise FlowError(f"{name} is {result:g}, beyond 1e-50 to {LARGEST:g}", at)
    return result


def whole(value: object, name: str, least: int, key: Key | None = None) -> int:
    """An integer from `least` on from the case, or FlowError at `key` (the name if not given)."""
    result = number(value, name, key=key)
    if result != int(result) or result < least:
        right = f"a whole number from {least} on"
        raise FlowError(f"{name} must be {right}, not {value!r}", (name,) if key is None else key)
    return int(result)


def tensor(value: Any, name: str, shape: tuple[int, ...], key: Key | None = None) -> Array:
    """A finite float array of the given shape, or FlowError at `key` (the name if not given)."""
    right = f"must hold {' x '.join(map(str, shape))} finite numbers"
    if not shape:
        right = "must be a finite number"
    at = (name,) if key is None else key
    try:
        result = np.array(value, dtype=float)
    except (TypeError, ValueError):
        raise FlowError(f"{name} {right}, not {value!r}", at) from None
    if result.shape != shape:
        raise FlowError(f"{name} {right}, got shape {result.shape}", at)
    if not np.all(np.isfinite(result)):
        raise FlowError(f"{name} {right}, not {value!r}", at)
    if np.any(np.abs(result) > LARGEST):
        raise FlowError(f"{name} holds numbers beyond {LARGEST:g}", at)
    return result


def settled(given: Array, nearest: Array, must: str, key: Key = ()) -> Array:
    """Numbers that differ from the nearest right ones by rounding alone, or FlowError.

    must: what is asked of them. Where the difference is that of single precision, the nearest are
    taken, with a SinglePrecisionWarning.
    """
    off, size = float(np.abs(given - nearest).max()), float(np.abs(given).max())
    if off <= DOUBLE * size:
        return given
    if off > SINGLE * size:
        near = f"; the nearest that does is {nearest.tolist()}" if nearest.size < 10 else ""
        raise FlowError(must + near, key)
    told = f"{must}: the nearest that does is taken, within single precision"
    warnings.warn(told, SinglePrecisionWarning, stacklevel=2)
    return nearest


def traceless(derivatives: Array) -> Array:
    """The nearest derivatives of a flow, (3, ...) with one index of it and n of space, div u = 0.

    Isotropic parts are taken off, which keeps them symmetric in the indices of space.
    """
    trace, rank = np.einsum("ii...->...", derivatives), derivatives.ndim
    away = np.zeros_like(derivatives)
    for axis in range(1, rank):
        away += np.moveaxis(np.multiply.outer(np.eye(3), trace), 1, axis)
    return np.asarray(derivatives - away / (rank + 1.0))


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
    rows = value if isinstance(value, Sequence | np.ndarray) else ()
    if len(rows) == 4:
        quaternion = tensor(value, name, (4,))
        length = float(np.linalg.norm(quaternion))
        if length == 0.0:
            raise FlowError(f"{right}; a zero quaternion is no rotation", (name,))
        scalar, a, b, c = quaternion / length
        cross = np.array([[0.0, -c, b], [c, 0.0, -a], [-b, a, 0.0]])
        return np.asarray(np.eye(3) + 2.0 * (scalar * cross + cross @ cross))
    if len(rows) != 3:
        raise FlowError(right, (name,))
    matrix = tensor(value, name, (3, 3))
    left, _, across = np.linalg.svd(matrix)
    if np.linalg.det(left @ across) < 0.0:
        raise FlowError(right, (name,))
    return settled(matrix, left @ across, right, (name,))


def parse_monomial(text: str) -> Exponents:
    """Exponents of x1, x2, x3 in a monomial such as x2^2, x1*x3 or 1; raises FlowError."""
    wrong = FlowError(
        f"{text!r} is not a monomial of degree <= 3 in x1, x2, x3; write e.g. 1, x2, "
        "x2^2, x1*x3 or x1*x2^2"
    )
    exponents = [0, 0, 0]
    if text.strip() != "1":
        # A power written ** would be torn apart by splitting at products.
        for factor in re.split(r"[*\s]+", text.replace("**", "^").strip()):
            match = _FACTOR.fullmatch(factor)
            if match is None:
                raise wrong
            exponents[int(match[1]) - 1] += int(match[2] or 1)
    if sum(exponents) > 3:
        raise wrong
    return exponents[0], exponents[1], exponents[2]
