"""The coupled problem of several bodies as a PETSc shell matrix, solved by GMRES.

The one-body inverses are inside the matrix (`bie.multiple_scattering`), which is the identity plus
a compact operator. Bodies are dealt to the ranks of a communicator; at each product they gather
the coefficients of all bodies' exterior flows and each evaluates them on its own bodies. Ranks wait
for each other asleep: the machine may have other work.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qbxstokes.bie.multiple_scattering import Coupled
from qbxstokes.errors import ConvergenceError
from qbxstokes.petsc.launch import finish_asleep
from qbxstokes.petsc.session import start, temporary_options
from qbxstokes.typing import Array, ComplexArray

PETSc = start()  # no process by itself waits for others to join it

_RESTART = 200
# Seconds between looks of a rank that waits for others in a solve, and before it sleeps at all.
PAUSE, AWAKE = 2e-5, 1e-4


class CoupledSolver:
    """GMRES on a coupled problem; options `-ksp_*` apply. Right-hand sides one after the other.

    problem: with the bodies of this rank as its own, see `dealt`. free: bodies under given
    loads, else of given motion. tolerance: of the residual relative to the data.
    """

    def __init__(
        self, problem: Coupled, free: bool, tolerance: float = 1e-10, comm: Any = None
    ) -> None:
        self.problem, self.free = problem, free
        self.comm = PETSc.COMM_SELF if comm is None else comm
        self._mpi = self.comm.tompi4py() if self.comm.getSize() > 1 else None
        if self._mpi is not None:
            finish_asleep(self._mpi.Ibarrier(), PAUSE, AWAKE)
            self._shares = dealt(problem, self.comm.getSize())
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

    def gathered(self, own: Mapping[int, NDArray[Any]], bodies: Sequence[int], shape: Any) -> Any:
        """Begin to gather arrays of some bodies; returns what waits for them, all by body.

        own: of this rank's among them. shape: that of each, a function of the body.
        """
        if self._mpi is None:
            return lambda: own
        order = [[b for b in share if b in bodies] for share in self._shares]
        counts = [sum(math.prod(shape(b)) for b in some) for some in order]
        mine = np.concatenate([np.zeros(0), *(a.ravel() for a in own.values())], dtype=complex)
        whole = np.empty(sum(counts), dtype=complex)
        request = self._mpi.Iallgatherv(mine, [whole, counts])

        def wait() -> dict[int, NDArray[Any]]:
            finish_asleep(request, PAUSE, AWAKE)
            found, begin = {}, 0
            for b in (b for some in order for b in some):
                end = begin + math.prod(shape(b))
                found[b], begin = whole[begin:end].reshape(shape(b)), end
            return found

        return wait

    def swept(self, unknowns: Array) -> tuple[dict[int, Array], dict[int, ComplexArray]]:
        """Velocities of the own bodies, met by what earlier stages send, and flows of all."""
        problem, flows = self.problem, dict[int, ComplexArray]()
        own = dict(zip(problem.rows, problem.split(unknowns), strict=True))
        wait: Callable[[], dict[int, ComplexArray]] = dict
        for stage in problem.stages:
            mine = [b for b in problem.rows if b in stage]
            for b in mine:  # while the latest flows are on their way
                own[b] = own[b] - problem.arriving(b, flows)
            latest = wait()
            for b in mine:
                own[b] = own[b] - problem.arriving(b, latest)
            flows |= latest
            sent = {b: problem.flow(b, own[b], self.free) for b in mine}
            wait = self.gathered(sent, stage, lambda b: problem.maps[b].shape_of_flows)
        return own, flows | wait()

    def mult(self, mat: Any, x: Any, y: Any) -> None:
        """y = (I + (K - L) (I + L)^-1) x, see `bie.multiple_scattering`."""
        problem, unknowns = self.problem, x.getArray(readonly=1)
        _, flows = self.swept(unknowns)
        arriving, place = [], {b: at for at, stage in enumerate(problem.stages) for b in stage}
        for b in problem.rows:
            later = {c: flow for c, flow in flows.items() if place[c] >= place[b]}
            arriving.append(problem.arriving(b, later))
        y.setArray(unknowns + problem.joined(arriving))
        if self._mpi is not None:  # PETSc's own sums over the ranks, next, wait awake
            finish_asleep(self._mpi.Ibarrier(), PAUSE, AWAKE)

    def solve(self, data: list[Array], guess: Array | None = None) -> Array:
        """Unknowns of the own bodies, for `swept`, from data (N, 3) on each.

        Raises ConvergenceError.
        """
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


def dealt(problem: Coupled, ranks: int) -> list[list[int]]:
    """Bodies of each rank: of each stage the costly ones dealt first, to who has least so far."""
    points = np.array(problem.nodes) ** 2  # at which the flows of all others are summed
    cost = points * (points.sum() - points) + 1.0
    shares: list[list[int]] = [[] for _ in range(ranks)]
    whole = np.zeros(ranks)
    for stage in problem.stages:
        load = np.zeros(ranks)
        for b in sorted(stage, key=lambda b: (-cost[b], b)):
            rank = min(range(ranks), key=lambda rank: (load[rank], whole[rank]))
            load[rank] += cost[b]
            whole[rank] += cost[b]
            shares[rank].append(b)
    return [sorted(share) for share in shares]


def over(comm: Any) -> Any:
    """PETSc's communicator over the ranks of MPI's; None of a single one."""
    return None if comm.size == 1 else PETSc.Comm(comm)
