"""The Stokes flow outside one body, from the surface to infinity: the one door to its values.

It is given by its velocity on the surface, or by a layer density, and vanishes far away with its
pressure; everything is in the body frame, in polar radii, mu = 1. Around a spheroid a table of
confocal harmonics (`qbx.exterior`) serves every point; where its error is above the tolerance and a
density is known, quadrature by expansion near the surface, panels graded to the point further out
and plain quadrature far away (`qbx.volume`) take over, and they check it.
"""

from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Literal

import numpy as np

from qbxstokes.bie.operators import SurfaceOperators
from qbxstokes.errors import FlowError
from qbxstokes.geometry.grid import SurfaceGrid
from qbxstokes.geometry.shape import Revolution
from qbxstokes.qbx.exterior import WHAT, ExteriorFlow, SurfaceToExterior
from qbxstokes.qbx.modes import ModalOperator, from_modes, to_modes
from qbxstokes.qbx.volume import METHODS, LayerPotentials
from qbxstokes.typing import AnyArray, Array

Velocity = Callable[[Array], Array]
Method = Literal["auto", "table", "quadrature"]

# What gave a target its value, as reported: the body's inside, the table, or one of METHODS.
INSIDE, TABLE = -1, len(METHODS)
SOURCES = (*METHODS, "table")
# Polar nodes beyond which a flow is given up as too close to singular.
MOST_NODES = 96
# Rounding of a table of a sphere, relative to its largest values; as much again for each unit of
# the ratio of longest to least radius. Factors on what a finer grid changes, and on what the
# highest degrees do. Beyond this share of the largest speed no change says how large an error is.
_ROUNDING, _FINER, _LEFT_OUT, _UNKNOWN = 1e-15, 1.5, 4.0, 0.1


@dataclass(frozen=True)
class ExteriorField:
    """A Stokes flow outside a body.

    velocity: (N, 3) on the grid, without net flux. degree: of it as a polynomial, None if it is
    none; the table then holds no degree that could only be rounding. boundary: the velocity
    at any points (N, 3) of the surface, where it is known. potentials: layers whose potentials the
    field is. tolerance: of values, unless `evaluate` is told another. data_error:
    relative error of the velocity itself.
    """

    grid: SurfaceGrid
    velocity: Array = field(repr=False)
    degree: int | None = None
    boundary: Velocity | None = field(default=None, repr=False)
    potentials: LayerPotentials | None = field(default=None, repr=False)
    tolerance: float = 1e-8
    data_error: float = 0.0

    @cached_property
    def table(self) -> ExteriorFlow:
        """The flow as exterior spheroidal harmonics, from its values on the surface."""
        return surface_map(self.grid, self.degree).flow(self.velocity).trimmed()

    @cached_property
    def scale(self) -> float:
        """Largest speed on the surface: what errors are relative to."""
        known = self.velocity if self.boundary is None else self.boundary(self.grid.points)
        return float(np.linalg.norm(known, axis=-1).max())

    def evaluate(
        self,
        points: Array,
        what: Collection[str] = ("velocity",),
        tolerance: float | None = None,
        method: Method = "auto",
    ) -> dict[str, AnyArray]:
        """Some of WHAT at points (N, 3), each in the way its tolerance asks for.

        velocity (N, 3), gradient (N, 3, 3) of d u_i/d x_j, pressure (N,), pressure_gradient (N, 3),
        stress (N, 6: xx, yy, zz, xy, xz, yz), and always source (N,): index into SOURCES, or
        INSIDE, where the values are NaN. tolerance: error of the velocity relative to its largest
        value; `errors` has those of the rest.

        The table serves every target for which its error, which decays away from the surface, is
        within the tolerance. Raises FlowError where it is not and there is no density to be summed.
        """
        points = np.asarray(points, dtype=float)
        tolerance = self.tolerance if tolerance is None else tolerance
        if method == "quadrature":
            found, used = self._layers.evaluate(points, tolerance)
            return {name: found[name] for name in what} | {"source": used}
        limit = tolerance * self.scale
        values = self.table.evaluate(points, what, 0.1 * limit)
        sources = np.where(np.isnan(values["pressure"]), INSIDE, TABLE)
        if method == "auto" and self.boundary_error > limit:
            # What the highest degree of the table has left from the surface to the points, or more.
            left = self.grid.shape.decay(points) ** (self.table.harmonics.degree + 1)
            poor = (sources == TABLE) & (self.boundary_error * left > limit)
            if poor.any():
                direct, sources[poor] = self._layers.evaluate(points[poor], tolerance)
                for name in what:
                    values[name][poor] = direct[name]
        return {name: values[name] for name in what} | {"source": sources}

    @property
    def _layers(self) -> LayerPotentials:
        if self.potentials is None:
            raise FlowError(
                f"the flow is known on {self.grid.n_theta} x {self.grid.n_phi} points of the "
                f"surface to {self.boundary_error / (self.scale or 1.0):.1e} of its largest speed, "
                "and has no density to be summed; ask for a larger tolerance or give more points"
            )
        return self.potentials

    # -- force, torque, stresslet -------------------------------------------------------------

    @property
    def loads(self) -> tuple[Array, Array]:
        """Force and torque (3,) that the body exerts ON the fluid."""
        both = self.table.harmonics.force_torque(self.table.coefficients)
        return both[:3], both[3:]

    @property
    def stresslet(self) -> Array:
        """Stresslet (3, 3) of the traction on the body about its centre."""
        moment = -self.table.harmonics.first_moment(self.table.coefficients)
        return np.asarray(0.5 * (moment + moment.T) - np.trace(moment) / 3.0 * np.eye(3))

    # -- errors -------------------------------------------------------------------------------

    @cached_property
    def _probes(self) -> Array:
        """Points of the surface between the nodes of the grid, and its poles."""
        grid = self.grid
        n_theta, n_phi = 2 * grid.n_theta + 1, 2 * grid.n_phi + 1
        theta = np.pi * (np.arange(n_theta) + 0.5) / n_theta
        phi = 2.0 * np.pi * (np.arange(n_phi) + 0.25) / n_phi
        return grid.shape.surface(theta[:, None], phi).reshape(-1, 3)

    @cached_property
    def _other(self) -> ExteriorFlow:
        """The same flow from half as many nodes again, or without its highest degrees and orders.

        A quarter of them: what is left out then shows what the grid has left out.
        """
        grid = self.grid
        if self.boundary is not None:
            n_theta, n_phi = 3 * grid.n_theta // 2 + 1, 3 * grid.n_phi // 2 + 1
            finer = SurfaceGrid(grid.shape, n_theta, n_phi)
            return surface_map(finer, self.degree).flow(self.boundary(finer.points))
        modes = to_modes(self.velocity, grid.n_theta, grid.n_phi)
        modes[len(modes) - max(2, len(modes) // 4) :] = 0.0
        rest = from_modes(modes, grid.n_theta, grid.n_phi)
        degree = grid.n_theta - 2 if self.degree is None else self.degree
        return surface_map(grid, max(degree - max(2, grid.n_theta // 4), 1)).flow(rest)

    @cached_property
    def boundary_error(self) -> float:
        """Largest error of the table on the surface, between the nodes of the grid, absolute.

        Where the velocity is known there. The error is itself an exterior Stokes flow, so that its
        largest value on the surface bounds it everywhere (up to the constant of the maximum modulus
        theorem, which is near 1).
        """
        table = self.table.evaluate(self._probes)["velocity"]
        if self.boundary is not None:
            return float(np.abs(table - self.boundary(self._probes)).max())
        other = self._other.evaluate(self._probes)["velocity"]
        return _LEFT_OUT * float(np.abs(table - other).max()) + self.data_error * self.scale

    @cached_property
    def errors(self) -> dict[str, float]:
        """Estimated largest error of the table's values anywhere outside, absolute, by name.

        The change on the surface, where all are largest, when the grid is refined by half (or the
        highest degrees are left out, where the velocity is known on the grid alone), and rounding.
        Infinite where the grid does not resolve the velocity to a tenth.
        """
        poles = self.grid.shape.surface(np.array([0.0, np.pi]), 0.0)
        points = np.concatenate([self._probes, poles])
        own, other = self.table.evaluate(points, WHAT), self._other.evaluate(points, WHAT)
        size = {name: float(np.abs(own[name]).max()) for name in WHAT}
        # Pressures that vanish by symmetry are differences of what does not.
        size["pressure"] += size["gradient"]
        size["pressure_gradient"] += size["gradient"] / self.grid.shape.radius
        thin = self.grid.shape.radius / self.grid.shape.least_radius
        rounding = _ROUNDING * (3.0 + thin) + self.data_error
        safety = _LEFT_OUT if self.boundary is None else _FINER
        change = {name: safety * float(np.abs(own[name] - other[name]).max()) for name in WHAT}
        if not change["velocity"] <= _UNKNOWN * self.scale:
            return dict.fromkeys(WHAT, np.inf)
        return {name: change[name] + rounding * size[name] for name in WHAT}

    def check_points(self, count: int) -> Array:
        """Random targets (count, 3) on the surface and from 1e-6 to ten body lengths away."""
        rng, shape = np.random.default_rng(0), self.grid.shape
        theta, phi = np.arccos(rng.uniform(-1, 1, count)), rng.uniform(0, 2 * np.pi, count)
        distance = shape.radius * 10.0 ** np.linspace(-6, 1.3, count)
        distance[0] = 0.0
        return shape.surface(theta, phi) + distance[:, None] * shape.normal(theta, phi)

    def differences(self, points: Array) -> Array:
        """Difference (N,) of the velocity by table and by QBX at (N, 3), relative to `scale`.

        Two evaluations of one field that share nothing but the density. NaN in the body.
        """
        table, direct = (
            self.evaluate(points, ("velocity",), 1e-13, method)["velocity"]
            for method in ("table", "quadrature")
        )
        return np.asarray(np.linalg.norm(table - direct, axis=-1) / (self.scale or 1.0))


@lru_cache(maxsize=32)
def surface_map(grid: SurfaceGrid, degree: int | None) -> SurfaceToExterior:
    """The map from surface velocities to exterior flows, for background flows of a degree."""
    return SurfaceToExterior(grid, grid.n_theta - 2 if degree is None else max(degree, 1))


def layer_limit(
    operators: SurfaceOperators, density: Array, force: Array, torque: Array
) -> tuple[Array, LayerPotentials]:
    """Outer limit (N, 3) on the surface, D[psi] - 4 pi psi + V, and the layers, of a density.

    psi (N, 3) on the grid of the operators; V is the spread completion of force and torque (3,) ON
    the fluid.
    """
    grid = operators.grid
    double = ModalOperator(operators.double_layer, grid.n_theta, grid.n_phi)
    limit = double.apply(density) - 4.0 * np.pi * density
    limit = limit + completion_velocity(operators, force, torque)
    # Of the density a + b x y of the spread completion (see `resistance`).
    spin = np.asarray(torque) * grid.shape.torque_density
    weight = np.concatenate([np.asarray(force) / (4.0 * np.pi), spin])
    return limit, LayerPotentials(grid, density, weight)


def completion_velocity(operators: SurfaceOperators, force: Array, torque: Array) -> Array:
    """Completion flow (N, 3) on the surface, of force and torque (3,) on the fluid."""
    grid, flows = operators.grid, operators.completion_flows
    modes = np.zeros((grid.n_phi // 2 + 1, 3 * grid.n_theta), dtype=np.complex128)
    # A real field of mode 1 has half its amplitude as Fourier coefficient.
    modes[1] += 0.5 * (force[0] - 1j * force[1]) * flows["translation_transverse"]
    modes[1] += 0.5 * (torque[1] + 1j * torque[0]) * flows["rotation_transverse"]
    modes[0] += force[2] * flows["translation_axial"]
    modes[0] += 1j * torque[2] * flows["rotation_axial"]
    return from_modes(modes, grid.n_theta, grid.n_phi)


def resolving_grid(shape: Revolution, velocity: Velocity, tolerance: float) -> tuple[int, int]:
    """Polar and azimuthal nodes whose table holds a surface velocity to a relative tolerance.

    Raises FlowError where MOST_NODES do not suffice.
    """
    fine = SurfaceGrid(shape, MOST_NODES, 2 * MOST_NODES)
    modes = to_modes(velocity(fine.points), fine.n_theta, fine.n_phi)
    size = np.abs(modes).max(axis=1)
    # What all higher modes hold together, from each mode on.
    rest = np.cumsum(size[::-1])[::-1] / size.max()
    small = np.flatnonzero(rest < tolerance)
    n_phi = max(2 * int(small[0] if small.size else MOST_NODES), 4)
    n_theta = 8
    while True:
        grid = SurfaceGrid(shape, n_theta, n_phi)
        table = surface_map(grid, None).flow(velocity(grid.points))
        probe = SurfaceGrid(shape, 2 * n_theta + 1, 7)
        exact = velocity(probe.points)
        outside = probe.points * (1.0 + 1e-15)
        error = float(np.abs(table.evaluate(outside)["velocity"] - exact).max())
        if error <= tolerance * float(np.abs(exact).max()):
            return n_theta, n_phi
        n_theta = (5 * n_theta + 3) // 4
        if n_theta > MOST_NODES or not small.size:
            raise FlowError(
                f"the flow varies too much over the body: {MOST_NODES} x {2 * MOST_NODES} points "
                f"of the surface leave an error of {error:.1e}, more than {tolerance:.0e}; "
                "a larger tolerance, or what drives it farther away"
            )
