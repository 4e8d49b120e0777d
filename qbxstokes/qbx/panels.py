"""Source rules for one expansion centre: panels graded to the centre, or uniform upsampling.

A rule is the tuple (theta_nodes, theta_weights, phi_start, phi_stop, phi_nodes, phi_weights):
theta node i carries the azimuthal nodes phi_start[i]:phi_stop[i] on [0, pi], whose weights count
both halves of the circle.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

MAX_DEPTH = 60


@njit(cache=True)
def _distance(k, theta, phi, cx, cz):  # type: ignore[no-untyped-def]
    rho = k * math.sin(theta)
    dx = rho * math.cos(phi) - cx
    dy = rho * math.sin(phi)
    dz = math.cos(theta) - cz
    return math.sqrt(dx * dx + dy * dy + dz * dz)


@njit(cache=True)
def _theta_panel(k, a, b, phi, cx, cz):  # type: ignore[no-untyped-def]
    """Length of [a, b] along a meridian (bound), least distance of it at phi, largest radius."""
    longest = 0.0
    nearest = 1e300
    widest = 0.0
    for i in range(9):
        theta = a + (b - a) * i / 8.0
        s = math.sin(theta)
        longest = max(longest, math.hypot(s, k * math.cos(theta)))
        widest = max(widest, k * s)
        nearest = min(nearest, _distance(k, theta, phi, cx, cz))
    return (b - a) * longest, nearest, widest


@njit(cache=True)
def graded_rule(aspect_ratio, theta_target, side, radius, ratio, max_theta, max_phi, x, w):  # type: ignore[no-untyped-def]
    """Panels split until their length is at most ratio times their distance to the centre.

    x, w: Gauss-Legendre nodes and weights on [-1, 1] used on every panel and direction.
    max_theta, max_phi: bounds on a panel's angle that keep the density and the azimuthal modes
    resolved. Lists the theta panels first; each then carries its own azimuthal panels.
    """
    k = aspect_ratio
    q = math.hypot(math.sin(theta_target), k * math.cos(theta_target))
    cx = k * math.sin(theta_target) + side * radius * math.sin(theta_target) / q
    cz = math.cos(theta_target) + side * radius * k * math.cos(theta_target) / q
    panels = [(0.0, math.pi, 0)]
    edges = [(0.0, 0.0)]
    edges.clear()
    while len(panels) > 0:
        a, b, depth = panels.pop()
        length, nearest, _ = _theta_panel(k, a, b, 0.0, cx, cz)
        if depth < MAX_DEPTH and (length > ratio * nearest or b - a > max_theta):
            middle = 0.5 * (a + b)
            panels.append((middle, b, depth + 1))
            panels.append((a, middle, depth + 1))
        else:
            edges.append((a, b))
    n = x.size
    theta_nodes = np.empty(n * len(edges))
    theta_weights = np.empty(n * len(edges))
    phi_start = np.empty(n * len(edges), np.int64)
    phi_stop = np.empty(n * len(edges), np.int64)
    phi_edges = [(0.0, 0.0)]
    phi_edges.clear()
    for e in range(len(edges)):
        a, b = edges[e]
        start = len(phi_edges) * n
        panels.append((0.0, math.pi, 0))
        while len(panels) > 0:
            lo, hi, depth = panels.pop()
            _, nearest, widest = _theta_panel(k, a, b, lo, cx, cz)
            if depth < MAX_DEPTH and ((hi - lo) * widest > ratio * nearest or hi - lo > max_phi):
                middle = 0.5 * (lo + hi)
                panels.append((middle, hi, depth + 1))
                panels.append((lo, middle, depth + 1))
            else:
                phi_edges.append((lo, hi))
        for i in range(n):
            theta_nodes[e * n + i] = 0.5 * (a + b) + 0.5 * (b - a) * x[i]
            theta_weights[e * n + i] = 0.5 * (b - a) * w[i]
            phi_start[e * n + i] = start
            phi_stop[e * n + i] = len(phi_edges) * n
    phi_nodes = np.empty(n * len(phi_edges))
    phi_weights = np.empty(n * len(phi_edges))
    for e in range(len(phi_edges)):
        lo, hi = phi_edges[e]
        for i in range(n):
            phi_nodes[e * n + i] = 0.5 * (lo + hi) + 0.5 * (hi - lo) * x[i]
            phi_weights[e * n + i] = (hi - lo) * w[i]
    return theta_nodes, theta_weights, phi_start, phi_stop, phi_nodes, phi_weights


def uniform_rule(n_theta: int, n_phi: int) -> tuple[NDArray[Any], ...]:
    """Gauss-Legendre in theta and trapezoid in phi on the upsampled grid (Bagge 2015, 5.3.3).

    The trapezoid rule over the whole circle is folded onto [0, pi] by the mirror symmetry of the
    kernel in phi, which changes nothing: the target sits at phi = 0, a node of the rule.
    """
    x, w = np.polynomial.legendre.leggauss(n_theta)
    j = np.arange(n_phi // 2 + 1)
    weights = np.full(j.size, 4.0 * np.pi / n_phi)
    weights[0] /= 2.0
    if n_phi % 2 == 0:
        weights[-1] /= 2.0
    start = np.zeros(n_theta, np.int64)
    stop = np.full(n_theta, j.size, np.int64)
    return (np.pi * (x + 1) / 2, np.pi / 2 * w, start, stop, 2.0 * np.pi * j / n_phi, weights)
