"""The flow around one body: operators formed once, solved at any number of instants."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.bie.accuracy import RowFormer, choose_scheme
from qbxstokes.bie.exterior import ExteriorField, layer_limit, resolving_grid
from qbxstokes.bie.field import (
    Disturbance,
    FlowAround,
    mobility_disturbance,
    resistance_disturbance,
)
from qbxstokes.bie.operators import SurfaceOperators, surface_operators
from qbxstokes.case.running import Hydrodynamics
from qbxstokes.errors import SceneError
from qbxstokes.flows import Flow
from qbxstokes.geometry import rotation
from qbxstokes.geometry.grid import SurfaceGrid
from qbxstokes.geometry.shape import Revolution
from qbxstokes.qbx.exterior import WHAT
from qbxstokes.qbx.operator import Scheme, independent_rows, layer_rows
from qbxstokes.simulation.arguments import numbers, require_flow
from qbxstokes.simulation.hydrodynamics import explicit_scheme, side_of, solver_factory
from qbxstokes.simulation.simulation import places
from qbxstokes.typing import AnyArray, Array

if TYPE_CHECKING:
    from qbxstokes.simulation.formed_body import FormedBody


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

    check = "table against QBX"

    def __init__(
        self, shape: Revolution, flow: Flow, section: Hydrodynamics, tolerance: float
    ) -> None:
        require_flow(flow)
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
        if degree is not None:
            n_theta, n_phi = max(8, degree + 5), 2 * degree + 4
        else:
            background = self._background(first)
            n_theta, n_phi = resolving_grid(self.shape, background, 0.1 * self.tolerance)
        scheme: Any = explicit_scheme(section)
        if scheme is None:
            scheme = choose_scheme(self.tolerance, n_theta, side=side_of(section))
        elif section.n_theta is None:
            scheme = replace(scheme, n_theta=max(scheme.n_theta, n_theta))
        n_phi = section.n_phi or n_phi
        self.operators = form_operators(self.shape, scheme, n_phi, form_rows)

    def at(self, instant: Instant) -> FlowAround:
        """The flow around the body at the instant; solved again only for another one."""
        if self._latest is not None and self._latest[0] is instant:
            return self._latest[1]
        if self.operators is None:
            self.form(instant)
        turn, flow = instant.rotation, self.flow
        solve: Callable[..., Disturbance] = resistance_disturbance
        vectors = instant.velocity, instant.angular_velocity
        if any(vector is None for vector in vectors):
            solve, vectors = mobility_disturbance, (instant.force, instant.torque)
        in_body = [turn.T @ np.asarray(vector) for vector in vectors]
        background = self._background(instant)
        disturbance = solve(self.operators, background, *in_body, self._solver, flow.degree)
        around = FlowAround(disturbance, flow, instant.position, turn, instant.time)
        self._latest = instant, around
        return around

    def facts(self, instant: Instant) -> dict[str, Any]:
        """The grid, and the table of the flow at an instant."""
        grid, last = self.operators.grid, self.at(instant).disturbance
        degree = last.table.harmonics.degree
        return {"n_theta": grid.n_theta, "n_phi": grid.n_phi, "degree_of_table": degree}

    def last_solve(self) -> tuple[int, float]:
        """Iterations and true residual of the latest solution."""
        (solver,) = self._solvers.values()
        if not solver.records:  # nothing disturbs a fluid at rest
            return 0, 0.0
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


def form_operators(
    shape: Revolution, scheme: Scheme, n_phi: int, form_rows: RowFormer = layer_rows
) -> SurfaceOperators:
    """The layers on a grid, with the spread completion."""
    wanted = independent_rows(shape, scheme.n_theta)
    rows = form_rows(shape, scheme, n_phi // 2 + 1, wanted, True)
    return surface_operators(shape, scheme, n_phi, "surface", rows)


def field_around(
    body: FormedBody,
    flow: Flow,
    points: ArrayLike,
    place: tuple[ArrayLike, ArrayLike],
    motion: tuple[ArrayLike | None, ArrayLike | None],
    what: Collection[str],
    tolerance: float,
    t: float,
) -> dict[str, AnyArray]:
    """`Body.field`: place is (position, orientation), motion (velocity, angular velocity)."""
    wrong = [name for name in what if name not in (*WHAT, "disturbance_velocity")]
    if wrong:
        known = ", ".join(("disturbance_velocity", *WHAT))
        raise SceneError("what", f"asks for {wrong[0]!r}", f"some of {known}")
    (x, q, _), held = places(*place), any(u is not None for u in motion)
    v, omega = (
        None if not held else np.zeros(3) if u is None else np.asarray(u, dtype=np.float64)
        for u in motion
    )
    around = AroundBody(body.shape, flow, body.settings, tolerance)
    whole = around.at(Instant(t, x[0], q[0], v, omega))
    return whole.evaluate(np.reshape(np.asarray(points, float), (-1, 3)), what, tolerance)


def exterior_field(
    body: FormedBody,
    velocity: Callable[[Array], ArrayLike] | ArrayLike | None,
    density: ArrayLike | None,
    loads: tuple[ArrayLike, ArrayLike],
    tolerance: float,
) -> ExteriorField:
    """`Body.exterior`: loads (force, torque) are those of the completion of a density."""
    body.check_size()
    shape = body.shape
    if (velocity is None) == (density is None):
        raise SceneError("velocity", "and density are both or neither given", "one of them")
    if not 1e-14 <= tolerance <= 0.1:
        raise SceneError("tolerance", f"is {tolerance:g}", "between 1e-14 and 0.1")
    if callable(velocity):
        function = velocity

        def boundary(x: Array) -> Array:
            u = numbers("velocity", function(x), "a function of points (N, 3)")
            if u.shape not in (x.shape, (3,)):
                raise SceneError("velocity", f"has shape {u.shape}", f"{x.shape} or (3,)")
            return _checked("velocity", np.broadcast_to(u, x.shape))

        few = SurfaceGrid(shape, 32, 64)
        _check_flux(few, boundary(few.points), max(1e-3, tolerance))
        n_theta, n_phi = resolving_grid(shape, boundary, 0.1 * tolerance)
        grid = SurfaceGrid(shape, n_theta, n_phi)
        return ExteriorField(grid, boundary(grid.points), None, boundary, None, tolerance)
    name = "velocity" if density is None else "density"
    right = "a function of points (N, 3), or values on the points of `surface`"
    values = numbers(name, velocity if density is None else density, right)  # type: ignore[arg-type]
    if values.ndim != 3 or values.shape[2] != 3 or min(values.shape[:2]) < 4:
        right = "(n_theta, n_phi, 3), at least 4 x 4, on the points of `surface`"
        raise SceneError(name, f"has shape {values.shape}", right)
    grid = SurfaceGrid(shape, values.shape[0], values.shape[1])
    flat = _checked(name, values.reshape(-1, 3))
    layers = None
    if density is not None:
        scheme = choose_scheme(tolerance, grid.n_theta, side=side_of(body.settings))
        operators = form_operators(shape, scheme, grid.n_phi)
        force, torque = (np.asarray(load, dtype=np.float64) for load in loads)
        flat, layers = layer_limit(operators, flat, force, torque)
    _check_flux(grid, flat, max(1e-3, tolerance))
    error = 0.0 if layers is None else tolerance
    return ExteriorField(grid, flat, None, None, layers, tolerance, error)


def _checked(name: str, values: Array) -> Array:
    if not np.isfinite(values).all():
        raise SceneError(name, "is not finite everywhere on the surface", "finite values")
    return values


def _check_flux(grid: SurfaceGrid, velocity: Array, share: float) -> None:
    """Refuse a flow through the surface: a body neither grows nor shrinks."""
    through = np.sum(velocity * grid.normals, axis=-1)
    flux, size = grid.weights @ through, grid.weights @ np.linalg.norm(velocity, axis=-1)
    if abs(flux) > share * size:
        raise SceneError("velocity", f"has the net flux {flux:.3g} through the surface", "none")
