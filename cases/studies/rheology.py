"""Dilute suspensions of Brownian spheroids in shear: material functions over the Peclet number.

Intrinsic viscosity and normal stress differences of rods and discs, their limits over the aspect
ratio, and published numbers: viscosities at small Peclet number tabulated by Scheraga, Simha's
formula for slender rods, Jeffery's extremes of the dissipation over orbits, the one relaxation time
of small oscillations.

Papers:   R. Simha 1940, J. Phys. Chem. 44, 25; H. A. Scheraga 1955, J. Chem. Phys. 23, 1526; G. B.
          Jeffery 1922, Proc. R. Soc. A 102, 161; G. K. Batchelor 1970, J. Fluid Mech. 41, 545;
          E. J. Hinch & L. G. Leal 1972, J. Fluid Mech. 52, 683; H. Brenner 1974, Int. J. Multiphase
          Flow 1, 195.
Run:      python cases/studies/rheology.py      (20 s)
Expected: 2.908, 5.806, 13.63, 55.19 to every digit at small Pe; Simha's formula within 1 % at 25:1;
          N1 positive and N2 negative everywhere; small oscillations to 1e-6.
"""

from __future__ import annotations

import math

import common
import numpy as np
from common import Table

import qbxstokes as qs
from qbxstokes.plots import style

SHEAR = qs.flow("shear")
PUBLISHED = {2: 2.908, 5: 5.806, 10: 13.63, 25: 55.19}
NAMES = ("intrinsic_viscosity", "first_normal_stress_difference", "second_normal_stress_difference")


def simha(r: float) -> float:
    """[eta] at small Peclet number of slender rods of aspect ratio r (Simha 1940)."""
    log = math.log(2.0 * r)
    return r * r / (15.0 * (log - 1.5)) + r * r / (5.0 * (log - 0.5)) + 14.0 / 15.0


def curves(ratios: list[float], numbers: list[float], found: Table) -> None:
    """Material functions of bodies k over Peclet numbers."""
    for k in ratios:
        result = qs.rheology(qs.Body(k), SHEAR, numbers)
        for index, number in enumerate(numbers):
            values = {name: float(getattr(result, name)[index]) for name in NAMES}
            found.add(aspect_ratio=k, peclet_number=number, **values)


def limits(ratios: list[float], found: Table) -> None:
    """[eta] at small Pe, and over orbits: rolling, tumbling, isotropic at first."""
    for k in ratios:
        body = qs.Body(k)
        at_rest = qs.rheology(body, SHEAR, 1e-6).intrinsic_viscosity
        starts = {"rolling": [0, 0, 1], "tumbling": [1, 0, 0], "isotropic": "isotropic"}
        orbits = {
            name: float(qs.rheology(body, SHEAR, np.inf, orientations=start).intrinsic_viscosity)
            for name, start in starts.items()
        }
        found.add(aspect_ratio=k, at_rest=float(at_rest), **orbits)


def oscillation(k: float) -> float:
    """Relative error of the complex viscosity at w = 6 D against one relaxation time."""
    result = qs.rheology(qs.Body(k), SHEAR, 0.006, protocol="oscillation", amplitude=1e-3)
    facts = result.summary
    phase = np.exp(-1j * facts["frequency"] * result.time[:-1])
    measured = 2.0 * np.mean(result.intrinsic_viscosity[:-1] * phase)
    low, high = facts["viscosity_of_isotropic"], facts["viscosity_at_rest"]
    exact = low + (high - low) / (1.0 + 1j * facts["frequency"] * 0.006 / 6.0)
    return float(abs(measured / exact - 1.0))


def draw(table: Table, ends: Table) -> None:
    """Material functions over Pe, and the limits of [eta] over k."""
    with common.figure("rheology", style.PAGE, 4.6) as drawn:
        panels = np.ravel(drawn.subplots(2, 2))
        for axes, name, symbol in zip(panels, NAMES, (r"[\eta]", "N_1", "N_2"), strict=False):
            for index, k in enumerate(np.unique(table["aspect_ratio"]).tolist()):
                rows = table.where(aspect_ratio=k)
                look = style.line_style(index)
                values = np.abs(rows[name])
                axes.loglog(rows["peclet_number"], values, label=f"$k = {k:g}$", **look)
            sign = "-" if name == NAMES[2] else ""
            axes.set_ylabel(f"${sign}{symbol}$")
            axes.set_xlabel(r"Peclet number $\mathrm{Pe}$")
        style.legend_above(panels[0], columns=3)
        for index, name in enumerate(("at_rest", "rolling", "tumbling", "isotropic")):
            look = style.line_style(index)
            panels[3].loglog(ends["aspect_ratio"], ends[name], label=name.replace("_", " "), **look)
        panels[3].set_xlabel("aspect ratio $k$")
        panels[3].set_ylabel(r"$[\eta]$")
        style.legend_above(panels[3], columns=4)
        style.letter_panels(panels)


def main(small: bool) -> dict[str, float]:
    """The tables, the figure, and what is held against published numbers."""
    table = Table("rheology", "material functions per volume fraction, mu and rate")
    ends = Table("rheology_limits", "intrinsic viscosities at small Peclet number and on orbits")
    ratios = [0.2, 5.0] if small else [1 / 25, 0.1, 0.2, 0.5, 2.0, 5.0, 25.0]
    numbers = np.logspace(-1, 3, 5 if small else 33).tolist()
    curves(ratios, numbers, table)
    limits(np.geomspace(1 / 25, 25, 5 if small else 25).tolist(), ends)
    table.write()
    ends.write()
    draw(table, ends)
    rest = {
        r: float(qs.rheology(qs.Body(1 / r), SHEAR, 1e-6).intrinsic_viscosity) for r in PUBLISHED
    }
    common.markdown(
        ("r", "[eta] at small Pe", "Scheraga"),
        [(f"{r}", f"{rest[r]:.4g}", f"{value:g}") for r, value in PUBLISHED.items()],
    )
    return {
        "largest difference from Scheraga's digits": max(
            abs(float(f"{rest[r]:.4g}") - value) for r, value in PUBLISHED.items()
        ),
        "Simha's formula at 25:1, relative": abs(simha(25.0) / rest[25] - 1.0),
        "smallest N1": table[NAMES[1]].min(),
        "largest N2": table[NAMES[2]].max(),
        "small oscillations, relative": oscillation(0.2),
    }


if __name__ == "__main__":
    common.command(main)
