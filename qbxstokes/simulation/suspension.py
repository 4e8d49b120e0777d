"""Several bodies in one fluid, or one by a wall: resistance, mobility, motion and field."""

from __future__ import annotations

import warnings
from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.bie.multiple_scattering import Coupled, Placed
from qbxstokes.bie.scatterer import LOW
from qbxstokes.errors import SceneError
from qbxstokes.flows import Flow
from qbxstokes.geometry import rotation
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.simulation.arguments import numbers
from qbxstokes.simulation.simulation import ORIGIN, UPRIGHT, Simulation, places
from qbxstokes.simulation.solved_instant import (
    MOST_NODES,
    Solution,
    choose_nodes,
    flow_nodes_on,
    probed_nodes,
)
from qbxstokes.simulation.surroundings import Wall
from qbxstokes.typing import AnyArray, Array

if TYPE_CHECKING:
    from qbxstokes.simulation.body import Body
    from qbxstokes.simulation.coupled_assembly import CoupledMotion

# Bodies above which the whole resistance is refused: six solves for each.
MOST_RESISTANCE = 50
# How much more closely harmonics are summed than the grids resolve, how much more closely than that
# the linear system is solved, and how much less closely both for the estimate of errors.
_SUMS, _SOLVER, _LOOSER = 0.1, 0.1, 10.0


class Suspension:
    """Rigid spheroids in one fluid, with or without a plane wall, at an instant.

    bodies: a `Body` each (their `size` is the polar radius c in scene units, 1 unless given).
    surroundings: None or a `Wall`. tolerance: relative error to aim at; the grids follow from it
    and from the gaps. comm: of PETSc, over whose ranks the bodies are dealt; this process if None.

    >>> import numpy as np, qbxstokes as qs
    >>> pair = qs.Suspension([qs.Body(1.0), qs.Body(1.0)])
    >>> r = pair.resistance([[0, 0, 0], [0, 0, 3]])
    >>> r.shape, bool(np.allclose(r, r.T))
    ((12, 12), True)
    """

    def __init__(
        self,
        bodies: Sequence[Body],
        surroundings: Wall | None = None,
        *,
        tolerance: float = 1e-8,
        comm: Any = None,
    ) -> None:
        self.bodies = list(bodies)
        if not self.bodies:
            raise SceneError("bodies", "are none", "at least one")
        if other := [b.shape for b in self.bodies if not isinstance(b.shape, Spheroid)]:
            raise SceneError("bodies", f"hold a {other[0]}", "spheroids: gaps are theirs")
        if surroundings is not None and not isinstance(surroundings, Wall):
            raise SceneError("surroundings", f"is {surroundings!r}", "None or a qs.Wall(...)")
        if not 1e-12 <= tolerance <= 0.1:
            raise SceneError("tolerance", f"is {tolerance:g}", "between 1e-12 and 0.1")
        self.wall, self.tolerance, self.comm = surroundings, float(tolerance), comm
        self._known: Flow | None = None  # a polynomial that was found to be a flow: everywhere

    def __len__(self) -> int:
        """Number of bodies."""
        return len(self.bodies)

    def placed(self, position: ArrayLike, orientation: ArrayLike | None = None) -> list[Placed]:
        """The bodies at centres (N, 3) with axes (N, 3) or quaternions (N, 4); None: upright."""
        n, shape = len(self), np.shape(position)
        orientation = UPRIGHT if orientation is None else orientation
        x, q, lead = places(position, orientation)
        if shape != (n, 3) and not (n == 1 and shape == (3,)):
            raise SceneError("position", f"has shape {shape}", f"shape {(n, 3)}: a centre each")
        if lead not in ((n,), ()):
            right = f"shape {(n, 3)} (axes) or {(n, 4)}"
            raise SceneError("orientation", f"has shape {np.shape(orientation)}", right)
        return [
            Placed(body.shape, body.size, centre, matrix)
            for body, centre, matrix in zip(self.bodies, x, rotation.matrix(q), strict=True)
        ]

    # -- one instant --------------------------------------------------------------------------

    def grids(
        self,
        places: Sequence[Placed],
        flow: Flow | None = None,
        t: float = 0.0,
        clipped: bool = False,
        free: bool = False,
    ) -> list[int]:
        """Polar nodes of each body, which resolve the gaps and the flow.

        clipped: as many as there are at most, where more were needed for a gap; else grids are
        tried then, and their estimated error decides. free: for bodies under given loads. Raises
        ContactError, SceneError for a flow that is none around them.
        """
        chosen = choose_nodes(places, self.wall, self.tolerance, free)
        if clipped:
            chosen = [min(n, MOST_NODES) for n in chosen]
        elif max(chosen) > MOST_NODES:
            chosen = probed_nodes(self, places, chosen)
        if flow is None:
            return chosen
        for b, place in enumerate(places):
            known = flow is self._known
            needed = flow_nodes_on(b + 1, place, flow, t, self.tolerance, known)
            chosen[b] = max(chosen[b], needed)
        if flow.steady and flow.degree is not None:
            self._known = flow
        return chosen

    def problem(
        self, places: Sequence[Placed], nodes: Sequence[int] | None = None, looser: float = 1.0
    ) -> Coupled:
        """The linear problem of the bodies where they are. Raises ContactError.

        looser: factor on the errors of sums and solver.
        """
        chosen, tolerance = list(nodes or self.grids(places)), looser * _SUMS * self.tolerance
        problem = Coupled(places, self.wall, chosen, tolerance)
        if self.comm is not None:
            from qbxstokes.petsc.coupled import dealt

            problem.shares = dealt(problem, self.comm.getSize())
            problem.rank = self.comm.getRank()
        return problem

    def resistance(
        self,
        position: ArrayLike,
        orientation: ArrayLike | None = None,
        *,
        nodes: Sequence[int] | None = None,
    ) -> Array:
        """Resistance R (6N, 6N), space frame: (force, torque) by the bodies ON the fluid.

        Ordered body by body, force before torque, torque about each centre. nodes: polar nodes of
        each body, if not chosen by the gaps.
        """
        return self.resistance_of(self.problem(self.placed(position, orientation), nodes))

    def resistance_and_error(
        self, position: ArrayLike, orientation: ArrayLike | None = None
    ) -> tuple[Array, float]:
        """Resistance as above, and the estimated error of its entries over the largest of them."""
        problem = self.problem(places := self.placed(position, orientation))
        coarser = self.problem(places, problem.coarser, _LOOSER)
        fine, coarse = map(self.resistance_of, (problem, coarser))
        return fine, problem.estimated(fine, coarse) / float(np.abs(fine).max())

    def resistance_of(self, problem: Coupled) -> Array:
        """The resistance (6N, 6N) of bodies as they are placed in a problem."""
        n = len(self)
        if n > MOST_RESISTANCE:
            raise SceneError("bodies", f"are {n}", f"at most {MOST_RESISTANCE} for the resistance")
        columns = [unit.reshape(n, 6) for unit in np.eye(6 * n)]
        found = self.solved_held(problem, [(motion, None) for motion in columns])
        return np.stack([np.hstack([f.force, f.torque]).ravel() for f in found], axis=1)

    def mobility(self, position: ArrayLike, orientation: ArrayLike | None = None) -> Array:
        """Mobility (6N, 6N): the inverse of the resistance."""
        return np.linalg.inv(self.resistance(position, orientation))

    def held(
        self,
        flow: Flow | None,
        position: ArrayLike,
        orientation: ArrayLike | None = None,
        *,
        velocity: ArrayLike = ORIGIN,
        angular_velocity: ArrayLike = ORIGIN,
        t: float = 0.0,
        nodes: Sequence[int] | None = None,
    ) -> Solution:
        """The bodies with given velocities (N, 3) or (3,) in a flow."""
        self.check(flow, t)
        motion = np.hstack([self._each(velocity), self._each(angular_velocity)])
        places = self.placed(position, orientation)
        problem = self.problem(places, nodes or self.grids(places, flow, t))
        return self.solved_held(problem, [(motion, _velocity(flow, t))])[0]

    def free(
        self,
        flow: Flow | None,
        position: ArrayLike,
        orientation: ArrayLike | None = None,
        *,
        force: ArrayLike | None = None,
        torque: ArrayLike | None = None,
        t: float = 0.0,
        guess: Array | None = None,
        nodes: Sequence[int] | None = None,
    ) -> Solution:
        """The bodies under given force and torque (N, 3) or (3,) each, in a flow.

        guess: the unknowns of a solution with the same nodes, to start the solver from.
        """
        self.check(flow, t)
        places = self.placed(position, orientation)
        problem = self.problem(places, nodes or self.grids(places, flow, t, free=True))
        loads = np.concatenate([self._each(force), self._each(torque)], axis=1)
        return self.freed(problem, loads, _velocity(flow, t), guess)

    def free_motion(
        self,
        flow: Flow | None,
        position: ArrayLike,
        orientation: ArrayLike | None = None,
        **loads: Any,
    ) -> tuple[Array, Array]:
        """Velocities and angular velocities (N, 3) of the bodies without inertia; see `free`.

        >>> import numpy as np, qbxstokes as qs
        >>> pair = qs.Suspension([qs.Body(1.0), qs.Body(1.0)])
        >>> u, _ = pair.free_motion(None, [[0, 0, 0], [3, 0, 0]], force=[0, 0, -6 * np.pi])
        >>> bool(u[0, 2] < -1.0)  # two fall faster than one
        True
        """
        found = self.free(flow, position, orientation, **loads)
        return found.velocity, found.angular_velocity

    def force_torque(
        self,
        flow: Flow | None,
        position: ArrayLike,
        orientation: ArrayLike | None = None,
        **motion: Any,
    ) -> tuple[Array, Array]:
        """Force and torque (N, 3) of the fluid ON bodies of given motion; see `held`."""
        found = self.held(flow, position, orientation, **motion)
        return -found.force, -found.torque

    def stresslet(
        self,
        flow: Flow | None,
        position: ArrayLike,
        orientation: ArrayLike | None = None,
        **loads: Any,
    ) -> Array:
        """Stresslets (N, 3, 3) of the bodies, free but for given loads; see `free`."""
        return self.free(flow, position, orientation, **loads).stresslet

    def field(
        self,
        flow: Flow | None,
        points: ArrayLike,
        position: ArrayLike,
        orientation: ArrayLike | None = None,
        *,
        what: Collection[str] = ("velocity", "pressure"),
        **loads: Any,
    ) -> dict[str, AnyArray]:
        """What is asked for at points (P, 3) of space, to contact and on the wall.

        what: as of `Body.field`. source (P,): -1 inside a body or behind the wall, where values
        are NaN. The bodies are free but for the loads of `free`. Grids are refined until the slip
        on all surfaces, relative to the largest speed of one in the flow, is within the tolerance;
        warns where they do not suffice, unless `nodes` are given.
        """
        from qbxstokes.simulation.flow_among import FlowAmong, resolved

        t = loads.get("t", 0.0)

        def solve(nodes: list[int] | None) -> FlowAmong:
            given = {"nodes": nodes, **loads}
            return FlowAmong(self.free(flow, position, orientation, **given), flow, t)

        if "nodes" in loads:
            found = solve(None)
        else:
            self.check(flow, t)
            places = self.placed(position, orientation)
            nodes = self.grids(places, flow, t, clipped=True, free=True)
            found = resolved(solve, nodes, self.tolerance)
            if (slip := found.slip) > self.tolerance:
                missed = f"the slip on a surface is {slip:.1e}"
                warnings.warn(f"tolerance {self.tolerance:g} is missed: {missed}", stacklevel=2)
        return found.evaluate(np.asarray(points, float).reshape(-1, 3), what)

    def integrate(
        self,
        flow: Flow | None,
        times: ArrayLike,
        position: ArrayLike,
        orientation: ArrayLike | None = None,
        *,
        force: ArrayLike | None = None,
        torque: ArrayLike | None = None,
        tolerance: float = 1e-7,
        least_gap: float | None = None,
    ) -> CoupledMotion:
        """The motion from t = 0, sampled at increasing times (T,), by PETSc TS: (T, N, ...).

        force, torque (N, 3) or (3,): constant, in space. tolerance: error accepted at the end. The
        motion ends early, with its event named, where a gap falls below least_gap, or below what
        the tolerance of the suspension can be served at. Short for `qs.Simulation(...).integrate`,
        where loads may depend on time and bodies have inertia.
        """
        from qbxstokes.motion.loads import Loads

        scene = cast(Any, Simulation)(
            self.bodies,
            flow,
            self.wall,
            position=position,
            orientation=UPRIGHT if orientation is None else orientation,
            loads=Loads(self._each(force), self._each(torque)),
            events={} if least_gap is None else {"clearance": least_gap},
            tolerance=tolerance,
            resolution=self.tolerance,
            comm=self.comm,
        )
        return cast("CoupledMotion", scene.integrate(times))

    # -- solving ------------------------------------------------------------------------------

    def _solver(self, problem: Coupled, free: bool) -> Any:
        from qbxstokes.petsc.coupled import CoupledSolver

        return CoupledSolver(problem, free, _SOLVER * problem.tolerance, self.comm)

    def solved_held(self, problem: Coupled, cases: list[tuple[Array, Any]]) -> list[Solution]:
        """Bodies of given motions (N, 6), each in a background (points -> velocity) or none."""
        solver, found = self._solver(problem, False), []
        for motion, background in cases:
            x = solver.solve(problem.rigid_data(motion) - problem.background(background))
            _, sent = solver.swept(x)
            flows = [sent[b] for b in range(len(self))]
            loads = np.stack([problem.force(b, flow) for b, flow in enumerate(flows)])

            def again(nodes: list[int], one: Any = (motion, background)) -> Solution:
                return self.solved_held(self.problem(problem.bodies, nodes, _LOOSER), [one])[0]

            (v, omega), (force, torque) = np.hsplit(motion, 2), np.hsplit(loads, 2)
            found.append(Solution(problem, flows, v, omega, force, torque, solver.latest, x, again))
        solver.release()
        return found

    def freed(self, problem: Coupled, loads: Array, background: Any, guess: Any = None) -> Solution:
        """Bodies under loads (N, 6) in a background (points -> velocity) or none; see `free`."""
        solver = self._solver(problem, True)
        alone = [problem.loaded(b, loads[b]) for b in range(len(self))]
        driven = {b: flow for b, (_, flow) in enumerate(alone)}
        x = solver.solve(-problem.arriving(driven) - problem.background(background), guess)
        own, sent = solver.swept(x)
        parts = {b: problem.alone(b, own[rows])[1] for b, rows in problem.slices.items()}
        less = solver.gathered(parts, range(len(self)), lambda b: (6,))()
        motion = np.stack([problem.to_space(b, alone[b][0] - less[b]) for b in driven])
        flows = [sent[b] for b in driven]
        for b, flow in driven.items():
            flows[b][:, :LOW] += flow
        solver.release()

        def again(nodes: list[int]) -> Solution:
            return self.freed(self.problem(problem.bodies, nodes, _LOOSER), loads, background)

        (v, omega), (force, torque) = np.hsplit(motion, 2), np.hsplit(loads, 2)
        speeds = [
            max(np.abs(one[:3]).max(), place.shape.radius * np.abs(one[3:]).max())
            for (one, _), place in zip(alone, problem.bodies, strict=True)
        ]
        told = solver.latest, x, again, float(max(speeds))
        return Solution(problem, flows, v, omega, force, torque, *told)

    def _each(self, vectors: ArrayLike | None) -> Array:
        given = numbers("vectors", ORIGIN if vectors is None else vectors, "finite numbers")
        if given.shape not in ((3,), (1, 3), (len(self), 3)):
            right = f"shape {(len(self), 3)} or (3,)"
            raise SceneError("bodies", f"got vectors of shape {given.shape}", right)
        return np.array(np.broadcast_to(given, (len(self), 3)))

    def check(self, flow: Flow | None, t: float = 0.0) -> None:
        """Refuse a flow that slips on the wall."""
        if self.wall is not None:
            if flow is not None:
                self.wall.check(flow, t)
            elif self.wall.velocity.any():
                raise SceneError("flow", "is none by a moving wall", "a flow with its velocity")


def _velocity(flow: Flow | None, t: float) -> Any:
    return None if flow is None else lambda points: flow.velocity(points, t)
