"""`Body.stresslet`: the stresslet of a body where it is put, free, moving or driven."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qbxstokes.flows import Flow
from qbxstokes.geometry import rotation
from qbxstokes.motion.equations import Loads
from qbxstokes.motion.layout import ORIENTATION, POSITION
from qbxstokes.motion.stress import symmetric
from qbxstokes.simulation.simulation import ORIGIN, Simulation
from qbxstokes.simulation.stresses import SceneStress

if TYPE_CHECKING:
    from qbxstokes.simulation.body import Body

Array = NDArray[np.float64]


def body_stresslet(
    body: Body,
    flow: Flow,
    position: ArrayLike,
    orientation: ArrayLike,
    motion: tuple[ArrayLike | None, ArrayLike | None],
    loads: tuple[ArrayLike | None, ArrayLike | None],
    t: float,
) -> Array:
    """`Body.stresslet`: motion is (velocity, angular velocity), loads (force, torque)."""
    # With inertia the velocities are part of the state, whatever the Stokes number.
    held = any(u is not None for u in motion)
    velocity, spin = (ORIGIN if held and u is None else u for u in motion)
    pushed = any(f is not None for f in loads)
    scene = Simulation(
        body.with_inertia(1.0 if held else 0.0),
        flow,
        position=position,
        orientation=orientation,
        velocity=velocity,
        angular_velocity=spin,
        loads=Loads(*(ORIGIN if f is None else f for f in loads)) if pushed else None,
    )
    assembled = scene.assemble(t=t)
    stress = SceneStress.of(assembled)
    states = assembled.initial
    torque = assembled.equations.force_torque(t, states)[1] if held or pushed else None
    q = rotation.normalize(states[:, ORIENTATION])
    found = stress.stresslet(t, states[:, POSITION], q, rotation.axis(q), torque)
    return scene.shaped(symmetric(found))
