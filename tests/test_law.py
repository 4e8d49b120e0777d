"""The law as tensors: reciprocity, another point, and against the motion and the other route."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import qbxstokes as qs
from qbxstokes.bie.law import STRAIN_BASIS, shift
from qbxstokes.bie.scatterer import scatterer
from qbxstokes.errors import SceneError

SHAPES = [1 / 50, 0.5, 1.0, 50.0]
POINT = np.array([0.3, -0.2, 0.7])


@cache
def body(k):
    return qs.Body(k, tolerance=1e-8)


def flow(velocity, spin, strain, about):
    """The linear flow of values about a point, as a flow of space."""
    gradient = strain + np.cross(np.eye(3), spin)
    terms = [
        {"type": "polynomial", "gradient": gradient.tolist(), "position": list(about)},
        {"type": "uniform", "velocity": list(velocity)},
    ]
    return qs.flow("sum", terms=terms)


@pytest.mark.parametrize("k", SHAPES)
def test_reciprocity_by_the_other_route(k):
    """R (11, 11) by exterior harmonics, which know of no symmetry of it, is symmetric and ours."""
    one = scatterer(body(k).shape, 12)
    columns = []
    for data in [*one.rigid, *(one.grid.points @ strain for strain in STRAIN_BASIS)]:
        sent = one.packed(data, one.inverse)
        stresslet = np.einsum("aij,ij->a", STRAIN_BASIS, one.harmonics.first_moment(sent))
        columns.append(np.concatenate([one.harmonics.force_torque(sent), stresslet]))
    other, law = np.stack(columns, axis=1), body(k).law().grand_resistance
    size = np.sqrt(np.outer(np.diag(law), np.diag(law)))
    assert np.abs((other - other.T) / size).max() < 1e-13
    assert np.abs((other - law) / size).max() < 1e-10


@pytest.mark.parametrize("k", SHAPES)
def test_about_another_point(k):
    """Symmetric, positive definite; the leading block is the resistance, whose inverse is M."""
    law = body(k).law(POINT)
    grand = law.grand_resistance
    assert np.allclose(grand, grand.T, rtol=0.0, atol=1e-13 * np.abs(grand).max())
    assert np.linalg.eigvalsh(grand).min() > 0.0
    assert np.allclose(grand[:6, :6], law.resistance, rtol=1e-14)
    assert np.abs(law.mobility @ law.resistance - np.eye(6)).max() < 1e-11
    assert np.allclose(shift(POINT) @ shift(-POINT), np.eye(11), atol=1e-15)
    central = body(k).law()
    assert np.array_equal(central.resistance, body(k).resistance)
    assert np.array_equal(central.mobility, body(k).mobility)


@pytest.mark.parametrize("k", [0.2, 4.0])
def test_translation_theorem_against_the_motion(k):
    """Loads in a linear flow and the motion of the body that is pushed, both about a point."""
    rng = np.random.default_rng(3)
    law, one = body(k).law(POINT), body(k)
    u, w, v, omega, force, torque = rng.standard_normal((6, 3))
    strain = np.tensordot(rng.standard_normal(5), STRAIN_BASIS, axes=1)
    around = flow(u, w, strain, POINT)
    centre = v - np.cross(omega, POINT)
    motion = {"velocity": centre, "angular_velocity": omega}
    f, t = one.force_torque(around, **motion)
    stress = one.stresslet(around, **motion)
    stress = stress - 0.5 * (np.outer(POINT, f) + np.outer(f, POINT)) + POINT @ f / 3.0 * np.eye(3)
    found = law.grand_resistance @ np.concatenate(
        [u - v, w - omega, np.einsum("aij,ij->a", STRAIN_BASIS, strain)]
    )
    exact = np.concatenate(
        [f, t - np.cross(POINT, f), np.einsum("aij,ij->a", STRAIN_BASIS, stress)]
    )
    assert np.abs(found - exact).max() < 1e-8 * np.abs(exact).max()
    # The push: torque about the centre of a force at the point.
    still = qs.flow("uniform", velocity=[0, 0, 0])
    v, omega = one.free_motion(still, force=force, torque=torque + np.cross(POINT, force))
    found = law.mobility @ np.concatenate([force, torque])
    exact = np.concatenate([v + np.cross(omega, POINT), omega])
    assert np.abs(found - exact).max() < 1e-9 * np.abs(exact).max()


@pytest.mark.parametrize("k", [0.2, 1.0, 4.0])
def test_functionals_of_a_flow_that_is_no_polynomial(k):
    """U of the point, Omega and S of the free body beside a stresslet."""
    near = [0.4, 2.5 + k, 0.9]
    source = qs.flow("stresslet", position=near, strength=[[1, 0, 2], [0, -3, 1], [2, 1, 2]])
    u, omega, s = body(k).law(POINT).free(source.velocity, 1e-9)
    v, spin = body(k).free_motion(source)
    assert np.allclose(u, v + np.cross(spin, POINT), rtol=0, atol=1e-8 * np.abs(u).max())
    assert np.allclose(omega, spin, rtol=0, atol=1e-8 * np.abs(omega).max())
    stress = body(k).stresslet(source)
    assert np.allclose(s, stress, rtol=0, atol=1e-7 * np.abs(stress).max())


def test_about_needs_a_point():
    with pytest.raises(SceneError, match=r"about is .* three finite numbers"):
        body(1.0).law([0.0, 1.0])
