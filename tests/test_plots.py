"""Pictures: which are drawn, that they show the right numbers, and what is refused."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from euler_orbits import euler_angles_at
from numpy.typing import NDArray

import qbxstokes
from qbxstokes.case.load import case_of
from qbxstokes.cli.main import run_command
from qbxstokes.cli.pictures import drawings, picture_command
from qbxstokes.errors import CaseError, ResultFileError
from qbxstokes.geometry import rotation
from qbxstokes.io.names import older_pictures
from qbxstokes.io.results import Result, load
from qbxstokes.io.writer import ResultWriter
from qbxstokes.plots import pictures, style, sweep
from qbxstokes.plots.animation import Frames, animate
from qbxstokes.plots.charts import figure_of
from qbxstokes.plots.columns import Columns
from qbxstokes.plots.pictures import kinds
from qbxstokes.plots.series import alike, draw_path
from qbxstokes.plots.source import axis_path, between, sampling, smooth
from qbxstokes.plots.sphere import drifts
from qbxstokes.plots.views import Camera, split_at_silhouette
from qbxstokes.reference import jeffery
from qbxstokes.simulation.from_case import samples_of, times_of

Array = NDArray[np.float64]

K = 0.5
RNG = np.random.default_rng(1)


def orbit(times: Array, theta: float = 1.0) -> dict[str, Array]:
    """A Jeffery orbit of a centre that drifts across a stream."""
    euler = euler_angles_at(times, K, 0.5, theta)
    q = rotation.from_euler(*euler.T)
    axis = rotation.axis(q)
    gradient = np.zeros((3, 3))
    gradient[0, 1] = 1.0
    turn = rotation.matrix(q)
    inside = np.swapaxes(turn, 1, 2) @ gradient @ turn
    spin = rotation.to_space(q, jeffery.free_angular_velocity(K, inside))
    zero = np.zeros_like(times)
    return {
        "time": times,
        "position": np.stack([9.0 * times, 3.0 + 1e-3 * times, zero], axis=-1),
        "orientation": q,
        "axis": axis,
        "velocity": np.stack([zero + 9.0, zero + 1e-3, zero], axis=-1),
        "angular_velocity": spin,
        "force": np.stack([np.sin(times), zero, zero], axis=-1),
        "torque": np.zeros((len(times), 3)),
        "euler_angles": rotation.to_euler(q),
        "orbit_constant": jeffery.orbit_constant(K, axis),
    }


def write(path: Path, block: dict[str, Any]) -> Path:
    provenance = {"resolved_case": json.dumps({"body": {"aspect_ratio": K}})}
    with ResultWriter(path, "motion", provenance, overwrite=True) as writer:
        if block:
            writer.append(block)
        return writer.finish({"steps": 1})


@pytest.fixture(scope="module")
def times() -> Array:
    return np.linspace(0.0, 2.0 * jeffery.period(K), 121)


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory, times: Array) -> Path:
    return write(tmp_path_factory.mktemp("plots") / "orbit.h5", orbit(times))


@pytest.fixture(scope="module")
def result(path: Path) -> Result:
    return load(path)


def drawn(axes: Any, name: str) -> tuple[Array, Array]:
    """Data of the line with this label."""
    (line,) = [line for line in axes.get_lines() if line.get_label() == name]
    x, y = line.get_data()
    return np.asarray(x, float), np.asarray(y, float)


def figure(result: Result, kind: str) -> Any:
    with style.styled():
        return pictures.motion_drawings(result)[kind]()


# -- what a motion calls for ------------------------------------------------------------------


def test_a_moving_body_calls_for_every_kind(result: Result) -> None:
    assert list(pictures.motion_drawings(result)) == [
        kind for kind in pictures.KINDS if kind != "stress"
    ]


def test_what_does_nothing_is_not_drawn(tmp_path: Path, times: Array) -> None:
    block = orbit(times)
    block["position"][:] = 0.0
    block["force"][:] = 1e-16
    still = pictures.motion_drawings(load(write(tmp_path / "a.h5", block)))
    assert list(still) == ["orbit", "rotation", "constant", "overview"]


def test_a_file_with_few_quantities_is_drawn_as_far_as_it_goes(
    tmp_path: Path, times: Array
) -> None:
    block = {name: orbit(times)[name] for name in ("time", "axis")}
    few = load(write(tmp_path / "a.h5", block))
    assert list(pictures.motion_drawings(few)) == ["orbit", "rotation", "overview"]
    for kind in pictures.motion_drawings(few):
        figure(few, kind)


@pytest.mark.parametrize("samples", [1, 2])
def test_few_samples_are_drawn(tmp_path: Path, samples: int) -> None:
    few = load(write(tmp_path / "a.h5", orbit(np.arange(samples, dtype=float))))
    kinds = {"orbit", "path", "overview"} & set(pictures.motion_drawings(few))
    assert "overview" in kinds
    for kind in sorted(kinds):
        picture = figure(few, kind)
        picture.set_layout_engine("none")  # which takes most of the time
        picture.canvas.draw()


@pytest.mark.parametrize("theta", [0.0, 0.5 * np.pi, np.pi])
def test_rolling_and_tumbling_are_drawn_without_a_drift(
    tmp_path: Path, times: Array, theta: float
) -> None:
    special = load(write(tmp_path / "a.h5", orbit(times, theta)))
    axes = figure(special, "constant").axes
    assert len(axes) == 1
    expected = 1.0 if theta == 0.5 * np.pi else 0.0
    np.testing.assert_allclose(axes[0].get_lines()[0].get_ydata(), expected, atol=1e-12)


# -- the right data on labelled axes ----------------------------------------------------------


def test_rotation_shows_axis_angles_and_angular_velocity(result: Result) -> None:
    axis, angles, spin = figure(result, "rotation").axes
    for i in range(3):
        x, y = drawn(axis, f"$D^3_{i + 1}$")
        np.testing.assert_array_equal(x, result.time)
        np.testing.assert_array_equal(y, result.axis[:, i])
        np.testing.assert_array_equal(
            drawn(spin, rf"$\Omega_{i + 1}$")[1], result.angular_velocity[:, i]
        )
    # phi goes on falling where the file wraps it at -pi
    phi = drawn(angles, r"$\varphi$")[1]
    assert np.all(np.diff(phi) < 0.0)
    np.testing.assert_allclose(np.exp(1j * np.pi * phi), np.exp(1j * result.euler_angles[:, 0]))
    assert axis.get_ylabel() == "axis $D^3$"
    assert spin.get_ylabel() == r"$\Omega$ ($\tau^{-1}$)"
    assert spin.get_xlabel() == r"time $t$ ($\tau$)"
    assert [a.get_title(loc="right") for a in (axis, angles, spin)] == ["(a)", "(b)", "(c)"]


def test_tiny_drift_is_an_error_and_a_large_one_a_rate(tmp_path: Path, times: Array) -> None:
    block = orbit(times)
    start = block["orbit_constant"][0]
    block["orbit_constant"] = start * np.exp(0.1 * times)
    axes = figure(load(write(tmp_path / "a.h5", block)), "constant").axes[1]
    np.testing.assert_allclose(axes.get_lines()[0].get_ydata(), 0.1 * times, atol=1e-12)
    assert axes.get_yscale() == "linear"
    block["orbit_constant"] = start * (1.0 + 1e-9 * times)
    axes = figure(load(write(tmp_path / "a.h5", block)), "constant").axes[1]
    np.testing.assert_allclose(axes.get_lines()[0].get_ydata()[1:], 1e-9 * times[1:], rtol=1e-5)
    assert axes.get_yscale() == "log"


def test_every_quantity_is_drawn_by_its_name(result: Result) -> None:
    with style.styled():
        (axes,) = kinds(result, ["orientation"])["orientation"]().axes
    for i in range(4):
        np.testing.assert_array_equal(drawn(axes, f"$q_{i}$")[1], result.orientation[:, i])


def test_path_separates_drift_from_stream(result: Result) -> None:
    path, stream, drift = figure(result, "path").axes
    line = path.get_lines()[0]
    along, across = (np.asarray(data)[::8] for data in line.get_data())  # and between the samples
    np.testing.assert_array_equal(along, result.position[:, 0])
    np.testing.assert_array_equal(across, result.position[:, 1])
    assert path.get_xlabel() == "$x_1$ ($c$); not to scale"
    assert stream.get_ylabel() == r"$\Delta x_1$ ($c$)"
    displacement = result.position[:, 1] - result.position[0, 1]
    np.testing.assert_array_equal(drawn(drift, r"$\Delta x_2$")[1], displacement)


def test_path_is_true_to_scale_where_that_can_be_seen(tmp_path: Path, times: Array) -> None:
    block = orbit(times)
    block["position"] = np.stack([np.sin(times), np.cos(times), 0.0 * times], axis=-1)
    circle = load(write(tmp_path / "a.h5", block))
    with style.styled():
        axes = style.new_figure(3.0, 3.0).add_subplot()
        draw_path(axes, circle)
    assert axes.get_aspect() == 1.0


def test_legends_stand_above_the_data(result: Result) -> None:
    for kind in ("rotation", "path"):
        picture = figure(result, kind)
        picture.canvas.draw()
        for axes in picture.axes:
            if axes.get_legend() is not None:
                frame = axes.get_window_extent()
                assert axes.get_legend().get_window_extent().y0 >= frame.y1 - 1.0


def test_loads_leave_out_the_torque_that_vanishes(result: Result) -> None:
    axes = figure(result, "loads").axes
    assert [a.get_ylabel() for a in axes] == [r"$F$ ($\mu c^2/\tau$)"]
    np.testing.assert_array_equal(drawn(axes[0], "$F_1$")[1], result.force[:, 0])


def test_infinite_orbit_constants_stand_in_a_legend() -> None:
    orbits, k = np.repeat([0.5, np.inf], 2), np.array([0.5, 2.0] * 2)
    held = Columns("table", {"start_orbit_constant": orbits, "aspect_ratio": k, "period": k})
    spec = {"x": "aspect_ratio", "y": "period", "by": "start_orbit_constant"}
    (axes,) = figure_of(held, spec).axes
    assert axes.get_legend_handles_labels()[1][1].endswith(r"= $\infty$")


def test_what_is_constant_but_for_rounding_is_drawn_as_constant() -> None:
    x = np.linspace(1.0, 2.0, 9)
    held = Columns("table", {"x": x, "period": 4.084 + 1e-12 * np.sin(9.0 * x)})
    (axes,) = figure_of(held, {"x": "x", "y": "period"}).axes
    assert axes.get_ylim() == pytest.approx((4.084 * 0.99, 4.084 * 1.01))


def test_powers_of_ten_stand_in_the_label() -> None:
    with style.styled():
        axes = style.new_figure(3.0, 2.0).add_subplot()
        axes.plot([0.0, 1.0], [0.0, -4e-5])
        style.set_ylabel(axes, "$V$", "c/tau")
        assert axes.get_ylabel() == r"$V$ ($10^{-5}\,c/\tau$)"
        axes.figure.canvas.draw()
    assert "\u22124" in [text.get_text() for text in axes.get_yticklabels()]


def test_components_of_different_size_are_parted() -> None:
    assert alike(np.array([1.0, 0.5, 0.2])) == [[0, 1, 2]]
    assert alike(np.array([1e-3, 1.0, 0.0])) == [[1], [0, 2]]
    assert alike(np.zeros(3)) == [[0, 1, 2]]


@pytest.mark.parametrize(
    ("units", "text"),
    [
        ("1", ""),
        ("", ""),
        ("tau", r"$\tau$"),
        ("c/tau", r"$c/\tau$"),
        ("1/tau", r"$\tau^{-1}$"),
        ("1/tau^2", r"$\tau^{-2}$"),
        ("mu c^3/tau", r"$\mu c^3/\tau$"),
        ("mu/(c tau)", r"$\mu/(c \tau)$"),
        ("rad", "rad"),
    ],
)
def test_units_are_written_as_formulas(units: str, text: str) -> None:
    assert style.units_text(units) == text


def test_curves_are_told_apart_without_colour() -> None:
    looks = [style.line_style(i, markers=True) for i in range(len(style.LINES))]
    assert len({str(look["linestyle"]) for look in looks}) == len(looks)
    assert len({look["marker"] for look in looks}) == len(looks)


# -- the orbit on the sphere -------------------------------------------------------------------


def test_camera_is_a_rotation_that_keeps_x3_upwards() -> None:
    camera = Camera(33.0, 21.0)
    np.testing.assert_allclose(camera.frame @ camera.frame.T, np.eye(3), atol=1e-15)
    assert np.linalg.det(camera.frame) == pytest.approx(1.0)
    up = camera.project([0.0, 0.0, 1.0])
    assert up[0] == pytest.approx(0.0)
    assert up[1] > 0.0
    a = np.radians(33.0)
    assert camera.depth([np.cos(a), np.sin(a), 0.0]) > 0.0


def test_silhouette_parts_a_curve_where_it_crosses() -> None:
    turn = np.linspace(0.0, 2.0 * np.pi, 100)
    circle = np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], axis=-1)
    front, back = split_at_silhouette(circle, circle[:, 1] + 0.2)
    assert (len(front), len(back)) == (2, 1)
    assert all(np.all(piece[:, 1] >= -0.2 - 1e-12) for piece in front)
    assert np.all(back[0][:, 1] <= -0.2 + 1e-12)
    np.testing.assert_array_equal(front[0][-1], back[0][0])
    np.testing.assert_array_equal(back[0][-1], front[1][0])
    assert sum(map(len, [*front, *back])) == len(circle) + 4


def test_hidden_part_of_the_orbit_is_lighter(result: Result) -> None:
    (axes,) = figure(result, "orbit").axes
    before = [line for line in axes.get_lines() if line.get_gid() == "before"]
    behind = [line for line in axes.get_lines() if line.get_gid() == "behind"]
    assert before
    assert behind
    assert {line.get_color() for line in before} == {style.BLUE}
    assert {line.get_color() for line in behind} == {style.PALE_BLUE}
    assert min(a.get_zorder() for a in before) > max(a.get_zorder() for a in behind)
    assert axes.get_aspect() == 1.0
    # together they are the projected orbit
    camera = Camera()
    there = np.concatenate([np.stack(line.get_data(), axis=-1) for line in before + behind])
    for point in camera.project(result.axis)[::10]:
        assert np.min(np.linalg.norm(there - point, axis=1)) < 1e-9


def test_only_orbits_that_drift_are_coloured_by_time(result: Result, times: Array) -> None:
    assert not drifts(axis_path(result.time, result.axis, None)[1])
    spiral = 0.3 + 0.02 * times
    path = np.stack(
        [np.sin(spiral) * np.cos(times), np.sin(spiral) * np.sin(times), np.cos(spiral)], axis=-1
    )
    assert drifts(path)


def test_between_samples_the_orbit_is_fourth_order(times: Array) -> None:
    errors = []
    for count in (30, 60, 120):
        coarse = orbit(np.linspace(0.0, times[-1], count))
        at, path = axis_path(coarse["time"], coarse["axis"], coarse["angular_velocity"])
        np.testing.assert_allclose(np.linalg.norm(path, axis=1), 1.0)
        assert np.max(np.linalg.norm(np.diff(path, axis=0), axis=1)) < 0.08
        exact = jeffery.axis_at(at, K, coarse["axis"][0])
        errors.append(np.abs(path - exact).max())
    assert errors[2] < 1e-4
    assert np.log2(errors[0] / errors[2]) / 2.0 > 3.5


def test_cubic_between_samples_is_exact_for_a_cubic() -> None:
    times = np.array([0.0, 1.0, 3.0])
    values, rates = (times**3)[:, None], (3.0 * times**2)[:, None]
    at = np.linspace(0.0, 3.0, 13)
    np.testing.assert_allclose(between(times, values, rates, at)[:, 0], at**3, atol=1e-13)


def test_paths_are_smooth_where_rates_agree_with_the_samples() -> None:
    """A cubic is met; between a start and an end that rates say nothing of it is straight."""
    t = np.array([0.0, 0.5, 1.0, 1.2])
    way = np.stack([t, t**2, t**3], axis=1)
    rates = np.stack([np.ones(4), 2.0 * t, 3.0 * t**2], axis=1)
    path = smooth(t, way, rates)
    np.testing.assert_allclose(path[:, 2], path[:, 0] ** 3, atol=1e-15)
    np.testing.assert_array_equal(path[::8], way)
    both = smooth(t, np.stack([way, way], axis=1), np.stack([rates, 9.0 * rates], axis=1))
    np.testing.assert_array_equal(both[:, 0], path)
    np.testing.assert_allclose(both[4, 1], 0.5 * (way[0] + way[1]))
    assert smooth(t, way, None) is way


# -- tables -------------------------------------------------------------------------------------


def table(**columns: Array) -> Columns:
    """Columns by name; times are in seconds."""
    return Columns("table", columns, {"time": "s"})


@pytest.fixture
def work() -> Columns:
    n = np.array([1.0, 2.0, 4.0, 8.0])
    return table(
        method=np.repeat(["first", "second"], 4),
        time=0.1 * np.tile(n, 2),
        error=np.concatenate([n**-1.0, n**-2.0]),
    )


def test_error_over_time_has_a_curve_per_method(work: Columns) -> None:
    with style.styled():
        spec = {"x": "time", "y": "error", "by": "method", "scale": "loglog"}
        (axes,) = figure_of(work, spec).axes
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
    x, y = drawn(axes, "second")
    np.testing.assert_allclose(x, 0.1 * np.array([1, 2, 4, 8]))
    np.testing.assert_allclose(y, x**-2.0 / 100.0)
    assert axes.get_xlabel() == "time (s)"
    assert axes.get_ylabel() == "error"


def test_map_puts_values_in_their_cells() -> None:
    cells = {(p, r): float(10.0 ** (-p + 3 * r)) for p in (2, 4, 8) for r in (0.1, 0.5)}
    del cells[2, 0.5]
    p, r = RNG.permutation(np.array(list(cells))).T
    error = np.array([cells[int(a), b] for a, b in zip(p, r, strict=True)])
    spec = {"x": "p", "y": "r", "value": "error"}
    with style.styled():
        axes = figure_of(table(p=p, r=r, error=error), spec).axes[0]
    (mesh,) = axes.collections
    shown = mesh.get_array().reshape(2, 3)
    assert shown.mask.sum() == 1
    assert shown[0, 2] == cells[8, 0.1]
    assert shown[1, 1] == cells[4, 0.5]
    twice = table(p=np.append(p, 2), r=np.append(r, 0.1), error=np.append(error, 1.0))
    with style.styled(), pytest.raises(CaseError, match="same p and r"):
        figure_of(twice, spec)


def test_texts_become_bars_and_many_curves_shades() -> None:
    n, part = np.repeat(np.arange(1, 11), 2), np.tile(["solve", "set-up"], 10)
    time = np.array([a - 1.0 + len(b) for a, b in zip(n, part.tolist(), strict=True)])
    times = table(part=part, n=n, time=time)
    with style.styled():
        (axes,) = figure_of(times, {"x": "part", "y": "time", "by": "n"}).axes
        assert len(axes.patches) == 20
        assert [t.get_text() for t in axes.get_yticklabels()] == ["solve", "set-up"]
        axes, bar = figure_of(times, {"x": "time", "y": "time", "by": "n"}).axes
        assert len(axes.get_lines()) == 10
        assert axes.get_legend() is None
        assert bar.get_ylabel() == "n"


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ({}, "what to draw"),
        ({"x": "time"}, "what to draw"),
        ({"x": "nothing", "y": "error"}, "no column 'nothing'"),
        ({"x": "time", "y": "method"}, "holds texts"),
        ({"x": "time", "y": "error", "scale": "log"}, "scale is one of"),
    ],
)
def test_wrong_descriptions_are_refused(work: Columns, spec: dict[str, Any], message: str) -> None:
    with style.styled(), pytest.raises(CaseError, match=message):
        figure_of(work, spec)


# -- sweeps -------------------------------------------------------------------------------------


class Swept:
    """A sweep result in memory."""

    def __init__(self, columns: dict[str, Array], coordinates: list[str], shape: tuple[int, ...]):
        size = int(np.prod(shape))
        kinds = [(name, "f8") for name in columns] + [("status", "i1"), ("reason", "S8")]
        table = np.zeros(size, dtype=kinds)
        for name, values in columns.items():
            table[name] = values.ravel()
        table["status"] = 1
        self.path, self.task = Path("sweep.h5"), "sweep"
        self.arrays: dict[str, Any] = {"table": table}
        self.attributes = {"table": {"period: units": "tau"}}
        self.groups: dict[str, Any] = {}
        self.summary: dict[str, Any] = {}
        self.provenance: dict[str, Any] = {}
        self.coordinates, self.shape = coordinates, shape


def two_axes(n: int, m: int) -> Swept:
    st, k = np.meshgrid(np.logspace(-1, 2, n), np.linspace(0.1, 0.9, m), indexing="ij")
    columns = {"stokes_number": st, "aspect_ratio": k, "period": st * k, "rotation_rate": 0 * k}
    return Swept(columns, ["stokes_number", "aspect_ratio"], (n, m))


def test_sweep_over_two_numbers_is_curves_or_a_map() -> None:
    curves, cells = two_axes(12, 3), two_axes(12, 11)
    assert list(sweep.drawings(curves)) == ["period"]  # the other summary is zero throughout
    with style.styled():
        (axes,) = sweep.drawings(curves)["period"]().axes
        x, y = drawn(axes, "$k$ = 0.5")
        np.testing.assert_allclose(y, 0.5 * x)
        assert axes.get_xlabel() == r"Stokes number $\mathrm{St}$"
        assert axes.get_ylabel() == r"period $T$ ($\tau$)"
        axes = sweep.drawings(cells)["period"]().axes[0]
    assert axes.collections[0].get_array().size == 11 * 12
    assert axes.get_ylabel() == "aspect ratio $k$"


def test_failed_trajectories_are_left_out_and_random_ones_are_points() -> None:
    columns = {
        "start_orientation_1": RNG.normal(size=30),
        "orbit_constant_start": RNG.uniform(0.1, 9.0, 30),
        "period": RNG.uniform(1.0, 2.0, 30),
    }
    random = Swept(columns, ["start_orientation_1"], (30,))
    random.arrays["table"]["status"][:4] = 2
    with style.styled():
        (axes,) = sweep.drawings(random)["period"]().axes
    (line,) = axes.get_lines()
    assert line.get_linestyle() == "None"
    np.testing.assert_array_equal(line.get_xdata(), columns["orbit_constant_start"][4:])
    random.arrays["table"]["status"] = 2
    with pytest.raises(CaseError, match="no trajectory"):
        sweep.drawings(random)


def test_sweep_draws_what_is_asked_for() -> None:
    swept = two_axes(4, 3)
    assert list(sweep.drawings(swept, ["rotation_rate"])) == ["rotation_rate"]
    with pytest.raises(CaseError, match="no summary 'reason'"):
        sweep.drawings(swept, ["reason"])
    roles = {"x": "aspect_ratio", "y": ["period"], "by": ["stokes_number"]}
    with style.styled():
        (axes,) = sweep.drawings(swept, (), roles)["period"]().axes
    assert len(axes.get_lines()) == 4


# -- animation ----------------------------------------------------------------------------------


def test_frames_follow_the_motion(result: Result, times: Array) -> None:
    film = Frames.of(result, 50, (1.0, 9.0))
    np.testing.assert_allclose(film.times, np.linspace(1.0, 9.0, 50))
    np.testing.assert_allclose(film.position[:, 0], 9.0 * film.times)
    exact = jeffery.axis_at(film.times, K, result.axis[0])
    np.testing.assert_allclose(rotation.axis(film.orientation), exact, atol=2e-4)
    with pytest.raises(CaseError, match="none in the window"):
        Frames.of(result, 50, (1e6, 2e6))


def test_quaternions_of_either_sign_are_one_motion(result: Result, tmp_path: Path) -> None:
    block = {"time": result.time, **{name: result[name].copy() for name in ("orientation", "axis")}}
    block["orientation"][1::2] *= -1.0
    flipped = Frames.of(load(write(tmp_path / "a.h5", block)), 40)
    plain = Frames.of(result, 40)
    distance = np.abs(rotation.axis(flipped.orientation) - rotation.axis(plain.orientation))
    assert distance.max() < 0.02  # linear against cubic interpolation


def test_animation_is_a_gif_with_its_frames(result: Result, tmp_path: Path) -> None:
    from PIL import Image

    film = animate(result, frames=4, fps=10)
    body = film.figure.axes[0].collections[0]
    film.show(2)
    limits = body.get_datalim(film.figure.axes[0].transData)
    assert limits.width <= 2.0 + 1e-9  # the body is not longer than its axis
    with Image.open(film.save(tmp_path / "a.gif")) as picture:
        assert picture.n_frames == 4
        assert picture.info["duration"] == 100
        assert picture.size == tuple(
            round(inches * film.figure.dpi) for inches in film.figure.get_size_inches()
        )
    with pytest.raises(CaseError, match="written as gif, mp4"):
        film.save(tmp_path / "a.avi")
    assert not [name for name in tmp_path.iterdir() if name.suffix != ".gif"]


def test_animation_needs_an_orientation_and_a_shape(
    tmp_path: Path, times: Array, result: Result
) -> None:
    block = {name: orbit(times)[name] for name in ("time", "axis")}
    with pytest.raises(CaseError, match="no orientation"):
        animate(load(write(tmp_path / "a.h5", block)))
    nameless = load(result.path)
    nameless.provenance = {}
    with pytest.raises(ResultFileError, match="shapes of the bodies"):
        animate(nameless)


# -- commands -----------------------------------------------------------------------------------

Command = Callable[..., list[str]]


@pytest.fixture
def command(capsys: pytest.CaptureFixture[str]) -> Command:
    def run(*words: Any) -> list[str]:
        assert picture_command(words[0], [str(word) for word in words[1:]]) == 0
        return capsys.readouterr().out.splitlines()

    return run


def test_plot_writes_vector_files_named_after_the_result(
    path: Path, tmp_path: Path, command: Command
) -> None:
    out = tmp_path / "new" / "folder"
    words = ("plot", path, "--output", out, "--kind", "orbit,constant", "--format", "pdf,svg")
    named = [
        out / f"orbit-{kind}.{end}" for kind in ("orbit", "constant") for end in ("pdf", "svg")
    ]
    assert command(*words) == [str(name) for name in named]
    assert sorted(out.iterdir()) == sorted(named)
    assert named[0].read_bytes().startswith(b"%PDF")
    first = [name.read_bytes() for name in named]
    assert command(*words, "--quiet") == []
    assert [name.read_bytes() for name in named] == first  # nothing depends on the day


def test_foreign_and_damaged_files_are_refused(path: Path, tmp_path: Path) -> None:
    whole = path.read_bytes()
    (tmp_path / "cut.h5").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "text.h5").write_text("time, axis\n")
    for name in ("cut.h5", "text.h5", "missing.h5"):
        for words in (["plot"], ["animate"]):
            with pytest.raises(ResultFileError):
                picture_command(words[0], [str(tmp_path / name), "--output", str(tmp_path)])
    assert len(list(tmp_path.iterdir())) == 2


def test_files_of_this_format_with_wrong_contents_are_refused(tmp_path: Path, times: Array) -> None:
    block = orbit(times)
    block["time"] = times[::-1]
    with pytest.raises(ResultFileError, match="do not rise"):
        drawings(write(tmp_path / "a.h5", block))["orbit"]()
    odd = write(tmp_path / "b.h5", orbit(times))
    result = load(odd)
    result.arrays["axis"] = result.arrays["axis"][:, :2]
    with pytest.raises(ResultFileError, match="axis has shape"):
        pictures.motion_drawings(result)["orbit"]()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["plot"], "needs a result file"),
        (["plot", "FILE", "--kind", "cheese"], "nothing to draw as 'cheese'; there are orbit"),
        (["plot", "FILE", "--format", "jpeg"], "--format is one of pdf, svg, png"),
        (["plot", "FILE", "--trajectory", "1"], "is not a sweep"),
        (["plot", "FILE", "--x", "time", "--y", "axis"], "is not a sweep"),
        (["plot", "FILE", "--colour"], "unrecognized arguments"),
        (["plot", "FILE", "--output", "FILE"], "-o takes a folder, or a file that ends in .pdf"),
        (["animate", "FILE", "FILE"], "one file at a time"),
        (["animate", "FILE", "--frames", "0"], "--frames"),
        (["animate", "FILE", "--fps", "many"], "invalid int value"),
        (["animate", "FILE", "--from", "1e9"], "none in the window"),
    ],
)
def test_wrong_words_are_refused(path: Path, words: list[str], message: str) -> None:
    given = [str(path) if word == "FILE" else word for word in words]
    with pytest.raises(CaseError, match=message):
        picture_command(given[0], given[1:])


def test_help_fits_a_terminal(command: Command) -> None:
    for name in ("plot", "animate", "export"):
        lines = command(name, "--help")
        assert max(map(len, lines)) <= 80
    assert any(line.split()[:1] == ["overview"] for line in command("plot", "--help"))


def test_exit_status_and_message_reach_the_shell(
    path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_command(["plot", "nothing.h5"]) == 2
    assert capsys.readouterr().err.startswith("nothing.h5: no such file")
    assert run_command(["plot", str(path), "--kind", "cheese"]) == 2
    assert run_command(["animate", "--help"]) == 0


def test_pictures_need_no_pyplot_and_leave_the_settings_alone(path: Path, tmp_path: Path) -> None:
    script = f"""
import sys
from matplotlib import rcParams
from qbxstokes.cli.main import run_command
from qbxstokes.cli.pictures import picture_command
settings = {{key: rcParams[key] for key in rcParams if key != "backend"}}
picture_command("plot", [{str(path)!r}, "--kind", "constant", "--output", {str(tmp_path)!r}])
assert settings == {{key: rcParams[key] for key in rcParams if key != "backend"}}
assert "matplotlib.pyplot" not in sys.modules
"""
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=False, timeout=120
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "orbit-constant.pdf").exists()


def test_a_case_stands_for_its_newest_result(
    tmp_path: Path, times: Array, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    """plot, info and load given a case take its newest result, and say so; so does an old one."""
    monkeypatch.chdir(tmp_path)
    for age, name in ((30, "out.h5"), (10, "out-1.h5"), (0, "out-2.h5")):
        made_by = {"case_file": f"x/{'ok' if age else 'no'}.yaml"}
        with ResultWriter(Path(name), "motion", made_by) as writer:
            writer.append(orbit(times))
            writer.finish({"complete": True})
        stamp = Path(name).stat().st_mtime - age
        os.utime(name, (stamp, stamp))
    assert load("ok.yaml").path == Path("out-1.h5")  # out-2.h5 is of another case
    assert run_command(["plot", "ok.yaml", "--kind", "orbit"]) == 0
    out, err = capsys.readouterr()
    assert (out, err) == (
        "out-1-orbit.pdf\n",
        "qbxstokes: ok.yaml: its newest result is out-1.h5\n",
    )
    assert run_command(["info", "out.h5"]) == 0
    assert "out-1.h5 is a newer result of its case" in capsys.readouterr().err
    assert older_pictures(Path("out-1.h5")) == []
    os.utime("out-1-orbit.pdf", (1, 1))
    assert older_pictures(Path("out-1.h5")) == [Path("out-1-orbit.pdf")]
    assert older_pictures(Path("out.h5")) == []
    assert run_command(["plot", "other.yaml"]) == 2
    assert "other.yaml: has no result here" in capsys.readouterr().err


def test_a_drawing_that_fails_keeps_the_picture_before(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    old = tmp_path / f"{path.stem}-orbit.pdf"
    old.write_text("before")
    fault = CaseError("nothing to draw")

    def fail(*_: Any, **__: Any) -> None:
        raise fault

    monkeypatch.setattr("qbxstokes.plots.pictures.draw_orbit", fail)
    monkeypatch.setattr("qbxstokes.plots.sphere.draw_orbit", fail)
    assert run_command(["plot", str(path), "--kind", "orbit", "--output", str(tmp_path)]) == 2
    assert f"{old}: an earlier picture, kept" in capsys.readouterr().err
    assert old.read_text() == "before"


def test_samples_too_far_apart_are_said_in_picture_and_terminal(
    tmp_path: Path, times: Array, capsys: Any
) -> None:
    few = write(tmp_path / "few.h5", orbit(times[::20]))  # 2 turns in 6 steps
    assert run_command(["plot", str(few), "--kind", "orbit", "--output", str(tmp_path)]) == 0
    assert "samples per turn where the axis turns fastest" in capsys.readouterr().err
    note = figure(load(few), "orbit")._supxlabel.get_text()
    wanted = int(note.split("time.samples of ")[1].split()[0])
    assert (
        sampling(load(write(tmp_path / "more.h5", orbit(np.linspace(0, times[-1], wanted))))) == ""
    )
    assert figure(load(write(tmp_path / "all.h5", orbit(times))), "orbit")._supxlabel is None


@pytest.mark.parametrize("k", [0.05, 0.5, 1.0, 4.0])
def test_as_many_samples_as_the_motion_needs(k: float) -> None:
    """Unset, their number keeps the turn between two below a third of a radian."""
    case = {
        "body": {"aspect_ratio": k},
        "flow": {"type": "shear", "rate": 2.0},
        "start": {"orientation": {"axis": [1, 0, 0.2]}},
        "time": {"periods": 12},
    }
    n = len(times_of(case_of(case)))
    fastest = 2.0 * max(1.0, k * k) / (1.0 + k * k)
    assert (n - 1) * 0.3 == pytest.approx(12 * np.pi * (k + 1 / k) * fastest, abs=0.3) or n == 201
    sweep = {"axes": [{"body.aspect_ratio": [1.0, k]}]}
    assert samples_of(case_of({**case, "sweep": sweep})) >= n
    assert samples_of(case_of({**case, "time": {"end": 1e9}})) == 20_001
    assert samples_of(case_of({**case, "flow": {"type": "extension"}, "time": {"end": 1e9}})) == 201


def test_an_overview_fits_a4(tmp_path: Path) -> None:
    """Also of a body that does everything: with inertia, pushed, in a flow that carries it."""
    case = {
        "body": {"aspect_ratio": 0.5, "stokes_number": 3.0},
        "flow": {"type": "paraboloid"},
        "start": {"position": [0, 1, 0.1], "orientation": {"axis": [1, 0.3, 1]}},
        "forces": {"force": [0.3, 0.01, 5.0], "torque": [0.0, 0.001, 1.0]},
        "time": {"end": 5.0, "samples": 61, "tolerance": 1e-6},
        "compare": {"reference": "none"},
    }
    figure = qbxstokes.run(case).plot("overview")
    assert len(figure.axes) > 12
    assert figure.get_figwidth() <= 8.27 - 2 * 0.5
    assert figure.get_figheight() <= 11.69 - 2 * 0.5
    figure.savefig(tmp_path / "a.png")
    tops = sorted((axes.get_position().x0, axes.get_position().y1) for axes in figure.axes)
    assert len(set(tops)) == len(figure.axes)
    assert min(a.get_position().height for a in figure.axes if a.get_ylabel()) > 0.04


def test_a_picture_is_laid_out_and_drawn_once(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Four pictures of an orbit take about a second: no drawing is thrown away."""
    from matplotlib.figure import Figure

    drawn: list[Figure] = []
    draw = Figure.draw
    monkeypatch.setattr(Figure, "draw", lambda self, by: (drawn.append(self), draw(self, by))[1])
    written = picture_command("plot", [str(path), "-o", str(tmp_path), "--quiet"])
    assert written == 0
    assert len(drawn) == len(list(tmp_path.glob("*.pdf"))) == len({id(one) for one in drawn})


def test_legends_fit_into_their_figures() -> None:
    for names, width, columns in (
        (["$D^3_1$", "$D^3_2$", "$D^3_3$"], style.COLUMN, 3),
        ([rf"$k = 0.2$, $\mathrm{{St}} = {st}$" for st in (0, 30, 200, 1000)], style.COLUMN, 2),
        ([rf"$k = 0.2$, $\mathrm{{St}} = {st}$" for st in (0, 30, 200, 1000)], style.PAGE, 4),
        (["a word of some forty letters, to be exact"], style.COLUMN, 1),
    ):
        with style.styled():
            figure = style.new_figure(width, 2.0)
            axes = figure.subplots()
            for index, name in enumerate(names):
                axes.plot([0.0, 1.0], [index, index], label=name)
            style.legend_on_top(figure, [axes]) if width == style.PAGE else style.legend_above(axes)
            (legend,) = figure.legends or [axes.get_legend()]
            figure.draw_without_rendering()
            assert legend._ncols == columns
            assert legend.get_window_extent().width <= figure.bbox.width


def test_vectors_are_told_apart_as_vectors() -> None:
    k, axis = np.array([0.5, 2.0] * 2), np.repeat([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]], 2, axis=0)
    parts = {f"start_axis_{i + 1}": axis[:, i] for i in range(3)}
    held = Columns("table", {"aspect_ratio": k, "period": k, **parts})
    (panel,) = figure_of(held, {"x": "aspect_ratio", "y": "period", "by": list(parts)}).axes
    names = panel.get_legend_handles_labels()[1]
    assert names == ["start axis = (0, 0, 1)", "start axis = (1, 0, 0)"]


def test_labels_stay_where_they_are_in_every_file(tmp_path: Path) -> None:
    with style.styled():
        figure = style.new_figure(3.0, 2.0)
        figure.add_subplot().set_ylabel("label")
    places = []
    for name in ("a.pdf", "a.png", "b.png"):
        style.save(figure, tmp_path / name)
        places.append(figure.axes[0].yaxis.label.get_position()[0])
    assert places == pytest.approx([places[0]] * 3, abs=1e-3)
    assert -0.3 < places[0] < -0.05
