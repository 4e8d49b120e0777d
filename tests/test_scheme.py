"""The thesis's scheme and the fast one: the same expansions, the same symmetries, at what cost."""

from __future__ import annotations

import math

import numpy as np
import pytest

from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.qbx.expansion import expanded_kernels, irregular_harmonics, regular_harmonics
from qbxstokes.qbx.operator import (
    GradedScheme,
    UniformScheme,
    blocks_from_rows,
    independent_rows,
    layer_rows,
)


def random_points(n, seed, size=1.0):
    return np.random.default_rng(seed).normal(size=(n, 3)) * size


def test_harmonics_sum_to_one_over_distance():
    """Eq. 5.14: sum of r_x^l Y_l^-m r_y^-(l+1) Y_l^m tends to 1/|x - y|, geometrically."""
    x, y = random_points(4, 0, 0.2), random_points(4, 1)
    y /= 0.5 * np.linalg.norm(y, axis=1, keepdims=True)
    exact = 1 / np.linalg.norm(x - y, axis=1)
    errors = []
    for order in (4, 8, 12, 16):
        weight = [1 if m == 0 else 2 for l in range(order + 1) for m in range(l + 1)]
        inner, outer = regular_harmonics(x, order)[0], irregular_harmonics(y, order)[0]
        errors.append(np.max(np.abs(np.array(weight) @ (np.conj(inner) * outer).real - exact)))
    slope = np.polyfit([4, 8, 12, 16], np.log10(errors), 1)[0]
    ratio = np.max(np.linalg.norm(x, axis=1) / np.linalg.norm(y, axis=1))
    assert slope < math.log10(ratio) + 0.1
    assert errors[-1] < 1e-7


@pytest.mark.parametrize("harmonics", [regular_harmonics, irregular_harmonics])
def test_gradients_of_harmonics_are_their_derivatives(harmonics):
    x, step = random_points(3, 2), 1e-5
    _, gradient = harmonics(x, 7)
    for i in range(3):
        shift = step * np.eye(3)[i]
        change = (harmonics(x + shift, 7)[0] - harmonics(x - shift, 7)[0]) / (2 * step)
        scale = np.max(np.abs(gradient[i]), axis=1, keepdims=True) + 1e-30
        assert np.max(np.abs(gradient[i] - change) / (scale + np.max(np.abs(change)))) < 1e-7


def stresslet(x, y, normal):
    r = x - y
    d = np.linalg.norm(r, axis=-1)[:, None, None]
    return -6 * r[:, :, None] * r[:, None, :] * np.sum(r * normal, -1)[:, None, None] / d**5


def test_expanded_kernel_tends_to_the_stresslet():
    y, normal = random_points(6, 3), random_points(6, 4)
    y *= 2 / np.linalg.norm(y, axis=1, keepdims=True)
    x, centre = np.array([0.3, -0.2, 0.1]), np.array([0.05, 0.1, -0.1])
    exact = stresslet(x, y, normal)
    errors = [
        np.max(np.abs(expanded_kernels(x, y, normal, centre, 0.5, order)[0] - exact))
        for order in (6, 12, 18, 24)
    ]
    assert np.polyfit([6, 12, 18, 24], np.log10(errors), 1)[0] < -0.45
    assert errors[-1] < 1e-9


@pytest.mark.parametrize("order", [0, 1, 5, 12, 20])
def test_coefficients_of_four_layers_are_the_summed_kernel(order):
    """Eq. 5.19-5.22 with stored z_lm, at several targets of one centre."""
    y, normal, density = (random_points(40, seed) for seed in (5, 6, 7))
    y *= 3 / np.linalg.norm(y, axis=1, keepdims=True)
    centre, radius = np.array([0.4, -0.3, 0.2]), 0.7
    targets = centre + random_points(5, 8, 0.3)
    arms, n = (y - centre) / radius, normal / radius**2
    _, slopes = irregular_harmonics(arms, order)
    along, across = (np.einsum("iln,ni->ln", slopes, each) for each in (n, density))
    moment = along @ np.sum(arms * density, 1) + across @ np.sum(arms * n, 1)
    z = np.concatenate([(along @ density + across @ n).T, moment[None]])
    assert z.shape == (4, (order + 1) * (order + 2) // 2)
    z *= [1 if m == 0 else 2 for l in range(order + 1) for m in range(l + 1)]
    x = (targets - centre) / radius
    values, slopes = (np.conj(part) for part in regular_harmonics(x, order))
    layers = np.einsum("cl,ln->cn", z, values).real
    slopes = np.einsum("cl,iln->cin", z, slopes).real
    velocity = np.einsum("nj,jin->ni", x, slopes[:3]) - layers[:3].T - slopes[3].T
    for target, u in zip(targets, velocity, strict=True):
        kernel, _ = expanded_kernels(target, y, normal, centre, radius, order)
        assert np.allclose(u, np.einsum("nij,nj->i", kernel, density), rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize("side", ["average", "inner", "outer"])
@pytest.mark.parametrize(("k", "order"), [(0.5, 0), (0.5, 6), (0.5, 20), (1.0, 10), (3.0, 10)])
def test_coefficients_equal_the_target_specific_form(k, order, side):
    """The rows of both layers agree to rounding, whatever the order and the side."""
    schemes = [
        UniformScheme(6, 6, order, 0.15, 3, side, coefficients) for coefficients in (False, True)
    ]
    fast, full = (layer_rows(Spheroid(k), scheme, 4, range(3), True) for scheme in schemes)
    for a, b in zip(fast, full, strict=True):
        assert np.max(np.abs(a - b)) < 2e-13 * np.max(np.abs(a))


def test_mirror_symmetry_gives_the_rows_left_out():
    for scheme in (GradedScheme(7), UniformScheme(7, 6, 6, 0.1, 6)):
        spheroid = Spheroid(0.6)
        every, _ = layer_rows(spheroid, scheme, 3, range(7))
        half, _ = layer_rows(spheroid, scheme, 3, independent_rows(spheroid, 7))
        blocks = blocks_from_rows(half).reshape(3, 3, 7, 3, 7)
        assert len(half) == 4
        assert np.max(np.abs(blocks - np.moveaxis(every, 0, 2))) < 1e-12 * np.max(np.abs(every))


def test_rotational_symmetry_gives_the_targets_left_out():
    """Sources and target turned about the axis by any angle: the same expansion, turned."""
    spheroid, centre = Spheroid(0.7), np.array([0.9, 0.0, 0.3])
    y = spheroid.surface(np.linspace(0.2, 3, 5)[:, None], np.linspace(0, 6, 7)).reshape(-1, 3)
    normal, density = random_points(len(y), 9), random_points(len(y), 10)
    target = np.array([0.8, 0.1, 0.25])
    turn = np.array(
        [[math.cos(1.1), -math.sin(1.1), 0], [math.sin(1.1), math.cos(1.1), 0], [0, 0, 1]]
    )
    here, _ = expanded_kernels(target, y, normal, centre, 0.2, 8)
    turned = (points @ turn.T for points in (target, y, normal, centre))
    there, _ = expanded_kernels(*turned, 0.2, 8)
    u, v = np.einsum("nij,nj->i", here, density), np.einsum("nij,nj->i", there, density @ turn.T)
    assert np.allclose(v, turn @ u, rtol=1e-12)


def test_rows_do_not_depend_on_their_company():
    """What makes any number of processes give the numbers of one."""
    spheroid, scheme = Spheroid(0.3), GradedScheme(8)
    together, single = layer_rows(spheroid, scheme, 3, range(4), True)
    for row in range(4):
        alone, alone_single = layer_rows(spheroid, scheme, 3, [row], True)
        assert np.array_equal(alone[0], together[row])
        assert np.array_equal(alone_single[0], single[row])
