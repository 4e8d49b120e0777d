"""The coupled problem of several bodies as a PETSc shell matrix, solved by GMRES.

The one-body inverses are inside the matrix (`bie.multiple_scattering`), which is the identity plus
a compact operator. Bodies, and circles of the grids of those that are too much for one rank, are
dealt to the ranks of a communicator; at each product they gather the coefficients of all bodies'
exterior flows, sums over whoever holds a part, and each evaluates them on what it holds. Ranks wait
for each other asleep: the machine may have other work.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any, cast

import numpy as np

from qbxstokes.bie.arrivals import Pairs
from qbxstokes.bie.multiple_scattering import Coupled
from qbxstokes.errors import ConvergenceError
from qbxstokes.petsc.launch import finish_asleep
from qbxstokes.petsc.session import start, temporary_options
from qbxstokes.typing import Array, Integers

PETSc = start()  # no process by itself waits for others to join it

_RESTART = 200
# Seconds between looks of a rank that waits for others in a solve, and before it sleeps at all.
PAUSE, AWAKE = 2e-5, 1e-4
# How much more than its share of the work a rank may get before bodies are cut; what a flow of n
# nodes takes over n^3, and what a call takes, in harmonics at points.
_SLACK, _OF_A_NODE, _OF_A_CALL = 1.03, 8.0, 2000.0


class CoupledSolver:
    """GMRES on a coupled problem; options `-ksp_*` apply. Right-hand sides one after the other.

    problem: with the shares of the ranks, see `dealt`. free: bodies under given
    loads, else of given motion. tolerance: of the residual relative to the data.
    """

    def __init__(
        self, problem: Coupled, free: bool, tolerance: float = 1e-10, comm: Any = None
    ) -> None:
        self.problem, self.free = problem, free
        self.comm = PETSc.COMM_SELF if comm is None else comm
        self._mpi = self.comm.tompi4py() if self.comm.getSize() > 1 else None
        self._together()
        self.latest: tuple[int, float] = 0, 0.0  # iterations, and residual relative to the data
        size = (problem.size, PETSc.DETERMINE)
        self._matrix = PETSc.Mat().createPython([size, size], self, comm=self.comm)
        self._matrix.setUp()
        self._ksp = ksp = PETSc.KSP().create(self.comm)
        ksp.setOperators(self._matrix)
        ksp.setType(PETSc.KSP.Type.GMRES)
        ksp.setGMRESRestart(_RESTART)
        ksp.setTolerances(rtol=tolerance, atol=1e-300, max_it=_RESTART)
        pc = ksp.getPC()
        pc.setType(PETSc.PC.Type.NONE)
        if problem.wall is not None and not free:
            ksp.setPCSide(PETSc.PC.Side.RIGHT)
            pc.setType(PETSc.PC.Type.PYTHON)
            pc.setPythonContext(_OwnImages(self))
        with temporary_options("", {}, {}):
            ksp.setFromOptions()
        self._solution, self._rhs = self._matrix.createVecs()

    def _together(self) -> None:
        """Wait for the other ranks, before PETSc's sums over them, which wait awake."""
        if self._mpi is not None:
            finish_asleep(self._mpi.Ibarrier(), PAUSE, AWAKE)

    def gathered(self, own: Mapping[int, Array], bodies: Sequence[int], shape: Any) -> Any:
        """Begin to sum arrays of some bodies over the ranks; returns what waits for them, by body.

        own: this rank's parts of them. shape: that of each, a function of the body.
        """
        if self._mpi is None:
            return lambda: own
        order = [[b for b in share if b in bodies] for share in self.problem.shares or ()]
        counts = [sum(math.prod(shape(b)) for b in some) for some in order]
        mine = np.concatenate([np.zeros(0), *(own[b].ravel() for b in order[self._mpi.rank])])
        whole = np.empty(sum(counts))
        request = self._mpi.Iallgatherv(mine, [whole, counts])

        def wait() -> dict[int, Array]:
            finish_asleep(request, PAUSE, AWAKE)
            found, begin = dict[int, Array](), 0
            for b in (b for some in order for b in some):
                end = begin + math.prod(shape(b))
                part, begin = whole[begin:end].reshape(shape(b)), end
                found[b] = found[b] + part if b in found else part
            return found

        return wait

    @cached_property
    def _ways(self) -> list[tuple[Pairs, Pairs, Pairs]]:
        """By stage: what arrives there of stages before the last, of the last, and what it sends.

        The latter to its own stage and to earlier ones.
        """
        stages, arrivals = self.problem.stages, self.problem.arrivals
        place = np.array([[b in stage for b in range(len(self.problem.nodes))] for stage in stages])
        source, target = np.argmax(place, axis=0)[arrivals.of]
        return [
            (
                arrivals.pairs((target == s) & (source < s - 1)),
                arrivals.pairs((target == s) & (source == s - 1)),
                arrivals.pairs((source == s) & (target <= s)),
            )
            for s in range(len(stages))
        ]

    def swept(self, unknowns: Array, back: Array | None = None) -> tuple[Array, dict[int, Array]]:
        """Velocities here, met by what earlier stages send, and the packed flows of all.

        back: velocities (P, 3) to which is added what later stages send, and the own one.
        """
        problem, flows, latest = self.problem, dict[int, Array](), dict[int, Array]()
        arrivals, own = problem.arrivals, problem.split(unknowns)
        waiting: Pairs | None = None
        met, wait = np.zeros_like(own), cast(Any, dict)
        for stage, (early, late, later) in zip(problem.stages, self._ways, strict=True):
            arrivals.add(early, met)  # while the latest flows are on their way
            arrivals.send(latest := wait())
            flows |= latest
            arrivals.add(late, met)
            mine = {b: rows for b, rows in problem.slices.items() if b in stage}
            sent = {}
            for b, rows in mine.items():
                own[rows] -= met[rows]
                sent[b] = problem.flow(b, own[rows], self.free)
            wait = self.gathered(sent, stage, lambda b: problem.maps[b].shape_of_flows)
            if back is not None and waiting is not None:
                arrivals.add(waiting, back)
            waiting = later
        arrivals.send(latest := wait())
        if back is not None and waiting is not None:
            arrivals.add(waiting, back)
        return own, flows | latest

    def mult(self, mat: Any, x: Any, y: Any) -> None:
        """y = (I + (K - L) (I + L)^-1) x, see `bie.multiple_scattering`."""
        problem, unknowns = self.problem, x.getArray(readonly=1)
        back = np.zeros((problem.size // 3, 3))
        self.swept(unknowns, back)
        y.setArray(unknowns + problem.joined(back))
        self._together()

    def solve(self, data: Array, guess: Array | None = None) -> Array:
        """Unknowns held here, for `swept`, from data (P, 3) on all that is held.

        Raises ConvergenceError.
        """
        ksp: Any = self._ksp
        self._rhs.setArray(self.problem.joined(data))
        self._together()
        size = self._rhs.norm()
        if size == 0.0:
            self.latest = 0, 0.0
            return np.zeros(self.problem.size)
        ksp.setInitialGuessNonzero(guess is not None)
        if guess is not None:
            self._solution.setArray(guess)
        ksp.solve(self._rhs, self._solution)
        steps, left = ksp.getIterationNumber(), ksp.getResidualNorm() / size
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


class _OwnImages:
    """Inverse of what a wall answers each body by itself to `Scatterer.lowest` velocities.

    With these as orthonormal rows F (M, 3 P) and the answers Y = K F it is that of I + Y^T F, which
    is I - Y^T (I + F Y^T)^-1 F. It takes a few sums of low harmonics, and off GMRES a tenth to a
    third of its steps. Bodies that are free need it less: no answer to force and torque is left.
    """

    def __init__(self, solver: CoupledSolver) -> None:
        self._solver, problem = solver, solver.problem
        shares = problem.shares or ()
        self._cut = [b for b in range(len(problem.bodies)) if sum(b in s for s in shares) > 1]
        self._parts = []
        arrivals = problem.arrivals
        for b, rows in problem.slices.items():
            (velocities, flows), held = problem.maps[b].lowest, problem.held[b]
            own, answers = arrivals.pairs(np.all(arrivals.of == b, axis=0)), []
            for flow in flows:
                arrivals.send({b: flow})
                arrivals.add(own, found := np.zeros((problem.size // 3, 3)), flow.shape[1])
                answers.append(found[rows])
            root, part = problem.maps[b].root_weights[held], slice(3 * rows.start, 3 * rows.stop)
            low, back = (
                (np.asarray(v) * root).reshape(len(flows), -1)
                for v in (velocities[:, held], answers)
            )
            self._parts.append((b, part, low, back))
        inner = self._summed({b: f @ y.T for b, _, f, y in self._parts}, 2)
        self._inner = {b: np.linalg.inv(np.eye(len(part)) + part) for b, part in inner.items()}

    def _summed(self, own: dict[int, Array], axes: int) -> dict[int, Array]:
        """Arrays of the bodies here, of those that several ranks hold parts of summed."""
        if not self._cut:
            return own
        here, maps = {b: own[b] for b in own if b in self._cut}, self._solver.problem.maps
        shape = {b: (len(maps[b].lowest[0]),) * axes for b in self._cut}
        return own | self._solver.gathered(here, self._cut, shape.__getitem__)()

    def apply(self, pc: Any, x: Any, y: Any) -> None:
        """y = the inverse of x."""
        given = x.getArray(readonly=1)
        found = given.copy()
        low = self._summed({b: f @ given[part] for b, part, f, _ in self._parts}, 1)
        for b, part, _, answers in self._parts:
            found[part] -= (self._inner[b] @ low[b]) @ answers
        y.setArray(found)


def dealt(problem: Coupled, ranks: int) -> list[dict[int, Integers]]:
    """What each rank holds: circles of the grids, by body.

    Of each stage bodies are dealt whole, the costly ones first, to who has least so far; those that
    are more than what is left of a rank's share of the work, circle by circle.
    """
    shares: list[dict[int, list[int]]] = [{} for _ in range(ranks)]
    cost, whole = costs(problem), np.zeros(ranks)
    for stage in problem.stages:
        load, cut = np.zeros(ranks), []
        most = _SLACK * float(cost[stage].sum()) / ranks

        def give(b: int, circles: Sequence[int], load: Array = load) -> None:
            rank = min(range(ranks), key=lambda rank: (load[rank], whole[rank]))
            for total in (load, whole):
                total[rank] += cost[b] * len(circles) / problem.nodes[b]
            shares[rank].setdefault(b, []).extend(circles)

        for b in sorted(stage, key=lambda b: (-cost[b], b)):
            if load.min() + cost[b] <= most:
                give(b, range(problem.nodes[b]))
            else:
                cut.append(b)
        for b in cut:
            for circle in range(problem.nodes[b]):
                give(b, [circle])
    return [{b: np.array(share[b]) for b in sorted(share)} for share in shares]


def costs(problem: Coupled) -> Array:
    """Work that each body is, in harmonics at points: what arrives at it and what it sends."""
    n, gaps = np.array(problem.nodes), problem.gaps
    reach = np.array([body.size * body.shape.radius for body in problem.bodies])
    cost = _OF_A_NODE * n**3.0
    for side in (0, 1):
        here, there = gaps.pairs[:, side], gaps.pairs[:, 1 - side]
        between = (here >= 0) & (there >= 0)
        b, c = here[between], there[between]
        degrees = -math.log(problem.tolerance) / np.log1p(gaps.gap[between] / reach[c]) + 2.0
        np.add.at(cost, b, 2.0 * n[b] ** 2 * np.minimum(n[c], degrees) ** 2 + _OF_A_CALL)
    if problem.wall is not None:
        cost += 5.0 * n**2 * (n**2).sum() + _OF_A_CALL * len(n)
    return cost


def over(comm: Any) -> Any:
    """PETSc's communicator over the ranks of MPI's; None of a single one."""
    return None if comm.size == 1 else PETSc.Comm(comm)
