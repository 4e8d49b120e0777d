"""The stress that a moving body adds: recorded quantities, inertial parts, dissipation."""

from __future__ import annotations

import json
import time
from pathlib import Path

import numpy as np
import pytest
import spheroid_stress

import qbxstokes as qs
from qbxstokes.geometry.symmetric import components
from qbxstokes.motion.averages import mean_of
from qbxstokes.reference import stress

SHEAR = qs.flow("shear")
STRAIN = 0.5 * np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])


def test_a_free_body_along_its_motion() -> None:
    body = qs.Body(0.4)
    motion = body.integrate(SHEAR, np.linspace(0.0, 9.0, 10), orientation=[1, 1, 1])
    numbers = stress.stresslet_numbers(0.4)
    exact = np.array([spheroid_stress.tensor(numbers, axis, STRAIN) for axis in motion.axis])
    assert np.abs(motion.stresslet - exact).max() < 1e-12 * np.abs(exact).max()
    np.testing.assert_allclose(motion.particle_stress, exact / body.shape.volume, atol=1e-12)
    assert not motion.acceleration_stress.any()
    assert motion.between(2.0, 5.0).stresslet.shape == (4, 3, 3)


@pytest.mark.parametrize(("k", "stokes"), [(0.5, 10.0), (0.2, 5.0)])
def test_inertial_means(k: float, stokes: float) -> None:
    """Acceleration and Reynolds terms cancel in Sigma_12 and N2 to 1e-9 over a period; dissipation.

    S:E + T.(w/2 - Omega), what the fluid around the body dissipates besides, is never negative, and
    its mean is <S>:E.
    """
    body = qs.Body(k, stokes_number=stokes)
    scene = qs.Simulation(body, SHEAR, orientation=[1.0, 0.2, 0.0], tolerance=1e-11)
    turns = scene.integrate([0.0, 300.0]).events["half_turns"]["time"]
    times = np.concatenate([[0.0], np.linspace(turns[-3], turns[-1], 1001)])
    motion = scene.integrate(times)

    def mean(values: np.ndarray) -> np.ndarray:
        return values[1:-1].mean(axis=0)

    inertial = mean(motion.acceleration_stress + motion.reynolds_stress)
    assert abs(inertial[0, 1]) < 1e-9
    assert abs(inertial[1, 1] - inertial[2, 2]) < 1e-9
    assert np.abs(mean(motion.acceleration_stress)).max() > 0.05
    whole = motion.stresslet / body.shape.volume
    whole = whole + motion.acceleration_stress + motion.reynolds_stress
    np.testing.assert_allclose(motion.particle_stress, whole, atol=1e-12)
    power = np.einsum("tij,ij->t", motion.stresslet, STRAIN)
    slip = np.array([0.0, 0.0, -0.5]) - motion.angular_velocity
    power = power + np.einsum("ti,ti->t", motion.torque, slip)
    assert power.min() > 0.0
    assert mean(power) == pytest.approx(np.sum(mean(motion.stresslet) * STRAIN), rel=1e-9)


def test_recorded_in_files_and_sweeps() -> None:
    case = {
        "body": {"aspect_ratio": 0.4, "stokes_number": 2.0},
        "flow": {"type": "shear"},
        "start": {"orientation": {"axis": [1, 1, 1]}},
        "time": {"end": 5.0, "samples": 6},
        "output": {"fields": ["axis", "stresslet", "particle_stress", "reynolds_stress"]},
    }
    result = qs.run(case)
    body = qs.Body(0.4, stokes_number=2.0)
    motion = body.integrate(SHEAR, np.linspace(0, 5, 6), orientation=[1, 1, 1])
    np.testing.assert_allclose(result.stresslet, components(motion.stresslet), atol=1e-9)
    np.testing.assert_allclose(
        result.particle_stress, components(motion.particle_stress), atol=1e-9
    )
    assert "acceleration_stress" not in result.names
    swept = qs.sweep(case, {"body.stokes_number": [1.0, 2.0]})
    assert swept.stresslet.shape == (2, 6, 6)
    np.testing.assert_allclose(swept.stresslet[1], result.stresslet, atol=1e-8)
    assert "stresslet" not in qs.run({**case, "output": {}}).names


def test_recorded_stresses_are_drawn() -> None:
    """Normal components in one panel, the others in the next; of a motion in Python, too."""
    fields = ["axis", "particle_stress"]
    case = {"body": {"aspect_ratio": 0.5}, "flow": {"type": "shear"}, "output": {"fields": fields}}
    times = np.linspace(0.0, 9.0, 31)
    result = qs.run({**case, "start": {"orientation": {"axis": [1, 0, 1]}}, "time": {"at": times}})
    motion = qs.Body(0.5).integrate(qs.flow("shear"), times, orientation=[1, 0, 1])
    assert "stress" in result.kinds
    for drawn, picture in ((result, "stress"), (motion, "particle_stress")):
        lines = [axes.get_lines() for axes in drawn.plot(picture).axes]
        assert [[line.get_label() for line in panel] for panel in lines] == [
            [rf"$\Sigma_{{{pair}}}$" for pair in pairs]
            for pairs in (("11", "22", "33"), ("12", "13", "23"))
        ]
        shear = lines[1][0].get_ydata()
        np.testing.assert_allclose(shear, motion.particle_stress[:, 0, 1], atol=1e-9)


def test_means_over_turns_and_axes() -> None:
    """Each orbit's mean to 1e-8, whatever part of a turn is left over; that of all orbits."""
    body, axes = qs.Body(0.4), [[1.0, 1.0, 1.0], [1.0, 0.2, 0.0]]
    scene = qs.Simulation(body, SHEAR, orientation=axes)
    motion = scene.integrate(np.linspace(0.0, 2.6 * scene.period, 801))
    found = motion.mean("particle_stress")
    for each, axis in zip(found.each, axes, strict=True):
        exact = qs.rheology(body, SHEAR, np.inf, orientations=axis).particle_stress
        assert np.abs(each - exact).max() < 1e-8
        assert np.abs(each - exact).max() < 3.0 * found.sampling_error * np.abs(exact).max()
    assert np.array_equal(found.mean, found.each.mean(axis=0))
    half = np.abs(found.each[0] - found.each[1]) / 2.0
    np.testing.assert_allclose(found.standard_error, half, rtol=1e-12)
    with pytest.raises(qs.errors.QbxStokesError, match="viscosity"):
        motion.mean("viscosity")


def test_means_of_sweeps(tmp_path: Path) -> None:
    """Over trajectories from isotropic axes: the mean of all orbits, within its error."""
    case = {
        "body": {"aspect_ratio": 0.4},
        "flow": {"type": "shear"},
        "time": {"end": 40.0, "samples": 301},
        "output": {"fields": ["axis", "particle_stress"]},
        "sweep": {"axes": [{"start.orientation": {"random": "axes", "count": 100, "seed": 1}}]},
    }
    path = tmp_path / "case.yaml"
    path.write_text(json.dumps(case))
    result = qs.run(path)
    found = result.mean("particle_stress")
    exact = qs.rheology(qs.Body(0.4), SHEAR, np.inf).particle_stress
    assert abs(found.mean[3] - exact[0, 1]) < 3.0 * found.standard_error[3]
    assert found.standard_error[3] < 0.02 * exact[0, 1]
    with pytest.raises(AttributeError):
        result.mean("stresslet")


def test_a_motion_that_ends_has_the_mean_of_what_it_had() -> None:
    times = np.linspace(0.0, 1.0, 11)
    values = np.stack([times, np.where(times < 0.55, times, np.nan), np.full(11, np.nan)], axis=1)
    found = mean_of(times, values, np.full(3, np.nan))
    np.testing.assert_allclose(found.each, [0.5, 0.25, np.nan], atol=1e-15)
    assert found.mean == pytest.approx(0.375)


def test_any_flow() -> None:
    """By the functional on a grid, in a flow that is no polynomial."""
    flow = SHEAR + 0.3 * qs.flow("stokeslet", strength=[1, 0, 0], position=[0, 0, 5])
    motion = qs.Body(0.5).integrate(flow, [0.0, 1.0, 2.0], orientation=[1, 0, 1])
    for x, q, found in zip(motion.position, motion.orientation, motion.stresslet, strict=True):
        exact = spheroid_stress.stresslet(0.5, qs_matrix(q), x, flow.velocity)
        assert np.abs(found - exact).max() < 1e-10 * np.abs(exact).max()


def qs_matrix(q: np.ndarray) -> np.ndarray:
    """Rotation (3, 3) of a quaternion."""
    from qbxstokes.geometry import rotation

    return rotation.matrix(q[None])[0]


def test_recording_costs_little() -> None:
    """At most a fifth of the right-hand sides, at the default density of samples."""
    body, axes = qs.Body(0.5), np.random.default_rng(0).standard_normal((64, 3))
    assert body.stress.error_estimate < 1e-10
    scene = qs.Simulation(body, SHEAR, orientation=axes)
    motion = scene.integrate(np.linspace(0.0, 3 * scene.period, 201))
    assembled = motion._assembled

    def spent(action: object) -> float:
        assert callable(action)
        begin = time.process_time()
        action()
        return time.process_time() - begin

    without = min(
        spent(lambda: assembled.observe(motion.time, motion._states, ())) for _ in range(5)
    )
    with_stress = min(
        spent(lambda: assembled.observe(motion.time, motion._states, ("stresslet",)))
        for _ in range(5)
    )
    rates = min(spent(lambda: assembled.trajectory(motion.time)) for _ in range(3))
    assert with_stress - without < 0.2 * rates
