"""The closed forms against identities, limits, quadrature and each other."""

import numpy as np
import pytest
from euler_orbits import euler_angles_at
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from qbxstokes.reference import chwang, faxen, inertial, jeffery, lamb

ASPECT_RATIOS = [0.01, 0.02, 0.1, 0.5, 0.87, 0.999, 1.0, 1.001, 1.1, 2.0, 10.0, 50.0, 100.0]
SHEAR = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])


def euler_matrix(phi, theta, psi):
    def about_3(a):
        c, s = np.cos(a), np.sin(a)
        return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])

    c, s = np.cos(theta), np.sin(theta)
    about_1 = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    return about_3(phi) @ about_1 @ about_3(psi)


def euler_quaternion(phi, theta, psi):
    half = 0.5 * theta
    plus, minus = 0.5 * (phi + psi), 0.5 * (phi - psi)
    return np.array(
        [
            np.cos(half) * np.cos(plus),
            np.sin(half) * np.cos(minus),
            np.sin(half) * np.sin(minus),
            np.cos(half) * np.sin(plus),
        ]
    )


def quaternion_matrix(q):
    cross = np.array([[0.0, -q[3], q[2]], [q[3], 0.0, -q[1]], [-q[2], q[1], 0.0]])
    return np.eye(3) + 2.0 * (q[0] * cross + cross @ cross)


def random_rotation(rng):
    q = rng.normal(size=4)
    return quaternion_matrix(q / np.linalg.norm(q))


def random_stokes_tensors(rng):
    """(derivatives at the origin, velocity) of a random Stokes flow of degree 3."""
    points = rng.normal(size=(40, 3))
    exponents = [(a, b, c) for a in range(4) for b in range(4) for c in range(4) if a + b + c <= 3]

    def row(order):
        """Rows of d^order of each monomial at the points."""
        out = np.ones((len(points), len(exponents)))
        for column, exponent in enumerate(exponents):
            for axis in range(3):
                e, o = exponent[axis], order[axis]
                factor = np.prod([e - m for m in range(o)]) if o else 1.0
                out[:, column] *= factor * points[:, axis] ** max(e - o, 0)
        return out

    def unit(*axes):
        return tuple(sum(axis == j for axis in axes) for j in range(3))

    blocks = [np.hstack([row(unit(i)) for i in range(3)])]
    lap = [sum(row(unit(j, m, m)) for m in range(3)) for j in range(3)]
    zero = np.zeros_like(lap[0])
    blocks += [np.hstack([zero, -lap[2], lap[1]]), np.hstack([lap[2], zero, -lap[0]])]
    blocks += [np.hstack([-lap[1], lap[0], zero])]
    _, sigma, vt = np.linalg.svd(np.vstack(blocks))
    null = vt[np.sum(sigma > 1e-9 * sigma[0]) :]
    coefficients = (rng.normal(size=len(null)) @ null).reshape(3, -1)
    tensors = [np.zeros((3,) * (n + 1)) for n in range(4)]
    for column, exponent in enumerate(exponents):
        degree = sum(exponent)
        scale = np.prod([float(np.prod(range(1, e + 1))) for e in exponent])
        for index in np.ndindex(*(3,) * degree):
            if unit(*index) == exponent:
                tensors[degree][(slice(None), *index)] = scale * coefficients[:, column]

    def velocity(x):
        monomials = np.stack([np.prod(x ** np.array(e), axis=-1) for e in exponents], axis=-1)
        return monomials @ coefficients.T

    return tensors, velocity


# -- integrals, Lamb, Jeffery's resistance ----------------------------------------------------


@pytest.mark.parametrize("k", ASPECT_RATIOS)
def test_elliptic_integrals_satisfy_their_sum_rules(k):
    alpha, gamma, chi = lamb.alpha0(k), lamb.gamma0(k), lamb.chi0(k)
    assert 2 * alpha + gamma == pytest.approx(2 / k**2, rel=4e-15)
    assert 2 * k**2 * alpha + gamma == pytest.approx(chi, rel=4e-15)


@pytest.mark.parametrize("k", [0.02, 0.1, 0.5, 2.0, 10.0, 50.0])
def test_chi0_is_elementary(k):
    e = np.sqrt(abs(1 - k * k))
    elementary = 2 * np.log((1 + e) / k) / e if k < 1 else 2 * np.arctan(e) / e
    assert lamb.chi0(k) == pytest.approx(elementary, rel=2e-14)


def test_resistance_of_sphere_disc_and_needle():
    assert lamb.translation_resistance(1.0) == pytest.approx((6 * np.pi,) * 2, rel=1e-15)
    assert jeffery.rotation_resistance(1.0) == pytest.approx((8 * np.pi,) * 2, rel=1e-15)
    k = 1e7
    assert np.array(lamb.translation_resistance(k)) / k == pytest.approx([32 / 3, 16], rel=1e-6)
    assert np.array(jeffery.rotation_resistance(k)) / k**3 == pytest.approx([32 / 3] * 2, rel=1e-6)
    k = 1e-7  # slender-body limits: ratio 2 with the known logarithms
    across, along = lamb.translation_resistance(k)
    log = np.log(2 / k)
    assert along == pytest.approx(4 * np.pi / (log - 0.5), rel=1e-12)
    assert across == pytest.approx(8 * np.pi / (log + 0.5), rel=1e-12)
    assert jeffery.rotation_resistance(k)[0] == pytest.approx(
        8 * np.pi / 3 / (log - 0.5), rel=1e-12
    )
    assert jeffery.rotation_resistance(k)[1] == pytest.approx(16 * np.pi / 3 * k * k, rel=1e-12)


@pytest.mark.parametrize("k", ASPECT_RATIOS)
def test_drag_and_torque_oppose_motion_and_vanish_when_free(k):
    rng = np.random.default_rng(1)
    gradient, omega = rng.normal(size=(2, 5, 3, 3))[0], rng.normal(size=(5, 3))
    gradient -= np.trace(gradient, axis1=1, axis2=2)[:, None, None] / 3 * np.eye(3)
    across, along = jeffery.rotation_resistance(k)
    drag = np.array([across, across, along])
    free = jeffery.free_angular_velocity(k, gradient)
    scale = np.abs(drag).max() * np.abs(gradient).max()
    assert np.abs(jeffery.torque(k, gradient, free)).max() < 1e-14 * scale
    torque = jeffery.torque(k, gradient, omega)
    assert np.abs(torque - drag * (free - omega)).max() < 1e-14 * scale
    v = rng.normal(size=3)
    assert v @ lamb.drag(k, v) < 0


# -- the laws from first principles: single layers that move the body rigidly ------------------


def single_layer(k, point, density, order=100):
    """S[f](x) = int (f/r + r (f.r)/r^3) ds/(8 pi) over the unit sphere s, y = (k, k, 1) s."""
    height, weight = np.polynomial.legendre.leggauss(order)
    angle = np.pi / order * (np.arange(2 * order) + 0.5)
    radius = np.sqrt(1 - height**2)
    sphere = np.stack(
        [
            np.outer(radius, np.cos(angle)),
            np.outer(radius, np.sin(angle)),
            np.outer(height, np.ones(2 * order)),
        ],
        axis=-1,
    ).reshape(-1, 3)
    measure = np.repeat(weight * np.pi / order, 2 * order)
    f = density(sphere)
    r = point - sphere * [k, k, 1.0]
    distance = np.linalg.norm(r, axis=1)[:, None]
    kernel = f / distance + r * np.sum(r * f, axis=1)[:, None] / distance**3
    return measure @ kernel / (8 * np.pi)


INSIDE = np.array([[0.0, 0.0, 0.0], [0.3, 0.2, 0.3], [-0.1, 0.4, -0.4]])


@pytest.mark.parametrize("k", [0.5, 2.0])
def test_force_spread_by_the_support_function_moves_the_body_rigidly(k):
    """Hence U = (mean of u over s) for a free body, and F = R U with Lamb's resistance."""
    across, along = lamb.translation_resistance(k)
    for force, resistance in zip(np.eye(3), (across, across, along), strict=True):
        for x in INSIDE * [k, k, 1.0]:
            u = single_layer(k, x, lambda s, force=force: np.tile(force / (4 * np.pi), (len(s), 1)))
            assert u == pytest.approx(force / resistance, abs=1e-11)


@pytest.mark.parametrize("k", [0.5, 2.0])
def test_torque_from_the_reciprocal_theorem_is_jefferys(k):
    """Tractions B n move the body linearly; those of a rotation give the torque in any flow."""
    axes = np.array([k, k, 1.0])
    x = 0.4 * np.eye(3)
    origin = np.zeros(3)
    response = np.empty((9, 9))
    for column, b in enumerate(np.eye(9).reshape(9, 3, 3)):
        # B n dS = B (s/a) a1 a2 a3 ds; the field inside is linear and odd.
        def density(s, b=b):
            return k * k * (s / axes) @ b.T

        assert single_layer(k, origin, density) == pytest.approx(origin, abs=1e-12)
        gradient = np.stack([single_layer(k, point, density) / 0.4 for point in x], axis=1)
        response[:, column] = gradient.ravel()
    rng = np.random.default_rng(10)
    flow = rng.normal(size=(3, 3))
    flow -= np.trace(flow) / 3 * np.eye(3)
    torque = np.empty(3)
    for axis, spin in enumerate(np.eye(3)):
        rotation = np.cross(spin, np.eye(3)).T
        traction = np.linalg.lstsq(response, rotation.ravel(), rcond=1e-8)[0]
        assert response @ traction == pytest.approx(rotation.ravel(), abs=1e-9)
        torque[axis] = 4 * np.pi * k * k / 3 * np.sum(traction.reshape(3, 3) * flow)
    expected = jeffery.torque(k, flow, np.zeros(3))
    assert torque == pytest.approx(expected, abs=1e-8 * np.abs(expected).max())


# -- Jeffery orbits ---------------------------------------------------------------------------


@pytest.mark.parametrize("k", [0.02, 0.5, 1.0, 3.0, 50.0])
@pytest.mark.parametrize("rate", [1.0, -0.7])
def test_axis_of_orbit_is_periodic_conserves_orbit_constant_and_matches_expm(k, rate):
    rng = np.random.default_rng(2)
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    period = jeffery.period(k, rate)
    times = np.linspace(0.0, 2.0, 33) * period
    orbit = jeffery.axis_at(times, k, axis, rate)
    assert orbit[[0, 16, 32]] == pytest.approx(np.tile(axis, (3, 1)), abs=1e-13)
    assert jeffery.orbit_constant(k, orbit) == pytest.approx(
        np.full(33, jeffery.orbit_constant(k, axis)), rel=1e-12
    )
    general = jeffery.axis_in_linear_flow(times[5], k, rate * SHEAR, axis)
    assert general == pytest.approx(orbit[5], abs=1e-11)
    shape = (1 - k * k) / (1 + k * k)
    strain, spin = 0.5 * (SHEAR + SHEAR.T), 0.5 * (SHEAR - SHEAR.T)
    direct = expm(0.3 * rate * (spin + shape * strain)) @ axis
    assert jeffery.axis_at(0.3, k, axis, rate) == pytest.approx(
        direct / np.linalg.norm(direct), abs=1e-14
    )


def test_orbit_constant_at_log_rolling_and_tumbling():
    assert jeffery.orbit_constant(0.5, [0.0, 0.0, -1.0]) == 0.0
    assert jeffery.orbit_constant(0.5, [0.6, 0.8, 0.0]) == np.inf
    # Euler angles phi, theta: C = tan(theta) sqrt(cos^2 phi + k^2 sin^2 phi)/k
    phi, theta, k = 0.4, 1.1, 0.3
    axis = euler_matrix(phi, theta, 0.0)[:, 2]
    expected = np.tan(theta) * np.sqrt(np.cos(phi) ** 2 + k**2 * np.sin(phi) ** 2) / k
    assert jeffery.orbit_constant(k, axis) == pytest.approx(expected, rel=1e-14)


@pytest.mark.parametrize("k", [0.05, 0.5, 1.0, 4.0])
@pytest.mark.parametrize("theta", [0.0, 1e-9, 0.8, np.pi / 2, 2.5, np.pi])
def test_euler_angles_of_orbit_match_integrated_quaternions(k, theta):
    phi, psi = 0.3, -0.2
    times = np.array([0.0, 0.21, 0.5, 1.3]) * jeffery.period(k)
    angles = euler_angles_at(times, k, phi, theta, psi)
    assert angles[0] == pytest.approx([phi, theta, psi], abs=1e-15)
    start = euler_quaternion(phi, theta, psi)
    solution = inertial.linear_flow(k, 0.0, SHEAR, start, times, rtol=1e-12)
    for row, q in zip(angles, solution.orientation, strict=True):
        assert euler_matrix(*row) == pytest.approx(quaternion_matrix(q), abs=1e-10)
    assert angles[:, 0][-1] == pytest.approx(
        euler_angles_at(times[-1] - jeffery.period(k), k, phi, theta)[0] - 2 * np.pi
    )


# -- Faxen laws -------------------------------------------------------------------------------


@pytest.mark.parametrize("k", [0.02, 0.5, 1.0, 3.0, 50.0])
def test_polynomial_faxen_law_matches_surface_quadrature(k):
    rng = np.random.default_rng(3)
    tensors, velocity = random_stokes_tensors(rng)
    turn = random_rotation(rng)
    U, omega = faxen.free_motion(k, turn, np.zeros(3), velocity, order=8)
    U2, omega2 = faxen.free_motion_polynomial(k, turn[:, 2], *tensors)
    scale = np.abs(U).max() + np.abs(omega).max()
    assert pytest.approx(U2, abs=2e-13 * scale) == U
    assert pytest.approx(omega2, abs=2e-13 * scale) == omega


@pytest.mark.parametrize("k", [0.3, 2.0])
def test_coefficients_reproduce_the_polynomial_law(k):
    rng = np.random.default_rng(4)
    (u, a, b, c), _ = random_stokes_tensors(rng)
    d = random_rotation(rng)[:, 2]
    shape, q, cubic = faxen.body_coefficients(k)
    epsilon = np.zeros((3, 3, 3))
    for i in range(3):
        epsilon[i, (i + 1) % 3, (i + 2) % 3], epsilon[i, (i + 2) % 3, (i + 1) % 3] = 1.0, -1.0
    along = np.einsum("ijk,j,k->i", b, d, d)
    lap = np.einsum("ijj->i", b)
    U = u + q[0] * lap + q[1] * along + q[2] * d * (d @ lap) + q[3] * d * (d @ along)
    U = U + q[4] * np.einsum("jki,j,k->i", b, d, d)
    strain = 0.5 * (a + a.T)
    strain_lap, strain_along = np.einsum("ijkk->ij", c), np.einsum("ijkl,k,l->ij", c, d, d)
    w_along = np.einsum("ijk,kj->i", epsilon, strain_along)
    assert np.einsum("ijk,kj->i", epsilon, strain_lap) == pytest.approx(np.zeros(3), abs=1e-12)
    omega = 0.5 * np.einsum("ijk,kj->i", epsilon, a) + shape * np.cross(d, strain @ d)
    omega += cubic[0] * w_along + cubic[1] * d * (d @ w_along)
    omega += cubic[2] * np.cross(d, 0.5 * (strain_lap + strain_lap.T) @ d)
    omega += cubic[3] * np.cross(d, 0.5 * (strain_along + strain_along.T) @ d)
    expected = faxen.free_motion_polynomial(k, d, u, a, b, c)
    assert pytest.approx(expected[0], abs=1e-12) == U
    assert omega == pytest.approx(expected[1], abs=1e-12)


def test_sphere_in_a_stokeslet_obeys_the_classical_laws():
    force, source, centre = np.array([1.0, 2.0, -0.5]), np.array([0.5, 2.0, 1.0]), np.zeros(3)

    def velocity(x):
        r = x - source
        distance = np.linalg.norm(r, axis=-1, keepdims=True)
        return (force / distance + r * (r @ force)[..., None] / distance**3) / (8 * np.pi)

    r = centre - source
    distance = np.linalg.norm(r)
    lap = (force / distance**3 - 3 * r * (r @ force) / distance**5) / (4 * np.pi)
    U, omega = faxen.free_motion(1.0, random_rotation(np.random.default_rng(5)), centre, velocity)
    assert pytest.approx(velocity(centre) + lap / 6, abs=1e-14) == U
    assert omega == pytest.approx(np.cross(force, r) / distance**3 / (8 * np.pi), abs=1e-14)
    triaxial = faxen.free_motion((1.0, 1.0, 1.0), np.eye(3), centre, velocity)
    assert triaxial[0] == pytest.approx(U, abs=1e-14)
    assert triaxial[1] == pytest.approx(omega, abs=1e-14)


def test_slender_and_flat_ellipsoids_agree_with_the_spheroid():
    rng = np.random.default_rng(6)
    _, velocity = random_stokes_tensors(rng)
    turn, centre = random_rotation(rng), rng.normal(size=3)
    for k in (0.2, 4.0):
        one = faxen.free_motion(k, turn, centre, velocity, order=8)
        two = faxen.free_motion((k, k, 1.0), turn, centre, velocity, order=8)
        assert one[0] == pytest.approx(two[0], rel=1e-13)
        assert one[1] == pytest.approx(two[1], rel=1e-13)


# -- Chwang -----------------------------------------------------------------------------------


@pytest.mark.parametrize("k", ASPECT_RATIOS)
def test_chwang_agrees_with_the_faxen_law_for_every_aspect_ratio(k):
    curvature, eta, phi = 0.7, 1.3, 0.6

    def velocity(x):
        stream = curvature * (x[..., 1] ** 2 + x[..., 2] ** 2)
        return np.stack([stream, 0 * stream, 0 * stream], axis=-1)

    turn = euler_matrix(phi, np.pi / 2, 0.0)
    centre = np.array([0.4, eta, 0.0])
    cosine, sine = turn[0, 2], turn[0, 0]
    force, torque = faxen.fixed_force_torque(k, turn, centre, velocity, order=8)
    across, along = chwang.fixed_force(k, curvature, eta, cosine, sine)
    body_force = np.array([across, 0.0, along])
    body_torque = np.array([0.0, chwang.fixed_torque(k, curvature, eta, cosine), 0.0])
    assert turn @ body_force == pytest.approx(force, abs=3e-13 * np.abs(force).max())
    assert turn @ body_torque == pytest.approx(torque, abs=3e-13 * np.abs(torque).max())

    general = random_rotation(np.random.default_rng(7))
    U, omega = faxen.free_motion(k, general, centre, velocity, order=8)
    alpha = np.arccos(general[0, 2])
    expected = [chwang.free_velocity(k, curvature, eta, alpha), 0.0, 0.0]
    assert pytest.approx(expected, abs=1e-12 * np.abs(U).max()) == U
    gradient = 2 * curvature * eta * SHEAR
    spin = general @ jeffery.free_angular_velocity(k, general.T @ gradient @ general)
    assert omega == pytest.approx(spin, abs=1e-12 * np.abs(spin).max())


# -- inertial bodies --------------------------------------------------------------------------


@pytest.mark.parametrize("k", [0.5, 2.0])
def test_inertial_rotation_conserves_the_balance_of_angular_momentum(k):
    """The same motion in the space frame: d(J Omega)/dt = M/St with a rotation matrix as state."""
    stokes = 5.0
    start = euler_quaternion(0.4, 1.0, 0.3)
    spin = np.array([0.2, -0.3, 0.5])
    times = np.linspace(0.0, 12.0, 4)
    solution = inertial.linear_flow(k, stokes, SHEAR, start, times, spin)
    moments = inertial.inertia(k)

    def rate(_, y):
        turn, momentum = y[:9].reshape(3, 3), y[9:]
        body_spin = turn.T @ momentum / moments
        a, b, c = turn @ body_spin
        cross = np.array([[0.0, -c, b], [c, 0.0, -a], [-b, a, 0.0]])
        torque = turn @ jeffery.torque(k, turn.T @ SHEAR @ turn, body_spin)
        return np.concatenate([(cross @ turn).ravel(), torque / stokes])

    turn = quaternion_matrix(start)
    y0 = np.concatenate([turn.ravel(), turn @ (moments * spin)])
    check = solve_ivp(rate, (0.0, 12.0), y0, method="DOP853", rtol=1e-11, atol=1e-12)
    last = check.y[:9, -1].reshape(3, 3)
    assert quaternion_matrix(solution.orientation[-1]) == pytest.approx(last, abs=1e-9)
    expected = last.T @ check.y[9:, -1] / moments
    assert solution.angular_velocity[-1] == pytest.approx(expected, abs=1e-9)


def test_light_bodies_approach_the_massless_one_in_proportion_to_the_stokes_number():
    times = np.array([0.0, 2.0])
    start = euler_quaternion(0.2, 1.1, 0.0)
    massless = inertial.linear_flow(0.5, 0.0, SHEAR, start, times).orientation[-1]
    errors = [
        np.linalg.norm(
            inertial.linear_flow(0.5, st, SHEAR, start, times, rtol=1e-8).orientation[-1] - massless
        )
        for st in (0.2, 0.1)
    ]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(1.0, abs=0.1)
    assert errors[0] < 0.02


def test_massless_body_in_the_paraboloid_follows_jeffery_and_chwang():
    k, eta, phi = 0.5, 2.0, 0.3
    curvature = 1 / (2 * eta)
    times = np.linspace(0.0, jeffery.period(k), 5)
    solution = inertial.paraboloid(k, 0.0, curvature, (0.0, eta), phi, times)
    angles = euler_angles_at(times, k, phi, np.pi / 2)
    assert solution.phi == pytest.approx(angles[:, 0], abs=1e-11)
    assert solution.position[:, 1] == pytest.approx(np.full(5, eta), abs=1e-12)
    alpha = np.arccos(np.sin(solution.phi))
    speed = [chwang.free_velocity(k, curvature, eta, a) for a in alpha]
    assert solution.velocity[:, 0] == pytest.approx(speed, rel=1e-12)


def test_inertial_paraboloid_far_from_the_axis_turns_as_in_linear_shear_and_drifts_nearby():
    k, stokes, phi = 0.5, 10.0, 0.3
    times = np.linspace(0.0, 8.0, 3)
    far = inertial.paraboloid(k, stokes, 0.5e-6, (0.0, 1e6), phi, times, rtol=1e-7, atol=1e-8)
    start = euler_quaternion(phi, np.pi / 2, 0.0)
    linear = inertial.linear_flow(k, stokes, SHEAR, start, times, rtol=1e-7, atol=1e-8)
    turn = quaternion_matrix(linear.orientation[-1])
    expected = [np.sin(far.phi[-1]), -np.cos(far.phi[-1]), 0.0]
    assert turn[:, 2] == pytest.approx(expected, abs=1e-4)
    assert linear.angular_velocity[-1, 1] == pytest.approx(far.phi_rate[-1], abs=1e-4)
    near = inertial.paraboloid(k, stokes, 0.25, (0.0, 2.0), phi, [0.0, 20.0], rtol=1e-7, atol=1e-8)
    assert near.position[-1, 1] > 2.0  # inertia carries the body to higher shear


def test_heavy_body_keeps_its_velocity():
    solution = inertial.paraboloid(
        0.5, 1e12, 0.25, (0.0, 2.0), 0.3, [0.0, 1.0], velocity=(1.0, 0.5), phi_rate=-0.2
    )
    assert solution.position[-1] == pytest.approx([1.0, 2.5], abs=1e-9)
    assert solution.phi[-1] == pytest.approx(0.1, abs=1e-9)
