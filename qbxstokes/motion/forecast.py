"""What can be told of an integration before it starts: method, local tolerance, number of steps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from qbxstokes.motion.equations import RigidBodyEquations

Array = NDArray[np.float64]

# Smallest local tolerance: below it the error estimate is rounding, which the differences of high
# order that BDF takes of its steps make larger: there it would cut its steps without end.
FLOOR = 2e-15
_FLOORS = {"bdf": 2e-14}
EXPLICIT_TYPES = ("rk",)
# Error of a step over the share of the tolerance that falls to it: (factor share)^power.
_LOCAL = {"bdf": (0.5, 7.0 / 6.0), "arkimex": (0.1, 1.0)}
# The error at the end is held to this many times the tolerance, at how many times the cost.
WITHIN = 20.0
AFFORDED = 30.0
# Local tolerance above which 5dp takes fewer right-hand sides than 8vr.
LOOSE = 1e-6
# Right-hand sides of a step of 8vr, and those that take as long as a step of arkimex.
STAGES = 13
_COSTS = {"rk": STAGES, "arkimex": 25 * STAGES}
# Steps that BDF takes at least to reach its highest order.
_START = 150
# Steps of an implicit formula of one step after a break.
_FRESH = 16


def floor_of(kind: str) -> float:
    """Smallest local tolerance of a type of integrator."""
    return _FLOORS.get(kind, FLOOR)


class Forecast:
    """What can be told of a run before it starts: local tolerance, method, and how long it is.

    The constants were measured in shear flow, k from 1/50 to 50, St from 1e-6 to 10.
    """

    def __init__(
        self,
        equations: RigidBodyEquations,
        t: float,
        state: Array,
        end: float,
        tolerance: float,
        breaks: int = 0,
    ) -> None:
        """state (n_lanes, n_state) at t; tolerance: error accepted at the end.

        breaks: instants at which the steps begin afresh.
        """
        self._breaks, self._bdf_cost = breaks, equations.bdf_cost
        self._noise = equations.noise
        self._sensitivity = equations.sensitivity(t, state, end - t)
        self._asked = tolerance
        self._span = (end - t) * float(np.max(equations.mean_rate(t, state, end - t)))
        self._stiff_span = (end - t) * float(np.max(equations.stiffness))

    def tolerance(self, kind: str) -> float:
        """Error of a step that leads to the tolerance at the end.

        BDF controls the order that it propagates: its global error goes as the local tolerance to
        the power 6/7. With the factors here the error after ten periods was 0.04 to 3 times the
        one asked for.
        """
        share = self._asked / self._sensitivity
        factor, power = _LOCAL.get(kind, (1.0, 1.0))
        least = floor_of(kind) if kind in EXPLICIT_TYPES else max(floor_of(kind), self._noise)
        return max(float((factor * share) ** power), least)

    def reachable(self, kind: str) -> float:
        """The tolerance that leads to the smallest error of a step, that of rounding.

        Rounding adds up to as much: 0.1 to 3 times this after ten periods, k from 1/50 to 50.
        """
        factor, power = _LOCAL.get(kind, (1.0, 1.0))
        return self._sensitivity * float(floor_of(kind) ** (1.0 / power)) / factor

    def steps(self, kind: str) -> float:
        """Steps that accuracy needs and, for an explicit formula, the relaxation.

        There 8vr is stable for rate times h up to 4.8, but the error it makes in following the
        flow with a lag of 1/rate keeps it below that.
        """
        tolerance = self.tolerance(kind)
        accurate = float(self._span * tolerance ** (-1.0 / 8.0))
        if kind not in EXPLICIT_TYPES:
            fresh = 0 if kind == "bdf" else _FRESH * self._breaks
            return 1.6 * accurate + fresh
        lag = self._stiff_span / self._span if self._span > 0.0 else 0.0
        lag *= max(tolerance, min(tolerance * lag, self._asked))  # as accepted of velocities
        reach = min(4.8, float(12.0 * lag ** (1.0 / 8.0)))
        return max(0.11 * accurate, self._stiff_span / reach if reach > 0.0 else 0.0)

    def evaluations(self, kind: str) -> float:
        """Right-hand sides, with each Jacobian counted as so many."""
        return self.steps(kind) * _COSTS.get(kind, self._bdf_cost)

    @property
    def implicit(self) -> float:
        """Right-hand sides of BDF, its start included."""
        return self.evaluations("bdf") + _START * self._bdf_cost

    @property
    def method(self) -> str:
        """The cheapest method: BDF where stability alone would set an explicit step.

        Its rounding is larger: where that would miss the tolerance, the explicit step is taken as
        long as it can be afforded.
        """
        missed = self.reachable("bdf") > WITHIN * self._asked >= self.reachable("rk")
        share = AFFORDED if missed else 1.0
        if share * self.implicit < self.evaluations("rk"):
            if self._breaks * _START < self.steps("bdf"):
                return "bdf"
            # It would not get beyond its low orders.
            single = self.evaluations("arkimex")
            return "8vr" if self.evaluations("rk") < single else "arkimex"
        return "5dp" if self.tolerance("rk") > LOOSE else "8vr"
