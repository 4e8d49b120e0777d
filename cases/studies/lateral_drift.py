"""Drift of tumbling bodies to higher shear in a paraboloid: against St and shape, and its cause.

Mean velocity across the stream over the curvature K of the profile, 16 lengths from its axis, with
inertia of both motions, of the translation or of the rotation alone, against the periodic solution
for weak curvature and its limits (heavy.py).

Paper:    J. Bagge 2015, KTH, chapter 9, for a single run; the rest is new here.
Run:      python cases/studies/lateral_drift.py      (90 s)
Expected: every run within 0.15 % of the periodic solution at its mean local shear rate; below
          1e-12 K for a sphere and with inertia of the rotation alone.
"""

import math

import common
import heavy
import numpy as np
from common import Table, labelled, power
from motions import averages, body, cross, groups, orbit, paraboloid, shown
from scipy.optimize import minimize_scalar

from qbxstokes.plots import style

HALF_TURNS = 4
FAR = 16.0  # distance from the axis at which the curvature is weak
COMPARED = (0.1, 0.5, 5.0)  # drawn with and without inertia of the rotation


def run(k, stokes_numbers, inertia, distance, found):
    """Add the drift over K of bodies that tumble in the plane of shear."""
    means = averages(body(k, stokes_numbers, inertia), paraboloid(distance), orbit(k, math.inf),
                     HALF_TURNS, (0.0, distance, 0.0))  # fmt: skip
    for i, st in enumerate(stokes_numbers):
        drift, error = (2.0 * distance * values[i, 1] for values in means["velocity"])
        rate = means["position"][0][i, 1] / distance
        found.add(aspect_ratio=k, inertia=inertia, distance=distance, stokes_number=st, drift=drift,
                  uncertainty=error, local_rate=rate, theory=heavy.drift(k, st * rate, inertia),
        )  # fmt: skip


def maximum(k, runs):
    """Where the periodic solution is largest, the largest run, and both ends."""
    scale = math.log(heavy.relaxation_rates(k)[0])
    top = minimize_scalar(
        lambda x: -heavy.drift(k, math.exp(x)), bounds=(scale - 5.0, scale + 4.0),
        method="bounded", options={"xatol": 1e-4},
    )  # fmt: skip
    stokes, largest = math.exp(top.x), -float(top.fun)
    best = runs.rows[int(np.argmax(runs["drift"]))]
    exponents = np.diff(np.log(runs["drift"])) / np.diff(np.log(runs["stokes_number"]))
    return {
        "aspect_ratio": k, "stokes_number": stokes,
        "lag": stokes / (0.5 * sum(heavy.relaxation_rates(k)[:2])), "drift": largest,
        "measured_at": best["stokes_number"], "measured": best["drift"],
        "uncertainty": best["uncertainty"], "light": heavy.small_stokes_drift(k),
        "heavy": heavy.large_stokes_drift(k), "light_exponent": exponents[0],
        "heavy_exponent": exponents[-1],
        "rotation_share": largest / heavy.drift(k, stokes, "translation") - 1.0,
    }  # fmt: skip


def draw(drift, small):
    """Drift against St; the same over its limits of small and large St, joined, by parts."""
    with common.figure("lateral_drift", style.PAGE, 2.7, 1, 2, "$k$") as (left, right):
        labelled(left, r"Stokes number $\mathrm{St}$", r"drift$\,/\,K c^2$", "xy")
        labelled(right, r"$\mathrm{St}\,\Theta/R_1$",
                 r"drift$\,/\,$limits of small and large $\mathrm{St}$, joined", "x")  # fmt: skip
        ratios = [k for k in np.unique(drift["aspect_ratio"]).tolist() if k != 1.0]
        ends = drift["stokes_number"].min(), drift["stokes_number"].max()
        fine = np.geomspace(*ends, 10 if small else 80)
        for (color, _, marker), k in zip(style.LINES, ratios, strict=False):
            light, last = heavy.small_stokes_drift(k), heavy.large_stokes_drift(k)
            scale = heavy.relaxation_rates(k)[0]
            for inertia, dashes in (("both", "solid"), ("translation", (0, (4, 1.5)))):
                runs, whole = drift.where(aspect_ratio=k, inertia=inertia), inertia == "both"
                exact = np.array([heavy.drift(k, st, inertia) for st in fine.tolist()])
                if whole:
                    left.plot(fine, exact, color=color)
                    face = "white" if k < 1.0 else color
                    left.plot(runs["stokes_number"], runs["drift"], marker, color=color,
                              markerfacecolor=face, label=f"{k:g}")  # fmt: skip
                if k in COMPARED:
                    # At the shear rate where the body was: St counts with that rate.
                    x = runs["stokes_number"] * runs["local_rate"]
                    right.plot(fine / scale, exact * (1.0 / (light * fine) + fine / last),
                               color=color, linestyle=dashes)  # fmt: skip
                    y = runs["drift"] * (1.0 / (light * x) + x / last)
                    face = color if whole else "white"
                    right.plot(x / scale, y, marker, color=color, markerfacecolor=face)
        for text, dashes in (("both", "solid"), ("translation alone", (0, (4, 1.5)))):
            right.plot([], [], color=style.BLACK, linestyle=dashes, label=text)
        right.axhline(1.0, color=style.GREY, linewidth=0.6, zorder=0)
        right.legend(loc="lower left", title="inertia")


@common.command
def main(small=False):
    """Run, print, write and draw; how far the runs are from theory and from zero."""
    stokes_numbers = np.array([1.0, 30.0]) if small else np.geomspace(0.1, 1000.0, 9)
    drift = Table("lateral_drift", "drift: K c^2; theory: at the mean local shear rate")
    maxima = Table("lateral_drift_maximum", "drift: K c^2; light: over St, heavy: times St")
    turning = Table("lateral_drift_rotation", drift.about)
    for k in (0.5, 1.0, 2.0) if small else (0.1, 0.2, 0.5, 0.8, 1.0, 1.25, 2.0, 5.0):
        for inertia in ("both", "translation"):
            for group in groups(stokes_numbers, 1 if small else 2):
                run(k, group, inertia, FAR, drift)
        run(k, [10.0] if small else [1.0, 10.0], "rotation", FAR, turning)
        if k != 1.0:
            maxima.add(**maximum(k, drift.where(aspect_ratio=k, inertia="both")))
    for table in (drift, maxima, turning):
        table.write()
    cross(drift.where(inertia="both"), lambda row: "0" if row["aspect_ratio"] == 1.0
          else shown(row["drift"], row["uncertainty"]))  # fmt: skip
    common.markdown(
        ("k", "St of the maximum", "St Θ/R there", "maximum", "largest run", "limit of drift/St",
         "limit of drift · St", "exponent, light", "exponent, heavy", "rotational inertia adds"),
        [(f"{row['aspect_ratio']:g}", f"{row['stokes_number']:.4g}", f"{row['lag']:.2f}",
          power(row["drift"], 3), f"{power(row['measured'], 3)} ± {power(row['uncertainty'], 0)} "
          f"(St = {row['measured_at']:.4g})", power(row["light"], 3), power(row["heavy"], 3),
          f"{row['light_exponent']:+.3f}", f"{row['heavy_exponent']:+.3f}",
          f"{100.0 * row['rotation_share']:+.1f} %") for row in maxima.rows],
    )  # fmt: skip
    draw(drift, small)
    apart = [row["drift"] / row["theory"] - 1.0 for row in drift.rows if row["theory"]]
    spheres = drift.where(aspect_ratio=1.0)["drift"]
    return {
        "largest difference from the periodic solution": np.abs(apart).max(),
        "largest drift of a sphere": np.abs(spheres).max(),
        "largest drift with inertia of the rotation alone": np.abs(turning["drift"]).max(),
        "maximum of k = 0.5": maxima.where(aspect_ratio=0.5)["drift"][0],
    }
