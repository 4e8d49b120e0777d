"""Users' functions as flows: what a right-hand side takes.

A spheroid of k = 1/5 in rolls of length 30 that oscillate, T = 20, tolerance 1e-6: all of a run
over its right-hand sides, checks of the steps included. `bar`: what it ought to be.

Run:      python cases/benchmarks/functions.py      (1 min; --small: 20 s; --csv)
Expected: a right-hand side of many bodies takes 1 us each by compiled functions, 3 by NumPy's, 0.2
          by a given gradient; of one body 2 us, besides 7 ms of the run for looks at the flow,
          and 130 us by NumPy's. (Errors: tests/stress/test_tolerances.py.)
"""

import math
import time
from functools import partial

import numba
import numpy as np
from measure import command, timed

import qbxstokes as qs

END, TOLERANCE, AXIS = 20.0, 1e-6, [0.48, 0.6, 0.64]


def rolls(x, y, z, t, s):
    """The flow at a point."""
    w = s * math.cos(t) * math.exp(0.03 * y)
    return w * math.cos(0.03 * x), w * math.sin(0.03 * x), 0.0


@numba.cfunc(
    numba.void(*[numba.float64] * 4, *[numba.types.CPointer(numba.float64)] * 2), cache=True
)
def rolls_in_c(x, y, z, t, p, u):  # type: ignore[no-untyped-def]
    """The same as a function of C."""
    w = p[0] * math.cos(t) * math.exp(0.03 * y)
    u[0], u[1], u[2] = w * math.cos(0.03 * x), w * math.sin(0.03 * x), 0.0


def many(x, t, s):
    """The same at many points."""
    w = s * np.cos(t) * np.exp(0.03 * x[:, 1])
    return np.stack([w * np.cos(0.03 * x[:, 0]), w * np.sin(0.03 * x[:, 0]), 0.0 * w], axis=1)


def gradient(x, t, s):
    """Its derivatives, d_j u_i."""
    w = 0.03 * s * np.cos(t) * np.exp(0.03 * x[:, 1])
    c, d = w * np.cos(0.03 * x[:, 0]), w * np.sin(0.03 * x[:, 0])
    found = np.zeros((len(x), 3, 3))
    found[:, 0, 0], found[:, 0, 1], found[:, 1, 0], found[:, 1, 1] = -d, c, c, d
    return found


def shear(x, t, s):
    """An oscillating shear, which is recognised."""
    found = np.zeros_like(x)
    found[:, 0] = s * np.cos(t) * x[:, 1]
    return found


@command
def main(small=False):
    """The table."""
    lanes, repeats = (256, 2) if small else (1000, 5)
    derived = {"hydrodynamics": {"derivatives": 1}}
    known = {"parameters": {"s": 0.5}, "length": 30.0}
    kinds = [
        ("compiled", {"function": rolls, "compiled": True}, {}, 5.0),
        ("of C", {"function": rolls_in_c, "compiled": True}, {}, 5.0),
        ("compiled, St = 10", {"function": rolls, "compiled": True}, {"stokes_number": 10.0}, 5.0),
        ("NumPy", {"function": many}, {}, None),
        ("NumPy, St = 10", {"function": many}, {"stokes_number": 10.0}, None),
        ("gradient by differences", {"function": many}, derived, 1.0),
        ("gradient given", {"function": many, "gradient": gradient}, derived, 0.2),
        ("recognised shear", {"function": shear}, {}, None),
    ]
    rows = []
    axes = np.random.default_rng(1).normal(size=(lanes, 3))
    for name, flow, body, bar in kinds:
        row = {"what": name, "bar_us": bar}
        for count, start in ((1, AXIS), (lanes, axes)):
            moved, keys = qs.flow("user", **flow, **known), {"tolerance": TOLERANCE}
            scene = qs.Simulation(qs.Body(0.2, **body), moved, orientation=start, **keys).assemble()
            scene.integrate([END])
            spent, motion = timed(partial(scene.integrate, [END]), repeats, time.thread_time)
            calls = motion.summary["rhs_evaluations"]
            row[f"{'one' if count == 1 else 'each of many'}_us"] = 1e6 * spent / calls / count
            if count == 1:
                row["one_ms"] = 1e3 * spent
        rows.append(row)
    return {"functions": rows}
