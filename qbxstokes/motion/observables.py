"""Quantities of a motion from the states that the integrator gives: one function for each.

A quantity that `quantities.RECORDABLE` lists is computed by the function that is registered here
under its name. To add one: a line in the list, a function here.
"""

from collections.abc import Callable, Iterable
from functools import cached_property
from typing import Any

import numpy as np

from qbxstokes.geometry import rotation
from qbxstokes.geometry.symmetric import components
from qbxstokes.motion.diagnostics import orbit_constant
from qbxstokes.motion.equations import RigidBodyEquations
from qbxstokes.motion.layout import ORIENTATION, POSITION
from qbxstokes.motion.stress import StressSource, inertial_stresses
from qbxstokes.quantities import RECORDABLE
from qbxstokes.typing import Array

# States are turned into quantities in pieces of about this many, which stay in the cache.
_PIECE = 4096
# Nearer to e3 or -e3, where the third component of the axis is 1 or -1 to rounding, or nearer than
# the tolerance, phi and psi alone are noise of the integration: psi is 0 there.
_POLE = 1e-8
# What every caller gets.
_BASIC = ("position", "axis", "velocity", "angular_velocity")


class Moment:
    """The states (n, n_state) of n bodies at time t, or times (n,), and what quantities share.

    shear: directions (3, 3) of stream, gradient and vorticity to which the orbit constant refers,
    None where there are none. tolerance: to which the states are known.
    """

    def __init__(
        self,
        equations: RigidBodyEquations,
        t: Any,
        states: Array,
        shear: Array | None,
        stress: StressSource | None = None,
        tolerance: float = 0.0,
    ) -> None:
        self.tolerance = tolerance
        self.equations, self.t, self.states, self.shear = equations, t, states, shear
        self._stress = stress

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

    @property
    def stress(self) -> StressSource:
        """What knows the stresslets. Raises ValueError where nothing was prepared."""
        if self._stress is None:
            raise ValueError("stresses need a source")
        return self._stress

    @cached_property
    def stresslet(self) -> Array:
        """Stresslets (n, 6), those of hydrodynamic torques included."""
        torque = None if self.equations.free_of_torque else self.force_torque[1]
        x = self.states[:, POSITION]
        return self.stress.stresslet(self.t, x, self.orientation, self.axis, torque)

    @cached_property
    def inertial(self) -> tuple[Array, Array]:
        """Parts (n, 6) of the particle stress from acceleration and relative motion."""
        gradient, volume_rate = self._scale
        parts = inertial_stresses(self.equations, self.t, self.states, gradient)
        return components(parts[0]) / volume_rate, components(parts[1]) / volume_rate

    @cached_property
    def brownian(self) -> Array:
        """3 kT lambda (pp - I/3) (n, 6), part of the particle stress (Hinch & Leal 1972)."""
        thermal = 0.0 if self.stress.thermal is None else self.stress.thermal
        p, strength = self.axis, np.resize(thermal, len(self.states))[:, None]
        outer = p[:, :, None] * p[:, None, :] - np.eye(3) / 3.0
        return np.asarray(strength * components(outer) / self._scale[1])

    @cached_property
    def _scale(self) -> tuple[Array, Array]:
        """Velocity gradient (n, 3, 3) at the centres, and volume times rate (n, 1)."""
        gradient = self.stress.gradient(self.t, self.states)
        twice = gradient + gradient.swapaxes(1, 2)
        rate = np.sqrt(0.5 * np.einsum("nij,nij->n", twice, twice))
        volume = np.broadcast_to(self.equations.bodies.inertia[0], rate.shape)
        with np.errstate(divide="ignore"):
            return gradient, np.where(rate > 0.0, volume * rate, np.nan)[:, None]

    @property
    def particle_stress(self) -> Array:
        """Sum (n, 6) of all parts over volume fraction, mu and rate (G. K. Batchelor 1970)."""
        flowing = np.asarray(self.stresslet / self._scale[1])
        if self.stress.thermal is not None:
            flowing = flowing + self.brownian
        return flowing if self.equations.massless else flowing + self.inertial[0] + self.inertial[1]


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
    "euler_angles": lambda moment: rotation.to_euler(
        moment.orientation, max(_POLE, moment.tolerance)
    ),
    "orbit_constant": _orbit_constant,
    "stresslet": lambda moment: moment.stresslet,
    "particle_stress": lambda moment: moment.particle_stress,
    "acceleration_stress": lambda moment: moment.inertial[0],
    "reynolds_stress": lambda moment: moment.inertial[1],
    "brownian_stress": lambda moment: moment.brownian,
}


def observe(
    equations: RigidBodyEquations,
    times: Array,
    states: Array,
    steady: bool,
    wanted: Iterable[str] = (),
    shear: Array | None = None,
    stress: StressSource | None = None,
    tolerance: float = 0.0,
) -> dict[str, Array]:
    """The wanted quantities (T, n, ...) from the states (T, n, n_state) at the times (T,).

    Position, axis and both velocities are always among them. steady: whether the flow is. shear:
    and tolerance: as in `Moment`; the orbit constant is NaN without the first. stress: what knows
    the stresslets. Raises KeyError for an unknown name.
    """
    samples, n = states.shape[:2]
    vectors = steady or (equations.changing is not None and stress is None)
    together = max(1, _PIECE // n) if vectors and equations.steady else 1
    results: dict[str, Array] = {
        name: np.empty((samples, n, *RECORDABLE[name].shape))
        for name in dict.fromkeys((*_BASIC, *wanted))
    }
    many = equations
    for start in range(0, samples, together):
        piece = slice(start, min(start + together, samples))
        count = piece.stop - piece.start
        y = states[piece].reshape(count * n, -1)
        if many.n_lanes != len(y):
            many = equations.repeated(count)
        t = float(times[start]) if steady or count == 1 else np.repeat(times[piece], n)
        moment = Moment(many, t, y, shear, stress, tolerance)
        for name, array in results.items():
            array[piece] = OBSERVABLES[name](moment).reshape(count, n, *array.shape[2:])
    return results
