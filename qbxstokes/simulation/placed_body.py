"""A body where it is put, free, in a given motion or driven: what `Body` tells of it in a flow."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.flows import Flow
from qbxstokes.geometry import rotation
from qbxstokes.geometry.symmetric import symmetric
from qbxstokes.motion.equations import Loads
from qbxstokes.motion.layout import ORIENTATION, POSITION
from qbxstokes.simulation.assembly import Assembled
from qbxstokes.simulation.simulation import ORIGIN, Simulation
from qbxstokes.simulation.stresses import SceneStress
from qbxstokes.typing import Array

if TYPE_CHECKING:
    from qbxstokes.simulation.body import Body

Pair = tuple[ArrayLike | None, ArrayLike | None]
NOTHING: Pair = (None, None)


class PlacedBody:
    """A body at places (..., 3) with orientations (...) in a flow at time t.

    motion: velocity and angular velocity (space frame), of a body that is not free; what is left
    out is zero. loads: force and torque from outside.
    """

    def __init__(
        self,
        body: Body,
        flow: Flow,
        position: ArrayLike,
        orientation: ArrayLike,
        motion: Pair,
        loads: Pair,
        t: float,
    ) -> None:
        held, pushed = (any(u is not None for u in pair) for pair in (motion, loads))
        velocity, spin = (ORIGIN if held and u is None else u for u in motion)
        # With inertia the velocities are part of the state, whatever the Stokes number.
        self._scene = Simulation(
            body.with_inertia(1.0 if held else 0.0),
            flow,
            position=position,
            orientation=orientation,
            velocity=velocity,
            angular_velocity=spin,
            loads=Loads(*(ORIGIN if f is None else f for f in loads)) if pushed else None,
        )
        self._assembled: Assembled = self._scene.assemble(t=t)
        self._t, self._torque = t, held or pushed

    def velocities(self) -> tuple[Array, Array]:
        """Velocity and angular velocity (..., 3), space frame."""
        u, omega = self._assembled.equations.velocities(self._t, self._assembled.initial)
        return self._scene.shaped(np.array(u)), self._scene.shaped(np.array(omega))

    def force_torque(self) -> tuple[Array, Array]:
        """Force and torque (..., 3) of the fluid ON the body, space frame."""
        found = self._assembled.equations.force_torque(self._t, self._assembled.initial)
        return self._scene.shaped(found[0]), self._scene.shaped(found[1])

    def stresslet(self) -> Array:
        """Stresslet (..., 3, 3), space frame."""
        states, equations = self._assembled.initial, self._assembled.equations
        stress = SceneStress.of(self._assembled)
        torque = equations.force_torque(self._t, states)[1] if self._torque else None
        q = rotation.normalize(states[:, ORIENTATION])
        found = stress.stresslet(self._t, states[:, POSITION], q, rotation.axis(q), torque)
        return self._scene.shaped(symmetric(found))
