"""Where the hydrodynamics end: thin bodies, coarse or extreme set-ups, ill-conditioned operators.

Errors are against closed forms; what is refused must at least be told.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np
import pytest
from conftest import See

from qbxstokes.bie.accuracy import accurate_body, choose_scheme
from qbxstokes.bie.operators import surface_operators
from qbxstokes.errors import ConvergenceError
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.qbx.operator import GradedScheme, Scheme, UniformScheme
from qbxstokes.simulation.closed_forms import true_error

ASPECT_RATIOS = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 0.9, 1.0, 1.1, 2.0, 5.0,
                 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0)  # fmt: skip
# What is refused must be told within this factor.
REFUSED = 10.0
# True error over the estimate, which is made from two resolutions.
HONESTY = 3.0
# Of GMRES; the residual of a solution may exceed it by MARGIN before the solve is refused.
TOLERANCE, MARGIN = 1e-12, 10.0


@pytest.mark.slow
def test_aspect_ratios(see: See) -> None:
    """A tolerance is reached, or refused with an estimate that tells the error."""
    for k, tolerance in product(ASPECT_RATIOS, (1e-6, 1e-10)):
        try:
            body, refused = accurate_body(Spheroid(k), tolerance), False
        except ConvergenceError:
            body, refused = accurate_body(Spheroid(k), tolerance, strict=False), True
        bound = REFUSED * body.model.error_estimate if refused else tolerance
        where = f"k = {k:g}, tolerance {tolerance:g} {'refused' if refused else 'reached'}"
        see(true_error(body.model), bound, where)


@pytest.mark.slow
def test_expansions(see: See) -> None:
    """Orders up to 80 and radii up to the admissible limit: no overflow, no silent loss."""
    orders, factors, sides = (0, 4, 16, 80), (0.03, 0.3, 0.99, 1.0), ("inner", "outer", "average")
    for k, order, factor, side in product((0.02, 0.5, 20.0), orders, factors, sides):
        try:
            body = accurate_body(Spheroid(k), 1e-10, GradedScheme(6, order, factor, 18, 0.7, side))
        except ConvergenceError:
            continue
        where = f"k = {k:g}, order {order}, radius {factor:g}, {side}"
        see(true_error(body.model) / body.model.error_estimate, HONESTY, where)


def coarse_schemes(k: float) -> Iterator[Scheme]:
    """Upsampling, panels and grids that are too coarse for the order of the expansions."""
    limit = min(k * k, 1.0 / k)
    for order, upsampling, n_theta in product((4, 16, 32), (1, 2, 4, 8), (6, 16)):
        yield UniformScheme(n_theta, n_theta, order, 0.9 * limit * n_theta / 6.3, upsampling)
    for order, panel_order, n_theta in product((8, 24), (2, 4, 8, 12), (3, 4, 6)):
        yield GradedScheme(n_theta, order, 0.2, panel_order)


@pytest.mark.slow
def test_resolution(see: See) -> None:
    """The estimate sees a quadrature that is too coarse."""
    for k in (0.4, 1.0, 2.5):
        for scheme in coarse_schemes(k):
            body = accurate_body(Spheroid(k), 1e-10, scheme)
            where = f"k = {k:g}, {scheme}"
            see(true_error(body.model) / body.model.error_estimate, HONESTY, where)


@pytest.mark.slow
def test_conditioning(see: See) -> None:
    """True residuals, whatever GMRES reports: over the data, or |A||x| where rounding forbids."""
    from qbxstokes.petsc import session

    session.start([])
    from qbxstokes.petsc.gmres import GmresSolver

    rng = np.random.default_rng(0)
    for k in (0.001, 0.005, 0.02, 0.1, 0.5, 1.0, 2.0, 10.0, 50.0, 500.0):
        operators = surface_operators(Spheroid(k), choose_scheme(1e-12, 8), 8)
        grid = operators.grid
        # In the norm of the surface, as the solver has it.
        root, scale = np.sqrt(grid.weights.reshape(8, 8)[:, 0]), np.sqrt(grid.weights)[:, None]
        for problem, preconditioned in product(("mobility", "resistance"), (True, False)):
            operator = getattr(operators, problem)
            solver = GmresSolver(operator, grid, TOLERANCE, preconditioned)
            data = rng.standard_normal((grid.weights.size, 3))
            try:
                x = solver.solve(data)
            except ConvergenceError:  # ends a run, with its residual and what to do about it
                continue
            rounding = np.finfo(float).eps * operator.balanced(root).norm
            size = max(
                np.linalg.norm(scale * data), rounding / TOLERANCE * np.linalg.norm(scale * x)
            )
            residual = float(np.linalg.norm(scale * (data - operator.apply(x))) / size)
            where = f"k = {k:g}, {problem}, {'' if preconditioned else 'not '}preconditioned"
            see(residual, MARGIN * TOLERANCE, where)
