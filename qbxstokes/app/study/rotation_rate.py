"""Mean rotation rate against Stokes number: from Jeffery's tumbling to nearly uniform rotation."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from qbxstokes.app.study import simulate
from qbxstokes.app.study.linear_shear import fill
from qbxstokes.io.tables import Column, Table
from qbxstokes.reference import heavy

HALF_TURNS = 4


def blocks(full: bool) -> list[dict[str, Any]]:
    """Groups of Stokes numbers of like cost for every aspect ratio.

    The Stokes numbers are multiples of R/J, so that every body is seen through its transition.
    """
    ratios = (0.1, 0.2, 0.5, 2.0, 5.0, 10.0) if full else (0.5, 5.0)
    lags = np.geomspace(0.03, 100.0, 15) if full else np.array([0.1, 1.0, 10.0])
    found = []
    for k in ratios:
        stokes = [float(f"{lag * heavy.relaxation_rates(k)[2]:.4g}") for lag in lags]
        found += [{"k": k, "stokes_numbers": group} for group in simulate.decades(stokes, 10.0)]
    return found


def compute(k: float, stokes_numbers: list[float]) -> list[dict[str, Any]]:
    """Mean rate of bodies that tumble in the plane of shear."""
    tumble = np.tile(simulate.orbit_axes(k, np.inf), (len(stokes_numbers), 1))
    relaxed = simulate.TRANSIENT * max(stokes_numbers) / heavy.relaxation_rates(k)[2]
    found = simulate.measure(
        k, simulate.shear(), stokes_numbers, tumble, HALF_TURNS, relaxed=relaxed
    )
    return [
        {
            "table": "rotation_rate",
            "aspect_ratio": k,
            "stokes_number": stokes,
            "lag": stokes / heavy.relaxation_rates(k)[2],
            "rotation_rate": float(found.values["rotation_rate"][i]),
            "uncertainty": float(found.errors["rotation_rate"][i]),
            "theory": heavy.mean_rotation_rate(k, stokes),
        }
        for i, stokes in enumerate(stokes_numbers)
    ]


def transition(k: float) -> float:
    """Stokes number at which the rate is halfway between k/(1+k^2) and 1/2, from the theory."""
    from scipy.optimize import brentq

    middle = 0.5 * (0.5 + k / (1.0 + k * k))
    scale = heavy.relaxation_rates(k)[2]

    def excess(logarithm: float) -> float:
        return heavy.mean_rotation_rate(k, scale * math.exp(logarithm)) - middle

    return scale * math.exp(float(brentq(excess, math.log(0.5), math.log(2.0), xtol=1e-6)))


def tables(rows: list[dict[str, Any]]) -> list[Table]:
    """The rates, and the transition of every aspect ratio."""
    rates = Table(
        "rotation_rate",
        "Mean rotation rate in the plane of shear",
        (
            Column("aspect_ratio", "", "equatorial over polar radius", "g", "k"),
            Column("stokes_number", "", "Stokes number", ".4g", "St"),
            Column("lag", "", "relaxation time St J/R of the rotation", ".3g", "St J/R"),
            Column("rotation_rate", "shear rate", "mean of whole half-turns", ".8f"),
            Column("uncertainty", "shear rate", "two tolerances, two windows", ".1e"),
            Column("theory", "shear rate", "periodic solution of the planar equation", ".8f"),
        ),
        notes=["Transients and uncertainties as in cases/README.md."],
        plot={"x": "stokes_number", "y": "rotation_rate", "by": "aspect_ratio"},
    )
    fill([rates], rows)
    summary = Table(
        "transition",
        "Transition from tumbling to uniform rotation",
        (
            Column("aspect_ratio", "", "equatorial over polar radius", "g", "k"),
            Column("jeffery_rate", "shear rate", "k/(1+k^2)", ".6f"),
            Column("transition", "", "St at the rate halfway to 1/2, from the runs", ".4g"),
            Column("uncertainty", "", "of the transition", ".1e"),
            Column("theory", "", "St from the periodic solution", ".4g"),
            Column("lag", "", "St J/R at the transition", ".4f", "St J/R"),
            Column("light", "", "(rate/Jeffery's - 1)/(St J/R)^2 of the lightest", ".4f"),
            Column("light_limit", "", "s (1 - s), s = 2k/(1+k^2)", ".4f"),
            Column("heavy", "", "(1/2 - rate) (St J/R)^2/lambda^2 of the heaviest", ".4f"),
        ),
        notes=[
            "For light bodies the rate rises as s (1 - s) (St J/R)^2, for heavy ones it falls "
            "short of 1/2 by (lambda R/(2 St J))^2: the last column tends to 1/4. For very thin "
            "bodies nothing turns below St J/R = 0.7026, the threshold of the pendulum whose "
            "constant torque is just enough to turn it over."
        ],
        plot={"x": "aspect_ratio", "y": "transition", "scale": "loglog"},
    )
    for k in sorted(set(rates["aspect_ratio"].tolist())):
        chosen = rates["aspect_ratio"] == k
        order = np.argsort(rates["stokes_number"][chosen])
        stokes, rate, lag, error = (
            rates[name][chosen][order]
            for name in ("stokes_number", "rotation_rate", "lag", "uncertainty")
        )
        known = np.isfinite(rate)
        stokes, rate, lag, error = stokes[known], rate[known], lag[known], error[known]
        free = k / (1.0 + k * k)
        exact = transition(k)
        # Corrected by the theory, the measured points give the transition without interpolation
        # error: where they stand apart from the theory, so does the transition.
        theory = np.array([heavy.mean_rotation_rate(k, s) for s in stokes])
        slope = _slope(k, exact)
        apart = float(np.interp(np.log(exact), np.log(stokes), rate - theory))
        summary.add(
            aspect_ratio=k,
            jeffery_rate=free,
            transition=exact - apart / slope,
            uncertainty=float(np.interp(np.log(exact), np.log(stokes), error)) / slope,
            theory=exact,
            lag=exact / heavy.relaxation_rates(k)[2],
            light=(rate[0] / free - 1.0) / lag[0] ** 2,
            light_limit=heavy.light_rate_coefficient(k),
            heavy=(0.5 - rate[-1]) * lag[-1] ** 2 / heavy.shape(k) ** 2,
        )
    return [rates, summary]


def _slope(k: float, stokes: float) -> float:
    step = 1e-3 * stokes
    high, low = (heavy.mean_rotation_rate(k, stokes + s) for s in (step, -step))
    return (high - low) / (2.0 * step)


def figures(made: dict[str, Table]) -> dict[str, Any]:
    """Rate against St, the collapse over St J/R, and the transition against k."""
    from qbxstokes.plots import style

    rates, summary = made["rotation_rate"], made["transition"]
    figure = style.new_figure(style.PAGE, 2.5)
    panels = figure.subplots(1, 3)
    for index, k in enumerate(sorted(set(rates["aspect_ratio"].tolist()))):
        color, _, marker = style.LINES[index % 7]
        chosen = rates["aspect_ratio"] == k
        x, y = (rates[name][chosen] for name in ("stokes_number", "rotation_rate"))
        fine = np.geomspace(np.min(x), np.max(x), 80)
        exact = np.array([heavy.mean_rotation_rate(k, s) for s in fine])
        free, scale = k / (1.0 + k * k), heavy.relaxation_rates(k)[2]
        dashes = "solid" if k < 1.0 else (0, (4, 1.5))
        face = "white" if k < 1.0 else color
        panels[0].plot(fine, exact, color=color, linestyle=dashes)
        panels[0].plot(x, y, marker, color=color, markerfacecolor=face, label=f"{k:g}")
        panels[1].plot(fine / scale, (exact - free) / (0.5 - free), color=color, linestyle=dashes)
        panels[1].plot(x / scale, (y - free) / (0.5 - free), marker, color=color,
                       markerfacecolor=face)  # fmt: skip
    panels[0].set_ylim(0.0, 0.52)
    panels[0].set_xlabel(r"Stokes number $\mathrm{St}$")
    panels[0].set_ylabel(r"mean rotation rate$\,/\,$shear rate")
    panels[1].axhline(0.5, color=style.GREY, linewidth=0.6, zorder=0)
    panels[1].set_xlabel(r"$t=\mathrm{St}\,J_1/R_1$")
    panels[1].set_ylabel("part of the way to 1/2")
    for panel in panels[:2]:
        panel.set_xscale("log")
    figure.legend(*panels[0].get_legend_handles_labels(), title="$k$", loc="outside right center")
    k = summary["aspect_ratio"]
    panels[2].loglog(k, summary["transition"], "o", label="runs", color=style.BLUE)
    fine = np.concatenate([np.geomspace(0.1, 0.9, 9), [np.nan], np.geomspace(1.1, 10.0, 9)])
    exact = np.array([transition(float(v)) if np.isfinite(v) else np.nan for v in fine])
    panels[2].loglog(fine, exact, color=style.GREY, label="periodic solution", zorder=0)
    panels[2].set_xlabel("aspect ratio $k$")
    panels[2].set_ylabel(r"$\mathrm{St}$ at the transition")
    panels[2].legend(handlelength=1.2)
    style.letter_panels(list(panels))
    return {"rotation_rate": figure}
