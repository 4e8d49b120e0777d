"""The kernels with the law of one polynomial degree put in, plain or compiled."""

from __future__ import annotations

from collections.abc import Callable
from types import FunctionType
from typing import Any

from qbxstokes.motion import kernels

_LAWS = {
    1: "free_motion_linear",
    2: "free_motion_quadratic",
    3: "free_motion_cubic",
}


def bind(
    degree: int,
    finish: Callable[[str, FunctionType], Any] | None = None,
    at_origin: bool = False,
) -> dict[str, Callable[..., Any]]:
    """Copies of all functions of `kernels.py`, by name, that call each other.

    The choice by degree (`free_motion_about`) is made here, once: a branch would cost a call on
    plain numbers and would keep a compiler from working on several bodies at once. `finish` makes
    of each name and copy what the others shall call. at_origin: the flow's derivatives are those at
    the space origin, so that nothing need be subtracted.
    """
    plain = {
        name: function
        for name, function in vars(kernels).items()
        if isinstance(function, FunctionType) and function.__module__ == kernels.__name__
    }
    plain["free_motion_about"] = plain[_LAWS[degree]]
    if at_origin:
        plain["free_motion"] = plain[_LAWS[degree]]
    namespace: dict[str, Any] = dict(vars(kernels))
    for name, function in plain.items():
        copy = FunctionType(function.__code__, namespace, name, function.__defaults__)
        copy.__module__ = function.__module__
        copy.__qualname__ = f"{name}_{degree}"
        namespace[name] = copy if finish is None else finish(name, copy)
    return {name: namespace[name] for name in plain}
