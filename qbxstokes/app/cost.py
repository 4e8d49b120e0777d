"""What a sweep costs: time, memory, and how it scales with the number of ranks.

    T(P) = models/min(P, bodies) + (integration + samples + hand-out)/P + last block + layout

with integration = trajectories x right-hand sides x time of one; the number of right-hand sides
follows from the horizon in shear times, and the tolerance of a step by the order of the formula.
The constants are processor times on one core of a 2 GHz Intel Xeon (Sapphire Rapids): measured are
a right-hand side of both kinds in linear flow and of inertial bodies in quadratic flow, steps, the
hand-out between two ranks, stored bytes and layout; the others are extrapolated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from qbxstokes.app.scenes import BLOCK_BYTES, Scenes

# Seconds per trajectory and right-hand side: massless and inertial, by degree of the flow (0, 1;
# 2; 3), and for a flow that is not polynomial.
RHS_SECONDS = {False: (1.1e-7, 1.3e-7, 2.5e-7), True: (1.7e-7, 1.9e-7, 3.5e-7)}
GENERAL_RHS_SECONDS = 5e-5
# Overhead of one call of the right-hand side, whatever the block holds.
CALL_SECONDS = 1.5e-5
# Steps per shear time at local tolerance 1 of the formula of order 8 (massless, inertial), and
# its stages.
STEP_FACTOR = {False: 0.3, True: 0.7}
STAGES = 13
SAMPLE_SECONDS = 6e-7
STORED_BYTE_SECONDS = 1.0e-9
HANDOUT_SECONDS = 5e-6
LAYOUT_SECONDS_PER_TRAJECTORY = 5e-7
MODEL_SECONDS = 0.7
BASE_MEMORY = 150e6


@dataclass(frozen=True)
class Estimate:
    """Seconds of the parts, and bytes of memory per rank."""

    models: float
    bodies: int
    integration: float
    output: float
    handout: float
    last_block: float
    layout: float
    memory: float

    @property
    def work(self) -> float:
        """Seconds of one rank alone."""
        return self.seconds(1)

    def seconds(self, ranks: int) -> float:
        """Wall time on a number of ranks."""
        shared = self.integration + self.output + self.handout
        models = self.models / min(ranks, max(self.bodies, 1))
        tail = 0.0 if ranks == 1 else 0.5 * self.last_block
        return models + shared / ranks + tail + self.layout


def scene_weight(scenes: Scenes, number: int) -> float:
    """Right-hand sides that one trajectory of a scene will take."""
    scene = scenes.scene(number)
    case, plan = scene.loaded.case, scene.plan
    assert case.time is not None
    k = case.body.aspect_ratio
    slenderness = max(k, 1.0 / k)
    gradient = scene.loaded.flow.gradient(plan.position)
    shear_times = max(1.0, float(plan.times[-1]) * float(np.linalg.norm(gradient)))
    local = max(case.time.tolerance / slenderness**2, 2e-15)
    steps = STEP_FACTOR[case.body.stokes_number > 0] * shear_times * local ** (-1.0 / 8.0)
    return STAGES * (steps + len(plan.times))


def weights(scenes: Scenes, most: int = 200) -> np.ndarray:
    """Right-hand sides per trajectory of every scene; those of a sample where there are many."""
    from qbxstokes.errors import QbxStokesError

    known = np.unique(np.linspace(0, scenes.size - 1, min(scenes.size, most)).astype(int))
    values = []
    for number in known.tolist():
        try:
            values.append(scene_weight(scenes, number))
        except QbxStokesError:  # told again, with its trajectories, when its turn comes
            values.append(1.0)
    return np.asarray(np.interp(np.arange(scenes.size), known, values))


def block_seconds(scenes: Scenes) -> np.ndarray:
    """Integration time of every block."""
    case, flow = scenes.loaded.case, scenes.loaded.flow
    inertial = case.body.stokes_number > 0
    if flow.degree is None or flow.degree > 3:
        seconds = GENERAL_RHS_SECONDS
    else:
        seconds = RHS_SECONDS[inertial][max(flow.degree - 1, 0)]
    calls = weights(scenes)[scenes.scene_of_block()]
    return np.asarray(calls * (scenes.block_sizes() * seconds + CALL_SECONDS))


def estimate(scenes: Scenes, row_bytes: int) -> Estimate:
    """Cost of the whole sweep."""
    sizes, per_block = scenes.block_sizes(), block_seconds(scenes)
    n = scenes.space.size
    output = n * (row_bytes * STORED_BYTE_SECONDS + scenes.samples * SAMPLE_SECONDS)
    bodies = len(scenes.bodies[1])
    held = 8 * scenes.samples * int(sizes.max()) * 60
    return Estimate(
        models=bodies * MODEL_SECONDS,
        bodies=bodies,
        integration=float(per_block.sum()),
        output=output,
        handout=scenes.blocks * HANDOUT_SECONDS,
        last_block=float(per_block.max()),
        layout=n * LAYOUT_SECONDS_PER_TRAJECTORY,
        memory=BASE_MEMORY + min(held, BLOCK_BYTES) + 24.0 * scenes.blocks,
    )
