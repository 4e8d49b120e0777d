"""Bodies of a block: what they are made of, what acts on them, and the pieces of their equations.

The pieces are put together for providers and constraints, and for what is reported of a motion.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qbxstokes.flows.polynomial import PolynomialFlow
from qbxstokes.geometry import rotation
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.motion import kernels, law
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
from qbxstokes.motion.providers import ForceTorque, FreeMotion

if TYPE_CHECKING:
    from qbxstokes.bie.functional import BodyModel

Array = NDArray[np.float64]
Evaluation = Literal["auto", "plain", "compiled"]
Inertia = Literal["both", "translation", "rotation"]

_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
_TRIPLES = (
    *((0, 0, 0), (0, 0, 1), (0, 0, 2), (0, 1, 1), (0, 1, 2)),
    *((0, 2, 2), (1, 1, 1), (1, 1, 2), (1, 2, 2), (2, 2, 2)),
)


class Pieces:
    """Free motion, drag and loads of the bodies of a block, of which their rates are made.

    The arguments are those of `RigidBodyEquations`.
    """

    def __init__(
        self,
        model: BodyModel,
        flow: PolynomialFlow | FreeMotion,
        stokes_number: ArrayLike = 0.0,
        n_lanes: int = 1,
        loads: Loads | None = None,
        constraints: Constraints | None = None,
        evaluation: Evaluation = "auto",
        inertia: Inertia = "both",
    ) -> None:
        """Precompute rates and tables.

        Raises ValueError for mixed or negative Stokes numbers, and for bodies with mass, loads or
        constraints whose model was formed without the resistance.
        """
        self.model, self.n_lanes = model, n_lanes
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

        self._force_free = self.massless and loads is None and self.constraints.free
        # Force-free bodies read none of what follows from the resistance.
        numbers = (math.nan,) * 4 if self._force_free else vars(model.resistance).values()
        self._resistance = tuple(numbers)
        self._mobility = tuple(1.0 / value for value in self._resistance)
        spheroid = Spheroid(model.aspect_ratio)
        j1, _, j3 = (float(value) for value in spheroid.inertia)
        self._gyration = (j3 - j1) / j1
        masses = np.array([spheroid.volume, spheroid.volume, j1, j3])
        with np.errstate(divide="ignore"):
            self._rates: Array = np.outer(np.array(self._resistance) / masses, 1.0) / (
                self.stokes_number
            )
        if self._follow is not None:
            move, turn = self._follow
            self._rates *= np.array([[1.0 - move], [1.0 - move], [1.0 - turn], [1.0 - turn]])

        self._table: Array | None = None
        self._provider: FreeMotion | None = None
        if isinstance(flow, PolynomialFlow):
            self._table = pack_table(flow, model)
            self._flow, self._law = law.tables(self._table.tolist())
        else:
            self._provider = flow
        self._polynomial = flow if isinstance(flow, PolynomialFlow) else None
        self._loads = None if loads is None else LoadRows(loads, n_lanes)
        self._given_loads = loads

    @property
    def steady(self) -> bool:
        """Whether loads and constraints are constant in time (the flow may still change)."""
        return self._steady_loads and self.constraints.steady

    @property
    def _steady_loads(self) -> bool:
        return self._loads is None or self._loads.steady

    @property
    def relaxation_rates(self) -> Array:
        """R/(St inertia), (4, n): translation and rotation, transverse and axial; inf for St = 0.

        Zero for a part whose inertia is switched off.

        The inverses are the time scales on which a body takes up the motion of the flow.
        """
        return self._rates

    def velocities(self, t: float, y: Array) -> tuple[Array, Array]:
        """V and Omega (space frame), each (n_lanes, 3), in the states y (n_lanes, n_state)."""
        motion = np.zeros((self.n_lanes, 6))
        if self.massless or self._follow is not None:
            driven = self._driven(t, y.T)
            motion = np.stack([np.broadcast_to(u, (self.n_lanes,)) for u in driven], axis=-1)
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

    def _vectors(self, vectors: Vectors, t: float) -> Array:
        value = vectors(t) if callable(vectors) else vectors
        return np.broadcast_to(np.asarray(value, dtype=np.float64), (self.n_lanes, 3))

    def _free(self, t: float, rows: Any) -> Any:
        """Free motion, six numbers or rows."""
        if self._table is not None:
            d = kernels.symmetry_axis(*rows[ORIENTATION])
            arguments: list[Any] = [*rows[POSITION], *d, self._flow, self._law]
            return law.free_motion(*arguments)
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
        pushed = kernels.driven_motion(
            tuple(self._rows(np.concatenate([v, omega], axis=1).T)),
            kernels.body_axes(*rows[ORIENTATION]),
            self._mobility,
            self._rows(np.concatenate([force.T, zero, torque.T, zero])),
        )
        return pushed

    def _driven(self, t: float, y: Array) -> Any:
        """Motion without net force and torque, loads included, in states y (n_state, n)."""
        rows = self._rows(y)
        motion = self._free(t, rows)
        if self._loads is None:
            return motion
        axes = kernels.body_axes(*rows[ORIENTATION])
        return kernels.driven_motion(motion, axes, self._mobility, self._rows(self._loads.at(t)))

    def _rate(self, t: float, rows: Any, motion: Any) -> Any:
        """dy/dt from the motion that drag pulls to, with loads and constraints."""
        axes = kernels.body_axes(*rows[ORIENTATION])
        if self._loads is not None:
            loads = self._rows(self._loads.at(t))
            motion = kernels.driven_motion(motion, axes, self._mobility, loads)
        velocity, spin = self.constraints.velocity, self.constraints.angular_velocity
        v = None if velocity is None else tuple(self._rows(self._vectors(velocity, t).T))
        omega = None if spin is None else tuple(self._rows(self._vectors(spin, t).T))
        if self.massless:
            turn = omega if omega is not None else motion[ROTATION]
            move = v if v is not None else motion[TRANSLATION]
            return (*move, *kernels.quaternion_rate_space(*rows[ORIENTATION], *turn))
        if self._follow is not None:
            moves, turns = self._follow
            v = tuple(motion[TRANSLATION]) if moves and v is None else v
            omega = tuple(motion[ROTATION]) if turns and omega is None else omega
        coefficients: list[Any] = [motion, axes, self._rows(self._rates), self._gyration]
        pull = kernels.accelerations(*rows[RATES], *coefficients)
        still = (0.0, 0.0, 0.0)
        return (
            *(rows[VELOCITY] if v is None else v),
            *(
                kernels.quaternion_rate_body(*rows[ORIENTATION], *rows[SPIN])
                if omega is None
                else kernels.quaternion_rate_space(*rows[ORIENTATION], *omega)
            ),
            *(pull[TRANSLATION] if v is None else still),
            *(pull[ROTATION] if omega is None else still),
        )

    def _motion_slopes(self, t: float, y: Array) -> Array:
        """d(U, Omega)/d(x, q) of a provider, (n, 6, 7), by central differences in one call."""
        assert self._provider is not None
        step = 1e-5
        states = y[:N_MASSLESS].T
        moved = np.repeat(states[None], 14, axis=0)
        for j in range(7):
            moved[2 * j, :, j] += step
            moved[2 * j + 1, :, j] -= step
        flat = moved.reshape(-1, 7)
        u, omega = self._provider.free_motion(
            t, flat[:, POSITION], rotation.normalize(flat[:, ORIENTATION])
        )
        motion = np.concatenate([u, omega], axis=1).reshape(7, 2, self.n_lanes, 6)
        return np.asarray(np.moveaxis((motion[:, 0] - motion[:, 1]) / (2.0 * step), 0, -1))


def pack_table(flow: PolynomialFlow, model: BodyModel) -> Array:
    """Flow and Faxen coefficients as the kernels' table, (74,): see `law.tables`."""
    second = [flow.hessian[i, j, k] for i in range(3) for j, k in _PAIRS]
    third = [flow.third[i, j, k, m] for i in range(3) for j, k, m in _TRIPLES]
    faxen = model.faxen
    return np.concatenate(
        [
            [max(flow.degree or 0, 1)],
            flow.value,
            flow.gradient_tensor.ravel(),
            second,
            third,
            [faxen.linear],
            faxen.quadratic,
            faxen.cubic,
            flow.origin,
        ]
    )
