"""What changes with the aspect ratio: errors of both schemes at fixed and at adapted parameters.

Uniform: n_theta = 20, p = 14, kappa = 15 and r/h half of the largest one for k = 1/2 (fixed) or for
the body (adapted). Graded: the parameters for a tolerance of 1e-10 (fixed), and those that a body
chooses itself (automatic), with an estimate of the error. No number stands where the balls of the
expansions would cross the surface, or the upsampled grid is too large to try.

Paper:    J. Bagge 2015, KTH, chapter 7.
Run:      python cases/studies/qbx_aspect_ratios.py      (25 s)
Expected: graded errors below 5e-11 from k = 1/50 to 50, at most 1.2 times the estimate; uniform
          ones of 4e-4 and less for 1/2 <= k <= 2 only.
"""

import time

import common
import numpy as np
from common import Table, power

import qbxstokes as qs
from qbxstokes.bie.accuracy import accurate_body, choose_scheme, plain_body
from qbxstokes.plots import style
from qbxstokes.simulation.closed_forms import true_error

SCHEMES = ("uniform, fixed", "uniform, radius adapted", "graded, fixed", "graded, automatic")
TOLERANCE = 1e-10
DEAREST = 1e8  # work of the uniform scheme beyond which it is not tried


def scheme_of(k, name):
    """The scheme of a name; None where it cannot be had or is too dear."""
    if name.startswith("graded"):
        return choose_scheme(TOLERANCE)
    r_over_h = 0.5 * common.largest_ratio(0.5 if name == "uniform, fixed" else k, 20)
    scheme = common.uniform(k, 20, 14, r_over_h, 15)
    allowed = r_over_h <= common.largest_ratio(k, 20) and common.work(scheme) <= DEAREST
    return scheme if allowed else None


def measure(k, name, table):
    """Add true error, estimated error where one is made, and time."""
    row = dict.fromkeys(("error", "estimate", "time"), np.nan)
    begin, model = time.perf_counter(), None
    if name == "graded, automatic":
        model = accurate_body(qs.Spheroid(k), TOLERANCE, strict=False).model
        row["estimate"] = model.error_estimate
    elif scheme := scheme_of(k, name):
        model = plain_body(qs.Spheroid(k), scheme).model
    if model is not None:
        row |= {"time": time.perf_counter() - begin, "error": true_error(model)}
    table.add(aspect_ratio=k, scheme=name, **row)


def draw(table):
    """Error over the aspect ratio, a curve per scheme."""
    with common.figure("qbx_aspect_ratios", style.COLUMN, 2.9) as figure:
        panel = figure.subplots()
        for index, name in enumerate(SCHEMES):
            part = table.where(scheme=name)
            panel.loglog(part["aspect_ratio"], part["error"], label=name,
                         **style.line_style(index, markers=True))  # fmt: skip
        panel.set(ylim=(1e-15, 1e2), xlabel="aspect ratio $k$", ylabel="relative error")
        panel.legend(fontsize=7)


@common.command
def main(small=False):
    """Run, print, write and draw; the largest errors, and those beside the estimate."""
    ratios = (0.2, 50.0) if small else (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
    plain_body(qs.Spheroid(1.0), choose_scheme(1e-2))  # the first one waits for compiled kernels
    table = Table("qbx_aspect_ratios", "relative errors, nan where there are none; time in s")
    for k in ratios:
        for name in SCHEMES:
            measure(k, name, table)
    table.write()
    print("Error / time (s)")
    common.markdown(
        ("k", *SCHEMES[:-1], "graded, automatic, with estimate"),
        [(f"{k:g}", *(f"{power(row['error'])} / {row['time']:.2g}" if row["time"] > 0.0 else "–"
                      for row in table.where(aspect_ratio=k).rows)) for k in ratios],
    )  # fmt: skip
    draw(table)
    automatic, adapted = (table.where(scheme=SCHEMES[index]) for index in (3, 1))
    return {
        "largest error, graded": automatic["error"].max(),
        "largest error over its estimate, graded": np.max(
            automatic["error"] / automatic["estimate"]
        ),
        "smallest error, uniform": np.nanmin(adapted["error"]),
        "largest error, uniform": np.nanmax(adapted["error"]),
    }
