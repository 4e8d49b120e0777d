"""Bodies of a block: what they are made of, what acts on them, and the pieces of their equations.

The pieces are put together for providers and constraints, and for what is told of a motion: its
start, velocities, forces, rates and scales.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.bie.functional import BodyModel
from qbxstokes.errors import FlowError
from qbxstokes.flows.changing import ChangingFlow
from qbxstokes.flows.polynomial import PolynomialFlow
from qbxstokes.geometry import rotation
from qbxstokes.motion import taylor
from qbxstokes.motion.flow_rows import FlowRows
from qbxstokes.motion.lanes import Bodies, ForceTorque, FreeMotion, PerLane, provider_of
from qbxstokes.motion.layout import (
    N_INERTIAL,
    N_MASSLESS,
    ORIENTATION,
    POSITION,
    RATES,
    ROTATION,
    SPIN,
    TRANSLATION,
    VELOCITY,
    Layout,
)
from qbxstokes.motion.loads import Constraints, LoadRows, Loads, Vectors
from qbxstokes.motion.taylor import pack_flow, unpack_flow
from qbxstokes.typing import Array

# Parts of a run after which a flow that changes is looked at beforehand.
_SHARES = 0.04 * np.arange(25)
Evaluation = Literal["auto", "plain", "compiled"]
Inertia = Literal["both", "translation", "rotation"]


class Pieces:
    """Free motion, drag and loads of the bodies of a block, of which their rates are made.

    The arguments are those of `RigidBodyEquations`.

    free_of_torque: whether the fluid exerts neither force nor torque on any body at any instant.
    steady: whether loads and constraints are constant in time (the flow may still change).
    effective_ratio (n_lanes,): of the spheroids whose axes move as those of the lanes.
    relaxation_rates (4, n): R/(St inertia), of translation and rotation, transverse and axial; inf
    for St = 0, zero for a part whose inertia is switched off. The inverses are the time scales on
    which a body takes up the motion of the flow. stiffness (n_lanes,): the fastest of each body,
    zero for St = 0.
    """

    _mean_rate: tuple[Any, Array] = None, np.empty(0)  # the last one asked for

    def __init__(
        self,
        model: BodyModel | Sequence[BodyModel],
        flow: PolynomialFlow | FreeMotion | Sequence[PolynomialFlow] | Sequence[FreeMotion],
        stokes_number: ArrayLike = 0.0,
        n_lanes: int = 1,
        loads: Loads | None = None,
        constraints: Constraints | None = None,
        evaluation: Evaluation = "auto",
        inertia: Inertia = "both",
    ) -> None:
        """Precompute rates and tables.

        Raises ValueError for mixed or negative Stokes numbers, for sequences of another length than
        `n_lanes`, for polynomial flows mixed with providers, for laws of several classes, and for
        bodies with mass, loads or constraints whose model was formed without the resistance.
        """
        self.n_lanes = n_lanes
        self.stokes_number: Array = np.broadcast_to(
            np.asarray(stokes_number, dtype=np.float64), (n_lanes,)
        )
        self.massless = not np.any(self.stokes_number)
        if not self.massless and not np.all(self.stokes_number > 0.0):
            raise ValueError("Stokes numbers of one block must be all zero or all positive")
        self.n_state = N_MASSLESS if self.massless else N_INERTIAL
        self.layout = Layout(self.n_state, n_lanes)
        self.constraints = constraints or Constraints()
        self.evaluation: Evaluation = evaluation
        self.inertia: Inertia = inertia
        self._follow: tuple[float, float] | None = None
        if inertia != "both" and not self.massless:
            self._follow = (float(inertia == "rotation"), float(inertia == "translation"))

        # Force-free bodies read none of what follows from the resistance.
        self.free_of_torque = self.massless and loads is None and self.constraints.free
        self.bodies = bodies = Bodies(model, n_lanes, not self.free_of_torque)
        self.effective_ratio = np.broadcast_to(bodies.effective_ratio, (n_lanes,))
        with np.errstate(divide="ignore"):
            rates: Array = bodies.resistance / bodies.inertia / self.stokes_number
        if self._follow is not None:
            move, turn = self._follow
            rates *= np.array([[1.0 - move], [1.0 - move], [1.0 - turn], [1.0 - turn]])
        self.relaxation_rates = rates
        self.stiffness = np.zeros(n_lanes) if self.massless else rates.max(axis=0)

        self._flows: PerLane[Any] = PerLane(flow, n_lanes, _key_of_flow)
        self._table: Array | None = None
        self._provider: FreeMotion | None = None
        kinds = (PolynomialFlow, ChangingFlow)
        polynomial = {isinstance(entry, kinds) for entry in self._flows.distinct}
        # Of flows that change in time, the table holds the numbers of the last instant.
        self.changing: FlowRows | None = None
        if polynomial == {True}:
            self._table = self._flows.table(pack_flow)
            self._degree = int(np.max(self._table[0]))
            if any(isinstance(entry, ChangingFlow) for entry in self._flows.distinct):
                self.changing = FlowRows(self._flows, self._table)
            self._flow = self._flow_of([])
        elif polynomial == {False}:
            self._provider = provider_of(self._flows, n_lanes)
        else:
            raise ValueError("flows of one block must be all polynomial, or none of them")
        self._loads = None if loads is None else LoadRows(loads, n_lanes)
        self._given_loads = loads
        self._steady_loads = self._loads is None or self._loads.steady
        self.steady = self._steady_loads and self.constraints.steady

    @property
    def model(self) -> BodyModel:
        """The body model that all lanes share. Raises ValueError where they differ."""
        return self.bodies.models.only

    def accuracy_in_time(self, tolerance: float) -> float:
        """Relative accuracy of functions of time: a hundredth of a tolerance at the end, however
        the axis magnifies it."""
        k = self.effective_ratio
        return 0.01 * tolerance / float(np.max(np.maximum(k, 1.0 / k)))

    def velocities(self, t: float, y: Array) -> tuple[Array, Array]:
        """V and Omega (space frame), each (n_lanes, 3), in the states y (n_lanes, n_state)."""
        motion = np.zeros((self.n_lanes, 6))
        if self.massless or self._follow is not None:
            motion = self._twists(self._driven(t, y.T))
        v, omega = motion[:, TRANSLATION], motion[:, ROTATION]
        if not self.massless:
            move, turn = self._follow or (0.0, 0.0)
            v = v if move else y[:, VELOCITY]
            if not turn:
                omega = rotation.to_space(rotation.normalize(y[:, ORIENTATION]), y[:, SPIN])
        prescribed = self.constraints
        return (
            v if prescribed.velocity is None else self._vectors(prescribed.velocity, t),
            omega
            if prescribed.angular_velocity is None
            else self._vectors(prescribed.angular_velocity, t),
        )

    def _rows(self, y: Array) -> Any:
        """Numbers of the one body (plain arithmetic is fastest on floats), or rows."""
        return y[:, 0].tolist() if self.n_lanes == 1 else y

    def _twists(self, motion: Any) -> Array:
        """Six numbers, or rows, as (n_lanes, 6)."""
        found = np.empty((self.n_lanes, 6))
        for j, row in enumerate(motion):
            found[:, j] = row
        return found

    def _vectors(self, vectors: Vectors, t: float) -> Array:
        value = vectors(t) if callable(vectors) else vectors
        return np.broadcast_to(np.asarray(value, dtype=np.float64), (self.n_lanes, 3))

    def _flow_of(self, changing: Any) -> Any:
        """The flow as the kernels take it, with other numbers in the rows that change."""
        assert self._table is not None
        numbers = list(self._table) if self._table.ndim == 2 else self._table.tolist()
        numbers[0] = self._degree
        if len(changing) and self.changing is not None:
            for row, value in zip(self.changing.rows.tolist(), changing, strict=True):
                numbers[row] = value
        return unpack_flow(numbers)

    def _free(self, t: float, rows: Any) -> Any:
        """Free motion, six numbers or rows."""
        if self._table is not None:
            kernels, law = self.bodies.kernels, self.bodies.law
            flow = self._flow_of(self.changing.at(t)) if self.changing else self._flow
            return kernels.free(rows, flow, law)
        assert self._provider is not None
        y = np.stack([np.atleast_1d(row) for row in rows[:N_MASSLESS]], axis=-1)
        u, omega = self._provider.free_motion(
            t, y[:, POSITION], rotation.normalize(y[:, ORIENTATION])
        )
        return tuple(self._rows(np.concatenate([u, omega], axis=1).T))

    def _motion(self, t: float, rows: Any) -> Any:
        """What replaces the free motion in `_rate`, without the loads.

        With a provider of forces it is V + R^-1 F, which makes the drag formula return F.
        """
        if self.massless or not isinstance(self._provider, ForceTorque):
            return self._free(t, rows)
        y = np.stack([np.atleast_1d(row) for row in rows], axis=-1)
        q = rotation.normalize(y[:, ORIENTATION])
        v, omega = self.velocities(t, y)
        force, torque = self._provider.force_torque(t, y[:, POSITION], q, v, omega)
        zero = np.zeros((3, self.n_lanes))
        return self.bodies.kernels.driven_motion(
            tuple(self._rows(np.concatenate([v, omega], axis=1).T)),
            taylor.body_axes(rows[ORIENTATION]),
            self.bodies.mobility,
            self._rows(np.concatenate([force.T, zero, torque.T, zero])),
        )

    def _driven(self, t: float, y: Array) -> Any:
        """Motion without net force and torque, loads included, in states y (n_state, n)."""
        rows = self._rows(y)
        motion = self._free(t, rows)
        if self._loads is None:
            return motion
        axes, bodies = taylor.body_axes(rows[ORIENTATION]), self.bodies
        loads = self._rows(self._loads.at(t))
        return bodies.kernels.driven_motion(motion, axes, bodies.mobility, loads)

    def _rate(self, t: float, rows: Any, motion: Any) -> Any:
        """dy/dt from the motion that drag pulls to, with loads and constraints."""
        axes, bodies = taylor.body_axes(rows[ORIENTATION]), self.bodies
        if self._loads is not None:
            loads = self._rows(self._loads.at(t))
            motion = bodies.kernels.driven_motion(motion, axes, bodies.mobility, loads)
        velocity, spin = self.constraints.velocity, self.constraints.angular_velocity
        v = None if velocity is None else tuple(self._rows(self._vectors(velocity, t).T))
        omega = None if spin is None else tuple(self._rows(self._vectors(spin, t).T))
        if self.massless:
            turn = omega if omega is not None else motion[ROTATION]
            move = v if v is not None else motion[TRANSLATION]
            return (*move, *taylor.quaternion_rate_space(rows[ORIENTATION], turn))
        if self._follow is not None:
            moves, turns = self._follow
            v = tuple(motion[TRANSLATION]) if moves and v is None else v
            omega = tuple(motion[ROTATION]) if turns and omega is None else omega
        coefficients: list[Any] = [motion, axes, self._rows(self.relaxation_rates), bodies.gyration]
        pull = bodies.kernels.accelerations(rows[VELOCITY], rows[SPIN], *coefficients)
        still = (0.0, 0.0, 0.0)
        return (
            *(rows[VELOCITY] if v is None else v),
            *(
                taylor.quaternion_rate_body(rows[ORIENTATION], rows[SPIN])
                if omega is None
                else taylor.quaternion_rate_space(rows[ORIENTATION], omega)
            ),
            *(pull[TRANSLATION] if v is None else still),
            *(pull[ROTATION] if omega is None else still),
        )

    def _motion_slopes(self, t: float, y: Array, count: int = N_MASSLESS) -> Array:
        """d(U, Omega)/d(x, q) of a provider, (n, 6, count), by central differences in one call."""
        assert self._provider is not None
        step = 1e-5
        states = y[:N_MASSLESS].T
        moved = np.repeat(states[None], 2 * count, axis=0)
        for j in range(count):
            moved[2 * j, :, j] += step
            moved[2 * j + 1, :, j] -= step
        flat = moved.reshape(-1, N_MASSLESS)
        u, omega = self._provider.free_motion(
            t, flat[:, POSITION], rotation.normalize(flat[:, ORIENTATION])
        )
        motion = np.concatenate([u, omega], axis=1).reshape(count, 2, self.n_lanes, 6)
        return np.asarray(np.moveaxis((motion[:, 0] - motion[:, 1]) / (2.0 * step), 0, -1))

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
            free = self._twists(self._driven(t, y.T))
            v, omega = free[:, TRANSLATION], free[:, ROTATION]
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
        if self.free_of_torque:
            return np.zeros((self.n_lanes, 3)), np.zeros((self.n_lanes, 3))
        q = rotation.normalize(y[:, ORIENTATION])
        v, omega = self.velocities(t, y)
        if isinstance(self._provider, ForceTorque):
            return self._provider.force_torque(t, y[:, POSITION], q, v, omega)
        motion = self._twists(self._free(t, self._rows(y.T)))
        d = rotation.axis(q)
        rt, ra, st, sa = self.bodies.resistance[..., None]

        def drag(slip: Array, transverse: Array, axial: Array) -> Array:
            along = np.sum(slip * d, axis=-1, keepdims=True) * d
            return np.asarray(transverse * slip + (axial - transverse) * along)

        return drag(motion[:, TRANSLATION] - v, rt, ra), drag(motion[:, ROTATION] - omega, st, sa)

    def scales(self, t: float, y: Array) -> Array:
        """Size of each component of the states y, (n_lanes, n_state), for error control.

        1 for lengths (c) and for the quaternion; the rate at which the flow turns and strains for
        velocities, or that of the motion itself where the flow does neither.
        """
        scales = np.ones((self.n_lanes, self.n_state))
        if not self.massless:
            scales[:, N_MASSLESS:] = self.time_rate(t, y)[:, None]
        return scales

    def time_rate(self, t: float, y: Array) -> Array:
        """Rate (n,) at which things change: |grad U|, the shear rate in a shear."""
        gradient = self._flow_gradient(t, y)
        rate = np.sqrt(np.sum(gradient * gradient, axis=(-2, -1)))
        v, omega = self.velocities(t, y)
        moving = np.linalg.norm(v, axis=-1) + np.linalg.norm(omega, axis=-1)
        rate = np.where(rate > 1e-12 * moving, rate, moving)
        return np.where(rate > 0.0, rate, 1.0)

    def mean_rate(self, t: float, y: Array, horizon: float) -> Array:
        """`time_rate` (n,), in polynomial flows that change its mean until `horizon` later."""
        asked = t, y.tobytes(), horizon
        if self._mean_rate[0] != asked:
            rates = None
            with suppress(FlowError):  # told when the run comes to it
                if self.changing is not None:
                    sizes = np.linalg.norm(self._gradients(y, t + horizon * _SHARES), axis=(-2, -1))
                    known = sizes > 0.0
                    whole = sizes if known.all() else np.where(known, sizes, self.time_rate(t, y))
                    rates = np.mean(whole, axis=0)
            rates = self.time_rate(t, y) if rates is None else rates
            self._mean_rate = asked, rates
        return self._mean_rate[1]

    def _gradients(self, y: Array, t: Array) -> Array:
        """Velocity gradients (T, n, 3, 3) of polynomial flows at the centres, at instants (T,)."""
        found = np.empty((len(t), self.n_lanes, 3, 3))
        for flow, lanes in self._flows.groups():
            found[:, lanes] = flow.gradients(y[lanes, POSITION], t)
        return found

    def _flow_gradient(self, t: float, y: Array) -> Array:
        """Velocity gradient at the centres, (n, 3, 3); of the free velocity with a provider."""
        if self._table is not None:
            gradient = np.empty((self.n_lanes, 3, 3))
            for flow, lanes in self._flows.groups():
                gradient[lanes] = flow.gradient(y[lanes, POSITION], t)
            return gradient
        return self._motion_slopes(t, np.ascontiguousarray(y.T), 3)[:, TRANSLATION]


def _key_of_flow(flow: Any) -> Any:
    """What tells apart the flows of a block: the numbers of a polynomial, or the object."""
    return pack_flow(flow).tobytes() if isinstance(flow, PolynomialFlow) else id(flow)
