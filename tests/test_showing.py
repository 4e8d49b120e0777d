"""What results and motions show of themselves: lines, completion, pictures in any axes."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pytest
from conftest import Run
from matplotlib.figure import Figure

import qbxstokes as qs
from qbxstokes.errors import CaseError, SceneError
from qbxstokes.io.results import LazyArrays

SHEAR = {"body": {"aspect_ratio": 0.5}, "flow": {"type": "shear"}}
START = {"start": {"orientation": {"axis": [1, 0, 1]}}}
CASES: dict[str, dict[str, Any]] = {
    "motion": {"title": "An orbit", **SHEAR, **START, "time": {"periods": 2, "samples": 101}},
    "field": {"task": "field", **SHEAR, "field": {"plane": {"shape": [12, 9]}, "vtk": False}},
    "sweep": {
        **SHEAR,
        **START,
        "time": {"periods": 2, "samples": 101},
        "sweep": {"axes": [{"body.aspect_ratio": [0.5, 2, 3]}]},
    },
}


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    folder = tmp_path_factory.mktemp("results")
    return {name: qs.run(case, file=folder / f"{name}.h5") for name, case in CASES.items()}


@pytest.fixture(scope="module")
def motion() -> Any:
    axes = [[1, 0, 1], [1, 0, 2], [0, 1, 1]]
    times = np.linspace(0.0, 10.0, 51)
    return qs.Body(0.5).integrate(qs.flow("shear"), times, orientation=axes)


def test_a_result_tells_what_it_holds(results: dict[str, Any]) -> None:
    """Names, shapes and units of datasets, events, fields and the table."""
    orbit, field, sweep = (results[name] for name in ("motion", "field", "sweep"))
    shown = repr(orbit)
    for part in (
        ": An orbit>",
        "position 101x3          centre of the body [c]",
        "time 101                instants of the samples [tau]",
        "events.half_turns 4: axis [1], drift [c],",
        "summary: case, complete, end,",
    ):
        assert part in shown, part
    assert "fields.plane 1x108: " in repr(field)
    assert "velocity [c/tau]" in repr(field)
    sweep = qs.load(sweep.path)
    assert "  axis 3x101x3              symmetry axis D3 [1]" in repr(sweep)
    assert "  table: aspect_ratio, status, period," in repr(sweep)
    assert isinstance(sweep.arrays, LazyArrays)
    assert set(sweep.arrays._held) == {"table"}, "nothing is read to tell what there is"
    for result in results.values():
        assert max(map(len, repr(result).splitlines()[1:])) <= 110
        assert len(repr(result).splitlines()) < 30


def test_suspensions_show_their_numbers_in_a_few_lines() -> None:
    rod, shear = qs.Body(0.2), qs.flow("shear")
    lines = repr(qs.rheology(rod, shear, [0.1, 10.0])).splitlines()
    assert lines[0] == "<Rheology: a dilute suspension>"
    assert "  intrinsic_viscosity 5.80561 4.33821" in lines, lines
    assert "  particle_stress, hydrodynamic_stress" in lines[6]
    assert len(repr(qs.langevin(rod, shear, 10.0, trajectories=64)).splitlines()) < 12


def test_events_and_fields_are_at_hand(results: dict[str, Any]) -> None:
    orbit, field = results["motion"], results["field"]
    assert orbit.events.half_turns.time.shape == (4,)
    assert np.array_equal(orbit.events["half_turns"]["axis"], orbit.events.half_turns.axis)
    assert repr(orbit.events.half_turns).splitlines()[0].split() == ["axis", "[1]", "(4,", "3)"]
    assert "half_turns" in dir(orbit.events)
    assert orbit.fields.axis is orbit.axis
    assert field.fields.plane.velocity.shape == (1, 108, 3)
    assert "plane.velocity [c/tau]" in repr(field.fields)
    assert {"axis", "events", "fields", "plot", "export"} <= set(dir(orbit))
    assert "axis" in orbit._ipython_key_completions_()
    with pytest.raises(AttributeError, match="no turns; there are half_turns"):
        orbit.events.turns  # noqa: B018


def test_info_lists_them_with_units(results: dict[str, Any], run_cli: Run) -> None:
    told = run_cli("info", str(results["motion"].path)).stdout
    for part in ("Events\n  half_turns 4", "jeffery_period", "15.708 tau\n", "wall_times.motion"):
        assert part in told
    about = json.loads(run_cli("info", str(results["field"].path), "--json").stdout)
    assert "velocity" in about["fields"]["plane"]
    assert about["datasets"]["axis"]["shape"] == [1, 3]
    table = run_cli("info", str(results["sweep"].path)).stdout
    assert "Table\n  aspect_ratio" in table
    assert "twice the mean time of a half-turn of the axis [tau]" in " ".join(table.split())


def test_a_motion_is_a_few_lines(motion: Any) -> None:
    shown = repr(motion)
    assert shown.startswith("<Motion: 3 lanes, 51 instants, t = 0 to 10; ")
    assert "position, axis, velocity" in shown
    assert "(3, 51, 3)" in shown
    assert len(shown.splitlines()) < 8


def drawn(axes: Any) -> int:
    return len(axes.lines) + len(axes.collections) + len(axes.patches)


@pytest.mark.parametrize(
    ("name", "kind", "roles"),
    [
        ("motion", "orbit", {}),
        ("motion", "angular_velocity", {}),
        ("motion", "position", {}),
        ("field", "velocity-field", {}),
        ("sweep", "period", {}),
        ("sweep", "", {"x": "aspect_ratio", "y": "steps", "scale": "semilogx"}),
    ],
)
def test_pictures_go_into_axes_of_ones_own(
    name: str, kind: str, roles: dict[str, Any], results: dict[str, Any]
) -> None:
    before = dict(matplotlib.rcParams)
    axes = Figure().subplots()
    assert results[name].plot(kind, ax=axes, **roles) is axes
    assert drawn(axes) > 0
    figure = results[name].plot(kind, **roles)
    assert isinstance(figure, Figure)
    assert drawn(figure.axes[0]) > 0
    assert dict(matplotlib.rcParams) == before


def test_quantities_in_ones_own_axes_are_the_file_s(results: dict[str, Any], motion: Any) -> None:
    first, second = Figure().subplots(1, 2)
    results["motion"].plot("angular_velocity", ax=first)
    assert [line.get_ydata().tolist() for line in first.lines] == (
        results["motion"].angular_velocity.T.tolist()
    )
    assert "angular velocity" in first.get_ylabel()
    motion.plot("axis", ax=second, lane=2)
    assert [line.get_ydata().tolist() for line in second.lines] == motion.axis[2].T.tolist()
    both = Figure().subplots(2)
    results["motion"].plot("constant", ax=both)
    assert all(map(drawn, both))


def test_a_picture_shows_in_a_notebook(results: dict[str, Any], motion: Any) -> None:
    for figure in (results["motion"].plot(), results["field"].plot(), motion.plot("overview")):
        assert figure._repr_png_()[:8] == b"\x89PNG\r\n\x1a\n"
    assert results["motion"].kinds == ["orbit", "rotation", "constant", "overview"]


@pytest.mark.parametrize(
    ("draw", "told"),
    [
        (lambda r, m: r.plot("nonsense"), "nothing to draw as 'nonsense'; there are orbit, rot"),
        (lambda r, m: r.plot("constant", ax=Figure().subplots()), "more panels than the axes"),
        (lambda r, m: r.plot(x="steps"), "is not a sweep"),
        (lambda r, m: m.plot(lane=3), "lane is 3; a number from 0 to 2"),
    ],
)
def test_what_cannot_be_drawn_is_told(
    draw: Callable[[Any, Any], Any], told: str, results: dict[str, Any], motion: Any
) -> None:
    with pytest.raises((CaseError, SceneError), match=told):
        draw(results["motion"], motion)


def test_command_draws_a_quantity(results: dict[str, Any], run_cli: Run, tmp_path: Path) -> None:
    done = run_cli("plot", str(results["motion"].path), "--kind", "axis", "-o", tmp_path / "a.svg")
    assert done.returncode == 0
    assert (tmp_path / "a.svg").exists()


def test_flow_in_space_and_at_several_instants(tmp_path: Path) -> None:
    """Colours are |u| in space, on one scale; far from the body that of the flow alone."""
    plane = {"extent": [-9, 9, -6, 6], "shape": [19, 13], "frame": "space"}
    start = {"position": [0, 0.5, 0], "orientation": {"axis": [1, 1, 0]}}
    time = {"end": 2, "samples": 5, "tolerance": 1e-6}
    field = {"every": 2, "plane": plane, "vtk": False, "check": 0}
    case = {**SHEAR, "start": start, "time": time, "field": field}
    result = qs.run(case, file=tmp_path / "passing.h5")
    assert {"velocity-field", "lab-field", "instants"} <= set(result.kinds)
    sheet = result.plot("instants")
    panels = [axes for axes in sheet.axes if axes.get_title(loc="left")]
    assert [axes.get_title(loc="left") for axes in panels] == ["$t = 0$", "$t = 1$", "$t = 2$"]
    meshes = [axes.collections[0] for axes in panels]
    assert len({mesh.norm.vmax for mesh in meshes}) == 1
    corners = [np.asarray(mesh.get_array()).reshape(13, 19)[0, 0] for mesh in meshes]
    assert np.allclose(corners, 6.0, rtol=0.02)  # |x2|, and of the body what decays as 1/r^2
    alone = result.plot("lab-field").axes[0].collections[0]
    assert np.array_equal(alone.get_array(), meshes[-1].get_array())
    moved = result.plot("velocity-field").axes[0].collections[0].get_array()
    corner = np.asarray(moved).reshape(13, 19)[0, 0]
    assert np.isclose(corner, 6.5, rtol=0.02)  # relative to the centre, at x2 = 1/2
