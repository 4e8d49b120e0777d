"""Drift between Jeffery orbits in shear: prolate bodies to tumbling, oblate ones to rolling."""

from __future__ import annotations

from typing import Any

import numpy as np

from qbxstokes.app.study import simulate
from qbxstokes.app.study.linear_shear import fill
from qbxstokes.io.tables import Column, Table
from qbxstokes.reference import heavy, jeffery

HALF_TURNS = 2
# A tilt from rolling, or from the plane of shear, that counts as small.
SMALL = 2e-3
# Tilts that turn more slowly than this about rolling are not followed.
SLOWEST = 0.02
# A rate whose uncertainty is a larger part of it is left out: the tilt died too early.
LARGEST = 0.1


def blocks(full: bool) -> list[dict[str, Any]]:
    """Groups of Stokes numbers per aspect ratio, coefficients, and runs shown in time."""
    ratios = (0.1, 0.2, 0.5, 2.0, 5.0, 10.0) if full else (0.5, 2.0)
    lags = np.geomspace(0.01, 30.0, 12) if full else np.array([0.03, 1.0])
    found: list[dict[str, Any]] = []
    for k in ratios:
        stokes = [float(f"{lag * heavy.relaxation_rates(k)[2]:.4g}") for lag in lags]
        found += [{"k": k, "stokes_numbers": group} for group in simulate.decades(stokes, 2.5)]
    found += [{"k": k, "exponents": 40 if full else 5, "lags": [lags[0], lags[-1]]} for k in ratios]
    found += [{"k": k, "coefficients": 25 if full else 5} for k in ratios]
    shown = ((0.5, 10.0), (0.5, 40.0), (2.0, 1.0), (2.0, 4.0)) if full else ((0.5, 10.0),)
    return found + [{"k": k, "history": st} for k, st in shown]


def compute(
    k: float,
    stokes_numbers: list[float] | None = None,
    coefficients: int | None = None,
    exponents: int | None = None,
    lags: list[float] | None = None,
    history: float | None = None,
) -> list[dict[str, Any]]:
    """Drift rates, exact exponents, the small-St coefficient over the orbit, or C in time."""
    if stokes_numbers is not None:
        return _rates(k, stokes_numbers)
    if coefficients is not None:
        return [
            {
                "table": "drift_coefficient",
                "aspect_ratio": k,
                "orbit_constant": c,
                "coefficient": heavy.orbit_drift_coefficient(k, c),
            }
            for c in np.geomspace(0.01, 100.0, coefficients).tolist()
        ]
    if exponents is not None:
        assert lags is not None
        scale = heavy.relaxation_rates(k)[2]
        return [
            {
                "table": "drift_exponent",
                "aspect_ratio": k,
                "stokes_number": lag * scale,
                "rolling": heavy.rolling_exponent(k, lag * scale),
                "tumbling": -heavy.tumbling_exponent(k, lag * scale),
            }
            for lag in np.geomspace(lags[0], lags[1], exponents).tolist()
        ]
    assert history is not None
    return _history(k, history)


def _rates(k: float, stokes_numbers: list[float]) -> list[dict[str, Any]]:
    """Rates of ln C near both limits at every St, and on the orbit C = 1 where they are small.

    A body that leaves a limit is started so close to it that it is still near at the end, one that
    arrives there so far from it that it is near only when the transient is over.
    """
    rows = []
    for st in stokes_numbers:
        rows += _near_rolling(k, st)
    rows += _near_tumbling(k, stokes_numbers)
    relaxed = 10.0 * max(stokes_numbers) / heavy.relaxation_rates(k)[2]
    b = heavy.orbit_drift_coefficient(k, 1.0)
    # The others leave the orbit before the transient is over.
    slow = [st for st in stokes_numbers if abs(st * b) * (relaxed + 50.0) < 0.3]
    if slow:
        axis = np.tile(simulate.orbit_axes(k, 1.0), (len(slow), 1))
        found = simulate.measure(k, simulate.shear(), slow, axis, HALF_TURNS, relaxed=relaxed)
        middle = relaxed + (1.0 + 0.5 * HALF_TURNS) * heavy.tumbling(k, min(slow)).half_turn
        rows += [
            _row(k, "C = 1", st, found, i, np.nan, leaving_coefficient(k, st, middle))
            for i, st in enumerate(slow)
        ]
    return [row for row in rows if row["uncertainty"] < LARGEST * abs(row["rate"])]


def leaving_coefficient(k: float, stokes: float, middle: float) -> float:
    """b on the orbit that a body started at C = 1 has come to in the middle of its windows."""
    b = heavy.orbit_drift_coefficient(k, 1.0)
    return heavy.orbit_drift_coefficient(k, float(np.exp(stokes * b * middle)))


def _near_rolling(k: float, stokes: float) -> list[dict[str, Any]]:
    """Nothing for heavy flat bodies: their tilt decays without turning about the vorticity."""
    mode = heavy.rolling_mode(k, stokes)
    if mode.imag < SLOWEST:
        return []
    relaxed = 10.0 * stokes / heavy.relaxation_rates(k)[2]
    half_turn = np.pi / mode.imag
    start = _start(mode.real, relaxed, half_turn)
    found = simulate.measure(
        k, simulate.shear(), stokes, simulate.orbit_axes(k, start), HALF_TURNS,
        relaxed=relaxed, half_turn=half_turn,
    )  # fmt: skip
    small = heavy.rolling_drift_coefficient(k)
    return [_row(k, "rolling", stokes, found, 0, mode.real, small)]


def _near_tumbling(k: float, stokes_numbers: list[float]) -> list[dict[str, Any]]:
    relaxed = 10.0 * max(stokes_numbers) / heavy.relaxation_rates(k)[2]
    half_turn = heavy.tumbling(k, min(stokes_numbers)).half_turn
    exact = [heavy.tumbling_exponent(k, st) for st in stokes_numbers]
    starts = np.array([_start(growth, relaxed, half_turn) for growth in exact])
    axis = simulate.orbit_axes(k, 1.0 / starts)
    found = simulate.measure(
        k, simulate.shear(), stokes_numbers, axis, HALF_TURNS, relaxed=relaxed
    )  # fmt: skip
    small = heavy.orbit_drift_coefficient(k, np.inf)
    return [
        _row(k, "tumbling", st, found, i, -exact[i], small) for i, st in enumerate(stokes_numbers)
    ]


def _start(growth: float, relaxed: float, half_turn: float) -> float:
    """Tilt at the start, so that it is small, but not too small, while it is measured."""
    late = relaxed + (HALF_TURNS + 1.5 if growth > 0.0 else 1.0) * half_turn
    return float(np.clip(SMALL * np.exp(-growth * late), 1e-10, 0.3))


def _row(
    k: float,
    orbit: str,
    stokes: float,
    found: simulate.Measured,
    i: int,
    exact: float,
    small: float,
) -> dict[str, Any]:
    rate = float(found.values["orbit_drift"][i])
    return {
        "table": "orbit_drift",
        "aspect_ratio": k,
        "orbit": orbit,
        "stokes_number": stokes,
        "rate": rate,
        "uncertainty": float(found.errors["orbit_drift"][i]),
        "theory": exact,
        "rate_over_st": rate / stokes,
        "coefficient": small,
    }


def _history(k: float, stokes: float) -> list[dict[str, Any]]:
    """C at whole half-turns from C = 0.3 (prolate) or 3 (oblate) on, and its averaged theory."""
    start = 0.3 if k < 1.0 else 3.0
    rate = abs(stokes * heavy.orbit_drift_coefficient(k, start))
    times = np.linspace(0.0, 4.0 / rate, 4001)
    axis = simulate.orbit_axes(k, start)
    run = simulate.simulate(k, simulate.shear(), stokes, axis, times)
    constant = jeffery.orbit_constant(k, run.samples["axis"][:, 0])
    half = jeffery.period(k) / 2.0
    steps = max(1, round(half / (times[1] - times[0])))
    kernel = np.ones(steps) / steps
    smooth = np.convolve(np.log(constant), kernel, mode="valid")
    middle = times[: len(smooth)] + 0.5 * half
    grid = np.geomspace(1e-3, 1e3, 121)
    table = [heavy.orbit_drift_coefficient(k, c) for c in grid]

    def slope(c: float) -> float:
        return stokes * float(np.interp(np.log(c), np.log(grid), table))

    theory, at = [], np.log(start)
    clock = 0.0
    for t in middle:
        part = (t - clock) / 4
        for _ in range(4):
            half_way = at + 0.5 * part * slope(np.exp(at))
            at += part * slope(np.exp(half_way))
        clock = t
        theory.append(at)
    keep = slice(None, None, max(1, len(smooth) // 100))
    return [
        {
            "table": "orbit_history",
            "aspect_ratio": k,
            "stokes_number": stokes,
            "time": float(t),
            "orbit_constant": float(np.exp(c)),
            "theory": float(np.exp(e)),
        }
        for t, c, e in zip(middle[keep], smooth[keep], np.array(theory)[keep], strict=True)
    ]


_K = Column("aspect_ratio", "", "equatorial over polar radius", "g", "k")
_ST = Column("stokes_number", "", "Stokes number", ".4g", "St")


def tables(rows: list[dict[str, Any]]) -> list[Table]:
    """Rates near both limits, the coefficient for small St, and orbits in time."""
    rates = Table(
        "orbit_drift",
        "Rate of drift between orbits in shear, d(ln C)/dt",
        (
            _K,
            Column("orbit", "", "near rolling, from C = 1 on, or near tumbling"),
            _ST,
            Column("rate", "shear rate", "d(ln C)/dt over whole half-turns", ".4e"),
            Column("uncertainty", "shear rate", "two tolerances, two windows", ".0e"),
            Column("theory", "shear rate", "exact exponent (eigenvalue, Floquet)", ".4e"),
            Column("rate_over_st", "shear rate", "rate/St", ".4e", "rate/St"),
            Column(
                "coefficient",
                "shear rate",
                "limit of rate/St for St to 0, on the orbit of the run",
                ".4e",
            ),
        ),
        notes=[
            "Positive: towards tumbling. Transients: ten relaxation times of the rotation; other "
            "rules as in cases/README.md."
        ],
        plot={"x": "stokes_number", "y": "rate", "by": "aspect_ratio", "points": True},
    )
    exponents = Table(
        "drift_exponent",
        "Exact rates of ln C near both limits",
        (
            _K,
            _ST,
            Column("rolling", "shear rate", "near rolling (eigenvalue)", ".4e"),
            Column("tumbling", "shear rate", "near tumbling (Floquet)", ".4e"),
        ),
        plot={"x": "stokes_number", "y": "tumbling", "by": "aspect_ratio"},
    )
    coefficient = Table(
        "drift_coefficient",
        "Small-St coefficient of the drift, d(ln C)/dt = St b(C)",
        (
            _K,
            Column("orbit_constant", "", "Jeffery's C", ".4g", "C"),
            Column("coefficient", "shear rate", "b, averaged over the orbit", ".6e", "b"),
        ),
        notes=["Limits: b(0) = J3 lambda/(4 R) with lambda = (1 - k^2)/(1 + k^2)."],
        plot={"x": "orbit_constant", "y": "coefficient", "by": "aspect_ratio"},
    )
    history = Table(
        "orbit_history",
        "Orbit constant in time",
        (
            _K,
            _ST,
            Column("time", "1/shear rate", "", ".1f"),
            Column("orbit_constant", "", "geometric mean over a half-turn", ".4g", "C"),
            Column("theory", "", "d(ln C)/dt = St b(C)", ".4g"),
        ),
        plot={"x": "time", "y": "orbit_constant", "by": "stokes_number"},
    )
    return fill([rates, exponents, coefficient, history], rows)


def _figure(made: dict[str, Table]) -> Any:
    """Rates against St near rolling and tumbling, b(C), and C in time."""
    from qbxstokes.plots import style

    rates, exponents, coefficient, history = (
        made[name]
        for name in ("orbit_drift", "drift_exponent", "drift_coefficient", "orbit_history")
    )
    figure = style.new_figure(style.PAGE, 5.0)
    panels = figure.subplots(2, 2).ravel()
    ratios = sorted(set(rates["aspect_ratio"].tolist()))
    for panel, orbit in zip(panels[:2], ("rolling", "tumbling"), strict=True):
        for index, k in enumerate(ratios):
            color, _, marker = style.LINES[index]
            chosen = (rates["aspect_ratio"] == k) & (rates["orbit"] == orbit)
            order = np.argsort(rates["stokes_number"][chosen])
            x, y = (rates[name][chosen][order] for name in ("stokes_number", "rate"))
            fill_with = "white" if k < 1.0 else color
            panel.plot(x, np.abs(y), marker, color=color, markerfacecolor=fill_with, label=f"{k:g}")
            fine = exponents["aspect_ratio"] == k
            x, exact = (exponents[name][fine] for name in ("stokes_number", orbit))
            panel.plot(x, np.abs(exact), color=color, zorder=0)
            light = x < 0.3 * heavy.relaxation_rates(k)[2]
            small = abs(rates["coefficient"][chosen][0])
            panel.plot(x[light], small * x[light], color=color, linestyle=(0, (1, 1.2)), zorder=0)
        panel.set_xscale("log")
        panel.set_yscale("log")
        panel.set_xlabel(r"Stokes number $\mathrm{St}$")
        panel.set_ylabel(r"$|\mathrm{d}\ln C/\mathrm{d}t|\,/\,$shear rate")
        panel.set_title(f"near {orbit}", loc="left")
    for index, k in enumerate(ratios):
        chosen = coefficient["aspect_ratio"] == k
        panels[2].plot(
            coefficient["orbit_constant"][chosen],
            np.abs(coefficient["coefficient"][chosen]),
            color=style.LINES[index][0],
            linestyle="solid" if k < 1.0 else (0, (4, 1.5)),
        )
    panels[2].set_xscale("log")
    panels[2].set_yscale("log")
    panels[2].set_xlabel("orbit constant $C$")
    panels[2].set_ylabel(r"$|b|$, $\mathrm{d}\ln C/\mathrm{d}t=\mathrm{St}\,b$")
    pairs = sorted(
        set(zip(history["aspect_ratio"].tolist(), history["stokes_number"].tolist(), strict=True))
    )
    for index, (k, stokes) in enumerate(pairs):
        chosen = (history["aspect_ratio"] == k) & (history["stokes_number"] == stokes)
        t, c, exact = (history[n][chosen] for n in ("time", "orbit_constant", "theory"))
        b = abs(stokes * heavy.orbit_drift_coefficient(k, 1.0))
        color = style.LINES[index][0]
        panels[3].plot(t * b, exact / (1.0 + exact), color=style.GREY, linewidth=2.2, zorder=1)
        label = f"$k={k:g}$, $\\mathrm{{St}}={stokes:g}$"
        panels[3].plot(t * b, c / (1.0 + c), color=color, linestyle=style.LINES[index][1],
                       label=label)  # fmt: skip
    panels[3].set_ylim(-0.02, 1.02)
    panels[3].set_xlabel(r"$\mathrm{St}\,|b(1)|\,t$")
    panels[3].set_ylabel("orbit $C/(1+C)$")
    panels[3].legend(loc="center right")
    figure.legend(*panels[0].get_legend_handles_labels(), title="$k$", loc="outside right upper")
    style.letter_panels(list(panels))
    return figure


FIGURES = {"orbit_drift": _figure}
