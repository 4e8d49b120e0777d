"""What is told of the motion of a block: its start, velocities, forces, rates and scales."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qbxstokes.geometry import rotation
from qbxstokes.motion.layout import (
    N_MASSLESS,
    ORIENTATION,
    POSITION,
    RATES,
    ROTATION,
    SPIN,
    TRANSLATION,
    VELOCITY,
)
from qbxstokes.motion.pieces import Pieces
from qbxstokes.motion.providers import ForceTorque

Array = NDArray[np.float64]


class Reported(Pieces):
    """Bodies of a block with what is told of them in given states, and what guides the steps."""

    def initial_state(
        self,
        position: ArrayLike,
        quaternion: ArrayLike,
        velocity: ArrayLike | None = None,
        angular_velocity: ArrayLike | None = None,
        t: float = 0.0,
    ) -> Array:
        """States (n_lanes, n_state) from positions, quaternions and velocities (space frame).

        A velocity that is None follows the flow (and the loads): no net force, no net torque.
        """
        n = self.n_lanes
        y = np.empty((n, self.n_state))
        y[:, POSITION] = np.asarray(position, dtype=np.float64)
        y[:, ORIENTATION] = rotation.normalize(np.broadcast_to(quaternion, (n, 4)))
        if not self.massless:
            y[:, RATES] = 0.0
            free = np.stack([np.broadcast_to(u, (n,)) for u in self._driven(t, y.T)], axis=-1)
            v, omega = np.array(free[:, TRANSLATION]), np.array(free[:, ROTATION])
            if velocity is not None:
                v[:] = np.asarray(velocity, dtype=np.float64)
            if angular_velocity is not None:
                omega[:] = np.asarray(angular_velocity, dtype=np.float64)
            y[:, VELOCITY] = v
            y[:, SPIN] = rotation.to_body(y[:, ORIENTATION], omega)
            if self._follow is not None:
                move, turn = self._follow
                y[:, VELOCITY] *= 1.0 - move
                y[:, SPIN] *= 1.0 - turn
        return y

    def force_torque(self, t: float, y: Array) -> tuple[Array, Array]:
        """Hydrodynamic force and torque ON the bodies (space frame), each (n_lanes, 3).

        F = R_t (U - V) and M = R_r (Omega - W); external loads are not part of them.
        """
        if self._force_free:
            return np.zeros((self.n_lanes, 3)), np.zeros((self.n_lanes, 3))
        q = rotation.normalize(y[:, ORIENTATION])
        v, omega = self.velocities(t, y)
        if isinstance(self._provider, ForceTorque):
            return self._provider.force_torque(t, y[:, POSITION], q, v, omega)
        free = self._free(t, self._rows(y.T))
        motion = np.stack([np.broadcast_to(u, (self.n_lanes,)) for u in free], axis=-1)
        d = rotation.axis(q)
        rt, ra, st, sa = self.bodies.resistance[..., None]

        def drag(slip: Array, transverse: Array, axial: Array) -> Array:
            along = np.sum(slip * d, axis=-1, keepdims=True) * d
            return np.asarray(transverse * slip + (axial - transverse) * along)

        return drag(motion[:, TRANSLATION] - v, rt, ra), drag(motion[:, ROTATION] - omega, st, sa)

    @property
    def stiffness(self) -> Array:
        """Fastest relaxation rate of each body, (n,); zero for St = 0."""
        return np.zeros(self.n_lanes) if self.massless else self._rates.max(axis=0)

    def scales(self, t: float, y: Array) -> Array:
        """Size of each component of the states y, (n_lanes, n_state), for error control.

        1 for lengths (c) and for the quaternion; the rate at which the flow turns and strains for
        velocities, or that of the motion itself where the flow does neither.
        """
        scales = np.ones((self.n_lanes, self.n_state))
        if not self.massless:
            scales[:, N_MASSLESS:] = self.time_rate(t, y)[:, None]
        return scales

    def sensitivity(self, t: float, y: Array, horizon: float) -> float:
        """How many times the error of one step may grow until `horizon` later.

        An axis that a shear turns lingers in one direction and hurries through the rest: a lag
        grows by max(k, 1/k)^2 from the one to the other, and one more is made at every turn. The
        error of both Runge-Kutta pairs after ten periods is 0.04 to 1.4 times the tolerance then,
        for k from 1/50 to 50.
        """
        slenderness, square = self.bodies.slenderness
        turns = self.time_rate(t, y) * horizon / (2.0 * np.pi * slenderness)
        return float(np.max(square * np.maximum(1.0, turns)))

    def time_rate(self, t: float, y: Array) -> Array:
        """Rate (n,) at which things change: |grad U|, the shear rate in a shear."""
        gradient = self._flow_gradient(t, y)
        rate = np.sqrt(np.sum(gradient * gradient, axis=(-2, -1)))
        v, omega = self.velocities(t, y)
        moving = np.linalg.norm(v, axis=-1) + np.linalg.norm(omega, axis=-1)
        rate = np.where(rate > 1e-12 * moving, rate, moving)
        return np.where(rate > 0.0, rate, 1.0)

    def _flow_gradient(self, t: float, y: Array) -> Array:
        """Velocity gradient at the centres, (n, 3, 3); of the free velocity with a provider."""
        if self._table is not None:
            gradient = np.empty((self.n_lanes, 3, 3))
            for flow, lanes in self._flows.groups():
                gradient[lanes] = flow.gradient(y[lanes, POSITION], t)
            return gradient
        return self._motion_slopes(t, np.ascontiguousarray(y.T))[:, TRANSLATION, POSITION]
