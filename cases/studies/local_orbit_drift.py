"""Drift of orbits in a paraboloid against linear shear, near tumbling, at 1 to 32 lengths off axis.

In a quadratic flow the torque depends on the gradient at the centre alone: only the path can make
a difference. Against shear of the rate at the start, and of the mean rate where the body was.

Run:      python cases/studies/local_orbit_drift.py      (10 s)
Expected: differences of parts (c/distance)^2, below 0.15 % from 8 lengths on; with the mean local
          rate, for k = 1/2, within the uncertainty. (New here.)
"""

import common
import heavy
import numpy as np
from common import Table, power
from motions import averages, body, doubling, orbit, paraboloid, shown

import qbxstokes as qs
from qbxstokes.plots import style

HALF_TURNS = 4
RUNS = ((0.5, 10.0, 50.0), (2.0, 1.0, 1e6))  # k, St, and an orbit constant near tumbling
HEADS = ("mean local shear rate", "against the starting rate", "against the local rate")


def run(k, stokes, constant, distance, found):
    """Add the rates of ln C in the paraboloid and in shear of the rate where the body is."""
    moving, start = body(k, [stokes]), orbit(k, constant)
    relaxed = 10.0 * heavy.slowest_relaxation(k, stokes)
    place = (0.0, distance, 0.0)
    curved = averages(moving, paraboloid(distance), start, HALF_TURNS, place, relaxed)
    local = float(curved["position"][0][0, 1]) / distance
    shear = qs.flow("shear", rate=local)
    straight = averages(moving, shear, start, HALF_TURNS, relaxed=relaxed)
    rate, error = (float(values[0]) for values in curved["orbit_drift"])
    other, other_error = (float(values[0]) for values in straight["orbit_drift"])
    found.add(aspect_ratio=k, stokes_number=stokes, distance=distance, local_rate=local, rate=rate,
              uncertainty=error, in_shear=other, difference=rate / other - 1.0,
              difference_uncertainty=(error + other_error) / abs(other),
              from_start=rate / -heavy.tumbling_exponent(k, stokes) - 1.0)  # fmt: skip


@common.command
def main(small=False):
    """Run, print, write and draw; the largest differences from 8 lengths on."""
    distances = (4.0, 16.0) if small else (1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
    table = Table("local_orbit_drift", "rates of ln C; differences from shear, relative")
    head, printed = ["distance"], [[f"{d:g}"] for d in distances]
    for k, stokes, constant in RUNS:
        head += [f"k = {'1/2' if k < 1.0 else 2}, St = {stokes:g}: rate", *HEADS]
        for cells, distance in zip(printed, distances, strict=True):
            run(k, stokes, constant, distance, table)
            row = table.rows[-1]
            doubt = float(power(100.0 * row["difference_uncertainty"], 0))
            cells += [shown(row["rate"], row["uncertainty"]), f"{row['local_rate']:.4f}",
                      f"{100.0 * row['from_start']:+.2g} %",
                      f"{100.0 * row['difference']:+.2g} ± {doubt:g} %"]  # fmt: skip
    table.write()
    common.markdown(head, printed)
    with common.figure("local_orbit_drift", style.COLUMN, 2.4) as figure:
        panel = figure.add_subplot()
        doubling(panel, "relative difference from shear", "y")
        for index, (k, _, _) in enumerate(RUNS):
            rows, look = table.where(aspect_ratio=k), style.line_style(index, markers=True)
            for name, text in (("from_start", "starting rate"), ("difference", "local rate")):
                panel.plot(rows["distance"], np.abs(rows[name]), label=f"$k={k:g}$, {text}", **look)
                look |= {"markerfacecolor": look["color"]}
        panel.legend()
    far = table["distance"] >= 8.0
    return {
        "largest difference from 8 lengths on": np.abs(table["from_start"][far]).max(),
        "from shear of the local rate": np.abs(table["difference"][far]).max(),
    }
