"""Whether an implicit integrator that the program chose gets on, judged by its steps alone.

Never by the clock: a run that is resumed at a cut comes to the same judgement at the same step.

Two things hold such an integrator up. Its error estimate may be rounding, which no shorter step
lessens: many steps are rejected, and they shrink. Then the run starts afresh, with the sizes of its
state as it is by then, or with a larger local tolerance where those are not to blame. Or the motion
itself calls for steps so short that explicit ones would be stable. Those are taken once the steps
so far have cost as much as all that is left would cost with them: at most twice the better choice.

Explicit steps of bodies that come near each other or a wall are judged as well: drag grows there.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np

from qbxstokes.motion.forecast import STAGES
from qbxstokes.motion.layout import POSITION, RATES
from qbxstokes.petsc.system import RK_FORMULAS, System
from qbxstokes.petsc.trajectory import Checkpoint

# Steps between two looks; the first ones after a cut, of low order, are not judged.
WINDOW = 200
# Explicit steps between two looks at what has become stiff.
_LOOK = 10
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

    def __init__(self, system: System, start: Checkpoint, vector: Any) -> None:
        self._system, self._start, self._vector = system, start, vector
        explicit = system.chosen and system.method in RK_FORMULAS and not start.changed
        stiffening = system.equations.stiffness_at
        self._stiffness_at = stiffening if explicit else None
        self._judged = system.chosen and system.method == "bdf"
        # Unknown, and not small, where it grows on the way.
        self._stiffness = math.inf if stiffening else float(np.max(system.equations.stiffness))
        self._cost, self._next = system.equations.bdf_cost, start.steps + WINDOW
        self._before: tuple[float, int] | None = None

    @property
    def looks(self) -> bool:
        """Whether there is anything to judge."""
        return self._judged or self._stiffness_at is not None

    def held_up(self, t: float, steps: int, rejections: int) -> bool:
        """Whether the run is to be cut and `changed`, after a step to t.

        steps: of the whole run; rejections: since the cut.
        """
        if self._stiffness_at is not None:
            return self._stiffened(t, steps)
        if not self._judged or steps < self._next:
            return False
        self._next += WINDOW
        before, self._before = self._before, (t, rejections)
        if before is None:
            return False
        self._step = (t - before[0]) / WINDOW
        self._rounding = rejections - before[1] > _REJECTED
        return self._rounding or self._explicit(t, steps)

    def _stiffened(self, t: float, steps: int) -> bool:
        """Whether explicit steps, as many as stability takes, cost more than implicit ones."""
        if steps % _LOOK or self._stiffness_at is None:
            return False
        rate = self._stiffness_at(t, self._system.read(self._vector))
        left = STAGES * (self._system.end - t) * rate / _STABLE
        return left > self._system.guide.implicit

    def _explicit(self, t: float, steps: int) -> bool:
        if not self._step * self._stiffness < _STABLE * self._cost / STAGES:
            return False
        shortest = max(self._stiffness / _STABLE, 1.0 / (_LONGER * self._step))
        return self._cost * steps > STAGES * (self._system.end - t) * shortest

    def changed(self, at: Checkpoint) -> Checkpoint:
        """The cut from which a run goes on that is held up."""
        if self._stiffness_at is not None:
            return self._by(at, "bdf", f"drag outgrew explicit steps; bdf from t = {at.time:.6g}")
        if self._explicit(at.time, at.steps):
            told = f"bdf did not get on; explicit steps from t = {at.time:.6g}"
            return self._by(at, "8vr", told)
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
    def _by(at: Checkpoint, method: str, told: str) -> Checkpoint:
        """The cut with another method, of which all is to be thought of anew."""
        return replace(
            at, method=method, local_tolerance=0.0, reachable=0.0, expected=0.0, changed=told
        )

    @staticmethod
    def _size(at: Checkpoint) -> float:
        return float(max(np.linalg.norm(at.state[:, part]) for part in (POSITION, RATES)))
