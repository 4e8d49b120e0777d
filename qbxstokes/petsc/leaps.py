"""Steps that nobody looks at, one after the other in C.

Between two steps Python takes as long as PETSc takes for several. Where a run has to look at some
of its steps alone, at those with a sample, a cut, or a half-turn of the axis, a compiled function
calls TSStep up to the next of them. The steps are the same, to the last bit.
"""

from typing import Any, Self

import numpy as np
from petsc4py import PETSc

from qbxstokes.petsc.system import System

# Most steps of one leap: some milliseconds, in which no signal is heard.
_MOST = 1000


class Leaps:
    """Those of an integrator `ts` of a system, whose solution is `vector`.

    watch: what is to see the steps, None or one with a `passage` of the axis that alone matters.
    before, start: when the last step began, and from which vector; error: PETSc's, of that step;
    passed: whether it is to be seen.
    """

    def __init__(self, system: System, ts: Any, vector: Any, watch: Any) -> None:
        from qbxstokes.petsc.native_leaps import compiled_leap

        self._system, self._ts, self._run = system, ts, compiled_leap()
        self._handles, self.start = (ts.handle, vector.handle), np.empty(vector.size)
        self.before, self.error, self.passed = 0.0, None, True
        passage = getattr(watch, "passage", None)
        planes = np.zeros(6) if passage is None else np.array(passage.planes)
        self._look = system.place_of_q, 0.0 if passage is None else passage.stretch, planes

    @classmethod
    def of(cls, system: System, ts: Any, vector: Any, watch: Any) -> Self | None:
        """None where somebody looks at every step, or at its stages."""
        seldom = watch is None or getattr(watch, "seldom", False)
        return cls(system, ts, vector, watch) if seldom and system.leaps else None

    def take(self, t: float, until: float, last: int) -> bool:
        """Steps from t up to the first that ends at `until`, or step number `last`.

        False where none was taken, since it may meet what is not known yet of a flow.
        """
        edges, known = self._system.seen(t)
        if t + 1.001 * self._ts.getTimeStep() > known:
            return False
        most = max(1, min(last - self._ts.getStepNumber(), _MOST))
        until -= 1e-13 * abs(until)
        failed, self.before, self.passed = self._run(
            *self._handles, until, known, most, self.start, edges, *self._look
        )
        self.error = PETSc.Error(failed) if failed else None
        return True
