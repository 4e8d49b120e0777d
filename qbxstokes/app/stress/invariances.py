"""Symmetries of random scenes, and the table against solving the integral equation."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from qbxstokes.app.stress.checks import Checks
from qbxstokes.app.stress.scenes import SYMMETRIES, Scene, body_of, random_scene
from qbxstokes.app.tabulate import Work
from qbxstokes.bie.accuracy import choose_scheme
from qbxstokes.bie.operators import surface_operators
from qbxstokes.bie.providers import GridMotion, SolveMotion
from qbxstokes.flows import build_flow
from qbxstokes.geometry import rotation
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.io.tables import Column, Table

# Rounding of sums whose terms have the size of the scene's scale.
ROUNDING = 1e-14
# Two ways to the same motion from the same operator.
AGREEMENT = 1e-12
# Trajectories take other steps in another frame.
TOLERANCE = 1e-10
MOTION = 20.0 * TOLERANCE
# The sign of a flow turns an inertial motion into another one.
CARRIED = [name for name in SYMMETRIES if name != "sign"]


def tables(work: Work) -> Iterator[Table]:
    """The table of invariances."""
    checks = Checks(
        "invariances",
        "Symmetries of random scenes",
        (Column("symmetry"), Column("quantity"), Column("scenes", format="d")),
        "largest difference, relative to the terms that are summed",
    )
    rng = np.random.default_rng(work.section.seed)
    # Bodies are formed once per aspect ratio; any flow, place and motion goes with them.
    bodies = tuple(np.exp(rng.uniform(-1.0, 1.0, work.choose(6, 60)) * np.log(20.0)).tolist())
    count = work.choose(12, 400)
    for _ in range(count):
        scene = random_scene(rng, bodies)
        for name in SYMMETRIES:
            error = symmetry_error(scene, name, rng)
            checks.see(name, "rates", count, value=error, bound=ROUNDING, at=_place(scene))
    count = work.choose(2, 24)
    for _ in range(count):
        scene = random_scene(rng, (0.3, 2.5))
        for stokes, what in ((0.0, "motion, massless"), (10.0, "motion, St = 10")):
            for name in CARRIED:
                error = trajectory_error(scene, name, stokes, rng)
                checks.see(name, what, count, value=error, bound=MOTION, at=_place(scene))
        error = time_reversal_error(scene)
        name, what = "time reversal", "motion, massless"
        checks.see(name, what, count, value=error, bound=MOTION, at=_place(scene))
    for what, count, error_of in (
        ("table against solve", work.choose(3, 60), solve_error),
        ("grid against solve", work.choose(0, 10), singular_error),
    ):
        for _ in range(count):
            scene = random_scene(rng, bodies)
            error = error_of(scene, rng)
            checks.see("none", what, count, value=error, bound=AGREEMENT, at=_place(scene))
    checks.note(
        "Rates are U, Omega, F and M at one instant; motions run over a time of 3, and their "
        "bound is twenty times the tolerance of the integration."
    )
    yield checks.table()


def _place(scene: Scene) -> str:
    return f"k = {scene.aspect_ratio:.3g}, degree {scene.flow.degree}"


def symmetry_error(scene: Scene, name: str, rng: np.random.Generator) -> float:
    """Largest difference between the motion carried along and that of the scene carried along."""
    other, carried = SYMMETRIES[name](scene, rng)
    difference = np.abs(other.motion() - carried(scene.motion())).max(axis=1)
    return float(np.max(difference / scene.motion_scale))


def trajectory_error(
    scene: Scene, name: str, stokes_number: float, rng: np.random.Generator
) -> float:
    """Difference of position and axis after a motion, relative to the way and to 1."""
    from qbxstokes.petsc.stepper import integrate

    other, carried = SYMMETRIES[name](scene, rng)
    times = np.array([0.0, 1.5, 3.0]) / max(1.0, scene.scale)
    runs = [integrate(*one.state(stokes_number), times, TOLERANCE) for one in (scene, other)]
    (x, d), (y, e) = (
        (run.states[:, 0, :3] - run.states[0, 0, :3], rotation.axis(run.states[:, 0, 3:7]))
        for run in runs
    )
    # Position and axis follow as velocity and force do; a body has no sign of its axis.
    moved = carried(np.stack([x[-1], 0.0 * x[-1], d[-1], 0.0 * x[-1]]))
    turn = min(np.abs(e[-1] - moved[2]).max(), np.abs(e[-1] + moved[2]).max())
    way = np.abs(y[-1] - moved[0]).max() / max(1.0, np.abs(x).max())
    return float(max(turn, way))


def time_reversal_error(scene: Scene) -> float:
    """How far a massless body ends from its start when the flow is turned round halfway."""
    from qbxstokes.petsc.stepper import integrate

    times = np.array([0.0, 3.0 / max(1.0, scene.scale)])
    there, start = scene.state(0.0)
    end = integrate(there, start, times, TOLERANCE).states[-1]
    model = body_of(scene.aspect_ratio).model
    back = type(there)(model, scene.flow.scaled(-1.0), 0.0)
    again = integrate(back, end, times, TOLERANCE).states[-1]
    turn = rotation.axis(again[0, 3:7]) - rotation.axis(start[0, 3:7])
    way = np.abs(end[0, :3] - start[0, :3]).max()
    distance = np.abs(again[0, :3] - start[0, :3]).max() / max(1.0, way)
    return float(max(np.abs(turn).max(), distance))


def solve_error(scene: Scene, rng: np.random.Generator) -> float:
    """The table on monomials against a solve of the integral equation, free and forced."""
    body = body_of(scene.aspect_ratio)
    operators = surface_operators(Spheroid(scene.aspect_ratio), body.scheme, 10)
    solve = SolveMotion(operators, scene.flow)
    x, q = scene.position[None], scene.quaternion[None]
    free = solve.free_motion(0.0, x, q)
    forced = solve.force_torque(0.0, x, q, scene.velocity[None], scene.angular_velocity[None])
    difference = np.abs(np.concatenate([*free, *forced]) - scene.motion()).max(axis=1)
    return float(np.max(difference / scene.motion_scale))


def singular_error(scene: Scene, rng: np.random.Generator) -> float:
    """The functional on the grid against a solve, with a stokeslet three lengths off."""
    k = scene.aspect_ratio
    place = scene.position + 3.0 * max(1.0, k) * rotation.random_axes(1, rng)[0]
    flow = scene.flow + build_flow(
        {"type": "stokeslet", "strength": rng.standard_normal(3).tolist()}
    ).shifted(place)
    body = body_of(k)
    operators = surface_operators(Spheroid(k), choose_scheme(1e-10, 40), 48)
    x, q = scene.position[None], scene.quaternion[None]
    grid = GridMotion(body.functional.on_grid(48, 40), flow)
    one, other = grid.free_motion(0.0, x, q), SolveMotion(operators, flow).free_motion(0.0, x, q)
    difference = np.abs(np.concatenate(one) - np.concatenate(other)).max()
    return float(difference / scene.scale)
