"""What the equations of bodies that share a fluid ask of it: velocities, forces, their changes."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import numpy as np

from qbxstokes.errors import ContactError, FlowError, SceneError, Stopping
from qbxstokes.flows.interpolation import Between
from qbxstokes.geometry import rotation
from qbxstokes.geometry.symmetric import components
from qbxstokes.motion.layout import ORIENTATION, POSITION
from qbxstokes.motion.wall_constants import WallConstants
from qbxstokes.petsc.trajectory import Watch
from qbxstokes.typing import Array

if TYPE_CHECKING:
    from qbxstokes.simulation.coupled import CoupledSimulation


class Fluid(Between, Watch):
    """What the equations ask of a scene: each answer is a problem of its own.

    asked: whether a signal asks the run to stop; raises `Stopping` then, before the next problem.
    """

    thermal = None
    asked: Callable[[], bool] | None = None

    def __init__(self, scene: CoupledSimulation) -> None:
        self.scene = scene
        self.iterations = self.solves = 0
        self.errors: dict[str, float] = {}
        self._terms: Array | None = None

    def free(self, t: float, x: Array, q: Array) -> tuple[Array, Array]:
        """Velocities of the bodies under their loads."""
        told = self._from_table(t, x, q)
        if told is not None:
            return told
        found = self._solved("free", t, x, q)
        return found.velocity, found.angular_velocity

    def drag(self, t: float, x: Array, q: Array, v: Array, omega: Array) -> tuple[Array, Array]:
        """Force and torque of the fluid ON the bodies."""
        told = self._from_table(t, x, q, np.hstack([v, omega]))
        if told is not None:
            return told
        found = self._solved("held", t, x, q, velocity=v, angular_velocity=omega)
        return -found.force, -found.torque

    def resistance(self, t: float, x: Array, q: Array) -> Array:
        """Resistance (6N, 6N) of the bodies to the accuracy that a Jacobian needs."""
        table = self.scene.table
        if table is not None:
            with suppress(ContactError, SceneError):
                place = x[0], rotation.axis(q)[0]
                return np.linalg.inv(table.free_and_mobility(table.flow_terms(None), *place)[1])
        return np.asarray(self._solved("resistance", t, x, q))

    def _from_table(
        self, t: float, x: Array, q: Array, motion: Array | None = None
    ) -> tuple[Array, Array] | None:
        """Free velocities, or with a motion force and torque, from the table; None beyond it."""
        scene, table = self.scene, self.scene.table
        degree = 0 if scene.flow is None else scene.flow.degree
        if table is None or degree is None or degree > 2:
            return None
        if self._terms is None or (scene.flow is not None and not scene.flow.steady):
            self._terms = table.flow_terms(scene.flow, t)
        try:
            if motion is None:
                load = np.hstack(self.loads(t, x, q))
                return table.motion(self._terms, x, rotation.axis(q), load)
            drag = table.drag(self._terms, x[0], rotation.axis(q)[0], motion[0])
        except (ContactError, SceneError):
            return None
        return drag[None, :3], drag[None, 3:]

    @property
    def constants(self) -> Callable[[], WallConstants] | None:
        """What the compiled rate over a wall takes, where all of it is the table's."""
        scene, table = self.scene, self.scene.table
        flow, loads = scene.flow, scene.loads
        if table is None or scene.repulsion is not None or not (scene.massless and scene.steady):
            return None
        if flow is not None and not (flow.steady and flow.degree is not None and flow.degree <= 2):
            return None
        own: tuple[Any, ...] = () if loads is None else (loads.body_force, loads.body_torque)
        if any(np.any(vectors) for vectors in own):
            return None
        terms = table.flow_terms(flow, 0.0)
        load = np.hstack(self.loads(0.0, scene.position, scene.quaternion))[0]
        return lambda: table.constants(terms, load)

    def loads(self, t: float, x: Array, q: Array) -> tuple[Array, Array]:
        """Force and torque from outside."""
        still = np.zeros((len(q), 3))
        found = self.scene.forces(t, x, q)
        return found.get("force", still), found.get("torque", still)

    def gradient(self, t: float, x: Array) -> Array:
        """Velocity gradient of the flow at the centres."""
        flow = self.scene.flow
        return np.zeros((len(x), 3, 3)) if flow is None else np.asarray(flow.gradient(x, t))

    def stresslet(self, t: float, x: Array, q: Array, p: Array, torque: Any) -> Array:
        """Stresslets (N, 6) of the free bodies."""
        return components(self._solved("free", t, x, q).stresslet)

    def estimate(self, t: float, y: Array) -> None:
        """Take the estimated errors of the velocities in a state into account."""
        x, q = y[:, POSITION], rotation.normalize(y[:, ORIENTATION])
        found = self._solved("estimate", t, x, q).error_estimate
        for name in ("velocity", "angular_velocity"):
            error = found[name]
            if self.scene.table is not None:
                error += self.scene.table.error_estimate
            self.errors[name] = max(self.errors.get(name, 0.0), error)

    def _solved(self, kind: str, t: float, x: Array, q: Array, **motion: Array) -> Any:
        scene = self.scene
        if self.asked is not None and self.asked():
            raise Stopping
        try:
            places = scene.suspension.placed(x, q)
            nodes = scene.suspension.grids(places, scene.flow, t, True, kind != "held")
        except SceneError as error:  # beyond the edge of the flow, or at its singular point
            raise FlowError(str(error)) from None
        # From nothing, not from the last solution: numbers do not depend on what was asked before.
        found = scene.solved(kind, t, x, q, nodes, **motion)
        if kind != "resistance":
            self.solves += 1
            self.iterations += found.iterations
        return found
