"""The exterior field of a body: closed forms of all it gives, and its errors as promised."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from ellipsoid_flows import straining_flow, translating_flow

import qbxstokes as qs
from qbxstokes.bie.exterior import INSIDE, ExteriorField
from qbxstokes.bie.field import resistance_disturbance
from qbxstokes.bie.operators import surface_operators
from qbxstokes.errors import FlowError, SceneError
from qbxstokes.geometry.grid import SurfaceGrid
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.geometry.symmetric import components
from qbxstokes.qbx.exterior import WHAT
from qbxstokes.qbx.operator import GradedScheme
from qbxstokes.reference import faxen
from qbxstokes.reference.stress import stresslet_numbers

SHAPES = [1 / 50, 0.5, 2.0, 50.0]
SPIN = np.array([[0.0, -0.7, 0.4], [0.7, 0.0, -1.1], [-0.4, 1.1, 0.0]])
STRAIN = np.array([[0.5, 0.3, -1.0], [0.3, 0.7, 0.8], [-1.0, 0.8, -1.2]])


@cache
def body(k):
    return qs.Body(k)


def cloud(k, count, seed=0):
    """Points from the surface (poles and rim too) to 1e6 body lengths away."""
    rng, shape = np.random.default_rng(seed), Spheroid(k)
    theta = np.concatenate([np.linspace(0.0, np.pi, 31), rng.uniform(0.0, np.pi, count)])
    phi = rng.uniform(0.0, 2.0 * np.pi, theta.size)
    distance = shape.radius * 10.0 ** rng.uniform(-12.0, 6.0, theta.size)
    distance[:31] = 0.0
    return shape.surface(theta, phi) + distance[:, None] * shape.normal(theta, phi)


@pytest.mark.parametrize("k", SHAPES)
@pytest.mark.parametrize("matrix", [SPIN, STRAIN, SPIN + STRAIN])
def test_rotating_and_straining_spheroids(k, matrix):
    field = body(k).exterior(lambda x: x @ matrix.T, tolerance=1e-10)
    x = cloud(k, 200)
    found, exact = field.evaluate(x, WHAT, 1e-12), straining_flow(k, x, matrix)
    promised = field.errors
    for name in WHAT:
        error, size = np.abs(found[name] - exact[name]).max(), np.abs(exact[name]).max()
        # The closed form rounds as well, on thin bodies as much, and on each machine in its way.
        assert error < {1 / 50: 5e-11, 50.0: 2e-11}.get(k, 5e-12) * size, name
        assert error < 3.0 * promised[name], name
        assert promised[name] < 1e-9 * max(size, np.abs(exact["gradient"]).max()), name


@pytest.mark.parametrize("k", SHAPES)
def test_translating_spheroid(k):
    speed = np.array([1.0, -2.0, 0.5])
    field = body(k).exterior(lambda x: np.broadcast_to(speed, x.shape), tolerance=1e-10)
    x = cloud(k, 500)
    found, (u, p) = field.evaluate(x, WHAT, 1e-12), translating_flow(k, x, speed)
    assert np.abs(found["velocity"] - u).max() < 1e-12
    assert np.abs(found["pressure"] - p).max() < 1e-11 * np.abs(p).max()
    across, along = faxen.resistance(k)[:2]
    force, torque = field.loads
    assert np.allclose(force, speed * [across, across, along], rtol=1e-11)
    assert np.abs(torque).max() < 1e-11 * np.abs(force).max()
    slope = found["gradient"]
    stress = slope + slope.swapaxes(1, 2) - found["pressure"][:, None, None] * np.eye(3)
    assert np.abs(components(stress) - found["stress"]).max() < 1e-11 * np.abs(stress).max()


@pytest.mark.parametrize("k", [0.2, 3.0])
def test_torque_and_stresslet(k):
    field = body(k).exterior(lambda x: -x @ np.diag([-0.5, -0.5, 1.0]))
    assert np.allclose(field.stresslet, stresslet_numbers(k)[0] * np.diag([-0.5, -0.5, 1.0]))
    turning, spinning = faxen.resistance(k)[2:]
    torque = body(k).exterior(lambda x: np.cross([0.3, -0.2, 0.5], x)).loads[1]
    assert np.allclose(torque, np.array([0.3, -0.2, 0.5]) * [turning, turning, spinning])


def interior(rng, k):
    """Singularities inside the body, whose flow goes on outside as it is."""
    terms = []
    for kind in rng.choice(["stokeslet", "rotlet", "stresslet"], rng.integers(1, 4)):
        place = rng.standard_normal(3)
        place *= rng.uniform(0.0, 0.6) / np.linalg.norm(place) * np.array([k, k, 1.0])
        strength = rng.standard_normal((3, 3) if kind == "stresslet" else 3)
        if kind == "stresslet":
            strength = strength + strength.T
            strength -= np.trace(strength) / 3.0 * np.eye(3)
        terms.append({"type": str(kind), "position": place.tolist(), "strength": strength.tolist()})
    return qs.flow("sum", terms=terms)


def truth(flow, x):
    values = flow.velocity(x), flow.gradient(x), flow.pressure(x), flow.laplacian(x)
    return dict(zip(WHAT, (*values, components(flow.stress(x))), strict=True))


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))]
)
def test_estimated_errors_of_random_fields(seed):
    """Never below a third of the true ones, whether a function is known or values alone."""
    rng = np.random.default_rng(seed)
    for _ in range(6):
        k = float(np.exp(rng.uniform(np.log(0.15), np.log(7.0))))
        flow, grid = (
            interior(rng, k),
            SurfaceGrid(Spheroid(k), int(rng.integers(10, 40)), int(rng.integers(8, 36))),
        )
        known = flow.velocity if rng.random() < 0.5 else None
        field = ExteriorField(grid, flow.velocity(grid.points), None, known)
        x = cloud(k, 600, seed)
        found, exact = field.evaluate(x, WHAT, 0.0, "table"), truth(flow, x)
        for name in WHAT:
            error = np.abs(found[name] - exact[name]).max()
            assert field.errors[name] > error / 3.0, (name, k, grid.n_theta, grid.n_phi)
            if known is not None and np.isfinite(field.errors[name]):
                assert field.errors[name] < 30.0 * error + 1e-9 * np.abs(exact[name]).max()


def test_tolerance_of_a_function_and_of_values():
    k, flow = 0.6, qs.flow("stokeslet", position=[0.1, 0.0, 0.2], strength=[1, 2, 3])
    x = cloud(k, 300)
    exact = flow.velocity(x)
    for tolerance in (1e-4, 1e-8):
        field = body(k).exterior(flow.velocity, tolerance=tolerance)
        found = field.evaluate(x)["velocity"]
        assert np.abs(found - exact).max() < tolerance * field.scale
        assert field.boundary_error < tolerance * field.scale
    values = flow.velocity(body(k).surface(50, 40))
    assert values.shape == (50, 40, 3)
    given = body(k).exterior(values)
    found = given.evaluate(x, ["velocity"], 1e-6)["velocity"]
    assert np.abs(found - exact).max() < 1e-6 * given.scale
    coarse = body(k).exterior(flow.velocity(body(k).surface(12, 12)))
    with pytest.raises(FlowError, match="has no density to be summed"):
        coarse.evaluate(x, ["velocity"], 1e-8)


@pytest.mark.parametrize("k", [0.5, 2.0])
def test_field_of_a_density_by_both_ways(k):
    """The density of a straining body: table and direct sums give what the closed form has."""
    operators = surface_operators(Spheroid(k), GradedScheme(8), 8)
    matrix = SPIN + STRAIN
    zero = np.zeros(3)
    solved = resistance_disturbance(operators, lambda x: -x @ matrix.T, zero, zero, degree=1)
    psi = solved.potentials.density.reshape(8, 8, 3)
    loads = {"force": solved.force, "torque": solved.torque}
    field = body(k).exterior(density=psi, **loads, tolerance=1e-11)
    x = cloud(k, 0)[::6]
    x = np.concatenate([x, 1.05 * x, 4.0 * x])
    exact = straining_flow(k, x, matrix)
    for method, bound in (("table", 1e-9), ("quadrature", 1e-8)):
        found = field.evaluate(x, WHAT, 1e-11, method)
        for name in WHAT:
            size = np.abs(exact[name]).max()
            assert np.abs(found[name] - exact[name]).max() < bound * size, (method, name)


def test_gradients_in_space_are_those_of_the_whole_flow():
    """Shear past a turned spheroid: against differences of its own velocity and pressure."""
    place = {"position": [0.0, 1.0, 0.0], "orientation": [1.0, 1.0, 0.3]}
    x, step = np.array([[0.3, 2.2, 0.1], [1.4, 0.2, -0.5], [0.0, 1.0, 0.0]]), 1e-4
    flow = qs.flow("paraboloid")

    def at(points):
        return body(0.5).field(flow, points, **place, what=WHAT)

    own = at(x)
    assert own["source"].tolist() == [3, 3, INSIDE]
    assert np.isnan(own["gradient"][2]).all()
    for j, shift in enumerate(step * np.eye(3)):
        ahead, behind = at(x[:2] + shift), at(x[:2] - shift)
        for name, slope in (("velocity", "gradient"), ("pressure", "pressure_gradient")):
            change = (ahead[name] - behind[name]) / (2.0 * step)
            assert np.allclose(own[slope][:2, ..., j], change, atol=1e-6), name


def test_what_is_no_exterior_field_is_refused():
    one = body(0.5)
    with pytest.raises(SceneError, match=r"velocity has shape \(2048, 2\)"):
        qs.Body(0.5).exterior(lambda x: x[:, :2])
    with pytest.raises(SceneError, match="has the net flux"):
        one.exterior(lambda x: x)
    with pytest.raises(SceneError, match="not finite"):
        one.exterior(lambda x: np.where(x > 0.0, np.nan, 0.0))
    with pytest.raises(SceneError, match=r"has shape \(5, 3\)"):
        one.exterior(np.zeros((5, 3)))
    with pytest.raises(SceneError, match="both or neither"):
        one.exterior()
    with pytest.raises(SceneError, match="what asks for 'vorticity'"):
        one.field(qs.flow("shear"), [[2.0, 0.0, 0.0]], what=["vorticity"])
    with pytest.raises(FlowError, match="varies too much"):
        one.exterior(lambda x: np.cross([0, 0, 1], x) * np.sign(x[:, 2:]))
