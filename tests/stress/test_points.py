"""Errors of the flow at a million points, from the surface to ten body lengths; POINTS=1000000.

The exact flow is that of a translating body, as a resistance problem (velocity given) and as a
mobility problem (pushed by the force that goes with it). Errors are over the speed.
"""

from __future__ import annotations

import os
from itertools import product

import numpy as np
import pytest
from conftest import See
from ellipsoid_flows import translating_flow

from qbxstokes.bie.accuracy import choose_scheme
from qbxstokes.bie.field import mobility_disturbance, resistance_disturbance
from qbxstokes.bie.operators import surface_operators
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.reference import faxen

VELOCITY = np.array([1.0, -2.0, 0.5])
POINTS = int(os.environ.get("POINTS", 2000))


@pytest.mark.parametrize("k", [1 / 20, 1 / 2, 2.0, 20.0])
def test_points(k: float, see: See) -> None:
    """A tenth on the surface, the rest at 1e-12 to 10 body lengths."""
    rng, body = np.random.default_rng(0), Spheroid(k)
    theta, phi = np.arccos(rng.uniform(-1, 1, POINTS)), rng.uniform(0, 2 * np.pi, POINTS)
    distance = 2.0 * max(1.0, k) * 10.0 ** rng.uniform(-12, 1, POINTS)
    distance[: POINTS // 10] = 0.0
    points = body.surface(theta, phi) + distance[:, None] * body.normal(theta, phi)
    exact = translating_flow(k, points, VELOCITY)[0]
    across, along = faxen.resistance(k)[:2]
    force = VELOCITY * [across, across, along]
    for problem, tolerance in product(("resistance", "mobility"), (1e-6, 1e-8, 1e-10)):
        operators = surface_operators(body, choose_scheme(tolerance, 8), 6)
        if problem == "resistance":
            flow = resistance_disturbance(operators, np.zeros_like, VELOCITY, np.zeros(3), degree=0)
        else:
            flow = mobility_disturbance(operators, np.zeros_like, force, degree=0)
        found = flow.evaluate(points, ("velocity", "pressure", "stress"), tolerance)["velocity"]
        error = np.abs(found - exact).max() / np.linalg.norm(VELOCITY)
        see(float(error), tolerance, f"{problem}, {tolerance:.0e}")
