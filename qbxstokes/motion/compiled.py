"""The kernels compiled by numba, with its cache on disk; import only when a run is worth it.

Importing numba takes a few tenths of a second and the first compilation on a machine some seconds:
`equations.py` imports this module only when a block or a long run asks for it. The compiled
functions are those of the modules in `_SOURCES`, bound to each other's compiled form. Only the
loops over a block go to the cache, with everything they call inside.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import FunctionType
from typing import Any

import numba

from qbxstokes.motion import kernels, law, layout, loops, taylor

_SOURCES = (layout, taylor, law, kernels, loops)
_LAWS = {
    1: "free_motion_linear",
    2: "free_motion_quadratic",
    3: "free_motion_cubic",
}


@cache
def version() -> str:
    """A name for what the sources say: numba's cache watches the file of the outermost function."""
    digest = hashlib.blake2b(digest_size=6)
    for module in _SOURCES:
        digest.update(Path(str(module.__file__)).read_bytes())
    return digest.hexdigest()


@cache
def compiled_loops(degree: int) -> dict[str, Callable[..., None]]:
    """The loops over a block, by name, for flows of one degree.

    They and all they call are copies of the functions of the sources that call each other, with the
    law of the degree in the place of `free_motion_about`: a branch would keep the compiler from
    working on several lanes at once.
    """
    plain: dict[str, FunctionType] = {}
    namespace: dict[str, Any] = {}
    for module in _SOURCES:
        namespace |= vars(module)
        for name, function in vars(module).items():
            if isinstance(function, FunctionType) and function.__module__ == module.__name__:
                plain[name] = function
    plain["free_motion_about"] = plain[_LAWS[degree]]
    for name, function in plain.items():
        copy = FunctionType(function.__code__, namespace, name, function.__defaults__)
        copy.__module__ = function.__module__
        # The cache tells functions apart by their qualified names.
        copy.__qualname__ = f"{name}_{degree}_{version()}"
        options = {"cache": True} if name.endswith("_block") else {"forceinline": True}
        namespace[name] = numba.njit(error_model="numpy", **options)(copy)
    return {name: namespace[name] for name in plain if name.endswith("_block")}
