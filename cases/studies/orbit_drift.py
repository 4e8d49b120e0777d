"""Drift between Jeffery orbits in shear: prolate bodies to tumbling, oblate ones to rolling.

Rates of ln C near both limits at any Stokes number against the exact exponents of the linearised
equations, and from the orbit C = 1 on, for light bodies, against b in d(ln C)/dt = St b(C), the
average over Jeffery's orbit (heavy.py). A body that leaves a limit starts so
close to it that it is still near at the end, one that arrives there so far from it that it is near
only when the transient, ten relaxation times of the rotation, is over.

Paper:    J. Einarsson, J. R. Angilella & B. Mehlig 2014, Physica D 278, 79.
Run:      python cases/studies/orbit_drift.py      (40 s)
Expected: 121 runs near the limits, 1e-6 from the exact exponents in the median and at most 0.5 %
          (k = 0.1, next to the spike).
"""

import math

import common
import heavy
import numpy as np
from common import Table, labelled, power
from motions import SHEAR, TIGHT, averages, body, groups, orbit, shown
from scipy.integrate import solve_ivp
from scipy.optimize import minimize_scalar

import qbxstokes as qs
from qbxstokes.plots import style
from qbxstokes.reference import jeffery

HALF_TURNS = 2
SMALL = 2e-3  # a tilt from rolling, or from the plane of shear, that counts as small
SLOWEST = 0.02  # tilts that turn more slowly than this about rolling are not followed
LARGEST = 0.1  # a rate whose uncertainty is a larger part of it is left out
EXPONENTS = {
    "rolling": lambda k, st: heavy.rolling_mode(k, st).real,
    "tumbling": heavy.tumbling_exponent,
}


def run(k, stokes_numbers, rates):
    """Add rates near rolling, near tumbling and from C = 1 on."""
    scale, b = heavy.relaxation_rates(k)[2], heavy.orbit_drift_coefficient(k, 1.0)

    def add(where, chosen, starts, limit, exact, **times):
        """The rates of bodies that start on given orbits, beside rate/St for St -> 0 and theory."""
        found = averages(body(k, chosen), SHEAR, orbit(k, starts), HALF_TURNS, **times)
        columns = np.broadcast_arrays(chosen, *found["orbit_drift"], limit, exact)
        for st, rate, error, small, theory in zip(*(c.tolist() for c in columns), strict=True):
            if error < LARGEST * abs(rate):
                rates.add(aspect_ratio=k, orbit=where, stokes_number=st, rate=rate,
                          uncertainty=error, theory=theory, rate_over_st=rate / st,
                          coefficient=small)  # fmt: skip

    def tilt(growth):
        """At the start, so that it is small, but not too small, while it is measured."""
        late = relaxed + np.where(growth > 0.0, HALF_TURNS + 1.5, 1.0) * half_turn
        return np.clip(SMALL * np.exp(-growth * late), 1e-10, 0.3)

    for st in stokes_numbers:
        mode, relaxed = heavy.rolling_mode(k, st), 10.0 * st / scale
        # The tilt of heavy flat bodies decays without turning about the vorticity.
        if mode.imag >= SLOWEST:
            half_turn, limit = math.pi / mode.imag, heavy.rolling_drift_coefficient(k)
            add("rolling", [st], tilt(mode.real), limit, mode.real, relaxed=relaxed,
                half_turn=half_turn)  # fmt: skip
    relaxed = 10.0 * max(stokes_numbers) / scale
    half_turn = heavy.tumbling(k, min(stokes_numbers)).half_turn
    growth = np.array([heavy.tumbling_exponent(k, st) for st in stokes_numbers])
    limit = heavy.orbit_drift_coefficient(k, math.inf)
    add("tumbling", stokes_numbers, 1.0 / tilt(growth), limit, -growth, relaxed=relaxed)
    # The others leave the orbit before the transient is over.
    slow = [st for st in stokes_numbers if abs(st * b) * (relaxed + 50.0) < 0.3]
    if slow:
        # On the orbit that they have come to in the middle of the time that they are watched.
        middle = relaxed + (1.0 + 0.5 * HALF_TURNS) * heavy.tumbling(k, min(slow)).half_turn
        come = [heavy.orbit_drift_coefficient(k, math.exp(st * b * middle)) for st in slow]
        add("C = 1", slow, np.ones(len(slow)), come, math.nan, relaxed=relaxed)


def history(k, stokes):
    """Times, C from 0.3 (prolate) or 3 (oblate) on, mean over a half-turn, and its theory."""
    first = 0.3 if k < 1.0 else 3.0
    times = np.linspace(0.0, 4.0 / abs(stokes * heavy.orbit_drift_coefficient(k, first)), 4001)
    scene = qs.Simulation(body(k, stokes), SHEAR, orientation=orbit(k, first)[0], tolerance=TIGHT)
    constant = jeffery.orbit_constant(k, scene.integrate(times).axis)
    half = jeffery.period(k) / 2.0
    steps = max(1, round(half / times[1]))
    smooth = np.convolve(np.log(constant), np.ones(steps) / steps, mode="valid")
    middle = times[: len(smooth)] + 0.5 * half
    logs = np.linspace(-7.0, 7.0, 121)
    b = [stokes * heavy.orbit_drift_coefficient(k, c) for c in np.exp(logs).tolist()]
    exact = solve_ivp(lambda _, y: np.interp(y, logs, b), (0.0, middle[-1]), [math.log(first)],
                      t_eval=middle, rtol=1e-8)  # fmt: skip
    return middle, np.exp(smooth), np.exp(exact.y[0])


def exponents(k, where, lags):
    """Stokes numbers and exact rates over the range of the lags St J1/R1."""
    stokes = np.geomspace(lags[0], lags[-1], 40) * heavy.relaxation_rates(k)[2]
    return stokes, np.array([abs(EXPONENTS[where](k, st)) for st in stokes.tolist()])


def largest(k, where, lags):
    """The largest exact rate, or where it has a spike: finer points find more and more there."""
    stokes, rates = exponents(k, where, lags)
    at, scale = stokes[rates.argmax()], heavy.relaxation_rates(k)[2]
    near = minimize_scalar(lambda st: -abs(EXPONENTS[where](k, st)), bounds=(0.8 * at, 1.2 * at))
    if -near.fun > 1.5 * rates.max():
        return f"spike (St ≈ {near.x:.3g}, t = {near.x / scale:.2g})"
    return f"{rates.max():.2g} (St = {float(f'{at:.2g}'):g}, t = {at / scale:.2g})"


def draw(rates, lags, histories):
    """Rates against St near rolling and tumbling, b(C), and C in time."""
    with common.figure("orbit_drift", style.PAGE, 5.0, 2, 2, "$k$") as panels:
        for panel, where in zip(panels, EXPONENTS, strict=False):
            labelled(panel, r"Stokes number $\mathrm{St}$",
                     r"$|\mathrm{d}\ln C/\mathrm{d}t|\,/\,$shear rate", "xy")  # fmt: skip
            panel.set_title(f"near {where}", loc="left")
        labelled(panels[2], "orbit constant $C$",
                 r"$|b|$, $\mathrm{d}\ln C/\mathrm{d}t=\mathrm{St}\,b$", "xy")  # fmt: skip
        labelled(panels[3], r"$\mathrm{St}\,|b(1)|\,t$", "orbit $C/(1+C)$")
        constants = np.geomspace(0.01, 100.0, 25)
        ratios = np.unique(rates["aspect_ratio"]).tolist()
        for (color, _, marker), k in zip(style.LINES, ratios, strict=False):
            face, dashes = ("white", "solid") if k < 1.0 else (color, (0, (4, 1.5)))
            for panel, where in zip(panels, EXPONENTS, strict=False):
                runs = rates.where(aspect_ratio=k, orbit=where)
                panel.plot(runs["stokes_number"], np.abs(runs["rate"]), marker, color=color,
                           markerfacecolor=face, label=f"{k:g}")  # fmt: skip
                x, exact = exponents(k, where, lags)
                panel.plot(x, exact, color=color, zorder=0)
                light = x[x < 0.3 * heavy.relaxation_rates(k)[2]]
                panel.plot(light, abs(runs["coefficient"][0]) * light, color=color,
                           linestyle=(0, (1, 1.2)), zorder=0)  # fmt: skip
            b = [abs(heavy.orbit_drift_coefficient(k, c)) for c in constants.tolist()]
            panels[2].plot(constants, b, color=color, linestyle=dashes)
        for index, (k, st) in enumerate(histories):
            times, c, exact = history(k, st)
            t = times * abs(st * heavy.orbit_drift_coefficient(k, 1.0))
            panels[3].plot(t, exact / (1.0 + exact), color=style.GREY, linewidth=2.2, zorder=1)
            look = {"label": f"$k={k:g}$, $\\mathrm{{St}}={st:g}$", **style.line_style(index)}
            panels[3].plot(t, c / (1.0 + c), **look)
        panels[3].set_ylim(-0.02, 1.02)
        panels[3].legend(loc="center right")


@common.command
def main(small=False):
    """Run, print, write and draw; how far the runs are from the exact exponents."""
    ratios = (0.5, 2.0) if small else (0.1, 0.2, 0.5, 2.0, 5.0, 10.0)
    lags = np.array([0.03, 1.0]) if small else np.geomspace(0.01, 30.0, 12)
    rates = Table(
        "orbit_drift", "rates of ln C over the shear rate; coefficient: rate/St for St->0"
    )
    head, printed = ["k", "St"], []
    for k in ratios:
        for group in groups(lags * heavy.relaxation_rates(k)[2], 1 if small else 2):
            run(k, group, rates)
        cells = [f"{k:g}", f"{rates.where(aspect_ratio=k)['stokes_number'][0]:.3g}"]
        for where in ("rolling", "C = 1", "tumbling"):
            row = rates.where(aspect_ratio=k, orbit=where).rows[0]  # the lightest
            error = row["uncertainty"] / row["stokes_number"]
            cells += [power(row["coefficient"], 4), shown(row["rate_over_st"], error)]
        printed.append([*cells, *(largest(k, where, lags) for where in EXPONENTS)])
    rates.write()
    for text in ("near rolling", "after C = 1", "near tumbling"):
        head += [f"b {text}", "measured"]
    common.markdown([*head, *(f"largest, near {where}" for where in EXPONENTS)], printed)
    histories = [(0.5, 10.0), (0.5, 40.0), (2.0, 1.0), (2.0, 4.0)]
    draw(rates, lags, histories[:1] if small else histories)
    apart = np.abs(rates["rate"] / rates["theory"] - 1.0)
    apart = apart[np.isfinite(apart)]
    return {
        "runs near the limits": len(apart),
        "median difference from the exact exponents": float(np.median(apart)),
        "largest difference": apart.max(),
    }
