"""The coupled problem of several bodies as a PETSc shell matrix, solved by GMRES.

The one-body inverses are inside the matrix (`bie.multiple_scattering`), which is the identity plus
a compact operator. Bodies are dealt to the ranks of a communicator; at each product they gather
the coefficients of all bodies' exterior flows and each evaluates them on its own bodies. Ranks wait
for each other asleep: the machine may have other work.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from petsc4py import PETSc

from qbxstokes.bie.multiple_scattering import Coupled
from qbxstokes.errors import ConvergenceError
from qbxstokes.petsc.launch import finish_asleep
from qbxstokes.petsc.session import temporary_options
from qbxstokes.typing import Array, ComplexArray

_RESTART = 200
PAUSE = 2e-5  # seconds between looks of a rank that waits for others in a solve


class CoupledSolver:
    """GMRES on a coupled problem; options `-ksp_*` apply. Right-hand sides one after the other.

    problem: with the bodies of this rank as its own, see `own_bodies`. free: bodies under given
    loads, else of given motion. tolerance: of the residual relative to the data.
    """

    def __init__(
        self, problem: Coupled, free: bool, tolerance: float = 1e-10, comm: Any = None
    ) -> None:
        self.problem, self.free = problem, free
        self.comm = PETSc.COMM_SELF if comm is None else comm
        self._mpi = self.comm.tompi4py() if self.comm.getSize() > 1 else None
        if self._mpi is not None:
            finish_asleep(self._mpi.Ibarrier(), PAUSE)
            self._shares = self._mpi.allgather(list(problem.rows))
        self.latest: tuple[int, float] = 0, 0.0  # iterations, and residual relative to the data
        size = (problem.size, PETSc.DETERMINE)
        self._matrix = PETSc.Mat().createPython([size, size], self, comm=self.comm)
        self._matrix.setUp()
        self._ksp = ksp = PETSc.KSP().create(self.comm)
        ksp.setOperators(self._matrix)
        ksp.setType(PETSc.KSP.Type.GMRES)
        ksp.setGMRESRestart(_RESTART)
        ksp.setTolerances(rtol=tolerance, atol=1e-300, max_it=_RESTART)
        ksp.getPC().setType(PETSc.PC.Type.NONE)
        with temporary_options("", {}, {}):
            ksp.setFromOptions()
        self._solution, self._rhs = self._matrix.createVecs()

    def gathered(self, own: Sequence[NDArray[Any]], sizes: Sequence[int]) -> list[NDArray[Any]]:
        """Arrays of all bodies, flows or motions of known sizes, from those of each rank's own."""
        if self._mpi is None:
            return list(own)
        counts = [sum(sizes[b] for b in share) for share in self._shares]
        mine = np.concatenate([np.zeros(0), *(array.ravel() for array in own)], dtype=complex)
        whole = np.empty(sum(counts), dtype=complex)
        finish_asleep(self._mpi.Iallgatherv(mine, [whole, counts]), PAUSE)
        order = [b for share in self._shares for b in share]
        parts = np.split(whole, np.cumsum([sizes[b] for b in order])[:-1])
        return [part for _, part in sorted(zip(order, parts, strict=True), key=_first)]

    def sent(self, own: Sequence[ComplexArray]) -> list[ComplexArray]:
        """Flows of all bodies from those of each rank's own."""
        shapes = [one.shape_of_flows for one in self.problem.maps]
        found = self.gathered(own, [math.prod(shape) for shape in shapes])
        return [flow.reshape(shape) for flow, shape in zip(found, shapes, strict=True)]

    def mult(self, mat: Any, x: Any, y: Any) -> None:
        """y = x + what arrives at each body when all send what x makes them send."""
        problem, unknowns = self.problem, x.getArray(readonly=1)
        flows = self.sent(problem.flows(problem.split(unknowns), self.free))
        arriving = problem.joined([problem.arriving(b, flows) for b in problem.rows])
        y.setArray(unknowns + arriving)
        if self._mpi is not None:  # PETSc's own sums over the ranks, next, wait awake
            finish_asleep(self._mpi.Ibarrier(), PAUSE)

    def solve(self, data: list[Array], guess: Array | None = None) -> Array:
        """Unknowns of the own bodies for data (N, 3) on each. Raises ConvergenceError."""
        ksp: Any = self._ksp
        self._rhs.setArray(self.problem.joined(data))
        if self._rhs.norm() == 0.0:
            self.latest = 0, 0.0
            return np.zeros(self.problem.size)
        ksp.setInitialGuessNonzero(guess is not None)
        if guess is not None:
            self._solution.setArray(guess)
        ksp.solve(self._rhs, self._solution)
        steps, left = ksp.getIterationNumber(), ksp.getResidualNorm() / self._rhs.norm()
        self.latest = steps, float(left)
        if ksp.getConvergedReason() <= 0:
            raise ConvergenceError(
                f"GMRES on {len(self.problem.bodies)} coupled bodies stopped after "
                f"{steps} iterations at the relative residual {left:.1e} (reason "
                f"{ksp.getConvergedReason()}): loosen the tolerance, or move bodies apart"
            )
        return np.array(self._solution.getArray(readonly=1))

    def release(self) -> None:
        """Destroy what PETSc holds."""
        self._ksp.destroy()
        self._matrix.destroy()
        self._solution.destroy()
        self._rhs.destroy()


def _first(pair: tuple[int, Any]) -> int:
    return pair[0]


def own_bodies(nodes: list[int], comm: Any) -> list[int]:
    """Bodies of this rank: the costly ones dealt first, each to the rank with least so far."""
    load, own, whole = np.zeros(comm.getSize()), [], sum(n * n for n in nodes)
    for b in sorted(range(len(nodes)), key=lambda b: (-nodes[b], b)):
        rank = int(np.argmin(load))
        points = nodes[b] ** 2  # at which the flows of all others are summed
        load[rank] += points * (whole - points) if len(nodes) > 1 else 1.0
        if rank == comm.getRank():
            own.append(b)
    return sorted(own)


def over(comm: Any) -> Any:
    """PETSc's communicator over the ranks of MPI's; None of a single one."""
    return None if comm.size == 1 else PETSc.Comm(comm)
