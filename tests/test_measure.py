"""Bodies without a motion, measured sweeps, and what is drawn of both."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import ROOT, Run

import qbxstokes as qs
from qbxstokes.case.load import load_case
from qbxstokes.cli.pictures import drawings, picture_command
from qbxstokes.errors import CaseError, ConvergenceError
from qbxstokes.plots import style
from qbxstokes.quantities import BODY
from qbxstokes.runs.plan import plan_body
from qbxstokes.simulation.hydrodynamics import true_error

WriteCase = Callable[..., Path]

BARE: dict[str, Any] = {
    "task": "body",
    "body": {"aspect_ratio": 0.5},
    "hydrodynamics": {"tolerance": 1e-8},
}
PLACE = {"position": [0.0, 1.0, 0.0], "orientation": {"axis": [1.0, 0.0, 1.0]}}
FLOWS = {
    "linear": {"type": "shear", "rate": 2.0},
    "quadratic": {"type": "paraboloid", "curvature": 0.3},
    "singular": {"type": "stokeslet", "strength": [1.0, 0.5, 0.0], "position": [0.0, 4.0, 0.0]},
    "recognised": {
        "type": "user",
        "function": lambda x: np.stack([x[:, 1], *np.zeros((2, len(x)))], 1),
    },
}
EVERY_STEP = {"hydrodynamics": {"tolerance": 1e-8, "solve": "every_step"}}


def refused(case: dict[str, Any], write: WriteCase) -> str:
    with pytest.raises(CaseError) as caught:
        load_case(write(case))
    return str(caught.value)


# -- a body ----------------------------------------------------------------------------------------


def test_a_body_says_what_python_says() -> None:
    result, body = qs.run(BARE), qs.Body(0.5, tolerance=1e-8)
    assert result.task == "body"
    assert sorted(result.names) == [
        *("cubic", "kim_karrila", "linear", "mobility", "quadratic", "resistance"),
        "stresslet_numbers",
    ]
    np.testing.assert_array_equal(result.resistance, body.resistance)
    np.testing.assert_array_equal(result.mobility, body.mobility)
    law = body.model.faxen
    assert result.linear == law.linear
    np.testing.assert_array_equal(result.quadratic, law.quadratic)
    np.testing.assert_array_equal(result.cubic, law.cubic)
    hydro, summary = result.summary["hydrodynamics"], result.summary
    assert hydro["error_estimate"] == body.error_estimate
    assert hydro["error_parts"] == vars(body.model.error_parts)
    assert summary["errors"]["law"] == true_error(body.model)
    assert summary["errors"]["stresslet"] < summary["stresslet_error_estimate"] < 1e-8
    np.testing.assert_array_equal(result.stresslet_numbers[:3], body.stress.numbers)
    assert summary["largest_error"] < hydro["error_estimate"] < 1e-8
    assert hydro["solves"] == 4
    assert hydro["iterations"] >= 4
    assert hydro["true_residual"] < 1e-9
    assert summary["setup_time"] > 0.0
    assert summary["nodes"] == hydro["n_theta"] * hydro["n_phi"]
    for name in result.names:
        assert result.attributes[name]["units"] == BODY[name].units


@pytest.mark.parametrize(
    ("flow", "change"), [*((name, {}) for name in FLOWS), ("quadratic", EVERY_STEP)]
)
def test_a_body_in_a_flow_moves_or_is_held(flow: str, change: dict[str, Any]) -> None:
    result = qs.run({**BARE, "flow": FLOWS[flow], "start": PLACE, **change})
    background = qs.flow(**FLOWS[flow])
    body = qs.Body(0.5, tolerance=1e-8, hydrodynamics=change.get("hydrodynamics"))
    place, axis = PLACE["position"], PLACE["orientation"]["axis"]
    u, omega = body.free_motion(background, place, axis)
    force, torque = body.force_torque(background, place, axis)
    same = np.testing.assert_allclose if change else np.testing.assert_array_equal
    for name, values in (
        ("free_velocity", u),
        ("free_angular_velocity", omega),
        ("held_force", force),
        ("held_torque", torque),
    ):
        # The operators of each step have no resistance in them where no force is asked for.
        same(result[name], values, **({"atol": 1e-12} if change else {}))
        assert result.summary["errors"][name] < 1e-8


def test_the_flow_decides_what_the_law_is_for(write_case: WriteCase) -> None:
    known = {"linear": "degree <= 1", "quadratic": "degree <= 2", "singular": "any flow"}
    for name, words in known.items():
        assert words in plan_body(load_case(write_case(BARE | {"flow": FLOWS[name]}))).needs[0]
    assert "degree <= 3" in plan_body(load_case(write_case(BARE))).needs[0]


def test_commands_behave_as_for_a_motion(
    run_cli: Run, write_case: WriteCase, tmp_path: Path
) -> None:
    write_case(BARE | {"flow": FLOWS["quadratic"], "start": PLACE})
    done = run_cli("case.yaml", "--dry-run")
    assert done.returncode == 0
    assert "force and torque on the held one" in done.stdout
    assert "nothing is integrated" in done.stdout
    assert json.loads(run_cli("case.yaml", "--dry-run", "--json").stdout)["plan"]["needs"]
    assert [path.name for path in tmp_path.iterdir()] == ["case.yaml"]
    done = run_cli("case.yaml", "--explain")
    assert done.returncode == 0, done.stderr
    for word in ("Plan", "GMRES", "held force", "free velocity", "Errors", "case.h5"):
        assert word in done.stdout
    assert max(map(len, done.stdout.splitlines())) <= 80
    told = run_cli("info", "case.h5").stdout
    assert "held_force 3" in told
    assert "[mu c^2/tau]" in told
    assert run_cli("case.yaml", "--quiet", "--overwrite").stdout == ""
    facts = json.loads(run_cli("case.yaml", "--json", "--overwrite").stdout)
    assert facts["held_force"] == qs.load(tmp_path / "case.h5").held_force.tolist()
    assert run_cli("check", "case.yaml").stdout == "case.yaml: valid, task body\n"


def test_an_error_above_the_limit_is_told(run_cli: Run, write_case: WriteCase) -> None:
    write_case(BARE | {"compare": {"tolerance": 1e-30}})
    done = run_cli("case.yaml", "--quiet")
    assert done.returncode == ConvergenceError.exit_status
    assert "exceeds compare.tolerance 1e-30" in done.stderr
    write_case(BARE | {"compare": {"reference": "none", "tolerance": 1e-30}})
    assert run_cli("case.yaml", "--quiet").returncode == 0


@pytest.mark.parametrize(
    ("change", "wrong"),
    [
        ({"time": {"end": 1}}, "time: has no meaning for task: body"),
        ({"forces": {"force": [1, 0, 0]}}, "forces: has no meaning for task: body"),
        ({"start": PLACE}, "start: has no meaning without a flow"),
        (EVERY_STEP, "hydrodynamics.solve: has no meaning without a flow"),
        ({"body": {"aspect_ratio": 1, "stokes_number": 1}}, "body.stokes_number: has no meaning"),
        ({"hydrodynamics": {"cache": "x"}}, "hydrodynamics.cache: has no meaning"),
        ({"flow": {"rate": 1}}, "flow.type: is missing"),
        ({"flow": {"type": "sheer"}}, "did you mean shear"),
        ({"task": "motion", "time": {"end": 1}}, "flow: is missing"),
    ],
)
def test_what_has_no_meaning_is_refused(
    change: dict[str, Any], wrong: str, write_case: WriteCase
) -> None:
    assert wrong in refused(BARE | change, write_case)


# -- sweeps of bodies ------------------------------------------------------------------------------


def test_a_sweep_of_bodies_has_a_row_for_each() -> None:
    k = [0.2, 3.0]
    result = qs.sweep(BARE, {"body.aspect_ratio": k, "hydrodynamics.tolerance": [1e-4, 1e-8]})
    table = result.table
    assert result.shape == (2, 2)
    assert result.names == ["aspect_ratio", "hydrodynamics_tolerance", "table", "trajectory"]
    assert not [name for name in table.dtype.names if name.startswith(("held_", "free_"))]
    assert np.all(table["status"] == 1)
    single = qs.run({**BARE, "body": {"aspect_ratio": 3.0}})
    row, summary = table[3], single.summary
    for name, value in summary["resistance"].items():
        assert row[f"resistance_{name}"] == value
    assert row["linear"] == single.linear
    assert [row[f"cubic_{i}"] for i in range(4)] == single.cubic.tolist()
    assert row["error"] == summary["errors"]["law"]
    for name in ("error_estimate", "iterations", "true_residual", "n_theta", "expansion_order"):
        assert row[name] == summary["hydrodynamics"][name]
    assert row["nodes"] == summary["nodes"]
    assert np.all(table["error"] < table["hydrodynamics_tolerance"])
    assert np.all(table["setup_time"] > 0.0)
    assert result.attributes["table"]["resistance_rotation_axial: units"] == "mu c^3"


def test_bodies_are_swept_in_a_flow_and_over_words() -> None:
    case = {**BARE, "flow": FLOWS["linear"], "start": PLACE, "hydrodynamics": {"tolerance": 1e-6}}
    axes = {"flow.rate": [1.0, 2.0], "hydrodynamics.expansion": ["inner", "average"]}
    table = qs.sweep(case, axes).table
    assert set(table["hydrodynamics_expansion"]) == {b"inner", b"average"}
    velocity = table["free_velocity_1"].reshape(2, 2)
    np.testing.assert_allclose(velocity, [[1.0, 1.0], [2.0, 2.0]], rtol=1e-6)
    assert np.all(table["error"] < 1e-6)


def test_what_cannot_be_formed_fails_alone(run_cli: Run, write_case: WriteCase) -> None:
    axes = [{"body.aspect_ratio": [0.5, 0.001]}]
    write_case({**BARE, "hydrodynamics": {"tolerance": 1e-13}, "sweep": {"axes": axes}})
    done = run_cli("case.yaml", "--progress", "none")
    assert done.returncode == 1
    assert "1 done, 1 failed, each alone" in done.stdout
    assert "trajectory 1 failed: the estimated error" in done.stderr


# -- measured motions ------------------------------------------------------------------------------

MOTION: dict[str, Any] = {
    "body": {"aspect_ratio": 0.5},
    "flow": {"type": "shear"},
    "start": {"orientation": {"axis": [1.0, 0.0, 1.0]}},
    "time": {"end": 6.0, "samples": 7, "tolerance": 1e-8},
    "hydrodynamics": {"tolerance": 1e-6},
}
MEASURE = {"measure": {"repeats": 1}}


@pytest.mark.parametrize("stokes", [0.0, 2.0])
def test_a_measured_trajectory_is_the_single_motion(stokes: float) -> None:
    case = {**MOTION, "body": {"aspect_ratio": 0.5, "stokes_number": stokes}}
    result = qs.sweep(case, {"time.tolerance": [1e-4, 1e-8]}, **MEASURE)
    table, alone = result.table, qs.run(case)
    np.testing.assert_array_equal(result.orientation[1], alone.orientation)
    steps = alone.summary["integration"]
    row = table[1]
    assert row["steps"] == steps["steps"]
    times = alone.time  # what watches for events takes some right-hand sides of its own
    end = qs.from_case(case).assemble().trajectory(times).checkpoint
    assert row["rhs_evaluations"] == end.evaluations
    assert row["rejected"] == steps["rejected"]
    assert row["error"] == max(alone.summary["errors"].values())
    assert table["error"][0] > table["error"][1] > 0.0
    assert np.all(table["iterations"] == 4)
    assert np.all((table["wall_time"] > 0.0) & (table["setup_time"] > 0.0))
    # The body of both is the same, and its set-up measured once.
    assert len(set(table["setup_time"].tolist())) == 1


def test_every_step_counts_its_iterations_and_no_reference_is_no_error() -> None:
    case = {
        **MOTION,
        "time": {"end": 0.2, "samples": 2, "tolerance": 1e-3},
        "compare": {"reference": "none"},
    }
    axes = {"hydrodynamics.solve": ["functional", "every_step"]}
    table = qs.sweep(case, axes, **MEASURE).table
    assert table["iterations"][0] == 4
    assert table["iterations"][1] >= 4 + table["rhs_evaluations"][1]
    assert np.all(np.isnan(table["error"]))
    for flow in ("singular", "quadratic"):  # with inertia, no path is known in either
        heavy = {"body": {"aspect_ratio": 0.5, "stokes_number": 1.0}, "flow": FLOWS[flow]}
        known = {**case, **heavy, "start": PLACE, "compare": {"reference": "auto"}}
        (unknown,) = qs.sweep(known, {"body.aspect_ratio": [0.5]}, **MEASURE).table
        assert np.isnan(unknown["error"])
        assert unknown["steps"] > 0


def test_options_of_petsc_are_swept_where_each_is_alone(write_case: WriteCase) -> None:
    methods = {"petsc.ts_type": [None, "rk", "bdf"], "petsc.ts_rk_type": [None, "3bs", None]}
    sweep = {"axes": [methods, {"petsc.ts_bdf_order": [2, 6]}]}
    case = {**MOTION, "time": {"end": 2.0, "samples": 3, "tolerance": 1e-4}}
    table = qs.run({**case, "sweep": {**sweep, **MEASURE}}).table
    assert table["petsc_ts_type"].tolist() == [b"null"] * 2 + [b"rk"] * 2 + [b"bdf"] * 2
    steps = table["steps"].reshape(3, 2)
    assert np.all(steps[:2, 0] == steps[:2, 1])
    assert steps[2, 0] != steps[2, 1]  # the order is heeded, and by that method alone
    assert len(set(steps[:, 1].tolist())) == 3
    message = refused({**case, "sweep": sweep}, write_case)
    assert "petsc is the same for all trajectories; sweep other keys, or set sweep.meas" in message


def test_without_measure_nothing_is_measured() -> None:
    table = qs.sweep(MOTION, {"time.tolerance": [1e-4]}, store="summary", measure=False).table
    assert not {"setup_time", "error", "iterations"} & set(table.dtype.names)


def test_an_error_above_the_limit_fails_the_trajectory(run_cli: Run, write_case: WriteCase) -> None:
    axes = [{"time.tolerance": [1e-2, 1e-8]}]
    sweep = {"axes": axes, **MEASURE, "store": "summary"}
    path = write_case({**MOTION, "compare": {"tolerance": 1e-5}, "sweep": sweep})
    done = run_cli(path.name, "--progress", "none")
    assert done.returncode == 1
    assert "trajectory 0 failed: error" in done.stderr
    assert "exceeds compare.tolerance 1e-05" in done.stderr
    table = qs.load(path.with_suffix(".h5")).table
    assert table["status"].tolist() == [2, 1]
    assert table["error"][0] > 1e-5 > table["error"][1]


def test_plans_say_that_each_is_measured(run_cli: Run, write_case: WriteCase) -> None:
    sweep = {"axes": [{"time.tolerance": [1e-2, 1e-8]}], "measure": True}
    write_case({**MOTION, "sweep": sweep})
    told = run_cli("case.yaml", "--dry-run").stdout
    assert "each alone, once to warm up and 5 times" in told
    write_case({**BARE, "sweep": {"axes": [{"body.aspect_ratio": [1, 2]}]}})
    told = run_cli("case.yaml", "--dry-run").stdout
    assert "2 bodies (2)" in told
    assert "motion: nothing is integrated" in told
    write_case({**MOTION, "sweep": sweep | {"measure": {"repeats": 0}}})
    assert "sweep.measure.repeats: is 0" in run_cli("case.yaml", "--dry-run").stderr


@pytest.mark.mpi
def test_ranks_share_measured_trajectories(
    run_cli: Run, mpirun: Run, write_case: WriteCase, tmp_path: Path
) -> None:
    axes = [{"body.aspect_ratio": [0.5, 2.0]}, {"time.tolerance": [1e-2, 1e-4]}]
    write_case({**MOTION, "sweep": {"axes": axes, **MEASURE}})
    assert run_cli("case.yaml", "--quiet", "--set", "output.file=one.h5").returncode == 0
    done = mpirun(2, "case.yaml", "--quiet", "--set", "output.file=two.h5")
    assert done.returncode == 0, done.stderr
    one, two = (qs.load(tmp_path / name) for name in ("one.h5", "two.h5"))
    for name in one.table.dtype.names:
        if not name.endswith("_time"):
            np.testing.assert_array_equal(one.table[name], two.table[name])
    np.testing.assert_array_equal(one.orientation, two.orientation)


# -- pictures --------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A measured sweep over a method, an aspect ratio and a tolerance."""
    case = {**MOTION, "time": {"end": 2.0, "samples": 3}}
    axes = {
        "petsc.ts_rk_type": [None, "3bs"],
        "body.aspect_ratio": [0.5, 2.0],
        "time.tolerance": [1e-2, 1e-4, 1e-6],
    }
    path = tmp_path_factory.mktemp("measured") / "scene.h5"
    qs.sweep(case, axes, file=path, store="summary", **MEASURE)
    return path


def lines(path: Path, kind: str, **roles: Any) -> Any:
    """Axes of a picture, and its curves by their labels."""
    with style.styled():
        axes = drawings(path, roles=roles)[kind]().axes[0]
    return axes, {line.get_label(): line for line in axes.get_lines()}


def test_a_measured_sweep_is_drawn_as_error_over_time(measured: Path) -> None:
    assert list(drawings(measured)) == ["error"]
    axes, curves = lines(measured, "error")
    assert list(curves) == [f"{way}, $k$ = {k}" for way in ("default", "3bs") for k in ("0.5", "2")]
    table = qs.load(measured).table
    np.testing.assert_array_equal(curves["3bs, $k$ = 2"].get_xdata(), table["wall_time"][9:])
    np.testing.assert_array_equal(curves["3bs, $k$ = 2"].get_ydata(), table["error"][9:])
    assert curves["3bs, $k$ = 2"].get_linestyle() != "None"  # along the tolerance
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("wall time (s)", "error")
    assert axes.get_yscale() == "log"


def test_any_column_is_drawn_over_any_other(measured: Path) -> None:
    roles = {"x": "rhs_evaluations", "y": ["error", "error_estimate"], "by": ["petsc_ts_rk_type"]}
    axes, curves = lines(measured, "error-error_estimate", **roles, scale="loglog")
    both = [f"{name}, {way}" for name in ("error", "error estimate") for way in ("default", "3bs")]
    assert list(curves) == both
    # Rows that differ in shape and tolerance follow no curve.
    assert {line.get_linestyle() for line in curves.values()} == {"None"}
    assert axes.get_xlabel() == "right-hand sides"
    assert (axes.get_xscale(), axes.get_ylabel()) == ("log", "error")
    # What is left open is completed from the axes of the sweep.
    axes, curves = lines(measured, "steps", y=["steps"])
    assert len(curves) == 4
    assert axes.get_xlabel() == "time tolerance"
    axes, _ = lines(measured, "wall_time", x="petsc_ts_rk_type", y=["wall_time"])
    assert [text.get_text() for text in axes.get_yticklabels()] == ["null", "3bs"]


def test_swept_keys_are_named_as_in_the_case(measured: Path, tmp_path: Path) -> None:
    words = ["--x", "time.tolerance", "--y", "error", "--by", "body.aspect_ratio,petsc.ts_rk_type"]
    folder = ["--output", str(tmp_path), "--quiet"]
    assert picture_command("plot", [str(measured), *words, *folder]) == 0
    assert [path.name for path in tmp_path.iterdir()] == ["scene-error.pdf"]


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--x", "walltime", "--y", "error"], "no column 'walltime'; did you mean wall_time"),
        (["--x", "wall_time", "--y", "error_"], "no column 'error_'; did you mean error"),
        (
            ["--x", "wall_time", "--y", "time"],
            "no column 'time'; did you mean .*wall_time",
        ),
        (["--x", "wall_time", "--y", "zzz"], "no column 'zzz'; there are petsc_ts_rk_type, aspect"),
        (["--x", "wall_time", "--y", "petsc.ts_rk_type"], "holds texts, not numbers"),
        (["--x", "wall_time"], "say which column to draw with --y"),
        (["--y", "error", "--by", "steps", "--scale", "log"], "scale is one of loglog"),
        (["--kind", "walltime"], "no summary 'walltime' in this sweep; did you mean wall_time"),
    ],
)
def test_columns_that_are_not_there_are_told(measured: Path, words: list[str], told: str) -> None:
    with pytest.raises(CaseError, match=told):
        picture_command("plot", [str(measured), *words])


def test_bodies_are_drawn_over_what_is_swept(tmp_path: Path) -> None:
    path = tmp_path / "bodies.h5"
    axes = {"body.aspect_ratio": [0.5, 2.0], "hydrodynamics.tolerance": [1e-4, 1e-6]}
    qs.sweep(BARE, axes, file=path)
    assert list(drawings(path)) == [
        *(
            f"resistance_{m}_{d}"
            for m in ("translation", "rotation")
            for d in ("transverse", "axial")
        ),
        *("linear", "error"),
    ]
    drawn, curves = lines(path, "resistance_rotation_axial", y=["resistance_rotation_axial"])
    assert drawn.get_ylabel() == r"resistance to rotation, axial ($\mu c^3$)"
    assert list(curves) == [f"hydrodynamics tolerance = $10^{{{p}}}$" for p in (-4, -6)]


# -- cases -----------------------------------------------------------------------------------------

CASES = ROOT / "cases" / "benchmarks"


def test_integrators_take_the_right_hand_sides_that_are_quoted(
    run_cli: Run, tmp_path: Path
) -> None:
    methods = "{petsc.ts_type: [null, null, bdf], time.tolerance: [1e-4, 1e-8, 1e-4]}"
    changes = (f"sweep={{axes: [{methods}], measure: {{repeats: 1}}}}", "output.file=small.h5")
    words = [word for change in changes for word in ("--set", change)]
    done = run_cli(CASES / "motion_work_precision.yaml", "--quiet", *words)
    assert done.returncode == 0, done.stderr
    table = qs.load(tmp_path / "small.h5").table
    assert table["rhs_evaluations"].tolist()[:2] == [1531, 4901]
    assert np.all(table["error"] < 10.0 * table["time_tolerance"])
    assert table["wall_time"][2] > table["wall_time"][0]
