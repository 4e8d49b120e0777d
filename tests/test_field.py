"""The flow around the body against closed forms, the Stokes equations and another evaluation."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from ellipsoid_flows import translating_flow

import qbxstokes as qs
from qbxstokes.bie.exterior import INSIDE, TABLE, resolving_grid, surface_map
from qbxstokes.bie.field import (
    FlowAround,
    mobility_disturbance,
    resistance_disturbance,
)
from qbxstokes.bie.lines import MovingFlow, integrate_lines, streamlines
from qbxstokes.bie.operators import surface_operators
from qbxstokes.flows import build_flow
from qbxstokes.geometry import rotation
from qbxstokes.geometry.grid import SurfaceGrid
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.geometry.symmetric import symmetric
from qbxstokes.qbx.confocal import Harmonics
from qbxstokes.qbx.exterior import WHAT, SurfaceToExterior
from qbxstokes.qbx.operator import GradedScheme, layer_rows
from qbxstokes.qbx.volume import METHODS, LayerPotentials
from qbxstokes.reference import faxen

SHAPES = [1 / 20, 1 / 2, 1.0, 2.0, 20.0]
NOBODY = lambda x: np.zeros_like(x)  # noqa: E731


@cache
def operators(k, n_theta=8, n_phi=8):
    return surface_operators(Spheroid(k), GradedScheme(n_theta), n_phi)


def paraboloid():
    """A flow of degree 2 without any symmetry of the body."""
    turn = {"axis": [1, 2, 3], "angle": 1.0}
    return build_flow(
        {"type": "paraboloid", "curvature": 1.0, "position": [0.3, 0.2, 0.1], "rotation": turn}
    )


@cache
def free_body(k):
    flow = paraboloid()
    force, torque = np.array([1.0, 2.0, 3.0]), np.array([1.0, 0.0, 2.0])
    return mobility_disturbance(operators(k), flow.velocity, force, torque, degree=2)


@cache
def moving_body(k):
    velocity, spin = np.array([0.1, 0.2, 0.3]), np.array([0.3, -0.2, 0.1])
    return resistance_disturbance(operators(k), paraboloid().velocity, velocity, spin, degree=2)


def cloud(k, n, seed=0, least=-12.0, most=1.0):
    """Random points at distances 10^least to 10^most body lengths from the surface."""
    rng = np.random.default_rng(seed)
    d = rng.normal(size=(n, 3))
    d /= np.linalg.norm(d, axis=1)[:, None]
    theta, phi = np.arccos(d[:, 2]), np.arctan2(d[:, 1], d[:, 0])
    distance = 2.0 * max(1.0, k) * 10.0 ** rng.uniform(least, most, n)
    body = Spheroid(k)
    return body.surface(theta, phi) + distance[:, None] * body.normal(theta, phi)


def values(source, x, names, *more):
    """Values at points by name, as a tuple."""
    found = source.evaluate(x, [name for name in names if name != "source"], *more)
    return tuple(found[name] for name in names)


@pytest.mark.parametrize("k", SHAPES)
def test_translating_body_against_lamb(k):
    velocity = np.array([1.0, -2.0, 0.5])
    body = resistance_disturbance(operators(k), NOBODY, velocity, np.zeros(3), degree=0)
    x = cloud(k, 2000)
    u, p, source = values(body, x, ("velocity", "pressure", "source"), 1e-10)
    exact, pressure = translating_flow(k, x, velocity)
    assert np.all(source == TABLE)
    assert np.abs(u - exact).max() < 1e-10
    assert np.abs(p - pressure).max() < 1e-9 * np.abs(pressure).max()


@pytest.mark.parametrize("k", SHAPES)
def test_traction_of_a_translating_body(k):
    """-F h / (4 pi k^2) on the surface, h the support function (Brenner 1964)."""
    velocity = np.array([1.0, -2.0, 0.5])
    body = resistance_disturbance(operators(k), NOBODY, velocity, np.zeros(3), degree=0)
    stokes = build_flow({"type": "uniform", "velocity": [0, 0, 0]})
    around = FlowAround(body, stokes, np.zeros(3), np.eye(3))
    theta, phi = np.linspace(0, np.pi, 7), np.linspace(0, 6, 5)
    found = around.surface(theta, phi)["traction"]
    support = k / Spheroid(k).speed(theta)
    across, along = faxen.resistance(k)[:2]
    drag = -np.array([across, across, along]) * velocity
    exact = drag * support[:, None, None] / (4.0 * np.pi * k * k)
    assert np.abs(found - exact).max() < 1e-10 * np.abs(exact).max()


@pytest.mark.parametrize(("k", "n_theta"), [(0.5, 60), (1.0, 36), (2.0, 80)])
def test_singularities_inside_the_body(k, n_theta):
    """A stokeslet and a rotlet off the centre as boundary data continue outside as themselves."""
    place = [0.1, 0.05, 0.2] if k < 2 else [0.3, 0.1, 0.05]
    terms = [
        {"type": "stokeslet", "position": place, "strength": [1, 2, 3]},
        {"type": "rotlet", "position": place, "strength": [1, -1, 0.5]},
    ]
    inner = build_flow({"type": "sum", "terms": terms})
    grid = SurfaceGrid(Spheroid(k), n_theta, 50)
    table = surface_map(grid, None).flow(inner.velocity(grid.points))
    x = cloud(k, 3000)
    exact = inner.velocity(x)
    size = np.abs(exact).max()
    u, p, s = values(table, x, ("velocity", "pressure", "stress"))
    assert np.abs(u - exact).max() < 1e-10 * size
    assert np.abs(p - inner.pressure(x)).max() < 1e-8 * np.abs(p).max()
    assert np.abs(symmetric(s) - inner.stress(x)).max() < 1e-8 * np.abs(s).max()
    # Leaving out degrees far away keeps the error below what was asked for.
    for tolerance in (1e-4, 1e-6, 1e-8):
        coarse = table.evaluate(x, ("velocity",), tolerance * size)["velocity"]
        assert np.abs(coarse - exact).max() < tolerance * size


def test_integral_equation_reproduces_singularities_inside():
    """The same through the double layer: resistance problem, force and torque included."""
    inner = build_flow({"type": "stokeslet", "position": [0, 0, 0.1], "strength": [1, 2, 3]})
    body = resistance_disturbance(
        operators(1.0, 24, 8), lambda x: -inner.velocity(x), np.zeros(3), np.zeros(3)
    )
    x = cloud(1.0, 300)
    assert np.abs(body.evaluate(x)["velocity"] - inner.velocity(x)).max() < 1e-10
    assert np.allclose(body.force, [1, 2, 3], atol=1e-10)
    assert np.allclose(body.torque, np.cross([0, 0, 0.1], [1, 2, 3]), atol=1e-10)


@pytest.mark.parametrize("k", SHAPES)
@pytest.mark.parametrize("problem", [free_body, moving_body])
def test_table_against_quadrature(k, problem):
    """Two evaluations of one field; the error of QBX comes from the density's, worst if thin."""
    body = problem(k)
    assert body.boundary_error < 1e-11 * body.scale
    x = np.concatenate([cloud(k, 4, 1, -9, -3), cloud(k, 4, 2, -2, 1)])
    table = body.evaluate(x, WHAT)
    direct = body.evaluate(x, WHAT, 1e-11, "quadrature")
    assert {int(i) for i in direct["source"]} <= set(range(len(METHODS)))
    assert np.abs(table["velocity"] - direct["velocity"]).max() < 1e-9 * body.scale
    loss = 1e-6 if k in (1 / 20, 20.0) else 1e-10
    for name in WHAT:
        more = 1e3 if name == "pressure_gradient" else 1.0  # on a disc's rim
        size = np.abs(table[name]).max()
        assert np.abs(table[name] - direct[name]).max() < more * loss * size, name


@pytest.mark.parametrize("k", [0.5, 2.0])
def test_every_method_near_its_border(k):
    """Expansion, graded and plain quadrature agree where one hands over to the next."""
    body = moving_body(k)
    radius = 0.1 * float(Spheroid(k).admissible_radius(1.0))
    foot, normal = Spheroid(k).surface(1.0, 0.3), Spheroid(k).normal(1.0, 0.3)
    for distance, methods in (
        (0.5 * radius, ("expansion", "graded")),
        (1.0 * max(1, k), ("graded", "plain")),
    ):
        x = (foot + distance * normal)[None]
        a, b = (body.potentials.evaluate(x, 1e-12, method)[0] for method in methods)
        for one, other in zip(a.values(), b.values(), strict=True):
            assert np.abs(one - other).max() < 1e-10 * max(1.0, np.abs(one).max())


@pytest.mark.parametrize(("factor", "share"), [(1.0, 0.3), (1.001, 0.3), (1.1, 0.9)])
def test_convergence_in_the_order_of_the_expansion(factor, share):
    """The error falls as (|x - c|/R)^p, R the distance from the centre c to the focal segment.

    The field of a polynomial density continues through the surface up to there. Away from the
    surface the ball is taken larger, so that it holds the target.
    """
    k = 0.5
    body = moving_body(k)
    x = factor * Spheroid(k).surface(0.8, 0.0)
    exact = body.table.evaluate(x[None])["velocity"]
    layer, orders = body.potentials, np.arange(6, 17, 2)
    errors = []
    for order in orders:
        coarse = LayerPotentials(layer.grid, layer.density, layer.weight, int(order), share)
        found = coarse.evaluate(x[None], method="expansion")[0]["velocity"]
        errors.append(np.abs(found - exact).max())
    theta, _ = Spheroid(k).nearest(x[0], x[2])
    radius = share * float(Spheroid(k).admissible_radius(theta))
    centre = Spheroid(k).surface(theta, 0.0) + radius * Spheroid(k).normal(theta, 0.0)
    focus = np.sqrt(1 - k * k)
    reach = np.hypot(centre[0], max(centre[2] - focus, 0.0))
    expected = np.log10(reach / np.linalg.norm(x - centre))
    slope = -np.polyfit(orders, np.log10(errors), 1)[0]
    assert expected - 0.1 < slope < expected + 0.1


def test_convergence_of_plain_quadrature_far_away():
    """x 3: the error falls as t^(2n), t = (1 + k)/(alpha + gamma) of the confocal spheroid."""
    k = 0.5
    body = moving_body(k)
    x = 3.0 * Spheroid(k).surface(0.8, 0.0)[None]
    exact = body.table.evaluate(x)["velocity"]
    tolerances = 10.0 ** -np.arange(2.0, 12.0, 2.0)
    found = [body.potentials.evaluate(x, t, "plain")[0]["velocity"] for t in tolerances]
    errors = [np.abs(u - exact).max() for u in found]
    assert np.all(np.array(errors) < tolerances * body.scale + 1e-14)
    assert np.polyfit(np.log10(tolerances[:4]), np.log10(errors[:4]), 1)[0] > 0.7


@pytest.mark.parametrize("k", SHAPES)
def test_stokes_equations(k):
    """Divergence of velocity and stress vanish, stress is that of the velocity (differences)."""
    body = free_body(k)
    x = cloud(k, 20, 5, -1.0, 0.5)
    step = 1e-4 * min(1.0, k)
    gradient, force = np.zeros((len(x), 3, 3)), np.zeros((len(x), 3))
    own = body.evaluate(x, WHAT)
    pressure, stress = own["pressure"], own["stress"]
    for j in range(3):
        ahead, behind = (body.evaluate(x + s * step * np.eye(3)[j], WHAT) for s in (1.0, -1.0))
        gradient[:, :, j] = (ahead["velocity"] - behind["velocity"]) / (2.0 * step)
        change = symmetric(ahead["stress"]) - symmetric(behind["stress"])
        force += change[:, :, j] / (2.0 * step)
        slope = (ahead["pressure"] - behind["pressure"]) / (2.0 * step)
        off = np.abs(slope - own["pressure_gradient"][:, j]).max()
        assert off < 1e-4 * np.abs(own["pressure_gradient"]).max()
    assert np.abs(gradient - own["gradient"]).max() < 1e-5 * np.abs(gradient).max()
    size = np.abs(gradient).max()
    assert np.abs(np.trace(gradient, axis1=1, axis2=2)).max() < 1e-5 * size
    whole = gradient + gradient.swapaxes(1, 2) - pressure[:, None, None] * np.eye(3)
    assert np.abs(symmetric(stress) - whole).max() < 1e-5 * np.abs(whole).max()
    assert np.abs(force).max() < 1e-4 * np.abs(stress).max() / min(1.0, k)


@pytest.mark.parametrize("k", SHAPES)
def test_flux_force_and_torque_through_an_enclosing_sphere(k):
    body = free_body(k)
    z, w = np.polynomial.legendre.leggauss(30)
    phi = 2 * np.pi * np.arange(40) / 40
    s = np.sqrt(1 - z * z)
    n = np.stack(
        np.broadcast_arrays(s[:, None] * np.cos(phi), s[:, None] * np.sin(phi), z[:, None])
    )
    n = np.moveaxis(n, 0, -1).reshape(-1, 3)
    weights = np.repeat(w * 2 * np.pi / 40, 40)
    radius = 2.0 * max(1.0, k)
    u, stress = values(body, radius * n, ("velocity", "stress"))
    assert abs(weights @ np.sum(u * n, axis=1)) < 1e-12 * body.scale
    traction = np.einsum("nij,nj->ni", symmetric(stress), n) * radius**2
    force = weights @ traction
    torque = weights @ np.cross(radius * n, traction)
    # The fluid outside pulls at the sphere against what the body puts into the fluid.
    assert np.allclose(force, [-1, -2, -3], atol=1e-9 * max(1, k) ** 2)
    assert np.allclose(torque, [-1, 0, -2], atol=1e-9 * max(1, k) ** 3)


def test_flow_past_a_fixed_sphere():
    """Stokes 1851: u = U - (3/4)(U/r + x (U.x)/r^3) - (1/4)(U/r^3 - 3 x (U.x)/r^5)."""
    flow = build_flow({"type": "uniform", "velocity": [1.0, 0.0, 0.0]})
    zero = np.zeros(3)
    body = resistance_disturbance(operators(1.0), flow.velocity, zero, zero, degree=0)
    around = FlowAround(body, flow, np.array([1.0, 2.0, 3.0]), np.eye(3))
    x = cloud(1.0, 500)
    found = around.evaluate(x + around.position)
    u, r, along = np.array([1.0, 0, 0]), np.linalg.norm(x, axis=1)[:, None], x[:, :1]
    exact = u - 0.75 * (u / r + x * along / r**3) - 0.25 * (u / r**3 - 3 * x * along / r**5)
    assert np.abs(found["velocity"] - exact).max() < 1e-13
    assert np.abs(found["pressure"] + 1.5 * along[:, 0] / r[:, 0] ** 3).max() < 1e-12


@pytest.mark.parametrize("k", [1 / 20, 0.5, 1.0, 2.0, 20.0])
def test_single_layer_of_harmonics_against_qbx(k):
    """The closed form of the Stokes single layer against its quadrature by expansion."""
    grid = SurfaceGrid(Spheroid(k), 8, 8)
    scheme = GradedScheme(8)
    _, single = layer_rows(Spheroid(k), scheme, 2, [1, 5], with_single=True)
    # Density e_z sin(theta) d theta d phi / (8 pi): mode 0, component z.
    for index, row in enumerate((1, 5)):
        found = single[index, 0, :, 2, :].sum(axis=-1)
        layer = LayerPotentials(grid, np.zeros((64, 3)), np.array([0, 0, 1.0, 0, 0, 0]))
        x = Spheroid(k).surface(grid.theta[row], 0.0)[None]
        u = layer.evaluate(x, 1e-12, "expansion")[0]["velocity"][0]
        assert np.allclose([u[0], u[2]], found[[0, 2]], atol=1e-11)
        # and e_z is the density of a body that translates, up to its resistance
        table = SurfaceToExterior(grid, 2).flow(np.tile([0.0, 0.0, 1.0], (64, 1)))
        value = table.evaluate(x * (1 + 1e-15))["velocity"][0]
        assert np.allclose(value, [0, 0, 1], atol=1e-12)
        assert np.allclose(u[2] * faxen.resistance(k)[1], 4 * np.pi, rtol=1e-10)


def test_harmonics_of_extreme_shapes_are_finite():
    for k in (1e-3, 1 - 1e-9, 1 + 1e-9, 1e3):
        h = Harmonics(Spheroid(k), 12, 40)
        for name in ("ratio", "gain", "rise", "fall", "diagonal"):
            assert np.all(np.isfinite(getattr(h, name)))
        assert np.all(h.gain[np.arange(12)[:, None] <= np.arange(41)] > 0)


def test_nearest_point():
    for k in (0.1, 1.0, 7.0):
        body = Spheroid(k)
        theta = np.array([0.0, 0.3, 1.2, np.pi / 2, 3.0])
        for t, d in ((t, d) for t in theta for d in (0.0, 1e-9, 0.1, 30.0)):
            x = body.surface(t, 0.0) + d * body.normal(t, 0.0)
            found, distance = Spheroid(k).nearest(x[0], x[2])
            assert distance == pytest.approx(d, abs=1e-13 * max(1.0, k))
            assert found == pytest.approx(t, abs=1e-6)


def test_points_inside_are_marked_and_nan():
    body = free_body(0.5)
    x = np.array([[0, 0, 0.99], [0.2, 0.1, 0], [0.0, 0.0, 1.0], [np.nan, 0, 0], [0.6, 0, 0]])
    found = body.evaluate(x, WHAT)
    inside = [True, True, False, True, False]
    assert (found["source"] == INSIDE).tolist() == inside
    for name in WHAT:
        assert np.isnan(found[name].reshape(5, -1)[:, 0]).tolist() == inside


def test_one_path_chooses_by_tolerance():
    """A table too coarse for the flow is kept where its error has decayed, QBX takes the rest."""
    flow = build_flow({"type": "stokeslet", "position": [0, 1.8, 0], "strength": [1, 1, 0]})
    zero = np.zeros(3)
    body = resistance_disturbance(operators(0.5, 12, 16), flow.velocity, zero, zero)
    limit = 3.0 * body.boundary_error / body.scale
    assert np.all(body.evaluate(cloud(0.5, 5), tolerance=limit)["source"] == TABLE)
    x = np.concatenate([cloud(0.5, 2, 0, -4, -3), 10.0 * cloud(0.5, 2, 1, 0, 1)])
    source = body.evaluate(x, tolerance=limit / 1e3)["source"]
    assert np.all(source[:2] < TABLE)
    assert np.all(source[2:] == TABLE)


def test_grid_that_resolves_a_flow():
    near = build_flow({"type": "stokeslet", "position": [0, 2.0, 0], "strength": [1, 1, 0]})
    far = build_flow({"type": "stokeslet", "position": [0, 5.0, 0], "strength": [1, 1, 0]})
    body = Spheroid(0.5)
    assert resolving_grid(body, paraboloid().velocity, 1e-10) == (8, 8)
    assert resolving_grid(body, far.velocity, 1e-8) < resolving_grid(body, near.velocity, 1e-8)


def test_frames_turn_together():
    """The flow in space of a turned body in a turned flow is the turned flow."""
    flow, k = paraboloid(), 0.5
    turn = rotation.matrix(rotation.normalize(np.array([1.0, 0.3, -0.2, 0.5])))
    place = np.array([0.4, -0.1, 0.2])
    turned = flow.shifted(-place).rotated(turn)  # so that both see the same flow in the body

    def around(flow, place, turn):
        def background(x):
            return flow.velocity(x @ turn.T + place) @ turn

        body = mobility_disturbance(operators(k), background, degree=2)
        return FlowAround(body, flow, place, turn)

    x = cloud(k, 50, 3, -3, 0.5)
    one = around(flow, place, np.eye(3)).evaluate(x + place)
    other = around(turned, np.zeros(3), turn).evaluate(x @ turn.T)
    assert np.allclose(one["velocity"] @ turn.T, other["velocity"], atol=1e-12)
    stress = np.einsum("ai,nij,bj->nab", turn, symmetric(one["stress"]), turn)
    pressure = one["pressure"] - other["pressure"]  # known up to a constant
    assert np.ptp(pressure) < 1e-11
    shift = pressure.mean() * np.eye(3)
    assert np.allclose(stress + shift, symmetric(other["stress"]), atol=1e-11)


def test_streamlines_stay_outside_and_on_their_surfaces():
    """Shear past a sphere held at rest: the mirror plane is invariant, the surface not crossed."""
    flow = build_flow({"type": "shear"})
    zero = np.zeros(3)
    body = resistance_disturbance(operators(1.0), flow.velocity, zero, zero, degree=1)
    around = FlowAround(body, flow, zero, np.eye(3))
    starts = np.array([[-3.0, y, 0.0] for y in (1e-3, 0.1, 0.4)] + [[1.0 + 1e-9, 0, 0]] * 2)
    starts[-1] = [0.1, 0.1, 0.1]
    lines = streamlines(around, starts, 9.0, 60, 1e-8, False)
    assert lines.shape == (5, 60, 3)
    assert np.isnan(lines[4]).all()
    assert np.linalg.norm(lines[:4], axis=-1).min() > 1.0 - 1e-15
    assert np.abs(lines[:4, :, 2]).max() < 1e-7
    steps = np.linalg.norm(np.diff(lines[:3], axis=1), axis=-1)
    assert steps.max() < 9.0 / 59 * (1 + 1e-6)


def test_path_lines_conserve_the_stream_function():
    """Uniform flow past a fixed sphere: psi = rho^2 (1/2 - 3/(4r) + 1/(4r^3)) along every line."""
    flow = build_flow({"type": "uniform", "velocity": [0.0, 0.0, 1.0]})
    grid = SurfaceGrid(Spheroid(1.0), 8, 6)
    moving = MovingFlow(grid, flow, 0)
    zero = np.zeros(3)

    def velocity(t, x):
        return moving.relative_velocity(t, zero, np.eye(3), zero, zero, x)

    starts = np.array([[0.05, 0.0, -3.0], [0.5, 0.2, -2.0], [0.0, 1e-3, -1.5]])
    lines = integrate_lines(velocity, starts, (1.0, 1.0, 1.0), np.linspace(0, 20, 40), 1e-10, False)
    r = np.linalg.norm(lines, axis=-1)
    psi = (lines[..., 0] ** 2 + lines[..., 1] ** 2) * (0.5 - 0.75 / r + 0.25 / r**3)
    assert r.min() > 1.0
    assert np.abs(psi / psi[:, :1] - 1.0).max() < 1e-7


def test_nothing_disturbs_a_fluid_at_rest():
    """The solver is never asked, so that it has no iterations to tell of."""
    still = {"type": "uniform", "velocity": [0.0, 0.0, 0.0]}
    plane = {"shape": [5, 5], "extent": [2.0, 3.0, 2.0, 3.0]}
    found = qs.run(
        {"task": "field", "body": {"aspect_ratio": 0.5}, "flow": still, "field": {"plane": plane}}
    )
    assert not np.any(found.velocity)
