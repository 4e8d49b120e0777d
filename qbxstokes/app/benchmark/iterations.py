"""GMRES iterations to 1e-12 over the aspect ratio, with and without the preconditioner."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from qbxstokes.bie.accuracy import choose_scheme
from qbxstokes.bie.operators import surface_operators
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.io.tables import Column, Table

if TYPE_CHECKING:
    from qbxstokes.app.tabulate import Work

TOLERANCE = 1e-12
_N_PHI = 9


def tables(work: Work) -> Iterator[Table]:
    """One row per aspect ratio and problem; the data are a random cubic polynomial."""
    from qbxstokes.petsc.gmres import GmresSolver

    table = Table(
        "iterations",
        f"GMRES iterations to {TOLERANCE:.0e}",
        (
            Column("aspect_ratio", "", "k", ".3g"),
            Column("problem", "", "mobility or resistance"),
            Column("condition", "", "largest condition number of a mode", ".0e"),
            Column("plain", "", "iterations without preconditioner", "d"),
            Column("plain_residual", "", "true relative residual", ".0e"),
            Column("preconditioned", "", "iterations with it", "d"),
            Column("residual", "", "true relative residual", ".0e"),
            Column("passed", "", "both within ten times the tolerance, or what rounding allows"),
        ),
        plot={"x": "aspect_ratio", "y": ["plain", "preconditioned"], "by": "problem"},
    )
    scheme = choose_scheme(1e-12, 10)
    ratios = work.choose((0.1, 2.0), (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0))
    for k in ratios:
        work.say(f"aspect ratio {k:g}")
        operators = surface_operators(Spheroid(k), scheme, _N_PHI)
        x = operators.grid.points / max(1.0, k)
        powers = np.stack([np.prod(x**p, axis=1) for p in np.ndindex(4, 4, 4) if sum(p) <= 3])
        data = powers.T @ np.random.default_rng(0).normal(size=(len(powers), 3))
        for problem in ("mobility", "resistance"):
            operator = getattr(operators, problem)
            records = []
            for preconditioned in (False, True):
                solver = GmresSolver(operator, operators.grid, TOLERANCE, preconditioned)
                solver.solve(data)
                records.append(solver.records[-1])
            plain, better = records
            condition = float(np.max(np.linalg.cond(operator.blocks)))
            attainable = max(10.0 * TOLERANCE, float(np.finfo(float).eps) * condition)
            table.add(
                aspect_ratio=k,
                problem=problem,
                condition=condition,
                plain=plain.iterations,
                plain_residual=plain.true_residual,
                preconditioned=better.iterations,
                residual=better.true_residual,
                passed=max(plain.true_residual, better.true_residual) <= attainable,
            )
    table.notes.append(
        "The preconditioner is the inverse of the operator's azimuthal modes: exact but for "
        "rounding, so that a second iteration only mends what conditioning cost."
    )
    yield table
