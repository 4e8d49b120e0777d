"""One block of a sweep: start states, integration, quantities and summaries of its trajectories."""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qbxstokes.bie.functional import BodyModel
from qbxstokes.case.sweep import Key
from qbxstokes.errors import ConvergenceError, FlowError
from qbxstokes.flows.check import check_singularities
from qbxstokes.geometry import rotation
from qbxstokes.motion.averages import turn_averages
from qbxstokes.motion.equations import RigidBodyEquations
from qbxstokes.petsc.stepper import integrate
from qbxstokes.petsc.trajectory import Trajectory
from qbxstokes.runs.columns import SUMMARY
from qbxstokes.runs.plan import orbit_axis, start_quaternion
from qbxstokes.runs.quantities import BASIC, quantities, shape_of
from qbxstokes.runs.scenes import STOKES, Scene
from qbxstokes.simulation.loads import loads_and_constraints

Array = NDArray[np.float64]


@dataclass
class BlockResult:
    """Summaries (n,) by column, quantities (n, T, ...), failures, and what it cost."""

    summary: dict[str, Array]
    quantities: dict[str, Array]
    times: Array
    failed: dict[int, str] = field(default_factory=dict)
    steps: int = 0
    evaluations: int = 0


@dataclass(frozen=True)
class Starts:
    """Start of every trajectory of a block, arrays (n, ...); velocities None: with the flow."""

    stokes_number: Array
    position: Array
    quaternion: Array
    velocity: Array | None
    angular_velocity: Array | None

    def __len__(self) -> int:
        """Number of trajectories."""
        return len(self.stokes_number)

    def at(self, chosen: Any) -> Starts:
        """Those of some of the trajectories."""
        parts = (self.stokes_number, self.position, self.quaternion)
        moving = (self.velocity, self.angular_velocity)
        return Starts(
            *(part[chosen] for part in parts),
            *(None if part is None else part[chosen] for part in moving),
        )


def starts_of(scene: Scene, values: Mapping[Key, Any], n: int) -> Starts:
    """Where the n trajectories start, from the scene's case and the swept values."""
    case = scene.loaded.case

    def vectors(name: str) -> Array | None:
        base = getattr(case.start, name)
        key: Key = ("start", name)
        moving = [k for k in values if k[:2] == key]
        if base == "with_flow" and not moving:
            return None
        taken = np.empty((n, 3))
        taken[:] = 0.0 if base == "with_flow" else base
        for k in moving:
            if len(k) == 2:
                taken[:] = values[k]
            else:
                taken[:, k[2]] = values[k]
        return taken

    position = vectors("position")
    assert position is not None
    stokes = np.broadcast_to(values.get(STOKES, case.body.stokes_number), (n,))
    return Starts(
        np.array(stokes, dtype=np.float64),
        position,
        _quaternions(scene, values, n),
        vectors("velocity"),
        vectors("angular_velocity"),
    )


def _quaternions(scene: Scene, values: Mapping[Key, Any], n: int) -> Array:
    """Start orientations (n, 4)."""
    case = scene.loaded.case
    swept = {k[2:]: v for k, v in values.items() if k[:2] == ("start", "orientation")}
    if not swept:
        return np.tile(start_quaternion(case), (n, 1))
    if () in swept:  # random axes or rotations
        random = swept[()]
        return rotation.from_axis(random) if random.shape[1] == 3 else random
    form = str(next(iter(swept))[0])
    base = getattr(case.start.orientation, form)
    if form in ("axis", "quaternion"):
        vectors = np.empty((n, len(base)))
        vectors[:] = base
        for key, value in swept.items():
            if len(key) == 1:
                vectors[:] = value
            else:
                vectors[:, key[1]] = value
        return rotation.from_axis(vectors) if form == "axis" else rotation.normalize(vectors)
    names = ("phi", "theta", "psi") if form == "euler" else ("constant", "phase")
    parts = [np.broadcast_to(swept.get((form, name), getattr(base, name)), (n,)) for name in names]
    if form == "euler":
        return rotation.from_euler(*parts)
    return rotation.from_axis(orbit_axis(case.body.aspect_ratio, *parts))


def compute_block(
    scene: Scene,
    model: BodyModel,
    provider: Any,
    starts: Starts,
    fields: tuple[str, ...],
    discard: float,
    poke: Callable[[], bool],
) -> BlockResult:
    """Integrate the trajectories and summarise them; those that fail are told and left out.

    A block that cannot be integrated is halved until what fails stands alone.
    """
    n = len(starts)
    times = scene.plan.times
    result = BlockResult(
        {name: np.full(n, np.nan) for name in SUMMARY},
        {name: np.full((n, len(times), *shape_of(name)), np.nan) for name in fields},
        times,
    )
    sound = _sound(scene, starts, result)
    _compute(scene, model, provider, starts, sound, discard, poke, result)
    return result


def _sound(scene: Scene, starts: Starts, result: BlockResult) -> NDArray[np.intp]:
    """Those that may start: not in a singularity of the flow."""
    everyone = np.arange(len(starts))
    flow = scene.loaded.flow
    if not len(flow.singular_points):
        return everyone
    k, axes = scene.loaded.case.body.aspect_ratio, rotation.axis(starts.quaternion)
    for i in everyone:
        try:
            check_singularities(flow, starts.position[i], axes[i], k)
        except FlowError as error:
            result.failed[int(i)] = str(error)
    return np.array([i for i in everyone if i not in result.failed], dtype=np.intp)


def _compute(
    scene: Scene,
    model: BodyModel,
    provider: Any,
    starts: Starts,
    chosen: NDArray[np.intp],
    discard: float,
    poke: Callable[[], bool],
    result: BlockResult,
) -> None:
    """Fill the results of the chosen trajectories, halving on failure."""
    if not len(chosen):
        return
    begin = clock.perf_counter()
    case = scene.loaded.case
    assert case.time is not None
    some = starts.at(chosen)
    try:
        loads, constraints = loads_and_constraints(scene.loaded, float(result.times[-1]))
        equations = RigidBodyEquations(
            model,
            provider,
            some.stokes_number,
            len(chosen),
            loads,
            constraints,
            evaluation="compiled",  # a sweep repays the import, however small its blocks
            inertia=case.body.inertia,
        )
        initial = equations.initial_state(
            some.position, some.quaternion, some.velocity, some.angular_velocity
        )
        trajectory = integrate(
            equations,
            initial,
            result.times,
            case.time.tolerance,
            chunk_samples=len(result.times) + 1,
            interrupted=poke,
            longest_step=None if equations.steady else float(result.times[-1]) / 50.0,
        )
        if trajectory.refusal or trajectory.failure:
            raise ConvergenceError(trajectory.refusal or trajectory.failure)
        if not np.isfinite(trajectory.states).all():
            raise ConvergenceError("the state is not finite")
    except (ConvergenceError, FlowError, ArithmeticError) as error:
        if len(chosen) == 1:
            result.failed[int(chosen[0])] = " ".join(str(error).split())
            return
        half = len(chosen) // 2
        for part in (chosen[:half], chosen[half:]):
            _compute(scene, model, provider, starts, part, discard, poke, result)
        return
    result.steps += trajectory.steps * len(chosen)
    result.evaluations += trajectory.evaluations * len(chosen)
    _summarise(scene, equations, trajectory, chosen, discard, result)
    result.summary["wall_time"][chosen] = (clock.perf_counter() - begin) / len(chosen)


def _summarise(
    scene: Scene,
    equations: RigidBodyEquations,
    trajectory: Trajectory,
    chosen: NDArray[np.intp],
    discard: float,
    result: BlockResult,
) -> None:
    """Quantities, averages and final states of an integrated block."""
    case, plan = scene.loaded.case, scene.plan
    steady = scene.loaded.flow.steady
    wanted = {*BASIC, *result.quantities}
    frame = plan.frame
    samples = quantities(equations, result.times, trajectory.states, steady, wanted, frame.shear)
    for name, array in result.quantities.items():
        array[chosen] = samples[name].swapaxes(0, 1)
    table = result.summary
    averages = turn_averages(result.times, samples, case.body.aspect_ratio, frame, discard)
    for name in ("mean_velocity", "velocity_change"):
        averages |= {f"{name}_{i + 1}": averages[name][:, i] for i in range(3)}
        del averages[name]
    for name, values in averages.items():
        table[name][chosen] = values
    final = {
        "position": samples["position"][-1],
        "velocity": samples["velocity"][-1],
        "angular_velocity": samples["angular_velocity"][-1],
    }
    for name, vectors in final.items():
        for i in range(3):
            table[f"final_{name}_{i + 1}"][chosen] = vectors[:, i]
    last = rotation.normalize(trajectory.states[-1, :, 3:7])
    for i in range(4):
        table[f"final_orientation_{i}"][chosen] = last[:, i]
    assert case.time is not None
    horizon = float(result.times[-1])
    rate = float(np.linalg.norm(scene.loaded.flow.gradient(plan.position)))
    slenderness = max(case.body.aspect_ratio, 1.0 / case.body.aspect_ratio)
    model_error = equations.model.error_estimate * rate * horizon * slenderness
    table["error_estimate"][chosen] = case.time.tolerance + model_error
    table["jeffery_period"][chosen] = np.nan if plan.period is None else plan.period
    table["end"][chosen] = horizon
    table["steps"][chosen] = trajectory.steps
    table["rhs_evaluations"][chosen] = trajectory.evaluations
