"""What callers give, checked: each fault is one line that says what to write."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.case.values import Problem
from qbxstokes.errors import SceneError
from qbxstokes.flows import Flow
from qbxstokes.typing import Array


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
