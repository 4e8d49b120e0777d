"""The mobility problem: free motion of a body of given force and torque.

    -4 pi psi + D[psi] - U[psi] - Omega[psi] x (x - x_CM) = -V[F, M] - u_bg

with U, Omega 4 pi times the L2 projections of psi on the rigid motions (Bagge 2015, eq. 4.13 and
4.17-4.18, with the sign that moves the null space of -4 pi + D to -4 pi, on the side of the rest of
its spectrum [-8 pi, 0]).
"""

import numpy as np

from qbxstokes.bie.rigid import RigidMode
from qbxstokes.typing import Array


def mobility_blocks(double: Array, rigid: dict[str, RigidMode]) -> Array:
    """Blocks of the mobility operator from those of the double layer, (n_modes, 3n, 3n)."""
    blocks = double - 4.0 * np.pi * np.eye(double.shape[-1])
    for motion in rigid.values():
        if motion.mode < len(blocks):
            blocks[motion.mode] -= 4.0 * np.pi * np.outer(motion.amplitude, motion.projector)
    return blocks
