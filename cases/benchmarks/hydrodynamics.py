"""The thesis's uniform scheme against the graded one at no larger error; iterations of GMRES.

J. Bagge 2015, KTH, chapter 5: points on the front of error against time of a scan over n_theta, p,
r/h and upsampling kappa. Both by rotational and mirror symmetry, by the same kernels, two modes;
processor times (s) of this thread. Iterations to 1e-12 have a random cubic polynomial as data; the
preconditioner inverts the operator's azimuthal modes, exactly but for rounding.

Run:      python cases/benchmarks/hydrodynamics.py      (1 min; --small: 3 s; --csv)
Expected: uniform 50 to 150 times slower where it is at its best, a few times where errors of a
          percent will do; 1 iteration with the preconditioner for k = 1/20 to 20, and 9 to 116
          without; true residuals within ten times the tolerance, or eps times the condition number.
"""

import time
from functools import partial

import numpy as np
from measure import command, timed

from qbxstokes.bie.accuracy import choose_scheme, plain_body
from qbxstokes.bie.operators import surface_operators
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.petsc import session
from qbxstokes.qbx.operator import UniformScheme
from qbxstokes.simulation.closed_forms import true_error

# Aspect ratio, n_theta, order, r/h, upsampling.
UNIFORM = (
    (0.5, 8, 8, 0.191, 16), (0.2, 12, 2, 0.069, 12), (0.2, 24, 2, 0.138, 10),
    (0.2, 24, 4, 0.076, 16), (0.5, 12, 8, 0.358, 6), (0.5, 16, 14, 0.382, 12),
    (0.5, 24, 14, 0.477, 16), (2.0, 8, 6, 0.573, 12), (2.0, 20, 12, 1.432, 8),
    (2.0, 20, 16, 1.194, 12), (2.0, 24, 14, 0.955, 16), (5.0, 12, 2, 0.344, 12),
    (5.0, 24, 4, 0.688, 12),
)  # fmt: skip
RATIOS = (0.1, 2.0, 0.02, 0.05, 0.2, 0.5, 1.0, 5.0, 10.0, 20.0, 50.0)


def solved(operators, problem, data, tolerance, better):
    """Iterations and residual of a solve, with the preconditioner or without."""
    from qbxstokes.petsc.gmres import GmresSolver

    solver = GmresSolver(getattr(operators, problem), operators.grid, tolerance, better)
    solver.solve(data)
    return solver.records[-1]


def formed(k, scheme, repeats):
    """Error, time and iterations of GMRES to 1e-10, without preconditioner, of one body."""
    span, body = timed(partial(plain_body, Spheroid(k), scheme), repeats, time.thread_time)
    operators = surface_operators(Spheroid(k), scheme, 3)
    data = np.random.default_rng(0).standard_normal((operators.grid.weights.size, 3))
    record = solved(operators, "mobility", data, 1e-10, False)
    return {"error": true_error(body.model), "time": span, "iterations": record.iterations}


def schemes(cases, repeats):
    """A row per uniform scheme, with the graded one beside it."""
    rows = []
    for k, n, order, r_over_h, kappa in cases:
        row = {"k": k, "n_theta": n, "p": order, "r/h": r_over_h, "kappa": kappa}
        uniform = formed(k, UniformScheme(n, n, order, r_over_h, kappa), min(3, repeats))
        graded = formed(k, choose_scheme(uniform["error"]), repeats)
        row |= uniform | {f"graded_{name}": value for name, value in graded.items()}
        rows.append(row | {"ratio": uniform["time"] / graded["time"]})
    return rows


def iterations(ratios):
    """A row per aspect ratio and problem."""
    rows = []
    for k in ratios:
        operators = surface_operators(Spheroid(k), choose_scheme(1e-12, 10), 9)
        x = operators.grid.points / max(1.0, k)
        powers = np.stack([np.prod(x**p, axis=1) for p in np.ndindex(4, 4, 4) if sum(p) <= 3])
        data = powers.T @ np.random.default_rng(0).normal(size=(len(powers), 3))
        for problem in ("mobility", "resistance"):
            blocks = getattr(operators, problem).blocks
            row = {"k": k, "problem": problem, "condition": float(np.linalg.cond(blocks).max())}
            for name, better in (("plain", False), ("preconditioned", True)):
                record = solved(operators, problem, data, 1e-12, better)
                row |= {name: record.iterations, f"{name}_residual": record.true_residual}
            rows.append(row)
    return rows


@command
def main(small=False):
    """Both tables."""
    session.start([])
    compared = schemes(UNIFORM[:1], 1) if small else schemes(UNIFORM, 5)
    ratios = RATIOS[:2] if small else tuple(sorted(RATIOS))
    return {"schemes": compared, "iterations": iterations(ratios)}
