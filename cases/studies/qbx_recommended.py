"""Parameters for an aspect ratio and a tolerance, and what they cost.

What a body chooses itself for a tolerance (graded panels), beside the uniform scheme that meets it
with the least work, among n_theta 8, 16; kappa 8, 16; p 6, 12, 20; r/h at 0.4 and 1 times its
largest; dear ones left out.

Paper:    J. Bagge 2015, KTH, chapter 7.
Run:      python cases/studies/qbx_recommended.py      (80 s)
Expected: n_theta 6, p 8, radius factor 0.3 and panel order 7, 9, 12 for tolerances of 1e-4, 1e-7,
          1e-10, from k = 1/50 to 50, with errors below half the tolerance; a uniform scheme meets
          1e-4 for 1/2 <= k <= 2, and 1e-7 for the sphere only.
"""

import time
from itertools import product

import common
import numpy as np
from common import Table, power

import qbxstokes as qs
from qbxstokes.bie.accuracy import accurate_body, choose_scheme, plain_body
from qbxstokes.plots import style
from qbxstokes.simulation.closed_forms import true_error

TOLERANCES = (1e-4, 1e-7, 1e-10)
GRADED = ("n_theta", "expansion_order", "radius_factor", "panel_order")
UNIFORM = ("n_theta", "order", "radius", "upsampling", "error", "time", "work")


def timed(k, scheme):
    """True error of a scheme and the wall time of its set-up."""
    begin = time.perf_counter()
    model = plain_body(qs.Spheroid(k), scheme).model
    spent = time.perf_counter() - begin
    return true_error(model), spent


def graded(k, tolerance):
    """What the body chooses, its error, and the time without and with the estimate."""
    begin = time.perf_counter()
    body = accurate_body(qs.Spheroid(k), tolerance, strict=False)
    spent = time.perf_counter() - begin
    error, alone = timed(k, body.scheme)
    return {
        "aspect_ratio": k, "tolerance": tolerance,
        **{name: getattr(body.scheme, name) for name in GRADED}, "error": error,
        "estimate": body.model.error_estimate, "time": alone, "time_with_estimate": spent,
    }  # fmt: skip


def uniform_trials(k, dearest):
    """Parameters, error, time and work of the uniform schemes that are not too dear."""
    found = []
    for n_theta, kappa, order, part in product((8, 16), (8, 16), (6, 12, 20), (0.4, 1.0)):
        r_over_h = part * common.largest_ratio(k, n_theta) * (1.0 - 1e-12)
        scheme = common.uniform(k, n_theta, order, r_over_h, kappa)
        if (work := common.work(scheme)) <= dearest:
            found.append((n_theta, order, part, kappa, *timed(k, scheme), work))
    return found


def draw(table):
    """Set-up time over the aspect ratio for each tolerance, by both schemes."""
    with common.figure("qbx_recommended", style.COLUMN, 2.9) as figure:
        panel = figure.subplots()
        for (color, _, marker), tolerance in zip(style.LINES, TOLERANCES, strict=False):
            part = table.where(tolerance=tolerance)
            text = f"$10^{{{round(np.log10(tolerance))}}}$"
            k, look = part["aspect_ratio"], {"marker": marker, "color": color}
            panel.loglog(k, part["time"], label=f"graded, {text}", **look)
            if np.isfinite(part["uniform_time"]).any():
                panel.loglog(k, part["uniform_time"], linestyle=(0, (3, 1.5)), **look,
                             markerfacecolor="white", label=f"uniform, {text}")  # fmt: skip
        panel.set(xlabel="aspect ratio $k$", ylabel="set-up time (s)")
        panel.set_ylim(top=30.0 * table["time"].max())
        panel.legend(fontsize=7)


@common.command
def main(small=False):
    """Run, print, write and draw; what is recommended, and the largest error over tolerance."""
    ratios, dearest = ((1.0,), 1e6) if small else (
        (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0), 2.5e7)  # fmt: skip
    for scheme in (choose_scheme(1e-2), common.uniform(1.0, 6, 4, 0.3, 2)):
        timed(1.0, scheme)  # the first one waits for compiled kernels
    table = Table("qbx_recommended", "graded: parameters, errors, times in s; uniform: or nan")
    lines = []
    for k in ratios:
        trials, cells, met = uniform_trials(k, dearest), [], []
        for tolerance in TOLERANCES:
            good = [trial for trial in trials if trial[4] <= tolerance]
            best = min(good, key=lambda trial: trial[6], default=(np.nan,) * len(UNIFORM))
            row = graded(k, tolerance)
            table.add(**row, **{f"uniform_{n}": v for n, v in zip(UNIFORM, best, strict=True)})
            cells.append(f"{power(row['error'])} / {row['time']:.2g}")
            if good:
                n_theta, order, part, kappa, error, spent, _ = best
                met.append(f"{power(tolerance, 0)}: {n_theta}, {order}, {part:g}, {kappa}; "
                           f"{power(error)} / {spent:.2g}")  # fmt: skip
        lines.append((f"{k:g}", *cells, "<br>".join(met) or "none"))
    table.write()
    print("Error / set-up time (s); uniform: n_theta, p, part of the largest r/h, kappa")
    common.markdown(("k", *(f"tolerance {power(t, 0)}" for t in TOLERANCES), "uniform"), lines)
    draw(table)
    return {
        **{f"largest {name}": table[name].max() for name in GRADED},
        **{f"smallest {name}": table[name].min() for name in GRADED},
        "largest error over tolerance": np.max(table["error"] / table["tolerance"]),
        "uniform schemes found": np.isfinite(table["uniform_error"]).sum(),
        "least work of a uniform scheme": np.nanmin(table["uniform_work"]),
    }
