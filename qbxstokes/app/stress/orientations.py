"""Quaternions of any length, and orientations at and beside the poles of Euler's angles."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from qbxstokes.app.stress.checks import Checks
from qbxstokes.app.stress.scenes import polynomial
from qbxstokes.app.tabulate import Work
from qbxstokes.bie.exact import exact_model
from qbxstokes.geometry import rotation
from qbxstokes.io.tables import Column, Table
from qbxstokes.motion.equations import RigidBodyEquations
from qbxstokes.reference import jeffery

TOLERANCE = 1e-10
ROUNDING = 1e-14


def tables(work: Work) -> Iterator[Table]:
    """Motion, and Euler angles there and back, of starts that are special or odd."""
    from qbxstokes.petsc.stepper import integrate

    checks = Checks(
        "orientations",
        "Odd quaternions and poles",
        (Column("start"), Column("quantity")),
        "largest difference",
    )
    rng = np.random.default_rng(work.section.seed)
    flow = polynomial("shear")
    lengths = (1e-300, 1e-150, 1e-10, 0.3, 7.0, 1e150, 1e300)
    for length in work.choose(lengths[::3], lengths):
        for q in rotation.random_quaternions(work.choose(5, 200), rng):
            error = float(np.abs(rotation.normalize(length * q) - q).max())
            name = f"quaternion of length {length:g}"
            checks.see(name, "orientation", value=error, bound=4e-16)
    directions = {
        "at the pole": 0.0,
        "1e-300 beside": 1e-300,
        "1e-16 beside": 1e-16,
        "1e-12 beside": 1e-12,
        "1e-8 beside": 1e-8,
    }
    for name, angle in directions.items():
        for k in work.choose((0.5,), (0.05, 0.5, 1.0, 2.0, 20.0)):
            equations = RigidBodyEquations(exact_model(k), flow)
            times = np.linspace(0.0, 2.0 * jeffery.period(k), 9)
            for pole in (0.0, np.pi):
                phi, psi = rng.uniform(-3.0, 3.0, 2)
                q = rotation.from_euler(phi, pole + (angle if pole == 0.0 else -angle), psi)
                start = equations.initial_state(np.zeros(3), q)
                run = integrate(equations, start, times, TOLERANCE)
                states = run.states[:, 0, 3:7]
                exact = jeffery.axis_at(times, k, rotation.axis(q))
                at = f"k = {k:g}, theta = {'0' if pole == 0.0 else 'pi'}"
                error = float(np.abs(rotation.axis(states) - exact).max())
                checks.see(name, "axis", value=error, bound=10.0 * TOLERANCE, at=at)
                error = euler_error(np.concatenate([states, q[None]]))
                checks.see(name, "Euler angles and back", value=error, bound=ROUNDING, at=at)
    for q in rotation.random_quaternions(work.choose(50, 5000), rng):
        checks.see("anywhere", "Euler angles and back", value=euler_error(q), bound=ROUNDING)
    yield checks.table()


def euler_error(q: np.ndarray) -> float:
    """Largest entry by which R changes when it goes through Euler's angles."""
    angles = rotation.to_euler(q)
    back = rotation.from_euler(angles[..., 0], angles[..., 1], angles[..., 2])
    return float(np.abs(rotation.matrix(back) - rotation.matrix(q)).max())
