"""Ensembles of paths: against closed forms, and the numbers of a path apart from its company."""

from __future__ import annotations

import json
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from conftest import Run
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import qbxstokes as qs
from qbxstokes.errors import CaseError, ConvergenceError, FlowError, SceneError
from qbxstokes.reference.jeffery import axis_at
from qbxstokes.simulation.ensemble import Ensemble

Array = NDArray[np.float64]
AXIS = np.array([0.48, 0.6, 0.64])


@cache
def body(k: float) -> qs.Body:
    return qs.Body(k)


def isotropic_gradients(generator: np.random.Generator, *shape: int) -> Array:
    """Gaussian and isotropic, with <w^2> = 2 <E:E> as in homogeneous turbulence."""
    a = generator.standard_normal((*shape, 3, 3))
    strain = 0.5 * (a + np.swapaxes(a, -1, -2))
    strain -= np.trace(strain, axis1=-2, axis2=-1)[..., None, None] * np.eye(3) / 3.0
    # E:E is 5 (of five independent unit normals), a skew part of unit normals has w^2 = 6.
    return strain + np.sqrt(5.0 / 3.0) * 0.5 * (a - np.swapaxes(a, -1, -2))


def smooth_gradients(seed: int, paths: int, times: Array) -> Array:
    generator = np.random.default_rng(seed)
    rates = np.array([0.4, 0.9, 1.5, 2.3, 3.1])
    amplitude = 0.25 * isotropic_gradients(generator, paths, 5)
    phase = generator.uniform(0.0, 6.28, (paths, 5))
    return np.einsum("tpn,pnij->ptij", np.cos(times[:, None, None] * rates + phase), amplitude)


def ends(found: Ensemble) -> Array:
    """Axes of the first block at the end."""
    return found.follow(0)[1]


def test_isotropic_axes_and_gradients_tumble_as_they_must() -> None:
    """<p'^2> nu/epsilon = 1/6 + lambda^2/10 (Shin & Koch, J. Fluid Mech. 540, 2005; Parsa et al.,

    Phys. Rev. Lett. 109, 2012), and (Omega.p)^2 nu/epsilon = 1/12, whatever the shape.
    """
    a = isotropic_gradients(np.random.default_rng(11), 20_000, 1)
    series = qs.GradientSeries([0.0, 1e-3], np.repeat(a, 2, axis=1), interpolation="hold")
    ratios = np.array([0.02, 0.5, 1.0, 10.0])
    found = qs.ensemble([body(k) for k in ratios], series, statistics={"sampling": False})
    shape = (1.0 - ratios**2) / (1.0 + ratios**2)
    for name, exact in (("tumbling", 1.0 / 6.0 + shape**2 / 10.0), ("spinning", 1.0 / 12.0)):
        mean, error = found.over_dissipation(name)
        assert np.all(error < 0.015 * mean)
        assert np.all(np.abs(mean - exact) < 4.0 * error)
    cosine, error = found.mean("cos_vorticity")
    assert np.all(np.abs(cosine - 0.5) < 4.0 * error)
    assert np.all(found.variance("cos_vorticity") == pytest.approx(1.0 / 12.0, rel=0.03))


@pytest.mark.parametrize("k", [0.02, 0.2, 50.0])
@pytest.mark.parametrize("interpolation", ["hold", "sextic"])
def test_a_series_of_a_steady_shear_is_jefferys_orbit(k: float, interpolation: str) -> None:
    gradient = np.zeros((3, 3))
    gradient[0, 1] = 1.0
    times = np.linspace(0.0, 10.0 * np.pi * (k + 1.0 / k), 701)
    series = qs.GradientSeries(
        times, np.broadcast_to(gradient, (1, 701, 3, 3)), interpolation=interpolation
    )
    for tolerance in (1e-4, 1e-7):
        found = qs.ensemble(
            body(k), series, orientation=AXIS, statistics={"keep": 1}, tolerance=tolerance
        )
        exact = axis_at(found.time, k, AXIS)
        assert found.axes is not None
        assert np.abs(found.axes[0, :, 0] - exact).max() < max(10.0 * tolerance, 2e-9)


def test_gradients_that_are_held_turn_by_exponentials() -> None:
    times = np.cumsum(np.random.default_rng(2).uniform(0.02, 2.0, 40))
    a = smooth_gradients(3, 5, times)
    k = 0.1
    law = (1.0 - k * k) / (1.0 + k * k)
    series = qs.GradientSeries(times, a, interpolation="hold")
    found = ends(Ensemble((body(k),), series, AXIS, tolerance=1e-9))[:, 0]
    for path, end in zip(a, found, strict=True):
        p = AXIS
        for length, gradient in zip(np.diff(times), path, strict=False):
            turning = 0.5 * (gradient - gradient.T) + law * 0.5 * (gradient + gradient.T)
            p = expm(length * turning) @ p
        assert np.abs(end - p / np.linalg.norm(p)).max() < 1e-8


@pytest.mark.parametrize(("interpolation", "k"), [("sextic", 0.1), ("linear", 5.0), ("hold", 50.0)])
def test_every_path_keeps_its_tolerance(interpolation: str, k: float) -> None:
    """Against SciPy's DOP853, sample by sample, with a pulse and uneven samples."""
    generator = np.random.default_rng(5)
    times = np.concatenate([[0.0], np.cumsum(generator.uniform(0.01, 0.6, 60))])
    a = smooth_gradients(6, 8, times)
    a[:4, 30] *= 30.0
    law = (1.0 - k * k) / (1.0 + k * k)
    series = qs.GradientSeries(times, a, interpolation=interpolation)
    for path in (0, 7):
        gradient = series.path(path)

        def rate(t: float, p: Array) -> Array:
            g = gradient(t)  # noqa: B023
            pull = 0.5 * (g - g.T) @ p + law * 0.5 * (g + g.T) @ p
            return np.asarray(pull - (p @ pull) * p)

        p = AXIS
        for begin, end in pairwise(times):
            stop = np.nextafter(end, begin)
            p = solve_ivp(rate, (begin, stop), p, "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
        for tolerance in (1e-3, 1e-6, 1e-9):
            found = ends(Ensemble((body(k),), series, AXIS, tolerance=tolerance))
            assert np.abs(found[path, 0] - p).max() < 10.0 * tolerance


def test_ensembles_agree_with_the_integrator_of_scenes() -> None:
    times = np.linspace(0.0, 6.0, 121)
    a = smooth_gradients(8, 3, times)
    series = qs.GradientSeries(times, a)
    found = ends(Ensemble((body(0.2),), series, AXIS, tolerance=1e-7))
    for path in range(3):
        flow = qs.flow("linear", gradient=series, trajectory=path)
        motion = body(0.2).integrate(flow, [6.0], orientation=AXIS, tolerance=1e-7)
        assert np.abs(motion.axis[-1] - found[path, 0]).max() < 1e-6


@pytest.mark.parametrize(("k", "stokes"), [(0.2, 300.0), (1.0, 0.01), (0.2, 1.0), (5.0, 3.0)])
def test_bodies_with_inertia_turn_as_in_scenes(k: float, stokes: float) -> None:
    """Euler's equations by another integrator, from lazy to stiff, and samples far apart."""
    times = np.linspace(0.0, 8.0, 41)
    a = smooth_gradients(8, 3, times)
    a[1, 20] *= 8.0
    series = qs.GradientSeries(times, a)
    heavy = body(k).with_inertia(stokes)
    for tolerance in (1e-4, 1e-7):
        ensemble = Ensemble((body(0.2), heavy), series, AXIS, tolerance=tolerance)
        found = ends(ensemble)
        assert np.array_equal(
            found[:, 0], ends(Ensemble((body(0.2),), series, AXIS, tolerance=tolerance))[:, 0]
        )
        for path in range(2):
            flow = qs.flow("linear", gradient=series, trajectory=path)
            motion = heavy.integrate(flow, [8.0], orientation=AXIS, tolerance=1e-9)
            assert np.abs(motion.axis[-1] - found[path, 1]).max() < 10.0 * tolerance


def test_spin_of_a_heavy_sphere_follows_a_vorticity_that_turns() -> None:
    """Angular velocity W in a rotation w(t)/2: W' = r (w/2 - W), of each component."""
    times = np.linspace(0.0, 20.0, 201)
    a = np.zeros((1, 201, 3, 3))
    a[0, :, 0, 1], a[0, :, 1, 0] = -0.5 * np.cos(times), 0.5 * np.cos(times)
    series = qs.GradientSeries(times, a)
    found = qs.ensemble(
        body(1.0).with_inertia(5.0), series, orientation=[0, 0, 1], statistics={"sampling": False}
    )
    r = 15.0 / 5.0  # 8 pi/(8 pi/15 St)
    settled = r * (r * np.cos(found.time) + np.sin(found.time)) / (r * r + 1.0)
    spin = 0.5 * (settled + (1.0 - r * r / (r * r + 1.0)) * np.exp(-r * found.time))
    place = found.quantities.index("spinning")
    assert np.abs(found.mean_in_time[0, place] - spin**2).max() < 1e-6


@pytest.mark.slow
def test_axes_diffuse_in_gradients_that_forget_at_once() -> None:
    """White noise: -ln <p(0).p(t)> = <p'^2> (sqrt(pi/2) tau t - tau^2), by G. I. Taylor's formula

    for the correlation exp(-t^2/(2 tau^2)) of the gradients and a small tau, with axes at random.
    """
    tau, k = 0.05, 0.2
    series = qs.GradientSeries.gaussian(
        paths=1500, end=12.0, spacing=0.025, correlation_time=tau, rate=1.0, seed=3
    )
    found = qs.ensemble(body(k), series, statistics={"sampling": False, "correlation": 60})
    shape = (1.0 - k * k) / (1.0 + k * k)
    late = found.lag > 2.0
    assert late.sum() > 5
    exact = (1.0 / 6.0 + shape**2 / 10.0) * (np.sqrt(0.5 * np.pi) * tau * found.lag - tau**2)
    ratio = -np.log(found.correlation[0, late]) / exact[late]
    assert ratio.mean() == pytest.approx(1.0, abs=0.06)


def test_cosines_of_gradients_that_die_out_are_cosines() -> None:
    times = np.linspace(0.0, 1.0, 11)
    a = smooth_gradients(3, 4, times) * np.exp(-70.0 * np.arange(11.0))[:, None, None]
    found = qs.ensemble(body(0.2), qs.GradientSeries(times, a), statistics={"sampling": False})
    place = found.quantities.index("cos_vorticity")
    assert np.all(found.moments[:, place] <= 1.0)
    assert found.counts[0, place, [0, -1]].tolist() == [0, 0]


def test_a_path_does_not_depend_on_its_company(tmp_path: Path) -> None:
    times = np.linspace(0.0, 4.0, 41)
    a = smooth_gradients(9, 301, times).astype(np.float32)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["A"], file["t"] = np.swapaxes(a.reshape(301, 41, 9), 0, 1), times
    series = qs.GradientSeries(times, a)
    bodies = body(0.2), body(5.0), body(5.0).with_inertia(0.01)
    whole = Ensemble(bodies, series, AXIS)
    alone = Ensemble(bodies, series.part(slice(37, 38), slice(None)), AXIS)
    assert np.array_equal(ends(whole)[37], ends(alone)[0])
    statistics = {"keep": 2, "quantities": ["tumbling", "cos_strain_1", "cos_strain_3"]}
    found = qs.ensemble([body(0.2), body(5.0)], series, statistics=statistics)
    lazy = qs.GradientSeries.from_file(tmp_path / "a.h5", layout=["time", "trajectory"])
    again = qs.ensemble([body(0.2), body(5.0)], lazy, statistics=statistics)
    assert np.array_equal(found.moments, again.moments)
    assert found.counts.sum(axis=-1).tolist() == [[301 * 40] * 3] * 2
    assert found.moments.shape == (2, 3, 4)
    assert found.axes is not None
    assert found.axes.shape == (2, 40, 2, 3)
    assert found.correlation[:, 0] == pytest.approx(1.0)
    mean = found.mean_in_time.mean(axis=-1)
    assert mean == pytest.approx(found.moments[..., 0], rel=1e-12)


def test_tiles_of_time_leave_the_numbers_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    times = np.linspace(0.0, 4.0, 61)
    series = qs.GradientSeries(times, smooth_gradients(9, 20, times))
    statistics = {"every": 3, "discard": 0.2, "keep": 1}
    one = qs.ensemble(body(0.2), series, statistics=statistics)
    monkeypatch.setattr("qbxstokes.simulation.ensemble.TILE", 7)
    other = qs.ensemble(body(0.2), series, statistics=statistics)
    for name in ("moments", "counts", "mean_in_time", "correlation", "axes"):
        values = getattr(other, name)
        same = getattr(one, name) == pytest.approx(values, rel=1e-13 * (name == "correlation"))
        assert same, name


def test_what_the_sampling_leaves_is_told() -> None:
    fine = np.linspace(0.0, 10.0, 801)
    a = smooth_gradients(4, 40, fine)
    exact = ends(Ensemble((body(0.2),), qs.GradientSeries(fine, a), AXIS, tolerance=1e-12))
    for interpolation in ("sextic", "linear"):
        series = qs.GradientSeries(fine[::8], a[:, ::8], interpolation=interpolation)
        found = Ensemble((body(0.2),), series, AXIS, tolerance=1e-10)
        true = np.median(np.linalg.norm(ends(found) - exact, axis=-1))
        assert 0.3 * true < found.sampling()["axis_median"] < 30.0 * true


def turning_gradient(t: float) -> Array:
    """Not smooth at t = 1."""
    a = np.array([[0.0, np.cos(t), 0.0], [0.2, 0.0, np.sin(3.0 * t)], [0.0, -0.4, 0.0]])
    return a if t <= 1.0 else 2.0 * a


@pytest.mark.parametrize("stokes", [0.0, 0.5])
def test_one_function_of_time_turns_all_bodies(stokes: float) -> None:
    """Against the motions themselves, at instants of their own, the first not at 0."""
    times, axes = np.array([0.3, 0.7, 1.9, 2.0, 5.0]), np.array([[0.6, 0.0, 0.8], AXIS])
    bodies = [qs.Body(k, stokes_number=stokes) for k in (0.05, 4.0)]
    flow = qs.flow("linear", gradient=turning_gradient, breaks=[1.0])
    keep = {"keep": 2}
    found = qs.ensemble(bodies, flow, times, orientation=axes, statistics=keep, tolerance=1e-8)
    assert found.axes is not None
    assert found.time == pytest.approx(times[:-1])
    for place, one in enumerate(bodies):
        motion = one.integrate(flow, times, orientation=axes, tolerance=1e-9)
        assert np.abs(found.axes[:, :, place] - motion.axis[:, :-1]).max() < 1e-7
    assert found.summary["sampling"]["gradient"] < 1e-9


def test_expressions_steady_flows_and_series_are_shared_as_well() -> None:
    times = np.linspace(0.0, 3.0, 31)
    samples = [[[0.0, np.cos(t), 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]] for t in times]
    series = qs.flow("linear", gradient=qs.GradientSeries(times, samples))
    flows = qs.flow("shear", rate="cos(t)"), lambda t: np.array(samples[0]) * np.cos(t), series
    found = [qs.ensemble(body(0.2), flow, times, paths=300) for flow in flows]
    for other in found[1:]:
        assert other.moments == pytest.approx(found[0].moments, rel=1e-6)
    steady = qs.ensemble(body(0.2), qs.flow("shear"), times, orientation=AXIS)
    assert steady.mean("tumbling")[0] > 0.0
    assert steady.summary["sampling"] == {}
    case = {
        "body": {"aspect_ratio": 0.2},
        "flow": {"type": "shear", "rate": "cos(t)"},
        "time": {"end": 3.0, "samples": 31},
        "statistics": {"keep": 1},
        "sweep": {
            "axes": [
                {"start.orientation": [AXIS.tolist(), [1, 0, 0]]},
                {"body.aspect_ratio": [0.2, 5]},
            ],
            "store": "statistics",
        },
    }
    same = qs.ensemble(
        [body(0.2), body(5.0)],
        flows[0],
        times,
        orientation=[AXIS, [1.0, 0.0, 0.0]],
        statistics={"keep": 1},
    )
    assert qs.run(case).axis == pytest.approx(same.axes, abs=1e-8)
    case["sweep"]["axes"][0]["flow.trajectory"] = [0, 1]
    with pytest.raises(CaseError):
        qs.run(case)


def test_bad_input_is_refused() -> None:
    times = np.linspace(0.0, 1.0, 11)
    a = smooth_gradients(1, 3, times)
    series = qs.GradientSeries(times, a)
    with pytest.raises(SceneError, match="orientation"):
        qs.ensemble(body(0.2), series, orientation=np.ones((2, 3)))
    with pytest.raises(SceneError, match="bins"):
        qs.ensemble(body(0.2), series, statistics={"bins": 0})
    with pytest.raises(SceneError, match="linear flow"):
        qs.ensemble(body(0.2), qs.flow("paraboloid"), times)
    with pytest.raises(SceneError, match="times are missing"):
        qs.ensemble(body(0.2), qs.flow("shear"))
    with pytest.raises(SceneError, match="times is given"):
        qs.ensemble(body(0.2), series, times)
    with pytest.raises(SceneError, match="paths are 3"):
        qs.ensemble(body(0.2), qs.flow("shear"), times, paths=3, orientation=np.ones((2, 3)))
    a[1, 4, 0, 0] = np.nan
    with pytest.raises(FlowError, match="path 1, sample 4"):
        qs.ensemble(body(0.2), qs.GradientSeries(times, a))


# -- as cases -------------------------------------------------------------------------------------


CASE = {
    "body": {"aspect_ratio": 0.2},
    "flow": {
        "type": "linear",
        "gradient": {"process": "gaussian", "paths": 700, "end": 2.0, "spacing": 0.1},
    },
    "time": {"end": 2.0, "tolerance": 1e-6},
    "statistics": {"keep": 2, "sampling": False},
    "sweep": {
        "axes": [{"flow.trajectory": "all"}, {"body.aspect_ratio": [0.2, 5.0]}],
        "store": "statistics",
    },
}


def test_a_case_is_the_same_ensemble() -> None:
    found = qs.run(CASE)
    series = qs.GradientSeries.gaussian(paths=700, end=2.0, spacing=0.1)
    same = qs.ensemble([body(0.2), body(5.0)], series, statistics={"keep": 2, "sampling": False})
    assert found.tumbling_moments == pytest.approx(same.moments[:, 0], rel=1e-9)
    assert found.axis.shape == (2, 20, 2, 3)
    assert same.axes is not None
    assert np.abs(found.axis - same.axes).max() < 1e-8
    assert found.tumbling_counts.sum() == 700 * 20 * 2
    assert found.task == "ensemble"


@pytest.mark.parametrize("unit", [0.012, 0.13])  # the last instant is 1e-7 more, or less
def test_the_last_of_instants_in_single_precision_counts(unit: float, tmp_path: Path) -> None:
    times = (0.2 * unit * np.arange(500)).astype(np.float32)
    values = np.zeros((500, 2, 3, 3), dtype=np.float32)
    values[..., 0, 1] = 1.0 / unit
    np.save(tmp_path / "t.npy", times)
    np.save(tmp_path / "a.npy", values)
    names = {"file": str(tmp_path / "a.npy"), "time": str(tmp_path / "t.npy"), "unit": unit}
    gradient = {**names, "layout": ["time", "trajectory"]}
    ends = {"time": {"end": 99.8, "tolerance": 1e-6}, "statistics": {"quantities": ["tumbling"]}}
    found = qs.run({**CASE, **ends, "flow": {"type": "linear", "gradient": gradient}})
    assert len(found.time) == 499
    assert "cos_vorticity_over_strain" not in found.names
    times = qs.GradientSeries.from_file(**gradient).path(0)
    turned = qs.Body(0.2).integrate(qs.flow("linear", gradient=times), [99.8], tolerance=1e-6)
    assert turned.time[-1] == 99.8


def test_axes_of_a_table_start_beside_their_paths() -> None:
    axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.6, 0.0, 0.8]]
    together = [{"flow.trajectory": [5, 2, 600], "start.orientation": axes}]
    found = qs.run({**CASE, "sweep": {"axes": together, "store": "statistics"}})
    assert np.abs(found.axis[:, 0, 0] - np.array(axes)[:2]).max() < 1e-12
    alone = qs.ensemble(
        body(0.2),
        qs.GradientSeries.gaussian(paths=700, end=2.0, spacing=0.1).path(2),
        orientation=axes[1],
        statistics={"keep": 1, "sampling": False},
    )
    assert alone.axes is not None
    assert np.abs(found.axis[1] - alone.axes[0]).max() < 1e-8


def test_what_was_stopped_goes_on_to_the_same_bits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run_cli: Run
) -> None:
    path = tmp_path / "case.yaml"
    path.write_text(json.dumps({**CASE, "checkpoint": {"every": "1e-6 s"}}))
    assert run_cli("case.yaml", "--set", "output.file=whole.h5", "--quiet").returncode == 0
    follow, done = Ensemble.block, []

    def stopped(self: Ensemble, number: int) -> dict[str, Array]:
        if len(done) == 2:
            raise MemoryError
        done.append(number)
        return follow(self, number)

    monkeypatch.setattr(Ensemble, "block", stopped)
    assert run_cli("case.yaml", "--quiet").returncode == 1
    monkeypatch.setattr(Ensemble, "block", follow)
    assert not (tmp_path / "case.h5").exists()
    assert run_cli("case.yaml", "--quiet").returncode == 2  # it is there to go on with
    assert run_cli("case.yaml", "--quiet", "--resume").returncode == 0
    one, other = qs.load(tmp_path / "case.h5"), qs.load(tmp_path / "whole.h5")
    for name in other.names:
        assert np.array_equal(one[name], other[name], equal_nan=True), name
    assert run_cli("case.yaml", "--quiet", "--resume").returncode == 0


@pytest.mark.mpi
def test_ranks_leave_the_bits_alone(tmp_path: Path, mpirun: Run) -> None:
    (tmp_path / "case.yaml").write_text(json.dumps(CASE))
    for ranks in (1, 2, 3):
        options = ("--quiet", "--set", f"output.file={ranks}.h5")
        assert mpirun(ranks, "case.yaml", *options).returncode == 0
    one, *others = (qs.load(tmp_path / f"{ranks}.h5") for ranks in (1, 2, 3))
    for other in others:
        for name in one.names:
            assert np.array_equal(one[name], other[name], equal_nan=True), name


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"sweep": None}, "without sweep.store: statistics"),
        (
            {
                "body": {"aspect_ratio": 0.2, "stokes_number": 1.0},
                "statistics": {"stresses": True},
            },
            "massless",
        ),
        ({"time": {"end": 3.0}}, "is 3 and the series covers 0 to 2"),
        ({"forces": {"force": [0, 0, 1]}}, "forces: has no meaning"),
        ({"start": {"angular_velocity": [0, 0, 1]}, "body": {"stokes_number": 1.0}}, "no meaning"),
        ({"flow": {"type": "shear"}}, "has no paths"),
        ({"hydrodynamics": {"solve": "every_step"}}, "hydrodynamics.solve: has no meaning"),
        ({"petsc": {"ts_type": "bdf"}}, "petsc.ts_type: has no meaning"),
    ],
)
def test_cases_that_have_no_statistics_are_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(CaseError, match=message):
        qs.run({**CASE, **change})


def test_random_gradients_have_the_variances_they_are_to_have() -> None:
    series = qs.GradientSeries.gaussian(
        paths=3000, end=1.0, spacing=0.2, rate=2.0, correlation_time=0.5
    )
    a = series.read(0, 3000)
    later = np.einsum("pi,pti->t", a[:, 0], a) / np.sum(a[:, 0] ** 2)
    assert later == pytest.approx(np.exp(-2.0 * series.times**2), abs=0.02)
    gradient = a.reshape(-1, 3, 3)
    strain = 0.5 * (gradient + np.swapaxes(gradient, 1, 2))
    assert np.sum(strain**2) / len(gradient) == pytest.approx(2.0, rel=0.03)
    # <A_11^2> and <A_12^2> of isotropic gradients are 1/15 and 2/15 of epsilon/nu.
    assert np.mean(gradient[:, 0, 0] ** 2) == pytest.approx(4.0 / 15.0, rel=0.05)
    assert np.mean(gradient[:, 1, 2] ** 2) == pytest.approx(8.0 / 15.0, rel=0.05)


def test_no_more_is_read_at_once_than_a_tile() -> None:
    times = np.linspace(0.0, 4.0, 41)
    samples = smooth_gradients(9, 600, times).reshape(600, 41, 9)
    sizes = []

    class Lazy:
        shape, ndim, dtype = samples.shape, 3, samples.dtype

        def __getitem__(self, place: Any) -> Array:
            sizes.append(samples[place].size)
            return samples[place]

    numbers = np.arange(600)[::-1]
    series = qs.GradientSeries(times, Lazy()).chosen(numbers).part(slice(None), slice(2, 31))
    found = qs.ensemble(body(0.2), series)
    assert 0 < max(sizes) <= 256 * 29 * 9
    inside = qs.GradientSeries(times[2:31], samples[::-1, 2:31])
    assert np.array_equal(found.moments, qs.ensemble(body(0.2), inside).moments)


def test_paths_that_cannot_be_followed_are_told() -> None:
    """Far too strong a gradient: no number of parts of an interval will do."""
    rng = np.random.default_rng(0)
    a = 1e6 * rng.normal(size=(6, 3, 3))
    a -= np.trace(a, axis1=1, axis2=2)[:, None, None] * np.eye(3) / 3.0
    series = qs.GradientSeries(np.linspace(0.0, 20.0, 6), a, interpolation="hold")
    with pytest.raises(ConvergenceError, match="path 0: inertia"):
        qs.ensemble(qs.Body(0.5, stokes_number=0.01), series, orientation=[0.6, 0, 0.8])


@pytest.mark.parametrize("interpolation", ["linear", "hold"])
@pytest.mark.parametrize(("k", "stokes"), [(0.03, 0.2), (5.0, 1e-3), (0.3, 1e-8)])
def test_stiff_bodies_pass_kinks(interpolation: str, k: float, stokes: float) -> None:
    """Against one a thousand times as close; axes and rates, in a few parts of each interval."""
    times = np.linspace(0.0, 3.0, 31)
    gradients = smooth_gradients(3, 2, times)
    series = qs.GradientSeries(times, gradients, interpolation=interpolation)
    one, close = (
        qs.ensemble(
            qs.Body(k, stokes_number=stokes),
            series,
            orientation=AXIS,
            statistics={"keep": 2, "sampling": False},
            tolerance=tolerance,
        )
        for tolerance in (1e-7, 1e-10)
    )
    assert one.axes is not None
    assert np.abs(one.axes - close.axes).max() < 1e-8
    assert np.abs(one.mean_in_time[0, 0] - close.mean_in_time[0, 0]).max() < 1e-7
