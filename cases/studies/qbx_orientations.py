"""Force, torque and velocities of a body in random orientations, against closed forms.

A body in shear with a paraboloid on top is held (force, torque) or free (velocities), and the
integral equation is solved for each of a hundred orientations. Uniform is the scheme of the thesis
with n_theta = 20, p = 10, kappa = 10 (fine: 24, 20) and r/h at 0.8 of its largest.

Paper:    J. Bagge 2015, KTH, chapter 7; Kim & Karrila 1991, chapter 3 (Lamb, Jeffery, Faxen).
Run:      python cases/studies/qbx_orientations.py      (10 s)
Expected: in every orientation errors of at most 5e-4 (uniform), 1.3e-5 (fine), 7e-11 (graded 1e-6)
          and 5e-15 (graded 1e-10).
"""

import time

import common
import numpy as np
from common import Table, power

import qbxstokes as qs
from qbxstokes.bie.accuracy import choose_scheme
from qbxstokes.bie.operators import surface_operators
from qbxstokes.bie.providers import SolveMotion
from qbxstokes.geometry import rotation
from qbxstokes.plots import style
from qbxstokes.reference import faxen

SCHEMES = ("uniform", "uniform fine", "graded 1e-6", "graded 1e-10")
ERRORS = ("force", "torque", "velocity", "angular_velocity")


def scheme_and_completion(k, name):
    """The quadrature of a name, and the completion that goes with it."""
    if name.startswith("graded"):
        return choose_scheme(float(name.split()[1])), "surface"
    order, upsampling = (10, 10) if name == "uniform" else (24, 20)
    r_over_h = 0.8 * common.largest_ratio(k, 20)
    return common.uniform(k, 20, order, r_over_h, upsampling), "point"


def closed_forms(k, flow, x, d):
    """Force, torque, velocity and angular velocity (n, 3) at x (n, 3) with axes d (n, 3)."""
    u, omega = faxen.free_motion_polynomial(k, d, *flow.derivatives(x)[:4])
    across, along, turning, spinning = faxen.resistance(k)
    force = across * u + (along - across) * d * np.sum(d * u, 1, keepdims=True)
    torque = turning * omega + (spinning - turning) * d * np.sum(d * omega, 1, keepdims=True)
    return force, torque, u, omega


def measure(k, name, count, each):
    """Add relative errors per orientation, and wall times of the set-up and of a solve."""
    flow = common.every_term().polynomial
    scheme, completion = scheme_and_completion(k, name)
    q = rotation.random_quaternions(count, np.random.default_rng(7))
    d, x, still = rotation.axis(q), np.tile(common.PLACE, (count, 1)), np.zeros((count, 3))
    begin = time.perf_counter()
    # Nine azimuthal nodes: odd, and beyond the modes that a flow of degree 2 excites.
    motion = SolveMotion(surface_operators(qs.Spheroid(k), scheme, 9, completion), flow)
    motion.free_motion(0.0, x[:1], q[:1])
    formed = time.perf_counter()
    u, omega = motion.free_motion(0.0, x, q)
    force, torque = motion.force_torque(0.0, x, q, still, still)
    solve = (time.perf_counter() - formed) / (2 * count)
    found = (force, torque, u, omega)
    errors = [
        np.linalg.norm(value - exact, axis=1) / np.linalg.norm(exact, axis=1)
        for value, exact in zip(found, closed_forms(k, flow, x, d), strict=True)
    ]
    for tilt, *row in zip(np.degrees(np.arccos(np.abs(d[:, 2]))), *errors, strict=True):
        each.add(aspect_ratio=k, scheme=name, tilt=tilt, **dict(zip(ERRORS, row, strict=True)),
                 set_up=formed - begin, solve=solve)  # fmt: skip


def draw(each, ratios):
    """Errors over the tilt of the axis, a panel per aspect ratio."""
    with common.figure("qbx_orientations", style.PAGE, 3.1, 1, len(ratios)) as panels:
        for panel, k in zip(panels, ratios, strict=True):
            for (color, _, marker), name in zip(style.LINES, SCHEMES, strict=False):
                part, look = each.where(aspect_ratio=k, scheme=name), {"color": color}
                panel.plot(part["tilt"], part["force"], marker, label=name, **look)
                look["markerfacecolor"] = "none"
                panel.plot(part["tilt"], part["angular_velocity"], marker, **look)
            common.labelled(panel, "tilt of the axis (deg)", "", "y")
            panel.set_ylim(1e-17, 1e-2)
            panel.set_title(f"$k={k:g}$", loc="left")
        panels[0].set_ylabel("relative error")
        for text, face in (("force, held", style.BLACK), ("angular velocity, free", "none")):
            look = {"color": style.BLACK, "markerfacecolor": face, "label": text}
            panels[0].plot([], [], "o", **look)
        names = panels[0].get_legend_handles_labels()
        panels[0].figure.legend(*names, loc="outside upper left", ncol=6, handlelength=1.0)


@common.command
def main(small=False):
    """Run, print, write and draw; the largest error of each scheme."""
    ratios, count = ((0.5,), 6) if small else ((0.5, 2.0), 100)
    schemes = [name for name in SCHEMES if not (small and name == "uniform fine")]
    each = Table("qbx_orientations", "relative errors; tilt from the vorticity in deg, times in s")
    lines = []
    for k in ratios:
        for name in schemes:
            measure(k, name, count, each)
            part = each.where(aspect_ratio=k, scheme=name)
            lines.append(
                (f"{k:g}", name,
                 *(f"{power(np.median(part[e]))} / {power(part[e].max())}" for e in ERRORS),
                 f"{part['set_up'][0]:.2g}", f"{1e3 * part['solve'][0]:.2g}")
            )  # fmt: skip
    each.write()
    print("Median / largest error over the orientations")
    head = ("force", "torque", "velocity", "angular velocity", "set-up (s)", "solve (ms)")
    common.markdown(("k", "scheme", *head), lines)
    draw(each, ratios)
    largest = {name: [each.where(scheme=name)[e].max() for e in ERRORS] for name in schemes}
    return {f"largest error, {name}": max(errors) for name, errors in largest.items()}
