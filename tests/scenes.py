"""Random scenes and the symmetries that every motion in them must have."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qbxstokes.bie.accuracy import AccurateBody, accurate_body
from qbxstokes.bie.faxen import stokes_polynomials
from qbxstokes.bie.operators import surface_operators
from qbxstokes.bie.providers import SolveMotion
from qbxstokes.bie.resolution import flow_nodes, resolving_nodes
from qbxstokes.flows import PolynomialFlow
from qbxstokes.flows.singularities import Rotlet, Stokeslet, Stresslet
from qbxstokes.geometry import rotation
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.motion.equations import RigidBodyEquations
from qbxstokes.reference import faxen

Array = NDArray[np.float64]

# Rounding of sums whose terms have the size of the scene's scale.
ROUNDING = 1e-14
# Two ways to the same motion from the same operator.
AGREEMENT = 1e-12
# Trajectories take other steps in another frame.
TOLERANCE = 1e-10
MOTION = 20.0 * TOLERANCE


@lru_cache(maxsize=64)
def body_of(aspect_ratio: float, tolerance: float = 1e-11) -> AccurateBody:
    """The hydrodynamics of a body as good as can be had, formed once in this run."""
    return accurate_body(Spheroid(aspect_ratio), tolerance, strict=False)


@dataclass(frozen=True)
class Scene:
    """A body in a polynomial flow: where it is and how it lies and moves (space frame)."""

    aspect_ratio: float
    flow: PolynomialFlow
    position: Array
    quaternion: Array
    velocity: Array
    angular_velocity: Array

    @property
    def scale(self) -> float:
        """Size of the terms that the motion is summed from."""
        size = max(1.0, self.aspect_ratio)
        tensors = self.flow.derivatives(self.position)
        return float(sum(np.abs(d).sum() * size**n for n, d in enumerate(tensors)))

    @property
    def motion_scale(self) -> Array:
        """The same for velocity, angular velocity, force and torque, (4,)."""
        r = body_of(self.aspect_ratio).model.resistance
        own = float(np.abs(self.velocity).sum() + np.abs(self.angular_velocity).sum())
        force = max(r.translation_transverse, r.translation_axial)
        torque = max(r.rotation_transverse, r.rotation_axial)
        s = self.scale
        return np.array([s, s, force * (s + own), torque * (s + own)])

    def motion(self) -> Array:
        """Free velocity and angular velocity, force and torque of the moving body, (4, 3)."""
        model = body_of(self.aspect_ratio).model
        equations = RigidBodyEquations(model, self.flow, 1.0)
        state = equations.initial_state(
            self.position, self.quaternion, self.velocity, self.angular_velocity
        )
        free = RigidBodyEquations(model, self.flow, 0.0).velocities(0.0, state[:, :7])
        return np.concatenate([*free, *equations.force_torque(0.0, state)])

    def state(self, stokes_number: float) -> tuple[RigidBodyEquations, Array]:
        """Equations of motion and the start (1, n_state), with the flow if massless."""
        model = body_of(self.aspect_ratio).model
        equations = RigidBodyEquations(model, self.flow, stokes_number)
        velocities = (self.velocity, self.angular_velocity) if stokes_number else (None, None)
        return equations, equations.initial_state(self.position, self.quaternion, *velocities)


def random_scene(rng: np.random.Generator, aspect_ratios: tuple[float, ...] = ()) -> Scene:
    """Any body between 1/20 and 20 (or one of the given) in any flow of degree 0 to 3."""
    k = (
        float(rng.choice(np.array(aspect_ratios)))
        if aspect_ratios
        else float(np.exp(rng.uniform(-math.log(20.0), math.log(20.0))))
    )
    tensors = [rng.standard_normal(3)]
    for degree in (1, 2, 3):
        basis = stokes_polynomials(degree)
        size = 0.5 * rng.integers(0, 2) * max(1.0, k) ** (1 - degree)
        tensors.append(size * np.tensordot(rng.standard_normal(len(basis)), basis, axes=1))
    return Scene(
        k,
        PolynomialFlow(*tensors),
        rng.uniform(-2.0, 2.0, 3),
        rotation.random_quaternions(1, rng)[0],
        rng.standard_normal(3),
        rng.standard_normal(3),
    )


def _moved(scene: Scene, turn: Array) -> Scene:
    """The scene carried by an orthogonal matrix, which may be a reflection."""
    axis = turn @ rotation.axis(scene.quaternion)
    hand = np.linalg.det(turn)
    return replace(
        scene,
        flow=scene.flow.rotated(turn),
        position=turn @ scene.position,
        # The body is one of revolution: any quaternion with this axis is the same body.
        quaternion=rotation.from_axis(axis),
        velocity=turn @ scene.velocity,
        angular_velocity=hand * (turn @ scene.angular_velocity),
    )


def _carrier(turn: Array) -> Callable[[Array], Array]:
    """How velocity, angular velocity, force and torque follow a matrix: the axial ones by hand."""
    hand = np.array([1.0, np.linalg.det(turn), 1.0, np.linalg.det(turn)])
    return lambda motion: hand[:, None] * (motion @ turn.T)


def rotated(scene: Scene, rng: np.random.Generator) -> tuple[Scene, Callable[[Array], Array]]:
    """The whole scene turned."""
    turn = rotation.matrix(rotation.random_quaternions(1, rng)[0])
    return _moved(scene, turn), _carrier(turn)


def mirrored(scene: Scene, rng: np.random.Generator) -> tuple[Scene, Callable[[Array], Array]]:
    """The whole scene in a mirror."""
    normal = rotation.random_axes(1, rng)[0]
    mirror = np.eye(3) - 2.0 * np.outer(normal, normal)
    return _moved(scene, mirror), _carrier(mirror)


def relabelled(scene: Scene, rng: np.random.Generator) -> tuple[Scene, Callable[[Array], Array]]:
    """The coordinate axes named and directed anew."""
    matrix = np.eye(3)[rng.permutation(3)] * rng.choice([-1.0, 1.0], 3)
    return _moved(scene, matrix), _carrier(matrix)


def reversed_flow(scene: Scene, rng: np.random.Generator) -> tuple[Scene, Callable[[Array], Array]]:
    """Flow and motion of the body with the other sign."""
    other = replace(
        scene,
        flow=scene.flow.scaled(-1.0),
        velocity=-scene.velocity,
        angular_velocity=-scene.angular_velocity,
    )
    return other, lambda motion: -motion


def reversed_axis(scene: Scene, rng: np.random.Generator) -> tuple[Scene, Callable[[Array], Array]]:
    """The body turned end over end and about its axis: it is the same body."""
    angle = rng.uniform(0.0, 2.0 * math.pi)
    spin = np.array([math.cos(angle), 0.0, 0.0, math.sin(angle)])
    flipped = rotation.multiply(scene.quaternion, [0.0, 1.0, 0.0, 0.0])
    return replace(scene, quaternion=rotation.multiply(flipped, spin)), lambda motion: motion


def displaced(scene: Scene, rng: np.random.Generator) -> tuple[Scene, Callable[[Array], Array]]:
    """Flow and body moved together."""
    step = rng.uniform(-3.0, 3.0, 3)
    moved = replace(scene, flow=scene.flow.shifted(step), position=scene.position + step)
    return moved, lambda motion: motion


SYMMETRIES = {
    "rotation": rotated,
    "mirror": mirrored,
    "axes relabelled": relabelled,
    "sign": reversed_flow,
    "body turned over": reversed_axis,
    "displacement": displaced,
}
# The sign of a flow turns an inertial motion into another one.
CARRIED = [name for name in SYMMETRIES if name != "sign"]


def symmetry_error(scene: Scene, name: str, rng: np.random.Generator) -> float:
    """Largest difference between the motion carried along and that of the scene carried along."""
    other, carried = SYMMETRIES[name](scene, rng)
    difference = np.abs(other.motion() - carried(scene.motion())).max(axis=1)
    return float(np.max(difference / scene.motion_scale))


def trajectory_error(
    scene: Scene, name: str, stokes_number: float, rng: np.random.Generator
) -> float:
    """Difference of position and axis after a motion, relative to the way and to 1."""
    from qbxstokes.petsc.stepper import integrate

    other, carried = SYMMETRIES[name](scene, rng)
    times = np.array([0.0, 1.5, 3.0]) / max(1.0, scene.scale)
    runs = [integrate(*one.state(stokes_number), times, TOLERANCE) for one in (scene, other)]
    (x, d), (y, e) = (
        (run.states[:, 0, :3] - run.states[0, 0, :3], rotation.axis(run.states[:, 0, 3:7]))
        for run in runs
    )
    # Position and axis follow as velocity and force do; a body has no sign of its axis.
    moved = carried(np.stack([x[-1], 0.0 * x[-1], d[-1], 0.0 * x[-1]]))
    turn = min(np.abs(e[-1] - moved[2]).max(), np.abs(e[-1] + moved[2]).max())
    way = np.abs(y[-1] - moved[0]).max() / max(1.0, np.abs(x).max())
    return float(max(turn, way))


def time_reversal_error(scene: Scene) -> float:
    """How far a massless body ends from its start when the flow is turned round halfway."""
    from qbxstokes.petsc.stepper import integrate

    times = np.array([0.0, 3.0 / max(1.0, scene.scale)])
    there, start = scene.state(0.0)
    end = integrate(there, start, times, TOLERANCE).states[-1]
    back, _ = replace(scene, flow=scene.flow.scaled(-1.0)).state(0.0)
    again = integrate(back, end, times, TOLERANCE).states[-1]
    turn = rotation.axis(again[0, 3:7]) - rotation.axis(start[0, 3:7])
    way = np.abs(end[0, :3] - start[0, :3]).max()
    distance = np.abs(again[0, :3] - start[0, :3]).max() / max(1.0, way)
    return float(max(np.abs(turn).max(), distance))


def solve_error(scene: Scene) -> float:
    """The table on monomials against a solve of the integral equation, free and forced."""
    body = body_of(scene.aspect_ratio)
    operators = surface_operators(Spheroid(scene.aspect_ratio), body.scheme, 10)
    solve = SolveMotion(operators, scene.flow)
    x, q = scene.position[None], scene.quaternion[None]
    free = solve.free_motion(0.0, x, q)
    forced = solve.force_torque(0.0, x, q, scene.velocity[None], scene.angular_velocity[None])
    difference = np.abs(np.concatenate([*free, *forced]) - scene.motion()).max(axis=1)
    return float(np.max(difference / scene.motion_scale))


def phase_period(times: Array, axes: Array, aspect_ratio: float) -> tuple[float, float]:
    """Period 2 pi/|slope| of the phase atan2(b, k a), and its largest residual in radians.

    times (T,), axes (T, 3), at least twice a period. The phase is linear in time on a Jeffery
    orbit; least squares, the residual is its deviation from uniform progress.
    """
    angle = np.unwrap(np.arctan2(axes[:, 1], aspect_ratio * axes[:, 0]))
    centred = times - times.mean()
    slope = float(centred @ (angle - angle.mean()) / (centred @ centred))
    residual = float(np.max(np.abs(angle - angle.mean() - slope * centred)))
    return 2.0 * np.pi / abs(slope), residual


# -- bodies in flows that are not polynomials as well ----------------------------------------------


def random_sample(rng: np.random.Generator, extreme: float = 50.0) -> tuple[float, Array, Any]:
    """Aspect ratio, orientation (a quaternion) and flow about the body at the origin."""
    k = float(extreme ** rng.uniform(-1.0, 1.0))
    q = rotation.random_quaternions(1, rng)[0]
    if rng.uniform() < 0.5:
        degree = int(rng.integers(1, 4))
        parts = [rng.normal(size=3)]
        for order in (1, 2, 3):
            basis = stokes_polynomials(order)
            weights = rng.normal(size=len(basis)) * (order <= degree)
            parts.append(np.tensordot(weights, basis, axes=1))
        return k, q, PolynomialFlow(*parts)
    place = rotation.random_axes(1, rng)[0] * max(1.0, k) * rng.uniform(1.5, 5.0)
    kind = int(rng.integers(3))
    if kind == 2:
        strain = rng.normal(size=(3, 3))
        strain += strain.T
        strain -= np.trace(strain) / 3.0 * np.eye(3)
        return k, q, Stresslet(strain, place)
    return k, q, (Stokeslet, Rotlet)[kind](rng.normal(size=3), place)


def examine(k: float, q: Array, flow: Any, tolerance: float) -> tuple[float, float]:
    """True error and estimate of free motion and of force and torque of the body held fixed.

    The largest of the four, each relative to its own length, against Faxen's laws of the ellipsoid
    (Kim & Karrila 1991, chapter 3).
    """
    body, turn = accurate_body(Spheroid(k), tolerance, degree=flow.degree or 3), rotation.matrix(q)

    def velocity(points: Array) -> Array:
        return flow.velocity(points @ turn.T) @ turn

    n_theta, n_phi, left = body.functional.grid.n_theta, 8, 0.0
    if flow.polynomial is None:
        share = 0.1 * tolerance  # as in a run
        start = flow_nodes(float(np.max(Spheroid(k).decay(flow.singular_points @ turn))), share)
        n_theta, n_phi, left = resolving_nodes(body.functional, velocity, share, start)
    grid = body.functional.on_grid(n_phi, n_theta)
    motion = np.einsum("anj,nj->a", grid.weights, velocity(grid.points)).reshape(2, 3)
    r = body.model.resistance
    force = np.array([r.translation_transverse, r.translation_transverse, r.translation_axial])
    torque = np.array([r.rotation_transverse, r.rotation_transverse, r.rotation_axial])
    found = np.array([*motion, force * motion[0], torque * motion[1]]) @ turn.T
    scene = (k, turn, np.zeros(3), flow.velocity, 150)
    exact = np.array([*faxen.free_motion(*scene), *faxen.fixed_force_torque(*scene)])
    errors = np.linalg.norm(found - exact, axis=1) / np.linalg.norm(exact, axis=1)
    return float(errors.max()), body.model.error_estimate + left
