"""The flow around one body: operators formed once, solved at any number of instants."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qbxstokes.bie.accuracy import RowFormer, choose_scheme
from qbxstokes.bie.exterior import resolving_grid
from qbxstokes.bie.field import (
    Disturbance,
    FlowAround,
    mobility_disturbance,
    resistance_disturbance,
)
from qbxstokes.bie.operators import surface_operators
from qbxstokes.case.running import Hydrodynamics
from qbxstokes.flows import Flow
from qbxstokes.geometry import rotation
from qbxstokes.geometry.shape import Revolution
from qbxstokes.qbx.operator import independent_rows, layer_rows
from qbxstokes.simulation.hydrodynamics import explicit_scheme, side_of, solver_factory

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Instant:
    """The body at one instant, in space; velocities None where the body is free."""

    time: float
    position: Array
    quaternion: Array
    velocity: Array | None = None
    angular_velocity: Array | None = None
    force: Array = field(default_factory=lambda: np.zeros(3))
    torque: Array = field(default_factory=lambda: np.zeros(3))

    @property
    def rotation(self) -> Array:
        """Matrix (3, 3) from body to space."""
        return rotation.matrix(self.quaternion)


class AroundBody:
    """Solves for the flow around a body in a background flow.

    section: accuracy and scheme. tolerance: of the field, relative to the largest disturbance.
    """

    def __init__(
        self, shape: Revolution, flow: Flow, section: Hydrodynamics, tolerance: float
    ) -> None:
        self.shape, self.flow, self.section = shape, flow, section
        self.tolerance = min(section.tolerance, tolerance)
        self.operators: Any = None
        self._solvers: dict[str, Any] = {}
        self._latest: tuple[Instant, FlowAround] | None = None

    def form(self, first: Instant, form_rows: RowFormer = layer_rows) -> None:
        """Form the operators on a grid that resolves the flow at the first instant.

        Their completion is the spread one.
        """
        section, degree = self.section, self.flow.degree
        scheme: Any = explicit_scheme(section)
        if degree is not None:
            n_theta, n_phi = max(8, degree + 5), 2 * degree + 4
        else:
            background = self._background(first)
            n_theta, n_phi = resolving_grid(self.shape, background, 0.1 * self.tolerance)
        if scheme is None:
            scheme = choose_scheme(self.tolerance, n_theta, side=side_of(section))
        elif section.n_theta is None:
            scheme = replace(scheme, n_theta=max(scheme.n_theta, n_theta))
        n_phi = section.n_phi or n_phi
        wanted = independent_rows(self.shape, scheme.n_theta)
        rows = form_rows(self.shape, scheme, n_phi // 2 + 1, wanted, True)
        self.operators = surface_operators(self.shape, scheme, n_phi, "surface", rows)

    def at(self, instant: Instant) -> FlowAround:
        """The flow around the body at the instant; solved again only for another one."""
        if self._latest is not None and self._latest[0] is instant:
            return self._latest[1]
        if self.operators is None:
            self.form(instant)
        turn, flow = instant.rotation, self.flow
        disturbance: Disturbance
        if instant.velocity is None or instant.angular_velocity is None:
            disturbance = mobility_disturbance(
                self.operators,
                self._background(instant),
                turn.T @ instant.force,
                turn.T @ instant.torque,
                self._solver,
                flow.degree,
            )
        else:
            disturbance = resistance_disturbance(
                self.operators,
                self._background(instant),
                turn.T @ instant.velocity,
                turn.T @ instant.angular_velocity,
                self._solver,
                flow.degree,
            )
        around = FlowAround(disturbance, flow, instant.position, turn, instant.time)
        self._latest = instant, around
        return around

    def last_solve(self) -> tuple[int, float]:
        """Iterations and true residual of the latest solution."""
        (solver,) = self._solvers.values()
        record = solver.records[-1]
        return record.iterations, record.true_residual

    def _background(self, instant: Instant) -> Any:
        """Velocity of the background flow at points of the body frame, in the body frame."""
        turn, flow = instant.rotation, self.flow

        def background(points: Array) -> Array:
            space = points @ turn.T + instant.position
            return np.asarray(flow.velocity(space, instant.time) @ turn)

        return background

    def _solver(self, operator: Any, grid: Any) -> Any:
        kind = "mobility" if operator is self.operators.mobility else "resistance"
        if kind not in self._solvers:
            self._solvers[kind] = solver_factory(self.section, [])(operator, grid)
        return self._solvers[kind]
