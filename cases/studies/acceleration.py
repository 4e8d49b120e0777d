"""Acceleration of a body released at rest in a paraboloid: time scales against inertia over R.

A (1 - exp(-t/T)) is fitted to the velocity along the stream and to the rotation about the
vorticity, over three of the slowest relaxation times; fits that miss by more than a hundredth of A
are left out: there the body turns while it accelerates, and no single time exists.

Paper:    J. Bagge 2015, KTH, chapter 9.
Run:      python cases/studies/acceleration.py      (15 s)
Expected: for a rolling body T is St inertia/R to 1e-7; 226 of the 270 fits count.
"""

import common
import heavy
import numpy as np
from common import Table, labelled
from motions import LOOSE, TIGHT, axes, body, groups, paraboloid
from scipy.optimize import curve_fit

import qbxstokes as qs
from qbxstokes.plots import style

DISTANCE = 8.0
MISFIT = 0.01
STARTS = {"rolling": (0.0, 0.0, 1.0), "along": (1.0, 0.0, 0.0), "oblique": (0.48, -0.6, 0.64)}
# The quantity and component of each motion, and the start at which R along the axis counts.
MOTIONS = {"translation": ("velocity", 0, "along"), "rotation": ("angular_velocity", 2, "rolling")}


def fit(times, values):
    """T and the root mean square misfit over |A| of values = A (1 - exp(-t/T))."""

    def rise(t, amplitude, logarithm):
        return -amplitude * np.expm1(-t / np.exp(logarithm))

    middle = np.log(times[-1] / 3.0)
    bounds = [-np.inf, middle - 4.0], [np.inf, middle + 2.0]
    tight = {"bounds": bounds, "ftol": 1e-15, "xtol": 1e-12, "gtol": 1e-15}
    (amplitude, logarithm), _ = curve_fit(rise, times, values, (values[-1], middle), **tight)
    rest = values - rise(times, amplitude, logarithm)
    return np.exp(logarithm), np.sqrt(np.mean(rest**2)) / abs(amplitude)


def run(k, stokes, table):
    """Add the times of both motions from every start."""
    scales = [stokes / rate for rate in heavy.relaxation_rates(k)]
    scene = {
        "position": (0.0, DISTANCE, 0.0), "orientation": axes(STARTS.values()),
        "velocity": np.zeros(3), "angular_velocity": np.zeros(3),
    }  # fmt: skip
    for (name, (quantity, component, along)), (across, axial) in zip(
        MOTIONS.items(), (scales[:2], scales[2:]), strict=True
    ):
        times, loose_and_tight = np.linspace(0.0, 3.0 * max(across, axial), 301), []
        for error in (LOOSE, TIGHT):
            moved = qs.Simulation(body(k, stokes), paraboloid(DISTANCE), **scene, tolerance=error)
            loose_and_tight.append(getattr(moved.integrate(times), quantity)[..., component])
        for start, other, values in zip(STARTS, *loose_and_tight, strict=True):
            found, misfit = fit(times, values)
            change, half = fit(times, other)[0] - found, fit(times[:201], values[:201])[0] - found
            table.add(aspect_ratio=k, stokes_number=stokes, motion=name, start=start, time=found,
                      uncertainty=max(abs(change), 0.5 * abs(half)), misfit=misfit, across=across,
                      axial=axial, ratio=found / (axial if start == along else across),
            )  # fmt: skip


def spread(rows):
    """The range of T over its scale, and the largest St, of the fits that count."""
    counted = rows["misfit"] < MISFIT
    ratios, last = rows["ratio"][counted], rows["stokes_number"][counted][-1]
    return f"{ratios.min():.2f}–{ratios.max():.2f} (St ≤ {last:g})"


def draw(table):
    """Fitted times, and over St inertia/R of the start."""
    markers = dict(zip(STARTS, "os^", strict=True))
    with common.figure("acceleration", style.PAGE, 4.8, 2, 2, "", sharex=True) as panels:
        for above, below, motion in zip(panels[:2], panels[2:], MOTIONS, strict=True):
            labelled(above, "", "", "xy")
            labelled(below, r"Stokes number $\mathrm{St}$", "")
            above.set_title(motion, loc="left")
            below.axhline(1.0, color=style.GREY, linewidth=0.6, zorder=0)
            ratios = np.unique(table["aspect_ratio"])
            for (color, _, _), k in zip(style.LINES, ratios, strict=False):
                for start, marker in markers.items():
                    rows, rolling = (
                        table.where(aspect_ratio=k, motion=motion, start=start),
                        marker == "o",
                    )
                    x, fitted = rows["stokes_number"], rows["misfit"] < MISFIT
                    look = {"color": color, "markerfacecolor": color if rolling else "white",
                            "label": f"$k={k:g}$" if rolling else None}  # fmt: skip
                    above.plot(x[fitted], rows["time"][fitted], marker, **look)
                    below.plot(x[fitted], rows["ratio"][fitted], marker, **look)
                    if rolling:
                        scale = rows["axial" if motion == "rotation" else "across"]
                        above.plot(x, scale, color=color, linewidth=0.7, zorder=0)
        panels[0].set_ylabel(style.label("fitted time", "tau"))
        panels[2].set_ylabel(r"fitted time$\,/\,(\mathrm{St}\,$inertia$\,/R)$")
        for start, marker in markers.items():
            face = "white" if marker != "o" else style.BLACK
            panels[0].plot([], [], marker, color=style.BLACK, markerfacecolor=face, label=start)


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
