"""Source rules for one expansion centre: panels graded to the centre, or uniform upsampling.

A rule is the tuple (theta_nodes, theta_weights, phi_start, phi_stop, phi_nodes, phi_weights):
theta node i carries the azimuthal nodes phi_start[i]:phi_stop[i] on [0, pi], whose weights count
both halves of the circle.
"""

import numpy as np

from qbxstokes.geometry.grid import PolarNodes, gauss_legendre, polar_rule
from qbxstokes.geometry.shape import Revolution
from qbxstokes.typing import Array, Integers

Rule = tuple[Array, Array, Integers, Integers, Array, Array]

MAX_DEPTH = 100
# Points of a panel at which its distance to the centre is looked up.
_SAMPLES = np.arange(9) / 8.0


def _look(
    shape: Revolution, a: Array, b: Array, phi: Array, cx: float, cz: float
) -> tuple[Array, ...]:
    """Of panels [a, b] of a meridian: length (bound), least distance at phi, largest radius."""
    theta = a[:, None] + (b - a)[:, None] * _SAMPLES
    (rho, z), (d_rho, d_z) = shape.meridian(theta), shape.tangent(theta)
    longest = np.sqrt(np.max(d_z * d_z + d_rho**2, axis=1))
    square = (rho * np.cos(phi)[:, None] - cx) ** 2 + (z - cz) ** 2
    square += (rho * np.sin(phi)[:, None]) ** 2
    return (b - a) * longest, np.sqrt(np.min(square, axis=1)), np.max(rho, axis=1)


def graded_rule(
    shape: Revolution,
    theta_target: float,
    side: int,
    radius: float,
    ratio: float,
    order: int,
    longest: tuple[float, float],
) -> Rule:
    """Panels split until both their lengths are at most ratio times their distance to the centre.

    order: nodes of Gauss and Legendre's rule on every panel and direction. longest: bounds on a
    panel's angles that keep the density and the azimuthal modes resolved. A panel is a rectangle of
    angles and is halved along its longer side; each brings its own theta nodes, so that equal ones
    may occur more than once.
    """
    at = np.asarray(theta_target)
    (rho, z), (d_rho, d_z), speed = shape.meridian(at), shape.tangent(at), shape.speed(at)
    cx = float(rho - side * radius * d_z / speed)
    cz = float(z + side * radius * d_rho / speed)
    panels = np.array([[0.0, np.pi, 0.0, np.pi]])
    finished = []
    for depth in range(MAX_DEPTH + 1):
        a, b, low, high = panels.T
        length, nearest, widest = _look(shape, a, b, low, cx, cz)
        arc = (high - low) * widest
        # The longer side first: thin bodies need no cut around their waist.
        tall = (length > ratio * nearest) & (length >= arc) | (b - a > longest[0])
        wide = (arc > ratio * nearest) & (arc > length) | (high - low > longest[1])
        if depth == MAX_DEPTH:
            tall[:] = wide[:] = False
        finished.append(panels[~(tall | wide)])
        panels = np.concatenate(
            [
                _halves(panels[tall & ~wide], 0),
                _halves(panels[wide & ~tall], 2),
                _halves(_halves(panels[tall & wide], 0), 2),
            ]
        )
        if not len(panels):
            break
    a, b, low, high = np.concatenate(finished).T
    x, w = gauss_legendre(order)
    start = np.repeat(order * np.arange(a.size), order)
    return *_nodes(a, b, x, 0.5 * w), start, start + order, *_nodes(low, high, x, w)


def _halves(panels: Array, side: int) -> Array:
    """Panels (n, 4) cut in two along theta (side 0) or phi (side 2)."""
    first, second = panels.copy(), panels.copy()
    first[:, side + 1] = second[:, side] = 0.5 * (panels[:, side] + panels[:, side + 1])
    return np.concatenate([first, second])


def _nodes(low: Array, high: Array, x: Array, w: Array) -> tuple[Array, Array]:
    """Nodes and weights of the rule (x, w) moved to each panel, one panel after the other."""
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    return (middle[:, None] + half[:, None] * x).ravel(), np.outer(high - low, w).ravel()


def uniform_rule(n_theta: int, n_phi: int, nodes: PolarNodes = "theta") -> Rule:
    """Gauss-Legendre in theta (Bagge 2015, 5.3.3) or cos(theta), trapezoid in phi.

    The trapezoid rule over the whole circle is folded onto [0, pi] by the mirror symmetry of the
    kernel in phi, which changes nothing: the target sits at phi = 0, a node of the rule.
    """
    j = np.arange(n_phi // 2 + 1)
    weights = np.full(j.size, 4.0 * np.pi / n_phi)
    weights[0] /= 2.0
    if n_phi % 2 == 0:
        weights[-1] /= 2.0
    start, stop = np.zeros(n_theta, np.int64), np.full(n_theta, j.size, np.int64)
    return *polar_rule(n_theta, nodes), start, stop, 2.0 * np.pi * j / n_phi, weights
