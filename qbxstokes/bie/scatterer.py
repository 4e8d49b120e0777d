"""One body as its neighbours see it: boundary velocity -> exterior flow, force and torque.

The velocity v on the surface grid is matched by the Stokes single layer whose density is a sum of
spheroidal harmonics (`qbx.exterior`); outside it is B + grad(C - x . B) with B and C sums of
exterior spheroidal harmonics, from the surface to infinity. The map is small blocks per azimuthal
mode, shared by all bodies of one shape and unchanged when they move. Lengths in the polar
radius.
"""

from functools import cached_property, lru_cache
from itertools import combinations_with_replacement

import numpy as np

from qbxstokes.geometry.grid import SurfaceGrid
from qbxstokes.geometry.shape import Revolution
from qbxstokes.qbx.confocal import triangle
from qbxstokes.qbx.exterior import SurfaceToExterior
from qbxstokes.typing import Array, Integers

# Numbers of degrees 0 and 1, which hold force and torque; polar nodes of a fine grid.
LOW, _FINE = 6, 24


class Scatterer(SurfaceToExterior):
    """Exterior flows from velocities on n polar and 2 n azimuthal nodes; made by `scatterer`."""

    @cached_property
    def rigid(self) -> Array:
        """The six rigid motions on the grid, (6, N, 3)."""
        x = self.grid.points
        unit = np.eye(3)
        return np.stack(
            [np.broadcast_to(e, x.shape) for e in unit] + [np.cross(e, x) for e in unit]
        )

    @cached_property
    def resistance(self) -> Array:
        """Diagonal (6,) of the resistance of the body alone: (force, torque) on the fluid."""
        return np.array([self.loads(flow)[i] for i, flow in enumerate(self.rigid_flows)])

    @cached_property
    def rigid_flows(self) -> Array:
        """Packed flows (6, 4, LOW) of the rigid motions: they have no more than degrees 0 and 1."""
        return np.stack([self.packed(v, self.inverse)[:, :LOW] for v in self.rigid])

    def loads(self, flow: Array) -> Array:
        """Force and torque (6,) on the fluid of a packed flow, body frame."""
        return self._loads @ flow[:, :LOW].ravel()

    @cached_property
    def _loads(self) -> Array:
        """Force and torque (6, 4 * LOW) of the lowest coefficients, packed."""
        units = np.eye(4 * LOW).reshape(-1, 4, LOW)
        return np.stack([self.harmonics.force_torque(unit) for unit in units], axis=1)

    @cached_property
    def root_weights(self) -> Array:
        """Root (N, 1) of the weights of the parameter sphere, normalised to sum of squares 1."""
        w = np.repeat(self.grid.theta_weights * np.sin(self.grid.theta), self.grid.n_phi)
        return np.asarray(np.sqrt(w / w.sum())[:, None])

    def degrees_for(self, points: Array, tolerance: float) -> Integers:
        """Degrees (N,) beyond which harmonics are below tolerance at points of the body frame."""
        from qbxstokes.qbx.exterior_basis import degrees_for

        found, k = np.empty(len(points), dtype=np.int64), self.harmonics.ratio_of_axes
        degrees_for(np.ascontiguousarray(points), k, tolerance, self.harmonics.degree, found)
        return found

    @cached_property
    def lowest(self) -> tuple[Array, Array]:
        """Velocities (M, N, 3) linear in the place, on fine grids of discs quadratic; their flows.

        Orthonormal with the weights; packed flows, of harmonics of one degree more at most.
        """
        fine = self.grid.n_theta >= _FINE and self.harmonics.ratio_of_axes > 1.0
        x, degree = self.grid.points, 2 if fine else 1
        powers = [x[:, i] * x[:, j] for i, j in combinations_with_replacement(range(3), 2)]
        functions = np.stack([np.ones(len(x)), *x.T, *(powers[:5] if degree == 2 else ())], axis=1)
        functions = np.linalg.qr(self.root_weights * functions)[0] / self.root_weights
        found = [np.outer(f, e) for f in functions.T for e in np.eye(3)]
        below = 2 * int(triangle(degree + 3, degree + 2)[2][-1])
        flows = [self.packed(v, self.inverse)[:, :below] for v in found]
        return np.stack(found), np.ascontiguousarray(np.stack(flows))

    def moving(self, motion: Array) -> Array:
        """Packed flow (4, LOW) of the body moving alone (6,)."""
        return (motion @ self.rigid_flows.reshape(6, -1)).reshape(4, LOW)


@lru_cache(maxsize=64)
def scatterer(shape: Revolution, n: int) -> Scatterer:
    """The one scatterer of a shape and a number of polar nodes."""
    return Scatterer(SurfaceGrid(shape, n, 2 * n), n - 2)
