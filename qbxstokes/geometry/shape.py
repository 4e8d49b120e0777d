"""What a shape tells the numerics: one object for each, and nobody else knows its formulas.

Lengths are in the unit that the shape states (of a spheroid its polar radius c); the origin of the
body frame is the centre, about which torque and angular velocity are meant, and D3 the axis. A new
shape is a class in a file of its own and a line in `registry.SHAPES`.
"""

from abc import ABC, abstractmethod
from dataclasses import asdict
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.typing import Array

Symmetry = Literal["sphere", "fore-aft revolution", "revolution", "three planes"]

# Balls inside the body in which singular points of a flow are looked for.
MOST_BALLS = 500


class Shape(ABC):
    """A closed surface with the chart (theta, phi), theta in [0, pi], phi once around D3.

    Subclasses are frozen dataclasses whose fields are the keys of `shape` in a case file.
    semi_axes: (3,) of an ellipsoid, None of any other shape. On an ellipsoid the double layer of a
    polynomial is a polynomial of the same degree, and outside it confocal coordinates hold.
    effective_ratio: k of the spheroid whose axis moves alike in every linear flow (Bretherton
    1962, J. Fluid Mech. 14), None where only the law of the body tells it.
    """

    name: ClassVar[str]
    semi_axes: tuple[float, float, float] | None = None
    effective_ratio: float | None = None

    @property
    @abstractmethod
    def symmetry(self) -> Symmetry:
        """The rotations and reflections that map the body onto itself, about its centre."""

    @property
    def fore_aft(self) -> bool:
        """Whether z -> -z maps the body onto itself."""
        return self.symmetry != "revolution"

    @property
    def parameters(self) -> dict[str, float]:
        """The numbers that make it, by the names of their keys."""
        return asdict(self)  # type: ignore[call-overload,no-any-return]

    def spec(self) -> dict[str, Any]:
        """The plain dictionary from which `registry.build_shape` makes it again."""
        return {"type": self.name, **self.parameters}

    def __str__(self) -> str:
        """Name and numbers, for messages."""
        numbers = " and ".join(f"{name} {value:g}" for name, value in self.parameters.items())
        return f"{self.name} with {numbers}"

    @property
    @abstractmethod
    def volume(self) -> float:
        """Volume."""

    @property
    @abstractmethod
    def surface_area(self) -> float:
        """Surface area."""

    @property
    def centroid(self) -> Array:
        """Centre of volume (3,); the origin by symmetry unless a shape says otherwise."""
        return np.zeros(3)

    @property
    @abstractmethod
    def inertia(self) -> Array:
        """Principal moments (3,) about the centroid, unit density."""

    @property
    @abstractmethod
    def radius(self) -> float:
        """Largest distance of the surface from the centre: the size of the body."""

    @abstractmethod
    def surface(self, theta: ArrayLike, phi: ArrayLike) -> Array:
        """Points (..., 3) of the surface at the broadcast angles."""

    @abstractmethod
    def normal(self, theta: ArrayLike, phi: ArrayLike) -> Array:
        """Outward unit normals (..., 3) at the broadcast angles."""

    @abstractmethod
    def level(self, points: Array) -> Array:
        """A continuous function (...) of points (..., 3): 1 on the surface, less inside."""

    @abstractmethod
    def clearance(self, points: ArrayLike, centre: ArrayLike, axis: ArrayLike) -> Array:
        """Signed distance (..., m) of points (m, 3) from bodies, negative inside.

        centre, axis (..., 3): where the bodies are, and their D3 (of unit length).
        """

    @abstractmethod
    def extent(self, axis: ArrayLike) -> Array:
        """Matrices C (..., 3, 3) of ellipsoids around bodies with these axes D3 (..., 3).

        Their support function is sqrt(n.C n).
        """

    @abstractmethod
    def decay(self, points: ArrayLike) -> Array:
        """Factor (...) per degree, or more, by which fields decay from the surface to points."""

    @abstractmethod
    def flow_decay(self, points: ArrayLike) -> Array:
        """The same of a flow that is singular at the points, of every azimuthal order."""

    @abstractmethod
    def interior_balls(self) -> tuple[Array, Array]:
        """Centres (n, 3) and radii (n,) of balls inside, which overlap and nearly fill the body."""


class Revolution(Shape):
    """A body of revolution: a meridian rho(theta), z(theta) from the pole z > 0 to the other.

    The meridian and its derivative give the chart.
    """

    @abstractmethod
    def meridian(self, theta: Array) -> tuple[Array, Array]:
        """rho and z at theta."""

    @abstractmethod
    def tangent(self, theta: Array) -> tuple[Array, Array]:
        """d rho/d theta and dz/d theta."""

    @abstractmethod
    def difference(self, theta: Array, at: float) -> tuple[Array, Array]:
        """rho and z at theta less those at one place, exact to rounding however close they are."""

    @abstractmethod
    def area_vector(self, theta: Array) -> tuple[Array, Array]:
        """Components along rho and z of the normal times dS / (dtheta dphi)."""

    # -- the chart ------------------------------------------------------------------------------

    def speed(self, theta: ArrayLike) -> Array:
        """Length |dx/dtheta|, shape of theta."""
        d_rho, d_z = self.tangent(np.asarray(theta, dtype=float))
        return np.asarray(np.hypot(d_z, d_rho))

    def surface(self, theta: ArrayLike, phi: ArrayLike) -> Array:
        """Points (..., 3) of the surface at the broadcast angles."""
        theta, phi = np.broadcast_arrays(np.asarray(theta, float), np.asarray(phi, float))
        rho, z = self.meridian(theta)
        return np.stack([rho * np.cos(phi), rho * np.sin(phi), z], axis=-1)

    def normal(self, theta: ArrayLike, phi: ArrayLike) -> Array:
        """Outward unit normals (..., 3) at the broadcast angles."""
        theta, phi = np.broadcast_arrays(np.asarray(theta, float), np.asarray(phi, float))
        d_rho, d_z = self.tangent(theta)
        n = np.stack([-d_z * np.cos(phi), -d_z * np.sin(phi), d_rho], axis=-1)
        return np.asarray(n / self.speed(theta)[..., None])

    def area_element(self, theta: ArrayLike) -> Array:
        """W with dS = W dtheta dphi: rho |dx/dtheta| (Bagge 2015, eq. 5.7)."""
        rho, _ = self.meridian(np.asarray(theta, float))
        return np.asarray(rho * self.speed(theta))

    # -- sizes and distances --------------------------------------------------------------------

    @property
    @abstractmethod
    def torque_density(self) -> Array:
        """b (3,) for unit torques of the density b x y with measure sin(theta) dtheta dphi."""

    @abstractmethod
    def admissible_radius(self, theta: ArrayLike) -> Array:
        """Largest radius of a ball that touches the surface at theta alone, either side."""

    @property
    @abstractmethod
    def least_radius(self) -> float:
        """Least of the admissible radii."""

    @abstractmethod
    def nearest(self, rho: ArrayLike, z: ArrayLike) -> tuple[Array, Array]:
        """theta of the nearest point of the surface, and the distance, negative inside."""

    def clearance(self, points: ArrayLike, centre: ArrayLike, axis: ArrayLike) -> Array:
        """Signed distance (..., m) of points (m, 3) from bodies, negative inside.

        centre, axis (..., 3): where the bodies are, and their D3 (of unit length).
        """
        middle = np.asarray(centre, dtype=float)[..., None, :]
        direction = np.asarray(axis, dtype=float)[..., None, :]
        arm = np.asarray(points, dtype=float) - middle
        height = np.sum(arm * direction, axis=-1)
        width = np.linalg.norm(np.cross(direction, arm), axis=-1)
        return self.nearest(width, height)[1]
