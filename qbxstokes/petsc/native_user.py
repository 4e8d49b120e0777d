"""The right-hand side of bodies in a compiled flow as a C function that PETSc calls.

See `native`; the functional on the grid of the run (`bie.compiled_motion`) is all it takes.
"""

from functools import cache
from typing import Any

import numba
import numpy as np
from numba import carray

from qbxstokes.bie.compiled_motion import CompiledMotion, rates_of
from qbxstokes.motion.layout import Layout
from qbxstokes.petsc.native import SIGNATURE, Native, closed, opened, pointer

# Places in the constants: calls, bodies, numbers of a state, whether some rate was no number; the
# instant up to which the flow is asked, points of the grid, the addresses of these and of their
# weights; and 21 rows of the bodies.
_CALLS, _COLUMNS, _STATE, _ASTRAY, _LAST, _POINTS, _WHERE, _WEIGHTS, _BODY = range(9)


@cache
def _compiled(point: Any) -> Any:
    """TSRHSFunction in one flow; `constants` as `NativeUser` lays them out."""

    def rate(_: Any, t: float, state: Any, out: Any, constants: Any) -> int:
        constants[_CALLS] += 1.0
        places = np.empty(2, np.intp)
        failed = opened(state, out, places)
        if failed:
            return failed
        n, nodes = int(constants[_COLUMNS]), int(constants[_POINTS])
        points = carray(pointer(int(constants[_WHERE])), (nodes, 3))
        weights = carray(pointer(int(constants[_WEIGHTS])), (nodes, 3, 6))
        size, now = int(constants[_STATE]), min(t, constants[_LAST])
        y, slope = carray(pointer(places[0]), (size, n)), carray(pointer(places[1]), (size, n))
        body = carray(constants, (_BODY + 21 * n,))[_BODY:].reshape(21, n)
        if not rates_of(point, now, y, points, weights, body, size > 7, slope):
            constants[_ASTRAY] = 1.0
            slope[:] = 0.0  # whatever comes of it is taken back
        return closed(state, out, places)

    return numba.cfunc(SIGNATURE, error_model="numpy")(rate)


class NativeUser(Native):
    """That of bodies in a compiled flow, by the grid that the motion is on at a step."""

    def __init__(self, motion: CompiledMotion, body: Any, layout: Layout) -> None:
        self._motion, self._flow = motion, motion.flow
        constants = np.concatenate([np.zeros(_BODY), body.ravel()])
        constants[_COLUMNS], constants[_STATE] = layout.columns, layout.n_state
        super().__init__(_compiled(motion.flow.point_function), constants)

    def prepare(self) -> None:
        """Before every step: the grid, and how far the flow may be asked."""
        assert self._motion.grid_of_run is not None
        c, (points, weights) = self._constants, self._motion.grid_of_run
        c[_ASTRAY] = 0.0
        c[_LAST] = self._flow.between(np.inf)
        c[_POINTS], c[_WHERE], c[_WEIGHTS] = len(points), points.ctypes.data, weights.ctypes.data

    @property
    def astray(self) -> bool:
        """Whether some rate was no number in the last step."""
        return bool(self._constants[_ASTRAY])
