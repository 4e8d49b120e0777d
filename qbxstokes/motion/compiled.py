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

from qbxstokes.motion.binding import bind


@cache
def loops(degree: int) -> dict[str, Callable[..., None]]:
    """The loops over a block, by name, for flows of one degree."""

    def finish(name: str, function: FunctionType) -> Any:
        # The cache tells functions apart by their qualified names, which hold the degree.
        options = {"cache": True} if name.endswith("_block") else {"forceinline": True}
        return numba.njit(error_model="numpy", **options)(function)

    return {name: run for name, run in bind(degree, finish).items() if name.endswith("_block")}
