"""Pictures of many trajectories: averages with bands, histograms, axes on the sphere."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from qbxstokes.errors import CaseError
from qbxstokes.geometry import rotation
from qbxstokes.plots import sphere, style, sweep

Array = np.ndarray
RNG = np.random.default_rng(4)
K = np.array([0.2, 0.5, 0.8])
N = 40


class Swept:
    """A sweep in memory: three bodies from the same random starts."""

    def __init__(self) -> None:
        starts = rotation.random_axes(N, RNG)
        columns: dict[str, Array] = {
            "aspect_ratio": np.repeat(K, N),
            **{f"start_orientation_{i + 1}": np.tile(starts[:, i], 3) for i in range(3)},
            "period": np.repeat(10.0 * K, N) + RNG.normal(size=3 * N),
            "orbit_drift": np.exp(3.0 * RNG.normal(size=3 * N)),
        }
        turned = rotation.random_quaternions(3 * N, RNG)
        columns |= {f"final_orientation_{i}": turned[:, i] for i in range(4)}
        kinds = [(name, "f8") for name in columns] + [("status", "i1")]
        table = np.zeros(3 * N, dtype=kinds)
        for name, values in columns.items():
            table[name] = values
        table["status"] = 1
        self.path, self.task, self.columns = Path("sweep.h5"), "sweep", columns
        self.arrays: dict[str, Any] = {"table": table}
        self.attributes: dict[str, dict[str, Any]] = {"table": {}}
        self.groups: dict[str, Any] = {}
        self.summary: dict[str, Any] = {}
        self.provenance: dict[str, Any] = {}
        self.coordinates, self.shape = ["aspect_ratio", *list(columns)[1:4]], (3, N)


@pytest.fixture(scope="module")
def swept() -> Swept:
    return Swept()


def drawn(swept: Swept, **roles: Any) -> Any:
    with style.styled():
        (draw,) = sweep.drawings(swept, (), roles).values()
        return draw()


def test_random_starts_beside_a_number_are_a_median_with_a_band(swept: Swept) -> None:
    pictures = sweep.drawings(swept)
    assert list(pictures) == ["period", "orbit_drift", "orientations"]
    with style.styled():
        (axes,) = pictures["period"]().axes
    (line,) = axes.get_lines()
    values = swept.columns["period"].reshape(3, N)
    np.testing.assert_allclose(line.get_xdata(), K)
    np.testing.assert_allclose(line.get_ydata(), np.median(values, axis=1))
    corners = axes.collections[0].get_paths()[0].vertices[:, 1]
    low, high = np.quantile(values, (0.1, 0.9), axis=1)
    assert set(low) | set(high) <= set(corners)
    assert axes.get_ylabel().endswith("median, 10 to 90 % of 40")


def test_few_random_starts_are_a_median_too_where_x_and_y_are_named(
    swept: Swept, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And no legend of quaternions."""
    axes = [{"body.aspect_ratio": [0.2]}, {"start.orientation": {"random": "axes", "count": N}}]
    case = json.dumps({"sweep": {"axes": axes}})
    monkeypatch.setitem(swept.provenance, "resolved_case", case)
    monkeypatch.setattr(sweep, "CURVES", N)
    (panel,) = drawn(swept, x="aspect_ratio", y="period").axes
    (line,) = panel.get_lines()
    np.testing.assert_allclose(
        line.get_ydata(), np.median(swept.columns["period"].reshape(3, N), axis=1)
    )
    assert panel.get_legend() is None
    # Components that rise by chance are no numbers to draw over either.
    first = swept.arrays["table"]["start_orientation_1"]
    monkeypatch.setitem(swept.arrays, "table", swept.arrays["table"].copy())
    swept.arrays["table"]["start_orientation_1"] = np.sort(first.reshape(3, N)).ravel()
    assert sweep.description(swept, "period")["x"] == "aspect_ratio"


def test_a_mean_leaves_out_what_is_not_finite(swept: Swept) -> None:
    swept.arrays["table"]["period"][3] = np.nan
    (axes,) = drawn(swept, x="aspect_ratio", y=["period"], average="mean").axes
    swept.arrays["table"]["period"][3] = swept.columns["period"][3]
    (line,) = axes.get_lines()
    values = swept.columns["period"].reshape(3, N)
    rest = np.delete(values[0], 3)
    np.testing.assert_allclose(line.get_ydata(), [rest.mean(), *values[1:].mean(axis=1)])
    corners = axes.collections[0].get_paths()[0].vertices[:, 1]
    assert np.isclose(corners, rest.mean() + rest.std()).any()


def test_maps_are_averaged_where_rows_share_a_cell(swept: Swept) -> None:
    roles = {"x": "aspect_ratio", "y": ["aspect_ratio"], "value": "period"}
    with pytest.raises(CaseError, match="or average them"):
        drawn(swept, **roles)
    cells = drawn(swept, **roles, average="mean").axes[0].collections[0].get_array()
    means = swept.columns["period"].reshape(3, N).mean(axis=1)
    np.testing.assert_allclose(np.diag(cells), means)


def test_histograms_share_out_all_values(swept: Swept) -> None:
    figure = drawn(swept, histogram=["period", "orbit_drift"], by=["aspect_ratio"])
    for axes, scale in zip(figure.axes, ("linear", "log"), strict=True):
        assert axes.get_xscale() == scale
        assert len(axes.patches) == 3
        for outline in axes.patches:
            shares, edges, _ = outline.get_data()
            assert np.isclose(shares.sum(), 1.0)
            assert len(edges) > 4
    with pytest.raises(CaseError, match="goes with --by alone"):
        drawn(swept, histogram=["period"], x="aspect_ratio")


def test_cells_on_the_sphere_have_equal_areas(swept: Swept) -> None:
    axes = rotation.random_axes(200_000, RNG)
    *_, density = sphere._cells(axes)
    assert np.isclose(density.mean(), 1.0)
    spread = density.std() * np.sqrt(len(axes) / density.size)  # of independent counts: 1
    assert 0.9 < spread < 1.1
    inside = np.hypot(*sphere._projected(axes))
    assert inside.max() <= 1.0
    upper = np.where(axes[:, 2:] < 0.0, -axes, axes)
    np.testing.assert_allclose(inside**2, 1.0 - upper[:, 2], atol=1e-12)
    figure = drawn_orientations(swept)
    assert len(figure.axes) == 1  # few axes, drawn one by one
    places = figure.axes[0].get_lines()[0].get_xydata()
    assert len(places) == 3 * N


def drawn_orientations(swept: Swept) -> Any:
    with style.styled():
        return sweep.drawings(swept, ["orientations"])["orientations"]()


@pytest.mark.parametrize("average", ["mode", "Mean"])
def test_another_average_is_refused(swept: Swept, average: str) -> None:
    with pytest.raises(CaseError, match="average is one of mean, median"):
        drawn(swept, x="aspect_ratio", y=["period"], average=average)
