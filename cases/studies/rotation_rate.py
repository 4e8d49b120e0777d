"""Mean rotation rate in the plane of shear: from Jeffery's tumbling to nearly uniform rotation.

Bodies tumble in the plane of shear u = (x2, 0, 0) at Stokes numbers through their transition,
against periodic solutions of the equation of the axis (heavy.py).

Papers:   F. Lundell & A. Carlsson 2010, Phys. Rev. E 81, 016323; J. Bagge 2015, KTH, chapter 8.
Run:      python cases/studies/rotation_rate.py      (20 s)
Expected: every rate within 5e-7 of the shear rate of the periodic solution; the transition at
          St J1/R1 = 1.03 to 1.05 for every aspect ratio.
"""

import math

import common
import heavy
import numpy as np
from common import Table, labelled
from motions import SHEAR, TRANSIENT, averages, body, groups, orbit
from scipy.optimize import brentq

import qbxstokes as qs
from qbxstokes.plots import style

HALF_TURNS = 4


def run(k, stokes_numbers, rates):
    """Add the mean rates of bodies that tumble in the plane of shear."""
    scale = heavy.relaxation_rates(k)[2]
    found = averages(body(k, stokes_numbers), SHEAR, orbit(k, math.inf), HALF_TURNS,
                     relaxed=TRANSIENT * max(stokes_numbers) / scale)  # fmt: skip
    for st, rate, error in zip(stokes_numbers, *found["rotation_rate"], strict=True):
        rates.add(aspect_ratio=k, stokes_number=st, lag=st / scale, rotation_rate=rate,
                  uncertainty=error, theory=heavy.tumbling(k, st).rate)  # fmt: skip


def halfway(k):
    """St where the theory's rate is halfway between k/(1+k^2) and 1/2, and its slope there."""
    middle, scale = 0.5 * (0.5 + k / (1.0 + k * k)), heavy.relaxation_rates(k)[2]

    def excess(logarithm):
        return heavy.tumbling(k, scale * math.exp(logarithm)).rate - middle

    stokes = scale * math.exp(float(brentq(excess, math.log(0.5), math.log(2.0), xtol=1e-6)))
    high, low = (heavy.tumbling(k, stokes * (1.0 + s)).rate for s in (1e-3, -1e-3))
    return stokes, (high - low) / (2e-3 * stokes)


def transition(k, runs):
    """The transition of the runs, and the limits of light and of heavy bodies.

    Corrected by the theory, the runs give the transition without error of interpolation: where
    they stand apart from the theory, so does the transition.
    """
    exact, slope = halfway(k)
    lag, rate, free = runs["lag"], runs["rotation_rate"], k / (1.0 + k * k)
    apart, error = (
        np.interp(math.log(exact), np.log(runs["stokes_number"]), values) / slope
        for values in (rate - runs["theory"], runs["uncertainty"])
    )
    return {
        "aspect_ratio": k, "jeffery_rate": free, "transition": exact - apart,
        "uncertainty": error, "theory": exact, "lag": exact / heavy.relaxation_rates(k)[2],
        "light": (rate[0] / free - 1.0) / lag[0] ** 2,
        "light_limit": heavy.light_rate_coefficient(k),
        "heavy": (0.5 - rate[-1]) * lag[-1] ** 2 / heavy.shape(k) ** 2,
    }  # fmt: skip


def half_turn(k, stokes):
    """Angle from the stream over pi, and angular speed, from one alignment to the next."""
    half = heavy.tumbling(k, stokes).half_turn
    relaxed = TRANSIENT * stokes / heavy.relaxation_rates(k)[2]
    times = half * np.ceil(relaxed / half) + np.linspace(0.0, 2.1 * half, 800)
    scene = qs.Simulation(body(k, stokes), SHEAR, orientation=orbit(k, math.inf)[0])
    motion = scene.integrate(times)
    angle = np.unwrap(np.arctan2(motion.axis[:, 1], motion.axis[:, 0])) / math.pi
    return angle - np.floor(angle[0]), -motion.angular_velocity[:, 2]


def draw(rates, transitions, small):
    """A turn, rate against St, its collapse over St J1/R1, and the transition against k."""
    with common.figure("rotation_rate", style.PAGE, 4.8, 2, 2) as panels:
        turn, raw, collapsed, place = panels
        labelled(turn, r"angle from the stream$\,/\,\pi$", r"angular speed$\,/\,$shear rate")
        labelled(raw, r"Stokes number $\mathrm{St}$", r"mean rotation rate$\,/\,$shear rate", "x")
        labelled(collapsed, r"$t=\mathrm{St}\,J_1/R_1$", "part of the way to 1/2", "x")
        labelled(place, "aspect ratio $k$", r"$\mathrm{St}$ at the transition", "xy")
        for index, st in enumerate((0.0, 100.0) if small else (0.0, 30.0, 100.0, 300.0, 3000.0)):
            look = {"label": rf"$\mathrm{{St}}={st:g}$", **style.line_style(index)}
            turn.plot(*half_turn(0.2, st), **look)
        turn.set_xlim(-1.0, 0.0)
        style.legend_above(turn, columns=3, handle=2.0)
        for (color, _, marker), k in zip(style.LINES, transitions["aspect_ratio"], strict=False):
            free, scale = k / (1.0 + k * k), heavy.relaxation_rates(k)[2]
            runs = rates.where(aspect_ratio=k)
            x, y = runs["stokes_number"], runs["rotation_rate"]
            fine = np.geomspace(x[0], x[-1], 10 if small else 80)
            exact = np.array([heavy.tumbling(k, st).rate for st in fine])
            line = {"color": color, "linestyle": "solid" if k < 1.0 else (0, (4, 1.5))}
            dots = {"color": color, "markerfacecolor": "white" if k < 1.0 else color}
            raw.plot(fine, exact, **line)
            raw.plot(x, y, marker, label=f"{k:g}", **dots)
            collapsed.plot(fine / scale, (exact - free) / (0.5 - free), **line)
            collapsed.plot(x / scale, (y - free) / (0.5 - free), marker, **dots)
        raw.set_ylim(0.0, 0.52)
        for panel in (turn, collapsed):
            panel.axhline(0.5, color=style.GREY, linewidth=0.6, zorder=0)
        names = raw.get_legend_handles_labels()
        raw.figure.legend(*names, title="$k$", loc="outside right center")
        place.plot(*(transitions[name] for name in ("aspect_ratio", "transition")), "o",
                   color=style.BLUE, label="runs")  # fmt: skip
        prolate = np.geomspace(0.1, 0.9, 2 if small else 9)
        for ratios, label in ((prolate, "periodic solution"), (1.0 / prolate, None)):
            curve = [halfway(k)[0] for k in ratios.tolist()]
            place.plot(ratios, curve, color=style.GREY, label=label, zorder=0)
        place.legend(handlelength=1.2)


@common.command
def main(small=False):
    """Run, print, write and draw; the largest difference of a rate, and the extreme lags."""
    lags = np.array([0.1, 1.0, 10.0]) if small else np.geomspace(0.03, 100.0, 15)
    rates = Table("rotation_rate", "rates over the shear rate; lag: St J1/R1")
    transitions = Table("rotation_rate_transition", "St of the transition; lag: St J1/R1 there")
    for k in (0.5, 5.0) if small else (0.1, 0.2, 0.5, 2.0, 5.0, 10.0):
        for group in groups(lags * heavy.relaxation_rates(k)[2], 2 if small else 4):
            run(k, group, rates)
        transitions.add(**transition(k, rates.where(aspect_ratio=k)))
    rates.write()
    transitions.write()
    common.markdown(
        ("k", "Jeffery’s rate", "St of the transition", "theory", "St J₁/R₁ there",
         "light: measured", "s (1 − s)", "heavy: measured (limit 0.25)"),
        [("{:g}|{:.5f}|{:.5g} ± {:.0e}|{:.5g}|{:.4f}|{:.4f}|{:.4f}|{:.4f}"
          .format(*row.values()).split("|")) for row in transitions.rows],
    )  # fmt: skip
    draw(rates, transitions, small)
    return {
        "largest difference of a rate": np.abs(rates["rotation_rate"] - rates["theory"]).max(),
        "largest uncertainty of a rate": rates["uncertainty"].max(),
        "smallest lag of the transition": transitions["lag"].min(),
        "largest lag of the transition": transitions["lag"].max(),
    }
