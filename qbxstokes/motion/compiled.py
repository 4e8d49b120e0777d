"""The kernels compiled by numba, with its cache on disk; import only when a run is worth it.

Importing numba takes a few tenths of a second and the first compilation on a machine some seconds:
`equations.py` imports this module only when a block or a long run asks for it. The compiled
functions are the loops over a block and all they call, copied and bound to each other's compiled
form. Only the loops go to the cache, with everything they call inside.
"""

import hashlib
import inspect
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any

import numba

from qbxstokes.folders import compiled_are_kept
from qbxstokes.motion import loops, taylor

# What the loops take from the class of the law.
_OF_THE_LAW = ("N_NUMBERS", "massless", "inertial", "unpack_body")


@dataclass(frozen=True)
class Loops:
    """The loops over a block, by name, and what their sources say, in short.

    numba's cache watches the file of the outermost function alone: the version belongs to its name.
    """

    by_name: dict[str, Callable[..., None]]
    version: str


@cache
def compiled_loops(kernels: ModuleType, degree: int, massless: bool) -> Loops:
    """The loops for a class of laws (`lanes.KERNELS`), flows of one degree and St = 0 or not."""
    put_in: dict[str, Any] = {name: getattr(kernels, name) for name in _OF_THE_LAW}
    put_in |= kernels.for_compiler(degree) | {"unpack_flow": taylor.UNPACK[degree]}
    if massless:
        put_in |= {"rate_of_lane": loops.massless_lane, "state_of_one": loops.massless_state}
    plain: dict[str, FunctionType] = {}
    namespace: dict[str, Any] = {}

    def gather(function: FunctionType) -> None:
        """What the function finds among its globals, and the same of the functions it calls."""
        known = function.__globals__ | put_in
        for name in set(function.__code__.co_names) & known.keys():
            namespace.setdefault(name, known[name])
            if isinstance(known[name], FunctionType) and name not in plain:
                plain[name] = known[name]
                gather(known[name])

    outer = {name: value for name, value in vars(loops).items() if name.endswith("_block")}
    for loop in outer.values():
        gather(loop)
    files = {inspect.getfile(function) for function in (*plain.values(), *outer.values())}
    digest = hashlib.blake2b(digest_size=6)
    for file in sorted(files):
        digest.update(Path(file).read_bytes())
    version = digest.hexdigest()

    def compiled(name: str, function: FunctionType, **options: bool) -> Any:
        copy = FunctionType(function.__code__, namespace, name, function.__defaults__)
        copy.__module__ = function.__module__
        # The cache tells functions apart by their qualified names.
        law = kernels.__name__.rpartition(".")[2]
        copy.__qualname__ = f"{name}_{law}_{degree}_{massless:d}_{version}"
        return numba.njit(error_model="numpy", **options)(copy)

    for name, function in plain.items():
        namespace[name] = compiled(name, function, forceinline=True)
    kept = compiled_are_kept()
    by_name = {name: compiled(name, loop, cache=kept) for name, loop in outer.items()}
    return Loops(by_name, version)
