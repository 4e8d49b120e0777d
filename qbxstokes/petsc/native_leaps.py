"""Steps of an integrator one after the other in C, see `leaps`.

This module imports numba, and is itself imported where compiled kernels serve.
"""

import hashlib
import inspect
import math
from functools import cache
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba import carray, types

from qbxstokes.folders import compiled_are_kept
from qbxstokes.motion import events, taylor
from qbxstokes.motion.events import LARGEST_TURN, STILL
from qbxstokes.petsc.native import known_to_numba, library, pointer

_PLACE = types.voidptr
_NAMES = "TSGetTime", "TSGetTimeStep", "TSGetConvergedReason", "VecGetArrayRead"
_get_time, _get_step, _get_reason, _get_state, _restore_state = (
    types.ExternalFunction(name, types.int32(types.intp, _PLACE))
    for name in (*_NAMES, "VecRestoreArrayRead")
)
_step = types.ExternalFunction("TSStep", types.int32(types.intp))
_set_step = types.ExternalFunction("TSSetTimeStep", types.int32(types.intp, types.float64))
_axis = numba.njit(error_model="numpy")(taylor.symmetry_axis)


@numba.njit(error_model="numpy")
def _passage(y: Any, place: int, stretch: float, n: Any) -> Any:
    """As in `motion.events.Passage`: the axis along the normal, and its stretched angle."""
    d1, d2, d3 = _axis((y[place], y[place + 1], y[place + 2], y[place + 3]))
    along, across = d1 * n[0] + d2 * n[1] + d3 * n[2], d1 * n[3] + d2 * n[4] + d3 * n[5]
    if not math.hypot(along, across) > STILL:
        return 0.0, 0.0
    return along, math.atan2(across, stretch * along)


@numba.njit(error_model="numpy")
def _passed(start: Any, now: Any, place: int, stretch: float, planes: Any) -> bool:
    """Whether the axis passes the plane between two states, or turns far."""
    a, first = _passage(start, place, stretch, planes)
    b, second = _passage(now, place, stretch, planes)
    turn = abs(second - first)
    far = min(turn, 2.0 * math.pi - turn) > LARGEST_TURN
    return far or (a > 0.0) != (b > 0.0) or (a < 0.0) != (b < 0.0)


def _leap(  # type: ignore[no-untyped-def]
    ts, vector, until, known, most, start, edges, place, stretch, planes
):
    """Steps of `ts`, whose solution is `vector`: PETSc's error, when the last one began, `passed`.

    That is the first which ends at `until` or later, in which the axis passes a plane, which has to
    be judged, or the `most`th, or from whose end one more would go beyond `known`. start becomes
    the state at its beginning. edges: of pieces of the flow, of which a step may see the next two
    (`flows.signals.Sampled.near`). place: of q in the state. planes: normal and across (6,).
    passed: whether the axis passes the plane in the last step, or may do.
    """
    where, reason, clock = np.empty(1, np.intp), np.zeros(1, np.int32), np.empty(2)
    failed, now, passed = _get_time(ts, clock.ctypes), start.copy(), True
    before = clock[0]
    for taken in range(most):
        t = clock[0]
        failed += _get_step(ts, clock[1:].ctypes)
        if failed or (taken and t + clock[1] > known - 1e-3 * clock[1]):
            break
        failed, passed = _get_state(vector, where.ctypes), True
        before, start[:] = t, carray(pointer(where[0]), (len(start),))
        failed += _restore_state(vector, where.ctypes)
        last = np.searchsorted(edges, t, "right") + 1
        if last < len(edges) and edges[last] < t + clock[1]:
            failed += _set_step(ts, edges[last] - t)
        failed += _step(ts) + _get_time(ts, clock.ctypes) + _get_reason(ts, reason.ctypes)
        if failed or reason[0] < 0 or not t < clock[0]:
            break
        failed = _get_state(vector, where.ctypes)
        now[:] = carray(pointer(where[0]), (len(start),))
        failed += _restore_state(vector, where.ctypes)
        if failed or not math.isfinite(np.sum(np.abs(now))):
            break
        passed = stretch > 0.0 and _passed(start, now, place, stretch, planes)
        if passed or reason[0] > 0 or clock[0] >= until:
            break
    return failed, before, passed


@cache
def compiled_leap() -> Any:
    """The function above, compiled."""
    petsc = library()
    for name in (*_NAMES, "VecRestoreArrayRead", "TSStep", "TSSetTimeStep"):
        known_to_numba(petsc, name)
    # numba's cache watches this file alone: the name tells what else is compiled in.
    read = b"".join(Path(inspect.getfile(m)).read_bytes() for m in (events, taylor))
    _leap.__qualname__ = f"_leap_{hashlib.blake2b(read, digest_size=6).hexdigest()}"
    return numba.njit(cache=compiled_are_kept(), error_model="numpy")(_leap)
