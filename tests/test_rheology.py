"""Dilute suspensions: densities of orientations, material functions, orbits, the task."""

from __future__ import annotations

import math
import time
from pathlib import Path

import numpy as np
import pytest
import spheroid_stress
from conftest import See
from scipy import sparse
from scipy.sparse.linalg import expm_multiply, spsolve

import qbxstokes as qs
from qbxstokes.errors import CaseError, QbxStokesError
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.reference import stress
from qbxstokes.reference.jeffery import axis_at, period, rotation_resistance
from qbxstokes.simulation.rheology import linear_flow
from qbxstokes.suspension.distribution import Distribution
from qbxstokes.suspension.fokker_planck import Transport, isotropic
from qbxstokes.suspension.particle import LinearFlow, Particle

SHEAR = qs.flow("shear")


def particle(k: float) -> Particle:
    """A spheroid by closed forms."""
    linear = (1.0 - k * k) / (1.0 + k * k)
    numbers = np.array(stress.stresslet_numbers(k))
    return Particle(numbers, linear, rotation_resistance(k)[0], Spheroid(k).volume)


@pytest.fixture(scope="module")
def rod() -> qs.Body:
    """A rod of 5:1."""
    return qs.Body(0.2)


def random_gradient(seed: int) -> np.ndarray:
    g = np.random.default_rng(seed).standard_normal((3, 3))
    return g - np.trace(g) / 3.0 * np.eye(3)


@pytest.mark.parametrize(("ratio", "published"), [(2, 2.908), (5, 5.806), (10, 13.63), (25, 55.19)])
def test_small_peclet_numbers(ratio: int, published: float) -> None:
    """[eta] as tabulated by Scheraga 1955 (and Simha's equation of 1940), to its last digit."""
    rods = qs.Body(1.0 / ratio)
    found = qs.rheology(rods, SHEAR, 1e-5)
    assert float(f"{found.intrinsic_viscosity:.4g}") == published
    assert found.intrinsic_viscosity == pytest.approx(particle(1.0 / ratio).viscosity_at_rest, 1e-9)
    # Both fall to zero with the Peclet number, in a ratio that stays.
    assert abs(found.first_normal_stress_difference) < 1e-3
    assert found.second_normal_stress_difference < 0.0


def test_a_sphere_is_einsteins() -> None:
    found = qs.rheology(qs.Body(1.0), SHEAR, [0.1, 10.0, np.inf])
    np.testing.assert_allclose(found.intrinsic_viscosity, 2.5, rtol=1e-12)
    assert np.abs(found.first_normal_stress_difference).max() < 1e-12


@pytest.mark.parametrize("step", [1, 2])
def test_moments_evolve_as_they_must(step: int) -> None:
    """d<pp>/dt = <pdot p + p pdot> - 6 D (<pp> - I/3) for any density, no quadrature in between."""
    gradient = random_gradient(1)
    if step == 2:
        gradient = np.array([[1.0, 2.0, 0.0], [-0.5, 0.5, 0.0], [0.0, 0.0, -1.5]])
    flow, linear = linear_flow(qs.flow("polynomial", gradient=gradient.tolist()), [0, 0, 0]), 0.7
    transport = Transport(flow, linear)
    axes, used = transport.frame
    assert used == step
    basis, moved, laplacian = transport.operators(8)
    c = np.random.default_rng(2).standard_normal(basis.size)
    c[0] = 1.0 / np.sqrt(4.0 * np.pi)
    rate, _ = basis.moments(moved @ c + 0.3 * laplacian * c)
    two, four = basis.moments(c)
    strain = axes @ flow.strain @ axes.T
    spin = axes @ flow.spin
    turn = np.array([[0, -spin[2], spin[1]], [spin[2], 0, -spin[0]], [-spin[1], spin[0], 0]])
    pull = (turn + linear * strain) @ two - linear * np.einsum("ijkl,kl->ij", four, strain)
    expected = pull + pull.T - 1.8 * (two - np.eye(3) / 3.0)
    assert np.abs(rate - expected).max() < 1e-13 * np.abs(expected).max() * 10
    assert abs(np.trace(rate)) < 1e-12


@pytest.mark.parametrize("k", [1 / 25, 0.2, 5.0, 25.0])
@pytest.mark.parametrize("peclet", [1.0, 100.0, 1000.0])
def test_converged_in_less_than_a_second(see: See, k: float, peclet: float) -> None:
    """[eta], N1, N2 and <pp> to 1e-8 against a far finer truncation; the estimate holds."""
    body = qs.Body(k)
    body.formed(1, "surface")
    assert len(body.stress.numbers) == 3
    begin = time.process_time()
    found = qs.rheology(body, SHEAR, peclet)
    spent = time.process_time() - begin
    own = particle(k)
    density = Transport(LinearFlow(SHEAR.gradient([0, 0, 0]), 1.0, np.eye(3)), own.linear).steady(
        1.0 / peclet, 200
    )
    second, fourth = density.moments()
    strain = 0.5 * np.array([[0, 1, 0], [1, 0, 0], [0, 0, 0.0]])
    exact = own.hydrodynamic_stress(second, fourth, strain)
    exact += own.brownian_stress(second, 1.0 / peclet)
    error = np.abs(found.particle_stress - exact).max() / np.abs(exact).max()
    assert error < 1e-8
    assert error < 3.0 * found.error_estimate + 1e-13
    assert np.abs(found.order_tensor - second).max() < 1e-8
    n1, n2 = exact[0, 0] - exact[1, 1], exact[1, 1] - exact[2, 2]
    assert found.first_normal_stress_difference == pytest.approx(n1, abs=1e-8 * exact[0, 1])
    assert found.second_normal_stress_difference == pytest.approx(n2, abs=1e-8 * exact[0, 1])
    see(spent, 1.0, "s")


@pytest.mark.parametrize("seed", [0, 2])
def test_general_flows_within_five_times_that(see: See, seed: int) -> None:
    """Every order of the harmonics, and sharp peaks: <S> to 1e-8; the estimate holds."""
    body, gradient = qs.Body(1 / 25), random_gradient(seed)
    flow = qs.flow("polynomial", gradient=gradient.tolist())
    body.formed(1, "surface")
    assert len(body.stress.numbers) == 3
    begin = time.process_time()
    found = qs.rheology(body, flow, 1000.0)
    spent = time.process_time() - begin
    own, homogeneous = particle(1 / 25), linear_flow(flow, [0, 0, 0])
    density = Transport(homogeneous, own.linear).steady(1e-3, 230)
    second, fourth = density.moments()
    exact = own.hydrodynamic_stress(second, fourth, homogeneous.strain)
    exact += own.brownian_stress(second, 1e-3)
    error = np.abs(found.particle_stress - exact).max() / np.abs(exact).max()
    assert error < 1e-8
    assert error < 3.0 * found.error_estimate + 1e-13
    assert np.abs(found.order_tensor - second).max() < 1e-8
    see(spent, 5.0, "s")


def test_turned_flows_turn_the_stress(rod: qs.Body) -> None:
    """Neither a general flow nor a turned shear knows the axes of space."""
    q, _ = np.linalg.qr(np.random.default_rng(3).standard_normal((3, 3)))
    q *= np.sign(np.linalg.det(q))
    for g in (random_gradient(4), np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])):
        one = qs.rheology(rod, qs.flow("polynomial", gradient=g.tolist()), 30.0)
        other = qs.rheology(rod, qs.flow("polynomial", gradient=(q @ g @ q.T).tolist()), 30.0)
        turned = q @ one.particle_stress @ q.T
        assert np.abs(turned - other.particle_stress).max() < 1e-10 * np.abs(turned).max()
        assert other.intrinsic_viscosity == pytest.approx(one.intrinsic_viscosity, rel=1e-11)


def test_transients(rod: qs.Body) -> None:
    """Start-up begins isotropic and ends steady; cessation lets l = 2 decay by 6 D alone."""
    steady = qs.rheology(rod, SHEAR, 10.0)
    start = qs.rheology(rod, SHEAR, 10.0, protocol="startup", times=[0.0, 2.0, 40.0])
    assert start.intrinsic_viscosity[0] == pytest.approx(particle(0.2).viscosity_of_isotropic)
    assert np.abs(start.particle_stress[-1] - steady.particle_stress).max() < 1e-7
    assert start.intrinsic_viscosity[1] > start.intrinsic_viscosity[-1]  # the overshoot
    times = np.array([0.0, 1.0, 3.0])
    rest = qs.rheology(rod, SHEAR, 10.0, protocol="cessation", times=times)
    left = (steady.order_tensor - np.eye(3) / 3.0) * np.exp(-0.6 * times)[:, None, None]
    np.testing.assert_allclose(rest.order_tensor - np.eye(3) / 3.0, left, atol=1e-9)
    assert not rest.hydrodynamic_stress.any()


@pytest.mark.parametrize("k", [0.2, 5.0])
def test_histories_by_other_ways(k: float) -> None:
    """A start-up by matrix exponentials, a large oscillation by harmonic balance, to 1e-7."""
    rod, number, amplitude, most = qs.Body(k), 20.0, 2.0, 16
    transport = Transport(linear_flow(SHEAR, [0, 0, 0]), particle(k).linear)
    basis, moved, laplacian = transport.operators(32)
    spread, first = sparse.diags_array(laplacian / number), isotropic(basis)

    def stress_of(c: np.ndarray, rate: float) -> np.ndarray:
        second, fourth = Distribution(basis, transport.frame[0], c).moments()
        flowing = particle(k).hydrodynamic_stress(second, fourth, transport.flow.strain)
        return flowing * rate + particle(k).brownian_stress(second, 1.0 / number)

    times = np.array([0.0, 1.0, 3.0, 9.0])
    found = qs.rheology(rod, SHEAR, number, protocol="startup", times=times)
    for t, one in zip(times, found.particle_stress, strict=True):
        assert np.abs(one - stress_of(expm_multiply((moved + spread) * t, first), 1.0)).max() < 1e-7

    found = qs.rheology(rod, SHEAR, number, protocol="oscillation", amplitude=amplitude)
    w, order = found.summary["frequency"], np.arange(-most, most + 1)
    beside = sparse.diags([0.5 * np.ones(2 * most)] * 2, [-1, 1])
    balance = sparse.kron(sparse.diags(1j * w * order), sparse.eye(basis.size))
    balance = balance - sparse.kron(sparse.eye(2 * most + 1), spread) - sparse.kron(beside, moved)
    inner = np.arange(balance.shape[0]) % basis.size > 0  # the integral is kept
    given = np.zeros(balance.shape[0], dtype=complex)
    given[most * basis.size] = first[0]
    source = -(balance.tocsr() @ given)
    given[inner] = spsolve(balance.tocsc()[inner][:, inner], source[inner])
    waves = given.reshape(2 * most + 1, -1)
    for index in range(0, len(found.time), len(found.time) // 5):
        t = found.time[index]
        exact = stress_of((np.exp(1j * w * order * t) @ waves).real, math.cos(w * t))
        assert np.abs(found.particle_stress[index] - exact).max() < 1e-7


def test_small_oscillations_have_one_relaxation_time(rod: qs.Body) -> None:
    """[eta'] - i [eta''] = [eta]_iso + ([eta]_0 - [eta]_iso)/(1 + i w/(6 D)), to O(amplitude^2)."""
    found = qs.rheology(rod, SHEAR, 0.02, protocol="oscillation", amplitude=1e-3)
    w, own = found.summary["frequency"], particle(0.2)
    phase = np.exp(-1j * w * found.time[:-1])
    complex_viscosity = 2.0 * np.mean(found.intrinsic_viscosity[:-1] * phase)
    rise = own.viscosity_at_rest - own.viscosity_of_isotropic
    exact = own.viscosity_of_isotropic + rise / (1.0 + 1j * w * 0.02 / 6.0)
    assert abs(complex_viscosity - exact) < 1e-6 * abs(exact)


@pytest.mark.parametrize("k", [0.2, 5.0])
def test_extension_has_boltzmanns_density(k: float) -> None:
    """psi ~ exp(lambda Pe p.E.p/2), E over sqrt(2 E:E) = sqrt(3), p.E.p = (3 z^2 - 1)/2."""
    flow = qs.flow("polynomial", gradient=np.diag([-0.5, -0.5, 1.0]).tolist())
    found = qs.rheology(qs.Body(k), flow, 20.0)
    z, weights = np.polynomial.legendre.leggauss(400)
    linear = (1.0 - k * k) / (1.0 + k * k)
    density = weights * np.exp(0.75 * linear * 20.0 / math.sqrt(3.0) * (z * z - 1.0))
    exact = np.sum(density * z * z) / np.sum(density)
    assert found.order_tensor[2, 2] == pytest.approx(exact, rel=1e-9)


def test_oscillations_repeat(rod: qs.Body) -> None:
    found = qs.rheology(rod, SHEAR, 30.0, protocol="oscillation", amplitude=2.0)
    assert np.abs(found.particle_stress[0] - found.particle_stress[-1]).max() < 1e-7
    # Half a period later the flow is its own mirror image: the shear stress changes sign.
    half = len(found.time) // 2
    assert found.intrinsic_viscosity[half] == pytest.approx(-found.intrinsic_viscosity[0], abs=1e-7)


@pytest.mark.parametrize("k", [0.2, 5.0])
def test_orbits_without_brownian_motion(k: float) -> None:
    """Means over an orbit to 1e-9 against Jeffery's solution; N1 and N2 vanish there."""
    body, start = qs.Body(k), np.array([0.6, 0.3, 0.5])
    found = qs.rheology(body, SHEAR, np.inf, orientations=start)
    times = period(k) * np.arange(2000) / 2000
    p = axis_at(times, k, start / np.linalg.norm(start))
    assert np.abs(np.einsum("ti,tj->ij", p, p) / 2000 - found.order_tensor).max() < 1e-12
    strain = 0.5 * np.array([[0, 1, 0], [1, 0, 0], [0, 0, 0.0]])
    exact = np.mean(
        [spheroid_stress.tensor(stress.stresslet_numbers(k), a, strain) for a in p], axis=0
    )
    exact /= Spheroid(k).volume
    assert np.abs(exact - found.particle_stress).max() < 1e-9
    assert abs(found.first_normal_stress_difference) < 1e-9
    assert abs(found.second_normal_stress_difference) < 1e-9


def test_isotropic_at_first(rod: qs.Body) -> None:
    """Transients from isotropic orientations against their sum over many; the limit of large Pe."""
    x, w = np.polynomial.legendre.leggauss(120)
    phi = 2.0 * np.pi * np.arange(240) / 240
    sine = np.sqrt(1.0 - x * x)[:, None]
    axes = np.stack([sine * np.cos(phi), sine * np.sin(phi), x[:, None] + 0 * phi], -1)
    times = [0.0, 1.0, 2.5]
    one = qs.rheology(rod, SHEAR, np.inf, protocol="startup", times=times)
    other = qs.rheology(
        rod,
        SHEAR,
        np.inf,
        protocol="startup",
        times=times,
        orientations=axes.reshape(-1, 3),
        weights=np.repeat(w, 240),
    )
    assert np.abs(one.particle_stress - other.particle_stress).max() < 1e-9
    long = qs.rheology(rod, SHEAR, np.inf)
    cell = w[:, None] * 2.0 * np.pi / 240
    density = long.distribution.density(axes)
    assert np.sum(cell * density) == pytest.approx(1.0, abs=1e-9)
    mean = np.einsum("ab,abi,abj->ij", cell * density, axes, axes)
    assert np.abs(mean - long.order_tensor).max() < 1e-9


def test_densities(rod: qs.Body) -> None:
    """Values, tables and samples of a density agree with its moments."""
    found = qs.rheology(rod, SHEAR, 30.0)
    density = found.distribution
    table = density.table(181, 360)
    theta, phi = np.meshgrid(table["theta"], table["phi"], indexing="ij")
    p = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1)
    assert np.abs(density.density(p[7, 11]) - table["density"][7, 11]) < 1e-14
    assert np.abs(density.density(-p) - table["density"]).max() < 1e-10
    assert table["density"].min() > 0.0
    axes = density.sample(20_000, seed=1)
    assert np.array_equal(axes, density.sample(20_000, seed=1))
    mean = axes.T @ axes / len(axes)
    assert np.abs(mean - found.order_tensor).max() < 4.0 * 0.5 / np.sqrt(len(axes))


CASE = {
    "task": "rheology",
    "body": {"aspect_ratio": 0.2},
    "flow": {"type": "shear"},
    "rheology": {"peclet_number": [1, "inf"], "distribution": [7, 12]},
}


def test_the_task_says_what_python_says(rod: qs.Body, tmp_path: Path) -> None:
    result = qs.run(CASE)
    found = qs.rheology(rod, SHEAR, [1.0, np.inf])
    np.testing.assert_allclose(result.intrinsic_viscosity, found.intrinsic_viscosity, rtol=1e-12)
    np.testing.assert_allclose(result.order_tensor, found.order_tensor, atol=1e-12)
    assert result.distribution.shape == (2, 7, 12)
    assert result.summary["errors"]["stresslet"] < 1e-10
    many = {"peclet_number": {"logspace": [1, 100], "count": 3}, "distribution": [5, 8]}
    spaced = qs.run({**CASE, "rheology": many})
    np.testing.assert_allclose(spaced.peclet_number, [1.0, 10.0, 100.0])


def test_tables_for_others(tmp_path: Path) -> None:
    section = {"peclet_number": [2.0], "distribution": [5, 8], "tables": True, "samples": 40}
    result = qs.run({**CASE, "rheology": section}, file=tmp_path / "tables.h5")
    (drawn,) = tmp_path.glob("*-axes.csv")
    np.testing.assert_array_equal(np.loadtxt(drawn, delimiter=",", skiprows=1), result.samples[0])
    assert result.samples.shape == (1, 40, 3)
    name = drawn.with_name(drawn.name.replace("-axes", ""))
    rows = np.loadtxt(name, delimiter=",", skiprows=1)
    np.testing.assert_array_equal(rows[:, 2].reshape(5, 8), result.distribution[0])
    assert name.read_text().startswith("theta,phi,density\n")
    # The axes are starts of a transient and of a sweep; the density is none.
    start = {"protocol": "startup", "times": [0, 1], "peclet_number": ["inf"]}
    follow = {**CASE, "rheology": {**start, "orientations": {"table": str(drawn)}}}
    p = result.samples[0]
    second = qs.run(follow).order_tensor[0, 0]
    np.testing.assert_allclose(second, p.T @ p / len(p), atol=1e-12)
    motion = {"body": {"aspect_ratio": 0.2}, "flow": {"type": "shear"}, "time": {"at": [0, 1]}}
    starts = [{"start.orientation": {"table": str(drawn)}}]
    swept = qs.run({**motion, "sweep": {"axes": starts}})
    np.testing.assert_allclose(swept.axis[:, 0], result.samples[0], atol=1e-14)
    starts[0]["start.orientation"]["table"] = str(name)
    with pytest.raises(CaseError, match=r"holds theta, phi, density; axes: x1, x2, x3"):
        qs.run({**motion, "sweep": {"axes": starts}})


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"protocol": "oscillation"}, "amplitude"),
        ({"protocol": "oscillation", "amplitude": 1, "frequency": 1}, "amplitude and frequency"),
        ({"amplitude": 1}, "no meaning for protocol: steady"),
        ({"peclet_number": 0}, "must be"),
        ({"times": [0, 1]}, "no meaning for protocol: steady"),
        ({"peclet_number": 1, "orientations": {"aligned": [1, 0, 0]}}, "forgotten"),
        ({"peclet_number": "inf", "orientations": {"table": "none.csv"}}, "cannot be read"),
    ],
)
def test_bad_input_of_the_task(change: dict[str, object], says: str) -> None:
    with pytest.raises(QbxStokesError, match=says):
        qs.run({**CASE, "rheology": change})


def test_bad_scenes(rod: qs.Body) -> None:
    turning = qs.flow("linear", gradient=[[0, "cos(t)", 0], [0, 0, 0], [0, 0, 0]])
    for flow, says in (
        (qs.flow("paraboloid"), "homogeneous"),
        (qs.flow("rotation"), "strain"),
        (turning, "changes in time"),
    ):
        with pytest.raises(QbxStokesError, match=says):
            qs.rheology(rod, flow)
    heavy = qs.Body(0.2, stokes_number=1.0)
    with pytest.raises(QbxStokesError, match="stokes_number"):
        qs.rheology(heavy, SHEAR)
    with pytest.raises(QbxStokesError, match="isotropic"):
        qs.rheology(heavy, SHEAR, np.inf)


def test_estimates_of_attractors_are_promises() -> None:
    """A body that drifts to its attractor says how far it may be; one that leaves is refused."""
    body = qs.Body(0.5, stokes_number=10.0)
    right = qs.rheology(body, SHEAR, np.inf, orientations=[1.0, 0.2, 0.0], settling=100.0)
    for settling in (100.0, 200.0):
        found = qs.rheology(
            body, SHEAR, np.inf, orientations=[1.0, 0.2, 0.3], settling=settling, tolerance=1e-4
        )
        error = np.abs(found.particle_stress - right.particle_stress).max()
        assert error < 3.0 * found.error_estimate * np.abs(right.particle_stress).max()
        assert found.error_estimate < 0.1
    with pytest.raises(QbxStokesError, match="raise settling"):
        qs.rheology(body, SHEAR, np.inf, orientations=[0.1, 0.05, 1.0], settling=60.0)
    oblate = qs.Body(2.0, stokes_number=3.0)
    rolling = qs.rheology(oblate, SHEAR, np.inf, orientations=[1.0, 0.2, 1.0], settling=1000.0)
    assert np.abs(rolling.order_tensor - np.diag([0.0, 0.0, 1.0])).max() < 1e-9


def test_attractors_of_inertial_bodies() -> None:
    """Tumbling in the plane and rolling: N1 != 0 by inertia, whose own terms cancel to 1e-9."""
    body = qs.Body(0.5, stokes_number=10.0)
    tumbling = qs.rheology(body, SHEAR, np.inf, orientations=[1.0, 0.2, 0.0], settling=200.0)
    own = tumbling.inertial_stress
    assert max(abs(own[0, 1]), abs(own[1, 1] - own[2, 2]), abs(own[0, 0] - own[1, 1])) < 1e-9
    assert tumbling.error_estimate < 1e-7
    assert abs(tumbling.first_normal_stress_difference) > 1e-2
    massless = qs.rheology(qs.Body(0.5), SHEAR, np.inf, orientations=[1.0, 0.2, 0.0])
    assert tumbling.intrinsic_viscosity > massless.intrinsic_viscosity
    light = qs.Body(0.5, stokes_number=0.05)
    slow = qs.rheology(light, SHEAR, np.inf, orientations=[1.0, 0.2, 0.0], settling=40.0)
    assert slow.intrinsic_viscosity == pytest.approx(massless.intrinsic_viscosity, rel=1e-6)
    rolling = qs.rheology(body, SHEAR, np.inf, orientations=[0.0, 0.0, 1.0], settling=200.0)
    exact = spheroid_stress.tensor(
        stress.stresslet_numbers(0.5), [0, 0, 1], np.eye(3)[[1, 0, 2]] * 0.5
    )
    assert rolling.intrinsic_viscosity == pytest.approx(exact[0, 1] / body.shape.volume, rel=1e-9)
