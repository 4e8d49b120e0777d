"""The stresslet of a body: closed forms, Faxen's law in any flow, torque, error estimates."""

from __future__ import annotations

import math

import numpy as np
import pytest
import spheroid_stress

import qbxstokes as qs
from qbxstokes.bie.accuracy import choose_scheme
from qbxstokes.bie.faxen import stokes_polynomials
from qbxstokes.bie.stresslet import STRAINS, GridStress, accurate_stresslet, stresslet_of
from qbxstokes.geometry import rotation
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.reference import stress

SHAPES = (1 / 50, 5.0, *(pytest.param(k, marks=pytest.mark.slow) for k in (0.3, 1.0, 50.0)))


def random_flow(rng: np.random.Generator, degree: int) -> qs.Flow:
    """A polynomial Stokes flow with terms of every degree up to this one."""
    tensors = {"value": rng.standard_normal(3)}
    for name, order in (("gradient", 1), ("hessian", 2), ("third", 3)):
        if order <= degree:
            basis = stokes_polynomials(order)
            tensors[name] = np.tensordot(rng.standard_normal(len(basis)), basis, axes=1)
    return qs.flow("polynomial", **{name: values.tolist() for name, values in tensors.items()})


@pytest.fixture(scope="module", params=SHAPES, ids="k={:g}".format)
def body(request: pytest.FixtureRequest) -> qs.Body:
    """A body whose tolerance rounding allows."""
    return qs.Body(request.param, tolerance=1e-10 if request.param < 0.1 else 1e-11)


@pytest.mark.parametrize("k", [0.1, 0.5, 0.9])
def test_closed_forms_are_those_of_kim_and_karrila(k: float) -> None:
    """Microhydrodynamics, table 3.4: X^M, Y^M, Z^M by the eccentricity of a prolate spheroid."""
    e = math.sqrt(1.0 - k * k)
    log = math.log((1.0 + e) / (1.0 - e))
    x = 8 / 15 * e**5 / ((3 - e**2) * log - 6 * e)
    free = (2 * e * (2 * e**2 - 3) + 3 * (1 - e**2) * log) * (-2 * e + (1 + e**2) * log)
    y = 4 / 5 * e**5 * (2 * e * (1 - 2 * e**2) - (1 - e**2) * log) / free
    z = 16 / 5 * e**5 * (1 - e**2) / (3 * (1 - e**2) ** 2 * log - 2 * e * (3 - 5 * e**2))
    # The formulas of the book cancel towards the sphere, as e^-5.
    assert spheroid_stress.kim_karrila(k) == pytest.approx((x, y, z), rel=1e-14 / e**10)


@pytest.mark.parametrize("k", [0.5476, 0.5478, 1 - 1e-9, 1 + 1e-9, 1.825, 1.826])
def test_closed_forms_are_continuous_where_their_evaluation_changes(k: float) -> None:
    values = [np.array(stress.stresslet_numbers(k * (1 + s))) for s in (-1e-7, 0.0, 1e-7)]
    assert np.abs(values[0] - 2 * values[1] + values[2]).max() < 1e-12 * np.abs(values[1]).max()


def test_numbers_free_and_held(body: qs.Body) -> None:
    """S0, S1, S2 and the held S1 to 2e-12 for every shape, and what their estimates promise."""
    k, found = body.shape.aspect_ratio, body.stress
    error = np.abs(found.numbers / stress.stresslet_numbers(k) - 1.0).max()
    assert error < 2e-12
    assert found.error_estimate > error / 3.0
    held = [
        body.stresslet(qs.flow("polynomial", gradient=e.tolist()), angular_velocity=[0, 0, 0])
        for e in STRAINS
    ]
    numbers = stress.stresslet_numbers(k)[0], stress.held_number(k), stress.stresslet_numbers(k)[2]
    for e, s in zip(STRAINS, held, strict=True):
        exact = spheroid_stress.tensor(numbers, [0, 0, 1], e)
        assert np.abs(s - exact).max() < 2e-12 * np.abs(exact).max()


@pytest.mark.parametrize("kind", ["linear", "quadratic", "cubic", "stokeslet"])
def test_every_flow_by_the_mean_strain(body: qs.Body, kind: str) -> None:
    """Free, held, turning and driven, by table and by functional, against Faxen's law."""
    rng, k = np.random.default_rng(5), body.shape.aspect_ratio
    x, q = rng.standard_normal(3), rotation.normalize(rng.standard_normal(4))
    turn = rotation.matrix(q[None])[0]
    if kind == "stokeslet":
        place = x + max(1.0, k) * np.array([1.5, 2.0, 1.3])
        flow = qs.flow("stokeslet", strength=[1, 2, -1], position=place.tolist())
    else:
        flow = random_flow(rng, ["linear", "quadratic", "cubic"].index(kind) + 1)

    def exact(spin: object = None) -> np.ndarray:
        return spheroid_stress.stresslet(k, turn, x, flow.velocity, spin, order=60)

    spin, torque = rng.standard_normal(3), rng.standard_normal(3)
    _, driven = body.free_motion(flow, x, q, torque=torque)
    pairs = [
        (body.stresslet(flow, x, q), exact()),
        (body.stresslet(flow, x, q, velocity=[0, 0, 0]), exact([0, 0, 0])),
        (body.stresslet(flow, x, q, angular_velocity=spin), exact(spin)),
        (body.stresslet(flow, x, q, torque=torque), exact(driven)),
        (GridStress(body.stress, flow, 1e-12).stresslet(0.0, x[None], q[None])[0], exact()),
    ]
    for found, right in pairs:
        assert np.abs(found - right).max() < 1e-10 * np.abs(right).max()
        assert abs(np.trace(found)) < 1e-12 * np.abs(right).max()
        assert np.allclose(found, found.T, rtol=0, atol=1e-14 * np.abs(right).max())


def test_weights_interpolate_in_every_mode(body: qs.Body) -> None:
    """The trap of mode 2: from six nodes to 24 the functional stays the same, and smooth."""
    functional = body.stress.functional
    coarse, fine = functional.on_grid(8), functional.on_grid(24, 24)
    for strain in STRAINS:
        one = stresslet_of(coarse, coarse.points @ strain)
        other = stresslet_of(fine, fine.points @ strain)
        assert np.abs(one - other).max() < 1e-12 * np.abs(one).max()


def test_rigid_motion_has_no_stresslet(body: qs.Body) -> None:
    grid = body.stress.functional.on_grid(12, 12)
    size = np.abs(body.stress.numbers).max()
    for u in (np.tile([1.0, 2.0, 3.0], (len(grid.points), 1)), np.cross([3, 1, 2], grid.points)):
        assert np.abs(stresslet_of(grid, u)).max() < 1e-12 * size * np.abs(u).max()


def test_lanes_and_refusals() -> None:
    body, shear = qs.Body(0.4), qs.flow("shear")
    axes = np.random.default_rng(0).standard_normal((2, 3, 3))
    found = body.stresslet(shear, orientation=axes)
    assert found.shape == (2, 3, 3, 3)
    assert np.array_equal(found[1, 2], body.stresslet(shear, orientation=axes[1, 2]))
    near = qs.flow("stokeslet", strength=[1, 0, 0], position=[0, 0, 1.0001])
    with pytest.raises(qs.errors.QbxStokesError):
        body.stresslet(near)


@pytest.mark.parametrize("tolerance", [1e-6, pytest.param(1e-9, marks=pytest.mark.slow)])
def test_estimates_are_promises(tolerance: float) -> None:
    """Never below a third of the true error, on random shapes."""
    rng = np.random.default_rng(int(-math.log10(tolerance)))
    for k in np.exp(rng.uniform(math.log(1 / 50), math.log(50), 4)):
        found = accurate_stresslet(Spheroid(k), tolerance, choose_scheme(tolerance))
        error = np.abs(found.numbers / stress.stresslet_numbers(k) - 1.0).max()
        assert error < 3.0 * found.error_estimate
        assert found.error_estimate < tolerance
