"""Drift to higher shear, where: against distance and curvature, on Jeffery orbits, in two profiles.

In a paraboloid K (x2^2 + x3^2) and a plane profile K x2^2. Tumbling bodies at 1 to 32 lengths from
the axis of the paraboloid, at a fixed shear rate at the start: K = 1/(2 distance). Light bodies
with inertia of the translation alone, which keeps their orbits, against the average over Jeffery's
orbit of the first-order theory.

Run:      python cases/studies/lateral_drift_places.py      (20 s)
Expected: K c^2 f(k, St rate) with the shear rate where the body is, within 0.08 % from four lengths
          on and 1 % at one; on orbits within 0.06 % of the theory. (New here; the theory is
          derived in qbxstokes/reference/heavy.py.)
"""

import math

import common
import heavy
import numpy as np
from common import Table, power
from lateral_drift import FAR, HALF_TURNS, run
from motions import averages, body, doubling, labelled, orbit, paraboloid, shown

import qbxstokes as qs
from qbxstokes.plots import style
from qbxstokes.reference import inertial, lamb

RUNS = ((0.5, 10.0), (0.5, 100.0), (2.0, 1.0), (2.0, 10.0))
PROFILES = [(k, profile) for k in (0.5, 2.0) for profile in ("paraboloid", "plane")]


def orbit_theory(k, constant, profile):
    """Drift over K St on a Jeffery orbit for St -> 0: U varies as 1 - d1^2, or as d2^2."""
    if profile == "paraboloid":
        return heavy.small_stokes_drift_on_orbit(k, constant)
    d, g = heavy.jeffery_orbit(k, constant)
    across, along = lamb.translation_resistance(k)
    lag = float(np.mean(d[:, 0] * d[:, 1] * 2.0 * d[:, 1] * g[:, 1]))
    return -inertial.volume(k) * (1.0 / along - 1.0 / across) * (1.0 - k * k) / 3.0 * lag


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
                  theory=orbit_theory(k, c, profile), along_vorticity=v[2])  # fmt: skip


def draw(places, orbits):
    """Drift over its value for weak curvature against distance; on orbits over that of tumbling."""
    with common.figure("lateral_drift_places", style.PAGE, 2.7) as figure:
        left, right = figure.subplots(1, 2)
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
            limit = orbit_theory(k, math.inf, profile)
            exact = [orbit_theory(k, c, profile) / limit for c in fine.tolist()]
            right.plot(fine / (1.0 + fine), exact, color=color, linestyle=dashes)
            place, label = 1.0 - 1.0 / (1.0 + rows["orbit_constant"]), f"$k={k:g}$, {profile}"
            right.plot(place, rows["drift"] / limit, marker, color=color, markerfacecolor="white",
                       label=label)  # fmt: skip
        right.legend(loc="upper left")
        style.letter_panels([left, right])


@common.command
def main(small=False):
    """Run, print, write and draw; the largest differences from theory."""
    distances = (4.0, 16.0) if small else (1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
    constants = [1.0, math.inf] if small else [0.3, 1.0, 3.0, 10.0, math.inf]
    places = Table("lateral_drift_places_distance", "drift: K c^2; theory: at the mean shear rate")
    orbits = Table("lateral_drift_places_orbits", "drift, and that along the vorticity, over K St")
    for k, light in RUNS[::2]:
        for distance in distances:
            run(k, [light, 10.0 * light], "both", distance, places)
    for k, profile in PROFILES:
        on_orbits(k, profile, constants, orbits)
    places.write()
    orbits.write()
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
    draw(places, orbits)
    apart = np.abs(places["drift"] / places["theory"] - 1.0)
    return {
        "largest difference, from four lengths on": apart[places["distance"] >= 4.0].max(),
        "largest difference at any distance": apart.max(),
        "largest difference on orbits": np.abs(orbits["drift"] / orbits["theory"] - 1.0).max(),
        "largest velocity along the vorticity": np.abs(orbits["along_vorticity"]).max(),
    }
