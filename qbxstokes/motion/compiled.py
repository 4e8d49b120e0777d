"""The kernels compiled by numba, with its cache on disk; import only when a run is worth it.

Importing numba takes a few tenths of a second and the first compilation on a machine some seconds:
`equations.py` imports this module only when a block or a long run asks for it. The compiled
functions are those of `kernels.py` themselves, bound to each other's compiled form. Only the loops
over a block go to the cache, with everything they call inside.
"""

from __future__ import annotations

from types import FunctionType
from typing import Any

import numba

from qbxstokes.motion import kernels


def _compile() -> dict[str, Any]:
    namespace = dict(vars(kernels))
    for name, function in vars(kernels).items():
        if isinstance(function, FunctionType) and function.__module__ == kernels.__name__:
            bound = FunctionType(function.__code__, namespace, name, function.__defaults__)
            bound.__module__, bound.__qualname__ = function.__module__, function.__qualname__
            namespace[name] = numba.njit(cache=name.endswith("_block"), error_model="numpy")(bound)
    return namespace


_NAMESPACE = _compile()

massless_block = _NAMESPACE["massless_block"]
massless_jacobian_block = _NAMESPACE["massless_jacobian_block"]
inertial_block = _NAMESPACE["inertial_block"]
inertial_jacobian_block = _NAMESPACE["inertial_jacobian_block"]
