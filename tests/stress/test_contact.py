"""Do several bodies near contact keep their tolerance, or say what they miss? RUNS=200 has so many.

Random scenes of one to three spheroids, k log-uniform in [1/5, 5], of sizes apart by up to six
times, tilted, half of them above a wall, the least gap 0.02 to 0.3 of the smallest polar radius,
tolerance in [1e-4, 1e-2]: against grids a fifth finer at a fiftieth of the tolerance. Motions of
two in shear or under loads, against a thirtieth of the tolerance, up to contact.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from conftest import See

import qbxstokes as qs
from qbxstokes.bie.multiple_scattering import closest
from qbxstokes.geometry import rotation
from qbxstokes.motion.loads import Loads

RUNS = int(os.environ.get("RUNS", 6))
UP = qs.Wall(normal=[0.0, 0.0, 1.0])
SHEAR = qs.flow("polynomial", gradient=[[0, 0, 1], [0, 0, 0], [0, 0, 0]])
# Squares of polar nodes, summed over the bodies, above which a scene takes too long.
MOST = 700 if RUNS < 50 else 1800


def scene(seed: int) -> tuple[qs.Suspension, Any, Any, np.random.Generator]:
    """The bodies, their centres and orientations, and what draws the rest."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 4))
    wall = UP if count == 1 or rng.random() < 0.5 else None
    k, size = 5.0 ** rng.uniform(-1, 1, count), 6.0 ** rng.uniform(-0.5, 0.5, count)
    bodies = [qs.Body(float(a), size=float(b)) for a, b in zip(k, size, strict=True)]
    found = qs.Suspension(bodies, wall, tolerance=float(10.0 ** -rng.uniform(2.0, 4.0)))
    q, x = rotation.random_quaternions(count, rng), np.cumsum(rng.normal(size=(count, 3)), axis=0)
    x[:, 2] = np.abs(x[:, 2]) + 0.3
    wanted, low, high = 0.02 * 15.0 ** rng.uniform() * size.min(), 0.0, 200.0
    for _ in range(60):  # blown up about the origin until the least gap is the wanted one
        middle = 0.5 * (low + high)
        near = closest(found.placed(middle * x, q), wall)[0] < wanted
        low, high = (middle, high) if near else (low, middle)
    return found, high * x, q, rng


def served(count: int) -> Iterator[tuple[Any, ...]]:
    """So many scenes with the nodes of their grids, small enough to be done again on finer ones."""
    for seed in itertools.count():
        one, x, q, rng = scene(seed)
        nodes = one.grids(one.placed(x, q), clipped=True)
        if sum(n * n for n in nodes) < MOST:
            yield seed, one, x, q, rng, nodes
            count -= 1
        if not count:
            return


@pytest.mark.slow
def test_estimates_near_contact_are_honest(see: See) -> None:
    """Never below a third of the error; not above 100 times where the tolerance is missed."""
    for seed, one, x, q, rng, nodes in served(RUNS):
        fine = qs.Suspension(one.bodies, one.wall, tolerance=one.tolerance / 50.0)
        finer = [int(1.2 * n) + 6 for n in nodes]
        load, v = rng.normal(size=(2, 2, len(one), 3))
        for name, ask in {
            "free": lambda s, n, x=x, q=q, a=load: s.free(
                SHEAR, x, q, force=a[0], torque=a[1], nodes=n
            ),
            "held": lambda s, n, x=x, q=q, a=v: s.held(
                SHEAR, x, q, velocity=a[0], angular_velocity=a[1], nodes=n
            ),
        }.items():
            rough, exact = ask(one, None), ask(fine, finer)
            for what, share in rough.relative_errors.items():
                true = np.abs(getattr(rough, what) - getattr(exact, what)).max()
                true /= rough.sizes[what]
                where = f"seed {seed}, {name} {what}"
                see(true / share, 3.0, f"error over estimate, {where}")
                see(true / one.tolerance, 3.0, f"error over tolerance, {where}")
                see(share / max(true, 0.03 * one.tolerance), 100.0, f"estimate over error, {where}")


@pytest.mark.slow
def test_fields_near_contact_keep_their_tolerance(see: See) -> None:
    """Velocities from the surfaces on, relative to the largest speed of a surface in the flow."""
    for seed, one, x, q, rng, nodes in served(RUNS // 3):
        points, inner = [], one.placed(x, q)
        for body in inner:
            theta, phi = np.arccos(rng.uniform(-1, 1, 9)), rng.uniform(0, 6.28, 9)
            away = body.shape.normal(theta, phi) * 10.0 ** rng.uniform(-9, 0, (9, 1))
            local = body.shape.surface(theta, phi) + away
            points.append(body.position + body.size * local @ body.rotation.T)
        load, where = rng.normal(size=(len(one), 3)), np.concatenate(points)
        fine = qs.Suspension(one.bodies, one.wall, tolerance=one.tolerance / 50.0)
        asked = {"force": load, "what": ("velocity",)}
        rough = one.field(SHEAR, where, x, q, **asked)["velocity"]
        finer = [2 * n + 8 for n in nodes]
        exact = fine.field(SHEAR, where, x, q, nodes=finer, **asked)["velocity"]
        error = np.nanmax(np.abs(rough - exact)) / np.nanmax(np.abs(exact))
        see(error / one.tolerance, 3.0, f"seed {seed}, gap {closest(inner, one.wall)[0]:.3g}")


@pytest.mark.slow
def test_motions_through_near_contact_end_within_their_expected_error(see: See) -> None:
    for seed in range(RUNS // 3):
        rng = np.random.default_rng(seed)
        k, tolerance = (
            3.0 ** rng.uniform(-1, 1, 2),
            float(10.0 ** -rng.uniform(2.0, 3.5 if RUNS < 50 else 5.0)),
        )
        st = 0.0 if rng.random() < 0.7 else float(10.0 ** rng.uniform(-1, 1))
        bodies, reach = [qs.Body(float(a), stokes_number=st) for a in k], np.maximum(1.0, k).sum()
        offset = rng.uniform(0.1, 0.5) * reach
        start = {
            "position": [[-1.1 * reach, 0, 0.5 * offset], [0.6 * reach, 0.1, -0.5 * offset]],
            "orientation": rotation.random_quaternions(2, rng),
            "loads": Loads(rng.normal(size=(2, 3))),
        }

        def run(tolerance: float, end: float, a: Any = bodies, b: Any = start) -> Any:
            resolved = {"tolerance": tolerance, "resolution": tolerance}
            return qs.Simulation(a, SHEAR, None, **b, **resolved).integrate([0.0, end])

        rough = run(tolerance, float(rng.uniform(3.0, 6.0)))
        exact = run(tolerance / 30.0, float(rough.time[-1]))
        if exact.ended_by:  # it needs wider gaps
            rough = run(tolerance, float(exact.time[-1]))
        nearest = exact.summary["events"]["nearest"]
        # Samples are states with quaternions made unit, which moves surfaces by rounding of a run.
        assert nearest["gap"] <= exact.gap.min() + 1e-10
        error = np.abs(rough.position[-1] - exact.position[-1]).max()
        error = max(error, np.abs(rough.axis[-1] - exact.axis[-1]).max())
        told = rough.summary["expected_error"]["total"]
        see(error / told, 3.0, f"seed {seed}, nearest {nearest['gap']:.3g}, St = {st:.2g}")
