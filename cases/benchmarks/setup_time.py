"""Set-up of a body: the thesis's uniform scheme against the graded one; what a tolerance costs.

J. Bagge 2015, KTH, chapter 5, for the uniform scheme: points on the front of error against time of
a scan over n_theta, p, r/h and upsampling, each against the graded scheme at no larger error. Both
by rotational and mirror symmetry, by the same kernels, two modes. Times are processor times of this
thread, which does all the work; reading back from the cache is wall time.

Run:      python cases/benchmarks/setup_time.py      (2 min; --small: 3 s; --csv)
Expected: uniform 50 to 150 times slower where it is at its best, a few times where errors of a
          percent will do; 0.1 to 0.4 s to a tolerance with its estimate, a third of that without,
          2 ms from the cache.
"""

from __future__ import annotations

import tempfile
import time
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from measure import Rows, command, timed

from qbxstokes.bie.accuracy import AccurateBody, accurate_body, choose_scheme, plain_body
from qbxstokes.bie.exact import true_error
from qbxstokes.bie.operators import surface_operators
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.io.cache import Cache
from qbxstokes.petsc import session
from qbxstokes.qbx.operator import Scheme, UniformScheme, independent_rows

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


def schemes(cases: tuple[tuple[float, int, int, float, int], ...], repeats: int) -> Rows:
    """A row per uniform scheme, with the graded one beside it."""
    rows: Rows = []
    for k, n, order, r_over_h, kappa in cases:
        row = {"k": k, "n_theta": n, "p": order, "r/h": r_over_h, "kappa": kappa}
        uniform = formed(k, UniformScheme(n, n, order, r_over_h, kappa), min(repeats, 3))
        graded = formed(k, choose_scheme(uniform["error"]), repeats)
        row |= uniform | {f"graded_{name}": value for name, value in graded.items()}
        rows.append(row | {"ratio": uniform["time"] / graded["time"]})
    return rows


def sources(k: float, scheme: Scheme) -> int:
    """Source points of all rows."""
    spheroid, grid = Spheroid(k), scheme.grid(Spheroid(k), 1)
    rows = independent_rows(scheme.n_theta)
    rules = (scheme.rule(spheroid, float(grid.theta[row]), -1, 2) for row in rows)
    return sum(int(np.sum(rule[3] - rule[2])) for rule in rules)


def tolerances(ratios: tuple[float, ...], asked: tuple[float, ...], repeats: int) -> Rows:
    """A row per aspect ratio and tolerance: with the estimate, without, from the cache."""
    rows: Rows = []
    with tempfile.TemporaryDirectory() as folder:
        for k, tolerance in product(ratios, asked):
            whole = partial(accurate_body, Spheroid(k), tolerance)
            total, body = timed(whole, repeats, time.thread_time)
            alone, _ = timed(
                partial(plain_body, Spheroid(k), body.scheme), repeats, time.thread_time
            )
            cache, key = Cache(Path(folder)), {"aspect_ratio": k, "tolerance": tolerance}
            cache.store("body", key, body.to_arrays())

            def read(cache: Cache = cache, key: dict[str, Any] = key) -> AccurateBody:
                return AccurateBody.from_arrays(cache.load("body", key) or {})

            row = {"k": k, "tolerance": tolerance, "sources": sources(k, body.scheme)}
            row |= {"form": alone, "total": total, "cached": timed(read, repeats)[0]}
            rows.append(row | {"error": true_error(body.model)})
    return rows


def main(small: bool = False) -> dict[str, Rows]:
    """Both tables."""
    session.start([])
    repeats = 1 if small else 5
    ratios = (0.5,) if small else (0.02, 0.1, 0.5, 1.0, 2.0, 10.0, 50.0)
    return {
        "schemes": schemes(UNIFORM[: 1 if small else None], repeats),
        "setup": tolerances(ratios, (1e-10,) if small else (1e-4, 1e-7, 1e-10), repeats),
    }


if __name__ == "__main__":
    command(main)
