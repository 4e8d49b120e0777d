"""Theory of heavy bodies in shear and in weak curvature; inertia of one part switched off."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from conftest import script

from qbxstokes.flows import build_flow
from qbxstokes.geometry import rotation
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.motion.equations import Inertia, RigidBodyEquations
from qbxstokes.reference import lamb
from qbxstokes.reference.inertial import inertia as moments_of_inertia
from qbxstokes.reference.inertial import volume
from qbxstokes.simulation.hydrodynamics import exact_model

Array = Any
heavy = script("studies/heavy")


def paraboloid() -> Any:
    return build_flow({"type": "paraboloid", "curvature": 0.25}).polynomial


# -- theory ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("k", [0.2, 0.5, 2.0, 5.0])
def test_mean_rate_has_both_limits(k: float) -> None:
    free = k / (1.0 + k * k)
    scale = heavy.relaxation_rates(k)[2]
    light = [heavy.tumbling(k, lag * scale).rate / free - 1.0 for lag in (0.005, 0.01)]
    assert light[1] / light[0] == pytest.approx(4.0, rel=0.02)  # no correction of first order
    heavy_lag = 200.0
    short = 0.5 - heavy.tumbling(k, heavy_lag * scale).rate
    assert short * heavy_lag**2 == pytest.approx(0.25 * heavy.shape(k) ** 2, rel=1e-3)


@pytest.mark.parametrize("k", [0.1, 0.5, 2.0, 10.0])
def test_closed_forms_are_the_limits_of_light_and_of_heavy_bodies(k: float) -> None:
    rates = heavy.relaxation_rates(k)
    lag = 1e-3 * min(k, 1.0 / k)
    gain = heavy.tumbling(k, lag * rates[2]).rate * (k + 1.0 / k) - 1.0
    assert gain / lag**2 == pytest.approx(heavy.light_rate_coefficient(k), rel=1e-4)
    stokes = 1e4 * rates[0]
    assert stokes * heavy.drift(k, stokes) == pytest.approx(
        heavy.large_stokes_drift(k), rel=1e-6
    )  # fmt: skip


def test_rate_depends_on_shape_through_the_square_of_lambda_and_on_st_through_the_lag() -> None:
    for lag in (0.3, 1.0, 30.0, 3e3):  # the last one beyond the precision of a plain Newton step
        rates = [heavy.tumbling(k, lag * heavy.relaxation_rates(k)[2]).rate for k in (0.2, 5.0)]
        assert rates[0] == pytest.approx(rates[1], rel=1e-9)


def test_thin_lanes_turn_above_the_threshold_of_the_pendulum() -> None:
    """t'' + t' / lag = (cos t - 1)/lag turns over for lag > 0.70256: shooting along t = -2a."""
    from scipy.integrate import solve_ivp

    def gone(lag: float) -> float:
        """Angle reached from rest along the stream, in half-turns."""
        event = lambda x, p: p[0] - 1e-7  # noqa: E731
        event.terminal = True  # type: ignore[attr-defined]
        start = 0.01
        run = solve_ivp(
            lambda x, p: [(np.sin(x) ** 2 - p[0]) / (lag * p[0])],
            (start, np.pi), [start**2 * (1.0 - 2.0 * lag * start)],
            method="LSODA", rtol=1e-10, atol=1e-14, events=event,
        )  # fmt: skip
        return float(run.t[-1] / np.pi)

    assert gone(0.702) < 1.0
    assert gone(0.703) == 1.0
    k = 0.05
    below, above = (
        heavy.tumbling(k, lag * heavy.relaxation_rates(k)[2]).rate for lag in (0.5, 0.9)
    )
    assert below < 1.1 * k / (1.0 + k * k)
    assert above > 4.0 * below


@pytest.mark.parametrize("k", [0.2, 0.5, 2.0, 5.0])
def test_small_stokes_numbers_drift_by_the_averaged_rate(k: float) -> None:
    stokes = 1e-3 * heavy.relaxation_rates(k)[2]
    rolling = heavy.rolling_drift_coefficient(k)
    assert heavy.orbit_drift_coefficient(k, 1e-3) == pytest.approx(rolling, rel=1e-4)
    assert heavy.rolling_mode(k, stokes).real / stokes == pytest.approx(rolling, rel=1e-3)
    tumbling = heavy.orbit_drift_coefficient(k, np.inf)
    assert heavy.orbit_drift_coefficient(k, 1e4) == pytest.approx(tumbling, rel=1e-4)
    assert -heavy.tumbling_exponent(k, stokes) / stokes == pytest.approx(tumbling, rel=1e-3)
    assert np.sign(rolling) == np.sign(tumbling) == np.sign(1.0 - k)


@pytest.mark.parametrize(("k", "lag"), [(0.1, 0.03), (0.5, 3.0), (5.0, 0.5)])
def test_exponent_of_tumbling_is_that_of_stepwise_integration(k: float, lag: float) -> None:
    """The same linear system for (z, z', s), in time beside the angle a' = -p(a), by DOP853."""
    from scipy.integrate import solve_ivp

    stokes = lag * heavy.relaxation_rates(k)[2]
    orbit = heavy.tumbling(k, stokes)
    across, along = (rate / stokes for rate in heavy.relaxation_rates(k)[2:])
    ratio = moments_of_inertia(k)[2] / moments_of_inertia(k)[0]
    waves = np.fft.rfft(orbit.speed) / orbit.angle.size
    waves[1:] *= 2.0
    harmonics = np.arange(waves.size)

    def rate(_: float, y: Array) -> Array:
        a, z, dz, s = y[0], *y[1:].reshape(3, 3)
        p = float(np.sum((waves * np.exp(2j * harmonics * a)).real))
        pull = heavy.shape(k) * np.sin(a) * np.cos(a)
        ddz = -p * p * z - across * (pull * z + dz) - ratio * s * p
        return np.concatenate([[-p], dz, ddz, -along * (0.5 * z + s)])

    start = np.concatenate([[np.pi], np.eye(3).ravel()])
    run = solve_ivp(rate, (0.0, orbit.half_turn), start, "DOP853", rtol=1e-12, atol=1e-14)
    assert run.y[0, -1] == pytest.approx(0.0, abs=1e-7)  # what the nodes of the orbit hold
    multipliers = np.linalg.eigvals(run.y[1:, -1].reshape(3, 3))
    growth = float(np.log(np.max(np.abs(multipliers))))
    exponent = heavy.tumbling_exponent(k, stokes)
    assert exponent * orbit.half_turn == pytest.approx(growth, abs=1e-9)


def test_tilt_of_a_heavy_flat_body_decays_without_turning() -> None:
    rate = heavy.relaxation_rates(5.0)[2]
    light, late = (heavy.rolling_mode(5.0, lag * rate) for lag in (0.01, 10.0))
    assert light.imag == pytest.approx(5.0 / 26.0, rel=1e-2)
    assert late.imag == 0.0


@pytest.mark.parametrize("k", [0.2, 0.5, 2.0, 5.0])
def test_lateral_drift_goes_to_higher_shear_and_dies_out(k: float) -> None:
    small = heavy.small_stokes_drift(k)
    assert small > 0.0
    theta, (across, along) = volume(k), lamb.translation_resistance(k)
    exact = theta * (1.0 / along - 1.0 / across) * (1.0 - k * k) * k / (12.0 * (1.0 + k * k))
    for profile in ("paraboloid", "plane"):
        assert heavy.small_stokes_drift(k, np.inf, profile) == pytest.approx(exact, rel=1e-10)
    stokes = 1e-3 * heavy.relaxation_rates(k)[1]
    for parts in ("both", "translation"):
        assert heavy.drift(k, stokes, parts) / stokes == pytest.approx(small, rel=1e-4)  # type: ignore[arg-type]
    far = 1e4 * heavy.relaxation_rates(k)[0]
    assert heavy.drift(k, 10.0 * far) / heavy.drift(k, far) == pytest.approx(0.1, rel=1e-3)


@pytest.mark.parametrize("stokes_number", [0.3, 30.0])
def test_sphere_does_not_drift(stokes_number: float) -> None:
    assert abs(heavy.drift(1.0, stokes_number)) < 1e-15
    assert heavy.tumbling(1.0, stokes_number).rate == pytest.approx(0.5, rel=1e-13)


# -- inertia of one part --------------------------------------------------------------------------


@pytest.mark.parametrize("inertia", ["translation", "rotation"])
def test_part_without_inertia_follows_the_flow(inertia: Inertia) -> None:
    n, rng = 9, np.random.default_rng(3)
    x, q = rng.normal(size=(n, 3)), rotation.random_quaternions(n, rng)
    equations = RigidBodyEquations(
        exact_model(Spheroid(0.4)), paraboloid(), 2.0, n, inertia=inertia
    )
    y = equations.initial_state(x, q, rng.normal(size=3), rng.normal(size=3))
    v, omega = equations.velocities(0.0, y)
    free = RigidBodyEquations(exact_model(Spheroid(0.4)), paraboloid(), 0.0, n)
    u, spin = free.velocities(0.0, free.initial_state(x, q))
    followed = (omega, spin) if inertia == "translation" else (v, u)
    kept = (v, u) if inertia == "translation" else (omega, spin)
    assert np.allclose(*followed, rtol=0.0, atol=1e-14)
    assert np.abs(kept[0] - kept[1]).max() > 0.1
    columns = np.ascontiguousarray(y.T)
    rate = np.empty_like(columns)
    equations.rates(0.0, columns, rate)
    assert np.array_equal(rate[:3].T, v)
    rest = rate[10:13] if inertia == "translation" else rate[7:10]
    assert not rest.any()


@pytest.mark.parametrize("inertia", ["translation", "rotation"])
def test_its_jacobian_is_exact_and_compiled_is_plain(inertia: Inertia) -> None:
    n, rng = 3, np.random.default_rng(4)
    x, q = rng.normal(size=(n, 3)), rotation.random_quaternions(n, rng)
    plain, fast = (
        RigidBodyEquations(
            exact_model(Spheroid(2.5)), paraboloid(), 0.7, n, evaluation=evaluation, inertia=inertia
        )
        for evaluation in ("plain", "compiled")
    )
    y = np.ascontiguousarray(plain.initial_state(x, q, x, x).T)
    slopes, compiled = np.empty((n, 13, 13)), np.empty((n, 13, 13))
    plain.jacobian_function()(0.0, y, slopes)
    fast.jacobian_function()(0.0, y, compiled)
    assert np.allclose(slopes, compiled, rtol=1e-13, atol=1e-13)
    step = 1e-6
    for j in range(13):
        sides = []
        for sign in (1.0, -1.0):
            moved, rate = y.copy(), np.empty_like(y)
            moved[j] += sign * step
            plain.rates(0.0, moved, rate)
            sides.append(rate)
        difference = (sides[0] - sides[1]) / (2.0 * step)
        assert np.allclose(slopes[:, :, j], difference.T, rtol=1e-6, atol=1e-7)
