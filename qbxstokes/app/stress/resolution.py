"""Panels, upsampling and grids too coarse for the order of the expansions: seen and told."""

from __future__ import annotations

from collections.abc import Iterator

from qbxstokes.app.stress.checks import Checks
from qbxstokes.app.tabulate import Work
from qbxstokes.bie.accuracy import accurate_body
from qbxstokes.bie.exact import true_error
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.io.tables import Column, Table
from qbxstokes.qbx.operator import GradedScheme, Scheme, UniformScheme

# True error over the estimate, which compares resolutions.
HONESTY = 3.0


def _schemes(work: Work, k: float) -> Iterator[tuple[str, str, Scheme]]:
    limit = min(k * k, 1.0 / k)
    for order in work.choose((16,), (4, 16, 32)):
        for upsampling in work.choose((2,), (1, 2, 4, 8)):
            for n_theta in work.choose((12,), (6, 16)):
                ratio = 0.9 * limit * n_theta / 6.3
                scheme = UniformScheme(n_theta, n_theta, order, ratio, upsampling)
                yield "uniform", f"kappa = {upsampling}", scheme
    for order in work.choose((16,), (8, 24)):
        for panel_order in work.choose((4,), (2, 4, 8, 12)):
            for n_theta in work.choose((4,), (3, 4, 6)):
                yield (
                    "graded",
                    f"{panel_order} nodes",
                    GradedScheme(n_theta, order, 0.2, panel_order),
                )


def tables(work: Work) -> Iterator[Table]:
    """True over estimated error where the quadrature is too coarse for the order."""
    checks = Checks(
        "resolution",
        "Quadrature too coarse for the expansions: true error over the estimate of it",
        (
            Column("scheme"),
            Column("quadrature", description="upsampling, or nodes per panel and direction"),
            Column("expansion_order", format="d", heading="order p"),
        ),
        "true over estimated error",
    )
    for k in work.choose((0.5,), (0.4, 1.0, 2.5)):
        work.say(f"resolution, aspect ratio {k:g}")
        for name, quadrature, scheme in _schemes(work, k):
            body = accurate_body(Spheroid(k), 1e-10, scheme)
            error, estimate = true_error(body.model), body.model.error_estimate
            at = f"k = {k:g}, n_theta = {scheme.n_theta}: error {error:.0e}"
            key = (name, quadrature, scheme.expansion_order)
            checks.see(*key, value=error / estimate, bound=HONESTY, at=at)
    yield checks.table()
