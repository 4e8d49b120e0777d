"""Bodies a million lengths away: the local expansion of the flow loses no digits."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from qbxstokes.app.stress.checks import Checks
from qbxstokes.app.stress.scenes import polynomial, random_scene
from qbxstokes.app.tabulate import Work
from qbxstokes.bie.exact import exact_model
from qbxstokes.geometry import rotation
from qbxstokes.io.tables import Column, Table
from qbxstokes.motion.equations import RigidBodyEquations
from qbxstokes.reference import faxen, jeffery

# Rounding of numbers of order one.
ROUNDING = 1e-13
TOLERANCE = 1e-10


def tables(work: Work) -> Iterator[Table]:
    """Rates and motions far from the origin against those at it, or against closed forms."""
    from qbxstokes.petsc.stepper import integrate

    checks = Checks(
        "positions",
        "Positions far from the origin",
        (Column("distance", "c", format=".0e"), Column("quantity")),
        "largest difference",
    )
    rng = np.random.default_rng(work.section.seed)
    for distance in work.choose((1e6,), (1e2, 1e4, 1e6, 1e8)):
        for _ in range(work.choose(3, 40)):
            scene = random_scene(rng, (0.3, 3.0))
            step = np.round(distance * rotation.random_axes(1, rng)[0])
            # Positions on a coarse grid, so that the sum of both holds them exactly.
            scene = replace(scene, position=np.round(scene.position * 64.0) / 64.0)
            far = replace(scene, flow=scene.flow.shifted(step), position=scene.position + step)
            difference = np.abs(far.motion() - scene.motion()).max(axis=1)
            error = float((difference / scene.motion_scale).max())
            what = f"rates, flow of degree {scene.flow.degree} moved along"
            checks.see(distance, what, value=error, bound=ROUNDING)
        for k in (0.2, 0.5, 3.0):
            _paraboloid(checks, distance, k, rng)
            axis = rotation.random_axes(1, rng)[0]
            flow = polynomial("shear")
            equations = RigidBodyEquations(exact_model(k), flow)
            times = np.array([0.0, 2.0])
            start = equations.initial_state([distance, 0.0, distance], rotation.from_axis(axis))
            run = integrate(equations, start, times, TOLERANCE)
            exact = jeffery.axis_at(2.0, k, axis)
            error = float(np.abs(rotation.axis(run.states[-1, 0, 3:7]) - exact).max())
            bound = 10.0 * TOLERANCE
            checks.see(distance, "motion in shear, axis", value=error, bound=bound, at=f"k = {k:g}")
    checks.note(
        "Rates are U, Omega, F and M, relative to each; the flow is moved as a whole, so that the "
        "body sees the same flow. In the paraboloid the difference of U and u is of order one "
        "where u itself is of the order of the distance."
    )
    yield checks.table()


def _paraboloid(checks: Checks, distance: float, k: float, rng: np.random.Generator) -> None:
    """Shear of rate one far off the axis of a paraboloid, whose curvature is small there."""
    flow = polynomial("paraboloid", curvature=0.5 / distance)
    x = np.array([0.0, distance, 0.0])
    axis = rotation.random_axes(1, rng)[0]
    equations = RigidBodyEquations(exact_model(k), flow)
    velocity, spin = equations.velocities(0.0, equations.initial_state(x, rotation.from_axis(axis)))
    exact = faxen.free_motion_polynomial(k, axis, *flow.derivatives(x))
    error = float(np.abs(spin[0] - exact[1]).max())
    checks.see(distance, "paraboloid, Omega", value=error, bound=ROUNDING, at=f"k = {k:g}")
    error = float(np.abs(velocity[0] - exact[0]).max() / np.abs(exact[0]).max())
    checks.see(distance, "paraboloid, U relative", value=error, bound=ROUNDING, at=f"k = {k:g}")
