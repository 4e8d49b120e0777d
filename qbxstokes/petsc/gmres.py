"""Solution of the integral equation by PETSc's GMRES, with the true residual checked.

A modal operator is a PETSc shell matrix, and its inverse a PETSc shell preconditioner.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from petsc4py import PETSc

from qbxstokes.errors import ConvergenceError
from qbxstokes.geometry.grid import SurfaceGrid
from qbxstokes.petsc.session import LIVE, temporary_options
from qbxstokes.qbx.modes import ModalOperator
from qbxstokes.typing import Array

# The true residual may exceed the tolerance by this factor before the solve counts as failed.
RESIDUAL_MARGIN = 10.0
# Corrections of the solution by the true residual; each costs one more solve.
REFINEMENTS = 2


class ShellContext:
    """What PETSc calls on an operator: products as of a matrix, or as of a preconditioner."""

    def __init__(self, operator: ModalOperator) -> None:
        self.operator = operator

    def mult(self, _: Any, x: Any, y: Any) -> None:
        """y = A x on the density in R^(3N)."""
        y.setArray(self.operator.apply(x.getArray(readonly=1)).ravel())

    def multTranspose(self, _: Any, x: Any, y: Any) -> None:
        """y = A^T x."""
        y.setArray(self.operator.apply_transpose(x.getArray(readonly=1)).ravel())

    apply, applyTranspose = mult, multTranspose


def shell_matrix(operator: ModalOperator) -> Any:
    """PETSc shell Mat (3N x 3N) of the operator, on this process alone.

    The density of one body is small and the operator cheap to apply: parallelism goes over rows of
    the set-up and over bodies, never through this matrix.
    """
    size = 3 * operator.n_theta * operator.n_phi
    matrix = PETSc.Mat().createPython([size, size], ShellContext(operator), comm=PETSc.COMM_SELF)
    matrix.setUp()
    return matrix


@dataclass(frozen=True)
class SolveRecord:
    """One solve: iterations, the residual GMRES reports and the true one, relative to the data."""

    iterations: int
    reported_residual: float
    true_residual: float


class GmresSolver:
    """GMRES on a modal operator as a shell matrix; options `-ksp_*` and `-pc_*` apply.

    The unknown is the density times the root of the quadrature weights, so that the Euclidean norm
    of PETSc is the L2 norm on the surface and operator and adjoint are equally well conditioned
    (without it the adjoint of a thin body takes ten times the iterations).
    tolerance: of the true residual relative to the right-hand side, or, where the solution is so
    large that rounding alone exceeds it, of the backward error.
    preconditioned: apply the mode-wise inverse of the operator as a shell preconditioner.
    Raises ConvergenceError when KSP diverges or the true residual misses the tolerance.
    """

    def __init__(
        self,
        operator: ModalOperator,
        grid: SurfaceGrid,
        tolerance: float = 1e-13,
        preconditioned: bool = True,
    ) -> None:
        self.records: list[SolveRecord] = []
        root = np.sqrt(grid.weights.reshape(grid.n_theta, grid.n_phi)[:, 0])
        self._scale = np.repeat(root, 3 * grid.n_phi)
        self._operator = operator = operator.balanced(root)
        self._matrix = shell_matrix(operator)
        self._ksp = PETSc.KSP().create(PETSc.COMM_SELF)
        ksp = self._ksp
        ksp.setOperators(self._matrix)
        ksp.setType(PETSc.KSP.Type.GMRES)
        ksp.setGMRESRestart(300)
        ksp.setTolerances(rtol=tolerance, atol=0.0, divtol=1e6, max_it=300)
        ksp.setPCSide(PETSc.PC.Side.RIGHT)
        pc = ksp.getPC()
        if preconditioned:
            pc.setType(PETSc.PC.Type.PYTHON)
            pc.setPythonContext(ShellContext(operator.inverse))
        else:
            pc.setType(PETSc.PC.Type.NONE)
        # Classical Gram-Schmidt, PETSc's default, loses the basis for k < 1/20 and stagnates.
        modified = (
            {"ksp_orthogonalization": "mgs"}
            if PETSc.Sys.getVersion() >= (3, 26)
            else {"ksp_gmres_modifiedgramschmidt": "true"}
        )
        with temporary_options("", modified, {}):
            ksp.setFromOptions()
        self._solution, self._rhs = self._matrix.createVecs()
        self._product = self._rhs.duplicate()
        LIVE.add(self)

    def release(self) -> None:
        """Destroy what PETSc holds; the records stay."""
        self._ksp.destroy()
        self._matrix.destroy()

    def solve(self, rhs: Array) -> Array:
        """Solution (N, 3) of A x = rhs, rhs of shape (N, 3)."""
        solution = self._run(np.ravel(rhs) * self._scale, transposed=False)
        return (solution / self._scale).reshape(np.shape(rhs))

    def solve_transpose(self, rhs: Array) -> Array:
        """Solution (N, 3) of A^T x = rhs, rhs of shape (N, 3)."""
        solution = self._run(np.ravel(rhs) / self._scale, transposed=True)
        return (solution * self._scale).reshape(np.shape(rhs))

    def _run(self, rhs: Array, transposed: bool) -> Array:
        ksp: Any = self._ksp
        b, x, r = self._rhs, self._solution, self._product
        solve = ksp.solveTranspose if transposed else ksp.solve
        multiply = self._matrix.multTranspose if transposed else self._matrix.mult
        b.setArray(rhs)
        norm = b.norm()
        if norm == 0.0:
            return np.zeros_like(rhs)
        tolerance = ksp.getTolerances()[0]
        total = np.zeros(b.getLocalSize())
        iterations, true = 0, 1.0
        for _ in range(1 + REFINEMENTS):
            solve(b, x)
            reason = ksp.getConvergedReason()
            reported = true * ksp.getResidualNorm() / b.norm()
            iterations += ksp.getIterationNumber()
            previous = true
            candidate = total + x.getArray(readonly=1)
            x.setArray(candidate)
            multiply(x, r)
            b.setArray(rhs - r.getArray(readonly=1))
            true = b.norm() / norm
            if true < previous or not total.any():
                total = candidate
            # The last digits of A x round to this, whatever the solver does.
            attainable = np.finfo(float).eps * self._operator.norm * np.linalg.norm(total) / norm
            if reason < 0 or true <= max(tolerance, attainable) or true > 0.5 * previous:
                break
        true = min(true, previous)
        self.records.append(SolveRecord(iterations, reported, true))
        if not true <= RESIDUAL_MARGIN * max(tolerance, attainable):
            raise ConvergenceError(
                f"GMRES stopped after {iterations} iterations with true relative residual "
                f"{true:.1e} (reported {reported:.1e}, asked for {tolerance:.1e}, reason "
                f"{_reason_name(reason)}); {self._advice(true)}"
            )
        return total

    def _advice(self, left: float) -> str:
        """What helps where a residual is left."""
        if self._ksp.getPC().getType() == PETSc.PC.Type.NONE:
            return "turn hydrodynamics.preconditioner on"
        if left < 1e-6:
            reached = 10.0 ** np.ceil(np.log10(left))
            return f"set hydrodynamics.gmres_tolerance to {reached:.0e} or more"
        return "rounding leaves no less: a body this thin or flat is beyond double precision"


def _reason_name(reason: int) -> str:
    names = {v: n for n, v in vars(PETSc.KSP.ConvergedReason).items() if isinstance(v, int)}
    return f"{names.get(reason, 'unknown')} ({reason})"
