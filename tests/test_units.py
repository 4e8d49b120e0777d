"""Physical units: scales, numbers with units in cases, results converted."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import Run

import qbxstokes as qs
from qbxstokes import quantities
from qbxstokes.case.load import case_of
from qbxstokes.case.units import UNITS_OF
from qbxstokes.cli.pages import PAGES
from qbxstokes.errors import CaseError, MissingPackageError, ResultFileError
from qbxstokes.quantity import Quantity
from qbxstokes.units import Scales, has_unit

pint = pytest.importorskip("pint")

GIVEN = {
    "length": "50 um",
    "rate": "5 1/s",
    "viscosity": "2 Pa*s",
    "body_density": "2600 kg/m^3",
    "fluid_density": "1260 kg/m^3",
    "gravity": "9.81 m/s^2",
}
C, TAU, MU = 50e-6, 0.2, 2.0
CASE: dict[str, Any] = {
    "units": GIVEN,
    "body": {"aspect_ratio": 0.5, "inertia": "rotation"},
    "flow": {"type": "shear", "rate": "2.5 1/s"},
    "start": {"position": [0, "20 um", 0], "orientation": {"axis": [1, 0, 1]}},
    "forces": {"force": [0, 0, "1 nN"], "torque": [0, "2 nN*um", 0]},
    "time": {"end": "3 s", "samples": 4, "tolerance": 1e-6},
    "compare": {"reference": "none"},
}


def test_numbers_follow_from_the_scales() -> None:
    """St, Re and G by the formulas of the page."""
    case = case_of(CASE).case
    assert case.body.stokes_number == pytest.approx(2600 * C**2 / (MU * TAU), rel=1e-14)
    weight = (2600 - 1260) * 9.81 * C * TAU / MU
    assert case.forces.gravity.number == pytest.approx(weight, rel=1e-14)
    assert Scales(GIVEN).reynolds_number == pytest.approx(1260 * C**2 / (MU * TAU), rel=1e-14)
    assert case.flow.spec()["rate"] == pytest.approx(0.5)
    assert case.start.position == pytest.approx((0, 20e-6 / C, 0))
    assert case.forces.force == pytest.approx((0, 0, 1e-9 / (MU * C**2 / TAU)))
    assert case.forces.torque == pytest.approx((0, 2e-15 / (MU * C**3 / TAU), 0))
    assert case.time.end == pytest.approx(3 / TAU)


def test_a_time_stands_for_its_rate() -> None:
    other = {**GIVEN, "time": "200 ms"}
    del other["rate"]
    first, second = case_of({**CASE, "units": other}).case, case_of(CASE).case
    assert first.body.stokes_number == pytest.approx(second.body.stokes_number, rel=1e-14)
    assert first.time.end == pytest.approx(second.time.end, rel=1e-14)


@pytest.mark.parametrize(
    ("key", "value", "number"),
    [
        ("flow", {"type": "stokeslet", "strength": ["1 nN", 0, 0], "position": [0, "1 mm", 0]}, 0),
        ("flow", {"type": "plane_poiseuille", "half_width": "1 mm", "speed": "1 mm/s"}, 0),
        ("flow", {"type": "sum", "terms": [{"type": "shear", "rate": "5 1/s"}]}, 0),
        ("flow", {"type": "linear", "gradient": [[0, "3*cos(t)", 0], [0, 0, 0], [0, 0, 0]]}, 0),
        ("time", {"at": ["1 s", "2 s"]}, 0),
        ("constraints", {"rotation": [0, 0, "5 1/s"]}, 0),
    ],
)
def test_flows_and_lists_take_units(key: str, value: Any, number: int) -> None:
    loaded = case_of({**CASE, key: value})
    place = np.array([0.1, 0.2, 0.3])
    if key == "time":
        assert loaded.case.time.at == pytest.approx((5.0, 10.0))
    elif key == "constraints":
        assert loaded.case.constraints.rotation == pytest.approx((0, 0, 1))
    elif value["type"] == "stokeslet":
        plain = {"strength": [1e-9 * TAU / (MU * C**2), 0, 0], "position": [0, 1e-3 / C, 0]}
        same = qs.flow("stokeslet", **plain).velocity(place)
        assert loaded.flow.velocity(place) == pytest.approx(same)
    elif value["type"] == "plane_poiseuille":
        assert loaded.flow.velocity(place)[0] == pytest.approx(
            1e-3 * TAU / C * (1 - (0.2 / 20) ** 2)
        )
    elif value["type"] == "sum":
        assert loaded.flow.velocity(place) == pytest.approx([0.2, 0, 0])
    else:
        assert loaded.flow.gradient(place, 0.5)[0, 1] == pytest.approx(3 * np.cos(0.5))


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"start.position": ["1 s", 0, 0]}, r"start.position\[0\]: '1 s' is no quantity in .* µm;"),
        ({"time.end": "1 furlong"}, r"time.end: '1 furlong' is no quantity in units such as s;"),
        ({"time.end": "1 blub"}, r"time.end: '1 blub' is no quantity"),
        ({"body.aspect_ratio": "3 um"}, r"body.aspect_ratio: '3 um' is not a number"),
        ({"units.length": "10 s"}, r"units.length: is '10 s'; write one such as 10 um"),
        ({"units.length": 10}, r"units.length: is 10; a number with its unit, such as 10 um"),
        ({"units.length": "-1 um"}, r"units.length: is '-1 um'; write one such as 10 um"),
        ({"units.time": "1 s"}, r"units.rate: stands beside time"),
        ({"units.lenght": "1 um"}, r"units.lenght: unknown key; did you mean length\?"),
        ({"body.stokes_number": 2}, r"body.stokes_number: stands beside units.body_density"),
        ({"forces.gravity.number": 2}, r"forces.gravity.number: stands beside units.gravity"),
    ],
)
def test_wrong_units_are_told_in_a_line(change: dict[str, Any], told: str) -> None:
    case = {name: dict(v) if isinstance(v, dict) else v for name, v in CASE.items()}
    for key, value in change.items():
        *path, last = key.split(".")
        holder = case
        for part in path:
            holder = holder.setdefault(part, {})
        holder[last] = value
    with pytest.raises(CaseError, match=told) as raised:
        case_of(case)
    assert "\n" not in str(raised.value)


def test_bodies_of_one_fluid_have_the_density_of_the_units() -> None:
    bodies = [{"aspect_ratio": 0.5, "start": {"position": [x, 0, 0]}} for x in (0, "200 um")]
    case: dict[str, Any] = {**CASE, "bodies": bodies}
    del case["body"], case["start"]
    loaded = case_of(case)
    number = Scales(CASE["units"]).stokes_number
    assert [body.stokes_number for body in loaded.case.members] == [number, number]
    bodies[1]["stokes_number"] = 1.0
    told = r"bodies\[1\].stokes_number: stands beside units.body_density"
    with pytest.raises(CaseError, match=told):
        case_of(case)


def test_a_force_needs_a_viscosity() -> None:
    few = {"length": "50 um", "rate": "5 1/s"}
    with pytest.raises(CaseError, match=r"forces.force\[2\]: '1 nN' needs units.viscosity"):
        case_of({**CASE, "units": few})


def test_pint_is_asked_for_where_it_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    from qbxstokes.units import _registry

    _registry.cache_clear()
    monkeypatch.setitem(sys.modules, "pint", None)
    with pytest.raises(MissingPackageError, match="needs pint, which is not installed"):
        case_of(CASE)


def test_pint_is_loaded_for_units_alone() -> None:
    script = (
        "import sys, qbxstokes as qs\nfrom qbxstokes.case.load import case_of\n"
        "case_of({'body': {'aspect_ratio': 1}, 'flow': {'type': 'shear'}, 'time': {'end': 1}})\n"
        "assert 'pint' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", script], check=True)


@pytest.mark.parametrize(
    ("text", "is_one"),
    [
        *[(text, True) for text in ("3 um", "3um", "1e-3 m", "5 1/s")],
        *[(text, False) for text in ("90 deg", "90°", "3", "abc", "locked", "2d.py:wind")],
    ],
)
def test_numbers_with_units_are_known(text: str, is_one: bool) -> None:
    assert has_unit(text) is is_one


def every_quantity() -> dict[str, str]:
    """Units of all that can be recorded."""
    found = {}
    for name, value in vars(quantities).items():
        for quantity in value.values() if isinstance(value, dict) else [value]:
            if isinstance(quantity, Quantity):
                found[f"{name}.{quantity.name}"] = quantity.units
    return found


def test_every_quantity_has_its_scale() -> None:
    """By the dimensions that its units stand for, against scales in SI by hand."""
    scales = Scales(GIVEN)
    unknown = {"", "1", "rad", "s", "1/rate"}
    for name, units in every_quantity().items():
        if units in unknown or ", " in units:  # of a matrix, see below
            continue
        by_hand = eval(  # texts of this program
            re.sub(r"(?<=\w) (?=\w)", "*", units.replace("^", "**")),
            {"c": C, "tau": TAU, "mu": MU},
        )
        assert scales.scale(units).to_base_units().magnitude == pytest.approx(by_hand), name


def test_results_are_converted(tmp_path: Path, run_cli: Run) -> None:
    path = tmp_path / "fibre.h5"
    plain = qs.run(CASE, file=path)
    physical = qs.load(path, units=True)
    scale = {"time": TAU, "position": C * 1e6, "velocity": C * 1e6 / TAU, "axis": 1.0}
    scale |= {"angular_velocity": 1 / TAU, "force": MU * C**2 / TAU * 1e9}
    for name, factor in scale.items():
        assert physical[name] == pytest.approx(plain[name] * factor, rel=1e-13), name
    units = {name: physical.attributes[name]["units"] for name in scale}
    assert units["time"] == "s"
    assert units["position"] == "µm"
    assert units["velocity"] == "µm/s"
    assert units["force"] == "nN"
    assert units["axis"] == "1"
    turns = physical.events.get("half_turns")
    if turns:
        assert turns.time == pytest.approx(plain.events.half_turns.time * TAU)
    assert plain.scales["stokes_number"] == pytest.approx(2600 * C**2 / (MU * TAU))
    assert plain.scales["length"] == "50 µm"
    assert "position 4x3          centre of the body [µm]" in repr(physical)
    assert physical.plot("axis") is not None
    done = run_cli("export", path, "--units", "-o", tmp_path / "out.csv")
    assert done.returncode == 0, done.stderr
    head = (tmp_path / "out.csv").read_text(encoding="utf-8").splitlines()[0].split(",")
    assert head[0] == "time [s]"
    assert {"position_1 [µm]", "velocity_3 [µm/s]", "axis_1"} <= set(head)
    shown = run_cli("info", path).stdout
    assert "stokes_number" in shown


def test_sweeps_and_bodies_are_converted() -> None:
    swept = qs.sweep(CASE, {"body.aspect_ratio": [0.5, 2.0]})
    physical = swept.in_units()
    assert physical.table["end"] == pytest.approx(swept.table["end"] * TAU)
    assert physical.table["aspect_ratio"].tolist() == [0.5, 2.0]
    assert physical.attributes["table"]["end: units"] == "s"
    assert physical.position == pytest.approx(swept.position * C * 1e6)
    assert physical.trajectory(1).time == pytest.approx(swept.trajectory(1).time * TAU)
    with pytest.raises(CaseError, match=r"units.rate: are those of all trajectories; sweep what"):
        qs.sweep(CASE, {"units.rate": ["5 1/s", "10 1/s"]})
    body = qs.run({"task": "body", "units": GIVEN, "body": {"aspect_ratio": 0.5}})
    physical = body.in_units()
    force, torque = MU * C * 1e9 / 1e6, MU * C**3 * 1e9 * 1e6  # nN s/um and nN um s
    assert physical.resistance[0, 0] == pytest.approx(body.resistance[0, 0] * force)
    assert physical.attributes["resistance"]["units"] == "nN*s/µm, µm*nN*s"
    assert physical.resistance[3, 3] == pytest.approx(body.resistance[3, 3] * torque)


def test_without_scales_there_are_no_units(tmp_path: Path) -> None:
    case = {name: CASE[name] for name in ("body", "flow", "time")}
    case |= {"flow": {"type": "shear"}, "time": {"end": 1.0, "samples": 2}}
    qs.run(case, file=tmp_path / "plain.h5")
    with pytest.raises(ResultFileError, match="holds no physical scales; a section `units`"):
        qs.load(tmp_path / "plain.h5", units=True)
    assert qs.load(tmp_path / "plain.h5").scales == {}


def test_the_page_names_every_key_that_takes_a_unit() -> None:
    page = (PAGES / "units.md").read_text(encoding="utf-8")
    part = page.partition("## Keys that take a unit")[2].partition("## Results")[0]
    named = set(re.findall(r"`(\w+\.[\w.]+)`", part)) - {"units.rate"}
    assert named == set(UNITS_OF)


def test_a_fluid_with_inertia_is_remarked(write_case: Any, run_cli: Run) -> None:
    thin = {**GIVEN, "viscosity": "1 mPa*s", "length": "1 mm", "gravity": "9.81 m/s^2"}
    path = write_case({**CASE, "units": thin, "forces": {}})
    done = run_cli(path.name)
    assert "Reynolds number 6.3 at the scale of the body" in done.stderr
    assert "Re = 6.3" in done.stdout
