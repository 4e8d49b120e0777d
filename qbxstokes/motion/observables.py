"""Quantities of a motion from the states that the integrator gives: one function for each.

A quantity that `quantities.MOTION` lists is computed by the function that is registered here under
its name. To add one: a line in the list, a function here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from qbxstokes.geometry import rotation
from qbxstokes.motion.diagnostics import orbit_constant
from qbxstokes.motion.equations import RigidBodyEquations
from qbxstokes.motion.layout import ORIENTATION, POSITION
from qbxstokes.quantities import MOTION

Array = NDArray[np.float64]

# States are turned into quantities in pieces of about this many, which stay in the cache.
_PIECE = 4096
# What every caller gets.
_BASIC = ("position", "axis", "velocity", "angular_velocity")


class Moment:
    """The states (n, n_state) of n bodies at the time t, and what several quantities share.

    shear: directions (3, 3) of stream, gradient and vorticity to which the orbit constant refers,
    None where there are none.
    """

    def __init__(
        self, equations: RigidBodyEquations, t: float, states: Array, shear: Array | None
    ) -> None:
        self.equations, self.t, self.states, self.shear = equations, t, states, shear

    @cached_property
    def orientation(self) -> Array:
        """Unit quaternions (n, 4)."""
        return rotation.normalize(self.states[:, ORIENTATION])

    @cached_property
    def axis(self) -> Array:
        """Symmetry axes (n, 3)."""
        return rotation.axis(self.orientation)

    @cached_property
    def velocities(self) -> tuple[Array, Array]:
        """V and Omega, each (n, 3)."""
        return self.equations.velocities(self.t, self.states)

    @cached_property
    def force_torque(self) -> tuple[Array, Array]:
        """Hydrodynamic force and torque on the bodies, each (n, 3)."""
        return self.equations.force_torque(self.t, self.states)


def _orbit_constant(moment: Moment) -> Array:
    if moment.shear is None:
        return np.full(len(moment.states), np.nan)
    return orbit_constant(moment.axis, moment.equations.effective_ratio, moment.shear)


OBSERVABLES: dict[str, Callable[[Moment], Array]] = {
    "position": lambda moment: moment.states[:, POSITION],
    "orientation": lambda moment: moment.orientation,
    "axis": lambda moment: moment.axis,
    "velocity": lambda moment: moment.velocities[0],
    "angular_velocity": lambda moment: moment.velocities[1],
    "force": lambda moment: moment.force_torque[0],
    "torque": lambda moment: moment.force_torque[1],
    "euler_angles": lambda moment: rotation.to_euler(moment.orientation),
    "orbit_constant": _orbit_constant,
}


def observe(
    equations: RigidBodyEquations,
    times: Array,
    states: Array,
    steady: bool,
    wanted: Iterable[str] = (),
    shear: Array | None = None,
) -> dict[str, Array]:
    """The wanted quantities (T, n, ...) from the states (T, n, n_state) at the times (T,).

    Position, axis and both velocities are always among them. steady: whether the flow is. shear:
    as in `Moment`; the orbit constant is NaN without it. Raises KeyError for an unknown name.
    """
    samples, n = states.shape[:2]
    together = max(1, _PIECE // n) if steady and equations.steady else 1
    results: dict[str, Array] = {
        name: np.empty((samples, n, *MOTION[name].shape))
        for name in dict.fromkeys((*_BASIC, *wanted))
    }
    many = equations
    for start in range(0, samples, together):
        piece = slice(start, min(start + together, samples))
        count = piece.stop - piece.start
        y = states[piece].reshape(count * n, -1)
        if many.n_lanes != len(y):
            many = equations.repeated(count)
        moment = Moment(many, float(times[start]), y, shear)
        for name, array in results.items():
            array[piece] = OBSERVABLES[name](moment).reshape(count, n, *array.shape[2:])
    return results
