"""Simulations of bodies that share a fluid, or of one beside a wall."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qbxstokes.bie.coupling import Placed, closest, names_of
from qbxstokes.case.running import Events as EventSettings
from qbxstokes.errors import SceneError
from qbxstokes.flows import Flow
from qbxstokes.geometry import rotation
from qbxstokes.motion.loads import LoadRows, Loads
from qbxstokes.simulation.simulation import ORIGIN, UPRIGHT, Simulation, event_settings
from qbxstokes.simulation.suspension import Suspension
from qbxstokes.simulation.wall import Wall

if TYPE_CHECKING:
    from qbxstokes.simulation.body import Body
    from qbxstokes.simulation.solved import Solution

Array = NDArray[np.float64]


class CoupledSimulation(Simulation):
    """What `qs.Simulation` makes of several bodies, or of one with a wall: one scene, no lanes.

    position (N, 3), orientation (N, 3) or (N, 4), loads (N, 3) each; of a single body that is given
    as itself and not in a list they may be without the first axis. resolution: relative error of
    the velocities to aim at; that of the motion where None. comm: of PETSc, over whose ranks the
    bodies are dealt. The rest as in `Simulation`.
    """

    def __init__(
        self,
        bodies: Body | Sequence[Body],
        flow: Flow | None,
        surroundings: Wall | None = None,
        *,
        position: ArrayLike = ORIGIN,
        orientation: ArrayLike = UPRIGHT,
        loads: Loads | None = None,
        events: Mapping[str, Any] | EventSettings | None = None,
        tolerance: float = 1e-6,
        resolution: float | None = None,
        comm: Any = None,
    ) -> None:
        self.several = isinstance(bodies, Sequence)
        members = list(bodies) if isinstance(bodies, Sequence) else [bodies]
        if flow is not None and not isinstance(flow, Flow):
            raise SceneError("flow", f"is {flow!r}", "a flow such as qs.flow('shear'), or None")
        if not 0.0 < tolerance <= 0.1:
            raise SceneError("tolerance", f"is {tolerance:g}", "more than 0, at most 0.1")
        self.suspension = Suspension(
            members, surroundings, tolerance=resolution or max(tolerance, 1e-12), comm=comm
        )
        self.places = places = self.suspension.placed(position, orientation)
        self.flow, self.tolerance = flow, float(tolerance)  # type: ignore[assignment]
        self.position = np.stack([place.position for place in places])
        turn = np.asarray(orientation, dtype=np.float64)
        q = rotation.normalize(turn) if turn.shape[-1] == 4 else rotation.from_axis(turn)
        self.quaternion = np.array(np.broadcast_to(q, (len(members), 4)))
        self.loads, self.events = loads, event_settings(events)
        self._rows = None if loads is None else LoadRows(loads, len(members))

    def forces(self, t: float, q: Array) -> dict[str, Any]:
        """Force and torque (N, 3) from outside, space frame, at a time and orientations (N, 4)."""
        if self._rows is None:
            return {}
        force, torque = self._rows.in_space(t, q)
        return {"force": force, "torque": torque}

    def solved(self, t: float, x: Array, q: Array, **more: Any) -> Solution:
        """The free bodies at centres x (N, 3) and orientations q (N, 4); see `Suspension.free`."""
        return self.suspension.free(self.flow, x, q, t=t, **self.forces(t, q), **more)

    def check(self) -> None:
        """Refuse bodies that touch, and a flow that is none around them or slips on the wall."""
        self.suspension.check(self.flow)
        self.suspension.grids(self.places, self.flow)

    def closest(self, places: Sequence[Placed]) -> tuple[float, str]:
        """The least gap of the scene, and whose it is; infinite where there is one body alone."""
        gap, pair, _ = closest(places, self.suspension.plane)
        return gap, names_of(*pair)
