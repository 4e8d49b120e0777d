"""Studies: theory of heavy bodies, inertia switched off, averages, blocks on ranks, resuming."""

from __future__ import annotations

import json
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from qbxstokes.app.study import MAKERS, simulate
from qbxstokes.bie.exact import exact_model
from qbxstokes.cli.main import run_command
from qbxstokes.errors import ConvergenceError
from qbxstokes.flows import build_flow
from qbxstokes.geometry import rotation
from qbxstokes.io.tables import Table
from qbxstokes.motion.equations import Inertia, RigidBodyEquations
from qbxstokes.reference import heavy
from qbxstokes.reference.inertial import inertia as moments_of_inertia

pytestmark = pytest.mark.slow

Array = Any


def paraboloid() -> Any:
    return build_flow({"type": "paraboloid", "curvature": 0.25}).polynomial


@pytest.fixture(autouse=True)
def _closed_forms(monkeypatch: pytest.MonkeyPatch) -> None:
    """Studies in these tests spare the integral equation."""
    monkeypatch.setattr(simulate, "body", exact_model)


# -- theory ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("k", [0.2, 0.5, 2.0, 5.0])
def test_mean_rate_has_both_limits(k: float) -> None:
    free = k / (1.0 + k * k)
    scale = heavy.relaxation_rates(k)[2]
    light = [heavy.mean_rotation_rate(k, lag * scale) / free - 1.0 for lag in (0.005, 0.01)]
    assert light[1] / light[0] == pytest.approx(4.0, rel=0.02)  # no correction of first order
    heavy_lag = 200.0
    short = 0.5 - heavy.mean_rotation_rate(k, heavy_lag * scale)
    assert short * heavy_lag**2 == pytest.approx(0.25 * heavy.shape(k) ** 2, rel=1e-3)


@pytest.mark.parametrize("k", [0.1, 0.5, 2.0, 10.0])
def test_closed_forms_are_the_limits_of_light_and_of_heavy_bodies(k: float) -> None:
    rates = heavy.relaxation_rates(k)
    lag = 1e-3 * min(k, 1.0 / k)
    gain = heavy.mean_rotation_rate(k, lag * rates[2]) * (k + 1.0 / k) - 1.0
    assert gain / lag**2 == pytest.approx(heavy.light_rate_coefficient(k), rel=1e-4)
    stokes = 1e4 * rates[0]
    assert stokes * heavy.drift(k, stokes) == pytest.approx(
        heavy.large_stokes_drift(k), rel=1e-6
    )  # fmt: skip


def test_rate_depends_on_shape_through_the_square_of_lambda_and_on_st_through_the_lag() -> None:
    for lag in (0.3, 1.0, 30.0, 3e3):  # the last one beyond the precision of a plain Newton step
        rates = [
            heavy.mean_rotation_rate(k, lag * heavy.relaxation_rates(k)[2]) for k in (0.2, 5.0)
        ]
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
        heavy.mean_rotation_rate(k, lag * heavy.relaxation_rates(k)[2]) for lag in (0.5, 0.9)
    )
    assert below < 1.1 * k / (1.0 + k * k)
    assert above > 4.0 * below


@pytest.mark.parametrize("k", [0.2, 0.5, 2.0, 5.0])
def test_small_stokes_numbers_drift_by_the_averaged_rate(k: float) -> None:
    stokes = 1e-3 * heavy.relaxation_rates(k)[2]
    rolling = heavy.rolling_drift_coefficient(k)
    assert heavy.orbit_drift_coefficient(k, 1e-3) == pytest.approx(rolling, rel=1e-4)
    assert heavy.rolling_exponent(k, stokes) / stokes == pytest.approx(rolling, rel=1e-3)
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


@pytest.mark.parametrize(("k", "lag"), [(0.2, 1.0), (0.5, 10.0), (2.0, 0.5)])
def test_measured_orbit_drift_is_the_exact_exponent(k: float, lag: float) -> None:
    study = import_module(MAKERS["orbit_drift"])
    rows = study.compute(k=k, stokes_numbers=[lag * heavy.relaxation_rates(k)[2]])
    assert {row["orbit"] for row in rows} >= {"rolling"}
    for row in rows:
        if row["orbit"] != "C = 1":
            assert row["rate"] == pytest.approx(row["theory"], rel=2e-3)


def test_tilt_of_a_heavy_flat_body_decays_without_turning() -> None:
    rate = heavy.relaxation_rates(5.0)[2]
    light, late = (heavy.rolling_mode(5.0, lag * rate) for lag in (0.01, 10.0))
    assert light.imag == pytest.approx(5.0 / 26.0, rel=1e-2)
    assert late.imag == 0.0
    study = import_module(MAKERS["orbit_drift"])
    rows = study.compute(k=5.0, stokes_numbers=[10.0 * rate])
    assert all(row["orbit"] != "rolling" for row in rows)


@pytest.mark.parametrize("k", [0.2, 0.5, 2.0, 5.0])
def test_lateral_drift_goes_to_higher_shear_and_dies_out(k: float) -> None:
    small = heavy.small_stokes_drift(k)
    assert small > 0.0
    assert heavy.small_stokes_drift_on_orbit(k, np.inf) == pytest.approx(small, rel=1e-10)
    stokes = 1e-3 * heavy.relaxation_rates(k)[1]
    for parts in ("both", "translation"):
        assert heavy.drift(k, stokes, parts) / stokes == pytest.approx(small, rel=1e-4)  # type: ignore[arg-type]
    far = 1e4 * heavy.relaxation_rates(k)[0]
    assert heavy.drift(k, 10.0 * far) / heavy.drift(k, far) == pytest.approx(0.1, rel=1e-3)


@pytest.mark.parametrize("stokes_number", [0.3, 30.0])
def test_sphere_does_not_drift(stokes_number: float) -> None:
    assert abs(heavy.drift(1.0, stokes_number)) < 1e-15
    assert heavy.mean_rotation_rate(1.0, stokes_number) == pytest.approx(0.5, rel=1e-13)


# -- inertia of one part --------------------------------------------------------------------------


@pytest.mark.parametrize("inertia", ["translation", "rotation"])
def test_part_without_inertia_follows_the_flow(inertia: Inertia) -> None:
    n, rng = 9, np.random.default_rng(3)
    x, q = rng.normal(size=(n, 3)), rotation.random_quaternions(n, rng)
    equations = RigidBodyEquations(exact_model(0.4), paraboloid(), 2.0, n, inertia=inertia)
    y = equations.initial_state(x, q, rng.normal(size=3), rng.normal(size=3))
    v, omega = equations.velocities(0.0, y)
    free = RigidBodyEquations(exact_model(0.4), paraboloid(), 0.0, n)
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
            exact_model(2.5), paraboloid(), 0.7, n, evaluation=evaluation, inertia=inertia
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


# -- averages -------------------------------------------------------------------------------------


def test_orientation_in_the_plane_of_shear_is_exact() -> None:
    axis = np.stack([np.cos([0.3, 2.0]), np.sin([0.3, 2.0]), [0.0, 0.0]], axis=-1)
    q = simulate.orientation(axis)
    assert np.allclose(rotation.axis(q), axis, atol=1e-15)
    assert np.array_equal(q[:, 0], q[:, 1])
    assert np.array_equal(q[:, 2], q[:, 3])


def test_measured_rates_are_those_of_the_theory_within_the_uncertainty() -> None:
    k, stokes = 2.0, [1.0, 2.0]
    flow = simulate.polynomial(type="paraboloid", curvature=1.0 / 64.0)
    axis = np.tile(simulate.orbit_axes(k, np.inf), (2, 1))
    found = simulate.measure(k, flow, stokes, axis, 4, (0.0, 32.0, 0.0))
    rates = [heavy.mean_rotation_rate(k, st) for st in stokes]
    drifts = [heavy.drift(k, st) / 64.0 for st in stokes]
    assert np.allclose(found.values["rotation_rate"], rates, rtol=1e-3)
    assert np.allclose(found.values["velocity_2"], drifts, rtol=2e-3)
    assert (found.values["position_2"] > 32.0).all()
    assert (found.half_turns >= 4).all()
    assert (found.errors["velocity_2"] < 1e-2 * found.values["velocity_2"]).all()


@pytest.mark.parametrize(("k", "inertia"), [(1.0, "both"), (0.5, "rotation")])
def test_no_drift_of_spheres_and_without_inertia_of_translation(k: float, inertia: Inertia) -> None:
    flow = simulate.polynomial(type="paraboloid", curvature=1.0 / 8.0)
    axis = simulate.orbit_axes(k, 1.0)
    found = simulate.measure(k, flow, 5.0, axis, 2, (0.0, 4.0, 0.0), inertia)
    assert np.abs(found.values["velocity_2"]).max() < 1e-12


def test_drift_near_the_axis_is_that_of_the_local_shear_rate() -> None:
    """One length off the axis the body gains a fifth of its shear rate while it is watched."""
    study = import_module(MAKERS["lateral_drift"])
    (row,) = study.compute(k=2.0, stokes_numbers=[10.0], distance=1.0)
    assert row["local_rate"] > 1.1
    at_start = heavy.drift(2.0, 10.0)
    assert row["drift"] == pytest.approx(row["theory"], rel=0.02)
    assert abs(row["drift"] / at_start - 1.0) > 0.05


# -- the machinery --------------------------------------------------------------------------------


@pytest.mark.parametrize("name", MAKERS)
def test_blocks_are_plain_data_and_tables_and_figures_fit(name: str) -> None:
    study = import_module(MAKERS[name])
    for full in (False, True):
        blocks = study.blocks(full)
        assert json.loads(json.dumps(blocks)) == json.loads(json.dumps(list(blocks)))
        assert len({json.dumps(block) for block in blocks}) == len(blocks)
    tables = study.tables([])
    assert all(isinstance(table, Table) and not len(table) for table in tables)
    for table in tables:
        names = {column.name for column in table.columns}
        for key in ("x", "y", "by", "value"):
            wanted = table.plot.get(key, [])
            assert names >= set([wanted] if isinstance(wanted, str) else wanted)
    assert study.FIGURES
    assert all(callable(draw) for draw in study.FIGURES.values())


CASE = """\
task: study
study: {tables: [acceleration], size: small, figures: true}
output: {file: out.h5}
"""


def test_study_runs_resumes_and_draws(
    run_cli: Callable[..., Any], write_case: Callable[..., Path], tmp_path: Path
) -> None:
    case = write_case(CASE)
    done = run_cli(case, "--quiet")
    assert done.returncode == 0, done.stderr
    names = {path.name for path in tmp_path.iterdir()}
    assert {
        "out.h5",
        "out_acceleration.csv",
        "out_acceleration.pdf",
        "out_acceleration.png",
    } <= names
    assert not (tmp_path / "out.h5.parts").exists()
    table = Table.read_csv(tmp_path / "out_acceleration.csv")
    rolling = table["orientation"] == "rolling"
    assert np.allclose(table["ratio"][rolling], 1.0, atol=1e-4)
    assert (table["exponential"][rolling] == 1.0).all()
    assert (table["exponential"] == (table["misfit"] < 0.01)).all()
    drawn = run_cli("plot", tmp_path / "out.h5", "--output", tmp_path / "drawn", "--format", "png")
    assert drawn.returncode == 0, drawn.stderr
    assert [path.suffix for path in (tmp_path / "drawn").iterdir()] == [".png"]
    picture = tmp_path / "out_acceleration.png"
    assert picture.read_bytes()[:4] == b"\x89PNG"
    assert picture.stat().st_size < 150_000


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in MAKERS if name != "acceleration"])
def test_small_studies_run_draw_and_pass(
    name: str, run_cli: Callable[..., Any], write_case: Callable[..., Path], tmp_path: Path
) -> None:
    done = run_cli(write_case(CASE.replace("acceleration", name)), "--quiet", timeout=600)
    assert done.returncode == 0, done.stderr
    tables = [Table.read_csv(path) for path in tmp_path.glob("out_*.csv")]
    assert tables
    assert all(len(table) for table in tables)
    assert any(tmp_path.glob("out_*.png"))
    drawn = run_cli("plot", tmp_path / "out.h5", "--output", tmp_path / "drawn", "--format", "png")
    assert drawn.returncode == 0, drawn.stderr


def test_unfinished_study_is_kept_and_told(
    run_cli: Callable[..., Any], write_case: Callable[..., Path], tmp_path: Path
) -> None:
    parts = tmp_path / "out.h5.parts"
    parts.mkdir()
    (parts / "study.json").write_text(json.dumps({"digest": "another"}))
    case = write_case(CASE)
    refused = run_cli(case, "--quiet")
    assert refused.returncode == 2
    assert "--resume" in refused.stderr
    other = run_cli(case, "--quiet", "--resume")
    assert other.returncode == 2
    assert "another study" in other.stderr


# -- ranks, and runs that stop --------------------------------------------------------------------

TWO = CASE.replace("[acceleration]", "[acceleration, rotation_rate]")
# Every picture that is saved is noted.
NOTING = """
import sys
from qbxstokes.plots import style
save, saved = style.save, []
def noting(figure, path, *rest):
    with open("saved.txt", "a") as log:
        log.write(path.name + chr(10))
    return save(figure, path, *rest)
style.save = noting
from qbxstokes.cli.main import run_command
sys.exit(run_command(sys.argv[1:]))
"""


def made_of(folder: Path) -> dict[str, Any]:
    """Tables of the CSV files and of the result to the last bit, and the bytes of the pictures."""
    import h5py

    found: dict[str, Any] = {}
    for path in sorted(folder.glob("out_*")):
        if path.suffix == ".csv":
            table = Table.read_csv(path)
            found[path.name] = (table.columns, table.rows)
        else:
            found[path.name] = path.read_bytes()
    with h5py.File(folder / "out.h5") as file:
        for name, group in file["tables"].items():
            for column, data in group.items():
                found[f"{name}/{column}"] = data[()].tobytes() if data.dtype.kind != "O" else (
                    data.asstr()[()].tolist()
                )  # fmt: skip
    return found


@pytest.mark.mpi
def test_any_number_of_ranks_makes_the_same_tables_and_pictures_once(
    mpirun: Callable[..., Any], write_case: Callable[..., Path], tmp_path: Path
) -> None:
    write_case(TWO)
    found = []
    for ranks in (1, 2, 3):
        done = mpirun(ranks, "case.yaml", "--quiet", "--overwrite", script=NOTING)
        assert done.returncode == 0, done.stderr
        assert not done.stderr
        found.append(made_of(tmp_path))
        saved = (tmp_path / "saved.txt").read_text().split()
        (tmp_path / "saved.txt").unlink()
        pictures = [f"out_{name}.{k}" for name in ("acceleration", "rotation_rate")
                    for k in ("pdf", "png")]  # fmt: skip
        assert sorted(saved) == pictures
        assert not (tmp_path / "out.h5.parts").exists()
        for path in tmp_path.glob("out*"):
            path.unlink()
    assert found[0].keys() >= {"out_transition.csv", "out_rotation_rate.pdf", "transition/theory"}
    assert found[0] == found[1] == found[2]


@pytest.mark.mpi
def test_a_picture_that_cannot_be_written_ends_all_ranks_with_one_line(
    mpirun: Callable[..., Any], write_case: Callable[..., Path], tmp_path: Path
) -> None:
    write_case(TWO)
    (tmp_path / "out_rotation_rate.png").mkdir()
    refused = mpirun(2, "case.yaml", "--quiet", timeout=60)
    assert refused.returncode == 2
    assert "out_rotation_rate.png: cannot be written" in refused.stderr
    lines = [line for line in refused.stderr.splitlines() if "qbxstokes" in line or "out_" in line]
    assert len(lines) == 1
    assert not (tmp_path / "out.h5").exists()
    (tmp_path / "out_rotation_rate.png").rmdir()
    done = mpirun(2, "case.yaml", "--quiet", "--resume")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out.h5").exists()
    assert (tmp_path / "out_rotation_rate.png").stat().st_size > 1000


@pytest.mark.parametrize("where", ["a table", "a picture", "the result"])
def test_a_study_stopped_after_its_blocks_goes_on_without_them(
    where: str,
    write_case: Callable[..., Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    from qbxstokes.io.writer import ResultWriter
    from qbxstokes.plots import style

    monkeypatch.chdir(tmp_path)
    words = [str(write_case(CASE)), "--quiet"]
    assert run_command(words) == 0
    whole = made_of(tmp_path)
    for path in tmp_path.glob("out*"):
        path.unlink()

    def stop(*_: Any) -> Any:
        raise KeyboardInterrupt

    study = import_module(MAKERS["acceleration"])
    with monkeypatch.context() as patch:
        owner, name = {
            "a table": (study, "tables"), "a picture": (style, "save"),
            "the result": (ResultWriter, "finish"),
        }[where]  # fmt: skip
        patch.setattr(owner, name, stop)
        assert run_command(words) == 130
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert "out.h5.parts: go on with --resume" in told
    assert not (tmp_path / "out.h5").exists()
    monkeypatch.setattr(study, "compute", stop)  # nothing is computed again
    assert run_command([*words, "--resume"]) == 0
    assert made_of(tmp_path) == whole
    assert not (tmp_path / "out.h5.parts").exists()


def test_a_block_that_fails_leaves_the_others_to_resume_with(
    write_case: Callable[..., Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    words = [str(write_case(CASE)), "--quiet"]
    study = import_module(MAKERS["acceleration"])
    compute, calls = study.compute, []

    def failing(**parameters: Any) -> Any:
        calls.append(parameters)
        if len(calls) == 1:
            raise ConvergenceError("no step is short enough")
        return compute(**parameters)

    monkeypatch.setattr(study, "compute", failing)
    assert run_command(words) == 1
    told = capsys.readouterr().err.splitlines()
    assert len(told) == 2
    assert "block" in told[0]
    assert "no step is short enough" in told[0]
    assert "out.h5.parts keeps the other blocks: --resume" in told[1]
    assert not (tmp_path / "out.h5").exists()
    whole = len(calls)
    assert run_command([*words, "--resume"]) == 0
    assert len(calls) == whole + 1
    assert (tmp_path / "out.h5").exists()
