"""The field: what a point costs over its distance, in microseconds with pressure and stress.

Of a translating body of k = 1/2. `table`: harmonics, as a run takes them; `quadrature`: what the
tolerance asks for at the distance; `plain`: plain quadrature of the velocity with the upsampling
of a grid of 8 by 16 that the tolerance takes there. (Errors: tests/stress/test_points.py.)

Run:      python cases/benchmarks/field.py      (30 s; --small: 5 s; --csv)
Expected: a point costs 0.1 to 0.2 microseconds at any distance by the table, and near the surface
          plain upsampling cannot follow.
"""

from functools import partial
from itertools import product

import numpy as np
from measure import command, timed

from qbxstokes.bie.accuracy import choose_scheme
from qbxstokes.bie.field import resistance_disturbance
from qbxstokes.bie.operators import surface_operators
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.qbx.panels import uniform_rule

VELOCITY = np.array([1.0, -2.0, 0.5])
NODES = 8  # along a meridian
USUAL = ("velocity", "pressure", "stress")


def costs(k, distances, tolerances):
    """Microseconds per point by the table, by the quadrature for its distance, and by plain."""
    rows = []
    rng, spheroid = np.random.default_rng(0), Spheroid(k)
    theta, phi = np.arccos(rng.uniform(-1, 1, 512)), rng.uniform(0, 2 * np.pi, 512)
    operators = surface_operators(spheroid, choose_scheme(1e-12, NODES), 6)
    body = resistance_disturbance(operators, np.zeros_like, VELOCITY, np.zeros(3), degree=0)
    table, potentials = body.table, body.potentials

    def cost(function, *more):
        return 1e6 * timed(partial(function, points, *more), 5)[0] / len(points)

    for distance, tolerance in product(distances, tolerances):
        points = spheroid.surface(theta, phi) + distance * spheroid.normal(theta, phi)
        few, limit = points[:8], tolerance * body.scale
        exact = table.evaluate(few, USUAL, 1e-13)["velocity"]
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
    """The table."""
    tolerances = (1e-8,) if small else (1e-6, 1e-8, 1e-10)
    distances = (1e-2, 3.0) if small else (0.0, 1e-6, 1e-4, 1e-2, 0.1, 0.3, 1.0, 3.0, 10.0)
    return {"field_costs": costs(0.5, distances, tolerances)}
