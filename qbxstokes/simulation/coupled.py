"""Simulations of bodies that share a fluid, or of one beside a wall."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.bie.multiple_scattering import Placed, closest, gaps_of, names_of
from qbxstokes.case.running import Events as EventSettings
from qbxstokes.errors import SceneError
from qbxstokes.flows import Flow
from qbxstokes.motion.loads import LoadRows, Loads
from qbxstokes.simulation.arguments import accepted, section
from qbxstokes.simulation.simulation import ORIGIN, UPRIGHT, Simulation, places
from qbxstokes.simulation.surroundings import Wall
from qbxstokes.simulation.suspension import Suspension
from qbxstokes.typing import Array

if TYPE_CHECKING:
    from qbxstokes.simulation.body import Body
    from qbxstokes.simulation.coupled_assembly import CoupledMotion, Together
    from qbxstokes.simulation.surroundings import Repulsion
    from qbxstokes.simulation.wall_table import OverWall


class CoupledSimulation(Simulation):
    """What `qs.Simulation` makes of several bodies, or of one with a wall: one scene, no lanes.

    position (N, 3), orientation (N, 3) or (N, 4), loads (N, 3) each; of a single body that is given
    as itself and not in a list they may be without the first axis. resolution: relative error of
    the velocities to aim at; that of the motion where None. table: one body by a wall moves by
    `qs.OverWall`, where the flow and the gap allow. repulsion: a force that keeps the bodies apart,
    beside the loads. comm: of PETSc, over whose ranks the
    bodies are dealt. herald: told of every problem before it is solved, for other ranks to join in.
    The rest as in `Simulation`.
    """

    coupled = True

    def __init__(
        self,
        bodies: Body | Sequence[Body],
        flow: Flow | None,
        surroundings: Wall | None = None,
        *,
        position: ArrayLike = ORIGIN,
        orientation: ArrayLike = UPRIGHT,
        velocity: ArrayLike | None = None,
        angular_velocity: ArrayLike | None = None,
        loads: Loads | None = None,
        constraints: None = None,
        events: Mapping[str, Any] | EventSettings | None = None,
        tolerance: float = 1e-6,
        resolution: float | None = None,
        table: bool = False,
        repulsion: Repulsion | None = None,
        comm: Any = None,
    ) -> None:
        self.several = isinstance(bodies, Sequence)
        members = list(bodies) if isinstance(bodies, Sequence) else [bodies]
        if flow is not None and not isinstance(flow, Flow):
            raise SceneError("flow", f"is {flow!r}", "a flow such as qs.flow('shear'), or None")
        tolerance = accepted(tolerance)
        self.suspension = Suspension(
            members, surroundings, tolerance=resolution or max(tolerance, 1e-12), comm=comm
        )
        self.table = self._table_of(members[0]) if table else None
        self.places = self.suspension.placed(position, orientation)
        self.position, self.quaternion, _ = places(position, orientation)
        self.flow, self.tolerance = flow, float(tolerance)  # type: ignore[assignment]
        self.repulsion = repulsion
        self.loads, self.events = loads, section("events", EventSettings, events)
        self.constraints = None
        if constraints is not None:
            raise SceneError("constraints", "are given", "None: bodies of one fluid are free")
        self.stokes_number = np.array([float(body.stokes_number) for body in members])
        if np.any(self.stokes_number) and not np.all(self.stokes_number):
            raise SceneError(
                "bodies", "are partly without inertia", "a stokes_number of all or none"
            )
        for name, given in (("velocity", velocity), ("angular_velocity", angular_velocity)):
            if given is not None and self.massless:
                raise SceneError(name, "is given of massless bodies", "None")
        self.velocity = None if velocity is None else np.asarray(velocity, dtype=np.float64)
        self.angular_velocity = (
            None if angular_velocity is None else np.asarray(angular_velocity, dtype=np.float64)
        )
        self.herald: Callable[[Any], None] | None = None
        self._rows = None if loads is None else LoadRows(loads, len(members))

    def _table_of(self, body: Body) -> OverWall:
        from qbxstokes.simulation.wall_table import OverWall

        wall = self.suspension.wall
        if wall is None or len(self.suspension) > 1:
            raise SceneError("table", "is asked for", "one body by a wall")
        return OverWall(body, wall, tolerance=self.suspension.tolerance)

    def forces(self, t: float, x: Array, q: Array) -> dict[str, Any]:
        """Force and torque (N, 3) not of the fluid on bodies at centres x (N, 3), turned by q."""
        if self._rows is None and self.repulsion is None:
            return {}
        force, torque = np.zeros((2, len(self), 3))
        if self._rows is not None:
            force, torque = self._rows.in_space(t, q)
        if self.repulsion is not None:
            push, turn = self.repulsion.loads(self.suspension.placed(x, q), self.suspension.wall)
            force, torque = force + push, torque + turn
        return {"force": force, "torque": torque}

    def solved(
        self,
        kind: str,
        t: float,
        x: Array,
        q: Array,
        nodes: list[int] | None = None,
        **motion: Array,
    ) -> Any:
        """The bodies at centres x (N, 3) and orientations q (N, 4) at a time.

        kind: "free" under their loads, "held" with a motion (`Suspension.held`), "estimate": free,
        with the estimated errors found, or "resistance": that, roughly, in place of a solution.
        """
        if self.herald is not None:
            gaps = gaps_of(self.suspension.placed(x, q), self.suspension.wall)
            self.herald((gaps, (kind, t, x, q, nodes), motion))
        suspension, flow = self.suspension, self.flow
        if kind == "resistance":
            places, looser = suspension.placed(x, q), max(1.0, 1e-3 / suspension.tolerance)
            coarser = suspension.problem(places, nodes).coarser
            return suspension.resistance_of(suspension.problem(places, coarser, looser))
        if kind == "held":
            return suspension.held(flow, x, q, t=t, nodes=nodes, **motion)
        found = suspension.free(flow, x, q, t=t, nodes=nodes, **self.forces(t, x, q))
        if kind == "estimate":
            found.error_estimate  # noqa: B018  # found by all ranks
        return found

    def join(self, gaps: Any, problem: tuple[Any, ...], motion: Mapping[str, Any]) -> None:
        """Solve with the other ranks what their herald told: with the gaps that they know."""
        gaps_of(self.suspension.placed(*problem[2:4]), self.suspension.wall, gaps)
        self.solved(*problem, **motion)

    def part(self) -> None:
        """From here on solve without other ranks."""
        self.suspension.comm = self.herald = None

    # -- what the scene is --------------------------------------------------------------------

    @property
    def steady(self) -> bool:
        """Whether no load depends on time."""
        return self._rows is None or self._rows.steady

    @cached_property
    def gradient(self) -> Array:
        """Velocity gradient (3, 3) at the first body's start."""
        if self.flow is None:
            return np.zeros((3, 3))
        return np.asarray(self.flow.gradient(self.position[0]))

    @property
    def period(self) -> None:
        """No period: that of Jeffery is one of a body alone."""

    def shaped(self, values: Array) -> Array:
        """Values (N, ...) of the bodies; of a single one that is no list without the axis."""
        return values if self.several else values[0]

    def assemble(self, *_: Any, **__: Any) -> Together:  # type: ignore[override]
        """The equations of the scene with their start."""
        from qbxstokes.simulation.coupled_assembly import Together

        return Together(self)

    def integrate(self, times: ArrayLike) -> CoupledMotion:
        """The motion from t = 0, sampled at increasing times (T,), by PETSc TS.

        Raises ContactError for bodies that touch, ConvergenceError where a step cannot be
        completed.
        """
        self.check()
        return self.assemble().integrate(times)

    def check(self) -> None:
        """Refuse bodies that touch, and a flow that is none around them or slips on the wall."""
        self.suspension.check(self.flow)
        self.suspension.grids(self.places, self.flow, clipped=True)

    def closest(self, places: Sequence[Placed]) -> tuple[float, str]:
        """The least gap of the scene, and whose it is; infinite where there is one body alone."""
        gap, pair, _ = closest(places, self.suspension.wall)
        return gap, names_of(*pair)
