"""Cost of a right-hand side: solve, functional on the grid, table on monomials, closed form."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from functools import partial
from statistics import median
from typing import TYPE_CHECKING, Any

import numpy as np

from qbxstokes.app.benchmark.timing import seconds_each
from qbxstokes.bie.accuracy import accurate_body
from qbxstokes.bie.exact import exact_model
from qbxstokes.bie.operators import surface_operators
from qbxstokes.bie.providers import GridMotion, SolveMotion
from qbxstokes.flows import build_flow
from qbxstokes.flows.named import Shear
from qbxstokes.geometry import rotation
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.io.tables import Column, Table
from qbxstokes.motion.equations import RigidBodyEquations

if TYPE_CHECKING:
    from qbxstokes.app.tabulate import Work

ASPECT_RATIO = 0.5
BLOCK = 4096
_QUATERNION: list[float] = rotation.normalize([0.7, 0.3, -0.4, 0.5]).tolist()


def closed_form(y: list[float], shape: float) -> tuple[float, ...]:
    """dy/dt of a massless spheroid in u = (x2, 0, 0), plain arithmetic on y = (x, q).

    Omega = w/2 + lambda d x (E d) (Jeffery 1922), shape = lambda = (1 - k^2)/(1 + k^2).
    """
    _, x2, _, q0, q1, q2, q3 = y
    s = 1.0 / (q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3)
    d1, d2 = 2.0 * s * (q1 * q3 + q0 * q2), 2.0 * s * (q2 * q3 - q0 * q1)
    d3 = s * (q0 * q0 - q1 * q1 - q2 * q2 + q3 * q3)
    half = 0.5 * shape
    a, b, c = -half * d3 * d1, half * d3 * d2, -0.5 + half * (d1 * d1 - d2 * d2)
    return (
        x2,
        0.0,
        0.0,
        -0.5 * (a * q1 + b * q2 + c * q3),
        0.5 * (a * q0 + b * q3 - c * q2),
        0.5 * (b * q0 + c * q1 - a * q3),
        0.5 * (c * q0 + a * q2 - b * q1),
    )


def closed_form_inertial(
    y: list[float], shape: float, drag: tuple[float, ...], gyration: float
) -> tuple[float, ...]:
    """dy/dt of a spheroid with inertia in u = (x2, 0, 0), on y = (x, q, V, W).

    Lamb's drag and Jeffery's torque, written as resistances times slip. drag: R/(St inertia) of
    translation and rotation, each transverse and axial; gyration: (J3 - J1)/J1.
    """
    _, x2, _, q0, q1, q2, q3, v1, v2, v3, w1, w2, w3 = y
    across, along, turning, spinning = drag
    s = 1.0 / (q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3)
    a1, a2, a3 = q0 * q0 + q1 * q1 - q2 * q2 - q3 * q3, q1 * q2 + q0 * q3, q1 * q3 - q0 * q2
    b1, b2, b3 = q1 * q2 - q0 * q3, q0 * q0 - q1 * q1 + q2 * q2 - q3 * q3, q2 * q3 + q0 * q1
    d1, d2 = 2.0 * s * (q1 * q3 + q0 * q2), 2.0 * s * (q2 * q3 - q0 * q1)
    d3 = s * (q0 * q0 - q1 * q1 - q2 * q2 + q3 * q3)
    half = 0.5 * shape
    o1, o2, o3 = -half * d3 * d1, half * d3 * d2, -0.5 + half * (d1 * d1 - d2 * d2)
    e1 = x2 - v1
    slip = (along - across) * (e1 * d1 - v2 * d2 - v3 * d3)
    spin = gyration * w3
    return (
        v1,
        v2,
        v3,
        -0.5 * (q1 * w1 + q2 * w2 + q3 * w3),
        0.5 * (q0 * w1 + q2 * w3 - q3 * w2),
        0.5 * (q0 * w2 + q3 * w1 - q1 * w3),
        0.5 * (q0 * w3 + q1 * w2 - q2 * w1),
        across * e1 + slip * d1,
        -across * v2 + slip * d2,
        -across * v3 + slip * d3,
        turning * (s * (a1 * o1 + 2.0 * (a2 * o2 + a3 * o3)) - w1) - spin * w2,
        turning * (s * (b2 * o2 + 2.0 * (b1 * o1 + b3 * o3)) - w2) + spin * w1,
        spinning * (d1 * o1 + d2 * o2 + d3 * o3 - w3),
    )


def tables(work: Work) -> Iterator[Table]:
    """A right-hand side of one body alone, and under the integrator."""
    yield _alone(work)
    yield _integrated(work)


class _Given(RigidBodyEquations):
    """Equations of motion with their rates given."""

    given: Callable[[list[float]], Any]

    @property
    def rate_of_rows(self) -> Callable[[float, Any], Any]:
        """The given rates."""
        given = self.given
        return lambda t, rows: given(rows)


def _integrated(work: Work) -> Table:
    """Wall time of an integration per right-hand side, closed form and program in turns."""
    from qbxstokes.petsc.stepper import integrate

    table = Table(
        "integrated",
        "Cost of a right-hand side under 8vr, PETSc's own work included (shear, k = 1/2)",
        (
            Column("stokes_number", "", "St", ".3g", "St"),
            Column("evaluation"),
            Column("evaluations", "", "right-hand sides of the integration", "d"),
            Column("time", "us", "wall time per right-hand side", ".3g"),
            Column("ratio", "", "over the closed form, run in turns with it", ".3g"),
            Column("difference", "", "largest of the rates, from the closed form", ".0e"),
        ),
        plot={"x": "evaluation", "y": "time", "by": "stokes_number", "scale": "semilogy"},
    )
    k, span = ASPECT_RATIO, work.choose(5.0, 200.0)
    shape, model = (1.0 - k * k) / (1.0 + k * k), exact_model(k)
    rounds = work.choose(1, 4 * work.section.repeats)
    for stokes_number in (0.0, 1.0):
        closed = _Given(model, Shear(), stokes_number, evaluation="plain")
        drag = tuple(closed.relaxation_rates[:, 0].tolist())
        j1, _, j3 = Spheroid(k).inertia.tolist()
        if closed.massless:
            closed.given = partial(closed_form, shape=shape)
        else:
            gyration = (j3 - j1) / j1
            closed.given = partial(closed_form_inertial, shape=shape, drag=drag, gyration=gyration)
        ways = {
            "closed form": closed,
            "table, plain Python": RigidBodyEquations(
                model, Shear(), stokes_number, evaluation="plain"
            ),
            "table, compiled": RigidBodyEquations(
                model, Shear(), stokes_number, evaluation="compiled"
            ),
        }
        start = closed.initial_state(np.zeros(3), _QUATERNION)
        exact = np.array(closed.rate_of_rows(0.0, start[0].tolist()))
        spans: dict[str, list[float]] = {name: [] for name in ways}
        counts: dict[str, int] = {}
        work.say(f"8vr at St = {stokes_number:g}")
        for _ in range(rounds):
            for name, equations in ways.items():
                begin = time.perf_counter()
                found = integrate(equations, start, [span], 1e-8, method="8vr")
                counts[name] = found.evaluations
                spans[name].append((time.perf_counter() - begin) / found.evaluations)
        for name, equations in ways.items():
            out = np.empty((equations.n_state, 1))
            equations.rate_function()(0.0, np.ascontiguousarray(start.T), out)
            shares = np.array(spans[name]) / np.array(spans["closed form"])
            table.add(
                stokes_number=stokes_number,
                evaluation=name,
                evaluations=counts[name],
                time=1e6 * median(spans[name]),
                ratio=median(shares.tolist()),
                difference=float(np.abs(out[:, 0] - exact).max()),
            )
    return table


def _alone(work: Work) -> Table:
    from qbxstokes.petsc.gmres import GmresSolver

    table = Table(
        "step",
        "Cost of a right-hand side of one massless body in shear (k = 1/2)",
        (
            Column("evaluation"),
            Column("time", "us", "wall time per body and right-hand side", ".3g"),
            Column("ratio", "", "over the closed form in the same run", ".3g"),
            Column("difference", "", "largest, from the closed form", ".0e"),
            Column("iterations", "", "of GMRES", "d"),
        ),
        plot={"x": "evaluation", "y": "time", "scale": "semilogy"},
    )
    k, repeats = ASPECT_RATIO, work.choose(1, work.section.repeats)
    flow = build_flow({"type": "shear"})
    polynomial = flow.polynomial
    assert polynomial is not None
    body = accurate_body(Spheroid(k), 1e-12)
    operators = surface_operators(Spheroid(k), body.scheme, 6)
    y = [0.1, 0.2, 0.3, *_QUATERNION]
    exact = np.array(closed_form(y, (1.0 - k * k) / (1.0 + k * k)))

    solvers: list[GmresSolver] = []

    def gmres(operator: Any, grid: Any) -> GmresSolver:
        solvers.append(GmresSolver(operator, grid, 1e-12))
        return solvers[-1]

    table_single = RigidBodyEquations(body.model, polynomial)
    entries: list[tuple[str, Callable[[], Any], int]] = [
        ("closed form", lambda: closed_form(y, (1.0 - k * k) / (1.0 + k * k)), 1),
        ("table, plain Python", lambda: table_single.rate_of_rows(0.0, y), 1),
    ]
    for bodies in (1, BLOCK):
        compiled = RigidBodyEquations(body.model, polynomial, 0.0, bodies, evaluation="compiled")
        name = f"table, compiled, {bodies} bod{'ies' if bodies > 1 else 'y'}"
        entries.append((name, _rates(compiled, y), bodies))
    for name, provider in (
        ("functional on the grid", GridMotion(body.functional.on_grid(6), flow)),
        ("solve at every step", SolveMotion(operators, flow, gmres)),
    ):
        entries.append((name, _rates(RigidBodyEquations(body.model, provider), y), 1))
    base = 0.0
    for name, action, bodies in entries:
        work.say(name)
        rate = np.asarray(action(), dtype=float).reshape(7, -1)[:, 0]
        span = seconds_each(action, repeats) / bodies
        base = base or span
        solved = name.startswith("solve")
        table.add(
            evaluation=name,
            time=1e6 * span,
            ratio=span / base,
            difference=float(np.abs(rate - exact).max()),
            iterations=solvers[-1].records[-1].iterations if solved else None,
        )
    return table


def _rates(equations: RigidBodyEquations, y: list[float]) -> Callable[[], Any]:
    """The right-hand side of every body of a block in the state y."""
    rate = equations.rate_function()
    state = np.repeat(np.array(y)[:, None], equations.n_lanes, axis=1)
    out = np.empty_like(state)

    def action() -> Any:
        rate(0.0, state, out)
        return out

    return action
