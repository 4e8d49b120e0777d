"""Free motion, force and torque of a body in a flow of any kind, step by step.

`GridMotion` takes the flow on the surface grid and multiplies it by the functional; `SolveMotion`
solves the integral equation anew, as the thesis does, and is the check on everything else. Both
work in the body frame, where the discrete operators never change, and answer in the space frame.
Polynomial flows need neither: their law is `FaxenCoefficients`.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from qbxstokes.bie.functional import GridFunctional
from qbxstokes.bie.operators import DirectSolver, SolverFactory, SurfaceOperators
from qbxstokes.geometry.rotation import matrix

Array = NDArray[np.float64]


class BackgroundFlow(Protocol):
    """The part of a flow that the motion of the body needs."""

    def velocity(self, x: Array, t: float = 0.0) -> Array:
        """Velocity (..., 3) at points (..., 3)."""


class GridMotion:
    """Free motion of a batch of bodies by the grid functional."""

    def __init__(self, functional: GridFunctional, flow: BackgroundFlow) -> None:
        self._points = functional.points
        self._weights = functional.weights
        self._flow = flow

    def free_motion(self, t: float, x: Array, q: Array) -> tuple[Array, Array]:
        """U and Omega (n, 3) in space at positions x (n, 3), orientations q (n, 4)."""
        rotation = matrix(q)
        points = x[:, None, :] + self._points @ rotation.swapaxes(1, 2)
        velocity = self._flow.velocity(points, t) @ rotation
        motion = np.tensordot(velocity, self._weights, axes=((1, 2), (1, 2)))
        return _to_space(rotation, motion[:, :3]), _to_space(rotation, motion[:, 3:])


class SolveMotion:
    """Free motion, or force and torque, by one solve of the integral equation per body and call."""

    def __init__(
        self,
        operators: SurfaceOperators,
        flow: BackgroundFlow,
        solver: SolverFactory = DirectSolver,
    ) -> None:
        self._operators = operators
        self._flow = flow
        self._mobility = solver(operators.mobility, operators.grid)
        self._resistance = solver(operators.resistance, operators.grid)

    def free_motion(self, t: float, x: Array, q: Array) -> tuple[Array, Array]:
        """U and Omega (n, 3) in space of the mobility problem without force or torque."""
        rotation = matrix(q)
        u, omega = np.empty_like(x), np.empty_like(x)
        for i, velocity in enumerate(self._surface_velocity(t, x, rotation)):
            u[i], omega[i] = self._operators.motion_of(self._mobility.solve(-velocity))
        return _to_space(rotation, u), _to_space(rotation, omega)

    def force_torque(
        self, t: float, x: Array, q: Array, velocity: Array, angular_velocity: Array
    ) -> tuple[Array, Array]:
        """Force and torque (n, 3) on the body in space, of the resistance problem.

        velocity and angular_velocity (n, 3) of the body, in the space frame.
        """
        rotation = matrix(q)
        v = np.einsum("nij,ni->nj", rotation, velocity)
        w = np.einsum("nij,ni->nj", rotation, angular_velocity)
        force, torque = np.empty_like(x), np.empty_like(x)
        points = self._operators.grid.points
        for i, background in enumerate(self._surface_velocity(t, x, rotation)):
            data = v[i] + np.cross(w[i], points) - background
            force[i], torque[i] = self._operators.force_of(self._resistance.solve(data))
        return _to_space(rotation, force), _to_space(rotation, torque)

    def _surface_velocity(self, t: float, x: Array, rotation: Array) -> Array:
        points = x[:, None, :] + self._operators.grid.points @ rotation.swapaxes(1, 2)
        return np.asarray(self._flow.velocity(points, t) @ rotation)


def _to_space(rotation: Array, vectors: Array) -> Array:
    return np.asarray(np.einsum("nij,nj->ni", rotation, vectors))
