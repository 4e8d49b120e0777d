"""What stresses cost: recorded along motions, and of a suspension's density of orientations.

`recording`: processor time of the stresslet and of all parts of the particle stress at the samples,
over that of the motion's integration, 67 samples a turn. `density`: processor time (s) of a steady
density, its degree, its error against a far finer one and what it says of itself; `general` is the
worst of four random linear flows. `langevin`: ns for a step of one axis.

Run:      python cases/benchmarks/rheology.py      (3 min; --small: 10 s; --csv)
Expected: stresslet at most 10 %, particle stress at most 16 % without mass and 50 % with it; shear
          at most 0.2 s up to Pe 1000, general flows at most 0.8 s, all errors below 1e-8 and below
          three estimates; 500 to 900 ns.
"""

import time

import numpy as np
from measure import command, timed

import qbxstokes as qs
from qbxstokes.simulation.rheology import linear_flow, particle_of
from qbxstokes.suspension.fokker_planck import Transport

FLOWS = {"shear": qs.flow("shear"), "paraboloid": qs.flow("paraboloid")}
FINEST = 230


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


def density(k, number, flow, name):
    """Time, degree and error of one steady density."""
    body = qs.Body(k)
    particle, _ = particle_of(body)
    seconds, found = timed(lambda: qs.rheology(body, flow, number), 3, time.thread_time)
    homogeneous = linear_flow(flow, [0.0, 0.0, 0.0])
    finer = Transport(homogeneous, particle.linear).steady(1.0 / number, FINEST)
    second, fourth = finer.moments()
    exact = particle.hydrodynamic_stress(second, fourth, homogeneous.strain)
    exact = exact + particle.brownian_stress(second, 1.0 / number)
    error = float(np.max(np.abs(found.particle_stress - exact)) / np.max(np.abs(exact)))
    row = {"flow": name, "k": k, "Pe": number, "seconds": seconds}
    return {**row, "degree": found.summary["degree"][0], "error": error} | {
        "estimate": float(found.error_estimate)
    }


def general(k, number, count):
    """The slowest of some random flows, with the largest error and what it says of that one."""
    rows = []
    for seed in range(count):
        gradient = np.random.default_rng(seed).standard_normal((3, 3))
        gradient -= np.trace(gradient) / 3.0 * np.eye(3)
        flow = qs.flow("polynomial", gradient=gradient.tolist())
        rows.append(density(k, number, flow, "general"))
    worst = max(rows, key=lambda row: row["error"])
    slowest = max(rows, key=lambda row: row["seconds"])
    return {**worst, "seconds": slowest["seconds"], "degree": slowest["degree"]}


def langevin(trajectories):
    """Time of a step of one axis."""
    keys = {"trajectories": trajectories, "strain": 5.0, "step": 0.05}
    body, shear = qs.Body(0.2), FLOWS["shear"]
    seconds, _ = timed(lambda: qs.langevin(body, shear, 10.0, **keys), 3, time.thread_time)
    steps = (5.0 + 5.0) / 0.05
    return {"trajectories": trajectories, "ns_per_step": 1e9 * seconds / steps / trajectories}


@command
def main(small):
    """Three tables."""
    lanes = (64,) if small else (1, 64, 512)
    inertia = (0.0,) if small else (0.0, 5.0)
    shapes = (0.2,) if small else (1 / 25, 0.2, 5.0, 25.0)
    numbers = (100.0,) if small else (1.0, 100.0, 1000.0)
    count = 1 if small else 4
    return {
        "recording": [recording(flow, st, n) for flow in FLOWS for st in inertia for n in lanes],
        "density": [
            row
            for k in shapes
            for number in numbers
            for row in (density(k, number, FLOWS["shear"], "shear"), general(k, number, count))
        ],
        "langevin": [langevin(1024)] + ([] if small else [langevin(8192)]),
    }
