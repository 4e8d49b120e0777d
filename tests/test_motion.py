"""The equations of motion against closed forms, invariants and other evaluations of themselves."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import random_flow
from scenes import phase_period

from qbxstokes.flows.polynomial import PolynomialFlow
from qbxstokes.geometry import rotation
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.motion import diagnostics
from qbxstokes.motion.equations import Constraints, Loads, RigidBodyEquations
from qbxstokes.reference import chwang, faxen, jeffery, lamb
from qbxstokes.simulation.hydrodynamics import exact_model

Array = np.ndarray
RNG = np.random.default_rng(2)
LOADS = Loads(
    force=(1.0, 2.0, 3.0),
    torque=(0.5, 0.0, 1.0),
    body_force=(1.0, 0.0, -0.5),
    body_torque=(0.1, 0.2, 0.3),
)


def random_state(equations: RigidBodyEquations) -> Array:
    n = equations.n_lanes
    velocities = () if equations.massless else RNG.standard_normal((2, n, 3))
    return equations.initial_state(
        RNG.standard_normal((n, 3)), rotation.random_quaternions(n, RNG), *velocities
    )


def rates(equations: RigidBodyEquations, y: Array) -> Array:
    out = np.empty((equations.n_state, equations.n_lanes))
    equations.rates(0.0, np.ascontiguousarray(y.T), out)
    return out.T


def jacobian(equations: RigidBodyEquations, y: Array) -> Array:
    size = equations.n_state
    out = np.empty((equations.n_lanes, size, size))
    equations.jacobian(0.0, np.ascontiguousarray(y.T), out)
    return out


class FaxenProvider:
    """The free motion from the reference's Faxen law, as a provider that is not polynomial."""

    def __init__(self, k: float, flow: PolynomialFlow) -> None:
        self.k, self.flow = k, flow

    def free_motion(self, t: float, x: Array, q: Array) -> tuple[Array, Array]:
        return faxen.free_motion_polynomial(self.k, rotation.axis(q), *self.flow.derivatives(x))


class ForceProvider(FaxenProvider):
    """The same, which also knows force and torque."""

    def force_torque(
        self, t: float, x: Array, q: Array, v: Array, omega: Array
    ) -> tuple[Array, Array]:
        free, spin = self.free_motion(t, x, q)
        model = exact_model(Spheroid(self.k))
        probe = RigidBodyEquations(model, PolynomialFlow(), 1.0, len(x))
        # The drag of a body that moves with (v - free) through fluid at rest.
        y = probe.initial_state(x, q, v - free, omega - spin)
        return probe.force_torque(t, y)


@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("k", [0.3, 1.0, 4.0])
def test_free_motion_is_the_faxen_law(degree: int, k: float) -> None:
    flow = random_flow(degree, RNG).shifted((1.0, -2.0, 0.5))
    equations = RigidBodyEquations(exact_model(Spheroid(k)), flow, 0.0, 6)
    y = random_state(equations)
    v, omega = equations.velocities(0.0, y)
    expected = FaxenProvider(k, flow).free_motion(0.0, y[:, :3], y[:, 3:])
    assert np.allclose(v, expected[0], rtol=1e-13, atol=1e-13)
    assert np.allclose(omega, expected[1], rtol=1e-13, atol=1e-13)


def test_free_rotation_is_jefferys() -> None:
    k, gradient = 0.2, np.array([[0.3, 1.0, -0.4], [0.2, -0.5, 0.7], [0.1, 0.6, 0.2]])
    equations = RigidBodyEquations(exact_model(Spheroid(k)), PolynomialFlow(None, gradient), 0.0)
    y = random_state(equations)
    turn = rotation.matrix(y[0, 3:])
    expected = jeffery.free_angular_velocity(k, turn.T @ gradient @ turn)
    assert np.allclose(rotation.to_body(y[:, 3:], equations.velocities(0.0, y)[1]), expected)


@pytest.mark.parametrize("stokes_number", [0.0, 1.7])
@pytest.mark.parametrize("loads", [None, LOADS])
@pytest.mark.parametrize("degree", [1, 2, 3])
def test_block_is_its_bodies(degree: int, loads: Loads | None, stokes_number: float) -> None:
    model, flow = exact_model(Spheroid(0.4)), random_flow(degree, RNG)
    block = RigidBodyEquations(model, flow, stokes_number, 3, loads)
    single = RigidBodyEquations(model, flow, stokes_number, 1, loads)
    y = random_state(block)
    assert np.array_equal(rates(block, y), np.concatenate([rates(single, row[None]) for row in y]))
    each = np.concatenate([jacobian(single, row[None]) for row in y])
    # Rows and plain numbers round complex products differently, by the size of what cancels.
    assert np.abs(jacobian(block, y) - each).max() < 4.0 * np.finfo(float).eps * np.abs(each).max()


@pytest.mark.parametrize(("stokes_number", "degree"), [(0.0, 1), (2.0, 2)])
def test_compiled_is_plain(stokes_number: float, degree: int) -> None:
    n = 70  # more than a tile
    model, flow = exact_model(Spheroid(0.4)), random_flow(degree, RNG).shifted((1.0, -2.0, 0.5))
    equations = RigidBodyEquations(model, flow, stokes_number, n, evaluation="compiled")
    y = random_state(equations)
    columns = np.ascontiguousarray(y.T)
    columns.flags.writeable = False  # as PETSc hands it out
    out = np.empty_like(columns)
    equations.rate_function()(0.0, columns, out)
    assert np.array_equal(out.T, rates(equations, y))


@pytest.mark.parametrize("stokes_number", [0.0, 0.7])
@pytest.mark.parametrize("loads", [None, LOADS])
@pytest.mark.parametrize("degree", [1, 3])
def test_jacobian(degree: int, loads: Loads | None, stokes_number: float) -> None:
    equations = RigidBodyEquations(
        exact_model(Spheroid(2.5)), random_flow(degree, RNG), stokes_number, 2, loads
    )
    y = random_state(equations)
    exact, step = jacobian(equations, y), 1e-3
    for j in range(equations.n_state):
        e = np.eye(equations.n_state)[j]
        central = [
            (rates(equations, y + h * e) - rates(equations, y - h * e)) / (2.0 * h)
            for h in (step, 2.0 * step)
        ]
        differenced = (4.0 * central[0] - central[1]) / 3.0  # Richardson: error of order h^4
        assert np.allclose(exact[:, :, j], differenced, rtol=0, atol=1e-9 * abs(exact).max())


def test_jacobian_blocks_that_are_known() -> None:
    k, stokes_number = 0.5, 0.1
    gradient = np.array([[0.3, 1.0, -0.4], [0.2, -0.5, 0.7], [0.1, 0.6, 0.2]])
    model = exact_model(Spheroid(k))
    equations = RigidBodyEquations(model, PolynomialFlow(None, gradient), stokes_number)
    y = equations.initial_state((1.0, 2.0, 3.0), (1.0, 0.0, 0.0, 0.0))
    block = jacobian(equations, y)[0]
    r, spheroid = model.resistance, Spheroid(k)
    drag = np.array([r.translation_transverse] * 2 + [r.translation_axial])
    drag /= stokes_number * spheroid.volume
    assert np.allclose(block[7:10, 7:10], -np.diag(drag), rtol=1e-14)
    assert np.allclose(block[7:10, 0:3], drag[:, None] * gradient, rtol=1e-13)
    assert np.array_equal(block[0:3, 7:10], np.eye(3))
    w = y[0, 10:13]
    assert np.allclose(block[3, 10:13], 0.0)
    assert np.allclose(block[4:7, 10:13], 0.5 * np.eye(3))
    assert np.allclose(block[3, 4:7], -0.5 * w)
    spin = r.rotation_axial / (stokes_number * spheroid.inertia[2])
    assert np.isclose(block[12, 12], -spin)


@pytest.mark.parametrize("provider", [FaxenProvider, ForceProvider])
@pytest.mark.parametrize("stokes_number", [0.0, 0.7])
def test_provider_is_the_table(provider: type[FaxenProvider], stokes_number: float) -> None:
    k, flow = 0.4, random_flow(2, RNG)
    table = RigidBodyEquations(exact_model(Spheroid(k)), flow, stokes_number, 3, LOADS)
    other = RigidBodyEquations(exact_model(Spheroid(k)), provider(k, flow), stokes_number, 3, LOADS)
    y = random_state(table)
    assert np.allclose(rates(other, y), rates(table, y), rtol=1e-11, atol=1e-11)
    scale = abs(jacobian(table, y)).max()
    assert np.allclose(jacobian(other, y), jacobian(table, y), rtol=0, atol=1e-8 * scale)
    for one, two in zip(other.force_torque(0.0, y), table.force_torque(0.0, y), strict=True):
        assert np.allclose(one, two, rtol=1e-11, atol=1e-11)


def test_signs_of_force_and_torque() -> None:
    wind = RigidBodyEquations(exact_model(Spheroid(1.0)), PolynomialFlow([1.0, 0.0, 0.0]), 1.0)
    at_rest = wind.initial_state((0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), (0, 0, 0), (0, 0, 2.0))
    force, torque = wind.force_torque(0.0, at_rest)
    assert np.allclose(force, [[6.0 * np.pi, 0.0, 0.0]], rtol=1e-12)
    assert np.allclose(torque, [[0.0, 0.0, -16.0 * np.pi]], rtol=1e-12)


def test_settling_spheroid() -> None:
    k, force = 0.3, np.array([0.0, 0.0, -2.0])
    q = rotation.from_axis([1.0, 0.0, 1.0])
    still = PolynomialFlow()
    sinking = RigidBodyEquations(exact_model(Spheroid(k)), still, 0.0, loads=Loads(force=force))
    y = sinking.initial_state((0.0, 0.0, 0.0), q)
    v, omega = sinking.velocities(0.0, y)
    assert np.allclose(lamb.drag(k, rotation.to_body(q, v[0])), rotation.to_body(q, -force))
    assert np.allclose(omega, 0.0)
    assert np.allclose(sinking.force_torque(0.0, y)[0], -force)
    inertial = RigidBodyEquations(exact_model(Spheroid(k)), still, 3.0, loads=Loads(force=force))
    y = inertial.initial_state((0.0, 0.0, 0.0), q)
    assert np.allclose(y[:, 7:10], v)
    assert np.allclose(rates(inertial, y)[:, 7:], 0.0, atol=1e-14)


def test_torque_fixed_in_the_body() -> None:
    k, q = 3.0, rotation.random_quaternions(1, RNG)[0]
    loads = Loads(body_torque=lambda t: (0.0, 0.0, 5.0 * t))
    equations = RigidBodyEquations(exact_model(Spheroid(k)), PolynomialFlow(), 0.0, loads=loads)
    y = equations.initial_state((0.0, 0.0, 0.0), q)
    omega = equations.velocities(2.0, y)[1][0]
    assert np.allclose(omega, 10.0 / jeffery.rotation_resistance(k)[1] * rotation.axis(q))


@pytest.mark.parametrize("stokes_number", [0.0, 2.0])
def test_held_in_a_paraboloid(stokes_number: float) -> None:
    k, curvature, eta, alpha = 0.4, 0.7, 1.3, 0.6
    hessian = np.zeros((3, 3, 3))
    hessian[0, 1, 1] = hessian[0, 2, 2] = 2.0 * curvature
    held = Constraints.held()
    equations = RigidBodyEquations(
        exact_model(Spheroid(k)), PolynomialFlow(hessian=hessian), stokes_number, constraints=held
    )
    axis = (np.cos(alpha), -np.sin(alpha), 0.0)
    q = rotation.from_euler(np.arctan2(axis[0], -axis[1]), np.pi / 2, 0.0)
    y = equations.initial_state((0.0, eta, 0.0), q)
    assert np.array_equal(rates(equations, y), np.zeros_like(y))
    force, torque = equations.force_torque(0.0, y)
    d1 = rotation.matrix(q)[:, 0]
    body = rotation.to_body(q, force[0]), rotation.to_body(q, torque[0])
    across, along = chwang.fixed_force(k, curvature, eta, axis[0], d1[0])
    assert np.allclose(body[0], [across, 0.0, along])
    assert np.allclose(body[1], [0.0, chwang.fixed_torque(k, curvature, eta, axis[0]), 0.0])


@pytest.mark.parametrize("stokes_number", [0.0, 2.0])
def test_one_motion_prescribed_leaves_the_other_free(stokes_number: float) -> None:
    model, flow = exact_model(Spheroid(0.4)), random_flow(2, RNG)
    free = RigidBodyEquations(model, flow, stokes_number)
    y = random_state(free)
    towed = RigidBodyEquations(
        model, flow, stokes_number, constraints=Constraints(velocity=lambda t: (t, 1.0, 0.0))
    )
    turned = RigidBodyEquations(
        model, flow, stokes_number, constraints=Constraints(angular_velocity=(0.0, 0.0, 2.0))
    )
    assert np.allclose(rates(towed, y)[0, :3], [0.0, 1.0, 0.0])
    assert np.allclose(rates(towed, y)[0, 3:7], rates(free, y)[0, 3:7])
    assert np.allclose(towed.velocities(3.0, y)[0], [[3.0, 1.0, 0.0]])
    q = y[0, 3:7]
    slope = 0.5 * rotation.multiply([0.0, 0.0, 0.0, 2.0], q)
    assert np.allclose(rates(turned, y)[0, 3:7], slope)
    assert np.allclose(rates(turned, y)[0, :3], rates(free, y)[0, :3])
    assert np.allclose(jacobian(turned, y)[0, :3], jacobian(free, y)[0, :3])


def test_length_of_the_quaternion_does_not_matter() -> None:
    equations = RigidBodyEquations(exact_model(Spheroid(0.4)), random_flow(3, RNG), 1.0, 4, LOADS)
    y = random_state(equations)
    longer = y.copy()
    longer[:, 3:7] *= 1.7
    expected = rates(equations, y)
    expected[:, 3:7] *= 1.7
    assert np.allclose(rates(equations, longer), expected, rtol=1e-13, atol=1e-13)


def test_stokes_numbers_do_not_mix() -> None:
    with pytest.raises(ValueError, match="all zero or all positive"):
        RigidBodyEquations(exact_model(Spheroid(0.5)), PolynomialFlow(), [0.0, 1.0], 2)


def test_relaxation_rates() -> None:
    equations = RigidBodyEquations(exact_model(Spheroid(1.0)), PolynomialFlow(), [0.1, 1.0], 2)
    # A sphere: 6 pi/(4 pi/3) = 9/2 and 8 pi/(8 pi/15) = 15 over St.
    assert np.allclose(equations.relaxation_rates[:, 1], [4.5, 4.5, 15.0, 15.0])
    assert np.allclose(equations.stiffness, [150.0, 15.0])


def test_orbit_constant_and_phase() -> None:
    k, start = 0.3, np.array([0.3, 0.4, np.sqrt(0.75)])
    period = jeffery.period(k)
    times = np.linspace(0.0, 3.0 * period, 100)
    axes = jeffery.axis_at(times, k, start)
    constant = diagnostics.orbit_constant(axes, k)
    assert np.allclose(constant, constant[0], rtol=1e-12)
    found, residual = phase_period(times, axes, k)
    assert np.isclose(found, period, rtol=1e-12)
    assert residual < 1e-11
    frame = rotation.matrix(rotation.random_quaternions(1, RNG)[0])
    turned = axes @ frame  # components in space of the shear that `frame` describes
    assert np.allclose(diagnostics.orbit_constant(turned, k, frame), constant)


def test_orbit_constant_of_log_rolling_and_tumbling() -> None:
    axes = [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]
    assert np.array_equal(diagnostics.orbit_constant(axes, 2.0), [0.0, np.inf])
