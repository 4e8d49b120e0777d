"""Quaternions, matrices and Euler angles agree with each other and with the stated conventions."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import qbxstokes as qs
from qbxstokes.geometry import rotation

RNG = np.random.default_rng(7)
ANGLE = st.floats(-3.0, 3.0)


def elementary(index: int, angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    i, j = (index + 1) % 3, (index + 2) % 3
    out = np.eye(3)
    out[i, i] = out[j, j] = c
    out[i, j], out[j, i] = -s, s
    return out


@given(phi=ANGLE, theta=st.floats(0.0, np.pi), psi=ANGLE)
def test_euler_angles_are_313(phi: float, theta: float, psi: float) -> None:
    expected = elementary(2, phi) @ elementary(0, theta) @ elementary(2, psi)
    q = rotation.from_euler(phi, theta, psi)
    assert np.allclose(rotation.matrix(q), expected, atol=1e-14)
    d = np.array([np.sin(theta) * np.sin(phi), -np.sin(theta) * np.cos(phi), np.cos(theta)])
    assert np.allclose(rotation.axis(q), d, atol=1e-14)


@given(phi=ANGLE, theta=st.floats(1e-3, np.pi - 1e-3), psi=ANGLE)
def test_euler_angles_return(phi: float, theta: float, psi: float) -> None:
    angles = rotation.to_euler(rotation.from_euler(phi, theta, psi))
    assert np.allclose(angles, [phi, theta, psi], atol=1e-12)


@pytest.mark.parametrize("theta", [0.0, np.pi])
def test_euler_angles_at_the_poles(theta: float) -> None:
    q = rotation.from_euler(0.7, theta, 0.4)
    angles = rotation.to_euler(q)
    assert np.all(np.isfinite(angles))
    assert angles[2] == 0.0
    assert np.isclose(angles[1], theta, atol=1e-15)
    again = rotation.from_euler(*angles)
    assert np.allclose(rotation.matrix(again), rotation.matrix(q), atol=1e-14)


def test_small_theta_keeps_its_digits() -> None:
    angles = rotation.to_euler(rotation.from_euler(0.3, 1e-9, 0.2))
    assert np.isclose(angles[1], 1e-9, rtol=1e-12)


def test_product_is_composition() -> None:
    p, q = rotation.random_quaternions(20, RNG), rotation.random_quaternions(20, RNG)
    assert np.allclose(
        rotation.matrix(rotation.multiply(p, q)), rotation.matrix(p) @ rotation.matrix(q)
    )
    identity = rotation.multiply(p, rotation.conjugate(p))
    assert np.allclose(identity, [1.0, 0.0, 0.0, 0.0])


def test_frames() -> None:
    q, v = rotation.random_quaternions(5, RNG), RNG.standard_normal((5, 3))
    assert np.allclose(rotation.to_body(q, rotation.to_space(q, v)), v)
    assert np.allclose(rotation.to_space(q, [0.0, 0.0, 1.0]), rotation.axis(q))
    assert np.allclose(np.linalg.det(rotation.matrix(q)), 1.0)


def test_from_axis() -> None:
    axes = rotation.random_axes(50, RNG)
    assert np.allclose(rotation.axis(rotation.from_axis(axes)), axes, atol=1e-14)
    assert np.allclose(rotation.from_axis([0.0, 0.0, 5.0]), [1.0, 0.0, 0.0, 0.0])
    assert np.allclose(rotation.axis(rotation.from_axis([0.0, 0.0, -2.0])), [0.0, 0.0, -1.0])
    assert np.allclose(rotation.axis(rotation.from_axis([0.0, 1e-200, 0.0])), [0.0, 1.0, 0.0])


def test_normalize() -> None:
    assert np.allclose(rotation.normalize([0.0, 3e300, 0.0, 4e300]), [0.0, 0.6, 0.0, 0.8])
    for bad in ([0.0, 0.0, 0.0, 0.0], [np.nan, 0.0, 0.0, 1.0]):
        with pytest.raises(ValueError, match="quaternion"):
            rotation.normalize(bad)
    with pytest.raises(ValueError, match="direction"):
        rotation.from_axis([0.0, 0.0, 0.0])


def test_random_axes_are_isotropic() -> None:
    axes = rotation.random_axes(20000, np.random.default_rng(1))
    assert np.allclose(axes.T @ axes / len(axes), np.eye(3) / 3.0, atol=0.01)
    turned = rotation.axis(rotation.random_quaternions(20000, np.random.default_rng(2)))
    assert np.allclose(turned.T @ turned / len(turned), np.eye(3) / 3.0, atol=0.01)


@pytest.mark.parametrize("axis", [[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]])
def test_phi_is_smooth_where_the_axis_of_a_heavy_body_stands_at_a_pole(axis: list[float]) -> None:
    body = qs.Body(2.0, stokes_number=1.0)
    times = np.linspace(0.0, 20.0, 201)
    motion = body.integrate(qs.flow("shear"), times, orientation=axis, tolerance=1e-6)
    phi, theta, psi = motion.euler_angles.T
    assert np.all(psi == 0.0)
    assert np.allclose(theta, np.arccos(axis[2]), atol=1e-8)
    assert np.allclose(np.unwrap(phi), -0.5 * times, atol=1e-6)
