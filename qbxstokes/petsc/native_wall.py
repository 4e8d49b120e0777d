"""The right-hand side of one body over a wall as a C function that PETSc calls; see `native`.

Where the table has no cell yet, or none can be made, it asks Python, which makes the cell or solves
that instant.
"""

import ctypes
from collections.abc import Callable
from functools import cache
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba import carray, types
from numba.extending import intrinsic

from qbxstokes.errors import ContactError, FlowError
from qbxstokes.folders import compiled_are_kept
from qbxstokes.motion.coupled import WallConstants
from qbxstokes.motion.over_wall import rate
from qbxstokes.petsc.native import SIGNATURE, Native, closed, opened, pointer
from qbxstokes.typing import Array

_STATE = 7
# Places in the constants: calls, the address of the Python function, k, size, the first cell, then
# address and length of cells and of pieces and their width, and plane, terms and load themselves.
_CALLS, _PYTHON, _RATIO, _SIZE, _FIRST, _CELLS, _PIECES, _PLANE = 0, 1, 2, 3, 4, 5, 7, 10
_TERMS, _LOAD, _END = 19, 34, 40
_PYTHON_RATE = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_double, ctypes.c_void_p, ctypes.c_void_p)


@intrinsic
def _ask(context, address, t, state, out):  # type: ignore[no-untyped-def]
    """Call the function (double, address, address) -> int at an address."""

    def generate(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        word = ir.IntType(64)
        kind = ir.FunctionType(ir.IntType(32), [ir.DoubleType(), word, word])
        function = builder.inttoptr(arguments[0], kind.as_pointer())
        return builder.call(function, arguments[1:])

    return types.int32(types.intp, types.float64, types.intp, types.intp), generate


def _rate(_: Any, t: float, state: Any, out: Any, constants: Any) -> int:
    """TSRHSFunction; `constants` as `NativeOverWall` lays them out."""
    constants[_CALLS] += 1.0
    places = np.empty(2, np.intp)
    failed = opened(state, out, places)
    if failed:
        return failed
    c = carray(constants, (_END,))
    cells = carray(pointer(int(c[_CELLS])), (int(c[_CELLS + 1]), 5))
    pieces = carray(pointer(int(c[_PIECES])), (int(c[_PIECES + 1]), 42, int(c[_PIECES + 2])))
    plane, terms = c[_PLANE:_TERMS].reshape(3, 3), c[_TERMS:_LOAD].reshape(5, 3)
    y, slope = carray(pointer(places[0]), (_STATE,)), carray(pointer(places[1]), (_STATE,))
    first = int(c[_FIRST])
    where = rate(y, c[_LOAD:_END], plane, c[_RATIO], c[_SIZE], terms, first, cells, pieces, slope)
    asked = 0
    if where != -1:
        asked = _ask(int(c[_PYTHON]), t, places[0], places[1])
    failed = closed(state, out, places)
    return failed if failed else asked


@cache
def _compiled() -> Any:
    return numba.cfunc(SIGNATURE, cache=compiled_are_kept(), error_model="numpy")(_rate)


class NativeOverWall(Native):
    """That of one body over a wall.

    constants: of now, looked up again after the Python function (t, y (7,), dy/dt (7,)) has been
    asked, which may have made cells. counter: of the run, told what that function raises.
    """

    def __init__(
        self,
        constants: Callable[[], WallConstants],
        python: Callable[[float, Array, Array], None],
        counter: Any,
    ) -> None:
        self._source, self._python, self._counter = constants, python, counter
        super().__init__(_compiled(), np.zeros(_END))
        self._callback = _PYTHON_RATE(self._asked)
        self._constants[_PYTHON] = ctypes.cast(self._callback, ctypes.c_void_p).value or 0
        self._look()

    def _look(self) -> None:
        found, c = self._source(), self._constants
        self._kept = np.ascontiguousarray(found.cells), np.ascontiguousarray(found.pieces)
        cells, pieces = self._kept
        c[_RATIO], c[_SIZE], c[_FIRST] = found.ratio, found.size, found.first
        c[_CELLS], c[_CELLS + 1] = cells.ctypes.data, len(cells)
        c[_PIECES : _PIECES + 3] = pieces.ctypes.data, len(pieces), pieces.shape[2]
        c[_PLANE:_TERMS], c[_TERMS:_LOAD] = found.plane.ravel(), found.terms.ravel()
        c[_LOAD:] = found.load

    def _asked(self, t: float, state: int, out: int) -> int:
        y, slope = (
            np.ctypeslib.as_array((ctypes.c_double * _STATE).from_address(place))
            for place in (state, out)
        )
        counter = self._counter
        try:
            self._python(t, y, slope)
            self._look()
        except (FlowError, ContactError) as refusal:
            counter.refusal, counter.astray = refusal, True
            slope[:] = 0.0  # whatever comes of it is taken back
        except BaseException as failure:
            counter.failure = failure
            return 1
        return 0
