"""Acceleration of a body released at rest in a paraboloid: time scales against inertia over R.

A (1 - exp(-t/T)) is fitted to the velocity along the stream and to the rotation about the
vorticity, over three of the slowest relaxation times; fits that miss by more than a hundredth of A
are left out: there the body turns while it accelerates, and no single time exists.

Paper:    J. Bagge 2015, KTH, chapter 9.
Run:      python cases/studies/acceleration.py      (15 s)
Expected: for a rolling body T is St inertia/R to 1e-7; 226 of the 270 fits count.
"""

import math

import common
import heavy
import numpy as np
from common import Table
from motions import LOOSE, TIGHT, axes, body, groups, labelled, paraboloid
from scipy.optimize import minimize_scalar

import qbxstokes as qs
from qbxstokes.plots import style

DISTANCE = 8.0
MISFIT = 0.01
STARTS = {"rolling": (0.0, 0.0, 1.0), "along": (1.0, 0.0, 0.0), "oblique": (0.48, -0.6, 0.64)}
# The quantity and component of each motion, and the start at which R along the axis counts.
MOTIONS = {"translation": ("velocity", 0, "along"), "rotation": ("angular_velocity", 2, "rolling")}


def fit(times, values):
    """T and the root mean square misfit over |A| of values = A (1 - exp(-t/T))."""

    def parts(logarithm):
        rise = -np.expm1(-times / math.exp(logarithm))
        amplitude = float(rise @ values) / float(rise @ rise)
        return amplitude, values - amplitude * rise

    middle = math.log(times[-1] / 3.0)
    found = minimize_scalar(
        lambda logarithm: float(np.sum(parts(logarithm)[1] ** 2)),
        bounds=(middle - 4.0, middle + 2.0), method="bounded", options={"xatol": 1e-10},
    )  # fmt: skip
    amplitude, rest = parts(float(found.x))
    return math.exp(float(found.x)), float(np.sqrt(np.mean(rest**2)) / abs(amplitude))


def run(k, stokes, table):
    """Add the times of both motions from every start."""
    scales = [stokes / rate for rate in heavy.relaxation_rates(k)]
    for pair, (name, (quantity, component, along)) in zip((scales[:2], scales[2:]), MOTIONS.items(),
                                                          strict=True):  # fmt: skip
        times = np.linspace(0.0, 3.0 * max(pair), 301)
        loose, tight = (
            getattr(qs.Simulation(
                body(k, stokes), paraboloid(DISTANCE), position=(0.0, DISTANCE, 0.0),
                orientation=axes(STARTS.values()), velocity=np.zeros(3),
                angular_velocity=np.zeros(3), tolerance=tolerance,
            ).integrate(times), quantity)[..., component]
            for tolerance in (LOOSE, TIGHT)
        )  # fmt: skip
        for start, other, values in zip(STARTS, loose, tight, strict=True):
            found, misfit = fit(times, values)
            change, half = fit(times, other)[0] - found, fit(times[:201], values[:201])[0] - found
            table.add(aspect_ratio=k, stokes_number=stokes, motion=name, start=start, time=found,
                      uncertainty=max(abs(change), 0.5 * abs(half)), misfit=misfit, across=pair[0],
                      axial=pair[1], ratio=found / pair[start == along])  # fmt: skip


def spread(rows):
    """The range of T over its scale, and the largest St, of the fits that count."""
    counted = rows["misfit"] < MISFIT
    ratios, last = rows["ratio"][counted], rows["stokes_number"][counted][-1]
    return f"{ratios.min():.2f}–{ratios.max():.2f} (St ≤ {last:g})"


def draw(table):
    """Fitted times, and over St inertia/R of the start."""
    with common.figure("acceleration", style.PAGE, 4.8) as figure:
        panels = figure.subplots(2, 2, sharex=True)
        markers = dict(zip(STARTS, "os^", strict=True))
        for (above, below), motion in zip(panels.T, MOTIONS, strict=True):
            labelled(above, "", "", "xy")
            labelled(below, r"Stokes number $\mathrm{St}$", "")
            above.set_title(motion, loc="left")
            below.axhline(1.0, color=style.GREY, linewidth=0.6, zorder=0)
            for (color, _, _), k in zip(
                style.LINES, np.unique(table["aspect_ratio"]), strict=False
            ):
                for start, marker in markers.items():
                    rows = table.where(aspect_ratio=k, motion=motion, start=start)
                    x, fitted, rolling = (
                        rows["stokes_number"],
                        rows["misfit"] < MISFIT,
                        marker == "o",
                    )
                    look = {"color": color, "markerfacecolor": color if rolling else "white",
                            "label": f"$k={k:g}$" if rolling else None}  # fmt: skip
                    above.plot(x[fitted], rows["time"][fitted], marker, **look)
                    below.plot(x[fitted], rows["ratio"][fitted], marker, **look)
                    if rolling:
                        scale = rows["axial" if motion == "rotation" else "across"]
                        above.plot(x, scale, color=color, linewidth=0.7, zorder=0)
        panels[0, 0].set_ylabel(style.label("fitted time", "tau"))
        panels[1, 0].set_ylabel(r"fitted time$\,/\,(\mathrm{St}\,$inertia$\,/R)$")
        for start, marker in markers.items():
            face = "white" if marker != "o" else style.BLACK
            panels[0, 0].plot([], [], marker, color=style.BLACK, markerfacecolor=face, label=start)
        figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside right center")
        style.letter_panels(list(panels.ravel()))


@common.command
def main(small=False):
    """Run, print, write and draw; the error for rolling bodies and how many fits count."""
    table = Table("acceleration", "times over 1/shear rate; ratio: over St inertia/R at the start")
    printed = []
    for k in (0.5,) if small else (0.2, 0.5, 1.0, 2.0, 5.0):
        for (st,) in groups([0.1, 100.0] if small else np.geomspace(0.1, 1000.0, 9), 1):
            run(k, st, table)
        printed.append([f"{k:g}", *(f"{1.0 / rate:.4g}" for rate in heavy.relaxation_rates(k)),
                        *(spread(table.where(aspect_ratio=k, motion=motion, start=start))
                          for motion in MOTIONS for start in ("along", "oblique"))])  # fmt: skip
    table.write()
    common.markdown(
        ("k", "Θ/R₁", "Θ/R₃", "J₁/R", "J₃/R", "translation, axis along the stream",
         "translation, oblique", "rotation, axis along the stream", "rotation, oblique"), printed,
    )  # fmt: skip
    draw(table)
    return {
        "largest error of T, rolling": np.abs(table.where(start="rolling")["ratio"] - 1.0).max(),
        "fits": len(table.rows),
        "fits that count": int((table["misfit"] < MISFIT).sum()),
    }
