"""Flows from data: what a motion and an ensemble take, beside a compiled script of one's own.

A spheroid of k = 1/5, massless, in a gradient of five cosines over T = 20, tolerance 1e-6. The
script is DOP853 of Jeffery's equation in numba, warm. `bar`: what it ought to be.

Run:      python cases/benchmarks/series.py      (2 min; --small: 30 s; --csv)
Expected: errors within the tolerance. A single motion takes 2 ms where the script takes 0.13, of
          which PETSc's 55 steps are 0.5; along samples 6 ms, a step for each of 400. That is in
          a process that has followed some bodies: the first ones take 5 ms. A gradient is
          sampled beforehand ("sampling": the calls of the user's function), once for all.
          Many bodies in one flow take 18 us each, as in a steady one; their axes alone take 1.5
          ms in all. Lanes with series of their own take 1.4 us a sample. Paths of an ensemble
          take as long as the script, statistics included; "all" follows the first 256 once
          more, on fewer samples.
"""

from __future__ import annotations

import time
from typing import Any

import numba
import numpy as np
from measure import Rows, command, timed
from scipy.integrate._ivp import dop853_coefficients as dop853

import qbxstokes as qs
from qbxstokes.flows.signals import Sampled
from qbxstokes.simulation.assembly import assemble

K, END, TOLERANCE, SAMPLES = 0.2, 20.0, 1e-6, 401
SHAPE = (1.0 - K * K) / (1.0 + K * K)
AXIS = np.array([0.48, 0.6, 0.64])
FREQUENCY = np.array([0.4, 0.9, 1.5, 2.3, 3.1])
A, B, C = dop853.A[:12, :12].copy(), dop853.B.copy(), dop853.C[:12].copy()
E5 = dop853.E5[:12].copy()


@numba.njit(error_model="numpy", cache=True)
def rate(t: float, p: Any, amplitude: Any, frequency: Any, out: Any) -> None:
    """dp/dt of Jeffery's equation."""
    a = np.zeros((3, 3))
    for n in range(len(frequency)):
        c = np.cos(frequency[n] * t + 1.0)
        for i in range(3):
            for j in range(3):
                a[i, j] += c * amplitude[n, i, j]
    along = 0.0
    for i in range(3):
        out[i] = 0.0
        for j in range(3):
            out[i] += 0.5 * (a[i, j] - a[j, i] + SHAPE * (a[i, j] + a[j, i])) * p[j]
        along += p[i] * out[i]
    for i in range(3):
        out[i] -= along * p[i]


@numba.njit(error_model="numpy", cache=True)
def follow(p: Any, amplitude: Any, frequency: Any, end: float, tolerance: float) -> Any:
    """The axis at the end, by DOP853 with steps of its own."""
    t, h = 0.0, 0.1
    k, y = np.zeros((12, 3)), np.zeros(3)
    while t < end:
        h = min(h, end - t)
        for s in range(12):
            for i in range(3):
                y[i] = p[i]
                for j in range(s):
                    y[i] += h * A[s, j] * k[j, i]
            rate(t + C[s] * h, y, amplitude, frequency, k[s])
        off = 1e-300
        for i in range(3):
            e = 0.0
            for s in range(12):
                e += h * E5[s] * k[s, i]
            off = max(off, abs(e) / tolerance)
        if off <= 1.0:
            t += h
            for s in range(12):
                for i in range(3):
                    p[i] += h * B[s] * k[s, i]
        h *= min(5.0, max(0.2, 0.9 * off ** (-1.0 / 6.0)))
    return p


def gradients(seed: int) -> Any:
    """Amplitudes (5, 3, 3), traceless."""
    a = 0.25 * np.random.default_rng(seed).normal(size=(5, 3, 3))
    return a - np.trace(a, axis1=1, axis2=2)[:, None, None] * np.eye(3) / 3.0


def main(small: bool = False) -> dict[str, Rows]:
    """The tables."""
    repeats = 3 if small else 9
    amplitude = gradients(3)

    def gradient(t: float) -> Any:
        return np.einsum("n,nij->ij", np.cos(FREQUENCY * t + 1.0), amplitude)

    times = np.linspace(0.0, END, SAMPLES)
    text = [
        [
            " + ".join(
                f"({a[i, j]:.17g})*cos({f}*t + 1)"
                for a, f in zip(amplitude, FREQUENCY, strict=True)
            )
            for j in range(3)
        ]
        for i in range(3)
    ]
    given = {
        "callable": gradient,
        "expression": text,
        "series": qs.GradientSeries(times, [gradient(t) for t in times]),
    }
    exact = follow(AXIS.copy(), amplitude, FREQUENCY, END, 1e-13)
    follow(AXIS.copy(), amplitude, FREQUENCY, END, TOLERANCE)
    script, found = timed(
        lambda: [follow(AXIS.copy(), amplitude, FREQUENCY, END, TOLERANCE) for _ in range(100)],
        repeats,
        time.thread_time,
    )
    script /= 100
    rows = [_row("one body, numba DOP853", script, found[0], exact, None)]
    body = qs.Body(K)
    for name, what in given.items():
        scene = qs.Simulation(
            body, qs.flow("linear", gradient=what), orientation=AXIS, tolerance=TOLERANCE
        ).assemble()
        scene.equations.evaluation = "compiled"  # as in any process that has followed some bodies
        scene.motion([END])
        spent, motion = timed(lambda scene=scene: scene.motion([END]), repeats, time.thread_time)
        rows.append(_row(f"one body, {name}", spent, motion.axis[-1], exact, 2.0 * script))
    n = 1000 if small else 10_000
    axes = np.random.default_rng(1).normal(size=(n, 3))
    scene = qs.Simulation(
        body, qs.flow("linear", gradient=gradient), orientation=axes, tolerance=TOLERANCE
    ).assemble()
    scene.motion([END])  # compiles
    spent, motion = timed(lambda: scene.motion([END]), 1, time.thread_time)
    p = axes[0] / np.linalg.norm(axes[0])
    p = follow(p, amplitude, FREQUENCY, END, 1e-13)
    rows.append(_row(f"{n} bodies, callable", spent, motion.axis[0, -1], p, 2e-3))
    flow = qs.flow("linear", gradient=gradient)
    signal = flow.signal
    spent, _ = timed(
        lambda: Sampled(signal, END, 1e-9, END / 50.0).cover(END, 0.0), 3, time.thread_time
    )
    rows.append({"what": "sampling, callable", "ms": 1e3 * spent, "bar_ms": None, "error": None})
    body.axes(flow, [END], axes)
    spent, found = timed(lambda: body.axes(flow, [END], axes), 3, time.thread_time)
    rows.append(_row(f"{n} axes, callable", spent, found[0, -1], p, 2e-3))
    rows.append(_lanes(body, 64))
    return {"series": rows, "ensemble": _ensemble(256 if small else 2048, repeats)}


def _lanes(body: Any, n: int) -> dict[str, Any]:
    """Bodies that move along series of their own, together."""
    times = np.linspace(0.0, END, SAMPLES)
    waves = np.cos(FREQUENCY * times[:, None] + 1.0)
    amplitudes = [gradients(seed) for seed in range(n)]
    scenes = [
        qs.Simulation(
            body,
            qs.flow(
                "linear", gradient=qs.GradientSeries(times, np.einsum("tn,nij->tij", waves, a))
            ),
            orientation=AXIS,
            tolerance=TOLERANCE,
        )
        for a in amplitudes
    ]
    together = assemble(scenes)
    together.motion([END])
    spent, motion = timed(lambda: together.motion([END]), 3, time.thread_time)
    exact = follow(AXIS.copy(), amplitudes[0], FREQUENCY, END, 1e-13)
    return _row(f"{n} bodies, {n} series", spent, motion.axis[0, -1], exact, None)


def _row(what: str, spent: float, axis: Any, exact: Any, bar: float | None) -> dict[str, Any]:
    return {
        "what": what,
        "ms": 1e3 * spent,
        "bar_ms": None if bar is None else 1e3 * bar,
        "error": float(np.abs(axis - exact).max()),
    }


def _ensemble(paths: int, repeats: int) -> Rows:
    """Paths with gradients of their own: us a path and sample."""
    times = np.linspace(0.0, END, SAMPLES)
    waves = np.cos(FREQUENCY * times[:, None] + 1.0)
    amplitudes = np.array([gradients(seed) for seed in range(paths)])
    samples = np.einsum("tn,pnij->ptij", waves, amplitudes).reshape(paths, SAMPLES, 9)
    series = qs.GradientSeries(times, samples.astype(np.float32))
    rows, bodies = [], {0.0: qs.Body(K), 10.0: qs.Body(K, stokes_number=10.0)}
    for name, chosen, stokes, bar in (
        ("statistics", {"sampling": False}, 0.0, 0.6),
        ("all", {}, 0.0, 0.6),
        ("statistics, St = 10", {"sampling": False}, 10.0, 2.0),
    ):
        settings = {**chosen, "quantities": ["tumbling"]}

        def run(settings: dict[str, Any] = settings, body: Any = bodies[stokes]) -> Any:
            return qs.ensemble(body, series, orientation=AXIS, statistics=settings)

        run()
        spent, _ = timed(run, repeats, time.thread_time)
        rows.append({"what": name, "us": 1e6 * spent / (paths * SAMPLES), "bar_us": bar})
    spent, _ = timed(
        lambda: [follow(AXIS.copy(), a, FREQUENCY, END, TOLERANCE) for a in amplitudes],
        repeats,
        time.thread_time,
    )
    rows.append({"what": "numba DOP853", "us": 1e6 * spent / (paths * SAMPLES), "bar_us": None})
    return rows


if __name__ == "__main__":
    command(main)
