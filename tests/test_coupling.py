"""Several bodies and a wall against exact series for spheres and the laws that hold exactly."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import qbxstokes as qs
from qbxstokes.bie.multiple_scattering import Placed, closest
from qbxstokes.errors import ContactError, SceneError
from qbxstokes.flows.user import UserFlow
from qbxstokes.geometry import rotation
from qbxstokes.motion.coupled import CoupledEquations
from qbxstokes.motion.layout import ORIENTATION, POSITION
from qbxstokes.motion.loads import Loads
from qbxstokes.petsc.coupled import costs, dealt
from qbxstokes.petsc.session import temporary_options
from qbxstokes.reference.bispherical import Bispherical, brenner, near_wall

ORIGIN, SHEAR = [[0.0, 0.0, 0.0]], qs.flow("shear")
UP = qs.Wall(normal=[0.0, 0.0, 1.0])


def test_bispherical_series_have_the_published_values() -> None:
    # Brenner (1961); Goldman, Cox & Brenner (1967), tables 1 and 2; Jeffrey & Onishi (1984).
    assert near_wall(1.1)["normal"] == pytest.approx(11.4591572, abs=1e-7)
    assert near_wall(1.1)["normal"] == pytest.approx(brenner(1.1), rel=1e-12)
    found = near_wall(1.5430806)
    assert found["parallel"] == pytest.approx(1.567459, abs=1e-6)
    assert found["rotation_parallel"] == pytest.approx(1.0998, abs=1e-4)
    assert found["shear_force"] == pytest.approx(1.4391, abs=1e-4)
    assert found["shear_torque"] == pytest.approx(0.97419, abs=4e-5)
    # Far apart: the leading reflections, 1 + 9/(4 s^2) and -3/(2 s) with s = 20.
    pair = Bispherical(1.0, 1.0, 18.0).along() / (6.0 * np.pi)
    assert pair[0, 0] == pytest.approx(1.0 + 9.0 / 4.0 / 400.0, abs=5e-5)
    assert pair[0, 1] == pytest.approx(-1.5 / 20.0, abs=1e-3)


@pytest.mark.parametrize("k", [0.2, 0.5, 1.0, 2.0])
def test_a_body_alone_is_the_law_of_the_integral_equation(k: float) -> None:
    one = qs.Suspension([qs.Body(k)])
    axis = np.array([0.6, 0.0, 0.8])
    r = one.resistance([[1.0, 2.0, 3.0]], [axis])
    turn = np.kron(np.eye(2), rotation.matrix(rotation.from_axis(axis)))
    assert np.allclose(r, turn @ qs.Body(k).resistance @ turn.T, rtol=0, atol=1e-9 * r.max())
    flow = qs.flow("shear") + qs.flow("paraboloid", curvature=0.3)
    u, w = one.free_motion(flow, [[0.1, 0.4, -0.3]], [axis])
    exact = qs.Body(k).free_motion(flow, [0.1, 0.4, -0.3], axis)
    assert np.allclose([u[0], w[0]], exact, atol=1e-9)
    s = one.stresslet(qs.flow("shear"), [[0.0, 0.0, 0.0]], [axis])[0]
    assert np.allclose(s, qs.Body(k).stresslet(qs.flow("shear"), orientation=axis), atol=1e-8)


@pytest.mark.parametrize("height", [1.5430806, 3.0, 10.0])
def test_a_sphere_by_a_wall_is_the_series(height: float) -> None:
    exact = near_wall(height)
    wall = qs.Suspension([qs.Body(1.0)], qs.Wall(), tolerance=1e-10)
    # The wall's normal is x2; the sphere's axis is of no account.
    r = wall.resistance([[0.3, height, 0.0]], [[1.0, 0.0, 1.0]])
    six, eight = 6.0 * np.pi, 8.0 * np.pi
    assert r[1, 1] == pytest.approx(six * exact["normal"], rel=1e-10)
    assert r[0, 0] == pytest.approx(six * exact["parallel"], rel=1e-10)
    assert r[3, 3] == pytest.approx(eight * exact["rotation_parallel"], rel=1e-10)
    assert r[4, 4] == pytest.approx(eight * exact["rotation_normal"], rel=1e-10)
    assert r[2, 3] == pytest.approx(six * exact["coupling"], rel=1e-7)
    assert np.allclose(r, r.T, atol=1e-9)
    force, torque = wall.force_torque(qs.flow("shear"), [[0.3, height, 0.0]])
    assert force[0, 0] == pytest.approx(six * height * exact["shear_force"], rel=1e-10)
    assert torque[0, 2] == pytest.approx(-4.0 * np.pi * exact["shear_torque"], rel=1e-10)


@pytest.mark.parametrize(("second", "gap"), [(1.0, 0.5), (0.5, 0.6)])
def test_two_spheres_are_the_series(second: float, gap: float) -> None:
    bodies = [qs.Body(1.0, size=second), qs.Body(1.0)]
    pair = qs.Suspension(bodies, tolerance=1e-9)
    r = pair.resistance([[0, 0, 0], [0, 0, 1.0 + second + gap]], [[1, 0, 0], [0, 1, 1]])
    series = Bispherical(1.0, second, gap)
    along, across, about = ([8, 2], [6, 10, 0, 4], [11, 5])
    for rows, exact in (
        (along, series.along()),
        (across, series.across()),
        (about, series.about()),
    ):
        assert np.allclose(r[np.ix_(rows, rows)], exact, rtol=0, atol=3e-9 * np.abs(exact).max())


def test_any_scene_has_a_symmetric_positive_resistance_that_the_mobility_inverts() -> None:
    rng = np.random.default_rng(3)
    scene = qs.Suspension([qs.Body(0.5), qs.Body(2.0, size=0.5), qs.Body(0.3)], UP, tolerance=1e-6)
    x = np.array([[0.0, 0.0, 1.6], [2.4, 0.3, 1.8], [-0.5, 2.6, 1.9]])
    axes = rng.normal(size=(3, 3))
    r = scene.resistance(x, axes)
    assert np.abs(r - r.T).max() < 1e-6 * np.abs(r).max()
    assert np.linalg.eigvalsh(r + r.T).min() > 0.0
    load = rng.normal(size=(3, 6))
    u, w = scene.free_motion(None, x, axes, force=load[:, :3], torque=load[:, 3:])
    assert np.allclose(r @ np.concatenate([u, w], 1).ravel(), load.ravel(), atol=1e-5)


def test_no_slip_holds_on_the_wall_and_between_the_nodes() -> None:
    scene = qs.Suspension([qs.Body(0.5), qs.Body(1.0, size=0.7)], UP, tolerance=1e-8)
    x, axes = [[0.0, 0.0, 1.2], [2.2, 0.0, 1.4]], [[0.8, 0.0, 0.6], [0.0, 0.0, 1.0]]
    strain = qs.flow("polynomial", gradient=[[0, 0, 1], [0, 0, 0], [0, 0, 0]])
    plane = np.array([[0.3, 0.2, 0.0], [1.0, -1.0, 0.0], [-4.0, 2.0, 0.0]])
    found = scene.field(strain, plane, x, axes, force=[0.0, 0.0, -1.0])
    assert np.abs(found["velocity"]).max() < 1e-13
    solution = scene.free(strain, x, axes, force=[0.0, 0.0, -1.0])
    theta, phi = np.array([0.3, 1.1, 2.9]), np.array([0.1, 2.0, 5.5])
    arm = scene.bodies[0].shape.surface(theta, phi) @ solution.problem.bodies[0].rotation.T
    field = scene.field(strain, x[0] + (1 + 1e-13) * arm, x, axes, force=[0.0, 0.0, -1.0])
    rigid = solution.velocity[0] + np.cross(solution.angular_velocity[0], arm)
    assert np.abs(field["velocity"] - rigid).max() < 3e-8
    assert field["source"].min() >= 0


def test_a_field_whose_slip_misses_the_tolerance_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("qbxstokes.simulation.flow_among.MOST_NODES", 16)
    scene, x = qs.Suspension([qs.Body(1.0)], UP, tolerance=1e-4), [[0.0, 0.0, 1.15]]
    with pytest.warns(UserWarning, match="tolerance 0.0001 is missed: the slip on a surface is"):
        scene.field(None, [[0.0, 0.0, 0.1]], x, force=[0.0, 0.0, -1.0])


def test_far_wall_and_far_bodies_leave_the_leading_image() -> None:
    body = qs.Body(0.5)
    alone = body.resistance[2, 2]
    for height in (20.0, 40.0):
        r = qs.Suspension([body], UP).resistance([[0, 0, height]])[2, 2]
        # The image of a stokeslet pulls back with 9/(8 h) of 1/(6 pi).
        assert r / alone - 1.0 == pytest.approx(alone / (6 * np.pi) * 9 / (8 * height), rel=0.1)
    pair = qs.Suspension([body, body])
    u, _ = pair.free_motion(None, [[0, 0, 0], [50.0, 0, 0]], force=[0, 0, -1.0])
    assert -u[0, 2] == pytest.approx(1 / alone + 1 / (8 * np.pi * 50.0), rel=1e-4)


def test_gaps_are_those_of_geometry() -> None:
    # Against the least distance between points of the surfaces, by another method: no direction of
    # the common normal, but the four angles of two points.
    from scipy.optimize import minimize

    rng = np.random.default_rng(0)
    for _ in range(6):
        axes = rotation.matrix(rotation.random_quaternions(2, rng))
        bodies = [
            Placed(qs.Spheroid(0.3), 1.0, np.zeros(3), axes[0]),
            Placed(qs.Spheroid(2.0), 0.8, np.array([3.0, 1, 1]), axes[1]),
        ]

        def point(one: Placed, theta: float, phi: float) -> np.ndarray:
            return one.position + one.size * one.rotation @ one.shape.surface(theta, phi)

        def apart(angles: np.ndarray, both: list[Placed] = bodies) -> float:
            return float(np.linalg.norm(point(both[1], *angles[2:]) - point(both[0], *angles[:2])))

        starts = rng.uniform([0, 0, 0, 0], [np.pi, 2 * np.pi, np.pi, 2 * np.pi], size=(6, 4))
        least = min(minimize(apart, start, method="BFGS", tol=1e-12).fun for start in starts)
        assert closest(bodies, None)[0] == pytest.approx(least, abs=1e-9)


def test_what_cannot_be_served_is_told() -> None:
    two = qs.Suspension([qs.Body(1.0)] * 2, UP)
    with pytest.raises(ContactError, match=r"bodies 1 and 2: the gap is -0\.5"):
        two.resistance([[0, 0, 3], [1.5, 0, 3]])
    with pytest.raises(ContactError, match=r"bodies 1 and 2: the gap is -"):
        two.resistance([[0, 0, 3], [0, 0, 3]])
    with pytest.raises(ContactError, match=r"body 1 and the wall: the gap is 0\.0001"):
        two.resistance([[0, 0, 1.0001], [4, 0, 3]])
    with pytest.raises(SceneError, match="slips on the wall"):
        two.free_motion(qs.flow("shear"), [[0, 0, 2], [4, 0, 3]])
    with pytest.raises(SceneError, match="goes through the wall"):
        qs.Wall(normal=[0, 0, 1], velocity=[0, 0, 1])
    with pytest.raises(SceneError, match="position has shape"):
        two.resistance([[0, 0, 3]])
    with pytest.raises(SceneError, match="position is not finite"):
        two.resistance([[0, 0, 3], [0, np.nan, 6]])
    with pytest.raises(SceneError, match="orientation has a zero vector"):
        two.resistance([[0, 0, 3], [0, 0, 6]], [[0, 0, 1], [0, 0, 0]])
    with pytest.raises(SceneError, match="vectors is not finite"):
        two.free_motion(None, [[0, 0, 3], [0, 0, 6]], force=[np.inf, 0, 0])


def test_what_bodies_send_is_their_field() -> None:
    pair = qs.Suspension([qs.Body(0.5), qs.Body(2.0)], UP, tolerance=1e-10)
    places = pair.placed([[0.0, 0.0, 2.0], [2.5, 0.5, 3.5]], [[0.2, 0.1, 1.0], [1.0, 0.3, 0.4]])
    problem = pair.problem(places, [12, 10])
    one, other = problem.maps[0], problem.bodies[1]
    rng = np.random.default_rng(0)
    v = np.tensordot(rng.normal(size=6), one.rigid, 1) + one.grid.points[:, [1, 2, 0]] ** 3
    arrived = problem.arriving({0: one.packed(v, one.inverse)})[problem.slices[1]]
    outside, x = one.flow(v), problem.points[1]
    sent = outside.evaluate(places[0].to_body(x))["velocity"] @ places[0].rotation.T
    sent += problem.reflected(0, outside, x)[0]
    assert np.allclose(arrived @ other.rotation.T, sent, atol=1e-9 * np.abs(sent).max())


def test_two_equal_spheres_fall_side_by_side_and_reversed_motion_returns() -> None:
    pair = qs.Suspension([qs.Body(1.0)] * 2, tolerance=1e-5)
    x = np.array([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0]])
    down = pair.integrate(None, [0.0, 0.5, 1.0], x, force=[0.0, 0.0, -6 * np.pi])
    assert down.position.shape == (3, 2, 3)
    assert down.ended_by is None
    assert np.allclose(down.position[-1, :, 0], x[:, 0], atol=1e-7)
    across = Bispherical(1.0, 1.0, 2.0).across()
    speed = np.linalg.solve(across, [1.0, 0.0, 1.0, 0.0])[0] * 6 * np.pi
    assert down.position[-1, 0, 2] == pytest.approx(-speed, rel=1e-5)
    back = pair.integrate(
        None, [0.0, 1.0], down.position[-1], down.orientation[-1], force=[0.0, 0.0, 6 * np.pi]
    )
    assert np.allclose(back.position[-1], x, atol=1e-7)


def test_a_motion_ends_at_the_wall_by_name() -> None:
    one = qs.Suspension([qs.Body(1.0)], UP, tolerance=1e-3)
    fall = one.integrate(
        None, [0.0, 50.0], [[0, 0, 1.8]], force=[0, 0, -30.0], tolerance=1e-4, least_gap=0.6
    )
    assert fall.ended_by == "clearance"
    assert "body 1 and the wall" in fall.message
    assert fall.gap[-1] == pytest.approx(0.6, abs=1e-6)
    assert fall.summary["events"]["nearest"]["gap"] == fall.gap[-1]
    assert fall.events["clearance"]["gap"] == pytest.approx(0.6, abs=1e-6)


def test_what_a_suspension_cannot_do_is_refused() -> None:
    with pytest.raises(SceneError, match="partly without inertia"):
        qs.Simulation([qs.Body(0.5, stokes_number=1.0), qs.Body(0.5)], SHEAR, position=ORIGIN * 2)
    big = qs.Body(0.5, size=2.0)
    for ask in (lambda: big.resistance, lambda: big.stress, lambda: big.free_motion(SHEAR, ORIGIN)):
        with pytest.raises(SceneError, match="size is 2"):
            ask()
    alone = qs.Suspension([big])
    channel = qs.flow("plane_poiseuille", half_width=3.0)
    with pytest.raises(SceneError, match="body 1 beyond"):
        alone.free_motion(channel, [[0.0, 2.5, 0.0]])
    with pytest.raises(SceneError, match="nobody knows"):
        alone.free_motion(UserFlow(lambda x: x * [1.0, -1.0, 0.0]), ORIGIN)
    inside = qs.flow("stokeslet", strength=[1, 0, 0], position=[0, 0, 1.5])
    with pytest.raises(SceneError, match="singular"):
        alone.free_motion(inside, ORIGIN)


def test_grids_follow_a_singular_flow() -> None:
    near = qs.flow("stokeslet", strength=[1, 0, 0], position=[0, 0, 1.8])
    one, axis = qs.Suspension([qs.Body(0.5)], tolerance=1e-8), [[0.6, 0.0, 0.8]]
    exact = qs.Body(0.5).free_motion(near, [0.0, 0.0, 0.0], axis[0])
    found = one.free_motion(near, ORIGIN, axis)
    assert np.allclose([found[0][0], found[1][0]], exact, rtol=0, atol=1e-8)


@pytest.mark.parametrize("ranks", [2, 3])
@pytest.mark.parametrize("nodes", [[12], [20, 20], [54, 12, 9], [8, 14, 36, 8, 10, 12, 8]])
def test_ranks_share_the_work_whatever_the_bodies(nodes: list[int], ranks: int) -> None:
    scene = qs.Suspension([qs.Body(0.5)] * len(nodes), UP)
    x = [[3.0 * i, 0.0, 2.0] for i in range(len(nodes))]
    problem = scene.problem(scene.placed(x), nodes)
    shares, cost = dealt(problem, ranks), costs(problem)
    for b, n in enumerate(nodes):
        assert sorted(np.concatenate([share.get(b, []) for share in shares])) == list(range(n))
    for stage in problem.stages:
        load = [sum(cost[b] * len(share.get(b, [])) / nodes[b] for b in stage) for share in shares]
        assert max(load) <= 1.15 * sum(load) / ranks


def test_bodies_that_pass_each_other_are_watched_by_few_solves() -> None:
    pair, x = (
        qs.Suspension([qs.Body(1.0)] * 2, tolerance=1e-5),
        [[-3.0, 1.2, 0.0], [3.0, -1.2, 0.0]],
    )
    found = pair.integrate(qs.flow("shear"), [0.0, 6.0], x, tolerance=1e-5)
    assert found.ended_by is None
    assert found.summary["solves"] < 1.25 * found.summary["rhs_evaluations"]
    assert found.summary["events"]["nearest"]["gap"] == pytest.approx(0.646, abs=0.07)


def _pair(stokes_number: float, tolerance: float, **keys: Any) -> Any:
    """Two bodies of some inertia in shear, one of which falls."""
    bodies = [qs.Body(0.5, stokes_number=stokes_number), qs.Body(1.5, stokes_number=stokes_number)]
    return qs.Simulation(
        bodies,
        qs.flow("shear"),
        position=[[0.0, 0.0, 0.0], [3.2, 0.4, 0.3]],
        orientation=[[0.6, 0.0, 0.8], [0.0, 0.6, 0.8]],
        loads=Loads(np.array([[0.0, -1.0, 0.0], [0.0] * 3]), np.zeros((2, 3))),
        tolerance=tolerance,
        **keys,
    )


def test_the_jacobian_of_heavy_bodies_is_that_of_their_drag() -> None:
    """But for how forces change with place and turn, which is left out."""
    together = _pair(0.1, 1e-4, resolution=1e-6).assemble()
    equations, y = together.equations, together.initial + 0.01
    resistance = together.scene.suspension.resistance(y[:, POSITION], y[:, ORIENTATION])
    found, exact = np.zeros((2, 1, y.size, y.size))
    equations.dragged(0.0, y.T, resistance, found)
    equations.jacobian(0.0, y.T, exact)
    found, differences, places = found[0], exact[0], np.arange(y.size).reshape(y.shape)
    rates, kinematic = places[:, 7:].ravel(), places[:, :7].ravel()
    assert np.abs(found[kinematic] - differences[kinematic]).max() < 1e-6
    part = np.ix_(rates, rates)
    assert np.abs(found[part] - differences[part]).max() < 1e-5 * np.abs(found[part]).max()
    # The fastest rate is that of drag, at least as fast as of each body alone.
    fastest = equations.stiffness_at(0.0, y)
    assert equations.stiffness.max() < 1.01 * fastest < 3.0 * equations.stiffness.max()


def test_light_bodies_of_one_fluid_take_implicit_steps() -> None:
    """As accurate as explicit ones, and as few as if drag were slow."""
    light, times = _pair(0.02, 1e-4).integrate([0.0, 0.1]), [0.0, 0.1]
    assert light.summary["method"] == "bdf"
    assert light.summary["rhs_evaluations"] < 400
    with temporary_options("", {}, {"ts_type": "rk", "ts_rk_type": "8vr"}):
        exact = _pair(0.02, 1e-6).integrate(times)
    assert exact.summary["rhs_evaluations"] > 600
    for name in ("position", "axis"):
        assert np.abs(getattr(light, name)[-1] - getattr(exact, name)[-1]).max() < 1e-5


def test_explicit_steps_give_way_where_drag_outgrows_them(monkeypatch: pytest.MonkeyPatch) -> None:
    usual = _pair(20.0, 1e-5).integrate([0.0, 6.0])
    assert usual.summary["method"] in ("5dp", "8vr")
    grown = lambda self, t, y: 1e6  # noqa: E731
    monkeypatch.setattr(CoupledEquations, "stiffness_at", grown)
    found = _pair(20.0, 1e-5).integrate([0.0, 6.0])
    assert found.summary["method"] == "bdf"
    assert "drag outgrew explicit steps" in found.summary["changed"]
    assert np.abs(found.position[-1] - usual.position[-1]).max() < 1e-4


def test_the_pair_that_ends_a_motion_is_the_one_whose_gap_takes_too_many_nodes() -> None:
    """Not the one with the least gap, which two spheres have here."""
    x = [[0, 0, 0], [0, 0, 2.03], [20, 0, 0], [28.05, 0, 0]]
    bodies = [qs.Body(1.0)] * 2 + [qs.Body(4.0)] * 2
    start: dict[str, Any] = {"position": x, "tolerance": 1e-4}
    together = qs.Simulation(bodies, None, None, **start).assemble()
    near = together.nearness(together.initial)
    assert near.pair == (2, 1)
    assert near.gap == pytest.approx(0.03)
    assert near.who == (4, 3)
    assert near.room < 0.0
    assert near.name == "body_contact"
    assert near.reason.startswith("bodies 3 and 4: at the gap 0.05 the tolerance 1e-04 would take")


def test_the_least_gap_is_that_between_steps() -> None:
    bodies, flow = [qs.Body(0.5), qs.Body(0.8)], qs.flow("shear")
    start: dict[str, Any] = {
        "position": [[-2, 0.5, 0], [2, -0.5, 0]],
        "orientation": [[0, 0, 1], [0, 0.6, 0.8]],
    }
    scene = qs.Simulation(bodies, flow, None, **start, tolerance=1e-5, resolution=1e-3)
    found = scene.integrate([0.0, *np.linspace(3.9, 4.1, 11), 5.0])
    nearest = found.summary["events"]["nearest"]
    assert nearest["gap"] == pytest.approx(found.gap.min(), rel=1e-3)
    assert nearest["time"] == pytest.approx(found.time[np.argmin(found.gap)], abs=0.03)


def test_scenes_take_over_the_memory_of_tables() -> None:
    """Scenes that are kept hold none of a gigabyte each; what was lost is made again."""
    x = [[0, 0, 0], [0, 0, 2.5]]
    one, other = (qs.Suspension([qs.Body(k)] * 2, tolerance=1e-3) for k in (0.5, 1.0))
    problem = one.problem(one.placed(x, None))
    first, second = one.resistance_of(problem), other.resistance(x)
    assert problem.workspace is other.problem(other.placed(x, None)).workspace
    assert np.array_equal(one.resistance_of(problem), first)
    assert np.array_equal(other.resistance(x), second)
