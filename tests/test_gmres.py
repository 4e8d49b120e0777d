"""The integral equation through PETSc: shell matrix, GMRES, preconditioner, options, failure."""

from __future__ import annotations

import numpy as np
import pytest

from qbxstokes.bie.operators import DirectSolver, form_body_model, surface_operators
from qbxstokes.errors import ConvergenceError
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.petsc import session
from qbxstokes.qbx.operator import GradedScheme

PETSc = session.start()

from qbxstokes.petsc.gmres import GmresSolver, shell_matrix  # noqa: E402  PETSc must have started


@pytest.fixture(scope="module", params=[0.05, 0.5, 8.0])
def operators(request):
    return surface_operators(Spheroid(request.param), GradedScheme(n_theta=8), 7)


def test_shell_matrix_and_its_transpose(operators):
    matrix = shell_matrix(operators.mobility)
    x, y = matrix.createVecs()
    other = x.duplicate()
    rng = np.random.default_rng(0)
    x.setArray(rng.normal(size=x.getLocalSize()))
    other.setArray(rng.normal(size=x.getLocalSize()))
    matrix.mult(x, y)
    product = y.dot(other)
    matrix.multTranspose(other, y)
    assert y.dot(x) == pytest.approx(product, rel=1e-11)
    assert matrix.getSize() == (3 * 8 * 7, 3 * 8 * 7)


def smooth_data(grid):
    x = grid.points
    return np.stack([x[:, 1], x[:, 0] * x[:, 2], 1.0 + x[:, 1] ** 2], axis=1)


@pytest.mark.parametrize("preconditioned", [True, False])
@pytest.mark.parametrize("kind", ["mobility", "resistance"])
def test_gmres_agrees_with_the_direct_solution(operators, preconditioned, kind):
    operator, grid = getattr(operators, kind), operators.grid
    solver = GmresSolver(operator, grid, 1e-12, preconditioned)
    direct = DirectSolver(operator, grid)
    smooth = smooth_data(grid)
    # A solution is as accurate as the residual times the condition of the operator.
    condition = max(np.linalg.cond(operator.blocks))
    for name in ("solve", "solve_transpose"):
        expected = getattr(direct, name)(smooth)
        found = getattr(solver, name)(smooth)
        assert np.max(np.abs(found - expected)) < 1e-11 * condition * np.max(np.abs(expected))
    assert all(record.true_residual < 1e-11 for record in solver.records)
    if preconditioned:
        assert max(record.iterations for record in solver.records) <= 6


def test_thin_body_without_preconditioner_keeps_its_basis():
    """Classical Gram-Schmidt stagnates here; modified Gram-Schmidt, the default, does not."""
    operators = surface_operators(Spheroid(1 / 50), GradedScheme(n_theta=8), 3)
    solver = GmresSolver(operators.mobility, operators.grid, 1e-12, preconditioned=False)
    form_body_model(operators, lambda operator, grid: solver)
    assert len(solver.records) == 4
    assert max(record.iterations for record in solver.records) < 120


def test_reported_residual_is_not_taken_on_trust(operators):
    """Too few iterations: an error that names residuals, reason and what to try."""
    PETSc.Options().setValue("ksp_max_it", 2)
    try:
        solver = GmresSolver(operators.mobility, operators.grid, 1e-12, preconditioned=False)
        with pytest.raises(ConvergenceError, match=r"true relative residual .*DIVERGED_MAX_IT"):
            solver.solve(smooth_data(operators.grid))
    finally:
        PETSc.Options().delValue("ksp_max_it")


def test_zero_data_have_the_zero_solution(operators):
    solver = GmresSolver(operators.mobility, operators.grid)
    assert not np.any(solver.solve(np.zeros_like(operators.grid.points)))
    assert solver.records == []


def test_what_the_program_sets_is_not_taken_for_the_users(operators):
    """Options of the solver turn off the cache, so that none of ours may stay in the database."""
    GmresSolver(operators.mobility, operators.grid, 1e-10)
    assert session.solver_options(PETSc) == []
    with session.temporary_options("", {"ksp_max_it": "50"}, {}):
        assert session.solver_options(PETSc) == ["ksp_max_it"]
    assert session.solver_options(PETSc) == []
