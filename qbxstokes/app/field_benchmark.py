"""Accuracy and cost of the field, measured: against closed forms, and against plain upsampling."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qbxstokes.bie.accuracy import choose_scheme
from qbxstokes.bie.field import Disturbance, mobility_disturbance, resistance_disturbance
from qbxstokes.bie.operators import SurfaceOperators, surface_operators
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.reference import faxen
from qbxstokes.reference.translation import translating_flow

Array = NDArray[np.float64]

ASPECT_RATIOS = (1 / 20, 1 / 2, 2.0, 20.0)
TOLERANCES = (1e-6, 1e-8, 1e-10)
DISTANCES = (0.0, 1e-6, 1e-4, 1e-2, 0.1, 0.3, 1.0, 3.0, 10.0)
_VELOCITY = np.array([1.0, -2.0, 0.5])
_NODES = 8
_MOST_SECONDS = 1.0  # spent on timing one entry of the table of costs


def uniform_accuracy(
    aspect_ratios: Sequence[float] = ASPECT_RATIOS,
    tolerances: Sequence[float] = TOLERANCES,
    targets: int = 1_000_000,
    seed: int = 0,
) -> list[dict[str, Any]]:
    """Largest error over targets from the surface to ten body lengths, and the time per target.

    The exact flow is that of a translating body: as a resistance problem (given velocity) and as a
    mobility problem (pushed by the force that goes with it). Errors relative to the speed. Rows
    with aspect_ratio, problem, tolerance, error, seconds (for all targets), share of the tolerance.
    """
    rows = []
    for k in aspect_ratios:
        points = scattered_targets(k, targets, seed)
        exact = translating_flow(k, points, _VELOCITY)[0]
        speed = float(np.linalg.norm(_VELOCITY))
        for problem, make in (("resistance", _resistance), ("mobility", _mobility)):
            for tolerance in tolerances:
                begin = time.perf_counter()
                body = make(_operators(k, tolerance))
                found = body.evaluate(points, tolerance)[0]
                seconds = time.perf_counter() - begin
                error = float(np.abs(found - exact).max()) / speed
                rows.append(
                    {
                        "aspect_ratio": k,
                        "problem": problem,
                        "tolerance": tolerance,
                        "targets": targets,
                        "error": error,
                        "share": error / tolerance,
                        "seconds": seconds,
                    }
                )
    return rows


def costs(
    aspect_ratio: float = 0.5,
    distances: Sequence[float] = DISTANCES,
    tolerances: Sequence[float] = TOLERANCES,
) -> list[dict[str, Any]]:
    """Time per target against distance (in c) and tolerance, for the table, QBX and upsampling.

    Rows with distance, tolerance, microseconds by table and by quadrature chosen per target
    (method says which), and for plain quadrature the upsampling of an n_theta = 8 grid that the
    tolerance takes there with its microseconds; infinite where no upsampling suffices (on the
    surface) or where it was not run because it would take more than a thousand times the nodes.
    """
    rows = []
    spheroid = Spheroid(aspect_ratio)
    rng = np.random.default_rng(0)
    theta, phi = np.arccos(rng.uniform(-1, 1, 512)), rng.uniform(0, 2 * np.pi, 512)
    body = _resistance(_operators(aspect_ratio, 1e-12))
    for distance in distances:
        points = spheroid.surface(theta, phi) + distance * spheroid.normal(theta, phi)
        exact = translating_flow(aspect_ratio, points, _VELOCITY)[0]
        for tolerance in tolerances:
            limit = 0.1 * tolerance * body.scale

            def by_table(x: Array, limit: float = limit) -> Array:
                return body.table.evaluate(x, True, limit)[0]

            def by_quadrature(x: Array, tolerance: float = tolerance) -> Array:
                return body.potentials.evaluate(x, tolerance)[0]

            used = body.potentials.evaluate(points[:1], tolerance)[3]
            upsampling, plain = _plain(body, points, exact, tolerance)
            rows.append(
                {
                    "aspect_ratio": aspect_ratio,
                    "distance": distance,
                    "tolerance": tolerance,
                    "table": _microseconds(by_table, points),
                    "quadrature": _microseconds(by_quadrature, points),
                    "method": ("plain", "graded", "expansion")[int(used[0])],
                    "upsampling": upsampling,
                    "plain": plain,
                }
            )
    return rows


def scattered_targets(aspect_ratio: float, count: int, seed: int = 0) -> Array:
    """Points (count, 3) outside: a tenth on the surface, the rest at 1e-12 to 10 body lengths."""
    rng = np.random.default_rng(seed)
    theta, phi = np.arccos(rng.uniform(-1, 1, count)), rng.uniform(0, 2 * np.pi, count)
    distance = 2.0 * max(1.0, aspect_ratio) * 10.0 ** rng.uniform(-12, 1, count)
    distance[: count // 10] = 0.0
    body = Spheroid(aspect_ratio)
    return body.surface(theta, phi) + distance[:, None] * body.normal(theta, phi)


def _operators(k: float, tolerance: float) -> SurfaceOperators:
    return surface_operators(Spheroid(k), choose_scheme(tolerance, _NODES), 6)


def _nothing(points: Array) -> Array:
    return np.zeros_like(points)


def _resistance(operators: SurfaceOperators) -> Disturbance:
    return resistance_disturbance(operators, _nothing, _VELOCITY, np.zeros(3), degree=0)


def _mobility(operators: SurfaceOperators) -> Disturbance:
    across, along = faxen.resistance(operators.grid.spheroid.aspect_ratio)[:2]
    force = _VELOCITY * [across, across, along]
    return mobility_disturbance(operators, _nothing, force, degree=0)


def _microseconds(function: Callable[[Array], Array], points: Array) -> float:
    """Time per target of the function on as many of the points as the time allows."""
    count = 1
    while True:
        begin = time.perf_counter()
        function(points[:count])
        seconds = time.perf_counter() - begin
        if count >= len(points) or seconds > 0.1 * _MOST_SECONDS:
            return 1e6 * seconds / count
        count = min(4 * count, len(points))


def _plain(body: Disturbance, points: Array, exact: Array, tolerance: float) -> tuple[float, float]:
    """Upsampling that the worst of a few targets takes, and microseconds per target with it."""
    from qbxstokes.qbx.volume import plain_rule

    few = points[:8]
    upsampling = 1
    while upsampling <= 32:
        rule = plain_rule(upsampling * _NODES, 2 * upsampling * _NODES)

        def run(x: Array, rule: Any = rule) -> Array:
            return body.potentials.by_rule(x, rule)

        if np.abs(run(few) - exact[:8]).max() <= tolerance * body.scale:
            return float(upsampling), _microseconds(run, points)
        upsampling *= 2
    return math.inf, math.inf
