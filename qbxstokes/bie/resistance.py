"""The resistance problem: force and torque on a body of given motion, and the completion flow.

    -4 pi psi + D[psi] + V[F, M] = V_b + Omega x (x - x_CM) - u_bg,   F, M linear in psi

(Bagge 2015, eq. 4.13, 4.15-4.16). V carries the force F and the torque M that the body exerts on
the fluid. It is either the point stokeslet and rotlet at the centre (Power & Miranda 1987) or a
single layer spread over the surface, smooth for every aspect ratio.
"""

from typing import Literal

import numpy as np

from qbxstokes.bie.rigid import RigidMode
from qbxstokes.geometry.grid import SurfaceGrid
from qbxstokes.typing import Array

Completion = Literal["surface", "point"]


def surface_completion(grid: SurfaceGrid, single: Array) -> dict[str, Array]:
    """Amplitudes (3 n_theta,) on the surface of the spread completion of unit force or torque.

    The density is (a + b x y) with measure sin(theta) dtheta dphi, that is a support-function
    weight; a gives the force 4 pi a, b a torque that the shape knows. single: blocks
    (>= 2, 3n, 3n) of the single layer.
    """
    rho, z = grid.shape.meridian(grid.theta)
    zero, one = np.zeros_like(rho), np.ones_like(rho)
    along = 1.0 / (4.0 * np.pi)
    across, _, about = grid.shape.torque_density
    return {
        "translation_axial": single[0] @ np.concatenate([zero, zero, along * one]),
        "rotation_axial": single[0] @ np.concatenate([zero, -about * rho, zero]),
        "translation_transverse": single[1] @ np.concatenate([along * one, along * one, zero]),
        "rotation_transverse": single[1] @ (across * np.concatenate([z, z, -rho])),
    }


def point_completion(grid: SurfaceGrid) -> dict[str, Array]:
    """The same for the stokeslet and the rotlet at the centre (Bagge 2015, eq. 4.9-4.11)."""
    rho, z = grid.shape.meridian(grid.theta)
    zero, one = np.zeros_like(rho), np.ones_like(rho)
    d = np.hypot(rho, z)
    c = 1.0 / (8.0 * np.pi)
    return {
        "translation_axial": c * np.concatenate([rho * z / d**3, zero, 1.0 / d + z * z / d**3]),
        "rotation_axial": c * np.concatenate([zero, -rho / d**3, zero]),
        "translation_transverse": c
        * np.concatenate([1.0 / d + rho * rho / d**3, one / d, rho * z / d**3]),
        "rotation_transverse": c * np.concatenate([z, z, -rho]) / np.tile(d**3, 3),
    }


def force_scale(motion: RigidMode, flow: Array) -> float:
    """Factor s in F = s * integral(psi . motion) that puts the completed eigenvalue at -4 pi."""
    return -4.0 * np.pi / (motion.circle * float(motion.projector @ flow))


def resistance_blocks(
    double: Array, rigid: dict[str, RigidMode], completion: dict[str, Array]
) -> Array:
    """Blocks of the resistance operator from those of the double layer, (n_modes, 3n, 3n)."""
    blocks = double - 4.0 * np.pi * np.eye(double.shape[-1])
    for name, motion in rigid.items():
        if motion.mode < len(blocks):
            flow = completion[name]
            scale = force_scale(motion, flow) * motion.circle
            blocks[motion.mode] += scale * np.outer(flow, motion.projector)
    return blocks
