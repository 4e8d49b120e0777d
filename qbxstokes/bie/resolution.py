"""How many nodes of the surface resolve a background flow, and what error a grid leaves.

Known beforehand where the flow's singular points are (the rate of decay of their harmonics on the
surface), and otherwise found by comparing the free motion on two grids.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from qbxstokes.bie.functional import ModalFunctional
from qbxstokes.errors import FlowError
from qbxstokes.typing import Array

# Polar nodes that hold the density of a polynomial flow of degree <= 3, with two to show its decay.
POLYNOMIAL_NODES = 6
# A grid for a singular flow never exceeds this many polar nodes: the flow is refused as too near.
MOST_NODES = 160


def flow_nodes(rate: float, tolerance: float) -> tuple[int, int]:
    """Polar and azimuthal nodes that resolve a flow of the given rate of decay (`Shape.decay`).

    The polar rule is Gauss's and gains the square of the rate per node. Raises FlowError if more
    than MOST_NODES would be needed.
    """
    # A stresslet's harmonics grow as the cube of the degree before they decay.
    digits = -math.log10(tolerance) + 1.0
    slope = -math.log10(rate) if rate > 0.0 else math.inf
    degree = digits / slope if slope > 0.0 else math.inf
    for _ in range(3):
        if math.isfinite(degree):
            degree = (digits + 3.0 * math.log10(max(1.0, degree * slope))) / slope
    if degree > 2 * MOST_NODES:
        least = 10.0 ** (-digits / (2.0 * MOST_NODES))
        raise FlowError(
            f"the flow's singularity is too near the body: its rate of decay {rate:.4f} on the "
            f"surface must stay below {least:.4f} for the tolerance {tolerance:.0e}"
        )
    n_theta = max(POLYNOMIAL_NODES, math.ceil(degree / 2.0) + 2)
    n_phi = max(8, math.ceil(degree) + 3)
    return n_theta, n_phi + n_phi % 2


def flow_error(
    functional: ModalFunctional, velocity: Callable[[Array], Array], n_theta: int, n_phi: int
) -> float:
    """Relative change of the free motion from the grid to one half as fine again.

    velocity: points (N, 3) of the body frame -> background velocity (N, 3) there. U and Omega are
    each measured by their own length, or, where symmetry makes them vanish, by a hundredth of the
    speed (difference of speed over the body's length) on the surface.
    """
    motions = []
    for polar, azimuthal in ((3 * n_theta // 2 + 2, 3 * n_phi // 2 + 2), (n_theta, n_phi)):
        grid = functional.on_grid(azimuthal, polar)
        u = velocity(grid.points)
        motions.append(np.einsum("anj,nj->a", grid.weights, u))
    # The finer grid errs as well, by much less.
    size = functional.grid.shape.radius
    return 1.5 * float(motion_change(motions[0], motions[1], flow_sizes(u), size))


def flow_sizes(u: Array) -> Array:
    """Largest speed and largest difference from the mean, (2, ...), of a flow (..., N, 3)."""
    variation = u - u.mean(axis=-2, keepdims=True)
    return np.stack([np.linalg.norm(v, axis=-1).max(axis=-1) for v in (u, variation)])


def motion_change(
    fine: Array, coarse: Array, sizes: Array, radius: float, allowed: Any = (0.0, 0.0)
) -> Array:
    """Relative difference (...) of free motions (..., 6) in a flow of the `flow_sizes` (2, ...).

    The larger one of U's and Omega's, with the scales of `flow_error`, or those that are `allowed`
    where these are larger.
    """
    scales = 0.01 * sizes[0], 0.01 * sizes[1] / radius
    # A uniform flow turns nothing: what it seems to turn is no error.
    rounding = 1e4 * scales[0] * float(np.finfo(float).eps)
    error = np.zeros(fine.shape[:-1])
    for first, least, known in zip((0, 3), scales, np.asarray(allowed), strict=True):
        part = slice(first, first + 3)
        scale = np.maximum(np.maximum(np.linalg.norm(fine[..., part], axis=-1), least), known)
        change = np.linalg.norm(fine[..., part] - coarse[..., part], axis=-1)
        change = np.maximum(0.0, change - rounding)
        error = np.maximum(error, change / np.where(scale > 0.0, scale, 1.0))
    return error


def resolving_nodes(
    functional: ModalFunctional,
    velocity: Callable[[Array], Array],
    tolerance: float,
    start: tuple[int, int] = (POLYNOMIAL_NODES, 8),
) -> tuple[int, int, float]:
    """Polar and azimuthal nodes for which `flow_error` meets the tolerance, and that error.

    Raises FlowError if MOST_NODES do not suffice.
    """
    n_theta, n_phi = start
    while True:
        error = flow_error(functional, velocity, n_theta, n_phi)
        if error <= tolerance:
            return n_theta, n_phi, error
        n_theta, n_phi = (5 * n_theta + 3) // 4, (5 * n_phi + 3) // 4
        n_phi += n_phi % 2
        if n_theta > MOST_NODES:
            raise FlowError(
                f"the flow varies too much over the body: its free motion still changes by "
                f"{error:.1e} at {n_theta} x {n_phi} points of the surface, more than the "
                f"tolerance {tolerance:.0e}"
            )
