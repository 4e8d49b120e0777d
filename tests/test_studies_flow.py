"""The studies of motion in cases/studies, in their small form, and the averages they take."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from conftest import ROOT, script

import qbxstokes as qs
from qbxstokes.geometry import rotation

heavy = script("studies/heavy")
Run = Callable[..., dict[str, float]]


# -- the scripts, and the numbers that their texts promise ---------------------------------------


def test_motions_are_those_of_jeffery_chwang_and_scipy(run_study: Run) -> None:
    found = run_study("validation")
    assert len(found) == 10
    assert max(found.values()) < 1e-9


def test_rates_and_transition_are_those_of_the_periodic_solution(run_study: Run) -> None:
    found = run_study("rotation_rate")
    assert found["largest difference of a rate"] < 2e-7
    assert found["smallest lag of the transition"] == pytest.approx(1.02768, abs=1e-5)
    assert found["largest lag of the transition"] == pytest.approx(1.05417, abs=1e-5)


def test_drift_of_orbits_is_the_exact_exponent(run_study: Run) -> None:
    found = run_study("orbit_drift")
    assert found["runs near the limits"] == 8
    assert found["median difference from the exact exponents"] < 3e-6
    assert found["largest difference"] < 0.02


def test_sample_run_moves_to_higher_shear() -> None:
    case = ROOT / "cases" / "sample_run.yaml"
    axes = {"body.stokes_number": [10], "time.end": [60]}
    (end,) = qs.sweep(case, axes).table["final_position_2"]
    assert end - 3.0 == pytest.approx(0.0390, abs=1e-4)


def test_suspensions_are_those_of_the_literature(run_study: Run) -> None:
    found = run_study("rheology")
    assert found["largest difference from Scheraga's digits"] == 0.0
    assert found["Simha's formula at 25:1, relative"] < 0.01
    assert found["sphere"] < 1e-12
    assert found["table of Mehl et al., largest"] < 2e-3
    assert found["rod of 50:1, large Pe"] < 0.015
    assert found["disc of 1:50, large Pe"] < 3e-3
    assert max(found["rod, least"], found["disc, least"]) < 5e-4
    assert found["dumbbell, Psi_1 at rest"] < 1e-6
    assert max(found["[eta], second order"], found["Psi_1, second order"]) < 1e-3
    assert found["Psi_1 (rate lambda)^(4/3)"] < 5e-3
    assert max(found[f"rod of 50:1, {factor}"] for factor in "AB") < 0.01
    assert max(value for name, value in found.items() if name.startswith("near a sphere")) < 5e-4
    assert found["smallest N1"] > 0.0
    assert found["largest N2"] < 0.0


def test_bodies_accelerate_in_their_relaxation_time(run_study: Run) -> None:
    found = run_study("acceleration")
    assert found["largest error of T, rolling"] < 1e-7
    assert (found["fits"], found["fits that count"]) == (12, 10)


def test_lateral_drift_is_that_of_the_periodic_solution(run_study: Run) -> None:
    found = run_study("lateral_drift")
    assert found["largest difference from the periodic solution"] < 1e-4
    assert found["largest drift of a sphere"] < 1e-11
    assert found["largest drift with inertia of the rotation alone"] < 1e-11
    assert found["maximum of k = 0.5"] == pytest.approx(1.876e-3, rel=1e-3)


def test_lateral_drift_depends_on_the_local_shear_rate(run_study: Run) -> None:
    found = run_study("lateral_drift_places", "lateral_drift_places", "local_orbit_drift")
    assert found["orbit drift from 8 lengths on"] == pytest.approx(3.4e-4, rel=0.03)
    assert found["from shear of the local rate"] < 4e-4
    assert found["largest difference, from four lengths on"] < 1e-3
    assert found["largest difference on orbits"] < 1e-3
    assert found["largest velocity along the vorticity"] < 1e-8


# -- their averages -------------------------------------------------------------------------------


def test_orientation_in_the_plane_of_shear_is_exact() -> None:
    axis = np.stack([np.cos([0.3, 2.0]), np.sin([0.3, 2.0]), [0.0, 0.0]], axis=-1)
    q = script("studies/motions").axes(axis)
    assert np.allclose(rotation.axis(q), axis, atol=1e-15)
    assert np.array_equal(q[:, 0], q[:, 1])
    assert np.array_equal(q[:, 2], q[:, 3])


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (1.43984e-5, 3.2e-8, "1.440(4)e-5"),
        (-2.58e-2, 1.2e-3, "-2.6(2)e-2"),
        (9.97e-3, 9.96e-5, "1.00(1)e-2"),
        (1.2345678912e-4, 1e-20, "1.2345679(1)e-4"),
        (0.0, 0.0, "0"),
    ],
)
def test_one_digit_of_the_uncertainty_is_shown(value: float, error: float, text: str) -> None:
    assert script("studies/motions").shown(value, error) == text


def test_measured_rates_are_those_of_the_theory_within_the_uncertainty() -> None:
    k, stokes, motions = 2.0, [1.0, 2.0], script("studies/motions")
    bodies, tumbling = motions.body(k, stokes), motions.orbit(k, math.inf)
    found = motions.averages(bodies, motions.paraboloid(32.0), tumbling, 4, (0.0, 32.0, 0.0))
    rates = [heavy.tumbling(k, st).rate for st in stokes]
    drifts = [heavy.drift(k, st) / 64.0 for st in stokes]
    velocity, error = (values[:, 1] for values in found["velocity"])
    assert np.allclose(found["rotation_rate"][0], rates, rtol=1e-3)
    assert np.allclose(velocity, drifts, rtol=2e-3)
    assert (found["position"][0][:, 1] > 32.0).all()
    assert (found["half_turns"][0] >= 4).all()
    assert (error < 1e-2 * velocity).all()


@pytest.mark.parametrize(("k", "inertia"), [(1.0, "both"), (0.5, "rotation")])
def test_no_drift_of_spheres_and_without_inertia_of_translation(k: float, inertia: str) -> None:
    motions = script("studies/motions")
    bodies, flow = motions.body(k, [5.0], inertia), motions.paraboloid(4.0)
    found = motions.averages(bodies, flow, motions.orbit(k, 1.0), 2, (0.0, 4.0, 0.0))
    assert np.abs(found["velocity"][0][:, 1]).max() < 1e-12


def test_drift_near_the_axis_is_that_of_the_local_shear_rate() -> None:
    """One length off the axis the body gains a fifth of its shear rate while it is watched."""
    found = script("studies/common").Table("found", "")
    script("studies/lateral_drift").run(2.0, [10.0], "both", 1.0, found)
    (row,) = found.rows
    assert row["local_rate"] > 1.1
    at_start = heavy.drift(2.0, 10.0)
    assert row["drift"] == pytest.approx(row["theory"], rel=0.02)
    assert abs(row["drift"] / at_start - 1.0) > 0.05


@pytest.mark.parametrize(("k", "lag"), [(0.2, 1.0), (0.5, 10.0), (2.0, 0.5)])
def test_measured_orbit_drift_is_the_exact_exponent(k: float, lag: float) -> None:
    found = script("studies/common").Table("found", "")
    script("studies/orbit_drift").run(k, [lag * heavy.relaxation_rates(k)[2]], found)
    assert {row["orbit"] for row in found.rows} >= {"rolling"}
    for row in found.rows:
        if row["orbit"] != "C = 1":
            assert row["rate"] == pytest.approx(row["theory"], rel=2e-3)


def test_heavy_flat_bodies_are_not_followed_near_rolling() -> None:
    found = script("studies/common").Table("found", "")
    script("studies/orbit_drift").run(5.0, [10.0 * heavy.relaxation_rates(5.0)[2]], found)
    assert all(row["orbit"] != "rolling" for row in found.rows)


def test_scripts_are_listed_and_say_how_to_run_them() -> None:
    page = (ROOT / "cases" / "README.md").read_text()
    for path in (ROOT / "cases" / "studies").glob("[!q]*.py"):
        if path.stem not in ("common", "heavy", "motions"):
            assert f"(studies/{path.name})" in page
            assert f"Run:      python cases/studies/{path.name}" in path.read_text()
