"""The kernels compiled by numba, with its cache on disk; import only when a run is worth it.

Importing numba takes a few tenths of a second and the first compilation on a machine some seconds:
`equations.py` imports this module only when a block or a long run asks for it. The compiled
functions are those of `kernels.py` themselves, bound to each other's compiled form. Only the loops
over a block go to the cache, with everything they call inside.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from types import FunctionType
from typing import Any

import numba

from qbxstokes.motion import kernels

_LAWS = {
    1: "free_motion_linear",
    2: "free_motion_quadratic",
    3: "free_motion_cubic",
}


@cache
def loops(degree: int) -> dict[str, Callable[..., None]]:
    """The loops over a block, by name, for flows of one degree.

    They and all they call are copies of the functions of `kernels.py` that call each other, with
    the law of the degree in the place of `free_motion_about`: a branch would keep the compiler from
    working on several bodies at once.
    """
    plain = {
        name: function
        for name, function in vars(kernels).items()
        if isinstance(function, FunctionType) and function.__module__ == kernels.__name__
    }
    plain["free_motion_about"] = plain[_LAWS[degree]]
    namespace: dict[str, Any] = dict(vars(kernels))
    for name, function in plain.items():
        copy = FunctionType(function.__code__, namespace, name, function.__defaults__)
        copy.__module__ = function.__module__
        # The cache tells functions apart by their qualified names.
        copy.__qualname__ = f"{name}_{degree}"
        options = {"cache": True} if name.endswith("_block") else {"forceinline": True}
        namespace[name] = numba.njit(error_model="numpy", **options)(copy)
    return {name: namespace[name] for name in plain if name.endswith("_block")}
