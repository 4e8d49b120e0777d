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

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qbxstokes.bie.accuracy import AccurateBody
from qbxstokes.bie.functional import BodyModel
from qbxstokes.bie.resistance import Completion
from qbxstokes.case.running import Hydrodynamics
from qbxstokes.case.values import Problem
from qbxstokes.errors import SceneError
from qbxstokes.flows import Flow, build_flow
from qbxstokes.geometry.registry import build_shape
from qbxstokes.geometry.shape import Shape
from qbxstokes.motion.equations import Constraints, Inertia, Loads
from qbxstokes.simulation.hydrodynamics import (
    Former,
    Hydrodynamic,
    Need,
    Workshop,
    form_body,
    solver_tolerance,
)
from qbxstokes.simulation.result import Motion
from qbxstokes.simulation.simulation import ORIGIN, UPRIGHT, Simulation, places

if TYPE_CHECKING:
    from qbxstokes.bie.law import BodyLaw
    from qbxstokes.bie.stresslet import Stresslet

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


class Body:
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

    def __init__(
        self,
        aspect_ratio: float | None = None,
        *,
        shape: Shape | Mapping[str, Any] | None = None,
        length_over_diameter: float | None = None,
        size: float = 1.0,
        stokes_number: ArrayLike = 0.0,
        tolerance: float = 1e-10,
        inertia: Inertia = "both",
        hydrodynamics: Mapping[str, Any] | Hydrodynamics | None = None,
    ) -> None:
        self.shape = build_shape(aspect_ratio, length_over_diameter, shape)
        if not 0.0 < size < math.inf:
            raise SceneError("size", f"is {size:g}", "positive and finite")
        self.size = float(size)
        self.stokes_number: Array = np.asarray(stokes_number, dtype=np.float64)
        if not np.all(self.stokes_number >= 0.0) or not np.isfinite(self.stokes_number).all():
            worst = float(self.stokes_number.ravel()[~(self.stokes_number.ravel() >= 0.0)][0])
            raise SceneError("stokes_number", f"is {worst:g}", "0 (massless) or more")
        if inertia not in ("both", "translation", "rotation"):
            raise SceneError("inertia", f"is {inertia!r}", "both, translation or rotation")
        self.inertia: Inertia = inertia
        if isinstance(hydrodynamics, Hydrodynamics):
            self.settings = hydrodynamics
            # A tolerance that nobody stated is one to come as near to as rounding allows.
            self.strict = "tolerance" in hydrodynamics.given_keys
        else:
            self.settings = _settings({"tolerance": tolerance, **(hydrodynamics or {})})
            self.strict = True
        self._formed: dict[tuple[int, Completion | None], tuple[AccurateBody, list[Any]]] = {}
        self._stress: dict[str, Stresslet] = {}

    def __repr__(self) -> str:
        given = ""
        if np.any(self.stokes_number):
            given = f", stokes_number={self.stokes_number.tolist()}"
        return f"Body({self.shape!r}{given}, tolerance={self.tolerance:g})"

    @property
    def effective_ratio(self) -> float:
        """k of the spheroid whose axis moves alike in every linear flow; its own of a spheroid."""
        known = self.shape.effective_ratio
        return self.model.effective_ratio if known is None else float(known)

    @property
    def tolerance(self) -> float:
        """Relative error of velocities, force and torque to aim at."""
        return float(self.settings.tolerance)

    def with_inertia(self, stokes_number: ArrayLike, inertia: Inertia = "both") -> Body:
        """The same body, hydrodynamics included, with another inertia."""
        other = Body(
            shape=self.shape,
            size=self.size,
            stokes_number=stokes_number,
            inertia=inertia,
            hydrodynamics=self.settings,
        )
        other.strict, other._formed, other._stress = self.strict, self._formed, self._stress
        return other

    # -- hydrodynamics ------------------------------------------------------------------------

    def formed(
        self,
        degree: int = 3,
        completion: Completion | None = "surface",
        workshop: Workshop | None = None,
    ) -> tuple[AccurateBody, list[Any]]:
        """The solved body and the GMRES solvers used, once for every kind of flow asked of it.

        degree: of a polynomial flow, 1 to 3. completion: of the resistance, None to leave it out.
        """
        self.check_size()
        key = degree, completion
        if key not in self._formed:
            section = self.settings
            self._formed[key] = form_body(
                self.shape, section, degree, completion, self.strict, workshop or Workshop()
            )
        return self._formed[key]

    def check_size(self) -> None:
        """Refuse another size than the unit of length, which has a meaning beside others alone."""
        if self.size != 1.0:
            raise SceneError("size", f"is {self.size:g}", "1 outside a Suspension: it is the unit")

    def hydrodynamics_in(
        self, flow: Flow, need: Need, workshop: Workshop, degree: int | None = None
    ) -> Hydrodynamic:
        """The body model and what a scene asks at each step, in a background flow.

        degree: of the flows that the model is for, 1 to 3, if not that of the flow itself.
        """
        degree = degree or (3 if flow.degree is None else min(3, max(1, flow.degree)))
        before, section = workshop.cache.found, self.settings
        body, solvers = self.formed(degree, need.completion, workshop)
        facts = {
            "scheme": section.scheme,
            "completion": need.completion,
            "gmres_tolerance": solver_tolerance(section),
            "cache": "found" if workshop.cache.found > before else "formed",
            "n_phi": body.functional.grid.n_phi,
            **vars(body.scheme),
        }
        if body.model.error_parts is not None:
            facts["error_parts"] = dict(vars(body.model.error_parts))
        solvers = list(solvers)
        former = Former(self.shape, section, flow, need, workshop)
        provider = former.provider(body, facts, solvers)
        return Hydrodynamic(body.model, provider, facts, solvers, workshop.cache.problems)

    @property
    def hydrodynamics(self) -> AccurateBody:
        """Body model, functional, discretisation and error estimate."""
        return self.formed()[0]

    @property
    def model(self) -> BodyModel:
        """The numbers that describe the body in every Stokes flow."""
        return self.hydrodynamics.model

    @property
    def stress(self) -> Stresslet:
        """S0, S1 and S2 (`numbers`) with their error estimate, and the functional behind them."""
        self.check_size()
        if "stresslet" not in self._stress:
            from qbxstokes.simulation.stresses import form_stresslet

            self._stress["stresslet"] = form_stresslet(self)
        return self._stress["stresslet"]

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
        return self.model.resistance.matrix

    @property
    def mobility(self) -> Array:
        """Matrix M (6, 6), body frame: (V, Omega) = M (force, torque) from outside."""
        return self.model.resistance.mobility

    def law(self, about: ArrayLike = ORIGIN) -> BodyLaw:
        """The law as tensors about a point (3,) of the body frame: resistance, mobility, and more.

        `resistance` and `mobility` (6, 6), `grand_resistance` (11, 11) with the stresslet, and
        `free(velocity)`, the free motion and stresslet in a flow: see `BodyLaw`.

        >>> import numpy as np, qbxstokes as qs
        >>> tip = qs.Body(0.5).law(about=[0, 0, 1]).resistance  # pushed at its tip a rod turns
        >>> bool(np.allclose(tip, tip.T)), bool(tip[0, 4] != 0.0)
        (True, True)
        """
        from qbxstokes.bie.law import BodyLaw

        point = np.asarray(about, dtype=np.float64)
        if point.shape != (3,) or not np.isfinite(point).all():
            raise SceneError("about", f"is {about!r}", "three finite numbers")
        return BodyLaw(self.model, self.hydrodynamics.functional, lambda: self.stress, point)

    # -- in a flow ----------------------------------------------------------------------------

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
        from qbxstokes.simulation.placed import NOTHING, PlacedBody

        loads = force, torque
        return PlacedBody(self, flow, position, orientation, NOTHING, loads, t).velocities()

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
        from qbxstokes.simulation.placed import NOTHING, PlacedBody

        motion = velocity, angular_velocity
        return PlacedBody(self, flow, position, orientation, motion, NOTHING, t).force_torque()

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
        from qbxstokes.simulation.placed import PlacedBody

        motion, loads = (velocity, angular_velocity), (force, torque)
        return PlacedBody(self, flow, position, orientation, motion, loads, t).stresslet()

    def integrate(
        self,
        flow: Flow,
        times: ArrayLike,
        position: ArrayLike = ORIGIN,
        orientation: ArrayLike = UPRIGHT,
        *,
        velocity: ArrayLike | None = None,
        angular_velocity: ArrayLike | None = None,
        loads: Loads | None = None,
        constraints: Constraints | None = None,
        tolerance: float = 1e-10,
        stokes_number: None = None,
    ) -> Motion:
        """The motion from t = 0, sampled at increasing times (T,), by PETSc TS.

        velocity, angular_velocity (space frame): at the start, None to follow the flow.
        tolerance: error accepted at the end. The short form of `qs.Simulation(...).integrate`.

        >>> import numpy as np, qbxstokes as qs
        >>> times = np.linspace(0.0, 5.0 * np.pi, 5)  # a Jeffery period of k = 1/2
        >>> orbit = qs.Body(0.5).integrate(qs.flow("shear"), times, orientation=[0.6, 0, 0.8])
        >>> bool(np.allclose(orbit.axis[-1], [0.6, 0, 0.8]))
        True
        """
        if stokes_number is not None:
            right = "qs.Body(..., stokes_number=...).integrate(...)"
            raise SceneError("stokes_number", "belongs to the body", right)
        return Simulation(
            self,
            flow,
            position=position,
            orientation=orientation,
            velocity=velocity,
            angular_velocity=angular_velocity,
            loads=loads,
            constraints=constraints,
            tolerance=tolerance,
        ).integrate(times)

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
        from qbxstokes.bie.field import USUAL
        from qbxstokes.simulation.around import AroundBody, Instant

        x, q, _ = places(position, orientation)
        v, omega = (
            None if u is None else np.asarray(u, dtype=np.float64)
            for u in (velocity, angular_velocity)
        )
        if v is not None or omega is not None:  # the other one is held
            v, omega = (np.zeros(3) if u is None else u for u in (v, omega))
        around = AroundBody(self.shape, flow, self.settings, tolerance)
        whole = around.at(Instant(t, x[0], q[0], v, omega))
        return whole.evaluate(np.reshape(np.asarray(points, float), (-1, 3)), USUAL, tolerance)


def _settings(given: Mapping[str, Any]) -> Hydrodynamics:
    try:
        return Hydrodynamics.read(dict(given))
    except Problem as problem:
        key = ".".join(["hydrodynamics", *map(str, problem.key)])
        raise SceneError(key, problem.wrong, problem.right) from None
