"""Point singularities of Stokes flow in closed form, and what a plane wall answers to them.

With r = x - position, r = |r| and mu = 1 (Kim & Karrila 1991, Microhydrodynamics, chapter 2;
Pozrikidis 1992, Boundary Integral and Singularity Methods, chapters 2 and 7).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.errors import FlowError
from qbxstokes.flows.base import Build, Composed, Flow
from qbxstokes.flows.differences import gradient_of, laplacian_of
from qbxstokes.flows.domain import Plane
from qbxstokes.flows.values import number, settled, tensor, traceless
from qbxstokes.typing import Array

_FOUR_PI = 4.0 * np.pi
_EIGHT_PI = 8.0 * np.pi
_UP, _MIRROR = np.array([0.0, 1.0, 0.0]), np.array([1.0, -1.0, 1.0])


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(np.einsum("...i,...i->...", a, b))


def _outer(a: Array, b: Array) -> Array:
    return a[..., :, None] * b[..., None, :]


class Singularity(Flow):
    """A singularity of a given strength (vector or tensor) at a point; decays at infinity."""

    linear_in = ("strength",)
    rank: ClassVar[int] = 1  # of the strength

    def __init__(self, strength: ArrayLike, position: ArrayLike = (0.0, 0.0, 0.0)) -> None:
        self.strength = tensor(strength, "strength", (3,) * self.rank)
        self.position = tensor(position, "position", (3,))
        self.singular_points = self.position[None, :]

    def _arms(self, x: ArrayLike) -> tuple[Array, Array]:
        """r = x - position (..., 3) and 1/|r| (...); infinite at the singularity itself."""
        arm = np.asarray(x, dtype=float) - self.position
        with np.errstate(divide="ignore"):
            inverse: Array = 1.0 / np.sqrt(_dot(arm, arm))
        return arm, inverse

    def spec(self) -> dict[str, Any]:
        """Specification: strength and position."""
        return {
            "type": self.type_name,
            "strength": self.strength.tolist(),
            "position": self.position.tolist(),
        }

    def shifted(self, displacement: ArrayLike) -> Flow:
        """The singularity moved."""
        moved = self.position + tensor(displacement, "position", (3,))
        return type(self)(self.strength, moved)

    def rotated(self, rotation: ArrayLike) -> Flow:
        """The singularity turned about the space origin, position and strength alike."""
        turn = tensor(rotation, "rotation", (3, 3))
        strength = turn @ self.strength
        if strength.ndim == 2:
            strength = strength @ turn.T
        return type(self)(strength, turn @ self.position)

    def scaled(self, factor: float) -> Flow:
        """The singularity with its strength times a number."""
        return type(self)(number(factor, "factor") * self.strength, self.position)


class Stokeslet(Singularity):
    """Point force F (the strength) on the fluid: u = (F/r + r (F.r)/r^3)/(8 pi)."""

    type_name = "stokeslet"

    def velocity(self, x: ArrayLike, t: float = 0.0) -> Array:
        """Velocity (..., 3)."""
        arm, inverse = self._arms(x)
        along = _dot(arm, self.strength) * inverse**2
        return np.asarray(
            (self.strength + along[..., None] * arm) * (inverse / _EIGHT_PI)[..., None]
        )

    def gradient(self, x: ArrayLike, t: float = 0.0) -> Array:
        """A_ij = (-F_i r_j + r_i F_j + (F.r)(delta_ij - 3 r_i r_j/r^2))/(8 pi r^3)."""
        arm, inverse = self._arms(x)
        along = _dot(arm, self.strength)[..., None, None]
        force = np.broadcast_to(self.strength, arm.shape)
        direction = arm * inverse[..., None]
        terms = _outer(arm, force) - _outer(force, arm)
        terms = terms + along * (np.eye(3) - 3.0 * _outer(direction, direction))
        return np.asarray(terms * (inverse**3 / _EIGHT_PI)[..., None, None])

    def laplacian(self, x: ArrayLike, t: float = 0.0) -> Array:
        """Gradient of the pressure: (F - 3 r (F.r)/r^2)/(4 pi r^3)."""
        arm, inverse = self._arms(x)
        along = 3.0 * _dot(arm, self.strength) * inverse**2
        return np.asarray(
            (self.strength - along[..., None] * arm) * (inverse**3 / _FOUR_PI)[..., None]
        )

    def pressure(self, x: ArrayLike, t: float = 0.0) -> Array:
        """p = F.r/(4 pi r^3)."""
        arm, inverse = self._arms(x)
        return np.asarray(_dot(arm, self.strength) * inverse**3 / _FOUR_PI)


class Rotlet(Singularity):
    """Point torque M (the strength) on the fluid: u = M x r/(8 pi r^3); no pressure."""

    type_name = "rotlet"

    def __init__(self, strength: ArrayLike, position: ArrayLike = (0.0, 0.0, 0.0)) -> None:
        super().__init__(strength, position)
        a, b, c = self.strength
        self._cross = np.array([[0.0, -c, b], [c, 0.0, -a], [-b, a, 0.0]])

    def velocity(self, x: ArrayLike, t: float = 0.0) -> Array:
        """Velocity (..., 3)."""
        arm, inverse = self._arms(x)
        return np.asarray(arm @ self._cross.T * (inverse**3 / _EIGHT_PI)[..., None])

    def gradient(self, x: ArrayLike, t: float = 0.0) -> Array:
        """A_ij = (eps_iaj M_a - 3 (M x r)_i r_j/r^2)/(8 pi r^3)."""
        arm, inverse = self._arms(x)
        direction = arm * inverse[..., None]
        terms = self._cross - 3.0 * _outer(direction @ self._cross.T, direction)
        return np.asarray(terms * (inverse**3 / _EIGHT_PI)[..., None, None])

    def laplacian(self, x: ArrayLike, t: float = 0.0) -> Array:
        """Zero: the rotlet is harmonic."""
        return np.zeros(np.shape(x))

    def pressure(self, x: ArrayLike, t: float = 0.0) -> Array:
        """Zero."""
        return np.zeros(np.shape(x)[:-1])


class Stresslet(Singularity):
    """Point stresslet S (symmetric, traceless): u = -3 r (r.S r)/(8 pi r^5).

    S is Batchelor's stresslet of a particle (Batchelor 1970, J. Fluid Mech. 41, 545): a sphere of
    radius a in the strain E disturbs the flow as S = (20/3) pi a^3 E does at large distance.
    """

    type_name = "stresslet"
    rank = 2

    @classmethod
    def unchecked(cls, spec: Mapping[str, Any], build: Build) -> Stresslet:
        """The flow of the part of a strength that is symmetric and traceless."""
        given = tensor(spec["strength"], "strength", (3, 3))
        found = cls.from_spec({**spec, "strength": traceless(0.5 * (given + given.T))}, build)
        assert isinstance(found, Stresslet)
        return found

    def __init__(self, strength: ArrayLike, position: ArrayLike = (0.0, 0.0, 0.0)) -> None:
        """Raises FlowError unless the strength is symmetric and traceless."""
        super().__init__(strength, position)
        symmetric = 0.5 * (self.strength + self.strength.T)
        must = "strength of a stresslet must be symmetric (a rotlet carries the rest) and traceless"
        self.strength = settled(self.strength, traceless(symmetric), must, ("strength",))

    def velocity(self, x: ArrayLike, t: float = 0.0) -> Array:
        """Velocity (..., 3)."""
        arm, inverse = self._arms(x)
        form = _dot(arm @ self.strength, arm)
        return (-3.0 / _EIGHT_PI * form * inverse**5)[..., None] * arm

    def gradient(self, x: ArrayLike, t: float = 0.0) -> Array:
        """A_ij = -3 (delta_ij s + 2 r_i (S r)_j - 5 r_i r_j s/r^2)/(8 pi r^5), s = r.S r."""
        arm, inverse = self._arms(x)
        stretched = arm @ self.strength
        form = _dot(stretched, arm)[..., None, None]
        direction = arm * inverse[..., None]
        terms = form * (np.eye(3) - 5.0 * _outer(direction, direction))
        terms = terms + 2.0 * _outer(arm, stretched)
        return np.asarray(terms * (-3.0 / _EIGHT_PI * inverse**5)[..., None, None])

    def laplacian(self, x: ArrayLike, t: float = 0.0) -> Array:
        """Gradient of the pressure: -3 (2 S r - 5 r s/r^2)/(4 pi r^5)."""
        arm, inverse = self._arms(x)
        stretched = arm @ self.strength
        form = _dot(stretched, arm) * inverse**2
        terms = 2.0 * stretched - 5.0 * form[..., None] * arm
        return np.asarray(terms * (-3.0 / _FOUR_PI * inverse**5)[..., None])

    def pressure(self, x: ArrayLike, t: float = 0.0) -> Array:
        """p = -3 s/(4 pi r^5)."""
        arm, inverse = self._arms(x)
        return np.asarray(-3.0 / _FOUR_PI * _dot(arm @ self.strength, arm) * inverse**5)


class AboveWall(Composed):
    """Any flow that is regular below x2 = 0, held at rest on that plane by its images.

    With ^ for the value at the mirrored point, h = x2 and J = diag(1, -1, 1), Lorentz's reflection
    (Kim & Karrila 1991, section 12.1) adds

        -u^ + 2 h J (grad u_2)^ + h^2 J (grad p)^,   p^ - 2 h (d_2 p)^ - 4 (d_2 u_2)^

    which makes of a stokeslet that of J. R. Blake 1971. The derivatives of the image are taken by
    extrapolated differences.
    """

    type_name = "above_wall"

    def __init__(self, flow: Flow) -> None:
        points = flow.singular_points
        if not flow.singular_points_known or not len(points):
            raise FlowError("flow 'above_wall' needs a singular flow, such as a stokeslet")
        if points[:, 1].min() <= 0.0:
            raise FlowError("flow 'above_wall' needs its singular points above x2 = 0")
        super().__init__([flow])  # the singular points of its image are behind the wall
        self.flow, self.domain = flow, (*flow.domain, Plane(np.zeros(3), _UP))

    @classmethod
    def from_spec(cls, spec: Mapping[str, Any], build: Build) -> Flow:
        """Flow {"flow": spec}; its wall is x2 = 0, moved and turned by the keys every flow has."""
        return cls(cls._inner(spec, build))

    def _composed(self, name: str, x: ArrayLike, t: float, *more: Any) -> Array:
        points = np.asarray(x, dtype=float)
        found: Array = getattr(self.flow, name)(points, t, *more)
        if name == "vorticity_of_laplacian":  # the image is a Stokes flow where the flow is one
            return found
        return found + self._image(name, points, t)

    def _image(self, name: str, x: Array, t: float) -> Array:
        """What the wall adds to the velocity, gradient, Laplacian or pressure."""
        flow, there, h = self.flow, x * _MIRROR, x[..., 1, None]
        if name == "velocity":
            lift = 2.0 * h * flow.gradient(there, t)[..., 1, :] + h * h * flow.laplacian(there, t)
            return np.asarray(lift * _MIRROR - flow.velocity(there, t))
        if name == "pressure":
            image = flow.pressure(there, t) - 4.0 * flow.gradient(there, t)[..., 1, 1]
            return np.asarray(image - 2.0 * x[..., 1] * flow.laplacian(there, t)[..., 1])
        away = x[..., None, :] - flow.singular_points * _MIRROR
        step = 0.2 * np.linalg.norm(away, axis=-1).min(axis=-1)
        derivative = gradient_of if name == "gradient" else laplacian_of
        return derivative(lambda y: self._image("velocity", y, t), x, step)

    def spec(self) -> dict[str, Any]:
        """Specification with that of the flow."""
        return {"type": self.type_name, "flow": self.flow.spec()}
