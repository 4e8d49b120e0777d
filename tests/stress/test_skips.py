"""What the plan leaves out (`--explain`): no change of the result, and the time that it saves.

k = 1/2 or thinner, hydrodynamics to 1e-10; processor times of this thread, of which the run tells
the ratio. Expected: 1.1 times faster without modes above 1 and without the resistance, 2 by mirror
symmetry, 4 to 5 without outer expansions, 2 to 3 at a step or a right-hand side.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from conftest import script
from numpy.typing import NDArray

from qbxstokes.bie.accuracy import accurate_body, choose_scheme
from qbxstokes.bie.faxen import faxen_coefficients
from qbxstokes.bie.operators import form_body_model, modal_functional, surface_operators
from qbxstokes.bie.providers import GridMotion, SolveMotion
from qbxstokes.flows.named import Shear
from qbxstokes.flows.polynomial import PolynomialFlow
from qbxstokes.geometry import rotation
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.motion import fore_aft
from qbxstokes.motion.equations import RigidBodyEquations
from qbxstokes.motion.taylor import pack_flow, unpack_flow
from qbxstokes.petsc import session
from qbxstokes.qbx.operator import independent_rows, layer_rows
from qbxstokes.reference import jeffery

Array = NDArray[np.float64]
Work = Callable[[], Any]
Skip = tuple[str, Work, Work]
timed = script("benchmarks/measure").timed
BLOCK, CALLS = 512, 1000  # bodies of a block, right-hand sides timed together
Q = rotation.normalize(np.array([[0.8, 0.3, -0.4, 0.33]]))


def set_up_skips(k: float) -> Iterator[Skip]:
    """Those of the set-up: name, the work without the skip, the work with it."""
    spheroid, scheme = Spheroid(k), choose_scheme(1e-10)
    both = replace(choose_scheme(1e-10, side="average"), n_theta=scheme.n_theta)
    half = independent_rows(spheroid, scheme.n_theta)

    def whole(completion: Any) -> Array:
        faxen = accurate_body(spheroid, 1e-10, strict=False, completion=completion).model.faxen
        return np.concatenate([[faxen.linear], faxen.quadratic, faxen.cubic])

    def formed(n_phi: int, used: Any) -> Array:
        functional = modal_functional(surface_operators(spheroid, used, n_phi))
        coefficients, _ = faxen_coefficients(functional)
        return np.concatenate([coefficients.quadratic, coefficients.cubic])

    def rows(chosen: Any) -> Array:
        return layer_rows(spheroid, scheme, 2, chosen)[0][: len(half)]

    narrow = partial(formed, 3, scheme)
    yield "azimuthal modes above 1", partial(formed, 8, scheme), narrow
    yield "resistance where no force acts", partial(whole, "surface"), partial(whole, None)
    yield "outer expansions", partial(formed, 3, both), narrow
    every = range(scheme.n_theta)
    yield "rows that mirror symmetry gives", partial(rows, every), partial(rows, half)


def many(rate: Any, start: Array) -> Work:
    """Many right-hand sides of one body."""
    rows = start[0].tolist()

    def calls() -> Array:
        for _ in range(CALLS):
            result = rate(0.0, rows)
        return np.array(result)

    return calls


def step_skips(k: float) -> Iterator[Skip]:
    """Those of a step and of a right-hand side."""
    scheme, x = choose_scheme(1e-10), np.zeros((1, 3))
    operators = surface_operators(Spheroid(k), scheme, 8)
    model = form_body_model(operators)
    solve = SolveMotion(operators, Shear())
    grid = GridMotion(modal_functional(operators).on_grid(8), Shear())
    equations = RigidBodyEquations(model, Shear())
    state = equations.initial_state(x[0], Q[0])
    solve.free_motion(0.0, x, Q)

    ways = (partial(way.free_motion, 0.0, x, Q) for way in (solve, grid))
    table = partial(equations.velocities, 0.0, state)
    by_solve, by_grid, by_table = (lambda w=way: np.array(w()) for way in (*ways, table))
    yield "integral equation at a step", by_solve, by_grid
    yield "flow on the surface at a step", by_grid, by_table
    law, _, _ = fore_aft.unpack_body(fore_aft.pack_body(model, True))
    constants = unpack_flow(pack_flow(Shear()).tolist()), law, None, None
    general = many(lambda t, rows: fore_aft.massless(rows, *constants), state)
    yield "terms that are zero at a right-hand side", general, many(equations.rate_of_rows, state)
    for stokes_number in (0.0, 10.0):
        moving, still = (partial(turned, model, stokes_number, u) for u in (1e-300, 0.0))
        moving(), still()  # compile what a fresh machine has not
        yield f"translation at a stagnation point, St = {stokes_number:g}", moving, still


def turned(model: Any, stokes_number: float, stream: float) -> Array:
    """Orientations of a block after a period; a stream too slow to count lets the bodies move."""
    from qbxstokes.petsc.stepper import integrate

    moved = PolynomialFlow((stream, 0.0, 0.0), Shear().gradient_tensor)
    block = RigidBodyEquations(model, moved, stokes_number, BLOCK, evaluation="compiled")
    orientations = rotation.random_quaternions(BLOCK, np.random.default_rng(0))
    start = block.initial_state(np.zeros(3), orientations)
    period = jeffery.period(model.effective_ratio)
    return integrate(block, start, [period], 1e-8).states[-1, :, 3:7]


@pytest.mark.parametrize(
    "k", [pytest.param(0.1, marks=pytest.mark.slow), pytest.param(0.5, marks=pytest.mark.slow), 4.0]
)
def test_every_skip_changes_no_more_than_rounding(
    k: float, record_property: Callable[[str, object], None]
) -> None:
    session.start([])
    for name, full, short in (*set_up_skips(k), *step_skips(k)):
        repeats = 3 if k == 0.5 else 1
        slow, before = timed(full, repeats, time.thread_time)
        fast, after = timed(short, repeats, time.thread_time)
        change = float(np.max(np.abs(before - after)) / np.max(np.abs(before)))
        assert change < 1e-11, name
        record_property("worst", f"{slow / fast:5.2f} times faster, change {change:.0e}: {name}")
