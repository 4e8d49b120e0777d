"""The flow around a body in a background flow, from the solved density.

    u = u_bg + D[psi] + V,   V = S[mu],  mu dS = (a + b x y) sin(theta) dtheta dphi

(Bagge 2015, eq. 4.13; V carries the force and torque that the body exerts on the fluid). The
disturbance D[psi] + V is an `ExteriorField`, held in the body frame.
"""

from collections.abc import Callable, Collection
from dataclasses import dataclass, field

import numpy as np

from qbxstokes.bie.exterior import (
    INSIDE,
    ExteriorField,
    Method,
    Velocity,
    completion_velocity,
    layer_limit,
)
from qbxstokes.bie.operators import DirectSolver, SolverFactory, SurfaceOperators
from qbxstokes.flows.base import Flow
from qbxstokes.geometry.symmetric import components, symmetric, turned
from qbxstokes.typing import AnyArray, Array

# What `FlowAround.evaluate` gives if nothing else is asked for.
USUAL = ("velocity", "disturbance_velocity", "pressure", "stress")
# Targets per block: what is in memory at once.
_BLOCK = 65_536


@dataclass(frozen=True, kw_only=True)
class Disturbance(ExteriorField):
    """What a body adds to a background flow, and how it moves, in the body frame.

    force, torque: ON the fluid, (3,). body_velocity, angular_velocity: motion of the body, (3,).
    background: velocity (N, 3) of the background flow at points of the surface.
    """

    force: Array
    torque: Array
    body_velocity: Array
    angular_velocity: Array
    background: Velocity = field(repr=False)

    def rigid(self, points: Array) -> Array:
        """Velocity (..., 3) of the rigid motion at points (..., 3) of the body frame."""
        return self.body_velocity + np.cross(self.angular_velocity, points)


@dataclass(frozen=True)
class FlowAround:
    """The whole flow around a body in the space frame, at one instant.

    position (3,) of the centre, rotation (3, 3) from body to space, the disturbance in the body
    frame and the background flow in space.
    """

    disturbance: Disturbance
    flow: Flow
    position: Array
    rotation: Array
    time: float = 0.0

    def to_body(self, points: Array) -> Array:
        """Points (N, 3) of space in the body frame."""
        return np.asarray((points - self.position) @ self.rotation)

    @property
    def slip(self) -> float:
        """Largest slip on the surface, relative to the largest disturbance."""
        return self.disturbance.boundary_error / (self.disturbance.scale or 1.0)

    def check_points(self, count: int) -> Array:
        """Random points (count, 3) of space, from the surface to far away."""
        return self.disturbance.check_points(count) @ self.rotation.T + self.position

    def differences(self, points: Array) -> Array:
        """Difference (N,) of the velocity by table and by QBX at points (N, 3) of space."""
        return self.disturbance.differences(self.to_body(points))

    @property
    def state(self) -> dict[str, Array]:
        """Motion of the body, and force and torque ON it, in space."""
        own = self.disturbance
        # Without negative zeros.
        return {
            "velocity": self.rotation @ own.body_velocity,
            "angular_velocity": self.rotation @ own.angular_velocity,
            "force": 0.0 - self.rotation @ own.force,
            "torque": 0.0 - self.rotation @ own.torque,
        }

    @property
    def scales(self) -> dict[str, float]:
        """Sizes that velocity, force and torque are made of: what rounding is relative to."""
        points = self.disturbance.grid.points
        speed = float(np.linalg.norm(self.disturbance.background(points), axis=-1).max())
        speed = max(speed, self.disturbance.scale)
        return sizes(speed, self.disturbance.grid.shape.radius)

    def evaluate(
        self,
        points: Array,
        what: Collection[str] = USUAL,
        tolerance: float = 1e-8,
        method: Method = "auto",
    ) -> dict[str, AnyArray]:
        """Fields at points (N, 3) of space: "disturbance_velocity" and any of WHAT, of the whole.

        Arrays, tolerance, method and source as in `ExteriorField.evaluate`, in the space frame.
        Works block by block, so that memory beyond the result stays bounded.
        """
        return in_blocks(points, _BLOCK, lambda some: self._block(some, what, tolerance, method))

    def _block(
        self, x: Array, what: Collection[str], tolerance: float, method: Method
    ) -> dict[str, AnyArray]:
        own = {name.removeprefix("disturbance_") for name in what}
        found = self.disturbance.evaluate(self.to_body(x), own, tolerance, method)
        turn, flow, t = self.rotation, self.flow, self.time
        total = {"source": found["source"]}
        if "velocity" in own:
            u = found["velocity"] @ turn.T
            total |= {"disturbance_velocity": u, "velocity": u + flow.velocity(x, t)}
        if "gradient" in own or "stress" in own:
            slope = flow.gradient(x, t)
        if "gradient" in own:
            total["gradient"] = turn @ found["gradient"] @ turn.T + slope
        if "pressure" in own or "stress" in own:
            pressure = np.where(total["source"] == INSIDE, np.nan, flow.pressure(x, t))
        if "pressure" in own:
            total["pressure"] = found["pressure"] + pressure
        if "pressure_gradient" in own:
            total["pressure_gradient"] = found["pressure_gradient"] @ turn.T + flow.laplacian(x, t)
        if "stress" in own:
            newton = components(slope + slope.swapaxes(1, 2))
            newton[:, :3] -= pressure[:, None]
            total["stress"] = turned(found["stress"], turn) + newton
        return {name: total[name] for name in (*what, "source")}

    def surface(self, theta: Array, phi: Array) -> dict[str, Array]:
        """Points, normals and traction (n_theta, n_phi, 3) of the surface, in space.

        The traction sigma.n is the force of the fluid on the body per area. The velocity is the
        rigid one, exactly.
        """
        shape = self.disturbance.grid.shape
        body = shape.surface(theta[:, None], phi)
        normals = shape.normal(theta[:, None], phi) @ self.rotation.T
        points = body @ self.rotation.T + self.position
        # A hair outside, so that rounding does not put the points inside the body.
        held = on_surface(self.evaluate, points, normals, points)
        return held | {"velocity": self.disturbance.rigid(body) @ self.rotation.T}

    def relative_velocity(self, body_points: Array) -> Array:
        """Velocity (N, 3) relative to the body at points of the body frame, in the body frame.

        It vanishes on the surface and has no component through it, so that its path lines do not
        cross it.
        """
        u = self.disturbance.evaluate(body_points, tolerance=1e-10, method="table")["velocity"]
        space = body_points @ self.rotation.T + self.position
        background = self.flow.velocity(space, self.time) @ self.rotation
        return np.asarray(u + background - self.disturbance.rigid(body_points))


def in_blocks(
    points: Array, size: int, evaluate: Callable[[Array], dict[str, AnyArray]]
) -> dict[str, AnyArray]:
    """What `evaluate` makes of points (N, 3), `size` of them at a time."""
    blocks = range(0, max(len(points), 1), size)
    parts = [evaluate(points[begin : begin + size]) for begin in blocks]
    if len(parts) == 1:
        return parts[0]
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def on_surface(
    evaluate: Callable[[Array, Collection[str]], dict[str, AnyArray]],
    points: Array,
    normals: Array,
    outside: Array,
) -> dict[str, Array]:
    """Points and normals (n_theta, n_phi, 3) of a surface with its traction and pressure.

    outside: where the flow is looked at instead of the points.
    """
    values = evaluate(outside.reshape(-1, 3), ("pressure", "stress"))
    stress = symmetric(values["stress"]).reshape(*points.shape, 3)
    return {
        "points": points,
        "normals": normals,
        "traction": np.einsum("...ij,...j->...i", stress, normals),
        "pressure": values["pressure"].reshape(points.shape[:-1]),
    }


def sizes(speed: float, length: float) -> dict[str, float]:
    """Sizes of a motion and its drag at a speed and a length."""
    return {
        "velocity": speed,
        "angular_velocity": speed / length,
        "force": 6.0 * np.pi * length * speed,
        "torque": 8.0 * np.pi * length**2 * speed,
    }


def resistance_disturbance(
    operators: SurfaceOperators,
    background: Velocity,
    velocity: Array,
    angular_velocity: Array,
    solver: SolverFactory = DirectSolver,
    degree: int | None = None,
) -> Disturbance:
    """Disturbance of a body of given motion in the background flow (body frame)."""
    points = operators.grid.points
    velocity, spin = np.asarray(velocity, float), np.asarray(angular_velocity, float)
    data = velocity + np.cross(spin, points) - background(points)
    density = solver(operators.resistance, operators.grid).solve(data)
    force, torque = operators.force_of(density)
    return _disturbance(operators, density, (-force, -torque), (velocity, spin), background, degree)


def mobility_disturbance(
    operators: SurfaceOperators,
    background: Velocity,
    force: Array | None = None,
    torque: Array | None = None,
    solver: SolverFactory = DirectSolver,
    degree: int | None = None,
) -> Disturbance:
    """Disturbance of a free body, pushed by an outer force and torque (3,), body frame."""
    zero = np.zeros(3)
    force = zero if force is None else np.asarray(force, float)
    torque = zero if torque is None else np.asarray(torque, float)
    data = -background(operators.grid.points) - completion_velocity(operators, force, torque)
    density = solver(operators.mobility, operators.grid).solve(data)
    motion = operators.motion_of(density)
    return _disturbance(operators, density, (force, torque), motion, background, degree)


def _disturbance(
    operators: SurfaceOperators,
    density: Array,
    loads: tuple[Array, Array],
    motion: tuple[Array, Array],
    background: Velocity,
    degree: int | None,
) -> Disturbance:
    limit, layers = layer_limit(operators, density, *loads)
    velocity, spin = motion

    def boundary(points: Array) -> Array:
        return np.asarray(velocity + np.cross(spin, points) - background(points))

    return Disturbance(
        operators.grid,
        limit,
        degree,
        boundary,
        layers,
        force=loads[0],
        torque=loads[1],
        body_velocity=velocity,
        angular_velocity=spin,
        background=background,
    )
