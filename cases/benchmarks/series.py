"""Flows from data: what a motion and an ensemble take, beside a compiled script of one's own.

A spheroid of k = 1/5, massless, in a gradient of five cosines over T = 20, tolerance 1e-6. The
script is DOP853 of place and quaternion in numba, warm. `bar`: what it ought to be.

Run:      python cases/benchmarks/series.py      (2 min; --small: 30 s; --csv)
Expected: errors within the tolerance. The axis of one body alone (`Body.axes`) takes what the
          script does (0.14 ms), along samples twice that. A motion with events, observables and
          PETSc's 55 steps takes 0.6 ms in a process that has followed some bodies. A gradient is
          sampled beforehand ("sampling": the calls of the user's function), once for all. Many
          bodies in one flow take 18 us each; their axes alone take 0.9 ms in all. Lanes with
          series of their own take 2 us a sample. Paths of an ensemble take as long as the script,
          statistics included; "all" follows the first 256 once more, on fewer samples.
"""

import time
from functools import partial

import numba
import numpy as np
from measure import command
from measure import timed as by_clock
from scipy.integrate._ivp import dop853_coefficients as dop853

import qbxstokes as qs
from qbxstokes.flows.signals import Sampled
from qbxstokes.geometry import rotation
from qbxstokes.simulation.assembly import assemble

timed = partial(by_clock, clock=time.thread_time)
K, END, TOLERANCE, SAMPLES = 0.2, 20.0, 1e-6, 401
SHAPE = (1.0 - K * K) / (1.0 + K * K)
AXIS = np.array([0.48, 0.6, 0.64])
FREQUENCY = np.array([0.4, 0.9, 1.5, 2.3, 3.1])
A, B, C = dop853.A[:12, :12].copy(), dop853.B.copy(), dop853.C[:12].copy()
E5 = dop853.E5[:12].copy()


@numba.njit(error_model="numpy", cache=True)
def rate(t, y, amplitude, frequency, out):
    """dy/dt of place and quaternion by Jeffery's equation."""
    a = np.zeros((3, 3))
    for n in range(len(frequency)):
        c = np.cos(frequency[n] * t + 1.0)
        for i in range(3):
            for j in range(3):
                a[i, j] += c * amplitude[n, i, j]
    q0, q1, q2, q3 = y[3], y[4], y[5], y[6]
    s = 1.0 / (q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3)
    p0, p1 = 2.0 * s * (q1 * q3 + q0 * q2), 2.0 * s * (q2 * q3 - q0 * q1)
    p2 = s * (q0 * q0 - q1 * q1 - q2 * q2 + q3 * q3)
    for i in range(3):
        out[i] = a[i, 0] * y[0] + a[i, 1] * y[1] + a[i, 2] * y[2]
        out[3 + i] = 0.5 * SHAPE * ((a[i, 0] + a[0, i]) * p0 + (a[i, 1] + a[1, i]) * p1)
        out[3 + i] += 0.5 * SHAPE * (a[i, 2] + a[2, i]) * p2
    u = 0.5 * (a[2, 1] - a[1, 2]) + p1 * out[5] - p2 * out[4]
    v = 0.5 * (a[0, 2] - a[2, 0]) + p2 * out[3] - p0 * out[5]
    w = 0.5 * (a[1, 0] - a[0, 1]) + p0 * out[4] - p1 * out[3]
    out[3], out[4] = -0.5 * (u * q1 + v * q2 + w * q3), 0.5 * (u * q0 + v * q3 - w * q2)
    out[5], out[6] = 0.5 * (v * q0 + w * q1 - u * q3), 0.5 * (w * q0 + u * q2 - v * q1)


@numba.njit(error_model="numpy", cache=True)
def follow(p, amplitude, frequency, end, tolerance):
    """The state at the end, by DOP853 with steps of its own."""
    t, h = 0.0, 0.1
    k, y = np.zeros((12, 7)), np.zeros(7)
    while t < end:
        h = min(h, end - t)
        for s in range(12):
            for i in range(7):
                y[i] = p[i]
                for j in range(s):
                    y[i] += h * A[s, j] * k[j, i]
            rate(t + C[s] * h, y, amplitude, frequency, k[s])
        off = 1e-300
        for i in range(7):
            e = 0.0
            for s in range(12):
                e += h * E5[s] * k[s, i]
            off = max(off, abs(e) / tolerance)
        if off <= 1.0:
            t += h
            for s in range(12):
                for i in range(7):
                    p[i] += h * B[s] * k[s, i]
        h *= min(5.0, max(0.2, 0.9 * off ** (-1.0 / 6.0)))
    return p


def gradients(seed):
    """Amplitudes (5, 3, 3), traceless."""
    a = 0.25 * np.random.default_rng(seed).normal(size=(5, 3, 3))
    return a - np.trace(a, axis1=1, axis2=2)[:, None, None] * np.eye(3) / 3.0


def scripted(amplitudes, repeats=1, axis=AXIS, tolerance=TOLERANCE):
    """Time (s) and the axes at the end of the script that stands beside the program."""
    start = np.append(np.zeros(3), rotation.from_axis(axis))
    spent, found = timed(
        lambda: [follow(start.copy(), a, FREQUENCY, END, tolerance) for a in amplitudes], repeats
    )
    return spent, rotation.axis(rotation.normalize(np.array(found)[:, 3:]))


def followed(amplitude, count, repeats):
    """One body in a gradient given in three ways, and many in one: time, and error at the end."""

    def gradient(t):
        return np.einsum("n,nij->ij", np.cos(FREQUENCY * t + 1.0), amplitude)

    def row(what, spent, axis, exact, bar):
        error, bar = float(np.abs(axis - exact).max()), None if bar is None else 1e3 * bar
        return {"what": what, "ms": 1e3 * spent, "bar_ms": bar, "error": error}

    def moved(what, orientation, repeats, calls=1):
        """Time of a motion of several, and its axes at the end."""
        flow = qs.flow("linear", gradient=what)
        scene = qs.Simulation(body, flow, orientation=orientation, tolerance=TOLERANCE).assemble()
        # One body alone, too: as in any process that has followed some bodies.
        scene.equations.evaluation = "compiled"
        scene.integrate([END])  # compiles
        spent, motions = timed(lambda: [scene.integrate([END]) for _ in range(calls)], repeats)
        return spent / calls, motions[0].axis

    def turned(flow, start, calls):
        """Time of one call for the axes alone, after a first one, and these at the end."""
        body.axes(flow, [END], start)
        many = timed(lambda: [body.axes(flow, [END], start) for _ in range(calls)], 3)
        return many[0] / calls, many[1][0]

    def component(i, j):
        parts = zip(amplitude[:, i, j], FREQUENCY, strict=True)
        return " + ".join(f"({a:.17g})*cos({f}*t + 1)" for a, f in parts)

    times, body = np.linspace(0.0, END, SAMPLES), qs.Body(K)
    given = {
        "callable": gradient,
        "expression": [[component(i, j) for j in range(3)] for i in range(3)],
        "series": qs.GradientSeries(times, [gradient(t) for t in times]),
    }
    exact = scripted([amplitude], tolerance=1e-13)[1][0]
    spent, found = scripted([amplitude] * 100, repeats)
    bar, rows = 0.02 * spent, [row("one body, numba DOP853", spent / 100, found[0], exact, None)]
    for name, what in given.items():
        own, axis = moved(what, AXIS, repeats, 20)
        rows.append(row(f"one body, {name}", own, axis[-1], exact, bar))
        own, axis = turned(qs.flow("linear", gradient=what), AXIS, 20)
        rows.append(row(f"one axis, {name}", own, axis[-1], exact, bar))
    axes = np.random.default_rng(1).normal(size=(count, 3))
    exact = scripted([amplitude], 1, axes[0], 1e-13)[1][0]
    spent, axis = moved(gradient, axes, 1)
    rows.append(row(f"{count} bodies, callable", spent, axis[0, -1], exact, 2e-3))
    flow = qs.flow("linear", gradient=gradient)
    signal = flow.signal
    spent, _ = timed(lambda: Sampled(signal, END, 1e-9, END / 50.0).cover(END, 0.0), 3)
    rows.append({"what": "sampling, callable", "ms": 1e3 * spent, "bar_ms": None, "error": None})
    spent, axis = turned(flow, axes, 3)
    rows.append(row(f"{count} axes, callable", spent, axis[0, -1], exact, 2e-3))
    # Bodies that move along series of their own, together.
    _, amplitudes, samples = paths(64)
    flows = [qs.flow("linear", gradient=qs.GradientSeries(times, one)) for one in samples]
    keys = {"orientation": AXIS, "tolerance": TOLERANCE}
    together = assemble([qs.Simulation(body, flow, **keys) for flow in flows])
    together.integrate([END])
    spent, motion = timed(lambda: together.integrate([END]), 3)
    exact = scripted(amplitudes[:1], tolerance=1e-13)[1][0]
    return [*rows, row("64 bodies, 64 series", spent, motion.axis[0, -1], exact, None)]


def paths(count):
    """Times, amplitudes and samples (count, T, 3, 3) of gradients."""
    times = np.linspace(0.0, END, SAMPLES)
    amplitudes = np.array([gradients(seed) for seed in range(count)])
    waves = np.cos(FREQUENCY * times[:, None] + 1.0)
    return times, amplitudes, np.einsum("tn,pnij->ptij", waves, amplitudes)


def ensembles(count, repeats):
    """Paths with gradients of their own: us a path and sample."""
    times, amplitudes, samples = paths(count)
    series = qs.GradientSeries(times, samples.reshape(count, SAMPLES, 9).astype(np.float32))
    rows = []
    for name, chosen, stokes, bar in (
        ("statistics", {"sampling": False}, 0.0, 0.6),
        ("all", {}, 0.0, 0.6),
        ("statistics, St = 10", {"sampling": False}, 10.0, 2.0),
    ):
        settings = {"orientation": AXIS, "statistics": {**chosen, "quantities": ["tumbling"]}}
        run = partial(qs.ensemble, qs.Body(K, stokes_number=stokes), series, **settings)
        run()
        spent, _ = timed(run, repeats)
        rows.append({"what": name, "us": 1e6 * spent / (count * SAMPLES), "bar_us": bar})
    spent, _ = scripted(amplitudes, repeats)
    rows.append({"what": "numba DOP853", "us": 1e6 * spent / (count * SAMPLES), "bar_us": None})
    return rows


@command
def main(small=False):
    """The tables."""
    repeats = 3 if small else 9
    return {
        "series": followed(gradients(3), 1000 if small else 10_000, repeats),
        "ensemble": ensembles(256 if small else 2048, repeats),
    }
