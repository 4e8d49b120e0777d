"""Ill-conditioned operators: the residual that GMRES reports against the true one."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from qbxstokes.app.stress.checks import Checks, outcome
from qbxstokes.app.tabulate import Work
from qbxstokes.bie.accuracy import choose_scheme
from qbxstokes.bie.operators import surface_operators
from qbxstokes.errors import ConvergenceError
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.io.tables import Column, Table

TOLERANCE = 1e-12
# The residual of a solution may exceed the tolerance by as much before the solve is refused.
MARGIN = 10.0


def tables(work: Work) -> Iterator[Table]:
    """Iterations and residuals of both problems, with and without the preconditioner."""
    from qbxstokes.petsc.gmres import GmresSolver

    checks = Checks(
        "conditioning",
        f"GMRES to {TOLERANCE:g}: true residual, whatever it reports",
        (
            Column("aspect_ratio", format="g", heading="k"),
            Column("problem"),
            Column("preconditioner"),
            Column("condition", format=".0e", description="condition number of the operator"),
            Column("iterations", format="d"),
            Column("reported", format=".0e", description="relative residual that GMRES reports"),
        ),
        "true residual over the data, or over |A||x| where rounding forbids that",
    )
    rng = np.random.default_rng(work.section.seed)
    for k in work.choose((0.02, 2.0), (0.001, 0.005, 0.02, 0.1, 0.5, 1.0, 2.0, 10.0, 50.0, 500.0)):
        work.say(f"conditioning, aspect ratio {k:g}")
        operators = surface_operators(Spheroid(k), choose_scheme(1e-12, 8), 8)
        for problem in ("mobility", "resistance"):
            operator = getattr(operators, problem)
            root = np.sqrt(operators.grid.weights.reshape(8, 8)[:, 0])
            condition = float(np.max(np.linalg.cond(operator.balanced(root).blocks)))
            for preconditioned in (True, False):
                solver = GmresSolver(operator, operators.grid, TOLERANCE, preconditioned)
                data = rng.standard_normal((operators.grid.weights.size, 3))
                x, _ = outcome(partial(solver.solve, data), ConvergenceError)
                record = solver.records[-1]
                # In the norm of the surface, as the solver has it.
                scale = np.repeat(np.sqrt(operators.grid.weights), 3).reshape(-1, 3)
                residual, at = record.true_residual, ""
                if x is None:
                    at = "refused"
                    residual = 0.0
                else:
                    size = np.linalg.norm(scale * data)
                    own = np.linalg.norm(scale * (data - operator.apply(x)))
                    rounding = np.finfo(float).eps * operator.balanced(root).norm
                    residual = own / max(size, rounding / TOLERANCE * np.linalg.norm(scale * x))
                key = (k, problem, preconditioned, condition, record.iterations)
                checks.see(
                    *key,
                    record.reported_residual,
                    value=residual,
                    bound=MARGIN * TOLERANCE,
                    at=at,
                )
    checks.note("A solve that is refused ends the run with its residual and what to do about it.")
    table = checks.table()
    table.plot = {
        "x": "aspect_ratio",
        "y": "iterations",
        "by": ["problem", "preconditioner"],
        "scale": "semilogx",
    }
    yield table
