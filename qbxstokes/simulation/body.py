"""A rigid body and its hydrodynamics, with NumPy arrays in and out.

>>> import numpy as np
>>> import qbxstokes as qs
>>> rod = qs.Body(0.2)
>>> shear = qs.flow("shear", rate=1.0)
>>> velocity, spin = rod.free_motion(shear, position=[0, 1, 0], orientation=[0, 1, 0])
>>> np.round(velocity, 9)
array([1., 0., 0.])
>>> float(np.round(spin[2], 9))  # the rod across the flow: -1/(1 + k^2)
-0.961538462
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.errors import SceneError
from qbxstokes.flows import Flow, build_flow
from qbxstokes.flows.series import GradientSeries
from qbxstokes.geometry import rotation
from qbxstokes.geometry.symmetric import symmetric
from qbxstokes.motion.equations import Loads
from qbxstokes.motion.layout import ORIENTATION, POSITION
from qbxstokes.simulation.assembly import Assembled
from qbxstokes.simulation.formed_body import FormedBody
from qbxstokes.simulation.result import Motion
from qbxstokes.simulation.simulation import ORIGIN, UPRIGHT, Simulation
from qbxstokes.typing import AnyArray, Array

Pair = tuple[ArrayLike | None, ArrayLike | None]


def flow(type: str, **keys: Any) -> Flow:
    """A background flow by the name and the keys of the case file's section `flow`.

    >>> import qbxstokes as qs
    >>> qs.flow("paraboloid", curvature=0.5).velocity([0.0, 2.0, 0.0]).tolist()
    [2.0, 0.0, 0.0]

    Flows add and scale: `qs.flow("shear") + 0.1 * qs.flow("stokeslet", strength=[1, 0, 0],
    position=[0, 4, 0])`. Raises FlowError for unknown names and impossible values.
    """
    return build_flow({"type": type, **keys})


class Body(FormedBody):
    """A rigid body: its shape, its inertia, and its hydrodynamics to a tolerance.

    aspect_ratio: k = a/c, equatorial over polar radius, of a spheroid; or length_over_diameter
    = 1/k; or a shape, as an object or as {"type": ..., ...}.
    stokes_number: St = rho_b c^2/(mu tau), 0 for a massless body; an array (lanes,) for independent
    copies. size: the polar radius in a `Suspension`'s units of length; elsewhere it is the
    unit itself, 1. inertia: of "both" motions, or of "translation" or "rotation" alone. tolerance:
    relative error of velocities, force and torque. hydrodynamics: further keys of that section of a
    case.

    The integral equation is solved when first needed, by GMRES (0.02 to 0.5 s, and once a machine
    about ten seconds of compilation). Everything is nondimensional: lengths in c, forces in
    mu c^2/tau. Raises ConvergenceError where rounding forbids the tolerance (k below about 1/100
    at 1e-10), SceneError for arguments that make no body.
    """

    def free_motion(
        self,
        flow: Flow,
        position: ArrayLike = ORIGIN,
        orientation: ArrayLike = UPRIGHT,
        *,
        force: ArrayLike | None = None,
        torque: ArrayLike | None = None,
        t: float = 0.0,
    ) -> tuple[Array, Array]:
        """Velocity and angular velocity (..., 3), space frame, of the body without inertia.

        position (..., 3); orientation: axes (..., 3) or quaternions (..., 4); they broadcast.
        force, torque (3,): from outside, in space; None: the body is free of them.
        """
        scene, assembled = self._placed(flow, position, orientation, t, loads=(force, torque))
        u, omega = assembled.equations.velocities(t, assembled.initial)
        return scene.shaped(np.array(u)), scene.shaped(np.array(omega))

    def force_torque(
        self,
        flow: Flow,
        position: ArrayLike = ORIGIN,
        orientation: ArrayLike = UPRIGHT,
        *,
        velocity: ArrayLike = ORIGIN,
        angular_velocity: ArrayLike = ORIGIN,
        t: float = 0.0,
    ) -> tuple[Array, Array]:
        """Force and torque (..., 3) of the fluid ON the body of given motion (space frame).

        >>> import numpy as np, qbxstokes as qs
        >>> force, _ = qs.Body(1.0).force_torque(qs.flow("uniform", velocity=[1, 0, 0]))
        >>> np.round(force / np.pi, 9)
        array([6., 0., 0.])
        """
        motion = velocity, angular_velocity
        scene, assembled = self._placed(flow, position, orientation, t, motion)
        force, torque = assembled.equations.force_torque(t, assembled.initial)
        return scene.shaped(force), scene.shaped(torque)

    def stresslet(
        self,
        flow: Flow,
        position: ArrayLike = ORIGIN,
        orientation: ArrayLike = UPRIGHT,
        *,
        velocity: ArrayLike | None = None,
        angular_velocity: ArrayLike | None = None,
        force: ArrayLike | None = None,
        torque: ArrayLike | None = None,
        t: float = 0.0,
    ) -> Array:
        """Stresslet S (..., 3, 3), space frame, units of mu c^3/tau, of the body in a flow.

        Free of force and torque where nothing is given; with a velocity or an angular velocity of
        a given motion (the other one is zero); with force and torque (3,) from outside as in
        `free_motion`. S = oint sym-traceless(x (sigma.n)) dS, traction on the body.

        >>> import numpy as np, qbxstokes as qs
        >>> strain = qs.flow("polynomial", gradient=[[1, 0, 0], [0, -1, 0], [0, 0, 0]])
        >>> np.round(np.diag(qs.Body(1.0).stresslet(strain)) * 3 / (20 * np.pi), 9) + 0.0
        array([ 1., -1.,  0.])
        """
        motion, loads = (velocity, angular_velocity), (force, torque)
        scene, assembled = self._placed(flow, position, orientation, t, motion, loads)
        states, free = assembled.initial, all(u is None for u in (*motion, *loads))
        drag = None if free else assembled.equations.force_torque(t, states)[1]
        q = rotation.normalize(states[:, ORIENTATION])
        found = assembled.stress.stresslet(t, states[:, POSITION], q, rotation.axis(q), drag)
        return scene.shaped(symmetric(found))

    def _placed(
        self,
        flow: Flow,
        position: ArrayLike,
        orientation: ArrayLike,
        t: float,
        motion: Pair = (None, None),
        loads: Pair = (None, None),
    ) -> tuple[Simulation, Assembled]:
        """The body at places (..., 3) with orientations (...) in a flow at time t.

        motion: velocity and angular velocity (space frame), of a body that is not free; what is
        left out is zero. loads: force and torque from outside.
        """
        held, pushed = (any(u is not None for u in pair) for pair in (motion, loads))
        velocity, spin = (ORIGIN if held and u is None else u for u in motion)
        scene = Simulation(
            # With inertia the velocities are part of the state, whatever the Stokes number.
            self.with_inertia(1.0 if held else 0.0),
            flow,
            position=position,
            orientation=orientation,
            velocity=velocity,
            angular_velocity=spin,
            loads=Loads(*(ORIGIN if f is None else f for f in loads)) if pushed else None,
        )
        return scene, scene.assemble(t=t)

    def integrate(
        self,
        flow: Flow,
        times: ArrayLike,
        position: ArrayLike = ORIGIN,
        orientation: ArrayLike = UPRIGHT,
        **scene: Any,
    ) -> Motion:
        """The motion from t = 0, sampled at increasing times (T,), by PETSc TS.

        scene: further arguments of `qs.Simulation`, such as velocity and angular_velocity at the
        start, loads, constraints, brownian and tolerance.

        >>> import numpy as np, qbxstokes as qs
        >>> times = np.linspace(0.0, 5.0 * np.pi, 5)  # a Jeffery period of k = 1/2
        >>> orbit = qs.Body(0.5).integrate(qs.flow("shear"), times, orientation=[0.6, 0, 0.8])
        >>> bool(np.allclose(orbit.axis[-1], [0.6, 0, 0.8]))
        True
        """
        if "stokes_number" in scene:
            right = "qs.Body(..., stokes_number=...).integrate(...)"
            raise SceneError("stokes_number", "belongs to the body", right)
        for name in ("velocity", "angular_velocity"):
            if scene.get(name) is not None and not np.any(self.stokes_number):
                right = "leave it out, or give the body a stokes_number"
                raise SceneError(name, "has no meaning for a massless body", right)
        return Simulation(
            self, flow, position=position, orientation=orientation, **scene
        ).integrate(times)

    def axes(
        self,
        flow: Flow | GradientSeries,
        times: ArrayLike,
        orientation: ArrayLike = UPRIGHT,
        *,
        tolerance: float = 1e-6,
    ) -> Array:
        """Axes (..., T, 3) at times (T,) of massless bodies that lie in one linear flow.

        orientation (..., 3): axes at t = 0. The same matrix turns all of them: ten thousand take
        little longer than one, and no positions or quaternions are found (`integrate`). tolerance:
        error accepted at the end.

        >>> import numpy as np, qbxstokes as qs
        >>> shear = qs.flow("linear", gradient=[[0, "cos(t)", 0], [0, 0, 0], [0, 0, 0]])
        >>> axes = qs.Body(0.5).axes(shear, [0.0, 2.0 * np.pi], [[1, 0, 0], [0.6, 0.0, 0.8]])
        >>> bool(np.allclose(axes[:, -1], [[1, 0, 0], [0.6, 0.0, 0.8]]))
        True
        """
        from qbxstokes.simulation.shared_gradient import axes_in

        return axes_in(self, flow, times, orientation, tolerance)

    def field(
        self,
        flow: Flow,
        points: ArrayLike,
        position: ArrayLike = ORIGIN,
        orientation: ArrayLike = UPRIGHT,
        *,
        velocity: ArrayLike | None = None,
        angular_velocity: ArrayLike | None = None,
        tolerance: float = 1e-8,
        t: float = 0.0,
        what: Collection[str] = ("velocity", "disturbance_velocity", "pressure", "stress"),
    ) -> dict[str, AnyArray]:
        """The flow at points (N, 3) around the body, from its surface to infinity.

        velocity, angular_velocity (3,) of the body; None: it moves freely. what: also gradient
        and pressure_gradient; arrays as in `ExteriorField.evaluate`, space frame, and source (N,),
        -1 for points inside the body, whose values are NaN.

        >>> import numpy as np, qbxstokes as qs
        >>> wind = qs.flow("uniform", velocity=[1, 0, 0])
        >>> held = dict(velocity=[0, 0, 0], angular_velocity=[0, 0, 0])
        >>> field = qs.Body(1.0).field(wind, [[0, 2, 0], [0, 1, 0]], **held)
        >>> np.round(field["velocity"][:, 0], 9) + 0.0  # 1 - 3/(4 r) - 1/(4 r^3) beside a sphere
        array([0.59375, 0.     ])
        """
        from qbxstokes.simulation.flow_around import field_around

        place, motion = (position, orientation), (velocity, angular_velocity)
        return field_around(self, flow, points, place, motion, what, tolerance, t)


def stokes_number(
    density_ratio: ArrayLike, length: ArrayLike, viscosity: ArrayLike, time: ArrayLike
) -> Array:
    """St = (rho_p/rho_f) c^2/(nu tau), as `Body` takes it; the arguments broadcast.

    density_ratio: rho_p/rho_f, of body to fluid. length: c, the polar radius; viscosity: nu,
    kinematic; time: tau, the unit of time (1/rate, or the Kolmogorov time), in units that agree.

    >>> import qbxstokes as qs
    >>> float(qs.stokes_number(2.5, 1e-4, 1e-6, 0.05))  # 0.2 mm of polystyrene or so, in water
    0.5
    """
    given = {"density_ratio": density_ratio, "length": length, "viscosity": viscosity, "time": time}
    rho, c, nu, tau = (np.asarray(value, dtype=np.float64) for value in given.values())
    for name, value in zip(given, (rho, c, nu, tau), strict=True):
        if not np.all((value > 0.0) & np.isfinite(value)):
            raise SceneError(name, f"is {value.tolist()}", "positive and finite")
    return np.asarray(rho * c**2 / (nu * tau))


def response_time(body: Body) -> Array:
    """tau_p/tau, the time in which a body of some Stokes number takes up a flow's velocity.

    Of axes in all directions alike: St V (2/R_across + 1/R_along)/3 with the volume V (Shapiro &
    Goldenberg, J. Aerosol Sci. 24, 1993). With the Kolmogorov time as the unit it is the
    tau_p/tau_eta of the literature.

    >>> import qbxstokes as qs
    >>> round(float(qs.response_time(qs.Body(1.0, stokes_number=9.0))), 9)  # of a sphere: 2 St/9
    2.0
    """
    across, along = np.diag(body.resistance)[[0, 2]]
    mobility = (2.0 / across + 1.0 / along) / 3.0
    return np.asarray(body.stokes_number * body.shape.volume * mobility)
