"""Azimuthal modes of the layer potentials at one target, from spherical-harmonic coefficients.

The counterpart of `kernel.target_row` that sums each expansion from its z_lm (`expansion`), for
comparison with it and with the thesis.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from qbxstokes.qbx.expansion import expanded_kernels
from qbxstokes.qbx.kernel import interpolation_weights, tell_apart

Array = NDArray[np.float64]
Integers = NDArray[np.int64]


def harmonic_row(
    aspect_ratio: float,
    theta_target: float,
    side: int,
    radius: float,
    order: int,
    theta_nodes: Array,
    theta_weights: Array,
    phi_start: Integers,
    phi_stop: Integers,
    phi_nodes: Array,
    phi_weights: Array,
    grid_theta: Array,
    barycentric: Array,
    cosine: bool,
    n_modes: int,
    with_single: bool,
    row_double: Array,
    row_single: Array,
) -> None:
    """Add the modes at the target to row_double and row_single; see `kernel.target_row`."""
    k = aspect_ratio
    st, ct = math.sin(theta_target), math.cos(theta_target)
    q = math.hypot(st, k * ct)
    target = np.array([k * st, 0.0, ct])
    centre = target + side * radius * np.array([st / q, 0.0, k * ct / q])
    even, odd, same, other = np.empty((4, grid_theta.size))
    m = np.arange(n_modes)
    for theta, weight, start, stop in zip(
        theta_nodes, theta_weights, phi_start, phi_stop, strict=True
    ):
        phi = phi_nodes[start:stop]
        s, c = math.sin(theta), math.cos(theta)
        cosines, sines, zero = np.cos(phi), np.sin(phi), np.zeros_like(phi)
        sources = np.stack([k * s * cosines, k * s * sines, np.full_like(phi, c)], axis=-1)
        # n dS = k sin(theta) (sin(theta) e_rho + k cos(theta) e_z) dtheta dphi
        normals = k * s * np.stack([s * cosines, s * sines, np.full_like(phi, k * c)], axis=-1)
        directions = np.stack(
            [
                np.stack([cosines, sines, zero], axis=-1),
                np.stack([-sines, cosines, zero], axis=-1),
                np.stack([zero, zero, zero + 1.0], axis=-1),
            ],
            axis=-1,
        )
        kernels = expanded_kernels(target, sources, normals, centre, radius, order)
        interpolation_weights(theta, grid_theta, barycentric, cosine, even, odd)
        angle = np.outer(m, phi)
        # Entries even in phi meet the cosine; those with one index phi / i the sine.
        circle = np.empty((3, 3, n_modes, phi.size))
        circle[:] = np.cos(angle)
        circle[:, 1] = -np.sin(angle)
        circle[1, :] = np.sin(angle)
        circle[1, 1] = np.cos(angle)
        rows = [(row_double, kernels[0], weight)]
        if with_single:
            rows.append((row_single, kernels[1], weight * s / (8.0 * math.pi)))
        for row, kernel, scale in rows:
            cylindrical = np.einsum("nij,njb,n->ibn", kernel, directions, phi_weights[start:stop])
            sums = scale * np.einsum("abn,abmn->mab", cylindrical, circle)
            for mode in range(n_modes):
                along, across = (even, odd) if mode % 2 == 0 else (odd, even)
                tell_apart(s, grid_theta, across, cosine and mode > 0, same, other)
                row[mode, :, 0] += np.outer(sums[mode, :, 0], same)
                row[mode, :, 0] += np.outer(sums[mode, :, 1], other)
                row[mode, :, 1] += np.outer(sums[mode, :, 1], same)
                row[mode, :, 1] += np.outer(sums[mode, :, 0], other)
                row[mode, :, 2] += np.outer(sums[mode, :, 2], along)
