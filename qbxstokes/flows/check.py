"""Is it a Stokes flow, and does it stay regular where the body is?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.errors import FlowError
from qbxstokes.flows.base import Array, Flow

# Least velocity gradient that residuals are compared with, in |u|/radius: the derivatives of a
# user's function are differences and carry the rounding of the velocity.
_LEAST_GRADIENT = 1e-3


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


def check_stokesian(
    flow: Flow,
    centre: ArrayLike = (0.0, 0.0, 0.0),
    radius: float = 2.0,
    seed: int = 0,
    tolerance: float = 1e-6,
    t: float = 0.0,
    n_points: int = 40,
) -> StokesianReport:
    """Check div u = 0 and curl Lap u = 0 at random points of the ball |x - centre| < radius.

    The points fill the ball, the place of the body included (a background flow extends through
    it); those within radius/4 of a declared singular point are drawn anew. Residuals are
    relative to the largest velocity gradient G in the ball (with the radius as length); G counts
    as at least 1e-3 |u|/radius. Honest user functions stay below 2e-7 (a stokeslet half a radius
    away is the worst seen), all other flows below 1e-8.
    Raises FlowError with residual and point if one exceeds `tolerance`, or if the velocity is
    not finite somewhere.
    """
    points = _points_in_ball(flow, np.asarray(centre, dtype=float), radius, seed, n_points)
    with np.errstate(all="ignore"):
        velocity = flow.velocity(points, t)
        gradient = flow.gradient(points, t)
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
        return StokesianReport(0.0, 0.0, points[0], tolerance)
    residuals = np.stack([divergence, twist * radius**2]) / scale
    kind, index = np.unravel_index(residuals.argmax(), residuals.shape)
    worst = float(residuals[kind, index])
    if worst > tolerance:
        what = (
            "divergence of the velocity" if kind == 0 else "curl of the Laplacian of the velocity"
        )
        raise FlowError(
            f"the flow is not Stokesian: the {what} is {worst:.3g} (relative to the velocity "
            f"gradient) at {_text(points[index])} and must vanish to {tolerance:.3g}"
        )
    return StokesianReport(
        float(residuals[0].max()), float(residuals[1].max()), points[index].copy(), tolerance
    )


def _points_in_ball(flow: Flow, centre: Array, radius: float, seed: int, count: int) -> Array:
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(50 * count, 3))
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    points = centre + radius * rng.uniform(size=(50 * count, 1)) ** (1.0 / 3.0) * directions
    singular = flow.singular_points
    if len(singular):
        separation = np.linalg.norm(points[:, None, :] - singular, axis=-1).min(axis=-1)
        # Where singularities crowd the ball, the farthest points are the best there are.
        clear = separation > 0.25 * radius
        points = points[clear] if clear.sum() >= count else points[np.argsort(-separation)]
    return points[:count]


def _text(point: Array) -> str:
    return "(" + ", ".join(f"{value:.6g}" for value in point) + ")"


def clearance(points: ArrayLike, centre: ArrayLike, axis: ArrayLike, aspect_ratio: float) -> Array:
    """Signed distance of points from spheroids, negative inside.

    points (m, 3); centre and axis (..., 3), the axis of unit length; semi-axes (k, k, 1).
    Returns (..., m). The nearest point of an ellipse is found from the one root t of
    (a y/(t+a^2))^2 + (b z/(t+b^2))^2 = 1 above -min(a, b)^2 by bisection (D. Eberly, Distance from
    a point to an ellipse, 2013).
    """
    k = float(aspect_ratio)
    middle = np.asarray(centre, dtype=float)[..., None, :]
    direction = np.asarray(axis, dtype=float)[..., None, :]
    arm = np.asarray(points, dtype=float) - middle
    height = np.abs(np.sum(arm * direction, axis=-1))
    width = np.linalg.norm(np.cross(direction, arm), axis=-1)
    low = np.maximum(k * (width - k), height - 1.0)
    high = np.hypot(k * width, height) - min(k, 1.0) ** 2
    tiny = np.finfo(float).tiny
    for _ in range(64):
        t = 0.5 * (low + high)
        across = k * width / np.maximum(t + k * k, tiny)
        along = height / np.maximum(t + 1.0, tiny)
        outside = across**2 + along**2 > 1.0
        low, high = np.where(outside, t, low), np.where(outside, high, t)
    across = np.minimum(k * width / np.maximum(high + k * k, tiny), 1.0)
    along = np.minimum(height / np.maximum(high + 1.0, tiny), 1.0)
    # On the focal segment or disc the coordinate along the shorter semi-axis is 0/0 there and
    # follows from the ellipse.
    if k < 1.0:
        across = np.where(high + k * k < 1e-14, np.sqrt(1.0 - along**2), across)
    else:
        along = np.where(high + 1.0 < 1e-14, np.sqrt(1.0 - across**2), along)
    distance = np.hypot(width - k * across, height - along)
    inside = (width / k) ** 2 + height**2 < 1.0
    return np.where(inside, -distance, distance)


def check_singularities(
    flow: Flow,
    centre: ArrayLike,
    axis: ArrayLike,
    aspect_ratio: float,
    minimum: float = 0.0,
) -> float:
    """Least distance of the flow's singular points from the body; infinite if there are none.

    centre and axis: (3,), or (..., 3) for several bodies. Raises FlowError if the distance is
    not above `minimum` (a singular point inside the body has a negative one).
    """
    points = flow.singular_points
    if len(points) == 0:
        return float("inf")
    distance = clearance(points, centre, axis, aspect_ratio)
    least = float(distance.min())
    if least <= minimum:
        worst = points[np.unravel_index(distance.argmin(), distance.shape)[-1]]
        where = "inside the body" if least < 0.0 else f"{least:.3g} from its surface"
        right = f" and must be more than {minimum:.3g} away" if minimum > 0.0 or least >= 0 else ""
        raise FlowError(f"the flow is singular at {_text(worst)}, {where}{right}")
    return least
