"""Quadratic flow: massless bodies against Chwang, an inertial one in his plane, a sample run."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np

from qbxstokes.app.study import simulate
from qbxstokes.app.study.linear_shear import fill
from qbxstokes.io.tables import Column, Table
from qbxstokes.reference import chwang, heavy, inertial, jeffery

ACCURATE = 1e-11
BOUND = 1e-7
_AXES = np.array([[0.48, -0.6, 0.64], [0.6, 0.8, 0.0], [0.1, 0.2, 0.97], [1.0, 0.0, 0.0]])


def blocks(full: bool) -> list[dict[str, Any]]:
    """Massless bodies per aspect ratio; inertial ones per aspect ratio and St; sample runs."""
    ratios = (0.1, 0.2, 0.5, 2.0, 5.0, 10.0) if full else (0.5, 2.0)
    stokes = (0.1, 1.0, 10.0, 100.0, 1000.0) if full else (10.0,)
    found: list[dict[str, Any]] = [{"k": k} for k in ratios]
    found += [
        {"k": k, "stokes_number": st}
        for k in ratios
        for st in stokes
        # The explicit reference has to follow every relaxation.
        if max(heavy.relaxation_rates(k)) / st * jeffery.period(k) < 2e3
    ]
    shown = ((0.5, 10.0, 600.0), (2.0, 1.0, 200.0)) if full else ((0.5, 10.0, 60.0),)
    return found + [{"k": k, "sample": st, "end": end} for k, st, end in shown]


def compute(
    k: float,
    stokes_number: float | None = None,
    sample: float | None = None,
    end: float = 0.0,
) -> list[dict[str, Any]]:
    """Errors against Chwang's velocity, or in his special orientation; or a run in full."""
    if stokes_number is not None:
        return _special(k, stokes_number)
    return _massless(k) if sample is None else _sample(k, sample, end)


def _flow(distance: float) -> Any:
    """Paraboloid of shear rate 1 at the distance."""
    return simulate.polynomial(type="paraboloid", curvature=0.5 / distance)


def _massless(k: float) -> list[dict[str, Any]]:
    rows = []
    for distance in (1.0, 3.0, 10.0):
        curvature = 0.5 / distance
        times = np.linspace(0.0, 2.0 * jeffery.period(k), 201)
        axis = _AXES / np.linalg.norm(_AXES, axis=1, keepdims=True)
        begin = time.perf_counter()
        run = simulate.simulate(
            k, _flow(distance), 0.0, axis, times, ACCURATE, (0.0, distance, 0.0)
        )
        spent = time.perf_counter() - begin
        velocity, turned = 0.0, 0.0
        for i, start in enumerate(axis):
            exact = jeffery.axis_at(times, k, start)
            turned = max(turned, float(np.abs(run.samples["axis"][:, i] - exact).max()))
            along = np.clip(exact[:, 0], -1.0, 1.0)
            speed = [chwang.free_velocity(k, curvature, distance, math.acos(a)) for a in along]
            free = np.outer(speed, [1.0, 0.0, 0.0])
            error = np.abs(run.samples["velocity"][:, i] - free).max()
            velocity = max(velocity, float(error / np.abs(free).max()))
        rows.append(
            {
                "table": "chwang",
                "aspect_ratio": k,
                "distance": distance,
                "velocity_error": velocity,
                "axis_error": turned,
                "time": spent / len(axis),
                "passed": max(velocity, turned) < BOUND,
            }
        )
    return rows


def _special(k: float, stokes: float) -> list[dict[str, Any]]:
    distance, phi = 3.0, 0.5
    axis = np.array([[math.sin(phi), -math.cos(phi), 0.0]])
    times = np.linspace(0.0, 2.0 * jeffery.period(k), 201)
    begin = time.perf_counter()
    run = simulate.simulate(k, _flow(distance), stokes, axis, times, ACCURATE, (0.0, distance, 0.0))
    spent = time.perf_counter() - begin
    exact = inertial.paraboloid(k, stokes, 0.5 / distance, (0.0, distance), phi, times)
    d = np.stack([np.sin(exact.phi), -np.cos(exact.phi), 0.0 * exact.phi], axis=-1)
    path = run.samples["position"][:, 0, :2] - exact.position
    travelled = np.ptp(exact.position, axis=0)
    axis_error = float(np.abs(run.samples["axis"][:, 0] - d).max())
    return [
        {
            "table": "special_orientation",
            "aspect_ratio": k,
            "stokes_number": stokes,
            "axis_error": axis_error,
            "along_error": float(np.abs(path[:, 0]).max() / travelled[0]),
            "across_error": float(np.abs(path[:, 1]).max() / travelled[1]),
            "across": float(exact.position[-1, 1] - distance),
            "method": run.method,
            "time": spent,
            "passed": axis_error < BOUND,
        }
    ]


def _sample(k: float, stokes: float, end: float) -> list[dict[str, Any]]:
    """Everything about one run from rest, three lengths off the axis, in general orientation."""
    axis = _AXES[:1] / np.linalg.norm(_AXES[0])
    times = np.linspace(0.0, end, 2401)
    still = np.zeros((1, 3))
    run = simulate.simulate(
        k,
        _flow(3.0),
        stokes,
        axis,
        times,
        position=(0.0, 3.0, 0.0),
        wanted=("euler_angles",),
        velocity=still,
        angular_velocity=still,
    )
    s = {name: values[:, 0] for name, values in run.samples.items()}
    angles = np.unwrap(s["euler_angles"], axis=0)
    rows = []
    for i, t in enumerate(times.tolist()):
        row: dict[str, Any] = {
            "table": "sample_run",
            "aspect_ratio": k,
            "stokes_number": stokes,
            "time": t,
        }
        for name, symbol in (("position", "x"), ("velocity", "v"), ("axis", "d")):
            row |= {f"{symbol}{j + 1}": float(s[name][i, j]) for j in range(3)}
        row |= {f"omega{j + 1}": float(s["angular_velocity"][i, j]) for j in range(3)}
        row |= {name: float(angles[i, j]) for j, name in enumerate(("phi", "theta", "psi"))}
        rows.append(row)
    return rows


def tables(rows: list[dict[str, Any]]) -> list[Table]:
    """Errors against Chwang without and with inertia, and the sample runs."""
    k = Column("aspect_ratio", "", "equatorial over polar radius", "g", "k")
    st = Column("stokes_number", "", "Stokes number", "g", "St")
    passed = Column("passed", "", "error below its bound")
    seconds = Column("time", "s", "wall time of the integration, per body", ".2g")
    massless = Table(
        "chwang",
        "Massless spheroids in a paraboloid against Chwang and Jeffery, four orientations",
        (
            k,
            Column("distance", "c", "from the axis of the flow", "g"),
            Column("velocity_error", "", "largest, relative to the largest velocity", ".1e"),
            Column("axis_error", "", "largest distance from Jeffery's axis, two periods", ".1e"),
            seconds,
            passed,
        ),
        plot={"x": "aspect_ratio", "y": ["velocity_error", "axis_error"], "scale": "loglog",
              "points": True},
    )  # fmt: skip
    special = Table(
        "special_orientation",
        "Inertial spheroids in Chwang's orientation against the semi-analytic equations",
        (
            k,
            st,
            Column("axis_error", "", "largest distance of the axes, two periods", ".1e"),
            Column("along_error", "", "of the path along the stream, relative", ".1e"),
            Column("across_error", "", "of the path across the stream, relative", ".1e"),
            Column("across", "c", "displacement towards higher shear at the end", ".3e"),
            Column("method", "", "formula of the integrator"),
            seconds,
            passed,
        ),
        plot={"x": "stokes_number", "y": "axis_error", "by": "aspect_ratio", "scale": "loglog"},
    )
    names = ("x1", "x2", "x3", "v1", "v2", "v3", "d1", "d2", "d3", "omega1", "omega2", "omega3")
    unit = {"x": "c", "v": "c/tau", "d": "", "o": "1/tau"}
    sample = Table(
        "sample_run",
        "Sample runs in a paraboloid, released at rest three lengths from its axis",
        (
            k,
            st,
            Column("time", "tau", "", ".2f"),
            *(Column(name, unit[name[0]], "", ".6f") for name in names),
            *(Column(name, "rad", "Euler angle", ".4f") for name in ("phi", "theta", "psi")),
        ),
    )
    return fill([massless, special, sample], rows)


def _figure(made: dict[str, Table]) -> Any:
    """The sample runs: a column each."""
    from qbxstokes.plots import style

    sample = made["sample_run"]
    pairs = sorted(
        set(zip(sample["aspect_ratio"].tolist(), sample["stokes_number"].tolist(), strict=True))
    )
    figure = style.new_figure(style.PAGE, 8.2)
    panels = figure.subplots(7, len(pairs), squeeze=False, sharex="col")
    turns = "turns of the axis\n$\\varphi/2\\pi$"
    for column, (k, stokes) in enumerate(pairs):
        chosen = (sample["aspect_ratio"] == k) & (sample["stokes_number"] == stokes)
        t = sample["time"][chosen]
        row = panels[:, column]
        groups: tuple[tuple[str, tuple[tuple[str, str], ...]], ...] = (
            ("across the stream\n$x_i-x_i(0)$", (("x2", "$x_2$"), ("x3", "$x_3$"))),
            ("velocity $V_1$", (("v1", "$V_1$"),)),
            ("$V_2,V_3$", (("v2", "$V_2$"), ("v3", "$V_3$"))),
            ("axis $D^3$", (("d1", "$D^3_1$"), ("d2", "$D^3_2$"), ("d3", "$D^3_3$"))),
            ("angle $\\theta$ (rad)", (("theta", r"$\theta$"),)),
            (turns, (("phi", r"$\varphi$"),)),
            (
                r"$\mathbf{\Omega}$",
                (("omega1", r"$\Omega_1$"), ("omega2", r"$\Omega_2$"), ("omega3", r"$\Omega_3$")),
            ),
        )
        for axes, (label, curves) in zip(row, groups, strict=True):
            for index, (name, text) in enumerate(curves):
                values = sample[name][chosen]
                values = values - values[0] if name[0] == "x" else values
                values = values / (2.0 * np.pi) if name == "phi" else values
                color = style.LINES[index][0]
                axes.plot(t, values, color=color, linewidth=0.6, label=text)
            if len(curves) > 1:
                legend = axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), handlelength=1)
                for line in legend.get_lines():
                    line.set_linewidth(1.5)
            if column == 0:
                axes.set_ylabel(label)
        # The first push across the stream is a hundred times the drift that follows.
        row[2].set_yscale("symlog", linthresh=1e-3)
        row[2].set_yticks([-1e-2, -1e-3, 0.0, 1e-3, 1e-2])
        row[0].set_title(f"$k={k:g}$, $\\mathrm{{St}}={stokes:g}$", loc="left")
        row[-1].set_xlabel(style.label("time $t$", "tau"))
    figure.align_ylabels(panels[:, 0])
    return figure


FIGURES = {"sample_run": _figure}
