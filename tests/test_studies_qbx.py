"""The studies of the quadrature, `cases/studies/qbx_*.py`, in their small form."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

CASES = Path(__file__).resolve().parents[1] / "cases"

Run = Callable[..., dict[str, float]]


def test_no_orientation_is_special(run_study: Run) -> None:
    found = run_study("qbx_orientations")
    assert found["largest error, uniform"] == pytest.approx(2.65e-4, rel=0.01)
    assert found["largest error, graded 1e-6"] == pytest.approx(4.7e-11, rel=0.05)
    assert found["largest error, graded 1e-10"] < 5e-15


def test_four_nodes_hold_the_density_of_a_polynomial_flow(run_study: Run) -> None:
    found = run_study("qbx_density_nodes")
    assert found["graded, fewest nodes, motion"] < 2e-12
    assert found["graded, fewest nodes, density"] == pytest.approx(1.72e-4, rel=0.01)
    assert found["graded, most nodes, density"] == pytest.approx(8.5e-6, rel=0.01)
    assert found["uniform, most nodes, density"] == pytest.approx(1.62e-3, rel=0.01)


def test_largest_radius_is_best_and_upsampling_lowers_the_valley(run_study: Run) -> None:
    found = run_study("qbx_truncation", "qbx_valley", "qbx_map")
    for kappa, order, error in ((4, 4, 4.38e-2), (8, 9, 6.65e-3)):
        assert found[f"kappa {kappa}, least error"] == pytest.approx(error, rel=0.01)
        assert found[f"kappa {kappa}, its p"] == order
        assert found[f"kappa {kappa}, its part of the largest r/h"] == pytest.approx(1.0, abs=1e-3)


def test_graded_parameters_serve_every_aspect_ratio(run_study: Run) -> None:
    found = run_study("qbx_aspect_ratios", "qbx_aspect_ratios", "qbx_recommended")
    assert found["largest error, graded"] < 1e-11
    # At k = 1/5 both are rounding, which differs from machine to machine: 1.2e-14 and less.
    assert found["largest error over its estimate, graded"] < 3.0
    assert found["largest error, uniform"] == pytest.approx(0.51, rel=0.01)
    for name, low, high in (("n_theta", 6, 6), ("expansion_order", 8, 8),
                            ("radius_factor", 0.3, 0.3), ("panel_order", 7, 12)):  # fmt: skip
        assert (found[f"smallest {name}"], found[f"largest {name}"]) == (low, high)
    assert found["largest error over tolerance"] == pytest.approx(7.01e-3, rel=0.01)
    assert found["uniform schemes found"] == 1
    assert found["least work of a uniform scheme"] == 64 * 8 * 4 * 8 * 21


def test_scripts_are_listed_and_say_how_to_run_them() -> None:
    page = (CASES / "README.md").read_text()
    scripts = sorted((CASES / "studies").glob("qbx_*.py"))
    assert len(scripts) == 4
    for script in scripts:
        assert f"(studies/{script.name})" in page
        assert f"Run:      python cases/studies/{script.name}" in script.read_text()
