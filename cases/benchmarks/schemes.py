"""Set-up of a body: the thesis's uniform scheme against the graded one at no larger error.

J. Bagge 2015, KTH, chapter 5: points on the front of error against time of a scan over n_theta, p,
r/h and upsampling kappa. Both by rotational and mirror symmetry, by the same kernels, two modes;
processor times (s) of this thread, which does all the work.

Run:      python cases/benchmarks/schemes.py      (1 min; --small: 2 s; --csv)
Expected: uniform 50 to 150 times slower where it is at its best, a few times where errors of a
          percent will do.
"""

from __future__ import annotations

import time
from functools import partial
from typing import Any

import numpy as np
from measure import Rows, command, timed

from qbxstokes.bie.accuracy import choose_scheme, plain_body
from qbxstokes.bie.exact import true_error
from qbxstokes.bie.operators import surface_operators
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.petsc import session
from qbxstokes.qbx.operator import Scheme, UniformScheme

# Aspect ratio, n_theta, order, r/h, upsampling.
UNIFORM = (
    (0.5, 8, 8, 0.191, 16),
    (0.2, 12, 2, 0.069, 12),
    (0.2, 24, 2, 0.138, 10),
    (0.2, 24, 4, 0.076, 16),
    (0.5, 12, 8, 0.358, 6),
    (0.5, 16, 14, 0.382, 12),
    (0.5, 24, 14, 0.477, 16),
    (2.0, 8, 6, 0.573, 12),
    (2.0, 20, 12, 1.432, 8),
    (2.0, 20, 16, 1.194, 12),
    (2.0, 24, 14, 0.955, 16),
    (5.0, 12, 2, 0.344, 12),
    (5.0, 24, 4, 0.688, 12),
)


def formed(k: float, scheme: Scheme, repeats: int) -> dict[str, Any]:
    """Error, time and iterations of GMRES to 1e-10, without preconditioner, of one body."""
    from qbxstokes.petsc.gmres import GmresSolver

    span, body = timed(partial(plain_body, Spheroid(k), scheme), repeats, time.thread_time)
    operators = surface_operators(Spheroid(k), scheme, 3)
    solver = GmresSolver(operators.mobility, operators.grid, 1e-10, False)
    solver.solve(np.random.default_rng(0).standard_normal((operators.grid.weights.size, 3)))
    iterations = solver.records[-1].iterations
    return {"error": true_error(body.model), "time": span, "iterations": iterations}


def main(small: bool = False) -> dict[str, Rows]:
    """A row per uniform scheme, with the graded one beside it."""
    session.start([])
    rows: Rows = []
    for k, n, order, r_over_h, kappa in UNIFORM[: 1 if small else None]:
        row = {"k": k, "n_theta": n, "p": order, "r/h": r_over_h, "kappa": kappa}
        uniform = formed(k, UniformScheme(n, n, order, r_over_h, kappa), 1 if small else 3)
        graded = formed(k, choose_scheme(uniform["error"]), 1 if small else 5)
        row |= uniform | {f"graded_{name}": value for name, value in graded.items()}
        rows.append(row | {"ratio": uniform["time"] / graded["time"]})
    return {"schemes": rows}


if __name__ == "__main__":
    command(main)
