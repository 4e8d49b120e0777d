"""Iterations of GMRES to 1e-12 over the aspect ratio, with and without the preconditioner.

The data are a random cubic polynomial. The preconditioner is the inverse of the operator's
azimuthal modes: exact but for rounding, so that a second iteration only mends what conditioning
cost.

Run:      python cases/benchmarks/iterations.py      (10 s; --small: 2 s; --csv)
Expected: 1 iteration with it for k = 1/20 to 20, and 9 to 105 without; true residuals within ten
          times the tolerance, or eps times the condition number where rounding allows no more.
"""

from __future__ import annotations

import numpy as np
from measure import Rows, command

from qbxstokes.bie.accuracy import choose_scheme
from qbxstokes.bie.operators import surface_operators
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.petsc import session

TOLERANCE = 1e-12


def main(small: bool = False) -> dict[str, Rows]:
    """A row per aspect ratio and problem."""
    session.start([])
    from qbxstokes.petsc.gmres import GmresSolver

    rows: Rows = []
    for k in (0.1, 2.0) if small else (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0):
        operators = surface_operators(Spheroid(k), choose_scheme(TOLERANCE, 10), 9)
        x = operators.grid.points / max(1.0, k)
        powers = np.stack([np.prod(x**p, axis=1) for p in np.ndindex(4, 4, 4) if sum(p) <= 3])
        data = powers.T @ np.random.default_rng(0).normal(size=(len(powers), 3))
        for problem in ("mobility", "resistance"):
            operator = getattr(operators, problem)
            row = {"aspect_ratio": k, "problem": problem}
            row["condition"] = float(np.max(np.linalg.cond(operator.blocks)))
            for name, preconditioned in (("plain", False), ("preconditioned", True)):
                solver = GmresSolver(operator, operators.grid, TOLERANCE, preconditioned)
                solver.solve(data)
                row[name] = solver.records[-1].iterations
                row[f"{name}_residual"] = solver.records[-1].true_residual
            rows.append(row)
    return {"iterations": rows}


if __name__ == "__main__":
    command(main)
