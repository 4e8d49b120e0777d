"""What is read off the axis of a body: orbit constant and period.

The axis D3 is described by its components (a, b, n) along stream, gradient and vorticity of the
shear: the rows of `frame` (3, 3), the axes of space for the flow (x2, 0, 0). Jeffery (Proc. R. Soc.
A 102, 1922, eqs. 48-50): on a free orbit in shear C is constant and the phase falls by 2 pi in
every period T = 2 pi (k + 1/k)/rate.
"""

import math

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.typing import Array


def orbit_constant(
    axis: ArrayLike, effective_ratio: float | Array, frame: ArrayLike | None = None
) -> Array:
    """C = sqrt(b^2 + k^2 a^2)/(k |n|), (..., 3) -> (...): 0 log-rolling, infinite tumbling."""
    d = np.asarray(axis, dtype=np.float64)
    if frame is not None:
        d = d @ np.asarray(frame, dtype=np.float64).T
    a, b, n = d[..., 0], d[..., 1], d[..., 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.hypot(b, effective_ratio * a) / (effective_ratio * np.abs(n)))


def orbit_axis(effective_ratio: ArrayLike, constant: ArrayLike, phase: ArrayLike) -> Array:
    """Axis (..., 3) on the Jeffery orbit C in the shear (x2, 0, 0), any length but zero.

    (C cos p, -C k sin p, 1), and its limit (cos p, -k sin p, 0) for infinite C; the phase p of a
    massless body grows by 2 pi in a period (Jeffery 1922, eqs. 48 f.).
    """
    k, c, p = (np.asarray(value, dtype=float) for value in (effective_ratio, constant, phase))
    # Both divided by 1 + C, so that tumbling needs no case of its own but the number itself.
    part = np.where(np.isinf(c), 1.0, c / (1.0 + np.where(np.isinf(c), 0.0, c)))
    return np.stack(np.broadcast_arrays(part * np.cos(p), -k * part * np.sin(p), 1.0 - part), -1)


def jeffery_period(gradient: Array, effective_ratio: float) -> float | None:
    """Period of a free spheroid's axis in a linear flow, None where it comes to rest.

    The axis follows the linear system dd/dt = (W + lambda E) d up to its length, with
    lambda = (1 - k^2)/(1 + k^2) (Bretherton 1962, J. Fluid Mech. 14, eq. 15 f.); a complex pair of
    eigenvalues +-i omega + sigma makes it turn with period 2 pi/omega. In a shear of rate 1 this
    is Jeffery's 2 pi (k + 1/k).
    """
    k = effective_ratio
    shape = (1.0 - k * k) / (1.0 + k * k)
    largest = float(np.abs(gradient).max())
    if not largest > 0.0:
        return None
    gradient = gradient / largest  # so that no rate is too large or too small for its square
    strain, spin = 0.5 * (gradient + gradient.T), 0.5 * (gradient - gradient.T)
    if not np.any(spin):
        return None
    # omega^2 = -(1/2) tr (W + lambda E)^2 when the third eigenvalue vanishes, which is exact for
    # plane flows where thin bodies make the eigenvalue problem ill-conditioned.
    system = spin + shape * strain
    if abs(np.linalg.det(system)) <= 1e-14 * np.abs(system).max() ** 3:
        squared = 0.5 * float(np.sum(spin * spin) - shape**2 * np.sum(strain * strain))
        omega = math.sqrt(max(0.0, squared))
    else:
        omega = float(np.abs(np.linalg.eigvals(system).imag).max())
    return 2.0 * math.pi / omega / largest if omega > 0.0 else None
