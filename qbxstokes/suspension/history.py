"""The history of a homogeneous flow: steady, from rest, stopped, or back and forth."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from qbxstokes.typing import Array

Protocol = Literal["steady", "startup", "cessation", "oscillation"]
PROTOCOLS = ("steady", "startup", "cessation", "oscillation")


@dataclass(frozen=True)
class History:
    """Rate and strain over time, by the flow's rate.

    instants: (T,), at which something is asked for; None of a steady state. cycle: angular
    frequency w over the rate of an oscillation, whose rate is cos(w t).
    """

    protocol: Protocol
    instants: Array | None = None
    cycle: float | None = None

    def rate(self, t: float) -> float:
        """Of the flow at a time t >= 0, over its own."""
        if self.cycle is not None:
            return math.cos(self.cycle * t)
        return 0.0 if self.protocol == "cessation" else 1.0

    def strain(self, times: Array) -> Array:
        """Strain (n,) since time 0; a flow that is stopped then has gone on before."""
        if self.cycle is not None:
            return np.asarray(np.sin(self.cycle * times) / self.cycle)
        return np.asarray(np.minimum(times, 0.0) if self.protocol == "cessation" else times)

    @property
    def rates(self) -> Array:
        """Rates (T,) at the instants; () of a steady state."""
        if self.instants is None:
            return np.ones(())
        return np.array([self.rate(t) for t in self.instants.tolist()])

    def lead(self, shortest: float) -> float:
        """Time before 0 that the orientations are given, whole cycles of an oscillation."""
        if self.protocol == "startup":
            return 0.0
        if self.cycle is None:
            return shortest
        period = 2.0 * math.pi / self.cycle
        return period * math.ceil(shortest / period)
