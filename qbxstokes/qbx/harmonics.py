"""Kernels of an expansion from its spherical-harmonic coefficients, for rows of the operators.

The counterpart of `kernel.target_specific` that sums each expansion from its z_lm (`expansion`),
for comparison with it and with the thesis.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from qbxstokes.qbx.expansion import expanded_kernels
from qbxstokes.qbx.kernel import Centre

Array = NDArray[np.float64]


def from_coefficients(
    centre: Centre, theta: Array, phi: Array, with_single: bool
) -> tuple[Array, Array | None]:
    """Kernels at the sources, as `kernel.Kernels` has them."""
    k = centre.aspect_ratio
    st, ct = math.sin(centre.theta), math.cos(centre.theta)
    q = math.hypot(st, k * ct)
    target = np.array([k * st, 0.0, ct])
    place = target + centre.side * centre.radius * np.array([st / q, 0.0, k * ct / q])
    shape = (3, 3, *np.broadcast_shapes(theta.shape, phi.shape))
    theta, phi = (each.ravel() for each in np.broadcast_arrays(theta, phi))
    s, c, cp, sp = np.sin(theta), np.cos(theta), np.cos(phi), np.sin(phi)
    zero, one = np.zeros_like(phi), np.ones_like(phi)
    sources = np.stack([k * s * cp, k * s * sp, c], axis=-1)
    # n dS = k sin(theta) (sin(theta) e_rho + k cos(theta) e_z) dtheta dphi
    normals = (k * s)[:, None] * np.stack([s * cp, s * sp, k * c], axis=-1)
    # Components (Cartesian, cylindrical, n) of the source's directions.
    directions = np.array([[cp, -sp, zero], [sp, cp, zero], [zero, zero, one]])
    double, single = (
        np.einsum("nij,jbn->ibn", kernel, directions)
        for kernel in expanded_kernels(target, sources, normals, place, centre.radius, centre.order)
    )
    scaled = single * (s / (8.0 * math.pi))
    return double.reshape(shape), scaled.reshape(shape) if with_single else None
