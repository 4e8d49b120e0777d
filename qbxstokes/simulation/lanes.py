"""Lanes that are integrated together, each until it ends: at the last instant, or at an edge.

With Brownian motion the flow carries them between random turns and displacements. A step is half of
these, the flow by the integrator, and the other half in the opposite order: weak order two
(`motion.random_turns`). Steps end at every sample.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from qbxstokes.errors import SceneError
from qbxstokes.geometry import rotation
from qbxstokes.motion.contacts import Contact
from qbxstokes.motion.layout import ORIENTATION, POSITION, Step
from qbxstokes.motion.random_turns import MOST_VARIANCE, kicks, philox, turned_axes, variance
from qbxstokes.petsc.trajectory import Checkpoint
from qbxstokes.simulation.watching import lane_contacts
from qbxstokes.typing import Array, Indices

if TYPE_CHECKING:
    from qbxstokes.petsc.trajectory import Chunk, Trajectory
    from qbxstokes.simulation.assembly import Assembled
    from qbxstokes.simulation.simulation import Simulation

# A Brownian step where nobody says, by the flow's gradient and by the diffusivity.
_BY_FLOW, _BY_DIFFUSION = 0.05, 0.025


@dataclass
class LaneRun:
    """The integration of n lanes at times (T,).

    Where one of them meets the edge of its flow, the others go on without it from that instant.
    states (T, n, n_state): the samples so far, NaN where a lane has ended. active: lanes that are
    under way. checkpoint: of these, None at the start. ended: contacts of the others. nearest:
    least gap below a body length that was seen.
    """

    assembled: Any  # Assembled; None until a run that is gone on with has it
    times: Array
    states: Array
    active: Indices
    checkpoint: Checkpoint | None = None
    ended: dict[int, Contact] = field(default_factory=dict)
    nearest: float = np.inf

    @classmethod
    def of(cls, assembled: Assembled, times: Array) -> LaneRun:
        """A run that has not begun."""
        n, n_state = assembled.initial.shape
        states = np.full((len(times), n, n_state), np.nan)
        return cls(assembled, times, states, np.arange(n))

    def go(
        self,
        on_cut: Callable[[], None] = lambda: None,
        interrupted: Callable[[], bool] | None = None,
        **cuts: int,
    ) -> Trajectory:
        """Integrate what is left; returns the last trajectory, which tells how it went.

        on_cut: called where the run could be resumed from what it holds. cuts: where that is, other
        than by the scene's own rule.
        """
        if self.assembled.parts[0].brownian is not None:
            return self._go_at_random(on_cut, interrupted)
        while True:
            whole = len(self.active) == self.states.shape[1]
            assembled = self.assembled if whole else self.assembled.some(self.active)
            contacts = lane_contacts(assembled.parts)
            found: list[Contact] = []

            def observe(step: Step, contacts: Any = contacts, found: Any = found) -> float | None:
                found += contacts(step)
                return found[0].t if found else None

            def receive(chunk: Chunk, found: Any = found) -> None:
                inside = np.isin(chunk.times, self.times)  # but for the instant of a contact
                rows = np.searchsorted(self.times, chunk.times[inside])
                self.states[rows[:, None], self.active] = chunk.states[inside]
                self.checkpoint = chunk.checkpoint
                if not found:
                    on_cut()

            trajectory = assembled.trajectory(
                self.times,
                self.checkpoint,
                on_chunk=receive,
                interrupted=interrupted,
                observe=None if contacts is None else observe,
                **cuts,
            )
            if contacts is not None:
                least = [gap for gap, _ in contacts.nearest.values()]
                self.nearest = min([self.nearest, *least])
            if not found or trajectory.failure or trajectory.refusal or not trajectory.finished:
                return trajectory
            self._leave(found)
            if not len(self.active):
                return trajectory

    def _go_at_random(
        self, on_cut: Callable[[], None], interrupted: Callable[[], bool] | None
    ) -> Trajectory:
        """`go` with Brownian motion: it is cut at the samples."""
        assembled, times, noise = self.assembled, self.times, _Noise(self.assembled)
        starts = np.concatenate([[0.0], times[:-1]])
        step = min(map(step_of, assembled.parts))
        counts = np.ceil((times - starts) / step * (1.0 - 1e-12)).astype(int)
        number = int(counts[: self.checkpoint.next_sample].sum()) if self.checkpoint else 0
        held = self.checkpoint or Checkpoint(0.0, assembled.initial)
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
            self.states[index] = state
            held = self.checkpoint = replace(
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

    def _leave(self, found: list[Contact]) -> None:
        """Go on without the lanes that have met an edge at the first of these instants."""
        assert self.checkpoint is not None
        t, held = found[0].t, self.checkpoint
        gone = [contact for contact in found if contact.t <= t]
        for contact in gone:
            lane = int(self.active[contact.lane])
            self.ended[lane] = replace(contact, lane=lane)
        stay = np.ones(len(self.active), dtype=bool)
        stay[[contact.lane for contact in gone]] = False
        self.active = self.active[stay]
        self.checkpoint = replace(
            held, state=held.state[stay], next_sample=int(np.searchsorted(self.times, t, "right"))
        )

    def samples(self, wanted: Sequence[str]) -> dict[str, Array]:
        """The wanted quantities (T, n, ...), NaN where a lane has ended."""
        states, counts = self.states.copy(), {}
        for lane, contact in self.ended.items():
            counts[lane] = int(np.searchsorted(self.times, contact.t, "right"))
            states[counts[lane] :, lane] = contact.state
        found = self.assembled.observe(self.times, states, wanted)
        for values in found.values():
            for lane, count in counts.items():
                values[count:, lane] = np.nan
        return found


# -- Brownian motion -----------------------------------------------------------------------------


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
        moved = turned_axes(
            p, variance(self.diffusivity, 0.5 * length), u[:, 2:] if later else u[:, :2]
        )
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
