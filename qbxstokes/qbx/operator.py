"""Discrete layer potentials on a body of revolution: a target per theta row, a block per mode.

Rotational symmetry leaves one target per row of the grid, mirror symmetry in z half of the rows,
and each row is independent of the others, so rows can be formed by different processes.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from qbxstokes.errors import CaseError
from qbxstokes.geometry.grid import SurfaceGrid
from qbxstokes.geometry.shape import Revolution
from qbxstokes.qbx.expansion import from_coefficients
from qbxstokes.qbx.kernel import Centre, Kernels, layer_row, target_specific
from qbxstokes.qbx.panels import Rule, graded_rule, uniform_rule
from qbxstokes.typing import Array

Side = Literal["average", "inner", "outer"]


@dataclass(frozen=True)
class GradedScheme:
    """Target-specific QBX with source panels graded to each centre.

    expansion_order: p. radius_factor: expansion radius over `Revolution.admissible_radius`.
    panel_order: Gauss-Legendre nodes per panel and direction. panel_ratio: largest panel length
    over its distance to the centre. side: average of inner and outer expansions, or one of them
    plus the jump; one side costs half as much and is as accurate. keep_rigid: impose the identity
    for rigid motions (`impose_rigid_motions`).
    """

    n_theta: int = 10
    expansion_order: int = 16
    radius_factor: float = 0.1
    panel_order: int = 18
    panel_ratio: float = 0.7
    side: Side = "inner"
    keep_rigid: bool = True

    def __post_init__(self) -> None:
        _require(0.0 < self.radius_factor <= 1.0, "radius_factor", self.radius_factor, "in (0, 1]")
        _require(self.expansion_order >= 0, "expansion_order", self.expansion_order, ">= 0")
        _require(self.n_theta >= 2, "n_theta", self.n_theta, ">= 2")
        _require(self.panel_order >= 2, "panel_order", self.panel_order, ">= 2")
        _require(self.panel_ratio > 0.0, "panel_ratio", self.panel_ratio, "positive")

    def grid(self, shape: Revolution, n_phi: int) -> SurfaceGrid:
        """The surface grid that carries the density."""
        return SurfaceGrid(shape, self.n_theta, n_phi)

    def radius(self, shape: Revolution, theta: float) -> float:
        """Expansion radius at theta, in c."""
        return self.radius_factor * shape.admissible_radius(theta).item()

    def rule(
        self, shape: Revolution, theta: float, side: int, n_modes: int, radius: float | None = None
    ) -> Rule:
        """Source rule of the centre at a radius, by default its own, from the target at theta."""
        # A panel must resolve the interpolated density and the azimuthal modes as well.
        turn, order = np.pi * self.panel_order, self.panel_order
        longest = turn / (self.n_theta + 8), turn / (2 * (n_modes + 3))
        away = self.radius(shape, theta) if radius is None else radius
        return graded_rule(shape, theta, side, away, self.panel_ratio, order, longest)


@dataclass(frozen=True)
class UniformScheme:
    """The thesis's scheme: one global radius, uniform upsampling (Bagge 2015, sec. 5.3.3).

    r_over_h gives the radius 2 pi (r/h) / n_theta; upsampling is kappa, in both directions.
    n_phi is that of the grid, since the source rule refines it. coefficients: sum the expansions
    from their spherical-harmonic coefficients, as the thesis does, instead of the target-specific
    form, which is the same number.
    """

    n_theta: int
    n_phi: int
    expansion_order: int
    r_over_h: float
    upsampling: int
    side: Side = "average"
    coefficients: bool = False

    def __post_init__(self) -> None:
        _require(self.r_over_h > 0.0, "r_over_h", self.r_over_h, "positive")
        _require(self.expansion_order >= 0, "expansion_order", self.expansion_order, ">= 0")
        _require(self.n_theta >= 2, "n_theta", self.n_theta, ">= 2")
        _require(self.n_phi >= 3, "n_phi", self.n_phi, ">= 3")
        _require(self.upsampling >= 1, "upsampling", self.upsampling, ">= 1")

    def grid(self, shape: Revolution, n_phi: int) -> SurfaceGrid:
        """The surface grid that carries the density: Gauss-Legendre in theta."""
        return SurfaceGrid(shape, self.n_theta, n_phi, "theta")

    def radius(self, shape: Revolution, theta: float) -> float:
        """The global expansion radius; CaseError if its ball crosses the surface anywhere."""
        radius = 2.0 * np.pi * self.r_over_h / self.n_theta
        limit = shape.least_radius
        if radius > limit:
            raise CaseError(
                f"r_over_h is {self.r_over_h:g}: the expansion ball would cross the surface of the "
                f"{shape}; use r_over_h <= {limit:.4g} n_theta / (2 pi) = "
                f"{limit * self.n_theta / (2.0 * np.pi):.6g}"
            )
        return radius

    def rule(self, shape: Revolution, theta: float, side: int, n_modes: int) -> Rule:
        """Source rule, the same for every centre: the upsampled grid."""
        return uniform_rule(self.upsampling * self.n_theta, self.upsampling * self.n_phi)


Scheme = GradedScheme | UniformScheme


def _require(condition: bool, name: str, value: object, wanted: str) -> None:
    if not condition:
        raise CaseError(f"{name} is {value}; it must be {wanted}")


def independent_rows(shape: Revolution, n_theta: int) -> range:
    """Rows to form; of a body with fore-aft symmetry the others follow by the mirror in z."""
    return range((n_theta + 1) // 2 if shape.fore_aft else n_theta)


def layer_rows(
    shape: Revolution, scheme: Scheme, n_modes: int, rows: Sequence[int], with_single: bool = False
) -> tuple[Array, Array]:
    """Rows of the double and the single layer at the targets theta[rows], phi = 0.

    Returns two arrays (len(rows), n_modes, 3, 3, n_theta); see `kernel.layer_row` for their
    meaning. One-sided expansions carry the jump term, so that the value is that on the surface:
    the exterior limit is D - 4 pi psi (Bagge 2015, eq. 4.8). The second array is of length 0 in
    n_modes unless with_single.
    """
    kernels: Kernels = target_specific
    if isinstance(scheme, UniformScheme) and scheme.coefficients:
        kernels = from_coefficients
    grid = scheme.grid(shape, 1)
    sides = {"average": (1, -1), "inner": (-1,), "outer": (1,)}[scheme.side]
    size = (len(rows), n_modes, 3, 3, scheme.n_theta)
    double = np.zeros(size)
    single = np.zeros(size if with_single else (len(rows), 0, 3, 3, scheme.n_theta))
    for index, row in enumerate(rows):
        theta = float(grid.theta[row])
        for side in sides:
            radius = scheme.radius(shape, theta)
            centre = Centre(shape, theta, side, radius, scheme.expansion_order)
            rule = scheme.rule(shape, theta, side, n_modes)
            pair = layer_row(centre, rule, grid, n_modes, with_single, kernels)
            double[index] += pair[0]
            single[index] += pair[1]
        if len(sides) == 1:
            for a in range(3):
                double[index, :, a, a, row] += 4.0 * np.pi * sides[0]
    if len(sides) == 2:
        double *= 0.5
        single *= 0.5
    if isinstance(scheme, GradedScheme) and scheme.keep_rigid:
        impose_rigid_motions(grid, rows, double)
    return double, single


def rigid_defects(grid: SurfaceGrid, rows: Sequence[int], double: Array) -> Array:
    """Defects of D psi = 4 pi psi for rigid motions psi, in rows (len(rows), n_modes, 3, 3, n).

    The identity holds on any closed surface (divergence theorem; Pozrikidis 1992, section 2.1), so
    its defects show the error of the quadrature without any solution being known. Returns
    (len(rows), 4, 3): the value at the target, by component, of the translation along the axis,
    the rotation about it, the translation across, and the rotation across about the target's
    height, the rotations with unit speed at the target's distance from the axis. Needs two modes
    for the last two, which are zero otherwise.
    """
    rho, z = grid.shape.meridian(grid.theta)
    defects = np.zeros((len(rows), 4, 3))
    for index, row in enumerate(rows):
        turn = rho / rho[row]
        lift = (z - z[row]) / rho[row]
        zero = double[index, 0]
        defects[index, 0] = zero[:, 2].sum(axis=-1) - 4.0 * np.pi * np.eye(3)[2]
        defects[index, 1] = zero[:, 1] @ turn - 4.0 * np.pi * np.eye(3)[1]
        if double.shape[1] > 1:
            one = double[index, 1]
            across = one[:, 0] + one[:, 1]
            defects[index, 2] = across.sum(axis=-1) - 4.0 * np.pi * np.array([1.0, 1.0, 0.0])
            defects[index, 3] = across @ lift - one[:, 2] @ turn + 4.0 * np.pi * np.eye(3)[2]
    return defects


def impose_rigid_motions(grid: SurfaceGrid, rows: Sequence[int], double: Array) -> None:
    """Make the rows reproduce D psi = 4 pi psi for rigid motions exactly, by their own entries.

    Only the entries that couple the target to itself change, by as much as the quadrature misses.
    A slender (or flat) body bends almost freely, so that an error delta in these identities
    reaches the motion as delta / k^3: rounding alone costs seven digits at k = 1/100 without this.
    """
    defects = rigid_defects(grid, rows, double)
    for index, row in enumerate(rows):
        zero = double[index, 0]
        zero[:, 2, row] -= defects[index, 0]
        zero[:, 1, row] -= defects[index, 1]
        if double.shape[1] > 1:
            one = double[index, 1]
            one[:, :2, row] -= 0.5 * defects[index, 2][:, None]
            # The correction of the translation sits at the target's own height and does not turn.
            one[:, 2, row] += defects[index, 3]


def blocks_from_rows(rows: Array) -> Array:
    """Blocks (n_modes, 3 n_theta, 3 n_theta) from the independent rows, completed by symmetry.

    Under z -> -z the z component changes sign and theta runs backwards; rows that are there already
    stay.
    """
    n_rows, n_modes, _, _, n_theta = rows.shape
    blocks = np.empty((n_modes, 3, n_theta, 3, n_theta))
    sign = np.array([1.0, 1.0, -1.0])
    mirrored = rows[..., ::-1] * (sign[:, None] * sign)[:, :, None]
    for i in range(n_rows):
        blocks[:, :, i] = rows[i]
        if n_theta - 1 - i >= n_rows:
            blocks[:, :, n_theta - 1 - i] = mirrored[i]
    return blocks.reshape(n_modes, 3 * n_theta, 3 * n_theta)
