"""The Python interface: examples run as written, and agree with closed forms."""

from __future__ import annotations

import doctest
import importlib
import subprocess
import sys

import numpy as np
import pytest

import qbxstokes as qs
from qbxstokes.errors import CaseError
from qbxstokes.geometry import rotation
from qbxstokes.reference import faxen, jeffery, lamb


@pytest.mark.parametrize("module", ["qbxstokes", "qbxstokes.app.interface"])
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
    motion = qs.Body(0.5).integrate(
        qs.flow("shear"), times, orientation=[1, 0, 0], stokes_number=5.0, velocity=[0, 0, 0.1]
    )
    assert motion.velocity[0] == pytest.approx([0, 0, 0.1])
    assert motion.position[-1, 2] > 0.0
    assert motion.force[0, 2] < 0.0
    assert motion.steps > 0


def test_wrong_shapes_are_named():
    with pytest.raises(CaseError, match=r"position has shape \(2,\)"):
        qs.Body(0.5).free_motion(qs.flow("shear"), position=[0, 1])
    with pytest.raises(CaseError, match="aspect_ratio"):
        qs.Body(-1.0)


def test_no_mpi_or_petsc_before_a_motion_is_integrated():
    code = (
        "import sys, qbxstokes as qs; qs.Body(0.5).free_motion(qs.flow('shear'));"
        "print([m for m in ('petsc4py', 'mpi4py', 'h5py', 'matplotlib') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
