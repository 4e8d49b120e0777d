"""One body's equations in C for implicit formulas: residual, Jacobian, the end of Newton's steps.

As `native` for explicit ones; the Jacobian is that of `motion.loops`, by complex steps. This module
imports numba, and is itself imported where compiled kernels serve.
"""

import ctypes
import math
from functools import cache
from typing import Any

import numba
import numpy as np
from numba import carray, types
from petsc4py import PETSc

from qbxstokes.folders import compiled_are_kept
from qbxstokes.motion.layout import Layout
from qbxstokes.motion.loops import BlockConstants
from qbxstokes.petsc import native
from qbxstokes.petsc.native import ASTRAY, JACOBIANS, Kind, NativeRate, closed, library, opened
from qbxstokes.petsc.native import frozen as _frozen
from qbxstokes.petsc.native import pointer as _pointer
from qbxstokes.typing import Array

_NUMBER, _PLACE = types.CPointer(types.float64), types.voidptr
_INTEGER = types.int32 if np.dtype(PETSc.IntType).itemsize == 4 else types.int64
# PetscErrorCode (TS, PetscReal, Vec, Vec, Vec, void *), (TS, PetscReal, Vec, Vec, PetscReal, Mat,
# Mat, void *) and (SNES, PetscInt, PetscReal, PetscReal, PetscReal, SNESConvergedReason *, void *)
_RESIDUAL = types.int32(_PLACE, types.float64, _PLACE, _PLACE, _PLACE, _NUMBER)
_JACOBIAN = types.int32(
    _PLACE, types.float64, _PLACE, _PLACE, types.float64, *2 * [_PLACE], _NUMBER
)
_TEST = types.int32(_PLACE, _INTEGER, *3 * [types.float64], types.CPointer(types.int32), _NUMBER)
_ARRAYS = "MatDenseGetArray", "MatDenseRestoreArray", "SNESGetSolution", "SNESGetSolutionUpdate"
_SETTERS = "TSSetIFunction", "TSSetIJacobian", "SNESSetConvergenceTest"
_get_matrix, _restore_matrix, _get_solution, _get_update = (
    types.ExternalFunction(name, types.int32(_PLACE, _PLACE)) for name in _ARRAYS
)
_read, _release = (
    types.ExternalFunction(name, types.int32(types.intp, _PLACE))
    for name in ("VecGetArrayRead", "VecRestoreArrayRead")
)
_GOING_ON = int(PETSc.SNES.ConvergedReason.CONVERGED_ITERATING)
_DONE = int(PETSc.SNES.ConvergedReason.CONVERGED_SNORM_RELATIVE)
_LOST = int(PETSc.SNES.ConvergedReason.DIVERGED_FUNCTION_DOMAIN)

# Put in for each kind of block (`native.Kind`).
_rate: Any = None
_parts_at: Any = None
_slopes: Any = None
_STATE = 7


def _residual(ts: Any, t: float, state: Any, slope: Any, out: Any, constants: Any) -> int:
    """TSIFunction: dy/dt - f(t, y); dy/dt alone where f is no number, to be taken back."""
    failed = _rate(ts, t, state, out, constants)
    if failed:
        return failed
    places = np.empty(2, np.intp)
    failed = opened(slope, out, places)
    if failed:
        return failed
    given, left = carray(_pointer(places[0]), (_STATE,)), carray(_pointer(places[1]), (_STATE,))
    total = 0.0
    for i in range(_STATE):
        total += left[i]
    if not math.isfinite(total):
        constants[ASTRAY] = 1.0
    for i in range(_STATE):
        left[i] = given[i] - left[i] if constants[ASTRAY] == 0.0 else given[i]
    return closed(slope, out, places)


def _jacobian(
    _: Any, t: float, state: Any, slope: Any, shift: float, own: Any, matrix: Any, constants: Any
) -> int:
    """TSIJacobian: shift - df/dy of a dense matrix."""
    constants[JACOBIANS] += 1.0
    places = np.empty(2, np.intp)
    failed = opened(state, slope, places)
    if failed:
        return failed
    flow, body, loads, rates, follow, _still = _parts_at(constants, t)
    y, found = _frozen(carray(_pointer(places[0]), (_STATE, 1))), np.empty((1, _STATE, _STATE))
    _slopes(y, found, flow, body, loads, rates, follow)
    failed = closed(state, slope, places)
    if failed:
        return failed
    failed = _get_matrix(matrix, places.ctypes)
    if failed:
        return failed
    entries, total = carray(_pointer(places[0]), (_STATE, _STATE)), 0.0  # by columns
    for i in range(_STATE):
        for j in range(_STATE):
            total += found[0, i, j]
    if not math.isfinite(total):
        constants[ASTRAY] = 1.0
    for i in range(_STATE):
        for j in range(_STATE):
            entries[j, i] = -found[0, i, j] if constants[ASTRAY] == 0.0 else 0.0
        entries[i, i] += shift
    return _restore_matrix(matrix, places.ctypes)


def _converged(
    snes: Any, iteration: int, x: float, g: float, norm: float, reason: Any, constants: Any
) -> int:
    """SNES's test: whether the last update is within what is accepted of every component.

    constants: the share of a step's error that is, the local tolerance, how many components, and
    their weights.
    """
    reason[0] = _GOING_ON
    if not math.isfinite(norm):
        reason[0] = _LOST
        return 0
    if iteration == 0:
        return 0
    vectors, places = np.empty(2, np.intp), np.empty(2, np.intp)
    failed = _get_solution(snes, vectors.ctypes) + _get_update(snes, vectors[1:].ctypes)
    for i in range(2):
        failed += _read(vectors[i], places[i:].ctypes)
    if failed:
        return failed
    enough, relative, count = constants[0], constants[1], int(constants[2])
    size, change = carray(_pointer(places[0]), (count,)), carray(_pointer(places[1]), (count,))
    reason[0] = _DONE
    for i in range(count):
        if not abs(change[i]) <= enough * (constants[3 + i] + relative * abs(size[i])):
            reason[0] = _GOING_ON
    for i in range(2):
        failed += _release(vectors[i], places[i:].ctypes)
    return failed


@cache
def _test() -> Any:
    return numba.cfunc(_TEST, cache=compiled_are_kept(), error_model="numpy")(_converged)


@cache
def _compiled(kind: Kind) -> tuple[Any, Any]:
    parts = kind.compiled(native._parts_at)
    rate = kind.compiled(native._rate, _parts_at=parts)
    return (
        kind.compiled(_residual, _RESIDUAL, _rate=rate),
        kind.compiled(_jacobian, _JACOBIAN, _parts_at=parts),
    )


class NativeImplicit(NativeRate):
    """The equations of a single body, for integrators with implicit formulas."""

    _functions = staticmethod(_compiled)

    def __init__(self, block: BlockConstants, layout: Layout) -> None:
        super().__init__(block, layout)
        self._tests: list[Array] = []

    @classmethod
    def made(cls, block: BlockConstants, layout: Layout) -> "NativeImplicit | None":
        """None where calls have to go through Python: of a rotation alone for its Jacobian."""
        if block.still is not None:
            return None
        found = library()
        names = *_ARRAYS, *_SETTERS
        if found is None or layout.columns > 1 or not all(hasattr(found, name) for name in names):
            return None
        for name in _ARRAYS:
            native.known_to_numba(found, name)
        return cls(block, layout)

    @property
    def astray(self) -> bool:
        """Whether some rate was no number in the last step."""
        return bool(self._constants[ASTRAY])

    @property
    def jacobians(self) -> int:
        """How many PETSc has asked for."""
        return int(self._constants[JACOBIANS])

    def prepare(self) -> None:
        """Before every step."""
        self._constants[ASTRAY] = 0.0

    def solve_with(self, ts: Any, work: Any, matrix: Any, test: Array) -> None:
        """Make it the equations of an integrator, with the constants of `_converged`."""
        self._tests = [*self._tests[-3:], test]  # of integrators that live
        (residual, jacobian), own, petsc = self._function, self._constants.ctypes.data, library()
        equations, newton = ts.handle, ts.getSNES().handle
        for name, *handles in (
            ("TSSetIFunction", equations, work.handle, residual.address, own),
            ("TSSetIJacobian", equations, matrix.handle, matrix.handle, jacobian.address, own),
            ("SNESSetConvergenceTest", newton, _test().address, test.ctypes.data, 0),
        ):
            if failed := getattr(petsc, name)(*map(ctypes.c_void_p, handles)):
                raise PETSc.Error(failed)
