"""Whether an implicit integrator that the program chose gets on, judged by its steps alone.

Never by the clock: a run that is resumed at a cut comes to the same judgement at the same step.

Two things hold such an integrator up. Its error estimate may be rounding, which no shorter step
lessens: many steps are rejected, and they shrink. Then the run starts afresh, with the sizes of its
state as it is by then, or with a larger local tolerance where those are not to blame. Or the motion
itself calls for steps so short that explicit ones would be stable. Those are taken once the steps
so far have cost as much as all that is left would cost with them: at most twice the better choice.
"""

from dataclasses import replace

import numpy as np

from qbxstokes.motion.forecast import STAGES
from qbxstokes.motion.layout import POSITION, RATES
from qbxstokes.petsc.system import System
from qbxstokes.petsc.trajectory import Checkpoint

# Steps between two looks; the first ones after a cut, of low order, are not judged.
WINDOW = 200
# Rejected steps of a window beyond which the error estimate is taken for rounding.
_REJECTED = 10
# Growth of the state since a cut from which its sizes then are to blame, and by how much the local
# tolerance grows where they are not.
_GROWTH = 1.5
_LOOSER = 10.0
# Rate of relaxation times step up to which explicit steps are stable and follow the flow, and how
# many times as long as those of BDF they are where accuracy alone matters.
_STABLE = 3.0
_LONGER = 15.0


class Pace:
    """Watches the steps since a cut."""

    def __init__(self, system: System, start: Checkpoint) -> None:
        self._system, self._start = system, start
        self._judged = system.chosen and system.method == "bdf"
        self._stiffness = float(np.max(system.equations.stiffness)) if self._judged else 0.0
        self._cost, self._next = system.equations.bdf_cost, start.steps + WINDOW
        self._before: tuple[float, int] | None = None

    def held_up(self, t: float, steps: int, rejections: int) -> bool:
        """Whether the run is to be cut and `changed`, after a step to t.

        steps: of the whole run; rejections: since the cut.
        """
        if not self._judged or steps < self._next:
            return False
        self._next += WINDOW
        before, self._before = self._before, (t, rejections)
        if before is None:
            return False
        self._step = (t - before[0]) / WINDOW
        self._rounding = rejections - before[1] > _REJECTED
        return self._rounding or self._explicit(t, steps)

    def _explicit(self, t: float, steps: int) -> bool:
        if not self._step * self._stiffness < _STABLE * self._cost / STAGES:
            return False
        shortest = max(self._stiffness / _STABLE, 1.0 / (_LONGER * self._step))
        return self._cost * steps > STAGES * (self._system.end - t) * shortest

    def changed(self, at: Checkpoint) -> Checkpoint:
        """The cut from which a run goes on that is held up."""
        if self._explicit(at.time, at.steps):
            told = f"bdf did not get on; explicit steps from t = {at.time:.6g}"
            return replace(
                at, method="8vr", local_tolerance=0.0, reachable=0.0, expected=0.0, changed=told
            )
        if self._size(at) > _GROWTH * self._size(self._start):
            return at
        told = f"rounding held bdf up; a larger local tolerance from t = {at.time:.6g}"
        return replace(
            at,
            local_tolerance=_LOOSER * at.local_tolerance,
            reachable=_LOOSER * at.reachable,
            changed=told,
        )

    @staticmethod
    def _size(at: Checkpoint) -> float:
        return float(max(np.linalg.norm(at.state[:, part]) for part in (POSITION, RATES)))
