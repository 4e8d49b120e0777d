"""Kernels of an expansion from its spherical-harmonic coefficients, for rows of the operators.

The counterpart of `kernel.target_specific` that sums each expansion from its z_lm (`expansion`),
for comparison with it and with the thesis.
"""

from __future__ import annotations

import math

import numpy as np

from qbxstokes.qbx.expansion import expanded_kernels
from qbxstokes.qbx.kernel import Centre
from qbxstokes.typing import Array


def from_coefficients(
    centre: Centre, theta: Array, phi: Array, with_single: bool
) -> tuple[Array, Array | None]:
    """Kernels at the sources, as `kernel.Kernels` has them."""
    rho_t, tx, tz = centre.target
    target = np.array([rho_t, 0.0, float(centre.shape.meridian(np.asarray(centre.theta))[1])])
    place = target + centre.side * centre.radius * np.array([tx, 0.0, tz])
    shape = (3, 3, *np.broadcast_shapes(theta.shape, phi.shape))
    theta, phi = (each.ravel() for each in np.broadcast_arrays(theta, phi))
    (rho, z), cp, sp = centre.shape.meridian(theta), np.cos(phi), np.sin(phi)
    zero, one = np.zeros_like(phi), np.ones_like(phi)
    sources = np.stack([rho * cp, rho * sp, z], axis=-1)
    nr, nz = centre.shape.area_vector(theta)
    normals = np.stack([nr * cp, nr * sp, nz], axis=-1)
    # Components (Cartesian, cylindrical, n) of the source's directions.
    directions = np.array([[cp, -sp, zero], [sp, cp, zero], [zero, zero, one]])
    double, single = (
        np.einsum("nij,jbn->ibn", kernel, directions)
        for kernel in expanded_kernels(target, sources, normals, place, centre.radius, centre.order)
    )
    scaled = single * (np.sin(theta) / (8.0 * math.pi))
    return double.reshape(shape), scaled.reshape(shape) if with_single else None
