"""A rigid body and its hydrodynamics apart from any place and flow: law, stresslet, exterior field.

What the integral equation says is formed when first asked for, once for every flow.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.bie.accuracy import AccurateBody
from qbxstokes.bie.functional import BodyModel
from qbxstokes.bie.rigid import Completion
from qbxstokes.case.running import Hydrodynamics
from qbxstokes.errors import SceneError
from qbxstokes.geometry.grid import SurfaceGrid
from qbxstokes.geometry.registry import build_shape
from qbxstokes.geometry.shape import Shape
from qbxstokes.motion.equations import Inertia
from qbxstokes.simulation.arguments import numbers, section
from qbxstokes.simulation.hydrodynamics import Workshop, form_body
from qbxstokes.simulation.simulation import ORIGIN
from qbxstokes.typing import Array

if TYPE_CHECKING:
    from qbxstokes.bie.exterior import ExteriorField
    from qbxstokes.bie.law import BodyLaw
    from qbxstokes.bie.stresslet import Stresslet


class FormedBody:
    """A body that knows its hydrodynamics; see `Body` for the arguments."""

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
        if not isinstance(size, int | float | np.number) or not 0.0 < size < math.inf:
            raise SceneError("size", f"is {size!r}", "positive and finite")
        self.size = float(size)
        self.stokes_number: Array = numbers("stokes_number", stokes_number, "0 (massless) or more")
        if not np.all(self.stokes_number >= 0.0):
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
            given = {"tolerance": tolerance, **(hydrodynamics or {})}
            self.settings = section("hydrodynamics", Hydrodynamics, given)
            self.strict = True
        # Who forms the operators, and where they are kept.
        self.workshop = Workshop()
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

    def with_inertia(self, stokes_number: ArrayLike, inertia: Inertia = "both") -> Self:
        """The same body, hydrodynamics included, with another inertia."""
        other = type(self)(
            shape=self.shape,
            size=self.size,
            stokes_number=stokes_number,
            inertia=inertia,
            hydrodynamics=self.settings,
        )
        other.strict, other.workshop = self.strict, self.workshop
        other._formed, other._stress = self._formed, self._stress
        return other

    # -- hydrodynamics ------------------------------------------------------------------------

    def formed(
        self, degree: int = 3, completion: Completion | None = "surface"
    ) -> tuple[AccurateBody, list[Any]]:
        """The solved body and the GMRES solvers used, once for every kind of flow asked of it.

        degree: of a polynomial flow, 1 to 3. completion: of the resistance, None to leave it out.
        """
        self.check_size()
        key = degree, completion
        if key not in self._formed:
            self._formed[key] = form_body(self, degree, completion)
        return self._formed[key]

    def check_size(self) -> None:
        """Refuse another size than the unit of length, which has a meaning beside others alone."""
        if self.size != 1.0:
            raise SceneError("size", f"is {self.size:g}", "1 outside a Suspension: it is the unit")

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

    def surface(self, n_theta: int, n_phi: int) -> Array:
        """Points (n_theta, n_phi, 3) of the surface on which `exterior` takes values."""
        return SurfaceGrid(self.shape, n_theta, n_phi).points.reshape(n_theta, n_phi, 3)

    def exterior(
        self,
        velocity: Callable[[Array], ArrayLike] | ArrayLike | None = None,
        *,
        density: ArrayLike | None = None,
        force: ArrayLike = ORIGIN,
        torque: ArrayLike = ORIGIN,
        tolerance: float = 1e-8,
    ) -> ExteriorField:
        """The Stokes flow outside the body with a given velocity on its surface, body frame.

        velocity: a function of points (N, 3) of the surface, or values (n_theta, n_phi, 3) at the
        points `surface(n_theta, n_phi)`; without net flux. Or density: values psi of the double
        layer D[psi], with the completion of a force and a torque (3,) on the fluid. tolerance:
        relative to the largest speed. The field's `evaluate(points, what)` gives velocity,
        gradient, pressure, pressure_gradient and stress anywhere outside, `errors` estimates the
        error of each, `loads` are force and torque on the fluid. Raises SceneError, and FlowError
        where no grid resolves the function.

        >>> import numpy as np, qbxstokes as qs
        >>> spin = qs.Body(1.0).exterior(lambda x: np.cross([0, 0, 1], x))
        >>> found = spin.evaluate([[2, 0, 0]], ["velocity", "gradient"])  # z x r / r^3
        >>> np.round(found["velocity"][0], 9) + 0.0, round(float(found["gradient"][0, 1, 0]), 9)
        (array([0.  , 0.25, 0.  ]), -0.25)
        """
        from qbxstokes.simulation.flow_around import exterior_field

        return exterior_field(self, velocity, density, (force, torque), tolerance)
