"""Target-specific expansions of the Stokes double and single layer, summed over azimuth.

At one target the addition theorem collapses a spherical-harmonic expansion of order p about a
centre into a modified kernel of cost O(p) (Siegel & Tornberg 2018, J. Comput. Phys. 364, sec. 3,
for the Laplace and Stokes layers; Tornberg & Greengard 2008 for the harmonic form used here).

With x (target) and y (source) relative to the centre, rho = |x|/|y|, t = cos of the angle between
them, S_p = sum_{l<=p} |x|^l P_l(t) / |y|^(l+1), g = grad_y S_p and H = grad_x grad_y S_p, the
double layer kernel (T_ijk n_k as p -> infinity) is

    K_ij = (H n)_i r_j + (r.n) H_ij - (g.n) delta_ij - n_i g_j,      r = x - y,

and the single layer kernel (delta_ij/|r| + r_i r_j/|r|^3) is S_p delta_ij - r_j d S_p/dx_i.

Everything is arithmetic on arrays of sources: a row of the operator takes a few milliseconds, less
than it takes to load a compiler.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from qbxstokes.geometry.grid import SurfaceGrid
from qbxstokes.geometry.shape import Revolution
from qbxstokes.qbx.panels import Rule
from qbxstokes.typing import Array, Integers

# Sources taken together at most: few enough for their arrays to stay in the processor's cache.
_CHUNK = 4096


@dataclass(frozen=True)
class Centre:
    """An expansion on the meridian phi = 0: target, side (+1 outer), radius, order."""

    shape: Revolution
    theta: float
    side: int
    radius: float
    order: int

    @property
    def target(self) -> tuple[float, float, float]:
        """Distance of the target from the axis, and the normal there, along rho and z."""
        at = np.asarray(self.theta)
        d_rho, d_z = self.shape.tangent(at)
        speed = math.hypot(d_z, d_rho)
        return float(self.shape.meridian(at)[0]), float(-d_z) / speed, float(d_rho) / speed


class Kernels(Protocol):
    """What gives the kernels of one expansion at sources of the same shape: arrays (3, 3, ...).

    Rows are the target's components (x, y, z) = (rho, phi, z), columns the source's cylindrical
    ones. The double layer includes the measure dS / (dtheta dphi); the single layer has the factor
    1/(8 pi) and the measure sin(theta), the weight of the support function, for which it stays
    smooth at any aspect ratio. The second array is None unless with_single.
    """

    def __call__(
        self, centre: Centre, theta: Array, phi: Array, with_single: bool
    ) -> tuple[Array, Array | None]:
        """Kernels at the sources, theta (panels, n, 1) and phi (panels, 1, m)."""


def expansion_sums(order: int, rho: Array, t: Array) -> tuple[Array, ...]:
    """Sums of the Legendre series at n sources: A1, A2, S and the terms that close B1, B2, C.

    A1 = sum_{l=1..p} rho^l P_l'(t), A2 = sum rho^l P_l''(t), S = sum_{l=0..p} rho^l P_l(t); then
    the terms l = p of A1 and A2, and the terms l = p + 1. P_l' and P_l'' follow the Gegenbauer
    recurrences (DLMF 18.9.1) with rho^l folded in, so that nothing overflows whatever the order.
    """
    rt, square = rho * t, rho * rho
    first, second, series = np.zeros_like(rho), np.zeros_like(rho), np.ones_like(rho)
    last1, last2 = np.zeros_like(rho), np.zeros_like(rho)
    next1, next2 = rho.copy(), np.zeros_like(rho)
    for l in range(1, order + 1):
        # next1 and next2 are the terms of degree l, last1 and last2 those of degree l - 1.
        first += next1
        second += next2
        # l P_l = t P_l' - P_{l-1}'
        series += (t * next1 - rho * last1) / l
        after1 = ((2 * l + 1) / l) * rt * next1 - ((l + 1) / l) * square * last1
        if l == 1:
            after2 = 3.0 * square
        else:
            after2 = ((2 * l + 1) / (l - 1)) * rt * next2
            after2 -= ((l + 2) / (l - 1)) * square * last2
        last1, next1, last2, next2 = next1, after1, next2, after2
    return first, second, series, last1, last2, next1, next2


def target_specific(
    centre: Centre, theta: Array, phi: Array, with_single: bool
) -> tuple[Array, Array | None]:
    """Kernels of an expansion in the form for its own target, `Kernels`."""
    shape, radius = centre.shape, centre.radius
    rho_t, tx, tz = centre.target
    # Direction from the centre to the target.
    hx, hz = -centre.side * tx, -centre.side * tz
    cp, sp = np.cos(phi), np.sin(phi)
    # Differences source - target: exact to rounding however close they are.
    d_rho, dz = shape.difference(theta, centre.theta)
    dx = d_rho * cp - (2.0 * rho_t) * np.sin(0.5 * phi) ** 2
    dy = shape.meridian(theta)[0] * sp
    # The source from the centre, which lies at -radius h from the target.
    ux, uz = dx + radius * hx, dz + radius * hz
    v = 1.0 / np.sqrt(ux * ux + dy * dy + uz * uz)
    ux, uy, uz = ux * v, dy * v, uz * v
    rho, t = radius * v, ux * hx + uz * hz
    a1, a2, series, last1, last2, next1, next2 = expansion_sums(centre.order, rho, t)
    inverse = 1.0 / rho
    b1 = (a1 + next1) * inverse
    b2 = (a2 + next2) * inverse
    cc = rho * (a2 - last2)
    v2 = v * v
    f = v2 * v * inverse
    # n dS / (dtheta dphi)
    nr, nz = shape.area_vector(theta)
    nx, ny = nr * cp, nr * sp
    hn = hx * nx + hz * nz
    un = ux * nx + uy * ny + uz * nz
    # H n = alpha h + beta u + gamma n
    alpha = f * (a2 * un - cc * hn)
    beta = f * (a2 * hn - b2 * un)
    gamma = f * a1
    hn_x = alpha * hx + beta * ux + gamma * nx
    hn_y = beta * uy + gamma * ny
    hn_z = alpha * hz + beta * uz + gamma * nz
    # r = x - y, h and u in the source's cylindrical directions (rho, phi, z)
    rr = -(dx * cp + dy * sp)
    rp = dx * sp - dy * cp
    rz = -dz
    rn = rr * nr + rz * nz
    hr, hp = hx * cp, -hx * sp
    ur, up = ux * cp + uy * sp, uy * cp - ux * sp
    gr = v2 * (a1 * hr - b1 * ur)
    gp = v2 * (a1 * hp - b1 * up)
    gz = v2 * (a1 * hz - b1 * uz)
    # (r.n) H_ij = h_j q_i + u_j w_i + delta_ij (r.n) f a1
    fr = f * rn
    qx, qy, qz = fr * (a2 * ux - cc * hx), fr * a2 * uy, fr * (a2 * uz - cc * hz)
    wx, wy, wz = fr * (a2 * hx - b2 * ux), -fr * b2 * uy, fr * (a2 * hz - b2 * uz)
    diagonal = fr * a1 - (gr * nr + gz * nz)
    double = np.empty((3, 3, *v.shape))
    double[0, 0] = hn_x * rr + qx * hr + wx * ur + diagonal * cp - nx * gr
    double[0, 1] = hn_x * rp + qx * hp + wx * up - diagonal * sp - nx * gp
    double[0, 2] = hn_x * rz + qx * hz + wx * uz - nx * gz
    double[1, 0] = hn_y * rr + qy * hr + wy * ur + diagonal * sp - ny * gr
    double[1, 1] = hn_y * rp + qy * hp + wy * up + diagonal * cp - ny * gp
    double[1, 2] = hn_y * rz + qy * hz + wy * uz - ny * gz
    double[2, 0] = hn_z * rr + qz * hr + wz * ur - nz * gr
    double[2, 1] = hn_z * rp + qz * hp + wz * up - nz * gp
    double[2, 2] = hn_z * rz + qz * hz + wz * uz + diagonal - nz * gz
    if not with_single:
        return double, None
    scale = np.sin(theta) / (8.0 * math.pi)
    sv = scale * series * v
    e1 = scale * v2 * a1 * inverse
    e2 = scale * v2 * (last1 - a1)
    ex, ey, ez = e1 * ux + e2 * hx, e1 * uy, e1 * uz + e2 * hz
    single = np.empty_like(double)
    single[0, 0] = sv * cp - ex * rr
    single[0, 1] = -sv * sp - ex * rp
    single[0, 2] = -ex * rz
    single[1, 0] = sv * sp - ey * rr
    single[1, 1] = sv * cp - ey * rp
    single[1, 2] = -ey * rz
    single[2, 0] = -ez * rr
    single[2, 1] = -ez * rp
    single[2, 2] = sv - ez * rz
    return double, single


def interpolation(
    theta: Array, grid_theta: Array, barycentric: Array, cosine: bool
) -> tuple[Array, Array]:
    """Matrices (n, n_theta) of interpolation for components even and odd across the pole.

    Barycentric formula of the second kind (Berrut & Trefethen 2004, eq. 4.2): of polynomials in
    theta, or with cosine of polynomials in cos(theta), times sin(theta) for the odd components.
    """
    delta = theta[:, None] - grid_theta
    if cosine:
        delta = np.sin(0.5 * (theta[:, None] + grid_theta)) * np.sin(0.5 * delta)
    at_node = delta == 0.0
    even = barycentric / np.where(at_node, 1.0, delta)
    hit = at_node.any(axis=1)
    even[hit] = at_node[hit]
    even /= even.sum(axis=1, keepdims=True)
    odd = even * (np.sin(theta)[:, None] / np.sin(grid_theta)) if cosine else even
    return even, odd


def density_parts(
    m: int, theta: Array, grid: SurfaceGrid, even: Array, odd: Array
) -> tuple[Array, Array, Array]:
    """Interpolation (n, n_theta) of mode m: z from z, rho from rho (and phi from phi), and across.

    On a grid in cos(theta) the density is a polynomial in cos(theta) times the power of sin(theta)
    with which a smooth field vanishes at the pole: for m >= 1 the component z as sin^m, the
    combinations rho + phi / i and rho - phi / i as sin^(m-1) and sin^(m+1), of which the parity is
    kept and the square that tells the last two apart. That is exact for polynomial densities and
    leaves out fields that no polynomial approaches.
    """
    along, across = (even, odd) if m % 2 == 0 else (odd, even)
    apart: Array | float = 1.0
    if grid.nodes == "cosine" and m > 0:
        apart = (np.sin(theta)[:, None] / np.sin(grid.theta)) ** 2
    return along, 0.5 * (1.0 + apart) * across, 0.5 * (1.0 - apart) * across


def layer_row(
    centre: Centre,
    rule: Rule,
    grid: SurfaceGrid,
    n_modes: int,
    with_single: bool,
    kernels: Kernels = target_specific,
) -> tuple[Array, Array]:
    """Azimuthal modes (n_modes, 3, 3, n_theta) of the two layers at the centre's target.

    Value in cylindrical components (rho, phi, z) at the target (theta, phi = 0) of the layer with
    density psi_b(theta) exp(i m phi), the phi components carrying a factor i so that all is real:
    (u_rho, u_phi / i, u_z) = sum_b row[m, a, b, :] . (psi_rho, psi_phi / i, psi_z). The second
    array has n_modes = 0 unless with_single. rule: see `panels`. grid: that carries the density.
    """
    theta_nodes, theta_weights, phi_start, phi_stop, phi_nodes, phi_weights = rule
    modes = np.arange(n_modes)
    sums = [np.empty((3, 3, theta_nodes.size, n_modes)) for _ in range(1 + with_single)]
    for nodes, azimuths in _blocks(phi_start, phi_stop):
        phi = phi_nodes[azimuths]
        angle = phi[:, :, None] * modes
        weight = phi_weights[azimuths][:, :, None]
        cosine_m, sine_m = weight * np.cos(angle), weight * np.sin(angle)
        both = kernels(centre, theta_nodes[nodes][:, :, None], phi[:, None, :], with_single)
        for kernel, total in zip(both, sums, strict=False):
            assert kernel is not None
            part = kernel @ cosine_m
            # A product with i m phi: the entries that are odd in phi meet the sine.
            part[0, 1], part[2, 1] = -kernel[0, 1] @ sine_m, -kernel[2, 1] @ sine_m
            part[1, 0], part[1, 2] = kernel[1, 0] @ sine_m, kernel[1, 2] @ sine_m
            total[:, :, nodes] = part
    even, odd = interpolation(theta_nodes, grid.theta, grid.barycentric, grid.nodes == "cosine")
    even, odd = theta_weights[:, None] * even, theta_weights[:, None] * odd
    rows = [np.empty((n_modes, 3, 3, grid.n_theta)) for _ in sums]
    for m in range(n_modes):
        along, same, other = density_parts(m, theta_nodes, grid, even, odd)
        for row, total in zip(rows, sums, strict=True):
            rho, phi, z = total[:, 0, :, m], total[:, 1, :, m], total[:, 2, :, m]
            row[m, :, 0] = rho @ same + phi @ other
            row[m, :, 1] = phi @ same + rho @ other
            row[m, :, 2] = z @ along
    return rows[0], rows[1] if with_single else rows[0][:0]


def _blocks(start: Integers, stop: Integers) -> Iterator[tuple[Integers, Integers]]:
    """Panels of equal shape, of about `_CHUNK` sources at most in all.

    A panel is a run of theta nodes that share their azimuthal nodes. Yields the numbers of the
    theta nodes (panels, n) and of the azimuthal nodes (panels, m).
    """
    first = np.concatenate([[0], np.flatnonzero(np.diff(start)) + 1])
    height = np.diff(first, append=start.size)
    width = stop[first] - start[first]
    # Panels taller than a block are cut into pieces of their own.
    tallest = np.maximum(1, _CHUNK // width)
    pieces = -(-height // tallest)
    if pieces.max() > 1:
        number = np.repeat(np.arange(first.size), pieces)
        piece = np.arange(number.size) - np.repeat(np.cumsum(pieces) - pieces, pieces)
        offset = piece * tallest[number]
        height = np.minimum(height[number] - offset, tallest[number])
        first, width = first[number] + offset, width[number]
    for tall, wide in set(zip(height.tolist(), width.tolist(), strict=True)):
        (equal,) = np.nonzero((height == tall) & (width == wide))
        step = max(1, _CHUNK // (tall * wide))
        for begin in range(0, equal.size, step):
            panel = first[equal[begin : begin + step]]
            yield panel[:, None] + np.arange(tall), start[panel][:, None] + np.arange(wide)
