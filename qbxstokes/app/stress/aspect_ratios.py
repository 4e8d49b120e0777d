"""Aspect ratios from 1/1000 to 1000: where accuracy ends, and what is said then."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from qbxstokes.app.stress.checks import Checks, outcome
from qbxstokes.app.tabulate import Work
from qbxstokes.bie.accuracy import accurate_body
from qbxstokes.bie.exact import true_error
from qbxstokes.errors import ConvergenceError
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.io.tables import Column, Table

_SMALL = (0.02, 1.0, 1e3)
_FULL = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 0.9, 1.0, 1.1, 2.0, 5.0, 10.0, 20.0,
         50.0, 100.0, 200.0, 500.0, 1000.0)  # fmt: skip
# What is refused must at least be told within this factor.
HONESTY = 10.0


def tables(work: Work) -> Iterator[Table]:
    """Errors against closed forms over the aspect ratio, by the tolerance asked for."""
    checks = Checks(
        "aspect_ratios",
        "Aspect ratios: error of the hydrodynamics against closed forms",
        (
            Column("aspect_ratio", format="g", heading="k"),
            Column("tolerance", description="asked for", format=".0e"),
            Column("estimate", description="error that the program tells", format=".1e"),
            Column("answer", description="whether the tolerance is reached or refused"),
        ),
        "error, the largest relative one of the fourteen numbers",
    )
    for k in work.choose(_SMALL, _FULL):
        work.say(f"aspect ratio {k:g}")
        for tolerance in work.choose((1e-10,), (1e-6, 1e-10)):
            spheroid = Spheroid(k)
            body, refusal = outcome(partial(accurate_body, spheroid, tolerance), ConvergenceError)
            if body is None:
                body = accurate_body(spheroid, tolerance, strict=False)
            estimate, error = body.model.error_estimate, true_error(body.model)
            answer = "refused" if refusal else "reached"
            bound = HONESTY * estimate if refusal else tolerance
            checks.see(k, tolerance, estimate, answer, value=error, bound=bound)
    checks.note(
        "Where the tolerance is reached the error must be below it; where it is refused (exit "
        f"status 1, with the tolerance that can be had) the estimate must tell the error within a "
        f"factor of {HONESTY:g}."
    )
    table = checks.table()
    table.plot = {"x": "aspect_ratio", "y": ["worst", "estimate"], "by": "tolerance"}
    yield table
