"""Cost of a right-hand side: solve, functional on the grid, table on monomials, closed form."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from qbxstokes.app.benchmark.timing import seconds_each
from qbxstokes.bie.accuracy import accurate_body
from qbxstokes.bie.operators import surface_operators
from qbxstokes.bie.providers import GridMotion, SolveMotion
from qbxstokes.flows import build_flow
from qbxstokes.geometry import rotation
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.io.tables import Column, Table
from qbxstokes.motion.equations import RigidBodyEquations

if TYPE_CHECKING:
    from qbxstokes.app.tabulate import Work

ASPECT_RATIO = 0.5
BLOCK = 4096


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


def tables(work: Work) -> Iterator[Table]:
    """Microseconds of one right-hand side of one body, over those of the closed form."""
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
    q = rotation.normalize([0.7, 0.3, -0.4, 0.5])
    y = [0.1, 0.2, 0.3, *q.tolist()]
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
    yield table


def _rates(equations: RigidBodyEquations, y: list[float]) -> Callable[[], Any]:
    """The right-hand side of every body of a block in the state y."""
    rate = equations.rate_function()
    state = np.repeat(np.array(y)[:, None], equations.n_bodies, axis=1)
    out = np.empty_like(state)

    def action() -> Any:
        rate(0.0, state, out)
        return out

    return action
