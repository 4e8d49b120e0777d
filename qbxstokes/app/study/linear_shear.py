"""Linear shear: massless bodies against Jeffery, inertial ones against semi-analytic equations."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from qbxstokes.app.study import simulate
from qbxstokes.geometry import rotation
from qbxstokes.io.tables import Column, Table
from qbxstokes.reference import heavy, inertial, jeffery

ACCURATE = 1e-11
_LIMITS = {"jeffery": 1e-7, "inertial_shear": 1e-7}
_RELEASE = np.array([0.48, -0.6, 0.64])  # an oblique axis


def blocks(full: bool) -> list[dict[str, Any]]:
    """One block per aspect ratio without inertia, and per aspect ratio and Stokes number with."""
    ratios = (0.05, 0.1, 0.2, 0.5, 2.0, 5.0, 10.0, 20.0) if full else (0.5, 2.0)
    constants = (0.1, 0.5, 1.0, 2.0, 10.0) if full else (0.5, 2.0)
    stokes = (0.1, 1.0, 10.0, 100.0, 1000.0) if full else (1.0, 100.0)
    found: list[dict[str, Any]] = [{"k": k, "constants": constants} for k in ratios]
    found += [
        {"k": k, "stokes_number": st}
        for k in ratios
        if 0.1 <= k <= 10.0
        for st in stokes
        # The explicit reference has to follow every relaxation.
        if max(heavy.relaxation_rates(k)) / st * jeffery.period(k) < 2e3
    ]
    chosen = (0.0, 30.0, 100.0, 300.0, 3000.0) if full else (0.0, 100.0)
    return found + [{"k": 0.2, "history": st} for st in chosen]


def compute(
    k: float,
    constants: list[float] | None = None,
    stokes_number: float | None = None,
    history: float | None = None,
) -> list[dict[str, Any]]:
    """Errors of orbits, of an inertial motion, or the rotation rate over a turn."""
    if constants is not None:
        return _orbits(k, np.array(constants))
    if stokes_number is not None:
        return _inertial(k, stokes_number)
    assert history is not None
    return _history(k, history)


def _orbits(k: float, constants: Any) -> list[dict[str, Any]]:
    period = jeffery.period(k)
    times = np.linspace(0.0, 3.0 * period, 301)
    start = simulate.orbit_axes(k, constants, 0.3)
    begin = time.perf_counter()
    run = simulate.simulate(k, simulate.shear(), 0.0, start, times, ACCURATE)
    spent = time.perf_counter() - begin
    axis = run.samples["axis"]
    rows = []
    for i, constant in enumerate(constants.tolist()):
        exact = jeffery.axis_at(times, k, start[i])
        orbit = jeffery.orbit_constant(k, axis[:, i])
        turn = np.unwrap(np.arctan2(axis[:, i, 1], k * axis[:, i, 0]))
        measured = 2.0 * np.pi * times[-1] / abs(turn[-1] - turn[0])
        error = float(np.linalg.norm(axis[:, i] - exact, axis=-1).max())
        rows.append(
            {
                "table": "jeffery",
                "aspect_ratio": k,
                "orbit_constant": constant,
                "period": measured,
                "period_error": abs(measured / period - 1.0),
                "axis_error": error,
                "orbit_constant_error": float(np.abs(orbit / orbit[0] - 1.0).max()),
                "steps": run.steps,
                "time": spent / len(constants),
                "passed": error < _LIMITS["jeffery"],
            }
        )
    return rows


def _inertial(k: float, stokes: float) -> list[dict[str, Any]]:
    period = jeffery.period(k)
    times = np.linspace(0.0, 2.0 * period, 201)
    axis = _RELEASE[None] / np.linalg.norm(_RELEASE)
    begin = time.perf_counter()
    run = simulate.simulate(k, simulate.shear(), stokes, axis, times, ACCURATE)
    spent = time.perf_counter() - begin
    gradient = np.zeros((3, 3))
    gradient[0, 1] = 1.0
    q0 = simulate.orientation(axis)[0]
    exact = inertial.linear_flow(k, stokes, gradient, q0, times)
    spin = rotation.to_space(exact.orientation, exact.angular_velocity)
    error = np.linalg.norm(run.samples["axis"][:, 0] - rotation.axis(exact.orientation), axis=-1)
    turning = np.linalg.norm(run.samples["angular_velocity"][:, 0] - spin, axis=-1)
    return [
        {
            "table": "inertial_shear",
            "aspect_ratio": k,
            "stokes_number": stokes,
            "axis_error": float(error.max()),
            "angular_velocity_error": float(turning.max() / np.abs(spin).max()),
            "steps": run.steps,
            "method": run.method,
            "time": spent,
            "passed": float(error.max()) < _LIMITS["inertial_shear"],
        }
    ]


def _history(k: float, stokes: float) -> list[dict[str, Any]]:
    """Rotation rate over half a turn in the plane of shear, from alignment to alignment."""
    tumble = simulate.orbit_axes(k, np.inf)
    half = heavy.tumbling(k, stokes).half_turn
    relaxed = simulate.TRANSIENT * stokes / heavy.relaxation_rates(k)[2]
    lead = half * np.ceil(relaxed / half)
    times = lead + np.linspace(0.0, 2.1 * half, 800)
    run = simulate.simulate(k, simulate.shear(), stokes, tumble, times, ACCURATE)
    axis, spin = run.samples["axis"][:, 0], run.samples["angular_velocity"][:, 0, 2]
    angle = np.unwrap(np.arctan2(axis[:, 1], axis[:, 0]))
    angle -= np.pi * np.floor(angle[0] / np.pi)  # zero where the axis is next along the stream
    return [
        {
            "table": "rotation_history",
            "aspect_ratio": k,
            "stokes_number": stokes,
            "angle": float(a / np.pi),
            "speed": float(-w),
        }
        for a, w in zip(angle, spin, strict=True)
        if -1.02 <= a / np.pi <= 0.02
    ]


_K = Column("aspect_ratio", "", "equatorial over polar radius", "g", "k")
_ST = Column("stokes_number", "", "Stokes number", "g", "St")
_STEPS = Column("steps", "", "steps of the block", "d")
_TIME = Column("time", "s", "wall time of the integration, per body", ".2g")
_PASSED = Column("passed", "", "error below its bound")


def tables(rows: list[dict[str, Any]]) -> list[Table]:
    """Errors against Jeffery's orbits, against the inertial equations, and turns in detail."""
    exact = Table(
        "jeffery",
        "Massless spheroids in shear against Jeffery's orbits, three periods",
        (
            _K,
            Column("orbit_constant", "", "C at the start", "g", "C"),
            Column("period", "1/shear rate", "from whole turns of the axis", ".10g"),
            Column("period_error", "", "relative, against 2 pi (k + 1/k)", ".1e"),
            Column("axis_error", "", "largest distance from Jeffery's axis", ".1e"),
            Column("orbit_constant_error", "", "largest relative change", ".1e"),
            _STEPS,
            _TIME,
            _PASSED,
        ),
        plot={"x": "aspect_ratio", "y": "axis_error", "by": "orbit_constant", "scale": "loglog"},
    )
    heavy_bodies = Table(
        "inertial_shear",
        "Inertial spheroids in shear against Jeffery's torque integrated independently",
        (
            _K,
            _ST,
            Column("axis_error", "", "largest distance of the axes, two periods", ".1e"),
            Column("angular_velocity_error", "", "largest, relative to the largest", ".1e"),
            _STEPS,
            Column("method", "", "formula of the integrator"),
            _TIME,
            _PASSED,
        ),
        notes=[
            f"The integration's tolerance is {ACCURATE:g}, that of the body "
            f"{simulate.MODEL_TOLERANCE:g}; the errors are those of both."
        ],
        plot={"x": "stokes_number", "y": "axis_error", "by": "aspect_ratio", "scale": "loglog"},
    )
    turns = Table(
        "rotation_history",
        "Angular speed over half a turn in the plane of shear, k = 0.2",
        (
            _K,
            _ST,
            Column("angle", "pi", "from the direction of the stream", ".4f"),
            Column("speed", "shear rate", "angular speed", ".6f"),
        ),
        plot={"x": "angle", "y": "speed", "by": "stokes_number", "scale": "linear"},
    )
    return fill([exact, heavy_bodies, turns], rows)


def fill(made: list[Table], rows: list[dict[str, Any]]) -> list[Table]:
    """Rows sorted into their tables."""
    by_name = {table.name: table for table in made}
    for row in rows:
        by_name[row["table"]].add(**{name: v for name, v in row.items() if name != "table"})
    return made


def _figure(made: dict[str, Table]) -> Any:
    """Error against aspect ratio and Stokes number, and the turn from tumbling to uniform."""
    from qbxstokes.plots import style
    from qbxstokes.plots.table import draw_curves

    figure = style.new_figure(style.PAGE, 2.6)
    panels = figure.subplots(1, 3)
    draw_curves(panels[0], made["jeffery"], _listed(made["jeffery"].plot))
    draw_curves(panels[1], made["inertial_shear"], _listed(made["inertial_shear"].plot))
    history = made["rotation_history"]
    for index, stokes in enumerate(np.unique(history["stokes_number"])):
        chosen = history["stokes_number"] == stokes
        panels[2].plot(
            history["angle"][chosen],
            history["speed"][chosen],
            label=rf"$\mathrm{{St}} = {stokes:g}$",
            **style.line_style(index),
        )
    panels[2].axhline(0.5, color=style.GREY, linewidth=0.6, zorder=0)
    panels[2].set_xlabel(r"angle from the stream$\,/\,\pi$")
    panels[2].set_ylabel(r"angular speed$\,/\,$shear rate")
    panels[2].set_xlim(-1.0, 0.0)
    for panel in panels:
        style.legend_above(panel, columns=2, handle=2.0)  # leaves room for the letters
    panels[0].set_ylabel("error of the axis")
    panels[1].set_ylabel("error of the axis")
    style.letter_panels(list(panels))
    return figure


def _listed(spec: dict[str, Any]) -> dict[str, Any]:
    return {**spec, "y": [spec["y"]], "by": [spec["by"]]}


FIGURES = {"validation": _figure}
