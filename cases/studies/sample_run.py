"""Two bodies released at rest three lengths off the axis of a paraboloid, in general orientation.

The prolate one tumbles ever more in the plane of shear and moves to higher shear all the while; the
oblate one settles into rolling and stops moving across the stream.

Paper:    J. Bagge 2015, KTH, chapter 9.
Run:      python cases/studies/sample_run.py      (5 s)
Expected: displacements to higher shear of 0.202 (k = 1/2, St = 10, t = 600) and -0.0282 (k = 2,
          St = 1, t = 200).
"""

import math

import common
import numpy as np
from motions import TIGHT, body, labelled, paraboloid

import qbxstokes as qs
from qbxstokes.plots import style

DISTANCE = 3.0
NAMES = (("$x_2$", "$x_3$"), ("",), ("$V_2$", "$V_3$"), ("$D^3_1$", "$D^3_2$", "$D^3_3$"), ("",),
         ("",), (r"$\Omega_1$", r"$\Omega_2$", r"$\Omega_3$"))  # fmt: skip
LABELS = ("across the stream\n$x_i-x_i(0)$", "velocity $V_1$", "$V_2,V_3$", "axis $D^3$",
          "angle $\\theta$ (rad)", "turns of the axis\n$\\varphi/2\\pi$",
          r"$\mathbf{\Omega}$")  # fmt: skip


def draw(k, stokes, end, panels, first):
    """Integrate and draw one run; how far it moves across the stream."""
    motion = qs.Simulation(
        body(k, stokes), paraboloid(DISTANCE), position=(0.0, DISTANCE, 0.0),
        orientation=(0.48, -0.6, 0.64), velocity=np.zeros(3), angular_velocity=np.zeros(3),
        tolerance=TIGHT,
    ).integrate(np.linspace(0.0, end, 2401))  # fmt: skip
    x, v = motion.position - motion.position[0], motion.velocity
    angles = np.unwrap(motion.euler_angles, axis=0)
    shown = (x[:, 1:], v, v[:, 1:], motion.axis, angles[:, 1:], angles / (2.0 * math.pi),
             motion.angular_velocity)  # fmt: skip
    columns = np.column_stack([motion.time, motion.position, v, *shown[3:5], shown[6]])
    np.savetxt(f"sample_run_k{k:g}.csv", columns, "%.9g", ",", header="time; position, velocity, "
               "axis (3 each); theta, psi; angular velocity (3)")  # fmt: skip
    for panel, values, label, names in zip(panels, shown, LABELS, NAMES, strict=True):
        labelled(panel, "", label if first else "")
        for name, curve, (color, _, _) in zip(names, values.T, style.LINES, strict=False):
            panel.plot(motion.time, curve, color=color, linewidth=0.6, label=name)
        if len(names) > 1:
            legend = panel.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), handlelength=1)
            for line in legend.get_lines():
                line.set_linewidth(1.5)
    # The first push across the stream is a hundred times the drift that follows.
    panels[2].set_yscale("symlog", linthresh=1e-3)
    panels[2].set_yticks([-1e-2, -1e-3, 0.0, 1e-3, 1e-2])
    panels[0].set_title(f"$k={k:g}$, $\\mathrm{{St}}={stokes:g}$", loc="left")
    panels[-1].set_xlabel(style.label("time $t$", "tau"))
    return float(x[-1, 1])


@common.command
def main(small=False):
    """Run and draw; the displacements across the stream."""
    runs = ((0.5, 10.0, 60.0),) if small else ((0.5, 10.0, 600.0), (2.0, 1.0, 200.0))
    found = {}
    with common.figure("sample_run", style.PAGE, 8.2) as figure:
        panels = figure.subplots(7, len(runs), squeeze=False, sharex="col")
        for column, run in enumerate(runs):
            found[f"displacement, k = {run[0]:g}"] = draw(*run, panels[:, column], column == 0)
        figure.align_ylabels(panels[:, 0])
    return found
