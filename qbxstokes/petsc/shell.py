"""A modal operator as a PETSc shell matrix, and its inverse as a PETSc shell preconditioner."""

from typing import Any

from petsc4py import PETSc

from qbxstokes.qbx.modes import ModalOperator


class ShellContext:
    """What PETSc calls on the operator: products with the matrix and its transpose."""

    def __init__(self, operator: ModalOperator) -> None:
        self.operator = operator

    def mult(self, mat: Any, x: Any, y: Any) -> None:
        """y = A x on the density in R^(3N)."""
        y.setArray(self.operator.apply(x.getArray(readonly=1)).ravel())

    def multTranspose(self, mat: Any, x: Any, y: Any) -> None:
        """y = A^T x."""
        y.setArray(self.operator.apply_transpose(x.getArray(readonly=1)).ravel())


class PreconditionerContext:
    """The inverse of the operator, mode by mode, as PETSc applies a preconditioner."""

    def __init__(self, inverse: ModalOperator) -> None:
        self.inverse = inverse

    def apply(self, pc: Any, x: Any, y: Any) -> None:
        """y = P^-1 x."""
        y.setArray(self.inverse.apply(x.getArray(readonly=1)).ravel())

    def applyTranspose(self, pc: Any, x: Any, y: Any) -> None:
        """y = P^-T x."""
        y.setArray(self.inverse.apply_transpose(x.getArray(readonly=1)).ravel())


def shell_matrix(operator: ModalOperator) -> Any:
    """PETSc shell Mat (3N x 3N) of the operator, on this process alone.

    The density of one body is small and the operator cheap to apply: parallelism goes over rows of
    the set-up and over bodies, never through this matrix.
    """
    size = 3 * operator.n_theta * operator.n_phi
    matrix = PETSc.Mat().createPython([size, size], ShellContext(operator), comm=PETSc.COMM_SELF)
    matrix.setUp()
    return matrix
