"""What a solved instant of several bodies holds: their motion, loads and exterior flows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qbxstokes.bie.coupling import Coupled
from qbxstokes.flows import Flow

Array = NDArray[np.float64]


@dataclass
class Solution:
    """One solved instant: each body's exterior flow, motion and load, and what the solver did.

    velocity, angular_velocity, force, torque (N, 3), space frame; force and torque are exerted by
    the bodies ON the fluid. iterations of GMRES, polar nodes of each body.
    """

    problem: Coupled
    flows: list[Any]
    velocity: Array
    angular_velocity: Array
    force: Array
    torque: Array
    iterations: int
    unknowns: Array = field(repr=False)
    _again: Callable[[list[int]], Solution] = field(repr=False)

    @property
    def nodes(self) -> list[int]:
        """Polar nodes of each body's grid."""
        return list(self.problem.nodes)

    @property
    def stresslet(self) -> Array:
        """Stresslets (N, 3, 3), space frame, of the tractions on the bodies about their centres."""
        return np.stack([self.problem.stresslet(b, flow) for b, flow in enumerate(self.flows)])

    @cached_property
    def error_estimate(self) -> dict[str, float]:
        """Estimated largest errors of velocity, angular_velocity, force, torque and stresslet.

        Absolute, by solving again with two polar nodes less (`bie.coupling.estimated`); given
        parts of the motion or loads have none.
        """
        problem, coarse = self.problem, self._again(self.problem.coarser)
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

    def field(self, flow: Flow | None, points: Array, t: float = 0.0) -> dict[str, Array]:
        """Velocity and pressure at points (P, 3) of space, in the flow that was solved in."""
        problem = self.problem
        inside = np.zeros(len(points), dtype=bool)
        for body in problem.bodies:
            inside |= body.shape.level(body.to_body(points)) < 1.0 - 1e-12
        if problem.wall is not None:
            inside |= problem.wall.height(points) < -1e-12
        here = points[~inside]
        u = np.zeros((len(here), 3)) if flow is None else np.array(flow.velocity(here, t))
        p = np.zeros(len(here)) if flow is None else np.array(flow.pressure(here, t))
        for c, (body, sent) in enumerate(zip(problem.bodies, self.flows, strict=True)):
            own = problem.exterior(c, sent).evaluate(body.to_body(here))
            u += own["velocity"] @ body.rotation.T
            p += own["pressure"] / body.size
            if problem.wall is not None:
                image, pressure = problem.reflected(c, sent, here)
                u += image
                p += pressure
        velocity, whole = np.full((len(points), 3), np.nan), np.full(len(points), np.nan)
        velocity[~inside], whole[~inside] = u, p
        return {"velocity": velocity, "pressure": whole, "source": np.where(inside, -1, 0)}
