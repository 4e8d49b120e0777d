"""Is what the user asks for what the user gets? Tolerance against true error, and its estimate.

Random bodies in random flows, each against the exact Faxen laws (`reference.faxen`), which nothing
that is tested shares. The error is the largest of four: free velocity, free angular velocity, force
and torque on the body held fixed, each relative to its own length.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from qbxstokes.bie.accuracy import AccurateBody, accurate_body
from qbxstokes.bie.exact import true_error
from qbxstokes.bie.functional import stokes_polynomials
from qbxstokes.bie.resolution import confocal_rate, flow_nodes, resolving_nodes
from qbxstokes.flows.base import Flow
from qbxstokes.flows.polynomial import PolynomialFlow
from qbxstokes.flows.singularities import Rotlet, Stokeslet, Stresslet
from qbxstokes.geometry import rotation
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.io.tables import Column, Table
from qbxstokes.reference import faxen

if TYPE_CHECKING:
    from qbxstokes.app.tabulate import Work

Array = NDArray[np.float64]

TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10)
# Share of the tolerance that the resolution of a flow may take, as in a run.
_FLOW_SHARE = 0.1
_REFERENCE_ORDER = 150


@dataclass(frozen=True)
class Sample:
    """A body of given orientation R (3, 3) at the origin of a flow."""

    aspect_ratio: float
    orientation: Array
    flow: Flow
    kind: str


@dataclass(frozen=True)
class Outcome:
    """True error, estimate, and nodes of the grid of one sample."""

    error: float
    estimate: float
    nodes: tuple[int, int]


def random_sample(rng: np.random.Generator, extreme: float = 50.0) -> Sample:
    """A body with k log-uniform in [1/extreme, extreme], in a flow of one of six kinds.

    Polynomial flows of degree 1 to 3, or a stokeslet, rotlet or stresslet at 1.5 to 5 longest
    semi-axes from the centre (the stricter reading of body lengths), of random direction.
    """
    k = float(extreme ** rng.uniform(-1.0, 1.0))
    turn = rotation.matrix(rotation.random_quaternions(1, rng)[0])
    if rng.uniform() < 0.5:
        degree = int(rng.integers(1, 4))
        parts = [rng.normal(size=3)]
        for order in (1, 2, 3):
            basis = stokes_polynomials(order)
            weights = rng.normal(size=len(basis)) * (order <= degree)
            parts.append(np.tensordot(weights, basis, axes=1))
        return Sample(k, turn, PolynomialFlow(*parts), f"polynomial of degree {degree}")
    place = rotation.random_axes(1, rng)[0] * max(1.0, k) * rng.uniform(1.5, 5.0)
    kind = int(rng.integers(3))
    if kind == 2:
        strain = rng.normal(size=(3, 3))
        strain += strain.T
        strain -= np.trace(strain) / 3.0 * np.eye(3)
        return Sample(k, turn, Stresslet(strain, place), "stresslet")
    flow = (Stokeslet, Rotlet)[kind](rng.normal(size=3), place)
    return Sample(k, turn, flow, flow.type_name)


def examine(sample: Sample, tolerance: float) -> Outcome:
    """Form the body to the tolerance and compare free motion, force and torque with the exact."""
    k, turn, flow = sample.aspect_ratio, sample.orientation, sample.flow
    body = accurate_body(Spheroid(k), tolerance, degree=flow.degree or 3)

    def velocity(points: Array) -> Array:
        return np.asarray(flow.velocity(points @ turn.T) @ turn)

    nodes, left = (body.functional.grid.n_theta, 8), 0.0
    if flow.polynomial is None:
        share = _FLOW_SHARE * tolerance
        start = flow_nodes(float(np.max(confocal_rate(k, flow.singular_points @ turn))), share)
        *found, left = resolving_nodes(body.functional, velocity, share, start)
        nodes = (found[0], found[1])
    return Outcome(_error(body, sample, velocity, nodes), body.model.error_estimate + left, nodes)


def _error(body: AccurateBody, sample: Sample, velocity: Any, nodes: tuple[int, int]) -> float:
    k, turn = sample.aspect_ratio, sample.orientation
    grid = body.functional.on_grid(nodes[1], nodes[0])
    motion = np.einsum("anj,nj->a", grid.weights, velocity(grid.points))
    r = body.model.resistance
    force = np.array([r.translation_transverse, r.translation_transverse, r.translation_axial])
    torque = np.array([r.rotation_transverse, r.rotation_transverse, r.rotation_axial])
    found = [motion[:3], motion[3:], force * motion[:3], torque * motion[3:]]
    arguments = (k, turn, np.zeros(3), sample.flow.velocity, _REFERENCE_ORDER)
    exact = [*faxen.free_motion(*arguments), *faxen.fixed_force_torque(*arguments)]
    return max(
        float(np.linalg.norm(turn @ a - b) / np.linalg.norm(b))
        for a, b in zip(found, exact, strict=True)
    )


def tables(work: Work) -> Iterator[Table]:
    """Honesty on random scenes, and where accuracy ends in the aspect ratio."""
    yield _honesty(work.choose(12, 200), work.say)
    yield _thinness()


def _honesty(count: int, say: Any) -> Table:
    table = Table(
        "honesty",
        f"Tolerance, true error and estimate on {count} random bodies and flows",
        (
            Column("tolerance", "", "asked for", ".0e"),
            Column("missed", "", "samples whose true error exceeds it", "d"),
            Column("worst", "", "largest true error", ".1e"),
            Column("below", "", "samples whose estimate is below the true error", "d"),
            Column("median_ratio", "", "median of estimate over true error", ".3g"),
            Column("within_100", "", "share of samples with the ratio in [1/100, 100]", ".2f"),
            Column("passed", "", "no sample missed and most estimates within 100"),
        ),
        plot={"x": "tolerance", "y": "worst", "scale": "loglog"},
    )
    rng = np.random.default_rng(1)
    samples = [random_sample(rng) for _ in range(count)]
    for tolerance in TOLERANCES:
        say(f"tolerance {tolerance:.0e}")
        outcomes = [examine(sample, tolerance) for sample in samples]
        errors = np.array([outcome.error for outcome in outcomes])
        ratio = np.array([outcome.estimate for outcome in outcomes]) / errors
        missed = int(np.sum(errors > tolerance))
        within = float(np.mean((ratio >= 0.01) & (ratio <= 100.0)))
        table.add(
            tolerance=tolerance,
            missed=missed,
            worst=float(errors.max()),
            below=int(np.sum(ratio < 1.0)),
            median_ratio=float(np.median(ratio)),
            within_100=within,
            passed=missed == 0 and within > 0.5,
        )
    table.notes.append(
        "k log-uniform in [1/50, 50]; polynomial flows of degree 1 to 3, point singularities at "
        "1.5 to 5 longest semi-axes; exact values from the Faxen laws of the ellipsoid."
    )
    return table


def _thinness() -> Table:
    table = Table(
        "thinness",
        "Where accuracy ends: default tolerance at any aspect ratio",
        (
            Column("aspect_ratio", "", "k", ".3g"),
            Column("error", "", "largest of resistance and Faxen coefficients", ".1e"),
            Column("estimate", "", "", ".1e"),
            Column("rounding", "", "part of the estimate that no refinement lowers", ".1e"),
            Column("passed", "", "the estimate is not below half the error"),
        ),
        plot={"x": "aspect_ratio", "y": ["error", "estimate", "rounding"], "scale": "loglog"},
    )
    for k in (1e-3, 1 / 300, 1e-2, 0.02, 0.1, 0.5, 1.0, 2.0, 10.0, 50.0, 100.0, 300.0, 1000.0):
        body = accurate_body(Spheroid(k), 1e-10, strict=False)
        parts = body.model.error_parts
        assert parts is not None
        error = true_error(body.model)
        table.add(
            aspect_ratio=k,
            error=error,
            estimate=parts.total,
            rounding=parts.rounding,
            passed=parts.total >= 0.5 * error,
        )
    table.notes.append(
        "Rounding is magnified by the condition number, about k^-3 for slender bodies; a tolerance "
        "that the estimate exceeds is refused when the case states it."
    )
    return table
