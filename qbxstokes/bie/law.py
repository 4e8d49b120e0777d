"""The law of a body as tensors about a stated point: loads of a motion, free motion, stresslet.

Body frame, mu = 1. About a point p the background u = U0 + W0 x (x - p) + E (x - p) exerts on a
body of velocity V at p and angular velocity Omega the force F, the torque T about p and the
stresslet S,

    (F, T, S) = R (U0 - V, W0 - Omega, E),   R symmetric and positive definite

(S. Kim & S. J. Karrila 1991, Microhydrodynamics, section 5.2), E and S by their components on five
orthonormal strain rates e_a. With K the matrix that takes (U0, W0, E) from p to the centre c = 0,

    U0(c) = U0 - W0 x p - E p,   R(p) = K^T R(c) K.

At the centre, bodies of revolution with fore-aft symmetry leave ten numbers, which kernels exploit:
two resistances each to translation and rotation, lambda, and S0, S1, S2.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from qbxstokes.bie.functional import BodyModel, GridFunctional, ModalFunctional
from qbxstokes.bie.resolution import resolving_nodes
from qbxstokes.bie.stresslet import STRAINS, Stresslet
from qbxstokes.typing import Array

_AXIS: Array = np.array([0.0, 0.0, 1.0])
# e_a (5, 3, 3): symmetric, traceless, orthonormal; axial, twice oblique, twice across the axis.
STRAIN_BASIS: Array = STRAINS / np.linalg.norm(STRAINS, axis=(1, 2))[:, None, None]


def shift(point: Array) -> Array:
    """K (11, 11): (velocity, spin, strain) of a linear flow about a point (3,) to the centre.

    K[:6, :6] does so for a rigid motion, its transpose for (force, torque) the other way.
    """
    found = np.eye(11)
    found[:3, 3:6] = np.cross(point, np.eye(3)).T
    found[:3, 6:] = -(STRAIN_BASIS @ point).T
    return found


@dataclass(frozen=True)
class BodyLaw:
    """The law about a point (3,) of the body frame, in polar radii from the centre.

    stress: gives the stresslet, which is formed when first needed.
    """

    model: BodyModel
    functional: ModalFunctional
    stress: Callable[[], Stresslet]
    about: Array

    @property
    def resistance(self) -> Array:
        """R (6, 6): (force, torque) ON the body = -R (V, Omega)."""
        k = shift(self.about)[:6, :6]
        return np.asarray(k.T @ self.model.resistance.matrix @ k)

    @property
    def mobility(self) -> Array:
        """M (6, 6) = R^-1: (V, Omega) = M (force, torque) from outside."""
        back = shift(-self.about)[:6, :6]
        return np.asarray(back @ self.model.resistance.mobility @ back.T)

    @property
    def grand_resistance(self) -> Array:
        """R (11, 11): (F, T, S_a) = R (U0 - V, W0 - Omega, E_a), a as in `STRAIN_BASIS`."""
        central = np.zeros((11, 11))
        central[:6, :6] = self.model.resistance.matrix
        # Omega = W0 + turn E of the free body, and its stresslet in the order of the strains.
        turn = self.model.faxen.linear * np.cross(_AXIS, STRAIN_BASIS @ _AXIS).T
        central[3:6, 6:] = central[3:6, 3:6] @ turn
        central[6:, 3:6] = central[3:6, 6:].T
        central[6:, 6:] = np.diag(self.stress().numbers[[0, 1, 1, 2, 2]])
        central[6:, 6:] += turn.T @ central[3:6, 6:]
        k = shift(self.about)
        return np.asarray(k.T @ central @ k)

    def on_grid(self, n_theta: int, n_phi: int) -> GridFunctional:
        """(U, Omega, S_a) of the free body as weights (11, N, 3) on the velocity at points (N, 3).

        U is the velocity of the point `about`.
        """
        motion = self.functional.on_grid(n_phi, n_theta)
        back = shift(-self.about)[:6, :6]
        rows = np.tensordot(back, motion.weights, axes=1)
        stress = self.stress().functional.on_grid(n_phi, n_theta).weights
        norms = np.linalg.norm(STRAINS, axis=(1, 2))[:, None, None]
        return GridFunctional(motion.points, np.concatenate([rows, stress / norms]))

    def free(
        self, velocity: Callable[[Array], Array], tolerance: float = 1e-10
    ) -> tuple[Array, Array, Array]:
        """U, Omega (3,) and S (3, 3) of the body free of force and torque in a background flow.

        velocity: points (N, 3) -> (N, 3), body frame, a Stokes flow around the body. Raises
        FlowError where no grid resolves it to the relative tolerance.
        """
        n_theta, n_phi, _ = resolving_nodes(self.functional, velocity, tolerance)
        # The stresslet weighs the next degree; the finer grid is the one that was compared with.
        grid = self.on_grid(3 * n_theta // 2 + 2, 3 * n_phi // 2 + 2)
        found = np.einsum("anj,nj->a", grid.weights, velocity(grid.points))
        return found[:3], found[3:6], np.tensordot(found[6:], STRAIN_BASIS, axes=1)
