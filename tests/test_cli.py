"""The command line as a user meets it: exit statuses, one-line errors, options for PETSc."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import ENVIRONMENT, ROOT, Run

import qbxstokes
from qbxstokes.case.describe import starter
from qbxstokes.case.document import parse, read_text
from qbxstokes.case.load import load_case
from qbxstokes.case.schema import FOREIGN, Case
from qbxstokes.cli.main import run_command, split_arguments
from qbxstokes.errors import CaseError
from qbxstokes.geometry import rotation
from qbxstokes.io.results import load
from qbxstokes.motion.diagnostics import jeffery_period
from qbxstokes.runs.destination import target_of
from qbxstokes.runs.parallel import missing_message
from qbxstokes.runs.plan import make_plan, plan_of
from qbxstokes.runs.report import counted, flow_text, shape_text
from qbxstokes.runs.summary import _estimate, _seen

WriteCase = Callable[..., Path]

CASE: dict[str, Any] = {
    "title": "A small run",
    "body": {"aspect_ratio": 0.5},
    "flow": {"type": "shear"},
    "start": {"orientation": {"axis": [1, 1, 1]}},
    "time": {"periods": 1, "samples": 21, "tolerance": 1e-10},
}
MASSIVE = CASE | {"body": {"aspect_ratio": 0.5, "stokes_number": 5}}


def test_words_are_shared_out_between_us_and_petsc() -> None:
    line = "case.yaml --set time.end=-3 -ts_monitor -ksp_rtol 1e-8 --quiet -offset -2.5 -log_view"
    own, petsc = split_arguments(line.split())
    assert own == ["case.yaml", "--set", "time.end=-3", "--quiet"]
    assert petsc == ["-ts_monitor", "-ksp_rtol", "1e-8", "-offset", "-2.5", "-log_view"]
    assert split_arguments(["-h"]) == (["--help"], [])
    assert split_arguments(["-help"]) == ([], ["-help"])


def test_version_and_help_fit_the_terminal(run_cli: Run, run_process: Run) -> None:
    assert run_process("--version").stdout == f"qbxstokes {qbxstokes.__version__}\n"
    done = run_cli("--help")
    assert done.returncode == 0
    lines = done.stdout.splitlines()
    assert len(lines) <= 40
    assert max(map(len, lines)) <= 80


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ([], "name a case file"),
        (["-ts_monitor"], "put the case file before"),
        (["--nonsense"], "--nonsense"),
        (["missing.yaml"], "missing.yaml: no such file"),
        ([str(ROOT)], "is a directory"),
        (["check"], "at least one case"),
        (["check", "missing.yaml"], "missing.yaml: no such file"),
        (["info", "missing.h5"], "missing.h5: no such file"),
        (["info"], "one result file"),
        (["new", "--task", "nothing"], "unknown; one of motion"),
        (["one.yaml", "two.yaml"], "one case at a time"),
    ],
)
def test_wrong_command_lines_end_in_one_line(
    arguments: list[str], expected: str, run_cli: Run, tmp_path: Path
) -> None:
    done = run_cli(*arguments)
    assert done.returncode == 2
    assert expected in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert done.stdout == ""
    assert not os.listdir(tmp_path)


def test_bad_case_writes_nothing(run_cli: Run, write_case: WriteCase, tmp_path: Path) -> None:
    path = write_case("body:\n  aspect_ratio: -2\nflow: {type: shear}\ntime: {end: 1}\n")
    done = run_cli(path.name)
    assert done.returncode == 2
    assert done.stderr == "case.yaml:2: body.aspect_ratio: is -2; must be > 0\n"
    assert os.listdir(tmp_path) == ["case.yaml"]


def test_starter_case_checks(run_cli: Run) -> None:
    assert run_cli("new", "mine.yaml").returncode == 0
    assert run_cli("new", "mine.yaml").returncode == 2  # never over an existing file
    assert run_cli("check", "mine.yaml").stdout == "mine.yaml: valid, task motion\n"


@pytest.mark.parametrize("task", ["field", "body"])
def test_every_task_has_a_starter(task: str, tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(starter(task))
    assert load_case(path).case.task == task


@pytest.mark.parametrize("task", sorted(FOREIGN))
def test_starters_fit_a_terminal_and_hold_what_their_task_takes(task: str, tmp_path: Path) -> None:
    text = starter(task, full=True)
    assert max(map(len, text.splitlines())) <= 80
    for key in FOREIGN[task]:
        assert len(key) > 1 or not re.search(rf"^(# )?{key[0]}:", text, re.MULTILINE)
    # Without the marks of what is commented out every section is there and reads as YAML.
    path = tmp_path / "all.yaml"
    path.write_text(re.sub(r"^# ", "", text, flags=re.MULTILINE))
    sections = set(parse(read_text(path), "all.yaml").data)
    assert sections == {name for name in Case.declared if (name,) not in FOREIGN[task]}


@pytest.mark.parametrize(
    ("change", "wrong"),
    [
        ("forces.force=[1,0,0]", "forces: has no meaning for task: field; give field.force"),
        ("start.velocity=[1,0,0]", "start.velocity: has no meaning for task: field; give field.v"),
        ("body.stokes_number=3", "body.stokes_number: has no meaning for task: field; leave"),
        ("time.end=3", "time: has no meaning for task: field; leave it out, or use task: motion"),
        ("output.fields=[axis]", "output.fields: has no meaning for task: field; leave it out"),
    ],
)
def test_keys_of_other_tasks_are_refused(change: str, wrong: str, tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(starter("field", full=True))
    with pytest.raises(CaseError) as caught:
        load_case(path, [change])
    assert wrong in str(caught.value)


def test_counts_and_flows_read_well(tmp_path: Path) -> None:
    texts = [counted(1, "rank"), counted(2, "rank"), counted(1.0, "period"), counted(0.5, "period")]
    assert texts == ["1 rank", "2 ranks", "1 period", "0.5 periods"]
    assert counted(0, "entry", "entries") == "0 entries"
    path = tmp_path / "mine.yaml"
    path.write_text("body: {aspect_ratio: 1}\nflow: {type: shear}\ntime: {end: 1}\n")
    told = {
        flow_text(load_case(path, change)) for change in ([], ["flow.rate=1"], ["flow.rate=1.0"])
    }
    assert told == {"shear, rate 1; polynomial of degree 1"}
    assert shape_text(load_case(path).case.body.outline) == "sphere, k = 1"


def test_estimate_says_how_its_parts_combine() -> None:
    parts = {"quadrature": 1e-12, "rounding": 2e-12}
    texts = [_estimate({"error_parts": parts, "error_estimate": whole}) for whole in (3e-12, 5e-9)]
    assert texts == [
        "3.0e-12: sum of quadrature 1.0e-12, rounding 2.0e-12",
        "5.0e-09: misfit of the law; besides, quadrature 1.0e-12, rounding 2.0e-12",
    ]


def test_doctor_fits_a_terminal(run_cli: Run) -> None:
    done = run_cli("doctor")
    wide = [line for line in done.stdout.splitlines() if len(line) > 80]
    assert all(" " not in line[24:].strip() for line in wide)  # a path is not broken
    assert "\nok   cache " in done.stdout


def test_no_orbit_constant_without_shear(run_cli: Run, tmp_path: Path) -> None:
    text = "body: {aspect_ratio: 0.5}\nflow: {type: extension}\ntime: {end: 1, samples: 3}\n"
    (tmp_path / "case.yaml").write_text(text)
    done = run_cli("case.yaml")
    assert done.returncode == 0
    assert "orbit constant" not in done.stdout
    assert "orbit_constant" not in load(tmp_path / "case.h5").arrays
    done = run_cli("case.yaml", "--set", "output.fields=[orbit_constant]")
    assert done.returncode == 2
    assert "exists in a simple shear only" in done.stderr
    # In a shear along other axes it refers to these, and a free body keeps it.
    turned = "flow.rotation={axis: [1, 2, 3], angle: 70 deg}"
    done = run_cli("case.yaml", "--set", "flow.type=shear", "--set", turned, "--overwrite")
    constant = load(tmp_path / "case.h5").arrays["orbit_constant"]
    assert constant == pytest.approx(np.full(3, constant[0]), rel=1e-8)


def test_tumbling_has_no_finite_orbit_constant() -> None:
    ends = ("orbit_constant_first", "orbit_constant_last")
    found = {"counts": {}, "period": 1.0, "turns": 2, "drift_per_period": [0.0, 0.0, 0.0]}
    rows = {
        text: dict(_seen({"events": found | dict.fromkeys(ends, value)}))["orbit constant"]
        for text, value in (("tumbling", 6e15), ("finite", 3.0))
    }
    assert rows["tumbling"].startswith("infinite")
    assert rows["finite"] == "3 to 3"


def test_schema_is_json(run_cli: Run) -> None:
    assert "properties" in json.loads(run_cli("schema").stdout)


@pytest.mark.parametrize("case", sorted((ROOT / "cases").glob("*.yaml")), ids=lambda p: p.name)
def test_cases_are_valid_and_say_what_they_are(case: Path) -> None:
    plan_of(load_case(case))
    text = case.read_text()
    assert text.startswith("# yaml-language-server: $schema=../qbxstokes/case/")
    for word in ("# Shows:", "# Source:", "# Run:", "# Expected:"):
        assert word in text


def test_plan_refuses_what_the_schema_cannot_see(write_case: WriteCase) -> None:
    faults = {
        "time.periods: the flow's gradient": {"flow": {"type": "extension"}},
        "output.fields[1]: orbit_constant exists": {
            "flow": {"type": "paraboloid"},
            "start": {"position": [0, 0, 0], "orientation": {"axis": [1, 0, 0]}},
            "output": {"fields": ["axis", "orbit_constant"]},
            "time": {"end": 1.0},
        },
        "start.position: the flow is singular": {
            "flow": {"type": "stokeslet", "strength": [1, 0, 0]}
        },
        "there is no directory": {"output": {"file": "nowhere/a.h5"}},
    }
    for expected, change in faults.items():
        loaded = load_case(write_case(CASE | change))
        plan = target_of if "output" in change and "file" in change["output"] else make_plan
        with pytest.raises(CaseError) as caught:
            plan(loaded)
        assert expected in str(caught.value)


def test_schema_knows_what_can_be_recorded(write_case: WriteCase) -> None:
    path = write_case(CASE | {"output": {"fields": ["axis", "axes"]}})
    with pytest.raises(CaseError, match=r"output.fields\[1\]: 'axes' is not .*did you mean axis\?"):
        load_case(path)


@pytest.mark.parametrize("k", [0.02, 0.5, 1.0, 3.0])
def test_rotation_period_is_jefferys_in_any_frame(k: float) -> None:
    shear = np.zeros((3, 3))
    shear[0, 1] = 2.0
    turn = rotation.matrix(rotation.random_quaternions(1, np.random.default_rng(1))[0])
    for gradient in (shear, turn @ shear @ turn.T):
        assert jeffery_period(gradient, k) == pytest.approx(np.pi * (k + 1 / k), rel=1e-11)
    assert jeffery_period(shear + shear.T, k) is None
    spin = shear - shear.T
    assert jeffery_period(spin, k) == pytest.approx(np.pi, rel=1e-14)


def test_dry_run_and_explain_compute_nothing(
    run_cli: Run, write_case: WriteCase, tmp_path: Path
) -> None:
    done = run_cli(write_case(CASE).name, "--dry-run")
    assert done.returncode == 0
    assert "table on monomials" in done.stdout
    assert max(map(len, done.stdout.splitlines())) <= 80
    assert os.listdir(tmp_path) == ["case.yaml"]


def test_run_writes_a_result_that_says_how_it_was_made(
    run_cli: Run, run_process: Run, write_case: WriteCase, tmp_path: Path
) -> None:
    write_case(CASE)
    words = ("case.yaml", "--set", "output.file=a.h5", "-ts_max_steps", "100000", "-typo", 1)
    done = run_process(*words)
    assert done.returncode == 0, done.stderr
    assert "PETSc option -typo was not used" in done.stderr
    assert max(map(len, done.stdout.splitlines())) <= 80
    for word in ("Solved", "Skipped", "Errors", "Times", "a.h5"):
        assert word in done.stdout
    result = qbxstokes.load(tmp_path / "a.h5")
    np.testing.assert_allclose(result.axis[-1], result.axis[0], atol=1e-8)  # one whole period
    np.testing.assert_allclose(np.linalg.norm(result.orientation, axis=1), 1.0, atol=1e-14)
    assert result.summary["errors"]["axis"] < 1e-8
    assert json.loads(result.provenance["resolved_case"])["time"]["samples"] == 21
    assert "output.file=a.h5" in result.provenance["overrides"]
    told = run_cli("info", "a.h5").stdout
    assert "aspect_ratio" in told
    assert "orbit_constant" in told
    assert json.loads(run_cli("info", "a.h5", "--json").stdout)["task"] == "motion"


def test_existing_result_is_kept_and_said_so(run_cli: Run, write_case: WriteCase) -> None:
    write_case(CASE)
    first = json.loads(run_cli("case.yaml", "--json").stdout)
    second = run_cli("case.yaml")
    assert first["result"] == "case.h5"
    assert "case-1.h5" in second.stdout
    assert "case.h5 exists and was kept" in second.stdout
    third = json.loads(run_cli("case.yaml", "--json", "--overwrite").stdout)
    assert third["result"] == "case.h5"


def test_accuracy_limit_decides_the_exit_status(run_cli: Run, write_case: WriteCase) -> None:
    write_case(CASE | {"compare": {"tolerance": 1e-30}})
    done = run_cli("case.yaml", "--quiet")
    assert done.returncode == 1
    assert done.stdout == ""
    assert "exceeds compare.tolerance" in done.stderr


def test_every_step_equals_the_functional(run_cli: Run, write_case: WriteCase) -> None:
    write_case(MASSIVE | {"time": {"end": 1, "samples": 3, "tolerance": 1e-8}})
    ends = []
    for solve in ("functional", "every_step"):
        done = run_cli("case.yaml", "--json", "--set", f"hydrodynamics.solve={solve}")
        assert done.returncode == 0, done.stderr
        ends.append(json.loads(done.stdout)["final_orientation"])
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-9)


@pytest.mark.mpi
def test_two_ranks_give_the_numbers_of_one(
    run_cli: Run, mpirun: Run, write_case: WriteCase, tmp_path: Path
) -> None:
    write_case(CASE)
    assert run_cli("case.yaml", "--set", "output.file=one.h5").returncode == 0
    done = mpirun(2, "case.yaml", "--set", "output.file=two.h5")
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("Solved") == 1
    one, two = (qbxstokes.load(tmp_path / name) for name in ("one.h5", "two.h5"))
    for name in one.names:
        np.testing.assert_array_equal(one[name], two[name])
    assert two.provenance["ranks"] == 2


@pytest.mark.mpi
def test_bad_case_on_two_ranks_is_told_once(mpirun: Run, write_case: WriteCase) -> None:
    write_case(CASE | {"body": {"aspect_ratio": 0}})
    done = mpirun(2, "case.yaml")
    assert done.returncode == 2
    assert done.stderr.count("body.aspect_ratio: is 0") == 1
    assert "Traceback" not in done.stderr


@pytest.mark.mpi
@pytest.mark.parametrize("error", ["QbxStokesError('the disk is full')", "ZeroDivisionError()"])
def test_one_rank_failing_ends_the_job(mpirun: Run, error: str) -> None:
    script = f"""
import time
from qbxstokes.runs.parallel import guarded, world
from qbxstokes.errors import QbxStokesError
comm = world()
def action():
    if comm.rank == 1:
        raise {error}
    time.sleep(60)
    return 0
guarded(comm, action)
"""
    done = mpirun(2, script=script, timeout=20)
    assert done.returncode == 1
    assert "rank 1" in done.stderr
    assert error.split("(")[0] in done.stderr or "the disk is full" in done.stderr


@pytest.mark.mpi
def test_a_failure_of_all_ranks_in_a_service_is_told_once(mpirun: Run) -> None:
    script = """
from qbxstokes.errors import OutputError
from qbxstokes.runs.parallel import agree, guarded, on_root, world
from qbxstokes.runs.sharing import with_team
comm = world()
def service():
    agree(comm, OutputError("the disk is full") if comm.rank == 1 else None)
def action(team):
    team.join("service")
    service()
guarded(comm, lambda: on_root(comm, with_team(comm, action, {"service": service})))
"""
    done = mpirun(2, script=script, timeout=20)
    assert done.stderr.splitlines() == ["qbxstokes: the disk is full"]


@pytest.mark.parametrize(
    ("text", "right"),
    [
        (
            "flow: {type: shear}\ntime: {end: 1}\nbody: {aspect_ratio: 10 mm}",
            "without a unit: lengths are in c, times in tau",
        ),
        (
            "flow: {type: shear}\ntime: {end: 1}\nbody:\n  aspect_ratio: 0,5",
            "write a point for the comma: 0.5",
        ),
        ("body:\n  aspect_ratio:0.5", "put a space after the colon"),
        ("body:\n\taspect_ratio: 0.5", "indent with spaces, not with tabs"),
        ("body: {aspect_ratio: 1}\nflow: shear", "write flow: {type: shear}"),
        (
            "body: {aspect_ratio: 1}\nflow: {type: shear}\nstart: {orientation: [1, 0, 0]}",
            "write orientation: {axis: [...]}",
        ),
    ],
)
def test_usual_mistakes_are_told_with_what_is_right(text: str, right: str, tmp_path: Path) -> None:
    path = tmp_path / "case.yaml"
    path.write_text(text + "\n")
    with pytest.raises(CaseError) as caught:
        load_case(path)
    assert right in str(caught.value)


@pytest.mark.parametrize(
    ("words", "right"),
    [
        (("chek", "case.yaml"), "chek: neither a command nor a case file; did you mean check?"),
        (("run", "case.yaml"), "run: neither a command nor a case file; commands: check, new"),
        (("a.yaml", "b.yaml"), "b.yaml: one case at a time"),
        (("case.yaml", "--explian"), "--explian: unknown option; did you mean --explain?"),
    ],
)
def test_words_of_the_command_line_that_are_wrong(
    words: tuple[str, ...], right: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_command(words) == 2
    assert right in capsys.readouterr().err


def test_a_missing_package_is_one_line() -> None:
    told = missing_message(ModuleNotFoundError("No module named 'mpi4py'", name="mpi4py"))
    assert told.startswith("mpi4py is not installed; python -m qbxstokes doctor")
    assert missing_message(ModuleNotFoundError("no", name="qbxstokes.petsc.x")) == ""
    assert missing_message(ValueError("x")) == ""


def test_signs_names_and_backends_that_are_not_known(tmp_path: Path) -> None:
    """ASCII terminals, bytes that are no UTF-8 in a file's name, a notebook's backend."""
    name = os.fsdecode(b"n\xff.yaml")
    text = "title: Gr\u00fc\u00dfe\nbody: {aspect_ratio: 0.5}\nflow: {type: shear}\n"
    (tmp_path / name).write_text(text + "time: {end: 1, samples: 3}\n", encoding="utf-8")
    extra = {"PYTHONIOENCODING": "ascii", "MPLBACKEND": "module://matplotlib_inline.backend_inline"}
    ascii_alone = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    for words, more in (
        ([name], extra),
        (["plot", os.fsdecode(b"n\xff.h5"), "--kind", "rotation"], extra),
        (["plot", name, "--kind", "orbit"], ascii_alone),  # the newest result of the case
        ([name, "--dry-run", "--set", "title=\u00f6"], ascii_alone),
    ):
        done = subprocess.run(
            [sys.executable, "-m", "qbxstokes", *words],
            cwd=tmp_path,
            env={**ENVIRONMENT, **more},
            capture_output=True,
            check=False,
        )
        assert (done.returncode, b"Traceback" in done.stderr) == (0, False), done.stderr
