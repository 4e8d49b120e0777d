"""Brownian motion of lanes in any flow: random turns and displacements between stretches of it.

A step is half of a random turn and displacement, the flow by the integrator, and the other half in
the opposite order: weak order two (`motion.random_turns`). Steps end at every sample.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from qbxstokes.errors import SceneError
from qbxstokes.geometry import rotation
from qbxstokes.motion.layout import ORIENTATION, POSITION
from qbxstokes.motion.random_turns import MOST_VARIANCE, philox, variance
from qbxstokes.suspension.langevin import kicks, turned
from qbxstokes.typing import Array

if TYPE_CHECKING:
    from qbxstokes.simulation.assembly import Assembled
    from qbxstokes.simulation.lanes import LaneRun
    from qbxstokes.simulation.simulation import Simulation

# A step where nobody says, by the flow's gradient and by the diffusivity.
_BY_FLOW, _BY_DIFFUSION = 0.05, 0.025


def check_brownian(scene: Simulation) -> None:
    """Raise SceneError for scenes whose bodies cannot be turned and displaced at random."""
    right = "none of it with brownian"
    flow, given = scene.flow, scene.brownian
    assert given is not None
    if not scene.massless:
        raise SceneError("stokes_number", "is not 0", "0 with brownian")
    if scene.constraints is not None:
        raise SceneError("constraints", "are given", right)
    if flow.domain or len(flow.singular_points):
        raise SceneError("flow", "has an edge or a singular point", "one without, with brownian")
    longest = MOST_VARIANCE / (2.0 * given.rotary_diffusivity)
    if given.step is not None and given.step > longest:
        raise SceneError("brownian.step", f"is {given.step:g}", f"at most {longest:.3g}")


def step_of(scene: Simulation) -> float:
    """Longest step of a scene."""
    given = scene.brownian
    assert given is not None
    if given.step is not None:
        return given.step
    gradients = np.asarray(scene.flow.gradient(scene.position))
    rate = float(np.linalg.norm(gradients.reshape(-1, 9), axis=1).max())
    by_flow = _BY_FLOW / rate if rate else np.inf
    return min(by_flow, _BY_DIFFUSION / given.rotary_diffusivity)


class _Noise:
    """Random halves of the steps of all lanes; each lane by its trajectory's number."""

    def __init__(self, assembled: Assembled) -> None:
        parts, counts = assembled.parts, [len(part) for part in assembled.parts]
        given: list[Any] = [part.brownian for part in parts]
        self.seed, self.displaced = given[0].seed, given[0].translation
        self.numbers = np.concatenate([part.numbers for part in parts])
        self.diffusivity = np.repeat([g.rotary_diffusivity for g in given], counts)
        resistances = [formed.model.resistance for formed in assembled.hydrodynamics]
        ratios = [
            [r.rotation_transverse / r.translation_transverse for r in resistances],
            [r.rotation_transverse / r.translation_axial for r in resistances],
        ]
        self.spread = np.repeat(ratios, counts, axis=1) * self.diffusivity

    def half(self, state: Array, length: float, step: int, later: bool) -> Array:
        """States (n, 7) after half of a random step of this length."""
        state, q = state.copy(), rotation.normalize(state[:, ORIENTATION])
        p = rotation.axis(q)
        u = self._uniform(step, 0)
        moved = turned(p, variance(self.diffusivity, 0.5 * length), u[:, 2:] if later else u[:, :2])
        if self.displaced:
            sizes = np.sqrt(self.spread * length)[..., None]
            state[:, POSITION] += kicks(
                p if later else moved, sizes, self._uniform(step, 1 + later)
            )
        # The shortest turn of one axis to the other.
        turn = np.column_stack([1.0 + np.sum(p * moved, axis=1), np.cross(p, moved)])
        state[:, ORIENTATION] = rotation.normalize(rotation.multiply(rotation.normalize(turn), q))
        return state

    def _uniform(self, step: int, word: int) -> Array:
        raw = np.stack(philox(self.seed, self.numbers, step, word), axis=1)
        return (raw.astype(np.float64) + 1.0) * 2.0**-32


def go_at_random(
    run: LaneRun, on_cut: Callable[[], None], interrupted: Callable[[], bool] | None
) -> Any:
    """`LaneRun.go` with Brownian motion: it is cut at the samples."""
    from qbxstokes.petsc.trajectory import Checkpoint

    assembled, times, noise = run.assembled, run.times, _Noise(run.assembled)
    starts = np.concatenate([[0.0], times[:-1]])
    step = min(map(step_of, assembled.parts))
    counts = np.ceil((times - starts) / step * (1.0 - 1e-12)).astype(int)
    number = int(counts[: run.checkpoint.next_sample].sum()) if run.checkpoint else 0
    held = run.checkpoint or Checkpoint(0.0, assembled.initial)
    trajectory: Any = None
    for index in range(held.next_sample, len(times)):
        edges = np.linspace(starts[index], times[index], counts[index] + 1)
        state, done = held.state, [held.steps, held.evaluations]
        record = held
        for begin, end in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
            state = noise.half(state, end - begin, number, False)
            trajectory = assembled.trajectory(
                np.array([end]), Checkpoint(begin, state, end - begin), interrupted=interrupted
            )
            if trajectory.failure or trajectory.refusal or not trajectory.finished:
                return trajectory
            record = trajectory.checkpoint
            state = noise.half(record.state, end - begin, number, True)
            done = [done[0] + record.steps, done[1] + record.evaluations]
            number += 1
        run.states[index] = state
        held = run.checkpoint = replace(
            record,
            time=float(times[index]),
            state=state,
            next_sample=index + 1,
            steps=done[0],
            evaluations=done[1],
        )
        on_cut()
    if trajectory is None:  # the only sample is the start
        trajectory = assembled.trajectory(times, held)
    return replace(trajectory, checkpoint=held)
