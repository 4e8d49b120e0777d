"""Local expansions of the layer potentials in spherical harmonics, coefficients z_lm and all.

The Stokes double layer is four Laplace double layers L[rho](x) = int rho_i r_i/|r|^3 dS
(Tornberg & Greengard 2008; Bagge 2015, eq. 5.12, 5.18-5.21, with the minus signs):

    T_ijk n_k psi_j = (r_j d/dx_i - delta_ij) L_k n_k psi_j + (r_k d/dx_i - delta_ik) L_j n_k psi_j,
    D_i[psi] = (x_j d/dx_i - delta_ij) L[psi_j n + n_j psi] - d/dx_i L[(y.psi) n + (y.n) psi],

coordinates relative to the centre, and each is expanded as (eq. 5.14-5.17, 5.22-5.23)

    L[rho](x) = sum_l sum_m |x|^l Y_l^-m(x) z_lm,   z_lm = int rho . grad_y(Y_l^m(y)/|y|^(l+1)) dS,

Y_l^m = sqrt((l-|m|)!/(l+|m|)!) P_l^|m|(cos) exp(i m phi); the factor sqrt((2l+1)/4 pi) that some
give Y cancels 4 pi/(2l+1) in the sum. A real density needs m >= 0 alone: z_l,-m = conj z_lm.

Lengths are scaled by the expansion radius, so that powers neither overflow nor vanish. The form at
one target (`kernel.target_specific`) is the same number at a cost of O(p) instead of O(p^2).
"""

import math

import numpy as np

from qbxstokes.qbx.kernel import Centre
from qbxstokes.typing import Array, ComplexArray


def count(order: int) -> int:
    """Number of coefficients with 0 <= m <= l <= order (eq. 5.26 for one layer)."""
    return (order + 1) * (order + 2) // 2


def _place(l: int, m: int) -> int:
    return l * (l + 1) // 2 + m


def _norms(order: int) -> Array:
    """sqrt((l-m)! (l+m)!), which the scaled recurrences below leave out of Y_l^m."""
    return np.array(
        [
            math.exp(0.5 * (math.lgamma(l - m + 1) + math.lgamma(l + m + 1)))
            for l in range(order + 1)
            for m in range(l + 1)
        ]
    )


def _irregular(y: Array, order: int) -> ComplexArray:
    """(l-m)! P_l^m exp(i m phi)/|y|^(l+1), shape (count, n)."""
    inverse = 1.0 / np.einsum("ni,ni->n", y, y)
    plane, height = (y[:, 0] + 1j * y[:, 1]) * inverse, y[:, 2] * inverse
    values = np.empty((count(order), len(y)), dtype=np.complex128)
    values[0] = np.sqrt(inverse)
    for m in range(order + 1):
        if m:
            values[_place(m, m)] = (2 * m - 1) * plane * values[_place(m - 1, m - 1)]
        for l in range(m + 1, order + 1):
            value = (2 * l - 1) * height * values[_place(l - 1, m)]
            if l > m + 1:
                value -= (l + m - 1) * (l - m - 1) * inverse * values[_place(l - 2, m)]
            values[_place(l, m)] = value
    return values


def _regular(x: Array, order: int) -> ComplexArray:
    """|x|^l P_l^m exp(i m phi)/(l+m)!, shape (count, n)."""
    square = np.einsum("ni,ni->n", x, x)
    plane, height = x[:, 0] + 1j * x[:, 1], x[:, 2]
    values = np.empty((count(order), len(x)), dtype=np.complex128)
    values[0] = 1.0
    for m in range(order + 1):
        if m:
            values[_place(m, m)] = plane * values[_place(m - 1, m - 1)] / (2 * m)
        for l in range(m + 1, order + 1):
            value = (2 * l - 1) * height * values[_place(l - 1, m)]
            if l > m + 1:
                value -= square * values[_place(l - 2, m)]
            values[_place(l, m)] = value / ((l - m) * (l + m))
    return values


def _gradient(values: ComplexArray, order: int, step: int) -> ComplexArray:
    """Gradients (3, count, n) from the neighbouring degrees; step +1 irregular, -1 regular.

    d/dz raises (lowers) l, d/dx +- i d/dy m as well (Hobson 1931, sections 88-90).
    """
    gradient = np.zeros((3, count(order), values.shape[1]), dtype=np.complex128)
    sign = -step
    for l in range(order + 1):
        other = l + step
        for m in range(l + 1):
            up = -values[_place(other, m + 1)] if m + 1 <= other else 0.0
            down = np.conj(up)
            if m:
                down = values[_place(other, m - 1)] if m - 1 <= other else 0.0
            place = _place(l, m)
            gradient[0, place] = 0.5 * (up + down)
            gradient[1, place] = -0.5j * (up - down)
            if 0 <= m <= other:
                gradient[2, place] = sign * values[_place(other, m)]
    return gradient


def irregular_harmonics(y: Array, order: int) -> tuple[ComplexArray, ComplexArray]:
    """Y_l^m(y)/|y|^(l+1), (count, n), and its gradients (3, count, n), for points y (n, 3)."""
    values = _irregular(y, order + 1)
    norms = _norms(order)[:, None]
    return values[: count(order)] / norms, _gradient(values, order, 1) / norms


def regular_harmonics(x: Array, order: int) -> tuple[ComplexArray, ComplexArray]:
    """|x|^l Y_l^m(x), (count, n), and its gradients (3, count, n), for points x (n, 3)."""
    values = _regular(x, order)
    norms = _norms(order)[:, None]
    return values * norms, _gradient(values, order, -1) * norms


def _twice(order: int) -> Array:
    """How often each coefficient counts when m < 0 is left out."""
    return np.array([1.0 if m == 0 else 2.0 for l in range(order + 1) for m in range(l + 1)])


def expanded_kernels(
    target: Array, sources: Array, normals: Array, centre: Array, radius: float, order: int
) -> tuple[Array, Array]:
    """Kernels (n, 3, 3) of the double and the single layer at one target, summed from z_lm.

    Column j is the expansion of a unit density along j at each source, evaluated at the target
    (3,): what the coefficients give, without storing them. The single layer is
    S_p delta_ij - r_j dS_p/dx_i, S_p the expansion of 1/|r|, without the factor 1/(8 pi).
    """
    x = ((target - centre) / radius)[None]
    y = (sources - centre) / radius
    inner, inner_slopes = regular_harmonics(x, order)
    outer, outer_slopes = irregular_harmonics(y, order)
    weight = _twice(order)
    value = weight * np.conj(inner[:, 0])
    slope = weight * np.conj(inner_slopes[:, :, 0])
    r, s, ds = x - y, (value @ outer).real, (slope @ outer).real.T
    g = np.einsum("l,jln->nj", value, outer_slopes).real
    h = np.einsum("il,jln->nij", slope, outer_slopes).real
    eye = np.eye(3)
    double = (
        np.einsum("nik,nk,nj->nij", h, normals, r)
        + np.einsum("nk,nk,nij->nij", r, normals, h)
        - np.einsum("nk,nk,ij->nij", g, normals, eye)
        - np.einsum("ni,nj->nij", normals, g)
    )
    single = s[:, None, None] * eye - np.einsum("ni,nj->nij", ds, r)
    return double / radius**2, single / radius


def from_coefficients(
    centre: Centre, theta: Array, phi: Array, with_single: bool
) -> tuple[Array, Array | None]:
    """Kernels at the sources, as `kernel.Kernels` has them, from the coefficients z_lm."""
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
