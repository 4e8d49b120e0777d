"""Free motion, force and torque of a body in a flow of any kind, step by step.

`GridMotion` takes the flow on the surface grid and multiplies it by the functional; `SolveMotion`
solves the integral equation anew, as the thesis does, and is the check on everything else. Both
work in the body frame, where the discrete operators never change, and answer in the space frame.
Polynomial flows need neither: their law is `FaxenCoefficients`.
"""

import math
from contextlib import suppress
from functools import cached_property
from typing import Any

import numpy as np

from qbxstokes.bie.functional import GridFunctional, ModalFunctional
from qbxstokes.bie.operators import DirectSolver, Solver, SolverFactory, SurfaceOperators
from qbxstokes.bie.resolution import MOST_NODES, flow_nodes, flow_sizes, motion_change
from qbxstokes.errors import FlowError
from qbxstokes.flows.base import Flow
from qbxstokes.geometry.rotation import matrix, multiply
from qbxstokes.typing import Array

# A third of a turn about (1, 1, 1) and back: each axis comes to lie along the others.
_TURNS = np.array([[0.5, 0.5, 0.5, 0.5], [0.5, -0.5, -0.5, -0.5]])
# Grids of a run, coarser first; from the last on the nodes grow by a quarter. What a grid may miss
# of what is allowed where it is chosen.
_RUNGS, _MARGIN = ((3, 5), (4, 6), (4, 8), (6, 8)), 0.3


class GridMotion:
    """Free motion of a batch of bodies by the grid functional."""

    def __init__(self, functional: GridFunctional, flow: Flow) -> None:
        self._points = functional.points
        self._weights = functional.weights
        self._flow = flow

    def free_motion(self, t: float, x: Array, q: Array) -> tuple[Array, Array]:
        """U and Omega (n, 3) in space at positions x (n, 3), orientations q (n, 4)."""
        rotation = matrix(q)
        _, motion = self.in_body(t, x, rotation)
        return _to_space(rotation, motion[:, :3]), _to_space(rotation, motion[:, 3:])

    @cached_property
    def grid(self) -> tuple[Array, Array]:
        """Points (N, 3) and weights (N, 3, 6)."""
        return self._points, np.ascontiguousarray(np.moveaxis(self._weights, 0, 2))

    def in_body(self, t: float, x: Array, rotation: Array) -> tuple[Array, Array]:
        """Flow on the grid (n, N, 3) and free motion (n, 6), both in the body frame."""
        points = x[:, None, :] + self._points @ rotation.swapaxes(1, 2)
        with np.errstate(invalid="ignore"):  # a flow without a value gives a motion without one
            velocity = self._flow.velocity(points, t) @ rotation
            return velocity, np.tensordot(velocity, self._weights, axes=((1, 2), (1, 2)))


class AdaptiveGridMotion:
    """Free motion in a flow with singular points, on a grid as fine as their distance asks for.

    The nodes follow from the rate at which the flow's surface harmonics decay
    (`Shape.decay`), in steps of a quarter, so that each body of a batch and each
    instant has the resolution it needs. Raises FlowError when a body comes so near to a singular
    point that no admissible grid resolves the flow; `decay` tells how near it is before that
    happens.
    """

    def __init__(self, functional: ModalFunctional, flow: Flow, tolerance: float) -> None:
        self._functional, self._flow = functional, flow
        self._tolerance, self._factor = tolerance, 1.0
        self._levels: dict[tuple[int, int], GridMotion] = {}

    def calibrate(self, x: Array, q: Array, n_theta: int) -> None:
        """Scale the nodes so that a body at x (3,), q (4,) gets at least n_theta of them."""
        predicted, _ = flow_nodes(float(self.decay(x[None], q[None])[0]), self._tolerance)
        self._factor = max(1.0, n_theta / predicted)

    def decay(self, x: Array, q: Array) -> Array:
        """Rate (n,) per degree of the flow's harmonics on each body, 1 for a singular surface."""
        arms = (self._flow.singular_points - x[:, None, :]) @ matrix(q)
        rates = self._functional.grid.shape.flow_decay(arms)
        return np.asarray(np.max(rates, axis=1))

    def nodes(self, x: Array, q: Array, t: float = 0.0) -> list[tuple[int, int]]:
        """Polar and azimuthal nodes for each body. Raises FlowError where none suffice."""
        needed = []
        for rate, place in zip(self.decay(x, q).tolist(), x, strict=True):
            try:
                n_theta, n_phi = flow_nodes(rate, self._tolerance)
            except FlowError as error:
                where = ", ".join(f"{value:.6g}" for value in place)
                raise FlowError(f"at t = {t:.6g}, body at ({where}): {error}") from None
            needed.append((_step(self._factor * n_theta), _step(self._factor * n_phi)))
        return needed

    def free_motion(self, t: float, x: Array, q: Array) -> tuple[Array, Array]:
        """U and Omega (n, 3) in space at positions x (n, 3), orientations q (n, 4)."""
        u, omega = np.empty_like(x), np.empty_like(x)
        needed = self.nodes(x, q, t)
        for level in set(needed):
            if level not in self._levels:
                grid = self._functional.on_grid(level[1], level[0])
                self._levels[level] = GridMotion(grid, self._flow)
            chosen = [index for index, each in enumerate(needed) if each == level]
            u[chosen], omega[chosen] = self._levels[level].free_motion(t, x[chosen], q[chosen])
        return u, omega


class MonitoredGridMotion:
    """Free motion in a flow that tells nothing of its singular points, on grids that prove fine.

    Asked for a motion, it computes it on two grids, the coarser of two thirds of the nodes. The
    error of a smooth flow falls geometrically with the nodes, so that the finer one errs by the
    power 3/2 of what the coarser one does; where that exceeds the tolerance, both grow by a
    quarter.

    In a run (`begin`, `rest`) it takes one grid, the coarsest that serves: for bodies much smaller
    than the scale of the flow one of 15 or 24 points, which is exact for flows of degree 2 or 3.
    Where a step has ended (`accept`) it is held against one that is finer by two rungs, and what
    it misses of U and Omega must be less than what the run allows, or than the tolerance; else the
    step is to be taken again, on a finer grid. Nothing is remembered beyond a beginning: a motion
    that is resumed is the same. Raises FlowError, with time and place, where MOST_NODES do not
    suffice.
    """

    def __init__(
        self,
        functional: ModalFunctional,
        flow: Flow,
        tolerance: float,
        start: tuple[int, int],
    ) -> None:
        """start: polar and azimuthal nodes of the finer grid to begin with, outside of a run."""
        self._functional, self._flow = functional, flow
        # A digit below the power of the tolerance: the rate is known up to a factor.
        self._tolerance, self._least = tolerance, 0.1 * tolerance ** (2.0 / 3.0)
        self._start, self.finest = start, start
        self.coarsest: tuple[int, int] | None = None  # of runs
        self._grids: dict[tuple[int, int], GridMotion] = {}
        self._rungs = list(_RUNGS)
        self._rung: int | None = None
        self._accepted, self._allowed = 0, (0.0, 0.0)

    def free_motion(self, t: float, x: Array, q: Array) -> tuple[Array, Array]:
        """U and Omega (n, 3) in space at positions x (n, 3), orientations q (n, 4)."""
        rotation = matrix(q)
        if self._rung is not None:
            motion, _ = self._sampled(self._on_rung(self._rung), t, x, rotation)
        else:
            motion = self._proved(t, x, rotation)
        return _to_space(rotation, motion[:, :3]), _to_space(rotation, motion[:, 3:])

    def _proved(self, t: float, x: Array, rotation: Array) -> Array:
        """Free motion (n, 6) in the body frame on grids as fine as each of the bodies asks for."""
        motion, waiting, level = np.empty((len(x), 6)), np.arange(len(x)), self._start
        while True:
            coarse = max(4, 2 * level[0] // 3), max(4, 2 * level[1] // 3)
            places = t, x[waiting], rotation[waiting]
            motion[waiting], sizes = self._sampled(self._grid(level), *places)
            rough, _ = self._sampled(self._grid(coarse), *places)
            change = self._change(motion[waiting], rough, sizes)
            if self.coarsest is None:
                self.finest = max(self.finest, level)
            open_still = ~(change <= self._least)
            waiting, change = waiting[open_still], change[open_still]
            if not len(waiting):
                return motion
            if level[0] >= MOST_NODES:
                raise self._beyond(t, x[waiting[0]], float(np.max(change)), level[0])
            level = _finer(level)

    def calibrate(self, x: Array, q: Array) -> None:
        """Begin with grids that serve a body at x (3,) that lies as q (4,) and two other ways."""
        turned = [q, *(multiply(turn, q) for turn in _TURNS)]
        with suppress(FlowError):  # told where the body comes to lie so
            self.free_motion(0.0, np.broadcast_to(x, (len(turned), 3)), np.array(turned))
            self._start = self.finest

    def begin(self, t: float, x: Array, q: Array, allowed: tuple[float, float]) -> None:
        """Go over to one grid, the coarsest that serves bodies at x, q; allowed: of U and Omega."""
        self._allowed, self._rung, self._accepted = allowed, 0, 0
        self._climb(t, x, q)

    def rest(self) -> None:
        """No longer on one grid."""
        self._rung = None

    def accept(self, t: float, x: Array, q: Array) -> bool:
        """Whether the grid serves where a step has ended; it is a finer one from there on if not.

        Now and then a coarser one is tried where it serves well.
        """
        assert self._rung is not None
        self._accepted += 1
        excess, _ = self._excess(self._rung, t, x, q)
        if excess > 1.0:
            self._rung += 1
            self._climb(t, x, q)
            return False
        if self._rung and excess < 0.01 and self._accepted % 8 == 0:
            below, _ = self._excess(self._rung - 1, t, x, q)
            self._rung -= below < _MARGIN
            self._note()
        return True

    def _climb(self, t: float, x: Array, q: Array) -> None:
        assert self._rung is not None
        while True:
            excess, worst = self._excess(self._rung, t, x, q)
            if excess < _MARGIN:
                break
            nodes = self._rungs[self._rung][0]
            if nodes >= MOST_NODES:
                raise self._beyond(t, x[worst], excess * self._tolerance, nodes)
            self._rung += 1
        self._note()

    def _note(self) -> None:
        assert self._rung is not None
        nodes = self._rungs[self._rung]
        self.finest = max(self.finest if self.coarsest else nodes, nodes)
        self.coarsest = min(self.coarsest or nodes, nodes)

    def _excess(self, rung: int, t: float, x: Array, q: Array) -> tuple[float, int]:
        """What a grid misses at most over what it may, and of which body; q of any length."""
        rotation = matrix(q / np.linalg.norm(q, axis=1, keepdims=True))
        motion, sizes = self._sampled(self._on_rung(rung + 2), t, x, rotation)
        rough, _ = self._sampled(self._on_rung(rung), t, x, rotation)
        allowed = np.asarray(self._allowed) / self._tolerance
        change = self._change(motion, rough, sizes, allowed) / self._tolerance
        return float(change.max()), int(change.argmax())

    def _change(self, motion: Array, rough: Array, sizes: Array, allowed: Any = (0, 0)) -> Array:
        """`motion_change` (n,); none where the flow has no value, for no grid helps there."""
        radius = float(self._functional.grid.shape.radius)
        with np.errstate(invalid="ignore"):
            return np.nan_to_num(motion_change(motion, rough, sizes, radius, allowed), nan=0.0)

    def _sampled(
        self, grid: GridMotion, t: float, x: Array, rotation: Array
    ) -> tuple[Array, Array]:
        """Free motion (n, 6) in the body frame on a grid, and the `flow_sizes` there (2, n)."""
        u, motion = grid.in_body(t, x, rotation)
        with np.errstate(invalid="ignore"):
            return motion, flow_sizes(u)

    def _on_rung(self, rung: int) -> GridMotion:
        while len(self._rungs) <= rung:
            self._rungs.append(_finer(self._rungs[-1]))
        return self._grid(self._rungs[rung])

    def _grid(self, nodes: tuple[int, int]) -> GridMotion:
        if nodes not in self._grids:
            self._grids[nodes] = GridMotion(
                self._functional.on_grid(nodes[1], nodes[0]), self._flow
            )
        return self._grids[nodes]

    @staticmethod
    def _beyond(t: float, x: Array, change: float, nodes: int) -> FlowError:
        where = ", ".join(f"{value:.6g}" for value in x)
        return FlowError(
            f"at t = {t:.6g}, body at ({where}): the flow varies too much over the body: "
            f"the free motion still changes by {change:.1e} between grids of up to "
            f"{nodes} points from pole to pole; a singular point must be very near"
        )


def _finer(nodes: tuple[int, int]) -> tuple[int, int]:
    return min(_step(nodes[0] + 1), MOST_NODES), _step(nodes[1] + 1)


def _step(nodes: float) -> int:
    """The next even number of nodes on a ladder with rungs about a quarter apart."""
    rung = 6
    while rung < nodes:
        rung = 2 * math.ceil(0.625 * rung)
    return rung


class SolveMotion:
    """Free motion, or force and torque, by one solve of the integral equation per body and call."""

    def __init__(
        self,
        operators: SurfaceOperators,
        flow: Flow,
        solver: SolverFactory = DirectSolver,
    ) -> None:
        self._operators = operators
        self._flow = flow
        self._solver = solver

    # Each problem is set up when it is first posed: a massless body never poses the second.
    @cached_property
    def _mobility(self) -> Solver:
        return self._solver(self._operators.mobility, self._operators.grid)

    @cached_property
    def _resistance(self) -> Solver:
        return self._solver(self._operators.resistance, self._operators.grid)

    def free_motion(self, t: float, x: Array, q: Array) -> tuple[Array, Array]:
        """U and Omega (n, 3) in space of the mobility problem without force or torque."""
        rotation = matrix(q)
        u, omega = np.empty_like(x), np.empty_like(x)
        for i, velocity in enumerate(self._surface_velocity(t, x, rotation)):
            u[i], omega[i] = self._operators.motion_of(self._mobility.solve(-velocity))
        return _to_space(rotation, u), _to_space(rotation, omega)

    def force_torque(
        self, t: float, x: Array, q: Array, velocity: Array, angular_velocity: Array
    ) -> tuple[Array, Array]:
        """Force and torque (n, 3) on the body in space, of the resistance problem.

        velocity and angular_velocity (n, 3) of the body, in the space frame.
        """
        rotation = matrix(q)
        v = np.einsum("nij,ni->nj", rotation, velocity)
        w = np.einsum("nij,ni->nj", rotation, angular_velocity)
        force, torque = np.empty_like(x), np.empty_like(x)
        points = self._operators.grid.points
        for i, background in enumerate(self._surface_velocity(t, x, rotation)):
            data = v[i] + np.cross(w[i], points) - background
            force[i], torque[i] = self._operators.force_of(self._resistance.solve(data))
        return _to_space(rotation, force), _to_space(rotation, torque)

    def _surface_velocity(self, t: float, x: Array, rotation: Array) -> Array:
        points = x[:, None, :] + self._operators.grid.points @ rotation.swapaxes(1, 2)
        return np.asarray(self._flow.velocity(points, t) @ rotation)


def _to_space(rotation: Array, vectors: Array) -> Array:
    return np.asarray(np.einsum("nij,nj->ni", rotation, vectors))
