"""Rotary Brownian motion of single axes: counted random numbers, weak order, averages."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import qbxstokes as qs
from qbxstokes.errors import QbxStokesError
from qbxstokes.motion import random_turns
from qbxstokes.motion.random_turns import turned_axes, variance
from qbxstokes.simulation.rheology import linear_flow
from qbxstokes.suspension.fokker_planck import Transport
from qbxstokes.suspension.langevin import isotropic_axes, uniform

SHEAR = qs.flow("shear")


def test_numbers_belong_to_trajectory_and_step() -> None:
    """Any division of the trajectories gives the same bits; other keys give other numbers."""
    whole = uniform(3, 0, 1000, 7)
    assert np.array_equal(whole[400:700], uniform(3, 400, 300, 7))
    assert 0.0 < whole.min() < whole.max() <= 1.0
    assert not np.any(whole == uniform(3, 0, 1000, 8))
    assert not np.any(whole == uniform(4, 0, 1000, 7))
    axes = isotropic_axes(1, 0, 20_000)
    assert np.abs(axes.T @ axes / 20_000 - np.eye(3) / 3.0).max() < 0.01


def test_turns_decay_as_diffusion_says() -> None:
    """<p.p0> = exp(-2 D h) and <P2> = exp(-6 D h) up to the third power of D h, in every place."""
    p = isotropic_axes(0, 0, 400_000)
    for h in (0.02, 0.1):
        moved = turned_axes(p, variance(1.0, h), uniform(0, 0, len(p), 0))
        assert np.abs(np.linalg.norm(moved, axis=1) - 1.0).max() < 1e-14
        cosine = np.sum(moved * p, axis=1)
        for mean, rate in ((cosine, 2.0), (1.5 * cosine**2 - 0.5, 6.0)):
            error = mean.std() / np.sqrt(len(p))
            assert abs(mean.mean() - np.exp(-rate * h)) < 4.0 * error + (rate * h) ** 3


def test_weak_order_two() -> None:
    """The scheme's own steady state, by the operators of a step: its error falls as h^2."""
    from scipy.linalg import expm

    transport, diffusivity = Transport(linear_flow(SHEAR, [0, 0, 0]), 12 / 13), 0.2
    basis, moved, _ = transport.operators(20)
    exact = basis.moments(transport.steady(diffusivity, 20).coefficients)[0]
    nodes, weights = np.polynomial.laguerre.laggauss(60)
    errors = []
    for h in (0.4, 0.2, 0.1):
        cosine = np.cos(np.sqrt(2.0 * variance(diffusivity, h) * nodes))
        legendre = np.polynomial.legendre.legvander(cosine, 20)
        half = expm(0.5 * h * moved.toarray())
        step = half @ ((weights @ legendre)[basis.degrees][:, None] * half)
        c = np.zeros(basis.size)
        c[0] = 1.0 / np.sqrt(4.0 * np.pi)
        c[1:] = np.linalg.solve((np.eye(basis.size) - step)[1:, 1:], step[1:, 0] * c[0])
        errors.append(np.abs(basis.moments(c)[0] - exact).max())
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(np.abs(orders - 2.0) < 0.05)
    assert errors[-1] < 2e-4


def test_counted_numbers_are_those_published() -> None:
    """Philox 4x32-10 of zeros (J. K. Salmon et al. 2011, Random123's kat_vectors)."""
    found = [int(number) for number in random_turns.philox(0, 0, 0, 0)]
    assert found == [0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8]
    places = np.arange(5, dtype=np.uint64)
    rows = np.stack(random_turns.philox(7, places, 2, 1))
    assert np.array_equal(rows[:, 3], np.stack(random_turns.philox(7, 3, 2, 1)))


def test_ensembles_turn_and_stress_as_the_density_says() -> None:
    """Brownian axes along paths that are all the same shear: within errors of `rheology`."""
    times = np.linspace(0.0, 21.0, 211)
    gradients = np.zeros((1024, len(times), 3, 3), dtype=np.float32)
    gradients[..., 0, 1] = 1.0
    series, bodies = qs.GradientSeries(times, gradients), [qs.Body(0.2), qs.Body(3.0)]
    keys = {"stresses": True, "discard": 0.2, "sampling": False}
    random = {"rotary_diffusivity": 0.1, "seed": 3}
    found = qs.ensemble(bodies, series, statistics=keys, brownian=random)
    half = qs.ensemble(
        bodies,
        series.part(slice(512), slice(None)),
        statistics={**keys, "keep": 9},
        brownian=random,
    )
    assert found.stresses is not None
    assert half.stresses is not None
    for place, body in enumerate(bodies):
        exact = qs.rheology(body, SHEAR, 10.0)
        for name, (mean, error) in found.stresses.items():
            right = getattr(exact, name)
            assert np.all(np.abs(mean[place] - right) < 4.0 * error[place] + 1e-12)
            assert np.max(error[place]) < 0.03 * np.max(np.abs(right))
            assert np.all(half.stresses[name][1][place] >= error[place])
    still = qs.ensemble(
        bodies[0], series.part(slice(9), slice(None)), statistics={**keys, "keep": 9}
    )
    assert still.axes is not None
    assert half.axes is not None
    assert np.abs(half.axes[:, :, :1] - still.axes).max() > 0.1
    for bad in ({"rotary_diffusivity": 6.0}, {"translation": True}, {}):
        with pytest.raises(QbxStokesError, match=r"^brownian"):
            qs.ensemble(bodies, series, brownian={"rotary_diffusivity": 0.1} | bad if bad else bad)


def test_motions_turn_at_random_as_the_density_says() -> None:
    """Lanes of a simulation in shear: stress and its Brownian part within errors of `rheology`."""
    body, axes = qs.Body(0.2), isotropic_axes(0, 0, 200)
    keys = {"brownian": {"rotary_diffusivity": 0.1, "seed": 2, "step": 0.1}, "tolerance": 1e-8}
    scene = qs.Simulation(body, SHEAR, orientation=axes, **keys)
    motion, exact = scene.integrate(np.linspace(0.0, 40.0, 81)), qs.rheology(body, SHEAR, 10.0)
    for name in ("particle_stress", "brownian_stress"):
        found, right = motion.mean(name, discard=0.25), getattr(exact, name)
        assert np.all(np.abs(found.mean - right) < 4.0 * found.standard_error)
        assert found.standard_error[0, 1] < 0.06 * right[0, 1]
    few = scene.at(np.array([3, 150])).integrate([0.0, 2.0, 4.0])
    again = scene.integrate([0.0, 2.0, 4.0]).axis[[3, 150]]
    assert np.abs(few.axis - again).max() < 1e-6


def test_a_single_body_turns_at_random() -> None:
    keys = {"rotary_diffusivity": 0.1, "seed": 3}
    body, times = qs.Body(0.2), np.linspace(0.0, 2.0, 5)
    alone = body.integrate(SHEAR, times, orientation=[1, 0, 0], brownian=keys)
    scene = qs.Simulation(body, SHEAR, orientation=[[1, 0, 0], [0, 0, 1]], brownian=keys)
    assert alone.axis.shape == (5, 3)
    assert np.array_equal(alone.axis, scene.integrate(times).axis[0])
    assert np.abs(alone.axis - body.integrate(SHEAR, times, orientation=[1, 0, 0]).axis).max() > 0.1


def test_motions_disperse_with_shear() -> None:
    """A sphere's places in shear: 2 D t (1 + t^2/3) along, D t^2 mixed, 2 D t across."""
    keys = {"rotary_diffusivity": 0.5, "translation": True}
    axes, t = np.tile([0.0, 0.0, 1.0], (3000, 1)), 3.0
    scene = qs.Simulation(qs.Body(1.0), SHEAR, orientation=axes, brownian=keys, tolerance=1e-8)
    found = np.cov(scene.integrate([t]).position[:, 0].T) / (0.5 * 8.0 / 6.0)
    exact = np.diag([2.0 * t * (1.0 + t * t / 3.0), 2.0 * t, 2.0 * t])
    exact[0, 1] = exact[1, 0] = t * t
    sizes = np.sqrt(np.diag(exact))
    assert np.all(np.abs(found - exact) < 4.0 * np.sqrt(2.0 / 3000) * np.outer(sizes, sizes))


def test_what_no_random_motion_can_have() -> None:
    random = {"rotary_diffusivity": 0.1}
    walls = qs.flow("plane_poiseuille", half_width=5.0)
    for keys in (
        {"bodies": qs.Body(0.5, stokes_number=1.0)},
        {"flow": walls},
        {"constraints": qs.Constraints(angular_velocity=[0, 0, 0])},
        {"brownian": {**random, "step": 6.0}},
        {"brownian": {"seed": 1}},
    ):
        given = {"bodies": qs.Body(0.5), "flow": SHEAR, "brownian": random} | keys
        with pytest.raises(QbxStokesError):
            qs.Simulation(**given)
    with pytest.raises(QbxStokesError, match="no meaning for a single motion"):
        qs.run({"flow": {"type": "shear"}, "time": {"end": 1}, "brownian": random})


def test_isotropic_axes_stress_a_fluid_as_they_must() -> None:
    """<S:E>/(2 <E:E> V) = (S0 + 2 S1 + 2 S2)/(10 V) where axes do not know the gradients."""
    gradients = np.random.default_rng(1).standard_normal((4000, 6, 3, 3))
    gradients -= np.trace(gradients, axis1=2, axis2=3)[..., None, None] * np.eye(3) / 3.0
    series = qs.GradientSeries(1e-6 * np.arange(6.0), gradients)
    found = qs.ensemble(qs.Body(0.1), series, statistics={"stresses": True, "sampling": False})
    assert found.stresses is not None
    mean, error = found.stresses["intrinsic_viscosity"]
    exact = qs.rheology(qs.Body(0.1), SHEAR, 1.0).summary["viscosity_of_isotropic"]
    assert abs(mean[0] - exact) < 3.0 * error[0]
    assert error[0] < 0.02 * exact


@pytest.mark.parametrize("peclet", [3.0, pytest.param(100.0, marks=pytest.mark.slow)])
def test_averages_are_those_of_the_density(peclet: float) -> None:
    """Within three standard errors, which are small against the numbers themselves."""
    body = qs.Body(0.2)
    found = qs.langevin(body, SHEAR, peclet, trajectories=1500, strain=40.0, seed=5)
    exact = qs.rheology(body, SHEAR, peclet)
    names = ("intrinsic_viscosity", "first_normal_stress_difference")
    for name in (*names, "second_normal_stress_difference"):
        mean, error = getattr(found, name)
        assert abs(mean - getattr(exact, name)) < 3.0 * error
    assert found.intrinsic_viscosity[1] < 0.01 * found.intrinsic_viscosity[0]
    mean, error = found.order_tensor
    assert np.all(np.abs(mean - exact.order_tensor) < 3.5 * error)


@pytest.mark.parametrize(
    ("protocol", "keys"),
    [("startup", {}), ("cessation", {}), ("oscillation", {"amplitude": 2.0})],
)
def test_histories_are_those_of_the_density(protocol: str, keys: dict[str, float]) -> None:
    """Means at instants with their errors; the parts of the stress apart from each other."""
    body, times = qs.Body(0.2), np.array([0.0, 0.5, 1.7, 3.0])
    more = {"protocol": protocol, "times": times, **keys}
    found = qs.langevin(body, SHEAR, [5.0], trajectories=3000, seed=2, **more)
    exact = qs.rheology(body, SHEAR, [5.0], **more)
    for name in ("intrinsic_viscosity", "hydrodynamic_stress", "brownian_stress", "order_tensor"):
        mean, error = getattr(found, name)
        right = getattr(exact, name)
        assert mean.shape == right.shape
        assert np.all(np.abs(mean - right) <= 4.0 * error + 1e-12)
        assert error.max() < 0.1 * np.abs(right).max() + 1e-12
    whole = found.hydrodynamic_stress[0] + found.brownian_stress[0]
    np.testing.assert_allclose(found.particle_stress[0], whole, atol=1e-12)


def test_blocks_make_the_whole() -> None:
    """Sums over any division of the trajectories, and the same ones kept."""
    body = qs.Body(0.5)
    times = [0.0, 1.0]
    found = qs.langevin(
        body, SHEAR, 3.0, protocol="startup", times=times, trajectories=2100, paths=2100
    )
    axes = found.paths
    assert axes.shape == (2, 2100, 3)
    order = axes[..., 0] * axes[..., 1]
    np.testing.assert_allclose(order.mean(axis=1), found.order_tensor[0][:, 0, 1], atol=1e-14)
    error = order.std(axis=1, ddof=1) / np.sqrt(2100)
    np.testing.assert_allclose(found.order_tensor[1][:, 0, 1], error, rtol=1e-12)
    few = qs.langevin(
        body, SHEAR, 3.0, protocol="startup", times=times, trajectories=300, paths=300
    )
    assert np.array_equal(few.paths, axes[:, :300])


def test_an_ensemble_starts_from_a_sample_of_a_density() -> None:
    """The steady density is one that stays."""
    body = qs.Body(0.2)
    steady = qs.rheology(body, SHEAR, 10.0)
    axes = steady.distribution.sample(3000, seed=4)
    found = qs.langevin(
        body, SHEAR, 10.0, protocol="startup", times=[3.0], orientations=axes, trajectories=3000
    )
    mean, error = found.order_tensor
    assert np.all(np.abs(mean[0] - steady.order_tensor) < 4.0 * error[0])


def test_places_disperse_with_shear() -> None:
    """A sphere's <dx dx> in shear: 2 D t (1 + t^2/3) along, D t^2 mixed, 2 D t across."""
    times, diffusivity = np.array([1.0, 3.0]), 0.5 * 8.0 / 6.0
    keys = {"protocol": "startup", "times": times, "trajectories": 6000, "translation": True}
    mean, error = qs.langevin(qs.Body(1.0), SHEAR, 2.0, **keys).mean_square_displacement
    exact = {
        (0, 0): 2.0 * times * (1.0 + times**2 / 3.0),
        (1, 1): 2.0 * times,
        (0, 1): times**2,
        (0, 2): 0.0 * times,
    }
    for place, value in exact.items():
        at = (slice(None), *place)
        assert np.all(np.abs(mean[at] - diffusivity * value) < 4.0 * error[at])
        assert error[at].max() < 0.1 * mean[:, 0, 0].max()


def test_bad_arguments() -> None:
    body = qs.Body(0.2)
    transient = {"protocol": "startup", "trajectories": 10, "times": [1.0]}
    for bad in (
        {"peclet_number": np.inf},
        {"trajectories": 1},
        {"step": 100.0},
        {"strain": 0.0},
        {"paths": 2},
        {"translation": True},
        {"orientations": [1.0, 0.0, 0.0]},
        {"peclet_number": 1e9, "strain": 1e9},
        {**transient, "paths": 11},
        {**transient, "orientations": "aligned"},
    ):
        with pytest.raises(QbxStokesError):
            qs.langevin(body, SHEAR, **bad)
    with pytest.raises(QbxStokesError, match="stokes_number"):
        qs.langevin(qs.Body(0.2, stokes_number=1.0), SHEAR)


CASE = {
    "task": "rheology",
    "body": {"aspect_ratio": 0.2},
    "flow": {"type": "shear"},
    "rheology": {
        "peclet_number": [2.0, 5.0],
        "langevin": {"trajectories": 1500, "strain": 2.0, "step": 0.1, "seed": 3},
    },
}


def test_the_task_says_what_python_says() -> None:
    result = qs.run(CASE)
    keys = {"trajectories": 1500, "strain": 2.0, "step": 0.1, "seed": 3}
    found = qs.langevin(qs.Body(0.2), SHEAR, [2.0, 5.0], **keys)
    for name, value in found.arrays().items():
        np.testing.assert_allclose(result[name], value, rtol=1e-9, atol=1e-12)
    assert result.summary["suspension"]["method"] == "langevin"


@pytest.mark.slow
def test_ranks_give_the_same_bits(mpirun: Callable[..., Any], tmp_path: Path) -> None:
    (tmp_path / "case.yaml").write_text(json.dumps(CASE))
    alone = qs.run(CASE)
    done = mpirun(3, "case.yaml")
    assert done.returncode == 0, done.stderr
    several = qs.load(tmp_path / "case.h5")
    for name, value in several.arrays.items():
        assert np.array_equal(alone[name], value), name


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"peclet_number": "inf"}, "nothing is random"),
        ({"langevin": {"paths": 5}}, "no meaning for langevin and protocol: steady"),
        ({"langevin": {"translation": True}}, "no meaning for langevin"),
        ({"orientations": {"aligned": [1, 0, 0]}}, "no meaning for langevin"),
        ({"samples": 5}, "no meaning for langevin"),
        ({"langevin": {"step": 50}}, r"langevin\.step: is 50"),
        ({"langevin": {"trajectories": 1}}, "trajectories"),
    ],
)
def test_bad_input_of_the_task(change: dict[str, object], says: str) -> None:
    with pytest.raises(QbxStokesError, match=says):
        qs.run({**CASE, "rheology": {**CASE["rheology"], **change}})
