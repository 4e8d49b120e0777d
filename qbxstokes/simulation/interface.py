"""The program from Python: bodies, flows and motions with NumPy arrays in and out.

>>> import numpy as np
>>> import qbxstokes as qs
>>> rod = qs.Body(0.2)
>>> shear = qs.flow("shear", rate=1.0)
>>> velocity, spin = rod.free_motion(shear, position=[0, 1, 0], orientation=[0, 1, 0])
>>> np.round(velocity, 9)
array([1., 0., 0.])
>>> float(np.round(spin[2], 9))  # the rod across the flow: -1/(1 + k^2)
-0.961538462

Nothing here needs MPI, a case file or a terminal; only `Body.integrate` loads PETSc.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qbxstokes.bie.accuracy import AccurateBody, accurate_body, choose_scheme, resolving_nodes
from qbxstokes.bie.field import (
    FlowAround,
    mobility_disturbance,
    resistance_disturbance,
    resolving_grid,
)
from qbxstokes.bie.functional import BodyModel
from qbxstokes.bie.operators import surface_operators
from qbxstokes.bie.providers import AdaptiveGridMotion, MonitoredGridMotion
from qbxstokes.errors import CaseError
from qbxstokes.flows import Flow, build_flow
from qbxstokes.geometry import rotation
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.motion.equations import Loads, RigidBodyEquations

Array = NDArray[np.float64]


def flow(type: str, **keys: Any) -> Flow:
    """A background flow by the name and the keys of the case file's section `flow`.

    >>> import qbxstokes as qs
    >>> qs.flow("paraboloid", curvature=0.5).velocity([0.0, 2.0, 0.0]).tolist()
    [2.0, 0.0, 0.0]

    Flows add and scale: `qs.flow("shear") + 0.1 * qs.flow("stokeslet", strength=[1, 0, 0],
    position=[0, 4, 0])`. Raises FlowError for unknown names and impossible values.
    """
    return build_flow({"type": type, **keys})


@dataclass(frozen=True)
class Motion:
    """A motion sampled at times (T,): arrays (T, ...) named as in result files.

    orientation: quaternions (T, 4); axis (T, 3); velocity, angular_velocity, force, torque (T, 3)
    in the space frame; steps: those the integrator took.
    """

    time: Array
    position: Array
    orientation: Array
    velocity: Array
    angular_velocity: Array
    force: Array
    torque: Array
    steps: int

    @property
    def axis(self) -> Array:
        """Symmetry axis D3 (T, 3)."""
        return rotation.axis(self.orientation)


@dataclass(frozen=True)
class Body:
    """A rigid spheroid of semi-axes (k, k, 1) and its hydrodynamics to a relative tolerance.

    The integral equation is solved when first needed (0.02 to 0.5 s, and once a machine about ten
    seconds of compilation). Everything is nondimensional: lengths in c, forces in mu c^2/tau.
    Raises ConvergenceError where rounding forbids the tolerance (k below about 1/100 at 1e-10).
    """

    aspect_ratio: float
    tolerance: float = 1e-10

    def __post_init__(self) -> None:
        Spheroid(self.aspect_ratio)

    @property
    def spheroid(self) -> Spheroid:
        """Its geometry."""
        return Spheroid(self.aspect_ratio)

    @cached_property
    def hydrodynamics(self) -> AccurateBody:
        """Body model, functional, discretisation and error estimate."""
        return accurate_body(self.spheroid, self.tolerance)

    @property
    def model(self) -> BodyModel:
        """The numbers that describe the body in every Stokes flow."""
        return self.hydrodynamics.model

    @property
    def error_estimate(self) -> float:
        """Estimated relative error of `model`, made without closed forms."""
        return self.model.error_estimate

    @property
    def resistance(self) -> Array:
        """Matrix R (6, 6), body frame: (force, torque) ON the body = -R (V, Omega).

        >>> import numpy as np, qbxstokes as qs
        >>> np.round(np.diag(qs.Body(1.0).resistance) / np.pi, 9)
        array([6., 6., 6., 8., 8., 8.])
        """
        r = self.model.resistance
        across, about = r.translation_transverse, r.rotation_transverse
        return np.diag([across, across, r.translation_axial, about, about, r.rotation_axial])

    @property
    def mobility(self) -> Array:
        """Matrix M (6, 6), body frame: (V, Omega) = M (force, torque) from outside."""
        return np.diag(1.0 / np.diag(self.resistance))

    def free_motion(
        self,
        flow: Flow,
        position: ArrayLike = (0.0, 0.0, 0.0),
        orientation: ArrayLike = (0.0, 0.0, 1.0),
        t: float = 0.0,
    ) -> tuple[Array, Array]:
        """Velocity and angular velocity (..., 3) of the body without force or torque.

        position (..., 3); orientation: axes (..., 3) or quaternions (..., 4); they broadcast.
        """
        x, q, shape = _places(position, orientation)
        equations = self.equations(flow, x[0], 0.0, len(x))
        u, omega = equations.velocities(t, equations.initial_state(x, q, t=t))
        return np.array(u).reshape(shape), np.array(omega).reshape(shape)

    def force_torque(
        self,
        flow: Flow,
        position: ArrayLike = (0.0, 0.0, 0.0),
        orientation: ArrayLike = (0.0, 0.0, 1.0),
        velocity: ArrayLike = (0.0, 0.0, 0.0),
        angular_velocity: ArrayLike = (0.0, 0.0, 0.0),
        t: float = 0.0,
    ) -> tuple[Array, Array]:
        """Force and torque (..., 3) of the fluid ON the body of given motion (space frame).

        >>> import numpy as np, qbxstokes as qs
        >>> force, _ = qs.Body(1.0).force_torque(qs.flow("uniform", velocity=[1, 0, 0]))
        >>> np.round(force / np.pi, 9)
        array([6., 0., 0.])
        """
        x, q, shape = _places(position, orientation)
        # With inertia the velocities are part of the state, whatever their value.
        equations = self.equations(flow, x[0], 1.0, len(x))
        state = equations.initial_state(x, q, velocity, angular_velocity, t)
        force, torque = equations.force_torque(t, state)
        return force.reshape(shape), torque.reshape(shape)

    def integrate(
        self,
        flow: Flow,
        times: ArrayLike,
        position: ArrayLike = (0.0, 0.0, 0.0),
        orientation: ArrayLike = (0.0, 0.0, 1.0),
        stokes_number: float = 0.0,
        velocity: ArrayLike | None = None,
        angular_velocity: ArrayLike | None = None,
        tolerance: float = 1e-10,
        loads: Loads | None = None,
    ) -> Motion:
        """The motion from t = 0, sampled at increasing times (T,), by PETSc TS.

        velocity, angular_velocity (space frame): at the start, None to follow the flow.
        tolerance: error accepted at the end. loads: external force and torque.

        >>> import numpy as np, qbxstokes as qs
        >>> times = np.linspace(0.0, 5.0 * np.pi, 5)  # a Jeffery period of k = 1/2
        >>> orbit = qs.Body(0.5).integrate(qs.flow("shear"), times, orientation=[0.6, 0, 0.8])
        >>> bool(np.allclose(orbit.axis[-1], [0.6, 0, 0.8]))
        True
        """
        from qbxstokes.petsc.stepper import integrate

        x, q, _ = _places(position, orientation)
        equations = self.equations(flow, x[0], stokes_number, 1, loads)
        start = equations.initial_state(x, q, velocity, angular_velocity)
        run = integrate(equations, start, times, tolerance)
        states = run.states[:, 0]
        parts = [
            [*equations.velocities(t, y[None]), *equations.force_torque(t, y[None])]
            for t, y in zip(run.times.tolist(), states, strict=True)
        ]
        v, omega, force, torque = np.concatenate(parts, axis=1)
        orientation = rotation.normalize(states[:, 3:7])
        return Motion(run.times, states[:, :3], orientation, v, omega, force, torque, run.steps)

    def equations(
        self,
        flow: Flow,
        near: ArrayLike = (0.0, 0.0, 0.0),
        stokes_number: ArrayLike = 0.0,
        n_bodies: int = 1,
        loads: Loads | None = None,
    ) -> RigidBodyEquations:
        """Equations of motion in the flow; `near` (3,) is where a singular flow is resolved."""
        provider: Any = flow.polynomial
        if provider is None:
            provider = self._grid_motion(flow, np.asarray(near, dtype=np.float64))
        return RigidBodyEquations(self.model, provider, stokes_number, n_bodies, loads)

    def _grid_motion(self, flow: Flow, place: Array) -> MonitoredGridMotion | AdaptiveGridMotion:
        """The functional on grids that resolve the flow wherever the body goes, from `place` on."""
        functional, share = self.hydrodynamics.functional, 0.1 * self.tolerance
        n_theta, n_phi, _ = resolving_nodes(functional, lambda x: flow.velocity(place + x), share)
        if not len(flow.singular_points):
            return MonitoredGridMotion(functional, flow, share, (n_theta, n_phi))
        motion = AdaptiveGridMotion(functional, flow, share)
        motion.calibrate(place, np.array([1.0, 0.0, 0.0, 0.0]), n_theta)
        return motion

    def field(
        self,
        flow: Flow,
        points: ArrayLike,
        position: ArrayLike = (0.0, 0.0, 0.0),
        orientation: ArrayLike = (0.0, 0.0, 1.0),
        velocity: ArrayLike | None = None,
        angular_velocity: ArrayLike | None = None,
        tolerance: float = 1e-8,
        t: float = 0.0,
    ) -> dict[str, NDArray[Any]]:
        """The flow at points (N, 3) around the body, from its surface to infinity.

        velocity, angular_velocity (3,) of the body; None: it moves freely. Returns velocity and
        disturbance_velocity (N, 3), pressure (N,), stress (N, 6: xx yy zz xy xz yz) and source
        (N,), -1 for points inside the body, whose values are NaN.

        >>> import numpy as np, qbxstokes as qs
        >>> wind = qs.flow("uniform", velocity=[1, 0, 0])
        >>> held = dict(velocity=[0, 0, 0], angular_velocity=[0, 0, 0])
        >>> field = qs.Body(1.0).field(wind, [[0, 2, 0], [0, 1, 0]], **held)
        >>> np.round(field["velocity"][:, 0], 9) + 0.0  # 1 - 3/(4 r) - 1/(4 r^3) beside a sphere
        array([0.59375, 0.     ])
        """
        x, q, _ = _places(position, orientation)
        turn = rotation.matrix(q[0])

        def background(y: Array) -> Array:
            return np.asarray(flow.velocity(x[0] + y @ turn.T, t) @ turn)

        degree = flow.degree
        if degree is None:
            n_theta, n_phi = resolving_grid(self.spheroid, background, 0.1 * tolerance)
        else:
            n_theta, n_phi = max(8, degree + 5), 2 * degree + 4
        scheme = choose_scheme(self.tolerance, n_theta)
        operators = surface_operators(self.spheroid, scheme, n_phi, "surface")
        if velocity is None and angular_velocity is None:
            around = mobility_disturbance(operators, background, degree=degree)
        else:
            v, w = (
                np.zeros(3) if u is None else np.asarray(u) for u in (velocity, angular_velocity)
            )
            around = resistance_disturbance(
                operators, background, v @ turn, w @ turn, degree=degree
            )
        whole = FlowAround(around, flow, x[0], turn, t)
        return whole.evaluate(np.reshape(np.asarray(points, float), (-1, 3)), tolerance)


def _places(position: ArrayLike, orientation: ArrayLike) -> tuple[Array, Array, tuple[int, ...]]:
    """Positions (n, 3), unit quaternions (n, 4), and the shape that results take."""
    x, turn = np.asarray(position, dtype=np.float64), np.asarray(orientation, dtype=np.float64)
    if x.shape[-1:] != (3,) or turn.shape[-1:] not in ((3,), (4,)):
        raise CaseError(
            f"position has shape {x.shape} and orientation {turn.shape}; they end in 3, and in 3 "
            "(axis) or 4 (quaternion)"
        )
    q = rotation.normalize(turn) if turn.shape[-1] == 4 else rotation.from_axis(turn)
    lead = np.broadcast_shapes(x.shape[:-1], q.shape[:-1])
    return (
        np.array(np.broadcast_to(x, (*lead, 3))).reshape(-1, 3),
        np.array(np.broadcast_to(q, (*lead, 4))).reshape(-1, 4),
        (*lead, 3),
    )
