"""Lanes that are integrated together, each until it ends: at the last instant, or at an edge."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from qbxstokes.motion.contacts import Contact
from qbxstokes.motion.layout import Step
from qbxstokes.simulation.watching import lane_contacts
from qbxstokes.typing import Array, Indices

if TYPE_CHECKING:
    from qbxstokes.petsc.trajectory import Checkpoint, Chunk, Trajectory
    from qbxstokes.simulation.assembly import Assembled


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
            from qbxstokes.simulation.brownian import go_at_random

            return go_at_random(self, on_cut, interrupted)
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
