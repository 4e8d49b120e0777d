"""Rotary Brownian motion of single axes: counted random numbers, weak order, averages."""

from __future__ import annotations

import numpy as np
import pytest

import qbxstokes as qs
from qbxstokes.errors import QbxStokesError
from qbxstokes.simulation.rheology import linear_flow
from qbxstokes.suspension.fokker_planck import Transport
from qbxstokes.suspension.langevin import isotropic_axes, turned, uniform, variance

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
        moved = turned(p, variance(1.0, h), uniform(0, 0, len(p), 0))
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


def test_bad_arguments() -> None:
    body = qs.Body(0.2)
    for bad in ({"peclet_number": np.inf}, {"trajectories": 1}, {"step": 100.0}, {"strain": 0.0}):
        with pytest.raises(QbxStokesError):
            qs.langevin(body, SHEAR, **bad)
