"""Flows over twelve decades of magnitude: results scale with the flow, exactly."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from qbxstokes.app.stress.checks import Checks
from qbxstokes.app.stress.scenes import random_scene
from qbxstokes.app.tabulate import Work
from qbxstokes.geometry import rotation
from qbxstokes.io.tables import Column, Table

TOLERANCE = 1e-10


def tables(work: Work) -> Iterator[Table]:
    """Motion in a flow times s over time t/s (and St/s), against that in the flow itself."""
    from qbxstokes.petsc.stepper import integrate

    checks = Checks(
        "magnitudes",
        "Flows times a factor: rates over the factor, and motions over stretched time",
        (Column("factor", format=".0e"), Column("quantity")),
        "largest relative difference",
    )
    rng = np.random.default_rng(work.section.seed)
    scenes = [random_scene(rng, (0.3, 3.0)) for _ in range(work.choose(2, 10))]
    for power in work.choose((-6, 6), (-9, -6, -3, -1, 1, 3, 6, 9)):
        work.say(f"magnitude 1e{power}")
        for base, bound in ((2.0, 0.0), (10.0, 1e-14)):
            # Powers of two leave every digit as it is.
            factor = 2.0 ** round(power / np.log10(2.0)) if base == 2.0 else 10.0**power
            what = "rates, power of two" if base == 2.0 else "rates"
            for scene in scenes:
                scaled = replace(
                    scene,
                    flow=scene.flow.scaled(factor),
                    velocity=factor * scene.velocity,
                    angular_velocity=factor * scene.angular_velocity,
                )
                own, other = scene.motion(), scaled.motion() / factor
                error = float(np.max(np.abs(other - own).max(axis=1) / scene.motion_scale))
                checks.see(10.0**power, what, value=error, bound=bound or 1e-300)
                if base == 2.0:
                    continue
                times = np.array([0.0, 3.0]) / max(1.0, scene.scale)
                for stokes in (0.0, 10.0):
                    one = integrate(*scene.state(stokes), times, TOLERANCE).states[-1, 0]
                    two = integrate(
                        *scaled.state(stokes / factor), times / factor, TOLERANCE
                    ).states[-1, 0]
                    turn = np.abs(rotation.axis(one[3:7]) - rotation.axis(two[3:7])).max()
                    way = np.abs(one[:3] - two[:3]).max()
                    name = "motion, massless" if stokes == 0.0 else "motion, St = 10/factor"
                    error = float(max(turn, way))
                    checks.see(10.0**power, name, value=error, bound=20.0 * TOLERANCE)
    yield checks.table()
