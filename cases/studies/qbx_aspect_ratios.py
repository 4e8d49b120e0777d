"""What the aspect ratio asks of the quadrature: errors, set-up times, parameters for a tolerance.

Uniform: n_theta = 20, p = 14, kappa = 15 and r/h half of the largest one for k = 1/2 (fixed) or for
the body (adapted); and of n_theta 8, 16; kappa 8, 16; p 6, 12, 20; r/h at 0.4 and 1 times its
largest the scheme that meets a tolerance with the least work, which is source nodes times targets
times orders. None stands where the balls of the expansions would cross the surface, or a scheme is
too dear to try. Graded: what a body chooses itself for a tolerance, with and without its estimate.

Paper:    J. Bagge 2015, KTH, chapter 7.
Run:      python cases/studies/qbx_aspect_ratios.py      (100 s)
Expected: graded n_theta 6, p 8, radius factor 0.3 and panel order 7, 9, 12 for 1e-4, 1e-7, 1e-10
          from k = 1/50 to 50, with errors below half the tolerance and at most 1.2 times the
          estimate; uniform errors of 4e-4 and less for 1/2 <= k <= 2 only, where some scheme meets
          1e-4, and 1e-7 for the sphere.
"""

import time
from itertools import product

import common
import numpy as np
from common import Table, formed, power

import qbxstokes as qs
from qbxstokes.bie.accuracy import accurate_body, choose_scheme
from qbxstokes.plots import style

TOLERANCES = (1e-4, 1e-7, 1e-10)
GRADED = ("n_theta", "expansion_order", "radius_factor", "panel_order")
UNIFORM = ("n_theta", "order", "radius", "upsampling", "error", "time", "work")
FIXED = ("uniform, fixed", "uniform, radius adapted")
DEAREST = 1e8  # work of the uniform scheme beyond which it is not tried


def work(scheme):
    """Source nodes times targets times orders: what the set-up of a uniform scheme takes."""
    sources = scheme.upsampling**2 * scheme.n_theta * scheme.n_phi / 2
    return sources * scheme.n_theta * (scheme.expansion_order + 1)


def graded(k, tolerance):
    """What the body chooses, its error, and the time without and with the estimate."""
    begin = time.perf_counter()
    body = accurate_body(qs.Spheroid(k), tolerance, strict=False)
    spent = time.perf_counter() - begin
    _, error, alone = formed(k, body.scheme)
    chosen = {name: getattr(body.scheme, name) for name in GRADED}
    found = {"aspect_ratio": k, "tolerance": tolerance, **chosen, "error": error}
    found |= {"estimate": body.model.error_estimate, "time": alone}
    return found | {"time_with_estimate": spent}


def at_half(k, name):
    """Error and time of the uniform scheme at half a largest radius; nan where it is not had."""
    r_over_h = 0.5 * common.largest_ratio(0.5 if name == FIXED[0] else k, 20)
    scheme = common.uniform(k, 20, 14, r_over_h, 15)
    if r_over_h > common.largest_ratio(k, 20) or work(scheme) > DEAREST:
        return np.nan, np.nan
    return formed(k, scheme)[1:]


def trials(k, dearest):
    """Parameters, error, time and work of the uniform schemes that are not too dear."""
    found = []
    for n_theta, kappa, order, part in product((8, 16), (8, 16), (6, 12, 20), (0.4, 1.0)):
        r_over_h = part * common.largest_ratio(k, n_theta) * (1.0 - 1e-12)
        scheme = common.uniform(k, n_theta, order, r_over_h, kappa)
        if work(scheme) <= dearest:
            found.append((n_theta, order, part, kappa, *formed(k, scheme)[1:], work(scheme)))
    return found


def draw(halves, table):
    """Errors, and set-up times for a tolerance, over the aspect ratio."""
    with common.figure("qbx_aspect_ratios", style.COLUMN, 2.9) as (panel,):
        common.labelled(panel, "aspect ratio $k$", "relative error", "xy")
        common.curves(panel, halves, "aspect_ratio", "error", "scheme", "{}")
        best, look = table.where(tolerance=TOLERANCES[-1]), style.line_style(2, markers=True)
        panel.plot(best["aspect_ratio"], best["error"], label="graded", **look)
        panel.set_ylim(1e-15, 1e2)
        panel.legend(fontsize=7)
    with common.figure("qbx_recommended", style.COLUMN, 2.9) as (panel,):
        common.labelled(panel, "aspect ratio $k$", "set-up time (s)", "xy")
        for (color, _, marker), tolerance in zip(style.LINES, TOLERANCES, strict=False):
            part, look = table.where(tolerance=tolerance), {"marker": marker, "color": color}
            text = f"$10^{{{round(np.log10(tolerance))}}}$"
            panel.plot(part["aspect_ratio"], part["time"], label=f"graded, {text}", **look)
            if np.isfinite(part["uniform_time"]).any():
                look |= {"markerfacecolor": "white", "linestyle": (0, (3, 1.5))}
                times = part["uniform_time"]
                panel.plot(part["aspect_ratio"], times, label=f"uniform, {text}", **look)
        panel.set_ylim(top=30.0 * table["time"].max())
        panel.legend(fontsize=7)


@common.command
def main(small=False):
    """Run, print, write and draw; the largest errors, and what is recommended."""
    ratios, dearest = ((0.2, 1.0), 1e6) if small else (
        (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0), 2.5e7)  # fmt: skip
    for scheme in (choose_scheme(1e-2), common.uniform(1.0, 6, 4, 0.3, 2)):
        formed(1.0, scheme)  # the first one waits for compiled kernels
    table = Table("qbx_recommended", "graded: parameters, errors, times in s; uniform: or nan")
    halves = Table("qbx_aspect_ratios", "relative errors, nan where there are none; time in s")
    errors, recommended = [], []
    for k in ratios:
        tried, met, cells = trials(k, dearest), [], []
        for name in FIXED:
            error, spent = at_half(k, name)
            halves.add(aspect_ratio=k, scheme=name, error=error, time=spent)
            cells.append(f"{power(error)} / {spent:.2g}" if spent > 0.0 else "–")
        for tolerance in TOLERANCES:
            good = [trial for trial in tried if trial[4] <= tolerance]
            best = min(good, key=lambda trial: trial[6], default=(np.nan,) * len(UNIFORM))
            row = graded(k, tolerance)
            table.add(**row, **{f"uniform_{n}": v for n, v in zip(UNIFORM, best, strict=True)})
            if good:
                n_theta, order, part, kappa, error, spent, _ = best
                met.append(f"{power(tolerance, 0)}: {n_theta}, {order}, {part:g}, {kappa}; "
                           f"{power(error)} / {spent:.2g}")  # fmt: skip
        graded_cells = [
            f"{power(r['error'])} / {r['time']:.2g}" for r in table.where(aspect_ratio=k).rows
        ]
        with_estimate = f"{power(row['error'])} / {row['time_with_estimate']:.2g}"
        errors.append((f"{k:g}", *cells, graded_cells[-1], with_estimate))
        recommended.append((f"{k:g}", *graded_cells, "<br>".join(met) or "none"))
    table.write()
    halves.write()
    print("Error / set-up time (s); uniform: n_theta, p, part of the largest r/h, kappa")
    common.markdown(("k", *FIXED, "graded, 1e-10", "with estimate"), errors)
    tolerances = (f"tolerance {power(t, 0)}" for t in TOLERANCES)
    common.markdown(("k", *tolerances, "uniform"), recommended)
    draw(halves, table)
    adapted, best = halves.where(scheme=FIXED[1])["error"], table.where(tolerance=TOLERANCES[-1])
    return {
        "largest error, graded": best["error"].max(),
        "largest error over its estimate, graded": np.max(best["error"] / best["estimate"]),
        "smallest error, uniform": np.nanmin(adapted),
        "largest error, uniform": np.nanmax(adapted),
        **{f"largest {name}": table[name].max() for name in GRADED},
        **{f"smallest {name}": table[name].min() for name in GRADED},
        "largest error over tolerance": np.max(table["error"] / table["tolerance"]),
        "uniform schemes found": np.isfinite(table["uniform_error"]).sum(),
        "least work of a uniform scheme": np.nanmin(table["uniform_work"]),
    }
