"""Cost of a right-hand side by every way to it: solve, functional, table, closed form.

A body of k = 1/2 in shear. `step`: the right-hand side alone, massless. `integrated`: under 8vr,
PETSc's own work included, in turns.

Run:      python cases/benchmarks/step.py      (30 s; --small: 5 s; --csv)
Expected: the same rates by every way; a table on monomials costs what the closed form costs, a
          microsecond in plain Python, and a fortieth of one per body in a compiled block; a solve
          at every step costs a thousand times as much.
"""

import time
from functools import partial
from statistics import median

import numpy as np
from measure import command, seconds_each, turns

from qbxstokes.bie.accuracy import accurate_body
from qbxstokes.bie.operators import surface_operators
from qbxstokes.bie.providers import GridMotion, SolveMotion
from qbxstokes.flows.named import Shear
from qbxstokes.geometry import rotation
from qbxstokes.geometry.spheroid import Spheroid
from qbxstokes.motion.equations import RigidBodyEquations
from qbxstokes.petsc import session
from qbxstokes.simulation.hydrodynamics import exact_model

K = 0.5
SHAPE = (1.0 - K * K) / (1.0 + K * K)
BLOCK = 4096
QUATERNION = rotation.normalize([0.7, 0.3, -0.4, 0.5]).tolist()


def closed_form(y, shape):
    """dy/dt of a massless spheroid in u = (x2, 0, 0), plain arithmetic on y = (x, q).

    Omega = w/2 + lambda d x (E d) (Jeffery 1922), shape = lambda = (1 - k^2)/(1 + k^2).
    """
    _, x2, _, q0, q1, q2, q3 = y
    s = 1.0 / (q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3)
    d1, d2 = 2.0 * s * (q1 * q3 + q0 * q2), 2.0 * s * (q2 * q3 - q0 * q1)
    d3 = s * (q0 * q0 - q1 * q1 - q2 * q2 + q3 * q3)
    half = 0.5 * shape
    a, b, c = -half * d3 * d1, half * d3 * d2, -0.5 + half * (d1 * d1 - d2 * d2)
    p0, p1 = -0.5 * (a * q1 + b * q2 + c * q3), 0.5 * (a * q0 + b * q3 - c * q2)
    p2, p3 = 0.5 * (b * q0 + c * q1 - a * q3), 0.5 * (c * q0 + a * q2 - b * q1)
    return x2, 0.0, 0.0, p0, p1, p2, p3


def closed_form_inertial(y, shape, drag, gyration):
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
    slip, spin = (along - across) * (e1 * d1 - v2 * d2 - v3 * d3), gyration * w3
    p0, p1 = -0.5 * (q1 * w1 + q2 * w2 + q3 * w3), 0.5 * (q0 * w1 + q2 * w3 - q3 * w2)
    p2, p3 = 0.5 * (q0 * w2 + q3 * w1 - q1 * w3), 0.5 * (q0 * w3 + q1 * w2 - q2 * w1)
    f1, f2, f3 = across * e1 + slip * d1, -across * v2 + slip * d2, -across * v3 + slip * d3
    m1 = turning * (s * (a1 * o1 + 2.0 * (a2 * o2 + a3 * o3)) - w1) - spin * w2
    m2 = turning * (s * (b2 * o2 + 2.0 * (b1 * o1 + b3 * o3)) - w2) + spin * w1
    m3 = spinning * (d1 * o1 + d2 * o2 + d3 * o3 - w3)
    return v1, v2, v3, p0, p1, p2, p3, f1, f2, f3, m1, m2, m3


class Given(RigidBodyEquations):
    """Equations of motion whose `given` makes the rates of rows."""

    rate_of_rows = property(lambda self: self.given)


def rates(equations, y, bodies=1):
    """The right-hand side of every body of a block in the state y."""
    rate, state = equations.rate_function(), np.repeat(np.array(y)[:, None], bodies, axis=1)
    out = np.empty_like(state)
    return lambda: rate(0.0, state, out) or out


def alone(repeats):
    """Time per body and right-hand side, and the largest difference from the closed form."""
    from qbxstokes.petsc.gmres import GmresSolver

    body = accurate_body(Spheroid(K), 1e-12)
    operators = surface_operators(Spheroid(K), body.scheme, 6)
    y = [0.1, 0.2, 0.3, *QUATERNION]
    solvers = []

    def gmres(operator, grid):
        solvers.append(GmresSolver(operator, grid, 1e-12))
        return solvers[-1]

    def compiled(bodies):
        equations = RigidBodyEquations(body.model, Shear(), 0.0, bodies, evaluation="compiled")
        return rates(equations, y, bodies)

    plain = RigidBodyEquations(body.model, Shear()).rate_of_rows
    grid = GridMotion(body.functional.on_grid(6), Shear())
    solve = SolveMotion(operators, Shear(), gmres)
    ways = {
        "closed form": (lambda: closed_form(y, SHAPE), 1),
        "table, plain Python": (lambda: plain(0.0, y), 1),
        "table, compiled, one body": (compiled(1), 1),
        f"table, compiled, {BLOCK} bodies": (compiled(BLOCK), BLOCK),
        "functional on the grid": (rates(RigidBodyEquations(body.model, grid), y), 1),
        "solve at every step": (rates(RigidBodyEquations(body.model, solve), y), 1),
    }
    rows = []
    for name, (action, bodies) in ways.items():
        rate = np.asarray(action(), dtype=float).reshape(7, -1)[:, 0]
        span = 1e6 * seconds_each(action, repeats) / bodies
        row = {"evaluation": name, "microseconds": span}
        row["ratio"] = span / rows[0]["microseconds"] if rows else 1.0
        row["difference"] = float(np.abs(rate - closed_form(y, SHAPE)).max())
        row["iterations"] = solvers[-1].records[-1].iterations if "solve" in name else None
        rows.append(row)
    return rows


def integrated(stokes_number, end, rounds):
    """Wall time of an integration per right-hand side."""
    from qbxstokes.petsc.stepper import integrate

    model = exact_model(Spheroid(K))
    closed = Given(model, Shear(), stokes_number, evaluation="plain")
    ways = {"closed form": closed}
    for way in ("plain", "compiled"):
        ways[f"table, {way}"] = RigidBodyEquations(model, Shear(), stokes_number, evaluation=way)
    closed.given = lambda t, y: closed_form(y, SHAPE)
    if stokes_number:
        drag = tuple(closed.relaxation_rates[:, 0].tolist())
        j1, _, j3 = Spheroid(K).inertia.tolist()
        gyration = (j3 - j1) / j1
        closed.given = lambda t, y: closed_form_inertial(y, SHAPE, drag, gyration)
    start = closed.initial_state(np.zeros(3), QUATERNION)
    exact = np.array(closed.rate_of_rows(0.0, start[0].tolist()))
    counts = {}

    def run(name):
        begin = time.perf_counter()
        motion = integrate(ways[name], start, [end], 1e-8, method="8vr")
        counts[name] = motion.checkpoint.evaluations
        return 1e6 * (time.perf_counter() - begin) / counts[name]

    spans = turns({name: partial(run, name) for name in ways}, rounds)
    rows = []
    for name, equations in ways.items():
        out = rates(equations, start[0].tolist())()[:, 0]
        shares = np.array(spans[name]) / np.array(spans["closed form"])
        row = {"St": stokes_number, "evaluation": name, "right_hand_sides": counts[name]}
        row |= {"microseconds": median(spans[name]), "ratio": float(np.median(shares))}
        rows.append(row | {"difference": float(np.abs(out - exact).max())})
    return rows


@command
def main(small=False):
    """Both tables."""
    session.start([])
    runs = [integrated(st, 5.0 if small else 200.0, 1 if small else 20) for st in (0.0, 1.0)]
    return {"step": alone(1 if small else 5), "integrated": [*runs[0], *runs[1]]}
