"""Random scenes by the hundred: symmetries, flows of any magnitude, places far away."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import See
from scenes import (
    AGREEMENT,
    CARRIED,
    MOTION,
    ROUNDING,
    SYMMETRIES,
    TOLERANCE,
    Scene,
    body_of,
    random_scene,
    solve_error,
    symmetry_error,
    time_reversal_error,
    trajectory_error,
)

from qbxstokes.bie.accuracy import choose_scheme
from qbxstokes.bie.operators import surface_operators
from qbxstokes.bie.providers import GridMotion, SolveMotion
from qbxstokes.flows import build_flow
from qbxstokes.flows.named import Paraboloid, Shear
from qbxstokes.geometry import rotation
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.motion.equations import RigidBodyEquations
from qbxstokes.petsc import session
from qbxstokes.reference import faxen, jeffery
from qbxstokes.simulation.hydrodynamics import exact_model

extents = pytest.mark.parametrize("extent", ["small", pytest.param("full", marks=pytest.mark.slow)])


@pytest.fixture(scope="module", autouse=True)
def petsc() -> None:
    session.start([])


def place(scene: Scene) -> str:
    return f"k = {scene.aspect_ratio:.3g}, degree {scene.flow.degree}"


@pytest.mark.slow
def test_invariances(see: See) -> None:
    """Rates, motions over a time of 3, and the ways to a rate, in 400, 24 and 60 scenes."""
    rng = np.random.default_rng(0)
    # Bodies are formed once per aspect ratio; any flow, place and motion goes with them.
    bodies = tuple(np.exp(rng.uniform(-1.0, 1.0, 60) * np.log(20.0)).tolist())
    for _ in range(400):
        scene = random_scene(rng, bodies)
        for name in SYMMETRIES:
            see(symmetry_error(scene, name, rng), ROUNDING, f"{name}, rates, {place(scene)}")
    for _ in range(24):
        scene = random_scene(rng, (0.3, 2.5))
        for stokes in (0.0, 10.0):
            for name in CARRIED:
                error = trajectory_error(scene, name, stokes, rng)
                see(error, MOTION, f"{name}, motion, St = {stokes:g}, {place(scene)}")
        see(time_reversal_error(scene), MOTION, f"time reversal, {place(scene)}")
    for _ in range(60):
        scene = random_scene(rng, bodies)
        see(solve_error(scene), AGREEMENT, f"table against solve, {place(scene)}")
    for _ in range(10):
        scene = random_scene(rng, bodies)
        see(singular_error(scene, rng), AGREEMENT, f"grid against solve, {place(scene)}")


def singular_error(scene: Scene, rng: np.random.Generator) -> float:
    """The functional on the grid against a solve, with a stokeslet three lengths off."""
    k = scene.aspect_ratio
    away = scene.position + 3.0 * max(1.0, k) * rotation.random_axes(1, rng)[0]
    strength = rng.standard_normal(3).tolist()
    stokeslet = build_flow({"type": "stokeslet", "strength": strength}).shifted(away)
    flow = scene.flow + stokeslet
    operators = surface_operators(Spheroid(k), choose_scheme(1e-10, 40), 48)
    x, q = scene.position[None], scene.quaternion[None]
    grid = GridMotion(body_of(k).functional.on_grid(48, 40), flow)
    one, other = grid.free_motion(0.0, x, q), SolveMotion(operators, flow).free_motion(0.0, x, q)
    return float(np.abs(np.concatenate(one) - np.concatenate(other)).max() / scene.scale)


@pytest.mark.slow
def test_magnitudes(see: See) -> None:
    """A flow times s: rates over s, and motions over time t/s with St/s, are as they were."""
    from qbxstokes.petsc.stepper import integrate

    rng = np.random.default_rng(0)
    scenes = [random_scene(rng, (0.3, 3.0)) for _ in range(10)]

    def scaled(scene: Scene, factor: float) -> Scene:
        flow, spin = scene.flow.scaled(factor), factor * scene.angular_velocity
        return replace(scene, flow=flow, velocity=factor * scene.velocity, angular_velocity=spin)

    for power in (-9, -6, -3, -1, 1, 3, 6, 9):
        for scene in scenes:
            # Powers of two leave every digit as it is.
            for factor, bound in (
                (2.0 ** round(power / np.log10(2.0)), 1e-300),
                (10.0**power, 1e-14),
            ):
                difference = np.abs(scaled(scene, factor).motion() / factor - scene.motion())
                error = float(np.max(difference.max(axis=1) / scene.motion_scale))
                see(error, bound, f"rates, factor {factor:g}, {place(scene)}")
            factor, times = 10.0**power, np.array([0.0, 3.0]) / max(1.0, scene.scale)
            for stokes in (0.0, 10.0):
                other, start = scaled(scene, factor).state(stokes / factor)
                one = integrate(*scene.state(stokes), times, TOLERANCE).states[-1, 0]
                two = integrate(other, start, times / factor, TOLERANCE).states[-1, 0]
                turn = np.abs(rotation.axis(one[3:7]) - rotation.axis(two[3:7])).max()
                error = float(max(turn, np.abs(one[:3] - two[:3]).max()))
                see(error, MOTION, f"motion, St = {stokes:g}/factor, factor {factor:g}")


@extents
def test_positions(extent: str, see: See) -> None:
    """Up to 1e8 lengths from the origin the local expansion of the flow loses no digits."""
    from qbxstokes.petsc.stepper import integrate

    rng, small = np.random.default_rng(0), extent == "small"
    rounding = 1e-13  # of numbers of order one
    for distance in (1e6,) if small else (1e2, 1e4, 1e6, 1e8):
        for _ in range(3 if small else 40):
            scene = random_scene(rng, (0.3, 3.0))
            step = np.round(distance * rotation.random_axes(1, rng)[0])
            # Positions on a coarse grid, so that the sum of both holds them exactly.
            scene = replace(scene, position=np.round(scene.position * 64.0) / 64.0)
            far = replace(scene, flow=scene.flow.shifted(step), position=scene.position + step)
            difference = np.abs(far.motion() - scene.motion()).max(axis=1)
            error = float((difference / scene.motion_scale).max())
            see(error, rounding, f"rates at {distance:g}, {place(scene)}")
        for k in (0.2, 0.5, 3.0):
            where = f"k = {k:g} at {distance:g}"
            # Shear of rate one far off the axis of a paraboloid, whose curvature is small there.
            flow, x = Paraboloid(0.5 / distance), np.array([0.0, distance, 0.0])
            axis = rotation.random_axes(1, rng)[0]
            equations = RigidBodyEquations(exact_model(Spheroid(k)), flow)
            start = equations.initial_state(x, rotation.from_axis(axis))
            velocity, spin = equations.velocities(0.0, start)
            u, omega = faxen.free_motion_polynomial(k, axis, *flow.derivatives(x))
            see(float(np.abs(spin[0] - omega).max()), rounding, f"paraboloid, Omega, {where}")
            # The difference of U and u is of order one where u is of the order of the distance.
            error = float(np.abs(velocity[0] - u).max() / np.abs(u).max())
            see(error, rounding, f"paraboloid, U, {where}")
            axis = rotation.random_axes(1, rng)[0]
            equations = RigidBodyEquations(exact_model(Spheroid(k)), Shear())
            start = equations.initial_state([distance, 0.0, distance], rotation.from_axis(axis))
            end = integrate(equations, start, [0.0, 2.0], TOLERANCE).states[-1, 0]
            error = float(np.abs(rotation.axis(end[3:7]) - jeffery.axis_at(2.0, k, axis)).max())
            see(error, 10.0 * TOLERANCE, f"motion in shear, axis, {where}")
