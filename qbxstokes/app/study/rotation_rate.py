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
    """Groups of Stokes numbers of like cost for every aspect ratio; then the theory, in parts.

    The Stokes numbers are multiples of R/J, so that every body is seen through its transition.
    """
    ratios = (0.1, 0.2, 0.5, 2.0, 5.0, 10.0) if full else (0.5, 5.0)
    lags = np.geomspace(0.03, 100.0, 15) if full else np.array([0.1, 1.0, 10.0])
    found = []
    for k in ratios:
        stokes = [float(f"{lag * heavy.relaxation_rates(k)[2]:.4g}") for lag in lags]
        found += [{"k": k, "stokes_numbers": group} for group in simulate.decades(stokes, 10.0)]
    points = 80 if full else 10
    found += [{"k": k, "curve": [lags[0], lags[-1]], "points": points} for k in ratios]
    fine = np.geomspace(0.1, 0.9, 9 if full else 2)
    shown = {*ratios, *fine.tolist(), *(1.0 / fine).tolist()}
    return found + [{"k": k, "transition": True} for k in sorted(shown)]


def compute(
    k: float,
    stokes_numbers: list[float] | None = None,
    curve: list[float] | None = None,
    points: int = 0,
    transition: bool = False,
) -> list[dict[str, Any]]:
    """Mean rates of bodies that tumble in the plane of shear, or the theory of it."""
    if stokes_numbers is not None:
        return _rates(k, stokes_numbers)
    if curve is not None:
        return _curve(k, np.geomspace(curve[0], curve[1], points))
    assert transition
    return _transition(k)


def _rates(k: float, stokes_numbers: list[float]) -> list[dict[str, Any]]:
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


def _curve(k: float, lags: Any) -> list[dict[str, Any]]:
    """The rate of the periodic solution at relaxation times St J/R."""
    return [
        {
            "table": "rotation_rate_curve",
            "aspect_ratio": k,
            "stokes_number": lag * heavy.relaxation_rates(k)[2],
            "lag": lag,
            "rotation_rate": heavy.mean_rotation_rate(k, lag * heavy.relaxation_rates(k)[2]),
        }
        for lag in lags.tolist()
    ]


def _transition(k: float) -> list[dict[str, Any]]:
    """Where the theory's rate is halfway between k/(1+k^2) and 1/2, and its slope there."""
    from scipy.optimize import brentq

    middle = 0.5 * (0.5 + k / (1.0 + k * k))
    scale = heavy.relaxation_rates(k)[2]

    def excess(logarithm: float) -> float:
        return heavy.mean_rotation_rate(k, scale * math.exp(logarithm)) - middle

    found = scale * math.exp(float(brentq(excess, math.log(0.5), math.log(2.0), xtol=1e-6)))
    step = 1e-3 * found
    high, low = (heavy.mean_rotation_rate(k, found + s) for s in (step, -step))
    return [
        {
            "table": "transition_curve",
            "aspect_ratio": k,
            "stokes_number": found,
            "lag": found / scale,
            "slope": (high - low) / (2.0 * step),
        }
    ]


def tables(rows: list[dict[str, Any]]) -> list[Table]:
    """The rates, the transition of every aspect ratio, and the theory of both."""
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
    curve = Table(
        "rotation_rate_curve",
        "Mean rotation rate in the plane of shear by the periodic solution",
        (
            Column("aspect_ratio", "", "equatorial over polar radius", "g", "k"),
            Column("stokes_number", "", "Stokes number", ".4g", "St"),
            Column("lag", "", "relaxation time St J/R of the rotation", ".3g", "St J/R"),
            Column("rotation_rate", "shear rate", "of the periodic solution", ".8f"),
        ),
        plot={"x": "stokes_number", "y": "rotation_rate", "by": "aspect_ratio"},
    )
    halfway = Table(
        "transition_curve",
        "Transition from tumbling to uniform rotation by the periodic solution",
        (
            Column("aspect_ratio", "", "equatorial over polar radius", ".4g", "k"),
            Column("stokes_number", "", "St at the rate halfway to 1/2", ".4g", "St"),
            Column("lag", "", "St J/R there", ".4f", "St J/R"),
            Column("slope", "shear rate", "of the rate over St there", ".4e"),
        ),
        plot={"x": "aspect_ratio", "y": "stokes_number", "scale": "loglog"},
    )
    fill([rates, curve, halfway], rows)
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
    for k, exact, exact_lag, slope in zip(*(halfway[name] for name in halfway.names), strict=True):
        chosen = (rates["aspect_ratio"] == k) & np.isfinite(rates["rotation_rate"])
        if not chosen.any():
            continue
        order = np.argsort(rates["stokes_number"][chosen])
        stokes, rate, lag, error, theory = (
            rates[name][chosen][order]
            for name in ("stokes_number", "rotation_rate", "lag", "uncertainty", "theory")
        )
        free = k / (1.0 + k * k)
        # Corrected by the theory, the measured points give the transition without interpolation
        # error: where they stand apart from the theory, so does the transition.
        apart = float(np.interp(np.log(exact), np.log(stokes), rate - theory))
        summary.add(
            aspect_ratio=k,
            jeffery_rate=free,
            transition=exact - apart / slope,
            uncertainty=float(np.interp(np.log(exact), np.log(stokes), error)) / slope,
            theory=exact,
            lag=exact_lag,
            light=(rate[0] / free - 1.0) / lag[0] ** 2,
            light_limit=heavy.light_rate_coefficient(k),
            heavy=(0.5 - rate[-1]) * lag[-1] ** 2 / heavy.shape(k) ** 2,
        )
    return [rates, summary, curve, halfway]


def _figure(made: dict[str, Table]) -> Any:
    """Rate against St, the collapse over St J/R, and the transition against k."""
    from qbxstokes.plots import style

    rates, curve = made["rotation_rate"], made["rotation_rate_curve"]
    figure = style.new_figure(style.PAGE, 2.5)
    panels = figure.subplots(1, 3)
    for index, k in enumerate(sorted(set(rates["aspect_ratio"].tolist()))):
        color, _, marker = style.LINES[index % 7]
        chosen = rates["aspect_ratio"] == k
        x, y = (rates[name][chosen] for name in ("stokes_number", "rotation_rate"))
        shown = curve["aspect_ratio"] == k
        fine, exact = (curve[name][shown] for name in ("stokes_number", "rotation_rate"))
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
    summary, halfway = made["transition"], made["transition_curve"]
    panels[2].loglog(summary["aspect_ratio"], summary["transition"], "o", label="runs",
                     color=style.BLUE)  # fmt: skip
    for side, label in ((halfway["aspect_ratio"] < 1.0, "periodic solution"),
                        (halfway["aspect_ratio"] > 1.0, None)):  # fmt: skip
        panels[2].loglog(halfway["aspect_ratio"][side], halfway["stokes_number"][side],
                         color=style.GREY, label=label, zorder=0)  # fmt: skip
    panels[2].set_xlabel("aspect ratio $k$")
    panels[2].set_ylabel(r"$\mathrm{St}$ at the transition")
    panels[2].legend(handlelength=1.2)
    style.letter_panels(list(panels))
    return figure


FIGURES = {"rotation_rate": _figure}
