"""The states inside a step.

A step from (t, y) to t + h is one application of the method's formula; the state at an
instant inside it is the same formula with a shorter step from the same (t, y), taken by a second
TS: as accurate as the steps, for the cost of one. PETSc's own interpolant serves where its order
suffices (`INTERPOLANT_SUFFICES`); it is linear for 8vr. Where more than `FEW` states are wanted of
one step, two are made so, at its thirds, and the rest follow from the polynomial of degree 7 that
has the states and rates of the ends and the thirds. With a radius of convergence r of the motion it
errs by 1.5e-4 (h/r)^8 at most, about what the step does: 30 right-hand sides, however many states.
"""

from typing import Any

import numpy as np

from qbxstokes.motion.layout import Step
from qbxstokes.petsc.system import System
from qbxstokes.typing import Array

# Formulas whose own interpolant is as good as the steps (measured, tests/test_stepper.py).
INTERPOLANT_SUFFICES = ("5dp", "bdf")
# States inside one step up to which each is made by the method's formula.
FEW = 2


class Inside:
    """States inside the last step of an integrator `ts` whose solution is `vector`."""

    def __init__(self, system: System, ts: Any, vector: Any) -> None:
        self._system, self._ts, self._vector = system, ts, vector
        self.scratch, self._slope = vector.duplicate(), vector.duplicate()
        self._sampler: Any = None
        self._polynomial: tuple[float, Array] | None = None

    def state_at(
        self, before: float, start: Array, after: float, t: float, many: bool = False
    ) -> Array:
        """State at t in [before, after], where `start` is the vector at `before`.

        many: whether so many states of this step are wanted that its polynomial is worth while.
        """
        if t == after:
            return self._system.read(self._vector)
        if self._system.method in INTERPOLANT_SUFFICES:
            self._ts.interpolate(t, self.scratch)
        elif many and (self._system.layout.columns == 1 or not self._system.explicit_in_c):
            return self._by_polynomial(before, start, after, np.array([t]))[0]
        else:
            self._substep(before, start, after, t)
        return self._system.read(self.scratch)

    def states_at(self, before: float, start: Array, after: float, times: Array) -> list[Array]:
        """States at all instants (n,) that are wanted of a step."""
        several = self._system.layout.columns > 1 and self._system.explicit_in_c
        if len(times) <= FEW or several or self._system.method in INTERPOLANT_SUFFICES:
            return [self.state_at(before, start, after, t) for t in times.tolist()]
        found = self._by_polynomial(before, start, after, times)
        return [*found[:-1], self._system.read(self._vector)] if times[-1] == after else found

    def _by_polynomial(self, before: float, start: Array, after: float, t: Array) -> list[Array]:
        """States at instants (n,) by the polynomial of the step."""
        if self._polynomial is None or self._polynomial[0] != before:
            self._polynomial = before, self._nodes(before, start, after)
        weights = _hermite((t - before) / (after - before), after - before)
        terms = weights[:, :, None] * self._polynomial[1]
        return list(self._system.states(np.add.reduce(terms, axis=1)))

    def _nodes(self, before: float, start: Array, after: float) -> Array:
        """States at the ends and the thirds of a step, then the rates there, (8, n)."""
        states, rates, slope = [], [], self._slope
        for node in THIRDS.tolist():
            t = before + node * (after - before)
            if node in (0.0, 1.0):
                self.scratch.setArray(start if node == 0.0 else self._vector.getArray(readonly=1))
            else:
                self._substep(before, start, after, t)
            if self._system.explicit_in_c:
                self._ts.computeRHSFunction(t, self.scratch, slope)
            else:
                self._system.rate(self._ts, t, self.scratch, slope)
            states.append(self.scratch.getArray(readonly=1).copy())
            rates.append(slope.getArray(readonly=1).copy())
        return np.array(states + rates)

    def _substep(self, before: float, start: Array, after: float, t: float) -> None:
        """The formula of the step, only as far as t, to the inner vector."""
        if self._sampler is None:
            self._sampler = self._system.integrator(self.scratch, adaptive=False)
        sampler = self._sampler
        self.scratch.setArray(start)
        sampler.setTime(before)
        sampler.setTimeStep(t - before)
        sampler.setMaxTime(2.0 * after - before)
        sampler.restartStep()
        sampler.step()

    def observed(self, before: float, start: Array, after: float) -> Step:
        """The last step, for an observer."""
        first, last = self._system.states(start), self._system.read(self._vector)

        asked = 0

        def state(t: float) -> Array:
            nonlocal asked
            asked += before < t < after
            return first if t <= before else self.state_at(before, start, after, t, asked > 1)

        costly = self._system.method not in INTERPOLANT_SUFFICES
        return Step(before, after, first, last, state, costly)


THIRDS = np.array([0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0])
_OWN = np.eye(4, dtype=bool)
_APART = THIRDS[:, None] - THIRDS + _OWN
_SLOPES = np.sum(1.0 / _APART, axis=1) - 1.0  # of each Lagrange polynomial at its own node


def _hermite(places: Array, step: float) -> Array:
    """Weights (n, 8) of states and rates at the thirds of a step for places within it, 0 to 1.

    Hermite's formula: (1 - 2 (x - x_i) l_i'(x_i)) l_i(x)^2 and (x - x_i) l_i(x)^2 with Lagrange's
    polynomials l_i (Abramowitz and Stegun 1964, eq. 25.2.5 for l_i).
    """
    away = places[:, None] - THIRDS
    factors = np.where(_OWN, 1.0, away[:, None, :]) / _APART
    squares = np.multiply.reduce(factors, axis=2) ** 2
    return np.concatenate([(1.0 - 2.0 * away * _SLOPES) * squares, step * away * squares], axis=1)
