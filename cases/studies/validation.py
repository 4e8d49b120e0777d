"""Spheroids in linear shear and in a paraboloid against closed forms and independent integrations.

Massless bodies in shear against Jeffery's orbits, in u = K (x2^2 + x3^2) e1 against Chwang's
velocity and Jeffery's axis at the local shear rate. Inertial ones, integrated by scipy, in shear
with Jeffery's torque (the equations of Lundell & Carlsson), and in the paraboloid, the axis in the
plane of x1 and x2, with Chwang's force and torque on a held body and Lamb's and Jeffery's drag.

Papers:   G. B. Jeffery 1922, Proc. R. Soc. A 102, 161; A. T. Chwang 1975, J. Fluid Mech. 72, 17;
          F. Lundell & A. Carlsson 2010, Phys. Rev. E 81, 016323; J. Bagge 2015, KTH, chapters 8, 9.
Run:      python cases/studies/validation.py      (20 s)
Expected: errors of axes below 1e-8 (1e-10 for 0.1 <= k <= 10), of periods and orbit constants below
          1e-10, of paths across the stream, relative to their extent, below 1e-8.
"""

import math

import common
import heavy
import numpy as np
from common import Table, labelled, power
from motions import SHEAR, axes, body, cross, orbit, paraboloid

import qbxstokes as qs
from qbxstokes.plots import style
from qbxstokes.reference import chwang, inertial, jeffery

AXES = axes([[0.48, -0.6, 0.64], [0.6, 0.8, 0.0], [0.1, 0.2, 0.97], [1.0, 0.0, 0.0]])


def run(k, stokes, distance, start, periods):
    """The motion of bodies in shear, or at a distance from the axis of the paraboloid."""
    flow = paraboloid(distance) if distance else SHEAR
    times = np.linspace(0.0, periods * jeffery.period(k), 100 * periods + 1)
    scene = qs.Simulation(body(k, stokes), flow, position=(0.0, distance, 0.0), orientation=start,
                          tolerance=1e-11)  # fmt: skip
    return scene.integrate(times)


def orbits(k, constants, found):
    """Massless bodies in shear, three periods."""
    for constant, start in zip(constants, orbit(k, constants, 0.3), strict=True):
        errors = run(k, 0.0, 0.0, start, 3).errors()
        errors = {name: errors[name] for name in ("period", "axis", "orbit_constant_drift")}
        found.add(aspect_ratio=k, orbit_constant=constant, **errors)


def drifting(k, distance, found):
    """Massless bodies in the paraboloid, two periods, four orientations."""
    motion = run(k, 0.0, distance, AXES, 2)
    velocity, turned = [], []
    for axis, v in zip(motion.axis, motion.velocity, strict=True):
        exact = jeffery.axis_at(motion.time, k, axis[0])
        angles = np.arccos(np.clip(exact[:, 0], -1.0, 1.0)).tolist()
        free = np.zeros_like(v)
        free[:, 0] = [chwang.free_velocity(k, 0.5 / distance, distance, a) for a in angles]
        velocity.append(np.abs(v - free).max() / np.abs(free).max())
        turned.append(np.abs(axis - exact).max())
    found.add(aspect_ratio=k, distance=distance, velocity=max(velocity), axis=max(turned))


def in_plane(k, stokes, found):
    """Inertial bodies in Chwang's orientation, three lengths off the axis, two periods."""
    distance, phi = 3.0, 0.5
    motion = run(k, stokes, distance, axes([[math.sin(phi), -math.cos(phi), 0.0]])[0], 2)
    exact = inertial.paraboloid(k, stokes, 0.5 / distance, (0.0, distance), phi, motion.time)
    d = np.stack([np.sin(exact.phi), -np.cos(exact.phi), 0.0 * exact.phi], axis=-1)
    path = np.abs(motion.position[:, :2] - exact.position).max(axis=0)
    along, across = path / np.ptp(exact.position, axis=0)
    found.add(aspect_ratio=k, stokes_number=stokes, axis=np.abs(motion.axis - d).max(), along=along,
              across=across)  # fmt: skip


def draw(massless, heavy_ones):
    """Error of the axis in shear against aspect ratio and Stokes number."""
    with common.figure("validation", style.PAGE, 2.8, 1, 2) as panels:
        common.curves(panels[0], massless, "aspect_ratio", "axis", "orbit_constant", "$C={:g}$")
        common.curves(panels[1], heavy_ones, "stokes_number", "axis", "aspect_ratio", "$k={:g}$")
        for panel, x in zip(
            panels, ("aspect ratio $k$", r"Stokes number $\mathrm{St}$"), strict=True
        ):
            labelled(panel, x, "error of the axis", "xy")
            style.legend_above(panel, columns=3)


@common.command
def main(small=False):
    """Run, print, write and draw; the largest errors."""
    ratios = (0.5, 2.0) if small else (0.05, 0.1, 0.2, 0.5, 2.0, 5.0, 10.0, 20.0)
    stokes_numbers = (10.0, 100.0) if small else (0.1, 1.0, 10.0, 100.0, 1000.0)
    shear, shear_inertia, curved, curved_inertia = tables = [
        Table(f"validation_{name}", "errors of axes; others relative to the largest")
        for name in ("shear", "shear_inertia", "paraboloid", "paraboloid_inertia")
    ]
    for k in ratios:
        orbits(k, [0.5, 2.0] if small else [0.1, 0.5, 1.0, 2.0, 10.0], shear)
        if not 0.1 <= k <= 10.0:
            continue
        for distance in (1.0, 3.0, 10.0):
            drifting(k, distance, curved)
        for st in stokes_numbers:
            # The explicit references have to follow every relaxation.
            if max(heavy.relaxation_rates(k)) / st * jeffery.period(k) < 2e3:
                errors = run(k, st, 0.0, AXES[0], 2).errors()
                shear_inertia.add(aspect_ratio=k, stokes_number=st, axis=errors["axis"],
                                  angular_velocity=errors["angular_velocity"])  # fmt: skip
                in_plane(k, st, curved_inertia)
    for table in tables:
        table.write()
    for table in (shear, curved):
        names = list(table.rows[0])[2:]
        rows = [
            (f"{k:g}", *(power(table.where(aspect_ratio=k)[name].max()) for name in names))
            for k in np.unique(table["aspect_ratio"]).tolist()
        ]
        common.markdown(("k", *(name.replace("_", " ") for name in names)), rows)
    cross(shear_inertia, lambda row: power(row["axis"]))
    cross(curved_inertia, lambda row: f"{power(row['axis'])} / {power(row['across'])}")
    draw(shear, shear_inertia)
    return {
        f"{table.name}, {name}": table[name].max()
        for table in tables
        for name in list(table.rows[0])[2:]
    }
