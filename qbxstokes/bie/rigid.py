"""Rigid-body motions of the surface as azimuthal modes, and projections on them.

Motions along and about the axis live in mode 0, those across it in mode 1, where the amplitude of
the motion along (about) x is real and that along (about) y is -i times it: a complex amplitude
U_x - i U_y carries both.
"""

from dataclasses import dataclass

import numpy as np

from qbxstokes.geometry.grid import SurfaceGrid
from qbxstokes.typing import Array


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
