"""The equations of motion for implicit formulas: residual, Jacobian, the end of Newton's steps."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from petsc4py import PETSc

from qbxstokes.errors import ContactError, FlowError
from qbxstokes.typing import Integers

if TYPE_CHECKING:
    from qbxstokes.petsc.system import System

# Error of a Newton step with an approximate Jacobian, in errors of a step of the integrator.
_ENOUGH = 0.05
_REASONS = PETSc.SNES.ConvergedReason


def give(system: System, ts: Any, vector: Any, weights: Any) -> None:
    """Let an integrator solve dy/dt - f(t, y) = 0 with the Jacobian shift I - df/dy.

    weights: the error of a step that is accepted where a component is small.
    """
    work = vector.duplicate()
    matrix, pattern = _matrix(system)
    # With the exact Jacobian the error left by a Newton step is its square times a curvature of
    # order one, else a part of it. Residuals are no measure: their rounding grows with the
    # stiffness. Each component is measured by its own size, as the steps are: a body far away has
    # orientation still.
    tolerance = system.local_tolerance
    enough = 0.1 / math.sqrt(tolerance) if system.equations.exact_jacobian else _ENOUGH
    weights = weights.getArray(readonly=1)
    if (native := system.native_implicit()) is not None:
        test = np.array([enough, tolerance, len(weights), *weights])
        native.solve_with(ts, work, matrix, test)
        return
    rate, jacobian = system.rate, _jacobian(system, pattern)

    def residual(ts: Any, t: float, state: Any, slope: Any, out: Any) -> None:
        rate(ts, t, state, work)
        out.waxpy(-1.0, work, slope)

    def shifted(
        ts: Any, t: float, state: Any, slope: Any, shift: float, _: Any, matrix: Any
    ) -> None:
        jacobian(t, state, matrix)
        matrix.scale(-1.0)
        matrix.shift(shift)

    ts.setIFunction(residual, vector.duplicate())
    ts.setIJacobian(shifted, matrix, matrix)

    def converged(snes: Any, iteration: int, norms: tuple[float, float, float]) -> int:
        if not math.isfinite(norms[2]):
            return int(_REASONS.DIVERGED_FUNCTION_DOMAIN)
        if iteration > 0:
            solution = np.abs(snes.getSolution().getArray(readonly=1))
            accepted = enough * (weights + tolerance * solution)
            if (np.abs(snes.getSolutionUpdate().getArray(readonly=1)) <= accepted).all():
                return int(_REASONS.CONVERGED_SNORM_RELATIVE)
        return int(_REASONS.CONVERGED_ITERATING)

    ts.getSNES().setConvergenceTest(converged)


def _matrix(system: System) -> tuple[Any, tuple[Integers, Integers]]:
    """Matrix of one dense block per lane, and its rows and columns; a dense one for one lane."""
    n, size = system.layout.lanes, system.layout.block
    rows = np.arange(0, n * size * size + 1, size, dtype=PETSc.IntType)
    columns = np.repeat(np.arange(n * size, dtype=PETSc.IntType).reshape(n, size), size, axis=0)
    pattern = rows, columns.ravel()
    if n == 1:
        dense = PETSc.Mat().createDense((size, size), comm=PETSc.COMM_SELF)
        dense.setUp()
        dense.assemble()
        return dense, pattern
    csr, whole = (*pattern, np.zeros(columns.size)), (n * size, n * size)
    return PETSc.Mat().createAIJ(whole, bsize=size, csr=csr, comm=PETSc.COMM_SELF), pattern


def _jacobian(
    system: System, pattern: tuple[Integers, Integers]
) -> Callable[[float, Any, Any], None]:
    """What writes df/dy at a time and state into the matrix."""
    counter, layout = system.counter, system.layout
    function = system.moving.jacobian_function(system.expected)
    blocks = np.empty((layout.lanes, layout.block, layout.block))
    indices = np.arange(layout.block, dtype=PETSc.IntType)

    def callback(t: float, state: Any, matrix: Any) -> None:
        counter.jacobians += 1
        try:
            try:
                function(t, system.componentwise(state.getArray(readonly=1)), blocks)
            except (FlowError, ContactError) as refusal:
                counter.refusal, counter.astray = refusal, True
            except ArithmeticError:
                counter.refusal, counter.astray = None, True
            if layout.lanes == 1 and not np.isfinite(blocks).all():
                counter.astray = True
            if counter.astray:
                blocks[:] = 0.0  # whatever comes of it is taken back
            if layout.lanes == 1:
                matrix.setValues(indices, indices, blocks[0])
            else:
                matrix.setValuesCSR(*pattern, blocks)
            matrix.assemble()
        except BaseException as failure:
            counter.failure = failure
            raise

    return callback
