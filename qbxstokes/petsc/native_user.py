"""The right-hand side of massless bodies in a compiled flow as a C function that PETSc calls.

See `native`; the functional on the grid of the run (`bie.compiled_motion`) is all it takes.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numba
import numpy as np
from numba import carray

from qbxstokes.bie.compiled_motion import CompiledMotion, massless_rates
from qbxstokes.petsc.native import (
    SIGNATURE,
    get_rate,
    get_state,
    give,
    library,
    pointer,
    restore_rate,
    restore_state,
)

_STATE = 7
# Places in the constants: calls, bodies, whether some rate was no number; the instant up to which
# the flow is asked, points of the grid, and the addresses of these and of their weights.
_CALLS, _COLUMNS, _ASTRAY, _LAST, _POINTS, _WHERE, _WEIGHTS, _END = 0, 1, 2, 3, 4, 5, 6, 7


@cache
def _compiled(point: Any) -> Any:
    """TSRHSFunction in one flow; `constants` as `NativeUser` lays them out."""

    def rate(_: Any, t: float, state: Any, out: Any, constants: Any) -> int:
        constants[_CALLS] += 1.0
        places = np.empty(2, np.intp)
        failed = get_state(state, places.ctypes)
        if failed:
            return failed
        failed = get_rate(out, places[1:].ctypes)
        if failed:
            return failed
        n, nodes = int(constants[_COLUMNS]), int(constants[_POINTS])
        points = carray(pointer(int(constants[_WHERE])), (nodes, 3))
        weights = carray(pointer(int(constants[_WEIGHTS])), (nodes, 3, 6))
        y, slope = carray(pointer(places[0]), (_STATE, n)), carray(pointer(places[1]), (_STATE, n))
        if not massless_rates(point, min(t, constants[_LAST]), y, points, weights, slope):
            constants[_ASTRAY] = 1.0
            slope[:] = 0.0  # whatever comes of it is taken back
        failed = restore_rate(out, places[1:].ctypes)
        if failed:
            return failed
        return restore_state(state, places.ctypes)

    return numba.cfunc(SIGNATURE, error_model="numpy")(rate)


class NativeUser:
    """As `native.NativeRate`; it takes the grid that the motion is on at the time of a step."""

    def __init__(self, motion: CompiledMotion, columns: int) -> None:
        self._motion, self._flow = motion, motion.flow
        self._constants = np.zeros(_END)
        self._constants[_COLUMNS] = columns
        self._address = _compiled(motion.flow.point_function).address

    def prepare(self) -> None:
        """Before every step: the grid, and how far the flow may be asked."""
        assert self._motion.grid is not None
        c, (points, weights) = self._constants, self._motion.grid
        c[_ASTRAY] = 0.0
        c[_LAST] = self._flow.before_break(np.inf)
        c[_POINTS], c[_WHERE], c[_WEIGHTS] = len(points), points.ctypes.data, weights.ctypes.data

    @property
    def astray(self) -> bool:
        """Whether some rate was no number in the last step."""
        return bool(self._constants[_ASTRAY])

    @property
    def calls(self) -> int:
        """How often PETSc has called it."""
        return int(self._constants[_CALLS])

    def give(self, ts: Any, work: Any) -> None:
        """Make it the right-hand side of an integrator; `work` is a vector for its value."""
        self.prepare()
        give(ts, work, self._address, self._constants)


def native_user(motion: CompiledMotion, columns: int) -> NativeUser | None:
    """The right-hand side for PETSc, None where it has to go through Python."""
    return None if library() is None else NativeUser(motion, columns)
