"""Drifts, where: to higher shear over distance, curvature, orbit and profile; of orbits likewise.

In a paraboloid K (x2^2 + x3^2) and a plane profile K x2^2. Tumbling bodies at 1 to 32 lengths from
the axis of the paraboloid, at a fixed shear rate at the start: K = 1/(2 distance). Light bodies
with inertia of the translation alone, which keeps their orbits, against the average over Jeffery's
orbit of the first-order theory.

And drift of orbits near tumbling, at the same distances: in a quadratic flow the torque depends on
the gradient at the centre alone, so that only the path can make a difference from shear, of the
rate at the start, and of the mean rate where the body was.

Run:      python cases/studies/lateral_drift_places.py      (25 s)
Expected: K c^2 f(k, St rate) with the shear rate where the body is, within 0.08 % from four lengths
          on and 1 % at one; on orbits within 0.06 % of the theory, which heavy.py derives. Rates of
          orbits differ by parts (c/distance)^2, below 0.15 % from 8 lengths on; with the mean local
          rate, for k = 1/2, by less than the uncertainty. (New here.)
"""

import math

import common
import heavy
import numpy as np
from common import Table, labelled, power
from lateral_drift import FAR, HALF_TURNS, run
from motions import averages, body, doubling, orbit, paraboloid, shown

import qbxstokes as qs
from qbxstokes.plots import style

RUNS = ((0.5, 10.0), (0.5, 100.0), (2.0, 1.0), (2.0, 10.0))
NEAR_TUMBLING = ((0.5, 10.0, 50.0), (2.0, 1.0, 1e6))  # k, St, and an orbit constant
HEADS = ("mean local shear rate", "against the starting rate", "against the local rate")
PROFILES = [(k, profile) for k in (0.5, 2.0) for profile in ("paraboloid", "plane")]


def on_orbits(k, profile, constants, found):
    """Add the drift over K St on every orbit."""
    hessian = np.zeros((3, 3, 3))
    hessian[0, 1, 1] = 1.0 / FAR
    plane = qs.flow("polynomial", hessian=hessian.tolist())
    stokes = 0.02 * heavy.relaxation_rates(k)[1]
    light = body(k, np.full(len(constants), stokes), "translation")
    flow = plane if profile == "plane" else paraboloid(FAR)
    drift, error = averages(light, flow, orbit(k, constants), HALF_TURNS, (0.0, FAR, 0.0))[
        "velocity"
    ]
    scale = stokes * 0.5 / FAR
    for c, v, e in zip(constants, drift / scale, error / scale, strict=True):
        found.add(aspect_ratio=k, profile=profile, orbit_constant=c, drift=v[1], uncertainty=e[1],
                  theory=heavy.small_stokes_drift(k, c, profile), along_vorticity=v[2])  # fmt: skip


def orbit_drift(k, stokes, constant, distance, found):
    """Add the rates of ln C in the paraboloid and in shear of the rate where the body is."""
    moving, start = body(k, [stokes]), orbit(k, constant)
    relaxed = 10.0 * stokes / min(heavy.relaxation_rates(k))
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


def draw(places, orbits, local):
    """Drifts over that for weak curvature, that of tumbling, and that in shear."""
    with common.figure("lateral_drift_places", style.PAGE, 2.7, 1, 2) as (left, right):
        doubling(left, r"drift$\,/\,$weak curvature")
        labelled(right, "orbit $C/(1+C)$", r"drift$\,/\,$that of tumbling")
        for index, (k, st) in enumerate(RUNS):
            rows, look = (
                places.where(aspect_ratio=k, stokes_number=st),
                style.line_style(index, True),
            )
            left.plot(rows["distance"], rows["drift"] / heavy.drift(k, st), **look,
                      label=f"$k={k:g}$, $\\mathrm{{St}}={st:g}$")  # fmt: skip
            look |= {"markerfacecolor": look["color"], "linestyle": "none"}
            left.plot(rows["distance"], rows["drift"] / rows["theory"], **look)
        left.axhline(1.0, color=style.GREY, linewidth=0.6, zorder=0)
        left.legend()
        fine = np.geomspace(0.1, 1e4, 60)
        for (color, dashes, marker), (k, profile) in zip(style.LINES, PROFILES, strict=False):
            rows = orbits.where(aspect_ratio=k, profile=profile)
            limit = heavy.small_stokes_drift(k, math.inf, profile)
            exact = [heavy.small_stokes_drift(k, c, profile) / limit for c in fine]
            right.plot(fine / (1.0 + fine), exact, color=color, linestyle=dashes)
            place, label = 1.0 - 1.0 / (1.0 + rows["orbit_constant"]), f"$k={k:g}$, {profile}"
            right.plot(place, rows["drift"] / limit, marker, color=color, markerfacecolor="white",
                       label=label)  # fmt: skip
        right.legend(loc="upper left")
    with common.figure("local_orbit_drift", style.COLUMN, 2.4) as (panel,):
        doubling(panel, "relative difference from shear", "y")
        for index, (k, _, _) in enumerate(NEAR_TUMBLING):
            rows, look = local.where(aspect_ratio=k), style.line_style(index, markers=True)
            for name, text in (("from_start", "starting rate"), ("difference", "local rate")):
                panel.plot(rows["distance"], np.abs(rows[name]), label=f"$k={k:g}$, {text}", **look)
                look |= {"markerfacecolor": look["color"]}
        panel.legend()


@common.command
def main(small=False):
    """Run, print, write and draw; the largest differences from theory and from shear."""
    distances = (4.0, 16.0) if small else (1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
    constants = [1.0, math.inf] if small else [0.3, 1.0, 3.0, 10.0, math.inf]
    places = Table("lateral_drift_places_distance", "drift: K c^2; theory: at the mean shear rate")
    orbits = Table("lateral_drift_places_orbits", "drift, and that along the vorticity, over K St")
    local = Table("local_orbit_drift", "rates of ln C; differences from shear, relative")
    for distance in distances:
        for k, light in RUNS[::2]:
            run(k, [light, 10.0 * light], "both", distance, places)
        for k, stokes, constant in NEAR_TUMBLING:
            orbit_drift(k, stokes, constant, distance, local)
    for k, profile in PROFILES:
        on_orbits(k, profile, constants, orbits)
    for table in (places, orbits, local):
        table.write()
    for row in places.rows:
        ratio = row["drift"] / heavy.drift(row["aspect_ratio"], row["stokes_number"])
        row["text"] = (f"{shown(row['drift'], row['uncertainty'])}; {ratio:.4f}; "
                       f"{row['local_rate']:.4f}; {row['drift'] / row['theory']:.4f}")  # fmt: skip
    common.markdown(("distance", "K", *(f"k = {k:g}, St = {st:g}" for k, st in RUNS)), [
        (f"{d:g}", f"{0.5 / d:.4g}", *places.where(distance=d)["text"]) for d in distances
    ])  # fmt: skip
    for row in orbits.rows:
        row["text"] = f"{shown(row['drift'], row['uncertainty'])} ({power(row['theory'], 3)})"
    common.markdown(("C", *(f"k = {'1/2' if k < 1.0 else 2}, {p}" for k, p in PROFILES)), [
        ("tumbling" if math.isinf(c) else f"{c:g}", *orbits.where(orbit_constant=c)["text"])
        for c in constants])  # fmt: skip
    head, printed = ["distance"], {d: [f"{d:g}"] for d in distances}
    for k, stokes, _ in NEAR_TUMBLING:
        head += [f"k = {'1/2' if k < 1.0 else 2}, St = {stokes:g}: rate", *HEADS]
    for row in local.rows:
        start, here, doubt = (
            100.0 * row[name] for name in ("from_start", "difference", "difference_uncertainty")
        )
        printed[row["distance"]] += [
            shown(row["rate"], row["uncertainty"]), f"{row['local_rate']:.4f}",
            f"{start:+.2g} %", f"{here:+.2g} ± {float(power(doubt, 0)):g} %",
        ]  # fmt: skip
    common.markdown(head, printed.values())
    draw(places, orbits, local)
    apart, far = np.abs(places["drift"] / places["theory"] - 1.0), local["distance"] >= 8.0
    return {
        "largest difference, from four lengths on": apart[places["distance"] >= 4.0].max(),
        "largest difference at any distance": apart.max(),
        "largest difference on orbits": np.abs(orbits["drift"] / orbits["theory"] - 1.0).max(),
        "largest velocity along the vorticity": np.abs(orbits["along_vorticity"]).max(),
        "orbit drift from 8 lengths on": np.abs(local["from_start"][far]).max(),
        "from shear of the local rate": np.abs(local["difference"][far]).max(),
    }
