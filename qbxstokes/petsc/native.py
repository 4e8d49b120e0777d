"""The right-hand side of a block as a C function that PETSc calls without Python in between.

A call through petsc4py costs some 15 us, as much as a hundred bodies: small blocks would spend
their time there. Numba makes a C function of the compiled loop (motion/compiled.py) instead, with
the signature of TSRHSFunction. It finds PETSc's functions for arrays by their names.

This module imports numba, and is itself imported where blocks are compiled.
"""

import ctypes
import hashlib
from functools import cache
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any, NamedTuple, Self

import llvmlite.binding
import numba
import numpy as np
from numba import carray, types
from numba.extending import intrinsic
from petsc4py import PETSc

from qbxstokes.folders import compiled_are_kept
from qbxstokes.motion.compiled import compiled_loops
from qbxstokes.motion.layout import Layout
from qbxstokes.motion.loops import BlockConstants
from qbxstokes.typing import Array

_NUMBER = types.CPointer(types.float64)
# PetscErrorCode (TS, PetscReal, Vec, Vec, void *)
SIGNATURE = types.int32(types.voidptr, types.float64, types.voidptr, types.voidptr, _NUMBER)
_ARRAYS = ("VecGetArrayRead", "VecRestoreArrayRead", "VecGetArray", "VecRestoreArray")

get_state, restore_state, get_rate, restore_rate = (
    types.ExternalFunction(name, types.int32(types.voidptr, types.voidptr)) for name in _ARRAYS
)


@intrinsic
def pointer(context, address):  # type: ignore[no-untyped-def]
    """An address as a pointer to numbers."""

    def generate(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        return builder.inttoptr(arguments[0], context.get_value_type(_NUMBER))

    return _NUMBER(types.intp), generate


@intrinsic
def frozen(context, array):  # type: ignore[no-untyped-def]
    """An array as one that cannot be written to: what the loops are compiled for."""
    kind = array.copy(readonly=True)

    def generate(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        context.nrt.incref(builder, signature.return_type, arguments[0])
        return arguments[0]

    return kind(array), generate


# Put in for each kind of block before compilation: its loop, the numbers of a state, of a flow and
# of a body, whether those are of every lane, and whether there are loads, inertia, parts that
# follow the flow, and centres that stay.
_loop: Any = None
_STATE, _FLOW, _BODY = 7, 64, 17
_FLOWS, _BODIES, _LOADED, _INERTIAL, _FOLLOWING, _STILL, _CHANGING, _SINGLE = (False,) * 8

# Places of the constants: calls so far, number of columns, what follows the flow, address and size
# of the pieces of a flow that changes, Jacobians so far and whether a rate was no number (implicit
# formulas), and where the parts begin, in the order of `BlockConstants`.
_CALLS, _COLUMNS, _FOLLOW, _PIECES, _SIZE, JACOBIANS, ASTRAY, _PARTS = 0, 1, 2, 4, 5, 6, 7, 8
# Places in the pieces (`flow_rows`): how many, coefficients, rows and flows of each, the last one
# asked for, the instant as of which later ones are seen, and where the rows' places begin.
_COUNT, _DEGREES, _ROWS, _GROUPS, _PLACE, _LAST, _HEAD = 0, 1, 2, 3, 4, 5, 6


@numba.njit(error_model="numpy")
def _put(t: float, p: Any, flow: Any) -> None:
    """The numbers that flows have at time t into their table, from pieces p."""
    count, degrees, rows, groups = int(p[_COUNT]), int(p[_DEGREES]), int(p[_ROWS]), int(p[_GROUPS])
    lanes = _HEAD + rows
    edges = lanes + (flow.shape[1] if flow.ndim == 2 else 0)
    origins = edges + count + 1
    i, t = int(p[_PLACE]), min(t, p[_LAST])
    while i > 0 and t < p[edges + i]:
        i -= 1
    while i + 1 < count and t >= p[edges + i + 1]:
        i += 1
    p[_PLACE] = i
    x = (t - p[origins + i]) * p[origins + count + i]
    first = origins + 2 * count + i * degrees * rows * groups
    power = rows * groups
    for row in range(rows):
        target, last = int(p[_HEAD + row]), first + (degrees - 1) * power + row * groups
        if flow.ndim == 1:
            value = p[last]
            for k in range(1, degrees):
                value = value * x + p[last - k * power]
            flow[target] = value
        else:
            for lane in range(flow.shape[1]):
                group = int(p[lanes + lane])
                if group >= 0:
                    value = p[last + group]
                    for k in range(1, degrees):
                        value = value * x + p[last + group - k * power]
                    flow[target, lane] = value


@numba.njit(forceinline=True)
def opened(state: Any, rate: Any, places: Any) -> int:
    """Open the numbers of a state and of its rate: their addresses in places (2,); PETSc's error.

    The state's are read alone.
    """
    failed = get_state(state, places.ctypes)
    return failed if failed else get_rate(rate, places[1:].ctypes)


@numba.njit(forceinline=True)
def closed(state: Any, rate: Any, places: Any) -> int:
    """Give back what `opened` opened; PETSc's error."""
    failed = restore_rate(rate, places[1:].ctypes)
    return failed if failed else restore_state(state, places.ctypes)


def _parts_at(constants: Any, t: float) -> Any:
    """What a loop takes of a block besides the states, from constants as `NativeRate` has them."""
    n = int(constants[_COLUMNS])
    after_flow = _PARTS + (_FLOW * n if _FLOWS else _FLOW)
    after_body = after_flow + (_BODY * n if _BODIES else _BODY)
    after_loads = after_body + (12 * n if _LOADED else 0)
    after_rates = after_loads + (4 * n if _INERTIAL else 0)
    after_still = after_rates + (3 * n if _STILL else 0)
    c = carray(constants, (after_still,))
    flow = c[_PARTS:after_flow].reshape(_FLOW, n) if _FLOWS else c[_PARTS:after_flow]
    body = c[after_flow:after_body].reshape(_BODY, n) if _BODIES else c[after_flow:after_body]
    loads = c[after_body:after_loads].reshape(12, n) if _LOADED else None
    still = c[after_rates:after_still].reshape(3, n) if _STILL else None
    if _CHANGING:
        _put(t, carray(pointer(np.intp(c[_PIECES])), (int(c[_SIZE]),)), flow)
    rates = c[after_loads:after_rates].reshape(4, n) if _INERTIAL else None
    follow = (c[_FOLLOW], c[_FOLLOW + 1]) if _FOLLOWING else None
    return flow, body, loads, rates, follow, still


def _rate(_: Any, t: float, state: Any, rate: Any, constants: Any) -> int:
    """TSRHSFunction of a block."""
    n = int(constants[_COLUMNS])
    constants[_CALLS] += 1.0
    places = np.empty(2, np.intp)
    failed = opened(state, rate, places)
    if failed:
        return failed
    flow, body, loads, rates, follow, still = _parts_at(constants, t)
    y = frozen(carray(pointer(places[0]), (_STATE, n)))
    out = carray(pointer(places[1]), (_STATE, n))
    _loop(y, out, flow, body, loads, rates, follow, still)
    return closed(state, rate, places)


_OWN = hashlib.blake2b(Path(__file__).read_bytes(), digest_size=6).hexdigest()


class Kind(NamedTuple):
    """A kind of block, for which C functions are compiled: see above."""

    kernels: ModuleType
    degree: int
    sizes: tuple[int, int, int]
    flows: bool
    bodies: bool
    loaded: bool
    inertial: bool
    following: bool
    still: bool
    changing: bool
    single: bool

    @classmethod
    def of(cls, block: BlockConstants, layout: Layout) -> Self:
        """That of a block."""
        return cls(
            block.kernels,
            block.degree,
            (layout.n_state, len(block.flow), len(block.body)),
            block.flow.ndim == 2,
            block.body.ndim == 2,
            block.loads is not None,
            block.rates is not None,
            block.follow is not None,
            block.still is not None,
            block.changing is not None,
            layout.columns == 1,
        )

    def compiled(self, function: Any, signature: Any = None, **more: Any) -> Any:
        """A function above, with `more` among its globals, in C, or for other compiled ones.

        From numba's cache on disk where it is there, which looks at the file alone: the name tells
        the rest.
        """
        loops = compiled_loops(self.kernels, self.degree, not self.inertial)
        flags = self[3:]
        namespace = function.__globals__ | {
            "_loop": loops.by_name["single_block" if self.single else "rate_block"],
            "_slopes": loops.by_name["jacobian_block"],
            **dict(zip(("_STATE", "_FLOW", "_BODY"), self.sizes, strict=True)),
            **dict(zip((f"_{name.upper()}" for name in self._fields[3:]), flags, strict=True)),
            **more,
        }
        copy = FunctionType(function.__code__, namespace, function.__name__)
        copy.__module__ = function.__module__
        kind = "".join(f"{flag:d}" for flag in flags)
        law = self.kernels.__name__.rpartition(".")[2]
        kind = f"{law}_{self.degree}_{self.sizes[0]}_{kind}_{loops.version}_{_OWN}"
        name = f"{function.__name__}_{kind}"
        copy.__qualname__ = name
        if signature is None:
            return numba.njit(error_model="numpy", forceinline=True)(copy)
        return numba.cfunc(signature, cache=compiled_are_kept(), error_model="numpy")(copy)


@cache
def _compiled(kind: Kind) -> Any:
    return kind.compiled(_rate, SIGNATURE, _parts_at=kind.compiled(_parts_at))


@cache
def library() -> Any:
    """PETSc's library, None where its functions cannot be called by name.

    Numba is told the addresses one by one: opened for all to see, PETSc's libraries would hand
    their HDF5 to an h5py that is imported later and was built with another.
    """
    library = ctypes.CDLL(PETSc.__file__)
    known = all(hasattr(library, name) for name in (*_ARRAYS, "TSSetRHSFunction"))
    if not known or np.dtype(PETSc.ScalarType) != np.float64:
        return None
    for name in _ARRAYS:
        known_to_numba(library, name)
    return library


def known_to_numba(library: Any, name: str) -> None:
    """Tell numba where a function of the library is."""
    address = ctypes.cast(getattr(library, name), ctypes.c_void_p).value
    llvmlite.binding.add_symbol(name, address)


class Native:
    """A compiled right-hand side, ready to be given to integrators.

    It has to outlive them: PETSc keeps the addresses of the function and of its constants, of which
    the first counts the calls.
    """

    everywhere = False  # whether it has a value wherever the state is finite

    def __init__(self, function: Any, constants: Array) -> None:
        self._function, self._constants = function, constants

    @classmethod
    def made(cls, *arguments: Any) -> Self | None:
        """One of these arguments, None where calls have to go through Python."""
        return None if library() is None else cls(*arguments)

    @property
    def calls(self) -> int:
        """How often PETSc has called it."""
        return int(self._constants[_CALLS])

    @property
    def astray(self) -> bool:
        """Whether some rate was no number in the last step."""
        return False

    @property
    def jacobians(self) -> int:
        """How many Jacobians PETSc has asked for."""
        return 0

    def prepare(self) -> None:
        """Before every step: take up what has changed."""

    def give(self, ts: Any, work: Any) -> None:
        """Make it the right-hand side of an integrator; `work` is a vector for its value."""
        self.prepare()
        place = ctypes.c_void_p
        numbers = (self._function.address, self._constants.ctypes.data)
        handles = (place(number) for number in (ts.handle, work.handle, *numbers))
        if failed := library().TSSetRHSFunction(*handles):
            raise PETSc.Error(failed)


class NativeRate(Native):
    """That of a block."""

    _functions = staticmethod(_compiled)
    everywhere = True

    def __init__(self, block: BlockConstants, layout: Layout) -> None:
        function = self._functions(Kind.of(block, layout))
        head = np.zeros(_PARTS)
        head[_COLUMNS] = layout.columns
        if block.follow is not None:
            head[_FOLLOW : _FOLLOW + 2] = block.follow
        parts = block.flow, block.body, block.loads, block.rates, block.still
        given = [part.ravel() for part in parts if part is not None]
        super().__init__(function, np.concatenate([head, *given]))
        self._changing, self._known = block.changing, None
        self._pieces = np.zeros(_HEAD)
        self.renew()

    def renew(self) -> None:
        """Take up what has become known of a flow that changes in time."""
        if self._changing is None:
            return
        edges, *parts = self._changing.pieces
        if self._known is not edges:
            self._known, coefficients = edges, parts[-1]
            head = [len(coefficients), *coefficients.shape[1:], 0.0, 0.0]
            group = [] if self._changing.group is None else self._changing.group
            given = [head, self._changing.rows, group, edges, *(part.ravel() for part in parts)]
            self._pieces = np.concatenate(given)
            self._constants[_PIECES] = self._pieces.ctypes.data
            self._constants[_SIZE] = len(self._pieces)
        self._pieces[_LAST] = self._changing.last
