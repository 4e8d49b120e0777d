"""The layer potentials: identities, orders of convergence, agreement of schemes."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from qbxstokes.errors import CaseError
from qbxstokes.geometry.grid import SurfaceGrid
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.qbx.modes import ModalOperator, from_modes, to_modes
from qbxstokes.qbx.operator import (
    GradedScheme,
    UniformScheme,
    blocks_from_rows,
    independent_rows,
    layer_rows,
    rigid_defects,
)


def double_layer(spheroid, scheme, n_phi=3):
    rows, _ = layer_rows(
        spheroid, scheme, n_phi // 2 + 1, independent_rows(spheroid, scheme.n_theta)
    )
    return ModalOperator(blocks_from_rows(rows), scheme.n_theta, n_phi)


def rigid_fields(grid):
    eye = np.eye(3)
    return [np.tile(e, (len(grid.points), 1)) for e in eye] + [
        np.cross(e, grid.points) for e in eye
    ]


@pytest.mark.parametrize("k", [1 / 50, 0.3, 1.0, 2.0, 50.0])
@pytest.mark.parametrize("nodes", ["cosine", "theta"])
def test_surface_area_and_volume_by_quadrature(k, nodes):
    # The area element of a thin body is nearly singular: the rule needs many nodes for it.
    grid = SurfaceGrid(Spheroid(k), 500, 1, nodes)
    assert np.sum(grid.weights) == pytest.approx(grid.shape.surface_area, rel=1e-8)
    flux = np.sum(grid.weights * np.einsum("ij,ij->i", grid.points, grid.normals)) / 3
    # One azimuthal node suffices: x.n does not depend on phi.
    assert flux == pytest.approx(grid.shape.volume, rel=1e-12)


@pytest.mark.parametrize("k", [0.02, 0.5, 1.0, 3.0, 50.0])
def test_admissible_ball_touches_the_surface_only_once(k):
    spheroid = Spheroid(k)
    theta = np.linspace(1e-3, np.pi - 1e-3, 41)
    radius = spheroid.admissible_radius(theta)
    sources = spheroid.surface(np.linspace(0, np.pi, 4001)[:, None], np.linspace(0, np.pi, 3))
    for side in (1, -1):
        centres = spheroid.surface(theta, 0.0) + side * radius[:, None] * spheroid.normal(theta, 0)
        for centre, r in zip(centres, radius, strict=True):
            nearest = np.min(np.linalg.norm(sources - centre, axis=-1))
            assert nearest >= r * (1 - 1e-6)


@pytest.mark.parametrize("k", [0.0, -1.0, np.nan, np.inf])
def test_impossible_aspect_ratio(k):
    with pytest.raises(CaseError, match="aspect_ratio"):
        Spheroid(k)


@pytest.mark.parametrize("n_phi", [3, 4, 7, 8])
def test_modes_and_back(n_phi):
    field = np.random.default_rng(0).normal(size=(5 * n_phi, 3))
    assert np.allclose(from_modes(to_modes(field, 5, n_phi), 5, n_phi), field, atol=1e-14)


@pytest.mark.parametrize("n_phi", [5, 6])
def test_transpose_and_inverse(n_phi):
    operator = double_layer(Spheroid(0.4), GradedScheme(n_theta=6), n_phi)
    operator = ModalOperator(operator.blocks - 4 * np.pi * 1.1 * np.eye(18), 6, n_phi)
    rng = np.random.default_rng(1)
    x, y = rng.normal(size=(2, 6 * n_phi, 3))
    assert np.sum(operator.apply(x) * y) == pytest.approx(np.sum(x * operator.apply_transpose(y)))
    back = operator.inverse.apply(operator.apply(x))
    if n_phi % 2:
        assert np.allclose(back, x, atol=1e-11)
    weighted = operator.balanced(np.linspace(1, 2, 6))
    values = [np.sort_complex(np.linalg.eigvals(o.blocks)) for o in (weighted, operator)]
    assert np.allclose(*values)


@pytest.mark.parametrize("k", [1 / 50, 1 / 10, 0.5, 1.0, 2.0, 10.0, 50.0])
def test_double_layer_of_a_rigid_motion_is_four_pi(k):
    """D of a rigid motion is 4 pi times it on the surface (method: 8 pi inside, 0 outside)."""
    scheme = GradedScheme(n_theta=10)
    operator = double_layer(Spheroid(k), scheme)
    for field in rigid_fields(SurfaceGrid(Spheroid(k), 10, 3)):
        error = np.abs(operator.apply(field) - 4 * np.pi * field)
        assert np.max(error) < 1e-10 * np.max(np.abs(field))


def smooth_density(x):
    return np.stack([x[..., 0] * x[..., 2], x[..., 1] + x[..., 2] ** 2, x[..., 0]], axis=-1)


def double_layer_values(spheroid, scheme):
    points = scheme.grid(spheroid, 7).points
    return double_layer(spheroid, scheme, 7).apply(smooth_density(points)), points


@pytest.mark.parametrize("side", ["inner", "outer"])
def test_one_sided_expansions_with_the_jump_agree_with_the_average(side):
    spheroid = Spheroid(0.5)
    average, _ = double_layer_values(spheroid, GradedScheme(side="average"))
    one, _ = double_layer_values(spheroid, GradedScheme(side=side))
    assert np.max(np.abs(one - average)) < 1e-10
    assert np.max(np.abs(one - average)) > 0


@pytest.mark.parametrize("k", [1 / 50, 0.5, 20.0])
def test_imposed_rigid_motions_change_what_the_quadrature_misses(k):
    """It then holds to rounding, and the rows change by no more than the quadrature missed."""
    spheroid, rows = Spheroid(k), independent_rows(Spheroid(k), 6)
    for order, bound in ((8, 1e-4), (16, 1e-9)):
        schemes = [
            GradedScheme(6, expansion_order=order, keep_rigid=keep) for keep in (False, True)
        ]
        plain, imposed = (layer_rows(spheroid, scheme, 3, rows)[0] for scheme in schemes)
        grid = schemes[0].grid(spheroid, 1)
        missed = np.max(np.abs(rigid_defects(grid, rows, plain)))
        assert 0 < missed < bound
        # Rounding of the sums themselves is magnified by the ratio of height to width.
        assert np.max(np.abs(rigid_defects(grid, rows, imposed))) < 1e-14 * max(1, 1 / k) * 50
        assert np.max(np.abs(imposed - plain)) <= 2 * missed
        assert np.array_equal(imposed[:, 2], plain[:, 2])


def test_double_layer_against_singularity_subtraction():
    """An independent quadrature: D[psi] = int T (psi(y) - psi(x)) n dS + 4 pi psi(x)."""
    k, n_theta, n_phi = 0.6, 8, 7
    grid = SurfaceGrid(Spheroid(k), n_theta, n_phi)
    operator = double_layer(Spheroid(k), GradedScheme(n_theta=n_theta), n_phi)
    density = smooth_density
    target_index = 4 * n_phi + 2
    target = grid.points[target_index]
    # Polar coordinates about the target would be exact; nested refinement is enough here.
    total = np.zeros(3)
    x, w = np.polynomial.legendre.leggauss(20)
    theta_t, phi_t = grid.theta[4], grid.phi[2]
    edges = np.concatenate([[0.0], 0.5 ** np.arange(40, -1, -1)])
    for lo, hi in pairwise(edges):
        u = 0.5 * (lo + hi) + 0.5 * (hi - lo) * x
        wu = 0.5 * (hi - lo) * w
        for v, wv in zip(0.5 * (x + 1), 0.5 * w, strict=True):
            for a, b in ((u, u * v), (u * v, u)):  # Duffy triangles of the unit square
                for end_t in (0.0, np.pi):
                    for end_p in (-np.pi, np.pi):
                        theta = theta_t + (end_t - theta_t) * a
                        phi = phi_t + end_p * b
                        y = grid.shape.surface(theta, phi)
                        n = grid.shape.normal(theta, phi)
                        weight = wu * wv * u * abs((end_t - theta_t) * end_p)
                        weight = weight * grid.shape.area_element(theta)
                        r = target - y
                        jump = density(y) - density(target)
                        kernel = -6 * np.sum(r * jump, -1) * np.sum(r * n, -1)
                        kernel = kernel / np.linalg.norm(r, axis=-1) ** 5
                        total += (weight * kernel) @ r
    total += 4 * np.pi * density(target)
    value = operator.apply(density(grid.points))[target_index]
    assert np.allclose(value, total, atol=1e-9)


def rate(errors, steps):
    return -np.polyfit(steps, np.log10(errors), 1)[0]


def test_spectral_convergence_in_expansion_order():
    """The truncation error falls geometrically with p, at a rate set by the radius."""
    spheroid = Spheroid(0.5)
    orders = np.array([4, 6, 8, 10, 12])
    field = rigid_fields(SurfaceGrid(spheroid, 8, 3))[0]
    rates = []
    for factor in (0.3, 0.15):
        errors = [
            np.max(
                np.abs(
                    double_layer(
                        spheroid,
                        GradedScheme(
                            n_theta=8,
                            expansion_order=p,
                            radius_factor=factor,
                            panel_ratio=0.5,
                            side="average",
                            keep_rigid=False,
                        ),
                    ).apply(field)
                    - 4 * np.pi * field
                )
            )
            for p in orders
        ]
        rates.append(rate(errors, orders))
    # Each order gains a factor of about radius over distance to the nearest singularity of the
    # continued potential: halving the radius gains log10(2) per order.
    assert rates[0] > 0.35
    assert rates[1] - rates[0] == pytest.approx(np.log10(2), abs=0.12)


def test_uniform_scheme_converges_to_the_same_values():
    """The thesis's scheme on its own grid: quadrature error falls geometrically with kappa."""
    spheroid = Spheroid(0.7)
    graded, graded_points = double_layer_values(spheroid, GradedScheme())

    def error(upsampling):
        values, points = double_layer_values(spheroid, UniformScheme(16, 7, 12, 0.4, upsampling))
        # D of the quadratic density is itself quadratic: fit it on one grid, compare on the other.
        exact = quadratic_fit(graded, graded_points)(points)
        return np.max(np.abs(values - exact))

    # High orders amplify the quadrature error: the thesis's scheme needs a large upsampling.
    errors = [error(upsampling) for upsampling in (8, 16, 32)]
    assert errors[2] < 1e-3
    assert errors[1] < 0.1 * errors[0]
    assert errors[2] < 0.1 * errors[1]


def quadratic_fit(values, points):
    def basis(x):
        a, b, c = np.moveaxis(x, -1, 0)
        one = np.ones_like(a)
        return np.stack([one, a, b, c, a * a, a * b, a * c, b * b, b * c], axis=-1)

    coefficients, *_ = np.linalg.lstsq(basis(points), values, rcond=None)
    assert np.max(np.abs(basis(points) @ coefficients - values)) < 1e-10
    return lambda x: basis(x) @ coefficients


def test_uniform_radius_restriction_names_its_formula():
    scheme = UniformScheme(20, 10, 8, 2.0, 4)
    with pytest.raises(CaseError, match=r"r_over_h <= 0\.25 n_theta / \(2 pi\) = 0\.79"):
        scheme.radius(Spheroid(0.5), 1.0)
    with pytest.raises(CaseError, match=r"r_over_h <= 0\.5 n_theta / \(2 pi\) = 1\.59"):
        scheme.radius(Spheroid(2.0), 1.0)
