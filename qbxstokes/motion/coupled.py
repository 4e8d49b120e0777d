"""Equations of motion of bodies that feel each other, or a wall, through the fluid.

One lane of N bodies (`layout`); states are (N, n_state) for the user, (n_state, N) in `rates`.
Without inertia, dx/dt = U and dq/dt = (0, Omega) * q / 2 with the velocities (U, Omega) at which
the fluid's force and torque balance the loads on every body. With inertia,

    St Theta dV/dt = F + F_ext,   St J dW/dt = M + M_ext - St W x (J W)   (body frame)

with the force F and torque M of the fluid on the bodies of given velocities, Theta and J the volume
and the moments of inertia of each, and St = rho_p L^2/(mu tau) with the scene's unit of length L.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.geometry import rotation
from qbxstokes.motion.equations import RigidBodyEquations
from qbxstokes.motion.layout import (
    N_INERTIAL,
    N_MASSLESS,
    ORIENTATION,
    POSITION,
    RATES,
    SPIN,
    VELOCITY,
    Layout,
)
from qbxstokes.motion.loads import Constraints
from qbxstokes.typing import Array

_MEETING = 4.0  # times that an error grows as two bodies pass each other
# Step of the differences of a Jacobian, well above the error of the rates.
_STEP = 1e-4
# Newton steps at one instant that show that a resistance is out of date, and instants that it
# serves at least.
_SLOW, _LASTING = 5, 5


@dataclass(frozen=True)
class WallConstants:
    """The arguments of `over_wall.rate` besides the state, for one body over a wall.

    load (6,): force and torque, in space. plane (3, 3): normal, point and velocity of the wall.
    ratio: k; size: the polar radius. terms (5, 3): of the flow. first: the first cell; cells and
    pieces: the table so far.
    """

    load: Array
    plane: Array
    ratio: float
    size: float
    terms: Array
    first: int
    cells: Array
    pieces: Array


class SharedFluid(Protocol):
    """What moves N bodies in one fluid: arrays (N, 3), quaternions (N, 4), in space."""

    def between(self, t: float) -> float:
        """The instant to ask for: at a break of the flow just before it, or just after it."""

    def free(self, t: float, x: Array, q: Array) -> tuple[Array, Array]:
        """Velocities and angular velocities at which nothing but the loads acts on the bodies."""

    def drag(self, t: float, x: Array, q: Array, v: Array, omega: Array) -> tuple[Array, Array]:
        """Force and torque of the fluid ON the bodies of given velocities."""

    def resistance(self, t: float, x: Array, q: Array) -> Array:
        """The resistance (6N, 6N), roughly: force and torque by the bodies ON the fluid."""

    def loads(self, t: float, x: Array, q: Array) -> tuple[Array, Array]:
        """Force and torque from outside."""

    def gradient(self, t: float, x: Array) -> Array:
        """Velocity gradient (N, 3, 3) of the background flow."""


class CoupledEquations(RigidBodyEquations):
    """dy/dt of the bodies of one fluid; see the module's text.

    ratios: k of the bodies. stokes_number (N,), all zero or all positive. volume (N,), inertia
    (N, 3): of the bodies at unit density. relaxation (4, N): the rates of each alone, as
    `relaxation_rates`; 0 without inertia. constants: what a compiled rate takes of the table of one
    massless body over a wall, where nothing changes in time.
    """

    bdf_cost = 4.0

    def __init__(
        self,
        fluid: SharedFluid,
        ratios: Array,
        stokes_number: Array,
        volume: Array,
        inertia: Array,
        relaxation: Array,
        constants: Callable[[], WallConstants] | None = None,
        noise: float = 0.0,
    ) -> None:
        self._constants = constants
        self.fluid, self.n_lanes = fluid, len(ratios)
        self.stokes_number = stokes_number
        self.massless = not np.any(stokes_number)
        self.n_state = N_MASSLESS if self.massless else N_INERTIAL
        self.layout = Layout(self.n_state, 1, self.n_lanes)
        self.constraints = Constraints()
        self.evaluation, self.inertia, self.exact_jacobian = "plain", "both", self.massless
        self.effective_ratio, self.stiffness = ratios, relaxation.max(axis=0)
        # Many instants are not asked for at once, and what drag does is a matter of all bodies.
        self.steady, self._steady_loads, self.free_of_torque = False, True, False
        self.relaxation_rates = relaxation
        self.noise = noise
        self._mass = stokes_number * volume
        self._moments = stokes_number[:, None] * inertia
        self._table, self._loads, self.changing = None, None, None
        self._latest: tuple[float, Array, tuple[Array, Array]] | None = None

    @property
    def function_rows(self) -> None:
        """No compiled flow moves bodies that feel each other."""

    def rates(self, t: float, y: Array, out: Array) -> None:
        """Write dy/dt, (n_state, N)."""
        out[:] = self._rate_of(t, y.T).T

    def _pieces(self, t: float, rows: Any) -> Any:
        """dy/dt of one body by a wall as a tuple of numbers."""
        return tuple(self._rate_of(t, np.array(rows, dtype=np.float64)[None])[0].tolist())

    @property
    def over_wall(self) -> tuple[Callable[[], WallConstants], Callable[..., None]] | None:
        """What the compiled rate takes, and the rate by Python where the table has none."""
        return None if self._constants is None else (self._constants, self.fill)

    def fill(self, t: float, y: Array, out: Array) -> None:
        """Write dy/dt (n_state,) of one body in the state y (n_state,)."""
        out[:] = self._rate_of(t, y[None])[0]

    def _rate_of(self, t: float, y: Array) -> Array:
        t, x, q = self.fluid.between(t), y[:, POSITION], rotation.normalize(y[:, ORIENTATION])
        rate = np.empty_like(y)
        v, omega = self.velocities(t, y)
        rate[:, :N_MASSLESS] = self._moving(y, v, omega)
        if self.massless:
            return rate
        force, torque = self.fluid.drag(t, x, q, v, omega)
        push, turn = self.fluid.loads(t, x, q)
        rate[:, VELOCITY] = (force + push) / self._mass[:, None]
        w = y[:, SPIN]
        about = rotation.to_body(q, torque + turn) - np.cross(w, self._moments * w)
        rate[:, SPIN] = about / self._moments
        return rate

    def moving(self, t: float, y: Array) -> Array:
        """Rates (N, 7) of positions and quaternions in the states y (N, n_state)."""
        return self._moving(y, *self.velocities(t, y))

    def _moving(self, y: Array, v: Array, omega: Array) -> Array:
        spin = np.concatenate([np.zeros((self.n_lanes, 1)), omega], axis=1)
        return np.hstack([v, 0.5 * rotation.multiply(spin, y[:, ORIENTATION])])

    def velocities(self, t: float, y: Array) -> tuple[Array, Array]:
        """V and Omega (space frame), each (N, 3), in the states y (N, n_state)."""
        q = rotation.normalize(y[:, ORIENTATION])
        if not self.massless:
            return np.array(y[:, VELOCITY]), rotation.to_space(q, y[:, SPIN])
        t = self.fluid.between(t)
        if self._latest is None or self._latest[0] != t or not np.array_equal(self._latest[1], y):
            self._latest = t, np.array(y), self.fluid.free(t, y[:, POSITION], q)
        return self._latest[2]

    def know(self, t: float, y: Array, velocities: tuple[Array, Array]) -> None:
        """Take velocities of massless bodies in a state as found: no problem is solved for them."""
        self._latest = self.fluid.between(t), np.array(y), velocities

    def force_torque(self, t: float, y: Array) -> tuple[Array, Array]:
        """Hydrodynamic force and torque ON the bodies (space frame), each (N, 3)."""
        q = rotation.normalize(y[:, ORIENTATION])
        if self.massless:
            force, torque = self.fluid.loads(t, y[:, POSITION], q)
            return 0.0 - force, 0.0 - torque
        v, omega = self.velocities(t, y)
        return self.fluid.drag(t, y[:, POSITION], q, v, omega)

    def initial_state(
        self,
        position: ArrayLike,
        quaternion: ArrayLike,
        velocity: ArrayLike | None = None,
        angular_velocity: ArrayLike | None = None,
        t: float = 0.0,
    ) -> Array:
        """States (N, n_state); velocities (N, 3) in space, None: those of the free bodies."""
        y = np.empty((self.n_lanes, self.n_state))
        y[:, POSITION] = np.asarray(position, dtype=np.float64)
        y[:, ORIENTATION] = rotation.normalize(np.broadcast_to(quaternion, (self.n_lanes, 4)))
        if not self.massless:
            q = y[:, ORIENTATION]
            free = (np.zeros(3), np.zeros(3))
            if velocity is None or angular_velocity is None:
                free = self.fluid.free(t, y[:, POSITION], q)
            y[:, RATES] = 0.0
            y[:, VELOCITY] = free[0] if velocity is None else np.asarray(velocity)
            omega = free[1] if angular_velocity is None else np.asarray(angular_velocity)
            y[:, SPIN] = rotation.to_body(q, np.broadcast_to(omega, (self.n_lanes, 3)))
        return y

    def sensitivity(self, t: float, y: Array, horizon: float) -> float:
        """How many times the error of one step may grow.

        As that of the most slender body alone; a gradient carries bodies apart that are off, and
        bodies that meet part further off than they came.
        """
        slenderness = np.maximum(self.effective_ratio, 1.0 / self.effective_ratio)
        turns = self.time_rate(t, y) * horizon / (2.0 * np.pi * slenderness)
        alone = np.max(slenderness * slenderness * np.maximum(1.0, turns))
        carried = np.linalg.norm(self._flow_gradient(t, y), axis=(1, 2)).max() * horizon
        return float(alone * (1.0 + carried) * (_MEETING if self.n_lanes > 1 else 1.0))

    def _flow_gradient(self, t: float, y: Array) -> Array:
        return self.fluid.gradient(t, y[:, POSITION])

    def jacobian_function(self, evaluations: float = 0.0) -> Callable[[float, Array, Array], None]:
        """The function (t, y, out) that writes the one block (1, N n_state, N n_state)."""
        return self.jacobian if self.massless else Drag(self).jacobian

    def jacobian(self, t: float, y: Array, out: Array) -> None:
        """Write the Jacobian by central differences: two problems for each number of the state."""
        states = np.array(y.T)
        for column in range(states.size):
            sides = []
            for step in (_STEP, -_STEP):
                moved = states.copy()
                moved.ravel()[column] += step
                sides.append(self._rate_of(t, moved).ravel())
            out[0, :, column] = (sides[0] - sides[1]) / (2.0 * _STEP)

    def dragged(self, t: float, y: Array, resistance: Array, out: Array) -> None:
        """Write the Jacobian (1, N 13, N 13) but for how forces change with place and turn.

        resistance (6N, 6N): of the bodies, about where they are. What is left out changes the
        velocities as fast as the flow does, not as drag does.
        """
        states, n = y.T, self.n_lanes
        raw, w = states[:, ORIENTATION], states[:, SPIN]
        to_space = rotation.matrix(rotation.normalize(raw))
        block = out.reshape(n, self.n_state, n, self.n_state)
        block[:] = 0.0
        drag = resistance.reshape(n, 2, 3, n, 2, 3).copy()
        drag[:, :, :, :, 1] = np.einsum("afibj,bjk->afibk", drag[:, :, :, :, 1], to_space)
        drag[:, 1] = np.einsum("aki,akbfj->aibfj", to_space, drag[:, 1])
        for part, own, mass in ((0, VELOCITY, self._mass[:, None]), (1, SPIN, self._moments)):
            for other, columns in ((0, VELOCITY), (1, SPIN)):
                block[:, own, :, columns] = (
                    -drag[:, part, :, :, other] / np.broadcast_to(mass, (n, 3))[:, :, None, None]
                )
        unit, spins = np.eye(4), np.concatenate([np.zeros((n, 1)), w], axis=1)
        for b, moments in enumerate(self._moments):
            block[b, POSITION, b, VELOCITY] = np.eye(3)
            block[b, ORIENTATION, b, ORIENTATION] = 0.5 * rotation.multiply(unit, spins[b]).T
            block[b, ORIENTATION, b, SPIN] = 0.5 * rotation.multiply(raw[b], unit[1:]).T
            whirl = np.cross(np.eye(3), moments * w[b]) + np.cross(w[b], np.diag(moments))
            block[b, SPIN, b, SPIN] -= whirl.T / moments[:, None]

    def resistance(self, t: float, y: Array) -> Array:
        """The resistance (6N, 6N), roughly, of bodies in the states y (N, n_state)."""
        x, q = y[:, POSITION], rotation.normalize(y[:, ORIENTATION])
        return self.fluid.resistance(self.fluid.between(t), x, q)

    def stiffness_at(self, t: float, y: Array) -> float:
        """The fastest rate at which drag takes up a motion of bodies in the states y (N, 13)."""
        found = np.empty((1, y.size, y.size))
        self.dragged(t, y.T, self.resistance(t, y), found)
        rates = np.arange(y.size).reshape(y.shape)[:, RATES].ravel()
        return float(np.abs(np.linalg.eigvals(found[0][np.ix_(rates, rates)])).max())


class Drag:
    """Jacobians for an integrator, with a resistance that is found anew where it serves no more."""

    def __init__(self, equations: CoupledEquations) -> None:
        self._equations = equations
        self._resistance: Array | None = None
        # The instant asked for last, how often, and how many others since the resistance.
        self._asked, self._times, self._since = math.nan, 0, 0

    def jacobian(self, t: float, y: Array, out: Array) -> None:
        """Write the Jacobian, see `CoupledEquations.dragged`."""
        self._times = self._times + 1 if t == self._asked else 1
        self._since += self._times == 1
        self._asked = t
        slow = self._times == _SLOW and self._since >= _LASTING
        if self._resistance is None or slow:
            self._resistance, self._since = self._equations.resistance(t, y.T), 0
        self._equations.dragged(t, y, self._resistance, out)
