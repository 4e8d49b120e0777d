"""Target-specific expansions of the Stokes double and single layer, summed over azimuth.

At one target the addition theorem collapses a spherical-harmonic expansion of order p about a
centre into a modified kernel of cost O(p) (Siegel & Tornberg 2018, J. Comput. Phys. 364, sec. 3,
for the Laplace and Stokes layers; Tornberg & Greengard 2008 for the harmonic form used here).

With x (target) and y (source) relative to the centre, rho = |x|/|y|, t = cos of the angle between
them, S_p = sum_{l<=p} |x|^l P_l(t) / |y|^(l+1), g = grad_y S_p and H = grad_x grad_y S_p, the
double layer kernel (T_ijk n_k as p -> infinity) is

    K_ij = (H n)_i r_j + (r.n) H_ij - (g.n) delta_ij - n_i g_j,      r = x - y,

and the single layer kernel (delta_ij/|r| + r_i r_j/|r|^3) is S_p delta_ij - r_j d S_p/dx_i.

This module is compiled by numba and imported only when an operator has to be formed.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit


@njit(cache=True)
def expansion_sums(order, n, rho, t, first, second, last1, last2, next1, next2, s0):  # type: ignore[no-untyped-def]
    """Sums of the Legendre series for n sources: A1, A2 and the terms that close B1, B2, C.

    first = sum_{l=1..p} rho^l P_l'(t), second = sum rho^l P_l''(t), s0 = sum_{l=0..p} rho^l P_l(t);
    last1, last2 are the terms l = p and next1, next2 the terms l = p + 1 of the first two.
    P_l' and P_l'' follow the Gegenbauer recurrences (DLMF 18.9.1) with rho^l folded in, so that
    nothing overflows whatever the order.
    """
    for i in range(n):
        first[i] = 0.0
        second[i] = 0.0
        last1[i] = 0.0
        last2[i] = 0.0
        next1[i] = rho[i]
        next2[i] = 0.0
        s0[i] = 1.0
    for order_l in range(1, order + 1):
        # next1/next2 hold the terms of degree order_l, last1/last2 those of order_l - 1.
        up1 = (2 * order_l + 1) / order_l
        down1 = (order_l + 1) / order_l
        if order_l > 1:
            up2 = (2 * order_l + 1) / (order_l - 1)
            down2 = (order_l + 2) / (order_l - 1)
            for i in range(n):
                rt = rho[i] * t[i]
                r2 = rho[i] * rho[i]
                a = next1[i]
                b = next2[i]
                first[i] += a
                second[i] += b
                # l P_l = t P_l' - P_{l-1}'
                s0[i] += (t[i] * a - rho[i] * last1[i]) / order_l
                next1[i] = up1 * rt * a - down1 * r2 * last1[i]
                next2[i] = up2 * rt * b - down2 * r2 * last2[i]
                last1[i] = a
                last2[i] = b
        else:
            for i in range(n):
                a = next1[i]
                first[i] += a
                s0[i] += t[i] * a
                next1[i] = 3.0 * rho[i] * t[i] * a
                next2[i] = 3.0 * rho[i] * rho[i]
                last1[i] = a


@njit(cache=True)
def target_row(  # type: ignore[no-untyped-def]
    aspect_ratio,
    theta_target,
    side,
    radius,
    order,
    theta_nodes,
    theta_weights,
    phi_start,
    phi_stop,
    phi_nodes,
    phi_weights,
    grid_theta,
    barycentric,
    cosine,
    n_modes,
    with_single,
    row_double,
    row_single,
):
    """Azimuthal modes of the layer potentials at one target (theta_target, phi = 0).

    Adds to row_double (n_modes, 3, 3, n_theta) and, if asked for, row_single: the value in
    cylindrical components (rho, phi, z) at the target of the layer with density
    psi_b(theta) exp(i m phi), the phi components carrying a factor i so that all is real:
    (u_rho, u_phi / i, u_z) = sum_b row[m, a, b, :] . (psi_rho, psi_phi / i, psi_z).
    The double layer has measure dS, the single layer sin(theta) dtheta dphi (the weight of the
    support function, for which it stays smooth at any aspect ratio) and the factor 1/(8 pi).

    side is +1 for an outer, -1 for an inner centre; the expansion has the given order and radius.
    Source rule: node i in theta has azimuthal nodes phi_start[i]:phi_stop[i] on [0, pi], their
    weights counting both halves.

    barycentric are the weights of the interpolation from grid_theta: of polynomials in theta, or,
    with cosine, of polynomials in cos(theta) times the power of sin(theta) with which a smooth
    field vanishes at the pole: for mode m >= 1 the component z as sin^m, the combinations
    rho + phi / i and rho - phi / i as sin^(m-1) and sin^(m+1), of which the parity is kept and the
    square that tells the last two apart. That is exact for polynomial densities and leaves out
    fields that no polynomial approaches.
    """
    k = aspect_ratio
    n_theta = grid_theta.size
    longest = 1
    for i in range(theta_nodes.size):
        longest = max(longest, phi_stop[i] - phi_start[i])
    rho = np.empty(longest)
    t = np.empty(longest)
    a1 = np.empty(longest)
    a2 = np.empty(longest)
    last1 = np.empty(longest)
    last2 = np.empty(longest)
    next1 = np.empty(longest)
    next2 = np.empty(longest)
    s0 = np.empty(longest)
    yx = np.empty(longest)
    yy = np.empty(longest)
    inv = np.empty(longest)
    cos_phi = np.empty(longest)
    sin_phi = np.empty(longest)
    kernel = np.empty((9, longest))
    layer = np.empty((9, longest))
    even = np.empty(n_theta)
    odd = np.empty(n_theta)
    same = np.empty(n_theta)
    other = np.empty(n_theta)
    cos_m = np.empty(longest)
    sin_m = np.empty(longest)

    st = math.sin(theta_target)
    ct = math.cos(theta_target)
    qt = math.hypot(st, k * ct)
    # Direction from the centre to the target.
    hx = -side * st / qt
    hz = -side * k * ct / qt

    for i in range(theta_nodes.size):
        theta = theta_nodes[i]
        s = math.sin(theta)
        c = math.cos(theta)
        half = 0.5 * (theta - theta_target)
        middle = 0.5 * (theta + theta_target)
        # Differences source - target in product form: exact to rounding however close they are.
        ds = 2.0 * math.cos(middle) * math.sin(half)
        dz = -2.0 * math.sin(middle) * math.sin(half)
        n = phi_stop[i] - phi_start[i]
        offset = phi_start[i]
        for j in range(n):
            phi = phi_nodes[offset + j]
            cp = math.cos(phi)
            sp = math.sin(phi)
            sh = math.sin(0.5 * phi)
            cos_phi[j] = cp
            sin_phi[j] = sp
            # Source relative to the target, then to the centre (which lies at -radius * h).
            dx = k * (ds * cp - st * 2.0 * sh * sh)
            dy = k * s * sp
            yx[j] = dx
            yy[j] = dy
            cx = dx + radius * hx
            cz = dz + radius * hz
            d2 = cx * cx + dy * dy + cz * cz
            v = 1.0 / math.sqrt(d2)
            inv[j] = v
            rho[j] = radius * v
            t[j] = (cx * hx + cz * hz) * v
        expansion_sums(order, n, rho, t, a1, a2, last1, last2, next1, next2, s0)
        # n dS = k sin(theta) (sin(theta) e_rho + k cos(theta) e_z) dtheta dphi
        nr = k * s * s
        nz = k * k * s * c
        for j in range(n):
            v = inv[j]
            cp = cos_phi[j]
            sp = sin_phi[j]
            dx = yx[j]
            dy = yy[j]
            ux = (dx + radius * hx) * v
            uy = dy * v
            uz = (dz + radius * hz) * v
            nx = nr * cp
            ny = nr * sp
            b1 = (a1[j] + next1[j]) / rho[j]
            b2 = (a2[j] + next2[j]) / rho[j]
            cc = rho[j] * (a2[j] - last2[j])
            f = v * v * v / rho[j]
            hn = hx * nx + hz * nz
            un = ux * nx + uy * ny + uz * nz
            # H n = alpha h + beta u + gamma n
            alpha = f * (-cc * hn + a2[j] * un)
            beta = f * (a2[j] * hn - b2 * un)
            gamma = f * a1[j]
            px = alpha * hx + beta * ux + gamma * nx
            py = beta * uy + gamma * ny
            pz = alpha * hz + beta * uz + gamma * nz
            # r = x - y in the source's cylindrical directions (rho, phi, z)
            rr = -(dx * cp + dy * sp)
            rp = dx * sp - dy * cp
            rz = -dz
            rn = rr * nr + rz * nz
            hr = hx * cp
            hp = -hx * sp
            ur = ux * cp + uy * sp
            up = uy * cp - ux * sp
            v2 = v * v
            gr = v2 * (a1[j] * hr - b1 * ur)
            gp = v2 * (a1[j] * hp - b1 * up)
            gz = v2 * (a1[j] * hz - b1 * uz)
            gn = gr * nr + gz * nz
            fr = f * rn
            # rows of H dotted with the cylindrical directions at the source
            qx = fr * (-cc * hx + a2[j] * ux)
            qy = fr * (a2[j] * uy)
            qz = fr * (-cc * hz + a2[j] * uz)
            wx = fr * (a2[j] * hx - b2 * ux)
            wy = fr * (-b2 * uy)
            wz = fr * (a2[j] * hz - b2 * uz)
            diagonal = fr * a1[j] - gn
            w = phi_weights[offset + j]
            kernel[0, j] = w * (px * rr + qx * hr + wx * ur + diagonal * cp - nx * gr)
            kernel[1, j] = w * (px * rp + qx * hp + wx * up - diagonal * sp - nx * gp)
            kernel[2, j] = w * (px * rz + qx * hz + wx * uz - nx * gz)
            kernel[3, j] = w * (py * rr + qy * hr + wy * ur + diagonal * sp - ny * gr)
            kernel[4, j] = w * (py * rp + qy * hp + wy * up + diagonal * cp - ny * gp)
            kernel[5, j] = w * (py * rz + qy * hz + wy * uz - ny * gz)
            kernel[6, j] = w * (pz * rr + qz * hr + wz * ur - nz * gr)
            kernel[7, j] = w * (pz * rp + qz * hp + wz * up - nz * gp)
            kernel[8, j] = w * (pz * rz + qz * hz + wz * uz + diagonal - nz * gz)
            if with_single:
                sv = w * s0[j] * v
                e1 = w * v2 * a1[j] / rho[j]
                e2 = -w * v2 * (a1[j] - last1[j])
                ex = e1 * ux + e2 * hx
                ey = e1 * uy
                ez = e1 * uz + e2 * hz
                layer[0, j] = sv * cp - ex * rr
                layer[1, j] = -sv * sp - ex * rp
                layer[2, j] = -ex * rz
                layer[3, j] = sv * sp - ey * rr
                layer[4, j] = sv * cp - ey * rp
                layer[5, j] = -ey * rz
                layer[6, j] = -ez * rr
                layer[7, j] = -ez * rp
                layer[8, j] = sv - ez * rz

        interpolation_weights(theta, grid_theta, barycentric, cosine, even, odd)
        for jt in range(n_theta):
            even[jt] *= theta_weights[i]
            odd[jt] *= theta_weights[i]

        for j in range(n):
            cos_m[j] = 1.0
            sin_m[j] = 0.0
        for m in range(n_modes):
            # Parity across the pole: (-1)^m for the z component, the opposite for the others.
            along, across = (even, odd) if m % 2 == 0 else (odd, even)
            tell_apart(s, grid_theta, across, cosine and m > 0, same, other)
            accumulate_mode(kernel, n, cos_m, sin_m, same, other, along, 1.0, row_double[m])
            if with_single:
                scale = s / (8.0 * math.pi)
                accumulate_mode(layer, n, cos_m, sin_m, same, other, along, scale, row_single[m])
            for j in range(n):
                cm = cos_m[j]
                cos_m[j] = cm * cos_phi[j] - sin_m[j] * sin_phi[j]
                sin_m[j] = sin_m[j] * cos_phi[j] + cm * sin_phi[j]


@njit(cache=True)
def interpolation_weights(theta, grid_theta, barycentric, cosine, even, odd):  # type: ignore[no-untyped-def]
    """Weights (n_theta,) of interpolation at theta for components even and odd across the pole.

    Barycentric formula of the second kind (Berrut & Trefethen 2004, eq. 4.2).
    """
    exact = -1
    total = 0.0
    for jt in range(grid_theta.size):
        delta = theta - grid_theta[jt]
        if cosine:
            delta = math.sin(0.5 * (theta + grid_theta[jt])) * math.sin(0.5 * delta)
        if delta == 0.0:
            exact = jt
        else:
            even[jt] = barycentric[jt] / delta
            total += even[jt]
    if exact >= 0:
        even[:] = 0.0
        even[exact] = 1.0
        total = 1.0
    for jt in range(grid_theta.size):
        even[jt] /= total
        odd[jt] = even[jt] * (math.sin(theta) / math.sin(grid_theta[jt])) if cosine else even[jt]


@njit(cache=True)
def tell_apart(sine, grid_theta, across, apart, same, other):  # type: ignore[no-untyped-def]
    """Weights of rho and phi / i from themselves and from each other.

    Their difference vanishes at the pole by sin^2 more than their sum (`apart`, modes m >= 1).
    """
    for jt in range(grid_theta.size):
        square = (sine / math.sin(grid_theta[jt])) ** 2 if apart else 1.0
        same[jt] = 0.5 * (1.0 + square) * across[jt]
        other[jt] = 0.5 * (1.0 - square) * across[jt]


@njit(cache=True, fastmath={"reassoc", "contract"})
def accumulate_mode(kernel, n, cos_m, sin_m, same, other, along, scale, row):  # type: ignore[no-untyped-def]
    """Add one theta node's azimuthal Fourier sums of a 3 x 3 kernel to row (3, 3, n_theta).

    Entries even in phi meet the cosine, the four odd ones (one index phi) the sine, with the sign
    that the factor i of the phi component gives. along interpolates the z component of the density,
    same each of the other two from itself and other from its partner.
    """
    sums = np.empty(3)
    for a in range(3):
        for b in range(3):
            total = 0.0
            if (a == 1) == (b == 1):
                for j in range(n):
                    total += kernel[3 * a + b, j] * cos_m[j]
            elif b == 1:
                for j in range(n):
                    total -= kernel[3 * a + b, j] * sin_m[j]
            else:
                for j in range(n):
                    total += kernel[3 * a + b, j] * sin_m[j]
            sums[b] = scale * total
        for jt in range(along.size):
            row[a, 0, jt] += sums[0] * same[jt] + sums[1] * other[jt]
            row[a, 1, jt] += sums[1] * same[jt] + sums[0] * other[jt]
            row[a, 2, jt] += sums[2] * along[jt]
