"""Quantities of a motion from the states that the integrator gives."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from qbxstokes.geometry import rotation
from qbxstokes.io.results import MOTION_FIELDS
from qbxstokes.motion.diagnostics import orbit_constant
from qbxstokes.motion.equations import RigidBodyEquations

Array = NDArray[np.float64]

# States are turned into quantities in pieces of about this many, which stay in the cache.
_PIECE = 4096
# What every caller gets.
BASIC = ("position", "axis", "velocity", "angular_velocity")


def shape_of(name: str) -> tuple[int, ...]:
    """Shape of a quantity at one instant."""
    return MOTION_FIELDS[name].shape


def quantities(
    equations: RigidBodyEquations,
    times: Array,
    states: Array,
    steady: bool,
    wanted: Iterable[str],
    shear: Array | None = None,
) -> dict[str, Array]:
    """The wanted quantities (T, n, ...) from the states (T, n, n_state) at the times (T,).

    steady: whether the flow is. shear: directions (3, 3) of stream, gradient and vorticity to which
    the orbit constant refers; it is NaN without them.
    """
    samples, n = states.shape[:2]
    steady = steady and equations.steady
    wanted = {*wanted, *BASIC}
    together = max(1, _PIECE // n) if steady else 1
    loads = {"force", "torque"} & wanted
    results: dict[str, Array] = {name: np.empty((samples, n, *shape_of(name))) for name in wanted}
    many = equations
    for start in range(0, samples, together):
        piece = slice(start, min(start + together, samples))
        count = piece.stop - piece.start
        y = states[piece].reshape(count * n, -1)
        if many.n_bodies != len(y):
            many = equations.repeated(count)
        t = float(times[start])
        orientation = rotation.normalize(y[:, 3:7])
        axis = rotation.axis(orientation)
        velocity, spin = many.velocities(t, y)
        found = {
            "position": y[:, 0:3],
            "axis": axis,
            "velocity": velocity,
            "angular_velocity": spin,
        }
        if "orientation" in wanted:
            found["orientation"] = orientation
        if "euler_angles" in wanted:
            found["euler_angles"] = rotation.to_euler(orientation)
        if "orbit_constant" in wanted:
            k = equations.model.aspect_ratio
            found["orbit_constant"] = (
                np.full(len(axis), np.nan) if shear is None else orbit_constant(axis, k, shear)
            )
        if loads:
            found["force"], found["torque"] = many.force_torque(t, y)
        for name, values in found.items():
            if name in results:
                results[name][piece] = values.reshape(count, n, *shape_of(name))
    return results
