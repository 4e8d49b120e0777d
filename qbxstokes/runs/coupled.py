"""Several bodies, or one by a wall: `task: body`, on any number of ranks.

The bodies are dealt to the ranks (`petsc.coupled`), which all go through the same solves; rank 0
alone writes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from qbxstokes.errors import QbxStokesError
from qbxstokes.geometry import rotation
from qbxstokes.geometry.symmetric import components
from qbxstokes.quantities import COUPLED
from qbxstokes.runs.parallel import agree, on_root
from qbxstokes.simulation.coupled import CoupledSimulation
from qbxstokes.simulation.from_bodies import coupled_of
from qbxstokes.simulation.from_case import pointed

if TYPE_CHECKING:
    from qbxstokes.runs.command import Job

Array = NDArray[np.float64]


def run_coupled(job: Job) -> dict[str, Any]:
    """Resistance and, where a flow or loads drive them, motion of the bodies; the summary."""
    loaded, comm = job.loaded, job.comm
    from qbxstokes.petsc.coupled import over

    failure: QbxStokesError | None = None
    arrays: dict[str, Array] = {}
    summary: dict[str, Any] = {}
    try:
        with job.clock.part("bodies"), pointed(loaded):
            arrays, summary = computed(coupled_of(loaded, over(comm)))
    except QbxStokesError as error:
        failure = error
    agree(comm, failure)

    return on_root(comm, lambda: {**arrays, **job.write(summary, arrays, COUPLED)})


def computed(scene: CoupledSimulation) -> tuple[dict[str, Array], dict[str, Any]]:
    """What bodies do at the start: arrays by name, and what is told of them."""
    suspension, x, q = scene.suspension, scene.position, scene.quaternion
    resistance, error = suspension.resistance_and_error(x, q)
    arrays = {
        "position": x,
        "axis": rotation.axis(q),
        "resistance": resistance,
        "mobility": np.linalg.inv(resistance),
    }
    errors = {"resistance": error}
    gap, who = scene.closest(scene.places)
    summary: dict[str, Any] = {"gap": gap, "nearest": who}
    free = scene.solved("free", 0.0, x, q)
    if any(part is not None for part in (scene.flow, scene.loads, scene.repulsion)):
        arrays |= {"free_velocity": free.velocity, "free_angular_velocity": free.angular_velocity}
        arrays["stresslet"] = components(free.stresslet)
        names = {"velocity": "free_velocity", "angular_velocity": "free_angular_velocity"}
        told = free.error_estimate
        errors |= {names.get(n, n): told[n] for n in (*names, "stresslet")}
    if scene.flow is not None:
        held = suspension.held(scene.flow, x, q)
        arrays |= {"held_force": -held.force, "held_torque": -held.torque}
        errors |= {f"held_{name}": held.error_estimate[name] for name in ("force", "torque")}
    if not scene.several:
        one = ("resistance", "mobility")
        arrays = {name: a if name in one else a[0] for name, a in arrays.items()}
    summary |= {
        "nodes": free.nodes,
        "iterations": free.iterations,
        "error_estimates": errors,
    }
    return arrays, summary
