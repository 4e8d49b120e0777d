"""Is what the user asks for what the user gets? Tolerance against true error and its estimate.

200 random bodies, k log-uniform in [1/50, 50], in random flows: polynomials of degree 1 to 3, or a
stokeslet, rotlet or stresslet at 1.5 to 5 longest semi-axes from the centre. The error is the
largest of free velocity, free angular velocity, force and torque (of the body held fixed), each
relative to its own length, against Faxen's laws of the ellipsoid (Kim & Karrila 1991, chapter 3).

Run:      python cases/benchmarks/honesty.py      (3 min; --small: 10 s; --csv)
Expected: no tolerance missed; estimates mostly within a factor of 100 of the error.
"""

import numpy as np
from measure import command
from numpy.typing import NDArray

from qbxstokes.bie.accuracy import accurate_body
from qbxstokes.bie.faxen import stokes_polynomials
from qbxstokes.bie.resolution import flow_nodes, resolving_nodes
from qbxstokes.flows import PolynomialFlow
from qbxstokes.flows.singularities import Rotlet, Stokeslet, Stresslet
from qbxstokes.geometry import rotation
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.reference import faxen

Array = NDArray[np.float64]

TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10)
# Share of the tolerance that the resolution of a singular flow may take, as in a run.
SHARE = 0.1
ORDER = 150  # of the quadrature in the exact laws


def random_sample(rng, extreme=50.0):
    """Aspect ratio, orientation (a quaternion) and flow about the body at the origin."""
    k = float(extreme ** rng.uniform(-1.0, 1.0))
    q = rotation.random_quaternions(1, rng)[0]
    if rng.uniform() < 0.5:
        degree = int(rng.integers(1, 4))
        parts = [rng.normal(size=3)]
        for order in (1, 2, 3):
            basis = stokes_polynomials(order)
            weights = rng.normal(size=len(basis)) * (order <= degree)
            parts.append(np.tensordot(weights, basis, axes=1))
        return k, q, PolynomialFlow(*parts)
    place = rotation.random_axes(1, rng)[0] * max(1.0, k) * rng.uniform(1.5, 5.0)
    kind = int(rng.integers(3))
    if kind == 2:
        strain = rng.normal(size=(3, 3))
        strain += strain.T
        strain -= np.trace(strain) / 3.0 * np.eye(3)
        return k, q, Stresslet(strain, place)
    return k, q, (Stokeslet, Rotlet)[kind](rng.normal(size=3), place)


def examine(k, q, flow, tolerance):
    """True error and estimate of free motion, force and torque, all in the body frame."""
    body, turn = accurate_body(Spheroid(k), tolerance, degree=flow.degree or 3), rotation.matrix(q)

    def velocity(points):
        return flow.velocity(points @ turn.T) @ turn

    n_theta, n_phi, left = body.functional.grid.n_theta, 8, 0.0
    if flow.polynomial is None:
        share = SHARE * tolerance
        start = flow_nodes(float(np.max(Spheroid(k).decay(flow.singular_points @ turn))), share)
        n_theta, n_phi, left = resolving_nodes(body.functional, velocity, share, start)
    grid = body.functional.on_grid(n_phi, n_theta)
    motion = np.einsum("anj,nj->a", grid.weights, velocity(grid.points)).reshape(2, 3)
    r = body.model.resistance
    force = np.array([r.translation_transverse, r.translation_transverse, r.translation_axial])
    torque = np.array([r.rotation_transverse, r.rotation_transverse, r.rotation_axial])
    found = np.array([*motion, force * motion[0], torque * motion[1]]) @ turn.T
    scene = (k, turn, np.zeros(3), flow.velocity, ORDER)
    exact = np.array([*faxen.free_motion(*scene), *faxen.fixed_force_torque(*scene)])
    errors = np.linalg.norm(found - exact, axis=1) / np.linalg.norm(exact, axis=1)
    return float(errors.max()), body.model.error_estimate + left


@command
def main(small=False):
    """A row per tolerance."""
    rng, rows = np.random.default_rng(1), []
    samples = [random_sample(rng) for _ in range(12 if small else 200)]
    for tolerance in TOLERANCES:
        errors, estimates = np.transpose([examine(*sample, tolerance) for sample in samples])
        ratio = estimates / errors
        rows.append(
            {
                "tolerance": tolerance,
                "missed": int(np.sum(errors > tolerance)),
                "worst": float(errors.max()),
                "estimate_below": int(np.sum(ratio < 1.0)),
                "median_ratio": float(np.median(ratio)),
                "within_100": float(np.mean((ratio >= 0.01) & (ratio <= 100.0))),
            }
        )
    return {"honesty": rows}
