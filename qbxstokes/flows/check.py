"""Is it a Stokes flow, and does it stay regular where the body is?"""

from dataclasses import dataclass
from functools import cache
from weakref import WeakSet

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.errors import FlowError
from qbxstokes.flows.base import Flow
from qbxstokes.flows.differences import curl, gradient_of, laplacian_gradient_of
from qbxstokes.flows.domain import Outline
from qbxstokes.typing import Array

# Least velocity gradient that residuals are compared with, in |u|/radius: the derivatives of a
# user's function are differences and carry the rounding of the velocity.
_LEAST_GRADIENT = 1e-3
# Random points, and the residual that is accepted at them.
_POINTS, _TOLERANCE = 40, 1e-6
# Part of the variation over a sphere by which its mean may miss that of a regular flow.
_IRREGULAR = 1e-5
# Radii of the spheres about one centre, over that of the largest.
_PARTS = (1.0, 0.75, 0.5, 0.25)
# Balls that are computed together.
_AT_ONCE = 100
# Flows of one gradient everywhere that have passed: they need no second look elsewhere.
PASSED: WeakSet[Flow] = WeakSet()
# Points and levels of extrapolation of a look that is made often.
_FEW, _SHORT = 10, 4


@dataclass(frozen=True)
class StokesianReport:
    """Largest residuals found, relative to the velocity gradient, and where the worst one is.

    divergence: |div u|/G; vorticity_of_laplacian: |curl Lap u| radius^2/G, with G the largest
    velocity gradient (Frobenius) over the points; point: (3,) of the larger of the two.
    """

    divergence: float
    vorticity_of_laplacian: float
    point: Array
    tolerance: float


def seems_stokesian(
    flow: Flow, centre: ArrayLike, radius: float, t: float, local: bool = False
) -> bool:
    """Whether a user's flow passes `check_stokesian` by short differences at few points.

    They are less exact: what they do not let pass may be right.
    """
    points = _points_in_ball(flow, np.asarray(centre, dtype=float), radius, 1, _FEW)

    def field(x: Array) -> Array:
        return flow.velocity(x, t)

    with np.errstate(all="ignore"):
        gradient = gradient_of(field, points, flow.difference_step(points), _SHORT)
        off = np.abs(np.trace(gradient, axis1=-2, axis2=-1)).max()
        if not local:
            steps = flow.difference_step(points, radius)
            twist = curl(laplacian_gradient_of(field, points, steps, _SHORT))
            off = max(off, radius**2 * np.linalg.norm(twist, axis=-1).max())
        return bool(off <= 1e-6 * np.linalg.norm(gradient, axis=(-1, -2)).max())


def check_stokesian(
    flow: Flow,
    centre: ArrayLike = (0.0, 0.0, 0.0),
    radius: float = 2.0,
    t: float = 0.0,
    local: bool = False,
) -> StokesianReport:
    """Check div u = 0 and curl Lap u = 0 at random points of the ball |x - centre| < radius.

    The points fill the ball, the place of the body included (a background flow extends through
    it); those within radius/4 of a declared singular point are drawn anew. Residuals are
    relative to the largest velocity gradient G in the ball (with the radius as length); G counts
    as at least 1e-3 |u|/radius. Honest user functions stay below 2e-7 (a stokeslet half a radius
    away is the worst seen), all other flows below 1e-8. local: where first and second derivatives
    at the centre alone move the body, div u = 0 is enough: they are those of a Stokes flow.
    Raises FlowError with residual and point if one exceeds 1e-6, or if the velocity is
    not finite somewhere.
    """
    points = _points_in_ball(flow, np.asarray(centre, dtype=float), radius, 0, _POINTS)
    with np.errstate(all="ignore"):
        velocity = flow.velocity(points, t)
        gradient = flow.gradient(points, t)
        twist = np.zeros(len(points))
        if not local:
            twist = np.linalg.norm(flow.vorticity_of_laplacian(points, t, radius), axis=-1)
        speeds = np.linalg.norm(velocity, axis=-1)
        gradients = np.linalg.norm(gradient, axis=(-1, -2))
    divergence = np.abs(np.trace(gradient, axis1=-2, axis2=-1))
    # Norms of what is too large for a square are infinite as well.
    finite = np.isfinite(speeds) & np.isfinite(gradients) & np.isfinite(twist)
    if not finite.all():
        where = _text(points[np.argmin(finite)])
        raise FlowError(
            f"the flow or its derivatives are too large or not finite at {where}, near the body"
        )
    scale, speed = float(gradients.max()), float(speeds.max())
    scale = max(scale, _LEAST_GRADIENT * speed / radius)
    if scale == 0.0:
        return StokesianReport(0.0, 0.0, points[0], _TOLERANCE)
    residuals = np.stack([divergence, twist * radius**2]) / scale
    kind, index = np.unravel_index(residuals.argmax(), residuals.shape)
    worst = float(residuals[kind, index])
    if worst > _TOLERANCE:
        what = (
            "divergence of the velocity" if kind == 0 else "curl of the Laplacian of the velocity"
        )
        small = "; a body much smaller than its scale may take hydrodynamics.derivatives: 1"
        raise FlowError(
            f"the flow is not Stokesian: the {what} is {worst:.3g} (relative to the velocity "
            f"gradient) at {_text(points[index])} and must vanish to {_TOLERANCE:.3g}"
            + (small if kind and flow.degree is None else "")
        )
    if flow.degree in (0, 1) and flow.surely_stokesian:
        PASSED.add(flow)
    return StokesianReport(
        float(residuals[0].max()), float(residuals[1].max()), points[index].copy(), _TOLERANCE
    )


def _points_in_ball(flow: Flow, centre: Array, radius: float, seed: int, count: int) -> Array:
    points, singular = centre + radius * _unit_ball(seed, 50 * count), flow.singular_points
    if len(singular):
        separation = np.linalg.norm(points[:, None, :] - singular, axis=-1).min(axis=-1)
        # Where singularities crowd the ball, the farthest points are the best there are.
        clear = separation > 0.25 * radius
        points = points[clear] if clear.sum() >= count else points[np.argsort(-separation)]
    return points[:count]


@cache
def _unit_ball(seed: int, count: int) -> Array:
    """Points at random (count, 3)."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    return np.asarray(rng.uniform(size=(count, 1)) ** (1.0 / 3.0) * directions)


def check_regular(flow: Flow, centre: ArrayLike, axis: ArrayLike, shape: Outline) -> None:
    """Refuse a flow that is singular inside the body, whether or not it says so.

    centre, axis (3,). Where a Stokes flow is regular, its mean over a sphere of radius r is
    u + r^2 Lap u/6 with the values of the centre (Pizzetti 1909, Rend. Lincei 18, 182, for
    biharmonic functions), so that (mean - u)/r^2 is the same for all spheres about one centre.
    Spheres fill the body but for a tenth at its surface, where the surface grid itself sees what is
    too near. A second quadrature bounds the error of the first, as that from a singular point
    outside. A flat body is searched in part (`Shape.interior_balls`).
    Raises FlowError with the place.
    """
    middle, along = np.asarray(centre, dtype=float), np.asarray(axis, dtype=float)
    centres, radii = shape.interior_balls()
    first = np.cross(along, np.eye(3)[int(np.argmin(np.abs(along)))])
    first /= np.linalg.norm(first)
    centres = middle + centres @ np.stack([first, np.cross(along, first), along])
    for start in range(0, len(radii), _AT_ONCE):
        balls = slice(start, start + _AT_ONCE)
        excess = _irregularity(flow, centres[balls], radii[balls])
        if np.any(excess > 1.0):  # what is not finite is left to the checks that say so
            worst = start + int(np.nanargmax(excess))
            raise FlowError(
                f"the flow is singular inside the body, within {radii[worst]:.3g} of "
                f"{_text(centres[worst])}: its means over spheres there are not those of a Stokes "
                "flow"
            )


def _irregularity(flow: Flow, centres: Array, radii: Array) -> Array:
    """Largest difference of (mean - u)/r^2 between two spheres over what it may be, (n,)."""
    with np.errstate(all="ignore"):
        values = flow.velocity(centres)[:, None, :]
        noise = 1e-13 * np.abs(values).max(axis=(1, 2))
        terms, errors = [], []
        for part in _PARTS:
            means = []
            for nodes, weights in (_sphere(6), _sphere(8)):
                points = centres[:, None, :] + part * radii[:, None, None] * nodes
                moved = flow.velocity(points) - values
                means.append(np.einsum("bni,n->bi", moved, weights))
            rough, fine = means
            size = np.abs(moved).max(axis=(1, 2))
            # Ten times the difference of two rules, for they may err alike.
            allowed = 10.0 * np.abs(fine - rough).max(axis=1) + _IRREGULAR * size + noise
            terms.append(fine / part**2)
            errors.append(allowed / part**2)
        pairs = [(i, j) for i in range(len(_PARTS)) for j in range(i)]
        apart = [np.abs(terms[i] - terms[j]).max(axis=1) for i, j in pairs]
        allowed_apart = [errors[i] + errors[j] for i, j in pairs]
        return np.asarray(np.max(np.divide(apart, allowed_apart), axis=0))


@cache
def _sphere(n: int) -> tuple[Array, Array]:
    """Nodes (2 n^2, 3) and weights of the mean over the unit sphere, exact to degree 2 n - 1."""
    z, weights = np.polynomial.legendre.leggauss(n)
    phi = np.pi * (np.arange(2 * n) + 0.5) / n
    s = np.sqrt(1.0 - z * z)[:, None]
    nodes = np.stack(np.broadcast_arrays(s * np.cos(phi), s * np.sin(phi), z[:, None]), axis=-1)
    return nodes.reshape(-1, 3), np.repeat(weights, 2 * n) / (4.0 * n)


def _text(point: Array) -> str:
    return "(" + ", ".join(f"{value:.6g}" for value in point) + ")"


def check_singularities(
    flow: Flow, centre: ArrayLike, axis: ArrayLike, shape: Outline, minimum: float = 0.0
) -> float:
    """Least distance of the flow's singular points from the body; infinite if there are none.

    centre and axis: (3,), or (..., 3) for several bodies. Raises FlowError if the distance is
    not above `minimum` (a singular point inside the body has a negative one).
    """
    points = flow.singular_points
    if len(points) == 0:
        return float("inf")
    distance = shape.clearance(points, centre, axis)
    least = float(distance.min())
    if least <= minimum:
        worst = points[np.unravel_index(distance.argmin(), distance.shape)[-1]]
        where = "inside the body" if least < 0.0 else f"{least:.3g} from its surface"
        right = f" and must be more than {minimum:.3g} away" if minimum > 0.0 or least >= 0 else ""
        raise FlowError(f"the flow is singular at {_text(worst)}, {where}{right}")
    return least
