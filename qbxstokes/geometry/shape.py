"""What a shape tells the numerics: one object for each, and nobody else knows its formulas.

Lengths are in the unit that the shape states (of a spheroid its polar radius c); the origin of the
body frame is the centre, about which torque and angular velocity are meant, and D3 the axis. A new
shape is a class in a file of its own and a line in `registry.SHAPES`.
"""

from abc import ABC, abstractmethod
from dataclasses import asdict
from functools import cached_property
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.typing import Array

Symmetry = Literal["sphere", "fore-aft revolution", "revolution", "three planes"]

# Nodes of quadrature over a meridian, and samples among which the nearest one is searched for.
_NODES, _SAMPLES = 400, 401
_BISECTIONS = 60
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

    def extent(self, axis: ArrayLike) -> Array:
        """Matrices C (..., 3, 3) of ellipsoids around bodies with these axes D3 (..., 3).

        Their support function is sqrt(n.C n); the sphere around the body unless a shape fits them
        closer.
        """
        unit = np.broadcast_to(np.eye(3), (*np.shape(axis)[:-1], 3, 3))
        return np.asarray(self.radius**2 * unit)

    def decay(self, points: ArrayLike) -> Array:
        """Factor (...) per degree, or more, by which fields decay from the surface to points.

        1 unless a shape knows better: then nothing is taken for granted.
        """
        return np.ones(np.shape(points)[:-1])

    def flow_decay(self, points: ArrayLike) -> Array:
        """The same of a flow that is singular at the points, of every azimuthal order."""
        return self.decay(points)

    def interior_balls(self) -> tuple[Array, Array]:
        """Centres (n, 3) and radii (n,) of balls inside, which overlap and nearly fill the body."""
        rng = np.random.default_rng(0)
        points = self.radius * rng.uniform(-1.0, 1.0, (20 * MOST_BALLS, 3))
        points = points[self.level(points) < 1.0][:MOST_BALLS]
        return points, -0.9 * self.clearance(points, np.zeros(3), np.array([0.0, 0.0, 1.0]))


class Revolution(Shape):
    """A body of revolution: a meridian rho(theta), z(theta) from the pole z > 0 to the other.

    The meridian, its first and its second derivative say everything; the rest is quadrature and
    search, which a shape with closed forms replaces.
    """

    @abstractmethod
    def meridian(self, theta: Array) -> tuple[Array, Array]:
        """rho and z at theta."""

    @abstractmethod
    def tangent(self, theta: Array) -> tuple[Array, Array]:
        """d rho/d theta and dz/d theta."""

    @abstractmethod
    def second(self, theta: Array) -> tuple[Array, Array]:
        """Second derivatives of rho and z."""

    def difference(self, theta: Array, at: float) -> tuple[Array, Array]:
        """rho and z at theta less those at one place, without loss of digits where it is known."""
        rho, z = self.meridian(theta)
        rho0, z0 = self.meridian(np.asarray(at))
        return rho - rho0, z - z0

    def area_vector(self, theta: Array) -> tuple[Array, Array]:
        """Components along rho and z of the normal times dS / (dtheta dphi)."""
        rho, _ = self.meridian(theta)
        d_rho, d_z = self.tangent(theta)
        return -rho * d_z, rho * d_rho

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

    # -- sizes ----------------------------------------------------------------------------------

    @cached_property
    def _quadrature(self) -> tuple[Array, Array, Array, Array]:
        """Weights of d theta, rho, z and the disc's volume pi rho^2 (-dz) at nodes in theta."""
        x, w = np.polynomial.legendre.leggauss(_NODES)
        theta = 0.5 * np.pi * (x + 1.0)
        weights = 0.5 * np.pi * w
        rho, z = self.meridian(theta)
        return weights * np.sin(theta), rho, z, -np.pi * weights * rho**2 * self.tangent(theta)[1]

    @property
    def volume(self) -> float:
        """Volume."""
        return float(self._quadrature[3].sum())

    @property
    def surface_area(self) -> float:
        """Surface area."""
        x, w = np.polynomial.legendre.leggauss(_NODES)
        return float(np.pi**2 * (w @ self.area_element(0.5 * np.pi * (x + 1.0))))

    @property
    def centroid(self) -> Array:
        """Centre of volume (3,), on the axis."""
        _, _, z, disc = self._quadrature
        return np.array([0.0, 0.0, 0.0 if self.fore_aft else disc @ z / disc.sum()])

    @property
    def inertia(self) -> Array:
        """Principal moments (3,) about the centroid, unit density."""
        _, rho, z, disc = self._quadrature
        across = float(disc @ (0.25 * rho**2 + (z - self.centroid[2]) ** 2))
        return np.array([across, across, 0.5 * float(disc @ rho**2)])

    @cached_property
    def radius(self) -> float:
        """Largest distance of the surface from the centre."""
        return float(np.max(np.hypot(*self.meridian(np.linspace(0.0, np.pi, _SAMPLES)))))

    @property
    def torque_density(self) -> Array:
        """b (3,) for unit torques of the density b x y with measure sin(theta) dtheta dphi."""
        measure, rho, z, _ = self._quadrature
        across = np.pi * float(measure @ (rho**2 + 2.0 * z**2))
        return np.array([1.0 / across, 1.0 / across, 0.5 / np.pi / float(measure @ rho**2)])

    # -- distances ------------------------------------------------------------------------------

    def admissible_radius(self, theta: ArrayLike) -> Array:
        """Largest radius of a ball that touches the surface at theta alone, either side."""
        at = np.atleast_1d(np.asarray(theta, dtype=float))
        (a, b), (a1, b1), (a2, b2) = self.meridian(at), self.tangent(at), self.second(at)
        speed = np.hypot(a1, b1)
        with np.errstate(divide="ignore", invalid="ignore"):
            along = speed**3 / np.abs(a1 * b2 - b1 * a2)
            around = np.where(a > 1e-8 * self.radius, a * speed / np.abs(b1), along)
            # Through any other point of the surface: |x - y|^2 / (2 |n.(x - y)|).
            rho, z = self.meridian(np.linspace(0.0, np.pi, _SAMPLES))
            least = np.minimum(along, around)
            for phi in np.linspace(0.0, np.pi, 17):
                dx, dy, dz = rho * np.cos(phi) - a[:, None], rho * np.sin(phi), z - b[:, None]
                height = np.abs(dz * a1[:, None] - dx * b1[:, None]) / speed[:, None]
                square = dx**2 + dy**2 + dz**2
                touching = np.where(square > 1e-6 * self.radius**2, 0.5 * square / height, np.inf)
                least = np.fmin(least, np.nanmin(touching, axis=1))
        return least

    @cached_property
    def least_radius(self) -> float:
        """Least of the admissible radii."""
        return float(self.admissible_radius(np.linspace(0.0, np.pi, _SAMPLES)).min())

    def nearest(self, rho: ArrayLike, z: ArrayLike) -> tuple[Array, Array]:
        """theta of the nearest point of the surface, and the distance, negative inside.

        Found among samples of the meridian and refined by bisection of (x - y).dx/dtheta.
        """
        r, h = np.broadcast_arrays(np.asarray(rho, float), np.asarray(z, float))
        samples = np.linspace(0.0, np.pi, _SAMPLES)
        places = np.stack(self.meridian(samples), axis=-1)
        apart = np.linalg.norm(np.stack([r, h], axis=-1)[..., None, :] - places, axis=-1)
        found = samples[np.argmin(apart, axis=-1)]
        step = samples[1]
        low, high = np.maximum(found - step, 0.0), np.minimum(found + step, np.pi)
        for _ in range(_BISECTIONS):
            theta = 0.5 * (low + high)
            (a, b), (a1, b1) = self.meridian(theta), self.tangent(theta)
            beyond = (r - a) * a1 + (h - b) * b1 > 0.0
            low, high = np.where(beyond, theta, low), np.where(beyond, high, theta)
        theta = 0.5 * (low + high)
        (a, b), (a1, b1) = self.meridian(theta), self.tangent(theta)
        outside = (h - b) * a1 - (r - a) * b1 >= 0.0
        distance = np.hypot(r - a, h - b)
        return theta, np.where(outside, distance, -distance)

    def level(self, points: Array) -> Array:
        """A continuous function (...) of points (..., 3): 1 on the surface, less inside."""
        return 1.0 + self.nearest(np.hypot(points[..., 0], points[..., 1]), points[..., 2])[1]

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
