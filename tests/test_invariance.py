"""Random scenes have the symmetries of the equations, and shortcuts equal the per-step solve."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import (
    AGREEMENT,
    CARRIED,
    MOTION,
    ROUNDING,
    SYMMETRIES,
    random_scene,
    solve_error,
    symmetry_error,
    time_reversal_error,
    trajectory_error,
)

# Bodies are formed once per aspect ratio; any orientation, position and flow goes with them.
ASPECT_RATIOS = (0.05, 0.5, 1.0, 3.0, 20.0)
SEEDS = st.integers(0, 2**32 - 1)


@pytest.fixture(scope="module", autouse=True)
def petsc() -> None:
    from qbxstokes.petsc import session

    session.start([])


@pytest.mark.parametrize("name", SYMMETRIES)
@settings(max_examples=60, deadline=None)
@given(seed=SEEDS)
def test_rates_follow_the_scene_to_rounding(name: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    scene = random_scene(rng, ASPECT_RATIOS)
    assert symmetry_error(scene, name, rng) < ROUNDING


@settings(max_examples=30, deadline=None)
@given(seed=SEEDS)
def test_the_table_equals_the_solve_at_every_step(seed: int) -> None:
    rng = np.random.default_rng(seed)
    scene = random_scene(rng, ASPECT_RATIOS)
    assert solve_error(scene) < AGREEMENT


@pytest.mark.parametrize("name", CARRIED)
@settings(max_examples=4, deadline=None)
@given(seed=SEEDS, stokes_number=st.sampled_from([0.0, 1e-3, 10.0]))
def test_motions_follow_the_scene(name: str, seed: int, stokes_number: float) -> None:
    rng = np.random.default_rng(seed)
    scene = random_scene(rng, (0.5, 3.0))
    error = trajectory_error(scene, name, stokes_number, rng)
    assert error < MOTION


@settings(max_examples=10, deadline=None)
@given(seed=SEEDS)
def test_a_massless_motion_runs_backwards(seed: int) -> None:
    scene = random_scene(np.random.default_rng(seed), (0.5, 3.0))
    assert time_reversal_error(scene) < MOTION


def test_a_broken_symmetry_is_seen() -> None:
    """The checks themselves: a scene that is not carried along as claimed does not pass."""
    rng = np.random.default_rng(1)
    scene = random_scene(rng, (0.5,))
    other, carried = SYMMETRIES["rotation"](scene, rng)
    assert np.abs(other.motion() - scene.motion()).max() > 1e-3
    assert np.abs(carried(scene.motion()) - scene.motion()).max() > 1e-3
