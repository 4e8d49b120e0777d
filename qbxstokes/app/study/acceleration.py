"""Acceleration of a body released at rest in a paraboloid: time scales against inertia over R."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qbxstokes.app.study import simulate
from qbxstokes.app.study.linear_shear import fill
from qbxstokes.io.tables import Column, Table
from qbxstokes.reference import heavy

Array = NDArray[np.float64]

DISTANCE = 8.0
# A fit that misses by more than this part of its amplitude is none: there is no such time.
MISFIT = 0.01
ORIENTATIONS = {
    "rolling": (0.0, 0.0, 1.0),
    "along": (1.0, 0.0, 0.0),
    "oblique": (0.48, -0.6, 0.64),
}


def blocks(full: bool) -> list[dict[str, Any]]:
    """One block per aspect ratio and Stokes number, all orientations in it."""
    ratios = (0.2, 0.5, 1.0, 2.0, 5.0) if full else (0.5,)
    stokes = np.geomspace(0.1, 1000.0, 9) if full else np.array([0.1, 100.0])
    return [{"k": k, "stokes_number": float(f"{st:.4g}")} for k in ratios for st in stokes]


def compute(k: float, stokes_number: float) -> list[dict[str, Any]]:
    """Fit A (1 - exp(-t/T)) to the velocity along the stream and to the rotation about e3."""
    axis = np.array(list(ORIENTATIONS.values()))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    flow = simulate.polynomial(type="paraboloid", curvature=0.5 / DISTANCE)
    scales = [stokes_number / rate for rate in heavy.relaxation_rates(k)]
    runs = []
    for longest in (max(scales[:2]), max(scales[2:])):
        times = np.linspace(0.0, 3.0 * longest, 301)
        still = np.zeros((len(axis), 3))
        runs.append(
            [
                simulate.simulate(
                    k, flow, stokes_number, axis, times, tolerance, (0.0, DISTANCE, 0.0),
                    velocity=still, angular_velocity=still,
                )
                for tolerance in (simulate.TOLERANCE * simulate.TOLERANCE_STEP, simulate.TOLERANCE)
            ]
        )  # fmt: skip
    rows = []
    for i, name in enumerate(ORIENTATIONS):
        for kind, group, quantity, component in (
            ("translation", runs[0], "velocity", 0),
            ("rotation", runs[1], "angular_velocity", 2),
        ):
            loose, tight = (
                _fit(run.times, run.samples[quantity][:, i, component]) for run in group
            )
            halved = _fit(group[1].times[:201], group[1].samples[quantity][:201, i, component])
            across, along = scales[:2] if kind == "translation" else scales[2:]
            rows.append(
                {
                    "table": "acceleration",
                    "aspect_ratio": k,
                    "stokes_number": stokes_number,
                    "motion": kind,
                    "orientation": name,
                    "time_scale": tight[0],
                    "uncertainty": max(abs(tight[0] - loose[0]), 0.5 * abs(tight[0] - halved[0])),
                    "misfit": tight[1],
                    "exponential": tight[1] < MISFIT,
                    "transverse": across,
                    "axial": along,
                    "ratio": tight[0] / (along if (name == "along" and kind == "translation")
                                         or (name == "rolling" and kind == "rotation") else across),
                }
            )  # fmt: skip
    return rows


def _fit(times: Array, values: Array) -> tuple[float, float]:
    """T and the root mean square misfit over |A| of values = A (1 - exp(-t/T))."""
    from scipy.optimize import minimize_scalar

    def shape(logarithm: float) -> tuple[float, Array]:
        rise = -np.expm1(-times / math.exp(logarithm))
        amplitude = float(rise @ values) / float(rise @ rise)
        return amplitude, values - amplitude * rise

    middle = math.log(times[-1] / 3.0)
    found = minimize_scalar(
        lambda logarithm: float(np.sum(shape(logarithm)[1] ** 2)),
        bounds=(middle - 4.0, middle + 2.0),
        method="bounded",
        options={"xatol": 1e-10},
    )
    amplitude, rest = shape(float(found.x))
    return math.exp(float(found.x)), float(np.sqrt(np.mean(rest**2)) / abs(amplitude))


def tables(rows: list[dict[str, Any]]) -> list[Table]:
    """Fitted time scales beside St inertia over resistance."""
    made = Table(
        "acceleration",
        "Time scales of the acceleration from rest in a paraboloid",
        (
            Column("aspect_ratio", "", "equatorial over polar radius", "g", "k"),
            Column("stokes_number", "", "Stokes number", ".4g", "St"),
            Column("motion", "", "velocity along the stream, or rotation about the vorticity"),
            Column("orientation", "", "of the axis at the start"),
            Column("time_scale", "tau", "of the fitted exponential", ".4g"),
            Column("uncertainty", "tau", "two tolerances; fit over 2 and over 3 times", ".0e"),
            Column("misfit", "", "root mean square of the fit over its amplitude", ".1e"),
            Column("exponential", "", f"misfit below {MISFIT:g}"),
            Column("transverse", "tau", "St inertia/R across the axis", ".4g"),
            Column("axial", "tau", "St inertia/R along the axis", ".4g"),
            Column("ratio", "", "fitted over that of the starting orientation", ".4f"),
        ),
        plot={"x": "stokes_number", "y": "ratio", "by": ["motion", "orientation"], "points": True},
    )
    return fill([made], rows)


def _figure(made: dict[str, Table]) -> Any:
    """Fitted times over St inertia/R."""
    from qbxstokes.plots import style

    table = made["acceleration"]
    figure = style.new_figure(style.PAGE, 4.8)
    panels = figure.subplots(2, 2, sharex=True)
    ratios = sorted(set(table["aspect_ratio"].tolist()))
    looks = {"rolling": "o", "along": "s", "oblique": "^"}
    for column, motion in enumerate(("translation", "rotation")):
        for index, k in enumerate(ratios):
            color = style.LINES[index][0]
            for orientation, marker in looks.items():
                chosen = (
                    (table["aspect_ratio"] == k)
                    & (table["motion"] == motion)
                    & (table["orientation"] == orientation)
                )
                fitted = table["exponential"][chosen].astype(bool)
                look = {
                    "color": color,
                    "markerfacecolor": color if marker == "o" else "white",
                    "label": f"$k={k:g}$" if marker == "o" else None,
                }
                x = table["stokes_number"][chosen][fitted]
                panels[0, column].plot(x, table["time_scale"][chosen][fitted], marker, **look)
                panels[1, column].plot(x, table["ratio"][chosen][fitted], marker, **look)
                if orientation == "rolling":
                    kind = "axial" if motion == "rotation" else "transverse"
                    panels[0, column].plot(table["stokes_number"][chosen], table[kind][chosen],
                                           color=color, linewidth=0.7, zorder=0)  # fmt: skip
        panels[0, column].set_xscale("log")
        panels[0, column].set_yscale("log")
        panels[0, column].set_title(motion, loc="left")
        panels[1, column].axhline(1.0, color=style.GREY, linewidth=0.6, zorder=0)
        panels[1, column].set_xlabel(r"Stokes number $\mathrm{St}$")
    panels[0, 0].set_ylabel(style.label("fitted time", "tau"))
    panels[1, 0].set_ylabel(r"fitted time$\,/\,(\mathrm{St}\,$inertia$\,/R)$")
    for orientation, marker in looks.items():
        panels[0, 0].plot([], [], marker, color=style.BLACK, label=orientation,
                          markerfacecolor="white" if marker != "o" else style.BLACK)  # fmt: skip
    figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside right center")
    style.letter_panels(list(panels.ravel()))
    return figure


FIGURES = {"acceleration": _figure}
