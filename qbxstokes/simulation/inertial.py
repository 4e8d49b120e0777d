"""The stress of inertial particles on their attractors: means over a turn of their motions."""

from __future__ import annotations

from typing import Any

import numpy as np

from qbxstokes.errors import ConvergenceError, SceneError
from qbxstokes.flows import Flow
from qbxstokes.simulation.body import Body
from qbxstokes.simulation.simulation import Simulation
from qbxstokes.suspension.orbits import Starts
from qbxstokes.typing import Array

# Samples of a turn, doubled from the first to the last; axes that turn less than this are steady.
_FIRST, _LAST, _STILL = 512, 8192, 1e-9
# Whole turns that are followed after that, and changes that are those of the integration.
_TURNS, _ROUNDING = 3, 1e-9


def inertial_means(
    body: Body, flow: Flow, starts: Starts, rate: float, settling: float, tolerance: float
) -> dict[str, Any]:
    """Stress and order tensor over the last turn of each start, weighted.

    settling: strain that the body is given to come to its attractor. error_estimate: what is
    left to the attractor, as the changes from turn to turn tell, and to finer sampling. Raises
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
    """The means of one body over a turn after it has moved until `end`."""
    motion = scene.integrate([0.0, 0.85 * end, 0.9 * end, end])
    if np.abs(motion.axis[-3:-1] - motion.axis[-1]).max() <= _STILL:
        return {**_means(motion, slice(-1, None)), "error_estimate": 0.0}
    turns = _half_turns(motion)
    if len(turns) >= 3:
        # It goes on from there: no turn is sampled at the price of the way to it.
        then = Simulation(
            scene.body,
            scene.flow,
            position=motion.position[-1],
            orientation=motion.orientation[-1],
            velocity=motion.velocity[-1],
            angular_velocity=motion.angular_velocity[-1],
            tolerance=scene.tolerance,
        )
        turns = _half_turns(then.integrate([0.0, 1.5 * (turns[-1] - turns[-3]) * _TURNS]))
    if len(turns) <= 2 * _TURNS:
        raise ConvergenceError(
            "the body neither rests nor turns evenly within the strain of settling: raise settling"
        )
    samples = _FIRST
    while True:
        # Of the turns after the way there, the last one on all samples and on every other one.
        times = np.concatenate(
            [np.linspace(turns[n], turns[n + 2], samples, endpoint=False) for n in (0, 2, 4)]
        )
        found = then.integrate(np.concatenate([[0.0], times, turns[6:7]]))
        first, second, fine = (
            _means(found, slice(1 + n * samples, 1 + (n + 1) * samples)) for n in range(_TURNS)
        )
        coarse = _means(found, slice(1 + 2 * samples, 1 + 3 * samples, 2))
        change = _change(fine, coarse)
        left = _left(_change(second, first), _change(fine, second))
        if change <= 0.1 * max(tolerance, left) or samples >= _LAST:
            return {**fine, "error_estimate": change + left}
        samples *= 2


def _half_turns(motion: Any) -> Array:
    """Instants (n,) of the half turns of a motion."""
    return np.asarray(motion.events.get("half_turns", {}).get("time", np.zeros(0)))


def _left(former: float, latter: float) -> float:
    """What is left to an attractor of changes from turn to turn that fall as powers of a number."""
    if latter <= _ROUNDING:
        return latter
    if latter >= former:
        raise ConvergenceError(
            f"the stress changes more from turn to turn ({former:.1e}, then {latter:.1e}): the "
            f"body comes to no attractor yet; raise settling"
        )
    return latter / (1.0 - latter / former)


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
