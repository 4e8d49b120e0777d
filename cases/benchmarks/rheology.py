"""What stresses cost: recorded along motions, and of Brownian axes.

`recording`: processor time of the stresslet and of all parts of the particle stress at the samples,
over that of the motion's integration, 67 samples a turn. `langevin`: ns for a step of one axis.
(Densities of orientations, their errors and times: `./run.sh test tests/test_rheology.py`.)

Run:      python cases/benchmarks/rheology.py      (1 min; --small: 5 s; --csv)
Expected: stresslet at most 10 %, particle stress at most 16 % without mass and 50 % with it; 500 to
          900 ns.
"""

import time

import numpy as np
from measure import command, timed

import qbxstokes as qs

FLOWS = {"shear": qs.flow("shear"), "paraboloid": qs.flow("paraboloid")}


def recording(flow, stokes_number, lanes):
    """Shares (%) of the integration's time."""
    axes = np.random.default_rng(0).standard_normal((lanes, 3))
    body = qs.Body(0.5, stokes_number=stokes_number)
    assert body.stress.error_estimate < 1e-10
    scene = qs.Simulation(body, FLOWS[flow], position=[0.0, 1.0, 0.0], orientation=axes)
    motion = scene.integrate(np.linspace(0.0, 15.0 * np.pi, 201))
    assembled, states = motion._assembled, motion._states

    def spent(*names):
        wanted = ("torque", *names)
        return timed(lambda: assembled.observe(motion.time, states, wanted), 9, time.thread_time)[0]

    rates, _ = timed(lambda: assembled.trajectory(motion.time), 3, time.thread_time)
    without = spent()
    row = {"flow": flow, "St": stokes_number, "lanes": lanes}
    for name in ("stresslet", "particle_stress"):
        row[f"{name}_percent"] = 100.0 * max(0.0, spent(name) - without) / rates
    return row


def langevin(trajectories):
    """Time of a step of one axis."""
    keys = {"trajectories": trajectories, "strain": 5.0, "step": 0.05}
    body, shear = qs.Body(0.2), FLOWS["shear"]
    seconds, _ = timed(lambda: qs.langevin(body, shear, 10.0, **keys), 3, time.thread_time)
    steps = (5.0 + 5.0) / 0.05
    return {"trajectories": trajectories, "ns_per_step": 1e9 * seconds / steps / trajectories}


@command
def main(small):
    """Both tables."""
    lanes, inertia = ((64,), (0.0,)) if small else ((1, 64, 512), (0.0, 5.0))
    return {
        "recording": [recording(flow, st, n) for flow in FLOWS for st in inertia for n in lanes],
        "langevin": [langevin(count) for count in ((1024,) if small else (1024, 8192))],
    }
