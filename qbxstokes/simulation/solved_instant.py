"""What a solved instant of several bodies holds: their motion, loads and exterior flows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from qbxstokes.bie.multiple_scattering import Coupled
from qbxstokes.typing import Array


@dataclass
class Solution:
    """One solved instant: each body's exterior flow, motion and load, and what the solver did.

    velocity, angular_velocity, force, torque (N, 3), space frame; force and torque are exerted by
    the bodies ON the fluid. took: iterations of GMRES, and the relative residual they left.
    """

    problem: Coupled
    flows: list[Any]
    velocity: Array
    angular_velocity: Array
    force: Array
    torque: Array
    took: tuple[int, float]
    unknowns: Array = field(repr=False)
    _again: Callable[[list[int]], Solution] = field(repr=False)

    @property
    def nodes(self) -> list[int]:
        """Polar nodes of each body's grid."""
        return list(self.problem.nodes)

    @property
    def iterations(self) -> int:
        """Iterations of GMRES."""
        return self.took[0]

    @property
    def stresslet(self) -> Array:
        """Stresslets (N, 3, 3), space frame, of the tractions on the bodies about their centres."""
        return np.stack([self.problem.stresslet(b, flow) for b, flow in enumerate(self.flows)])

    @cached_property
    def coarser(self) -> Solution:
        """The same with two polar nodes less and everything else ten times looser."""
        return self._again(self.problem.coarser)

    @cached_property
    def error_estimate(self) -> dict[str, float]:
        """Estimated largest errors of velocity, angular_velocity, force, torque and stresslet.

        Absolute, by what is `coarser` (`bie.multiple_scattering.estimated`); given parts of the
        motion or loads have none.
        """
        problem, coarse = self.problem, self.coarser
        arm = max(body.size * body.shape.radius for body in problem.bodies)
        # Powers of the arm by which quantities of a kind are of one size: moments and forces.
        kinds: tuple[dict[str, int], ...] = (
            {"velocity": 0, "angular_velocity": 1},
            {"force": 1, "torque": 0, "stresslet": 0},
        )
        found = {}
        for kind in kinds:
            whole = {name: np.abs(getattr(self, name)).max() * arm**p for name, p in kind.items()}
            for name, power in kind.items():
                size = max(whole.values()) / arm**power
                pair = getattr(self, name), getattr(coarse, name)
                found[name] = problem.estimated(*pair, float(size))
        return found
