"""Orders up to 80 and radii up to the admissible limit: no overflow, no silent loss."""

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
from qbxstokes.qbx.operator import GradedScheme

# True error over the estimate, which is made from two resolutions.
HONESTY = 3.0


def tables(work: Work) -> Iterator[Table]:
    """True over estimated error, by order, radius and side of the expansions."""
    checks = Checks(
        "expansions",
        "Expansion orders and radii: true error over the estimate of it",
        (
            Column("expansion_order", format="d", heading="order p"),
            Column("radius_factor", format="g", description="radius over the admissible one"),
            Column("side", description="of the surface on which the centres are"),
        ),
        "true over estimated error; an overflow would be infinite",
    )
    for k in work.choose((0.5,), (0.02, 0.5, 20.0)):
        work.say(f"expansions, aspect ratio {k:g}")
        for order in work.choose((2, 80), (0, 4, 16, 80)):
            for factor in work.choose((0.3, 1.0), (0.03, 0.3, 0.99, 1.0)):
                for side in work.choose(("inner", "outer"), ("inner", "outer", "average")):
                    scheme = GradedScheme(6, order, factor, 18, 0.7, side)
                    form = partial(accurate_body, Spheroid(k), 1e-10, scheme)
                    body, refusal = outcome(form, ConvergenceError)
                    if refusal:
                        checks.see(order, factor, side, value=0.0, bound=HONESTY, at="refused")
                        continue
                    error, estimate = true_error(body.model), body.model.error_estimate
                    at = f"k = {k:g}: error {error:.0e}, estimate {estimate:.0e}"
                    ratio = error / estimate
                    checks.see(order, factor, side, value=ratio, bound=HONESTY, at=at)
    yield checks.table()
