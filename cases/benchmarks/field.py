"""The field: error from the surface to ten body lengths; cost of a point over its distance.

The exact flow is that of a translating body (Chwang & Wu 1975), as a resistance problem (velocity
given) and as a mobility problem (pushed by the force that goes with it). Errors are over the speed,
costs in microseconds per point with pressure and stress. `plain` is plain quadrature of the
velocity with the upsampling of a grid of 8 by 16 that the tolerance takes there.

Run:      python cases/benchmarks/field.py      (1 min; --small: 5 s; --csv)
Expected: errors of a million points below every tolerance; a point costs a microsecond at any
          distance by the table of harmonics, and near the surface plain upsampling cannot follow.
"""

import time
from functools import partial
from itertools import product

import numpy as np
from measure import command, timed
from numpy.typing import NDArray
from translation import translating_flow

from qbxstokes.bie.accuracy import choose_scheme
from qbxstokes.bie.field import mobility_disturbance, resistance_disturbance
from qbxstokes.bie.operators import surface_operators
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.qbx.panels import uniform_rule
from qbxstokes.reference import faxen

Array = NDArray[np.float64]

VELOCITY = np.array([1.0, -2.0, 0.5])
SPEED = float(np.linalg.norm(VELOCITY))
NODES = 8  # along a meridian
USUAL = ("velocity", "pressure", "stress")


def translating(k, tolerance, problem):
    """The flow around the body in fluid at rest."""
    operators = surface_operators(Spheroid(k), choose_scheme(tolerance, NODES), 6)
    if problem == "resistance":
        return resistance_disturbance(operators, np.zeros_like, VELOCITY, np.zeros(3), degree=0)
    across, along = faxen.resistance(k)[:2]
    force = VELOCITY * [across, across, along]
    return mobility_disturbance(operators, np.zeros_like, force, degree=0)


def scattered(k, count):
    """Points (count, 3) outside: a tenth on the surface, the rest at 1e-12 to 10 body lengths."""
    rng = np.random.default_rng(0)
    theta, phi = np.arccos(rng.uniform(-1, 1, count)), rng.uniform(0, 2 * np.pi, count)
    distance = 2.0 * max(1.0, k) * 10.0 ** rng.uniform(-12, 1, count)
    distance[: count // 10] = 0.0
    body = Spheroid(k)
    return body.surface(theta, phi) + distance[:, None] * body.normal(theta, phi)


def accuracy(ratios, tolerances, targets):
    """Largest error over the points, and the time of set-up and all points."""
    rows = []
    for k, problem, tolerance in product(ratios, ("resistance", "mobility"), tolerances):
        points = scattered(k, targets)
        exact = translating_flow(k, points, VELOCITY)[0]
        begin = time.perf_counter()
        found = translating(k, tolerance, problem).evaluate(points, USUAL, tolerance)["velocity"]
        seconds = time.perf_counter() - begin
        error = float(np.abs(found - exact).max()) / SPEED
        row = {"k": k, "problem": problem, "tolerance": tolerance, "error": error}
        rows.append(row | {"seconds": seconds})
    return rows


def costs(k, distances, tolerances):
    """Microseconds per point by the table, by the quadrature for its distance, and by plain."""
    rows = []
    rng, spheroid = np.random.default_rng(0), Spheroid(k)
    theta, phi = np.arccos(rng.uniform(-1, 1, 512)), rng.uniform(0, 2 * np.pi, 512)
    body = translating(k, 1e-12, "resistance")
    table, potentials = body.table, body.potentials

    def cost(function, *more):
        return 1e6 * timed(partial(function, points, *more), 5)[0] / len(points)

    for distance, tolerance in product(distances, tolerances):
        points = spheroid.surface(theta, phi) + distance * spheroid.normal(theta, phi)
        few, limit = points[:8], tolerance * body.scale
        exact = translating_flow(k, few, VELOCITY)[0]
        row = {"distance": distance, "tolerance": tolerance}
        row["table"] = cost(table.evaluate, USUAL, 0.1 * limit)
        row |= {"plain": None, "upsampling": None}
        for upsampling in (1, 2, 4, 8, 16, 32):
            rule = uniform_rule(upsampling * NODES, 2 * upsampling * NODES, "cosine")
            if np.abs(potentials.by_rule(few, rule) - exact).max() <= limit:
                row |= {"plain": cost(potentials.by_rule, rule), "upsampling": upsampling}
                break
        used = int(potentials.evaluate(few[:1], tolerance)[1][0])
        points = few if used == 2 else points  # the slowest
        row["quadrature"] = cost(potentials.evaluate, tolerance)
        rows.append(row | {"method": ("plain", "graded", "expansion")[used]})
    return rows


@command
def main(small=False):
    """Both tables."""
    ratios = (0.5,) if small else (1 / 20, 1 / 2, 2.0, 20.0)
    tolerances = (1e-8,) if small else (1e-6, 1e-8, 1e-10)
    distances = (1e-2, 3.0) if small else (0.0, 1e-6, 1e-4, 1e-2, 0.1, 0.3, 1.0, 3.0, 10.0)
    accuracy(ratios[:1], tolerances[:1], 100)  # loads what is compiled
    return {
        "field_accuracy": accuracy(ratios, tolerances, 2000 if small else 1_000_000),
        "field_costs": costs(0.5, distances, tolerances),
    }
