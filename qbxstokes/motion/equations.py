"""Equations of motion of a block of rigid spheroids that share one body model and one flow.

State of a body: (x, q), 7 numbers, for St = 0; (x, q, V, W), 13 numbers, for St > 0, with x and
V in the space frame, q body to space and W the angular velocity in the body frame. Arrays of states
are (n_bodies, n_state) for the user and (n_state, n_bodies) in `rates` and `jacobian`, which is
how the kernels sweep them.

The hydrodynamics enter through the free motion (U, Omega), the one without force and torque. Drag
is linear, F = R_t (U - V), so that loads only shift the motion that the drag pulls to:

    St = 0:  dx/dt = U + R_t^-1 F_ext,  dq/dt = (0, Omega + R_r^-1 M_ext) * q / 2
    St > 0:  dx/dt = V,  dq/dt = q * (0, W) / 2,  St Theta dV/dt = R_t (U + R_t^-1 F_ext - V),
             St J dW/dt = R_r (Omega + R_r^-1 M_ext - W) - St W x (J W)      (body frame)

(Bagge 2015, eqs. 3.26-3.29.) For k > 0 with this symmetry translation and rotation do not couple
through drag, so that each may be prescribed while the other stays free. Likewise the inertia of
either may be switched off for St > 0: that part then moves as for St = 0, and its V or W stays
zero, unread.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qbxstokes.flows.polynomial import PolynomialFlow
from qbxstokes.geometry import rotation
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.motion import kernels
from qbxstokes.motion.tracing import specialise

if TYPE_CHECKING:
    from qbxstokes.bie.functional import BodyModel

Array = NDArray[np.float64]
Vectors = ArrayLike | Callable[[float], ArrayLike]
Evaluation = Literal["auto", "plain", "compiled"]
Inertia = Literal["both", "translation", "rotation"]

N_MASSLESS = 7
N_INERTIAL = 13

# From this size of the block, or this number of right-hand sides of a single body, the compiled
# kernels repay their import (0.4 s, and some seconds of compilation once on a machine, against
# some 6 us a right-hand side).
COMPILED_BLOCK = 8
COMPILED_EVALUATIONS = 500_000

_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
_TRIPLES = (
    *((0, 0, 0), (0, 0, 1), (0, 0, 2), (0, 1, 1), (0, 1, 2)),
    *((0, 2, 2), (1, 1, 1), (1, 1, 2), (1, 2, 2), (2, 2, 2)),
)


@runtime_checkable
class FreeMotion(Protocol):
    """Anything that knows the free motion of bodies at (x, q), in the space frame."""

    def free_motion(self, t: float, x: Array, q: Array) -> tuple[Array, Array]:
        """U and Omega, each (n, 3), at centres x (n, 3) and unit quaternions q (n, 4)."""
        ...


@runtime_checkable
class ForceTorque(FreeMotion, Protocol):
    """A free motion that also finds force and torque directly (the check of the shortcut)."""

    def force_torque(
        self, t: float, x: Array, q: Array, v: Array, omega: Array
    ) -> tuple[Array, Array]:
        """Hydrodynamic force and torque on the bodies, each (n, 3), in the space frame."""
        ...


@dataclass(frozen=True)
class Loads:
    """External force and torque on the bodies: arrays (3,) or (n, 3), or functions of time.

    force and torque are given in the space frame; body_force and body_torque in the body frame,
    in which they stay fixed. Units mu c^2/tau and mu c^3/tau.
    """

    force: Vectors = (0.0, 0.0, 0.0)
    torque: Vectors = (0.0, 0.0, 0.0)
    body_force: Vectors = (0.0, 0.0, 0.0)
    body_torque: Vectors = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Constraints:
    """Prescribed parts of the motion, None where it is free.

    velocity and angular_velocity are given in the space frame as arrays (3,) or (n, 3) or
    functions of time; zero locks. For St > 0 the prescribed part of the state keeps its initial
    value and is not read.
    """

    velocity: Vectors | None = None
    angular_velocity: Vectors | None = None

    @classmethod
    def held(cls) -> Constraints:
        """Neither translates nor rotates."""
        return cls(velocity=(0.0, 0.0, 0.0), angular_velocity=(0.0, 0.0, 0.0))


@dataclass(frozen=True)
class BlockConstants:
    """What the compiled loop over a block needs besides the states.

    table (74,): see `kernels.tables`. mobility (4,). loads (12, n), or None. rates (4, n), gyration
    and follow (2,) or None, of inertial bodies alone: rates is None for massless ones. still:
    centres (3, n) that stay, or None (see `motion.centred`).
    """

    degree: int
    table: Array
    mobility: Array
    loads: Array | None
    rates: Array | None
    gyration: float
    follow: tuple[float, float] | None
    still: Array | None = None


class RigidBodyEquations:
    """dy/dt and its Jacobian for `n_bodies` bodies; see the module's text for the equations.

    model: the body model that all share. flow: a polynomial flow (degree <= 3), whose free motion
    follows from the model's Faxen coefficients, or any provider with `free_motion`; a provider
    with `force_torque` is asked for the force itself when St > 0. stokes_number: a number or (n,),
    all zero or all positive. inertia: of translation and rotation "both", or of one of them alone
    (St > 0); the other follows the flow.
    """

    def __init__(
        self,
        model: BodyModel,
        flow: PolynomialFlow | FreeMotion,
        stokes_number: ArrayLike = 0.0,
        n_bodies: int = 1,
        loads: Loads | None = None,
        constraints: Constraints | None = None,
        evaluation: Evaluation = "auto",
        inertia: Inertia = "both",
    ) -> None:
        """Precompute rates and tables.

        Raises ValueError for mixed or negative Stokes numbers, and for bodies with mass, loads or
        constraints whose model was formed without the resistance.
        """
        self.model, self.n_bodies = model, n_bodies
        self.stokes_number: Array = np.broadcast_to(
            np.asarray(stokes_number, dtype=np.float64), (n_bodies,)
        )
        self.massless = not np.any(self.stokes_number)
        if not self.massless and not np.all(self.stokes_number > 0.0):
            raise ValueError("Stokes numbers of one block must be all zero or all positive")
        self.n_state = N_MASSLESS if self.massless else N_INERTIAL
        self.constraints = constraints or Constraints()
        self.evaluation: Evaluation = evaluation
        self.inertia: Inertia = inertia
        self._follow: tuple[float, float] | None = None
        if inertia != "both" and not self.massless:
            self._follow = (float(inertia == "rotation"), float(inertia == "translation"))

        self._force_free = self.massless and loads is None and self._unconstrained
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
            self._flow, self._law = kernels.tables(self._table.tolist())
        else:
            self._provider = flow
        self._polynomial = flow if isinstance(flow, PolynomialFlow) else None
        self._loads = loads
        self._load_rows: Array = np.zeros((12, n_bodies))
        self._timed_loads: list[tuple[int, Callable[[float], ArrayLike]]] = []
        if loads is not None:
            for place, vectors in enumerate(_load_fields(loads)):
                if callable(vectors):
                    self._timed_loads.append((place, vectors))
                else:
                    self._fill_load(place, vectors)
        self._steady_loads = not self._timed_loads

    def repeated(self, count: int) -> RigidBodyEquations:
        """The equations of `count` times the same bodies: many instants as many bodies.

        Only where nothing depends on time (`steady`).
        """

        def tiled(vectors: Any) -> Any:
            if vectors is None or callable(vectors) or np.ndim(vectors) < 2:
                return vectors
            return np.tile(vectors, (count, 1))

        loads, bound = self._loads, self.constraints
        return RigidBodyEquations(
            self.model,
            self._polynomial if self._polynomial is not None else self._provider,  # type: ignore[arg-type]
            np.tile(self.stokes_number, count),
            self.n_bodies * count,
            None if loads is None else Loads(*(tiled(field) for field in vars(loads).values())),
            Constraints(tiled(bound.velocity), tiled(bound.angular_velocity)),
            self.evaluation,
            self.inertia,
        )

    @property
    def steady(self) -> bool:
        """Whether loads and constraints are constant in time (the flow may still change)."""
        bound = self.constraints
        return self._steady_loads and not (
            callable(bound.velocity) or callable(bound.angular_velocity)
        )

    # -- the right-hand side ----------------------------------------------------------------

    @property
    def relaxation_rates(self) -> Array:
        """R/(St inertia), (4, n): translation and rotation, transverse and axial; inf for St = 0.

        Zero for a part whose inertia is switched off.

        The inverses are the time scales on which a body takes up the motion of the flow.
        """
        return self._rates

    @property
    def stiffness(self) -> Array:
        """Fastest relaxation rate of each body, (n,); zero for St = 0."""
        return np.zeros(self.n_bodies) if self.massless else self._rates.max(axis=0)

    def scales(self, t: float, y: Array) -> Array:
        """Size of each component of the states y, (n_bodies, n_state), for error control.

        1 for lengths (c) and for the quaternion; the rate at which the flow turns and strains for
        velocities, or that of the motion itself where the flow does neither.
        """
        scales = np.ones((self.n_bodies, self.n_state))
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
        k = self.model.aspect_ratio
        slenderness = max(k, 1.0 / k)
        turns = float(np.max(self.time_rate(t, y))) * horizon / (2.0 * np.pi * slenderness)
        return slenderness**2 * max(1.0, turns)

    def time_rate(self, t: float, y: Array) -> Array:
        """Rate (n,) at which things change: |grad U|, the shear rate in a shear."""
        gradient = self._flow_gradient(t, y)
        rate = np.sqrt(np.sum(gradient * gradient, axis=(-2, -1)))
        v, omega = self.velocities(t, y)
        moving = np.linalg.norm(v, axis=-1) + np.linalg.norm(omega, axis=-1)
        rate = np.where(rate > 1e-12 * moving, rate, moving)
        return np.where(rate > 0.0, rate, 1.0)

    def compiled(self, evaluations: float = 0.0) -> bool:
        """Whether the compiled kernels serve, given how many right-hand sides are to come."""
        possible = self._table is not None and self._unconstrained
        if self.evaluation != "auto":
            return possible and self.evaluation == "compiled"
        return possible and (self.n_bodies >= COMPILED_BLOCK or evaluations >= COMPILED_EVALUATIONS)

    def rate_function(
        self, evaluations: float = 0.0, still: Array | None = None
    ) -> Callable[[float, Array, Array], None]:
        """The function (t, y, out) that writes dy/dt for y (n_state, n_bodies), read-only.

        still: centres that stay, where y is to be without them (`motion.centred`, compiled alone).
        """
        return self._compiled("block", (still,)) if self.compiled(evaluations) else self.rates

    def jacobian_function(self, evaluations: float = 0.0) -> Callable[[float, Array, Array], None]:
        """The function (t, y, out) that writes the blocks (n_bodies, n_state, n_state)."""
        return self._compiled("jacobian_block") if self.compiled(evaluations) else self.jacobian

    def block_constants(self, evaluations: float = 0.0) -> BlockConstants | None:
        """All that the compiled loop takes, where it serves and nothing of it depends on time."""
        if not (self._steady_loads and self.compiled(evaluations)):
            return None
        return self._block()

    def at_rest(self, y: Array) -> bool:
        """Whether all centres stay where they are in the states y (n_bodies, n_state), for good.

        The free velocity of a body vanishes at the centre of a flow that is odd about it, however
        the body lies, since the body is its own image there. What is left are forces and a velocity
        at the start.
        """
        if self._polynomial is None or not self._unconstrained:
            return False
        pushed = any(place < 2 for place, _ in self._timed_loads) or np.any(self._load_rows[:6])
        moving = not self.massless and np.any(y[:, 7:10])
        return not (pushed or moving) and bool(np.all(self._polynomial.odd_about(y[:, :3])))

    def integrated(self, states: Array) -> Array:
        """The part of states (n_bodies, n_state) that is integrated: all."""
        return states

    def completed(self, part: Array) -> Array:
        """The states of what is integrated, as a copy."""
        return np.array(part)

    def _block(self) -> BlockConstants:
        assert self._table is not None
        return BlockConstants(
            int(self._table[0]),
            self._table,
            np.array(self._mobility),
            None if self._loads is None else self._load_rows,
            None if self.massless else self._rates,
            self._gyration,
            self._follow,
        )

    def _compiled(
        self, loop: str, more: tuple[Array | None, ...] = ()
    ) -> Callable[[float, Array, Array], None]:
        """A compiled loop over the block with its constant arguments, the last of them `more`."""
        from qbxstokes.motion.compiled import loops

        block = self._block()
        kind = "massless" if self.massless else "inertial"
        run = loops(block.degree)[f"{kind}_{loop}"]
        inertia = () if self.massless else (block.rates, block.gyration, block.follow)
        table, mobility = block.table, block.mobility

        def function(t: float, y: Array, out: Array) -> None:
            loads = None if self._loads is None else self._loads_at(t)
            run(y, out, table, mobility, loads, *inertia, *more)

        return function

    def rates(self, t: float, y: Array, out: Array) -> None:
        """Write dy/dt, (n_state, n_bodies), by the plain kernels."""
        for row, value in zip(out, self.rate_of_rows(t, self._rows(y)), strict=True):
            row[:] = value

    @property
    def rate_of_rows(self) -> Callable[[float, Any], Any]:
        """dy/dt as a tuple, (t, rows) -> n_state rows, plain or complex.

        rows: the numbers of a single body, or rows (n_bodies,). Looked up once for many calls; kept
        in no attribute, where a bound method would hold the provider's solvers in a cycle.
        """
        return self._pieces if self._kernel is None else self._kernel

    def jacobian(self, t: float, y: Array, out: Array) -> None:
        """Write the Jacobian, (n_bodies, n_state, n_state), by the plain kernels.

        Exact to rounding by complex steps for polynomial flows; for a provider its free motion is
        differenced (central, relative error about 1e-10) and the rest is exact.
        """
        rows = list(self._rows(y))
        step = kernels.STEP * 1.0j
        motion = self._motion(t, rows)
        provided = self._table is None
        columns = []
        for j in range(self.n_state):
            moved = [*rows[:j], rows[j] + step, *rows[j + 1 :]]
            if provided or j >= N_MASSLESS:  # the free motion does not depend on velocities
                columns.append(self._rate(t, moved, motion))
            else:
                columns.append(self.rate_of_rows(t, moved))
        out[:] = self._slopes(columns)
        if provided:
            columns = []
            for j in range(6):
                local = (*motion[:j], motion[j] + step, *motion[j + 1 :])
                columns.append(self._rate(t, rows, local))
            out[:, :, :N_MASSLESS] += self._slopes(columns) @ self._motion_slopes(t, y)

    # -- what is reported -------------------------------------------------------------------

    def initial_state(
        self,
        position: ArrayLike,
        quaternion: ArrayLike,
        velocity: ArrayLike | None = None,
        angular_velocity: ArrayLike | None = None,
        t: float = 0.0,
    ) -> Array:
        """States (n_bodies, n_state) from positions, quaternions and velocities (space frame).

        A velocity that is None follows the flow (and the loads): no net force, no net torque.
        """
        n = self.n_bodies
        y = np.empty((n, self.n_state))
        y[:, 0:3] = np.asarray(position, dtype=np.float64)
        y[:, 3:7] = rotation.normalize(np.broadcast_to(quaternion, (n, 4)))
        if not self.massless:
            y[:, 7:] = 0.0
            free = np.stack([np.broadcast_to(u, (n,)) for u in self._driven(t, y.T)], axis=-1)
            v, omega = np.array(free[:, :3]), np.array(free[:, 3:])
            if velocity is not None:
                v[:] = np.asarray(velocity, dtype=np.float64)
            if angular_velocity is not None:
                omega[:] = np.asarray(angular_velocity, dtype=np.float64)
            y[:, 7:10] = v
            y[:, 10:13] = rotation.to_body(y[:, 3:7], omega)
            if self._follow is not None:
                move, turn = self._follow
                y[:, 7:10] *= 1.0 - move
                y[:, 10:13] *= 1.0 - turn
        return y

    def velocities(self, t: float, y: Array) -> tuple[Array, Array]:
        """V and Omega (space frame), each (n_bodies, 3), in the states y (n_bodies, n_state)."""
        motion = np.zeros((self.n_bodies, 6))
        if self.massless or self._follow is not None:
            driven = self._driven(t, y.T)
            motion = np.stack([np.broadcast_to(u, (self.n_bodies,)) for u in driven], axis=-1)
        v, omega = motion[:, :3], motion[:, 3:]
        if not self.massless:
            move, turn = self._follow or (0.0, 0.0)
            v = v if move else y[:, 7:10]
            if not turn:
                omega = rotation.to_space(rotation.normalize(y[:, 3:7]), y[:, 10:13])
        prescribed = self.constraints
        return (
            v if prescribed.velocity is None else self._vectors(prescribed.velocity, t),
            omega
            if prescribed.angular_velocity is None
            else self._vectors(prescribed.angular_velocity, t),
        )

    def force_torque(self, t: float, y: Array) -> tuple[Array, Array]:
        """Hydrodynamic force and torque ON the bodies (space frame), each (n_bodies, 3).

        F = R_t (U - V) and M = R_r (Omega - W); external loads are not part of them.
        """
        if self._force_free:
            return np.zeros((self.n_bodies, 3)), np.zeros((self.n_bodies, 3))
        q = rotation.normalize(y[:, 3:7])
        v, omega = self.velocities(t, y)
        if isinstance(self._provider, ForceTorque):
            return self._provider.force_torque(t, y[:, 0:3], q, v, omega)
        free = self._free(t, self._rows(y.T))
        motion = np.stack([np.broadcast_to(u, (self.n_bodies,)) for u in free], axis=-1)
        d = rotation.axis(q)
        rt, ra, st, sa = self._resistance

        def drag(slip: Array, transverse: float, axial: float) -> Array:
            along = np.sum(slip * d, axis=-1, keepdims=True) * d
            return np.asarray(transverse * slip + (axial - transverse) * along)

        return drag(motion[:, :3] - v, rt, ra), drag(motion[:, 3:] - omega, st, sa)

    # -- pieces -----------------------------------------------------------------------------

    @property
    def _unconstrained(self) -> bool:
        return self.constraints.velocity is None and self.constraints.angular_velocity is None

    def _rows(self, y: Array) -> Any:
        """Numbers of the one body (plain arithmetic is fastest on floats), or rows."""
        return y[:, 0].tolist() if self.n_bodies == 1 else y

    def _vectors(self, vectors: Vectors, t: float) -> Array:
        value = vectors(t) if callable(vectors) else vectors
        return np.broadcast_to(np.asarray(value, dtype=np.float64), (self.n_bodies, 3))

    def _fill_load(self, place: int, vectors: ArrayLike) -> None:
        values = np.asarray(vectors, dtype=np.float64)
        rows = values.T if values.ndim == 2 else values[:, None]
        self._load_rows[3 * place : 3 * place + 3] = rows

    def _loads_at(self, t: float) -> Array:
        for place, vectors in self._timed_loads:
            self._fill_load(place, vectors(t))
        return self._load_rows

    @cached_property
    def _kernel(self) -> Callable[..., Any] | None:
        """dy/dt by the kernels in one piece: for polynomial flows without constraints.

        Numbers that differ from body to body, or in time, are handed over with the states.
        """
        if self._table is None or not self._unconstrained:
            return None
        loaded, several = self._loads is not None, self.n_bodies > 1
        handed = loaded and (several or not self._steady_loads)
        loads = self._rows(self._load_rows) if loaded and not handed else None
        rates = self._rows(self._rates)
        n_rates = 4 if several and not self.massless else 0

        def equations(rows: Any, more: Any) -> Any:
            arguments = [*rows, self._flow, self._law, self._mobility]
            arguments.append(tuple(more[:12]) if handed else loads)
            if self.massless:
                return kernels.massless(*arguments)
            arguments += [more[-4:] if n_rates else rates, self._gyration, self._follow]
            return kernels.inertial(*arguments)

        kernel = specialise(equations, self.n_state, 12 * handed + n_rates)
        if not (handed or n_rates):
            return kernel

        def with_numbers(t: float, rows: Any) -> Any:
            forces = self._rows(self._loads_at(t)) if handed else ()
            return kernel(t, rows, (*forces, *(rates if n_rates else ())))

        return with_numbers

    def _pieces(self, t: float, rows: Any) -> Any:
        """dy/dt put together from the kernels, for providers and constraints."""
        return self._rate(t, rows, self._motion(t, rows))

    def _free(self, t: float, rows: Any) -> Any:
        """Free motion, six numbers or rows."""
        if self._table is not None:
            d = kernels.symmetry_axis(*rows[3:7])
            arguments: list[Any] = [*rows[0:3], *d, self._flow, self._law]
            return kernels.free_motion(*arguments)
        assert self._provider is not None
        y = np.stack([np.atleast_1d(row) for row in rows[0:7]], axis=-1)
        u, omega = self._provider.free_motion(t, y[:, :3], rotation.normalize(y[:, 3:]))
        return tuple(self._rows(np.concatenate([u, omega], axis=1).T))

    def _motion(self, t: float, rows: Any) -> Any:
        """What replaces the free motion in `_rate`, without the loads.

        With a provider of forces it is V + R^-1 F, which makes the drag formula return F.
        """
        if self.massless or not isinstance(self._provider, ForceTorque):
            return self._free(t, rows)
        y = np.stack([np.atleast_1d(row) for row in rows], axis=-1)
        q = rotation.normalize(y[:, 3:7])
        v, omega = self.velocities(t, y)
        force, torque = self._provider.force_torque(t, y[:, 0:3], q, v, omega)
        zero = np.zeros((3, self.n_bodies))
        pushed = kernels.driven_motion(
            tuple(self._rows(np.concatenate([v, omega], axis=1).T)),
            kernels.body_axes(*rows[3:7]),
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
        axes = kernels.body_axes(*rows[3:7])
        return kernels.driven_motion(motion, axes, self._mobility, self._rows(self._loads_at(t)))

    def _rate(self, t: float, rows: Any, motion: Any) -> Any:
        """dy/dt from the motion that drag pulls to, with loads and constraints."""
        axes = kernels.body_axes(*rows[3:7])
        if self._loads is not None:
            loads = self._rows(self._loads_at(t))
            motion = kernels.driven_motion(motion, axes, self._mobility, loads)
        velocity, spin = self.constraints.velocity, self.constraints.angular_velocity
        v = None if velocity is None else tuple(self._rows(self._vectors(velocity, t).T))
        omega = None if spin is None else tuple(self._rows(self._vectors(spin, t).T))
        if self.massless:
            turn = omega if omega is not None else motion[3:6]
            move = v if v is not None else motion[0:3]
            return (*move, *kernels.quaternion_rate_space(*rows[3:7], *turn))
        if self._follow is not None:
            moves, turns = self._follow
            v = tuple(motion[0:3]) if moves and v is None else v
            omega = tuple(motion[3:6]) if turns and omega is None else omega
        coefficients: list[Any] = [motion, axes, self._rows(self._rates), self._gyration]
        pull = kernels.accelerations(*rows[7:13], *coefficients)
        still = (0.0, 0.0, 0.0)
        return (
            *(rows[7:10] if v is None else v),
            *(
                kernels.quaternion_rate_body(*rows[3:7], *rows[10:13])
                if omega is None
                else kernels.quaternion_rate_space(*rows[3:7], *omega)
            ),
            *(pull[0:3] if v is None else still),
            *(pull[3:6] if omega is None else still),
        )

    def _slopes(self, columns: list[Any]) -> Array:
        """(n, n_state, columns) from the values of complex steps, columns first."""
        if self.n_bodies > 1:
            columns = [np.broadcast_arrays(*column) for column in columns]
        values = np.array(columns).imag.reshape(len(columns), self.n_state, self.n_bodies)
        return np.asarray(np.moveaxis(values, -1, 0).swapaxes(1, 2) / kernels.STEP)

    def _flow_gradient(self, t: float, y: Array) -> Array:
        """Velocity gradient at the centres, (n, 3, 3); of the free velocity with a provider."""
        if self._polynomial is not None:
            return self._polynomial.gradient(y[:, 0:3], t)
        return self._motion_slopes(t, np.ascontiguousarray(y.T))[:, 0:3, 0:3]

    def _motion_slopes(self, t: float, y: Array) -> Array:
        """d(U, Omega)/d(x, q) of a provider, (n, 6, 7), by central differences in one call."""
        assert self._provider is not None
        step = 1e-5
        states = y[:7].T
        moved = np.repeat(states[None], 14, axis=0)
        for j in range(7):
            moved[2 * j, :, j] += step
            moved[2 * j + 1, :, j] -= step
        flat = moved.reshape(-1, 7)
        u, omega = self._provider.free_motion(t, flat[:, :3], rotation.normalize(flat[:, 3:]))
        motion = np.concatenate([u, omega], axis=1).reshape(7, 2, self.n_bodies, 6)
        return np.asarray(np.moveaxis((motion[:, 0] - motion[:, 1]) / (2.0 * step), 0, -1))


def _load_fields(loads: Loads) -> tuple[Vectors, Vectors, Vectors, Vectors]:
    """The loads in the order of the kernels."""
    return loads.force, loads.body_force, loads.torque, loads.body_torque


def pack_table(flow: PolynomialFlow, model: BodyModel) -> Array:
    """Flow and Faxen coefficients as the kernels' table, (74,): see `kernels.tables`."""
    second = [flow.hessian[i, j, k] for i in range(3) for j, k in _PAIRS]
    third = [flow.third[i, j, k, m] for i in range(3) for j, k, m in _TRIPLES]
    law = model.faxen
    return np.concatenate(
        [
            [max(flow.degree or 0, 1)],
            flow.value,
            flow.gradient_tensor.ravel(),
            second,
            third,
            [law.linear],
            law.quadratic,
            law.cubic,
            flow.origin,
        ]
    )
