"""Rigid-body motions of the surface as azimuthal modes, and the resistance problem.

Motions along and about the axis live in mode 0, those across it in mode 1, where the amplitude of
the motion along (about) x is real and that along (about) y is -i times it: a complex amplitude
U_x - i U_y carries both. Force and torque on a body of given motion follow from the density psi,

    -4 pi psi + D[psi] + V[F, M] = V_b + Omega x (x - x_CM) - u_bg,   F, M linear in psi

(Bagge 2015, eq. 4.13, 4.15-4.16). V carries the force F and the torque M that the body exerts on
the fluid. It is either the point stokeslet and rotlet at the centre (Power & Miranda 1987) or a
single layer spread over the surface, smooth for every aspect ratio.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from qbxstokes.geometry.grid import SurfaceGrid
from qbxstokes.typing import Array

Completion = Literal["surface", "point"]


@dataclass(frozen=True)
class RigidMode:
    """One rigid motion: its mode m, amplitude (3 n_theta,) and projector (3 n_theta,).

    projector . density is the component of a density in the L2 projection on the motion.
    circle is the integral of cos^2(m phi) over the circle times the norm, so that
    circle * projector . density = integral of density times motion over the surface. phase times
    amplitude is the mode of the real motion: i for the rotation about the axis, whose phi / i
    component is imaginary, 1 otherwise.
    """

    mode: int
    amplitude: Array
    projector: Array
    circle: float
    phase: complex


def rigid_modes(grid: SurfaceGrid) -> dict[str, RigidMode]:
    """The four kinds of rigid motion: translation and rotation, axial and transverse.

    The transverse rotation is that about y, whose amplitude is real: (z, z, -rho).
    """
    rho, z = grid.shape.meridian(grid.theta)
    zero, one = np.zeros_like(rho), np.ones_like(rho)
    weights = np.tile(grid.theta_weights * grid.shape.area_element(grid.theta), 3)

    def make(mode: int, parts: list[Array], phase: complex = 1.0) -> RigidMode:
        amplitude = np.concatenate(parts)
        norm = float(weights @ amplitude**2)
        return RigidMode(
            mode,
            amplitude,
            weights * amplitude / norm,
            norm * (2.0 * np.pi if mode == 0 else np.pi),
            phase,
        )

    return {
        "translation_axial": make(0, [zero, zero, one]),
        # rho e_phi has the phi / i component -i rho.
        "rotation_axial": make(0, [zero, -rho, zero], 1j),
        "translation_transverse": make(1, [one, one, zero]),
        "rotation_transverse": make(1, [z, z, -rho]),
    }


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
