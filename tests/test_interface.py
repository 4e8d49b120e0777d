"""The Python interface: examples run as written, and agree with closed forms."""

from __future__ import annotations

import doctest
import importlib
import subprocess
import sys

import numpy as np
import pytest

import qbxstokes as qs
from qbxstokes.errors import CaseError, ConvergenceError
from qbxstokes.geometry import rotation
from qbxstokes.reference import faxen, jeffery, lamb


@pytest.mark.parametrize(
    "module",
    [
        "qbxstokes",
        "qbxstokes.runs.from_python",
        "qbxstokes.simulation.body",
        "qbxstokes.simulation.simulation",
    ],
)
def test_examples_run_as_written(module):
    result = doctest.testmod(importlib.import_module(module), raise_on_error=False)
    assert result.attempted > 3
    assert result.failed == 0


def test_resistance_and_mobility_are_inverse_and_exact():
    body = qs.Body(0.3)
    across, along = lamb.translation_resistance(0.3)
    about, spin = jeffery.rotation_resistance(0.3)
    assert np.diag(body.resistance) == pytest.approx([across, across, along, about, about, spin])
    assert np.allclose(body.mobility @ body.resistance, np.eye(6), atol=1e-14)
    assert 0.0 < body.error_estimate < 1e-10


def test_free_motion_broadcasts_over_places():
    flow = qs.flow("paraboloid", curvature=0.3)
    places = np.random.default_rng(0).normal(size=(2, 3, 3))
    axis = np.array([0.6, 0.0, 0.8])
    u, omega = qs.Body(2.0).free_motion(flow, places, axis)
    assert u.shape == omega.shape == (2, 3, 3)
    one, spin = qs.Body(2.0).free_motion(flow, places[1, 2], axis)
    assert np.array_equal(u[1, 2], one)
    assert np.array_equal(omega[1, 2], spin)
    local = flow.polynomial.derivatives(places[1, 2])
    exact_u, exact_omega = faxen.free_motion_polynomial(2.0, axis, *local)
    assert one == pytest.approx(exact_u, rel=1e-10)
    assert spin == pytest.approx(exact_omega, rel=1e-10)


def test_flow_that_is_not_polynomial():
    """A stokeslet beside the body, against the Faxen law of the ellipsoid on the surface."""
    flow = qs.flow("stokeslet", strength=[1.0, 2.0, 0.0], position=[0.0, 3.0, 0.5])
    axis = np.array([0.0, 0.6, 0.8])
    u, omega = qs.Body(0.5).free_motion(flow, orientation=axis)
    turn = rotation.matrix(rotation.from_axis(axis))
    exact_u, exact_omega = faxen.free_motion(0.5, turn, np.zeros(3), flow.velocity)
    assert u == pytest.approx(exact_u, rel=1e-9)
    assert omega == pytest.approx(exact_omega, rel=1e-9)


def test_force_and_torque_vanish_on_the_free_body():
    body, flow = qs.Body(0.4), qs.flow("paraboloid", curvature=0.5)
    place = {"position": [0.0, 2.0, 0.3], "orientation": [0.5, 0.5, np.sqrt(0.5)]}
    u, omega = body.free_motion(flow, **place)
    force, torque = body.force_torque(flow, velocity=u, angular_velocity=omega, **place)
    assert np.max(np.abs([force, torque])) < 1e-13
    free = body.field(flow, [[0.0, 2.0, 0.3 + 1e-4], [0.0, 9.0, 0.0]], **place)
    assert free["source"][0] == -1
    assert np.all(np.isnan(free["velocity"][0]))
    assert np.all(np.isfinite(free["velocity"][1]))


def test_inertial_motion_starts_where_it_is_told():
    times = np.linspace(0.0, 1.0, 3)
    motion = qs.Body(0.5, stokes_number=5.0).integrate(
        qs.flow("shear"), times, orientation=[1, 0, 0], velocity=[0, 0, 0.1]
    )
    assert motion.velocity[0] == pytest.approx([0, 0, 0.1])
    assert motion.position[-1, 2] > 0.0
    assert motion.force[0, 2] < 0.0
    assert motion.steps > 0


def test_averages_and_means_of_a_single_motion():
    times = np.linspace(0, 100, 301)
    orbit = qs.Body(0.2).integrate(qs.flow("shear"), times, orientation=[1, 0, 1])
    assert orbit.averages()["period"] == pytest.approx(jeffery.period(0.2))
    stress = orbit.mean("particle_stress")
    assert stress.each.shape == stress.mean.shape == (3, 3)
    with pytest.raises(CaseError, match="orientations is"):
        qs.rheology(qs.Body(0.2), qs.flow("shear"), np.inf, orientations={"orbits": [1.0]})


def test_rounding_of_a_body_at_rest_is_no_error():
    case = {"body": {"aspect_ratio": 0.5}, "flow": {"type": "shear"}, "time": {"end": 3.0}}
    found = qs.run({**case, "hydrodynamics": {"solve": "every_step"}})
    assert found.summary["largest_error"] < 1e-10


def test_what_moved_is_told_with_its_new_place():
    with pytest.raises(CaseError, match=r"belongs to the body; qs\.Body\(..., stokes_number"):
        qs.Body(0.5).integrate(qs.flow("shear"), [1.0], stokes_number=5.0)


def test_wrong_shapes_are_named():
    with pytest.raises(CaseError, match=r"position has shape \(2,\)"):
        qs.Body(0.5).free_motion(qs.flow("shear"), position=[0, 1])
    with pytest.raises(CaseError, match="aspect_ratio"):
        qs.Body(-1.0)


@pytest.mark.parametrize(
    ("build", "told"),
    [
        (lambda: {"velocity": [1, 0, 0]}, "velocity has no meaning for a massless body"),
        (lambda: {"loads": qs.Loads(torque=[1.0])}, r"torque has shape \(1,\)"),
        (lambda: {"constraints": qs.Constraints(3.0)}, r"velocity has shape \(\)"),
        (lambda: {"orientation": np.eye(3)[:2], "position": np.eye(3)}, "axes that broadcast"),
    ],
)
def test_what_would_be_taken_for_something_else_is_refused(build, told):
    with pytest.raises(qs.QbxStokesError, match=told):
        qs.Body(0.5).integrate(qs.flow("shear"), [0, 1], **build())


def test_no_mpi_or_petsc_before_an_equation_is_solved():
    """PETSc solves the integral equation, in a notebook as on the command line; nothing else."""
    code = """
import sys
import qbxstokes as qs
def loaded():
    return [m for m in ("petsc4py", "mpi4py", "h5py", "matplotlib") if m in sys.modules]
scene = qs.Simulation(qs.Body(0.5), qs.flow("shear"))
print(loaded())
qs.Body(0.5).free_motion(qs.flow("shear"))
print(loaded())
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split("\n")[:2] == ["[]", "['petsc4py']"]


CASE = {
    "body": {"aspect_ratio": 0.5},
    "flow": {"type": "shear"},
    "start": {"orientation": {"axis": np.array([1.0, 0.0, 1.0])}},
    "time": {"end": np.float64(2.0), "samples": 5},
}


def test_run_keeps_the_file_that_is_named_and_numbers_the_next(tmp_path):
    first = qs.run(CASE, file=tmp_path / "orbit.h5")
    second = qs.run(CASE, file=tmp_path / "orbit.h5")
    assert first.path == tmp_path / "orbit.h5"
    assert second.path == tmp_path / "orbit-1.h5"
    assert np.array_equal(first.axis, second.axis)
    # Without a name the files are apart from each other and from the working directory.
    unnamed = [qs.run(CASE), qs.run(CASE)]
    assert unnamed[0].path != unnamed[1].path
    assert not list(tmp_path.glob("case*"))


def test_run_agrees_with_the_command_line(tmp_path, run_cli):
    path = tmp_path / "case.yaml"
    path.write_text(
        "body: {aspect_ratio: 0.5}\nflow: {type: shear}\n"
        "start: {orientation: {axis: [1, 0, 1]}}\ntime: {end: 2, samples: 5}\n"
    )
    assert run_cli("case.yaml").returncode == 0
    by_command = qs.load(tmp_path / "case.h5")
    for given in (path, CASE):
        # To rounding: another number of threads adds up in another order.
        assert np.allclose(qs.run(given).orientation, by_command.orientation, rtol=0, atol=1e-13)


def test_errors_name_the_key_and_limits_raise():
    wrong = {**CASE, "body": {"aspect_ratio": -1}}
    with pytest.raises(CaseError, match=r"^case: body.aspect_ratio: is -1; must be > 0"):
        qs.run(wrong)
    with pytest.raises(
        CaseError, match=r"^case: body.aspect: unknown key; did you mean aspect_ratio"
    ):
        qs.sweep(CASE, {"body.aspect": [1.0]})
    with pytest.raises(ConvergenceError, match="exceeds a limit"):
        qs.run({**CASE, "compare": {"tolerance": 1e-30}})


def test_petsc_options_of_a_case_end_with_it():
    steps = [
        qs.run(case).summary["integration"]["method"]
        for case in ({**CASE, "petsc": {"ts_rk_type": "5dp"}}, CASE)
    ]
    assert steps[0] == "5dp"
    assert steps[1] != "5dp"


def test_a_sweep_from_a_file_and_over_two_axes(tmp_path, monkeypatch):
    path = tmp_path / "case.yaml"
    path.write_text("body: {aspect_ratio: 0.5}\nflow: {type: shear}\ntime: {end: 1, samples: 3}\n")
    k, st = np.array([0.5, 2.0]), np.array([1.0, 5.0, 20.0])
    axes = {"body.aspect_ratio": k, "body.stokes_number": st}
    result = qs.sweep(path, axes, store="summary", file=tmp_path / "all.h5")
    assert result.shape == (2, 3)
    assert np.all(result.table["status"] == 1)
    assert np.array_equal(result.table["aspect_ratio"].reshape(2, 3)[:, 0], k)
    assert "axis" not in result.arrays
