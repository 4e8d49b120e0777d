"""Dilute suspensions of Brownian spheroids in shear: material functions over the Peclet number.

Intrinsic viscosity and normal stress differences of rods and discs, their limits over the aspect
ratio, and what has been published: tables and formulas of viscosities at small and at large Peclet
numbers, Jeffery's least ones, series and asymptotes of rigid dumbbells. (The density in a flow
without vorticity, and the one relaxation time of small oscillations: tests/test_rheology.py.)

Papers:   A. Einstein 1911, Ann. Phys. 339, 591; G. B. Jeffery 1922, Proc. R. Soc. A 102, 161; R.
          Simha 1940, J. Phys. Chem. 44, 25; J. W. Mehl, J. L. Oncley & R. Simha 1940, Science 92,
          132; H. A. Scheraga 1955, J. Chem. Phys. 23, 1526; G. K. Batchelor 1970, J. Fluid Mech.
          41, 545; W. E. Stewart & J. P. Sorensen 1972, Trans. Soc. Rheol. 16, 1; E. J. Hinch & L.
          G. Leal 1972, J. Fluid Mech. 52, 683; H. Brenner 1974, Int. J. Multiphase Flow 1, 195; R.
          B. Bird et al. 1987, Dynamics of Polymeric Liquids 2, chapter 14; L. G. Leal & E. J. Hinch
          1972, J. Fluid Mech. 55, 745 (of a body r = 1 + e: F = 9 e, one relaxation time).
Run:      python cases/studies/rheology.py      (40 s)
Expected: a sphere 2.5; rods of 2, 5, 10 and 25 to one 2.908, 5.806, 13.63, 55.19 to every digit
          (Scheraga), the 26 entries of Mehl, Oncley & Simha to 0.7 %, half of them to 0.04 %;
          Simha's formula to 0.7 % at 25:1; least values 2.000 of rods and 2.061 of discs (Jeffery);
          at large Pe Brenner's formulas to 1.3 % (rod of 50:1) and 0.2 % (disc of 1:50);
          dumbbells: the series' 18/35 and 38/35 to 0.04 %, at large Pe 0.658 and 1.203 where
          Stewart & Sorensen have 0.678 and 1.20; Hinch & Leal's factors of slender rods to 0.9 %
          (Batchelor's A among them), of discs to 3.4 %, of near spheres to 0.02 %, with which
          Leal & Hinch's constitutive equations have near spheres' loss of
          viscosity 0.3 e^2, N1 = 0.6 e^2 and N2 = -N1/7 at Pe = 6 to 0.03 %; N1 > 0 > N2
          everywhere.
"""

import functools
import math

import common
import numpy as np
from common import Table

import qbxstokes as qs
from qbxstokes.plots import style
from qbxstokes.simulation.rheology import linear_flow
from qbxstokes.suspension.fokker_planck import Transport
from qbxstokes.suspension.particle import Particle

SHEAR = qs.flow("shear")
SCHERAGA = {2: 2.908, 5: 5.806, 10: 13.63, 25: 55.19}
# Mehl, Oncley & Simha: viscosity increments at small Peclet number, prolate and oblate.
PROLATE = {2: 2.91, 3: 3.68, 4: 4.66, 5: 5.81, 6: 7.10, 8: 10.10, 10: 13.63, 12: 17.76, 15: 24.8}
PROLATE |= {20: 38.6, 25: 55.2, 30: 74.5, 40: 120.8, 50: 176.5}
OBLATE = {2: 2.85, 3: 3.43, 4: 4.06, 5: 4.71, 6: 5.36, 8: 6.70, 10: 8.04, 12: 9.39, 15: 11.42}
OBLATE |= {20: 14.80, 25: 18.19, 30: 21.6}
NAMES = ("intrinsic_viscosity", "first_normal_stress_difference", "second_normal_stress_difference")
STARTS = {"rolling": [0, 0, 1], "tumbling": [1, 0, 0], "isotropic": "isotropic"}


def simha(r):
    """[eta] at small Peclet number of slender rods of aspect ratio r (Simha 1940)."""
    log = math.log(2.0 * r)
    return r * r / (15.0 * (log - 1.5)) + r * r / (5.0 * (log - 0.5)) + 14.0 / 15.0


def brenner(k):
    """[eta] of slender rods and flat discs at large Peclet numbers (Brenner 1974)."""
    if k > 1.0:
        return 3.183 - 1.792 / k
    return 2.0 + (0.312 / k - 0.5) / (math.log(2.0 / k) - 1.5) - 1.872 * k


@functools.cache
def body(k):
    """The spheroid of an aspect ratio, formed once."""
    return qs.Body(k)


def viscosity(k, number, **keys):
    """[eta] of spheroids in shear."""
    return float(qs.rheology(body(k), SHEAR, number, **keys).intrinsic_viscosity)


def dumbbell(number, degree):
    """[eta] and Psi_1 in units of n kT lambda and n kT lambda^2 of rigid dumbbells in shear.

    lambda = 1/(6 D). Their stress is 3 n kT <pp> + 6 n kT lambda <pppp>:E; the flow turns them as
    slender rods.
    """
    drift = Transport(linear_flow(SHEAR, [0, 0, 0]), 1.0)
    beads = Particle(np.array([2.0 / 3.0, 0.0, 0.0]), 1.0, 1.0, 1.0)
    second, fourth = drift.steady(1.0 / number, degree).moments()
    stress = beads.hydrodynamic_stress(second, fourth, drift.flow.strain)
    stress = stress + beads.brownian_stress(second, 1.0 / number)
    found = drift.flow.material_functions(stress)
    # n kT lambda is zeta/6 here, Psi_1 = N1/rate^2 and lambda = Pe/6.
    return 6.0 * float(found[NAMES[0]]), 36.0 / number * float(found[NAMES[1]])


def factors(k):
    """Hinch & Leal's A, B, C: stress 2 mu (A <pppp>:E + B (<pp>.E + E.<pp>) + C E)."""
    s0, s1, s2, _ = np.resize(body(k).stress.numbers, 4) / (2.0 * body(k).shape.volume)
    return [float(1.5 * s0 - 2.0 * s1 + 0.5 * s2), float(s1 - s2), float(s2)]


def second_order(linear, index, small=0.01):
    """Coefficient of e^2 in a factor of r = 1 + e: what is left of it over e^2, extrapolated."""
    left = [
        (factors(1.0 / (1.0 + e))[index] - linear[0] - linear[1] * e) / e**2
        for e in (small, 2.0 * small)
    ]
    return 2.0 * left[0] - left[1]


def near_sphere(number, small=0.02):
    """[eta], N1 and N2 of spheroids r = 1 + e over e^2, less those at rest, where e is small."""
    sides = [body(1.0 / (1.0 + sign * small)) for sign in (1, -1)]
    found = [qs.rheology(side, SHEAR, [1e-6, number]) for side in sides]
    means = np.mean([[np.diff(getattr(one, name)) for name in NAMES] for one in found], axis=0)
    return (means[:, 0] / small**2).tolist()


def draw(table, ends):
    """Material functions over Pe, and the limits of [eta] over k."""
    with common.figure("rheology", style.PAGE, 4.6, 2, 2) as panels:
        for axes, name, symbol in zip(panels, NAMES, (r"[\eta]", "N_1", "-N_2"), strict=False):
            common.labelled(axes, r"Peclet number $\mathrm{Pe}$", f"${symbol}$", "xy")
            for index, k in enumerate(np.unique(table["aspect_ratio"]).tolist()):
                rows, look = table.where(aspect_ratio=k), style.line_style(index)
                axes.plot(rows["peclet_number"], abs(rows[name]), label=f"$k = {k:g}$", **look)
        common.labelled(panels[3], "aspect ratio $k$", r"$[\eta]$", "xy")
        for index, name in enumerate(("at_rest", *STARTS)):
            look = {"label": name.replace("_", " "), **style.line_style(index)}
            panels[3].plot(ends["aspect_ratio"], ends[name], **look)
        style.legend_above(panels[0], columns=3)
        style.legend_above(panels[3], columns=2)


def published(small):
    """A table of what is ours and what is published; the differences."""
    rods = {r: v for r, v in PROLATE.items() if r in SCHERAGA or not small}
    discs = {r: v for r, v in OBLATE.items() if r in SCHERAGA or not small}
    rest = {k: viscosity(k, 1e-6) for k in [1 / r for r in rods] + [float(r) for r in discs]}
    pairs = [(rest[1 / r], value) for r, value in rods.items()]
    pairs += [(rest[float(r)], value) for r, value in discs.items()]
    tabulated = sorted(abs(ours / value - 1.0) for ours, value in pairs)
    low, high = dumbbell(1e-4, 12), dumbbell(1e5, 400)
    slow, x, y = dumbbell(0.1, 20), 0.1 / 6.0, 1e5 / 6.0
    weak = {k: viscosity(k, 1e7, tolerance=1e-4) for k in (1 / 50, 50.0)}
    # The least value of discs has an error of order 1/k.
    flat = [viscosity(k, np.inf, orientations=[1, 0, 0]) for k in (25.0, 50.0)]
    drum_a = 500 / (3 * math.pi) + 208 / (9 * math.pi**2) - 2
    log, slender, drum = math.log(100.0), factors(1 / 50), factors(50.0)
    eta, n1, n2 = near_sphere(6.0)
    rows = [
        ("sphere", viscosity(1.0, 1.0), 2.5, "Einstein"),
        *((f"rod of {r}:1, small Pe", rest[1 / r], v, "Scheraga") for r, v in SCHERAGA.items()),
        ("rod of 25:1, small Pe", rest[1 / 25], simha(25.0), "Simha, slender rods"),
        *((f"rod of {r}:1, small Pe", rest[1 / r], v, "Mehl et al.") for r, v in rods.items()),
        *((f"disc of 1:{r}, small Pe", rest[r], v, "Mehl et al.") for r, v in discs.items()),
        ("rod of 50:1, large Pe", weak[1 / 50], brenner(1 / 50), "Brenner"),
        ("disc of 1:50, large Pe", weak[50.0], brenner(50.0), "Brenner"),
        ("rod, least", viscosity(1 / 50, np.inf, orientations=[0, 0, 1]), 2.0, "Jeffery"),
        ("disc, least", 2.0 * flat[1] - flat[0], 2.061, "Jeffery"),
        ("dumbbell, Psi_1 at rest", low[1], 1.2, "Bird et al."),
        ("[eta], second order", (1.0 - slow[0] / low[0]) / x**2, 18 / 35, "Bird et al."),
        ("Psi_1, second order", (1.0 - slow[1] / low[1]) / x**2, 38 / 35, "Bird et al."),
        ("[eta] (rate lambda)^(1/3)", high[0] * y ** (1 / 3), 0.678, "Stewart & Sorensen"),
        ("Psi_1 (rate lambda)^(4/3)", high[1] * y ** (4 / 3), 1.20, "Stewart & Sorensen"),
        ("rod of 50:1, A", slender[0], 1250 / (log - 1.5), "Batchelor, Hinch & Leal"),
        ("rod of 50:1, B", slender[1], (6.0 * log - 11.0) / 2500, "Hinch & Leal"),
        ("disc of 1:50, A", drum[0], drum_a, "Hinch & Leal"),
        ("disc of 1:50, C", drum[2], 400 / (3 * math.pi), "Hinch & Leal"),
        ("near a sphere, A/e^2", second_order((0.0, 0.0), 0), 395 / 147, "Hinch & Leal"),
        ("near a sphere, B: e^2", second_order((0.0, 15 / 14), 1), -895 / 588, "Hinch & Leal"),
        ("near a sphere, loss of [eta] to Pe = 6, over e^2", -eta, 0.3, "Leal & Hinch"),
        ("near a sphere at Pe = 6, N1/e^2", n1, 0.6, "Leal & Hinch"),
        ("near a sphere at Pe = 6, -N2/N1", -n2 / n1, 1 / 7, "Leal & Hinch"),
    ]
    common.markdown(
        ("[eta], or of a dumbbell", "here", "published", "by"),
        [(name, f"{ours:.5g}", f"{value:.5g}", who) for name, ours, value, who in rows],
    )
    return {
        **{name: abs(ours / value - 1.0) for name, ours, value, _ in rows},
        "largest difference from Scheraga's digits": max(
            abs(float(f"{rest[1 / r]:.4g}") - value) for r, value in SCHERAGA.items()
        ),
        "Simha's formula at 25:1, relative": abs(simha(25.0) / rest[1 / 25] - 1.0),
        "table of Mehl et al., largest": tabulated[-1],
        "table of Mehl et al., median": tabulated[len(tabulated) // 2],
    }


@common.command
def main(small):
    """The tables, the figure, and what is held against published numbers."""
    table = Table("rheology", "material functions per volume fraction, mu and rate")
    ends = Table("rheology_limits", "intrinsic viscosities at small Peclet number and on orbits")
    ratios = [0.2, 5.0] if small else [1 / 25, 0.1, 0.2, 0.5, 2.0, 5.0, 25.0]
    numbers = np.logspace(-1, 3, 5 if small else 33).tolist()
    for k in ratios:
        found = qs.rheology(body(k), SHEAR, numbers)
        columns = [getattr(found, name).tolist() for name in NAMES]
        for number, *values in zip(numbers, *columns, strict=True):
            named = dict(zip(NAMES, values, strict=True))
            table.add(aspect_ratio=k, peclet_number=number, **named)
    for k in np.geomspace(1 / 25, 25, 5 if small else 25).tolist():
        orbits = {name: viscosity(k, np.inf, orientations=start) for name, start in STARTS.items()}
        ends.add(aspect_ratio=k, at_rest=viscosity(k, 1e-6), **orbits)
    table.write()
    ends.write()
    draw(table, ends)
    return {
        **published(small),
        "smallest N1": table[NAMES[1]].min(),
        "largest N2": table[NAMES[2]].max(),
    }
