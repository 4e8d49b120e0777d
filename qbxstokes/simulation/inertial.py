"""The stress of inertial particles on their attractors: means over a turn of their motions."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from qbxstokes.errors import ConvergenceError, SceneError
from qbxstokes.flows import Flow
from qbxstokes.simulation.simulation import Simulation
from qbxstokes.suspension.orbits import Starts

if TYPE_CHECKING:
    from qbxstokes.simulation.body import Body

Array = NDArray[np.float64]

# Samples of a turn, doubled from the first to the last; axes that turn less than this are steady.
_FIRST, _LAST, _STILL = 256, 4096, 1e-9


def inertial_means(
    body: Body, flow: Flow, starts: Starts, rate: float, settling: float, tolerance: float
) -> dict[str, Any]:
    """Stress and order tensor over the last turn of each start, weighted.

    settling: strain that the body is given to come to its attractor. error_estimate: the largest
    relative change of the stress from the last turn but one, or under finer sampling. Raises
    SceneError for isotropic starts, of which none is a motion.
    """
    if starts.axes is None:
        right = "axes: inertial bodies are followed one by one, such as [[1, 0, 0], [0, 0, 1]]"
        raise SceneError("orientations", "are isotropic", right)
    total: dict[str, Any] = {}
    for axis, weight in zip(starts.axes, starts.share, strict=True):
        scene = Simulation(body, flow, orientation=axis, tolerance=min(1e-9, 0.01 * tolerance))
        one = _last_turn(scene, settling / rate, tolerance)
        for name, value in one.items():
            if name == "error_estimate":
                total[name] = max(total.get(name, 0.0), value)
            else:
                total[name] = total.get(name, 0.0) + weight * value
    return total


def _last_turn(scene: Simulation, end: float, tolerance: float) -> dict[str, Any]:
    """The means of one body that moves until `end`."""
    motion = scene.integrate([0.0, 0.9 * end, end])
    turns = motion.events.get("half_turns", {}).get("time", np.zeros(0))
    if len(turns) < 5:
        if np.abs(motion.axis[-1] - motion.axis[-2]).max() > _STILL:
            raise ConvergenceError(
                f"the body neither rests nor turns twice within the strain of settling; it made "
                f"{len(turns)} half turns: raise settling"
            )
        return {**_means(motion, slice(-1, None)), "error_estimate": 0.0}
    latest, before = turns[-3:][[0, 2]], turns[-5:][[0, 2]]
    samples, coarse = _FIRST, _of_turn(scene, latest, _FIRST)
    while True:
        samples *= 2
        fine = _of_turn(scene, latest, samples)
        change = _change(fine, coarse)
        if change <= 0.1 * tolerance or samples >= _LAST:
            break
        coarse = fine
    return {**fine, "error_estimate": change + _change(fine, _of_turn(scene, before, samples))}


def _of_turn(scene: Simulation, ends: Array, samples: int) -> dict[str, Array]:
    """Means over equal steps of the turn between two instants."""
    times = np.linspace(ends[0], ends[1], samples + 1)
    return _means(scene.integrate(np.concatenate([[0.0], times])), slice(1, -1))


def _means(motion: Any, chosen: slice) -> dict[str, Array]:
    inertial = (motion.acceleration_stress + motion.reynolds_stress)[chosen].mean(axis=0)
    whole = motion.particle_stress[chosen].mean(axis=0)
    axis = motion.axis[chosen]
    return {
        "hydrodynamic_stress": whole - inertial,
        "inertial_stress": inertial,
        "order_tensor": np.einsum("ti,tj->ij", axis, axis) / len(axis),
    }


def _change(one: dict[str, Array], other: dict[str, Array]) -> float:
    a, b = (part["hydrodynamic_stress"] + part["inertial_stress"] for part in (one, other))
    return float(np.max(np.abs(a - b)) / np.max(np.abs(a)))
