"""Compiled layer potentials, pressure, stress, vorticity and pressure gradient at points.

With S = 1/|x - y| and its derivatives in x, r = x - y and a = (r.n) psi + (r.psi) n, the double
layer (method of `kernel`, derivatives taken in x) has velocity, pressure, stress and vorticity

    u   = -(grad grad S) a + (n (psi.grad S) + psi (n.grad S))
    p   = -4 psi.(grad grad S).n
    sig =  I 4 psi.(grad grad S).n - 2 (grad grad grad S).a
    w   = 2 ((grad grad S) psi x n + (grad grad S) n x psi),   grad p = -4 (grad grad grad S) psi n

and the single layer, without 1/(8 pi),

    u = S mu - (r.mu) grad S,   p = -2 mu.grad S,   sig = I 2 mu.grad S - 2 (r.mu) grad grad S,
    w = 2 grad S x mu,   grad p = -2 (grad grad S) mu.

Replacing S by its local expansion of order p about a centre, S_p, turns these into quadrature by
expansion (Klöckner et al. 2013, J. Comput. Phys. 252; Siegel & Tornberg 2018, ibid. 364): the same
formulas with truncated Gegenbauer sums in place of powers of |r|. With X = x / |y|, Y = y / |y|
relative to the centre and T1, T2, T3 the sums over the solid Gegenbauer polynomials of index
3/2, 5/2, 7/2 (DLMF 18.12.4) times 1, 3, 15,

    |y|^2 grad S           = Y T1[p-1] - X T1[p-2]
    |y|^3 grad grad S      = YY T2[p-2] - (YX + XY) T2[p-3] + XX T2[p-4] - I T1[p-2]
    |y|^4 grad grad grad S = YYY T3[p-3] - ... (four sums) - I (Y T2[p-3] - X T2[p-4]), symmetrised

where T[q] stops at degree q. Each truncated potential still solves the Stokes equations exactly.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from qbxstokes.folders import compiled_are_kept

# Where |X|^(p - 2) is below this many digits, an expansion of order p is the plain kernel.
_DIGITS = 17.0


@njit(cache=compiled_are_kept())
def gegenbauer(order, a2, b, sums):  # type: ignore[no-untyped-def]
    """Sums for |X|^2 = a2 and X.Y = b, each from its highest degree down: S, 2 T1, 3 T2, 4 T3.

    The index is h + 1/2 for h = 0..3, degrees run to order - h, the last h + 1 sums are kept.
    """
    sums[:] = 0.0
    factor = 1.0
    slot = 0
    for h in range(4):
        lam = h + 0.5
        top = order - h
        total = 0.0
        last = 0.0
        now = 1.0
        for l in range(top + 1):
            total += now
            keep = top - l
            if keep <= h:
                sums[slot + keep] = factor * total
            nxt = (2.0 * (l + lam) * b * now - (l + 2.0 * lam - 1.0) * a2 * last) / (l + 1)
            last = now
            now = nxt
        slot += h + 1
        factor *= 2 * h + 1


@njit(cache=compiled_are_kept())
def polar_interpolation(theta, grid_theta, barycentric, cosine, even, odd):  # type: ignore[no-untyped-def]
    """Barycentric weights at theta for components even and odd across the pole."""
    n = grid_theta.size
    exact = -1
    total = 0.0
    for j in range(n):
        delta = theta - grid_theta[j]
        if cosine:
            delta = math.sin(0.5 * (theta + grid_theta[j])) * math.sin(0.5 * delta)
        if delta == 0.0:
            exact = j
        else:
            even[j] = barycentric[j] / delta
            total += even[j]
    if exact >= 0:
        even[:] = 0.0
        even[exact] = 1.0
        total = 1.0
    for j in range(n):
        even[j] /= total
        odd[j] = even[j] * (math.sin(theta) / math.sin(grid_theta[j])) if cosine else even[j]


@njit(cache=compiled_are_kept())
def potentials(  # type: ignore[no-untyped-def]
    foot,
    offset,
    radius,
    order,
    theta_nodes,
    sources,
    theta_weights,
    phi_start,
    phi_stop,
    phi_nodes,
    phi_weights,
    grid_theta,
    barycentric,
    cosine,
    double_modes,
    force,
    result,
):
    """Layer potentials at one target in the half plane phi = 0, added to result (16,).

    result: u, p, stress, vorticity and grad p. foot: of the target, distance from the axis and
    normal along rho and z. sources (n, 6): at the theta nodes rho, z, the normal times
    dS / (dtheta dphi) along rho and z, and rho and z less those of the foot. Source rule as in
    `panels`: azimuthal nodes on [0, pi] whose weights count both halves; the density is not
    symmetric and is summed over both. double_modes (n_modes, 3, n_theta, complex): modes of psi as
    (rho, phi / i, z), turned so that the target is at phi = 0; the real part of their sum is meant.
    force (6,): the single layer's density is (force[:3] + force[3:] x y) sin(theta) dtheta dphi,
    with the factor 1/(8 pi).
    order < 0: the plain kernel. Otherwise an expansion about the centre at the distance radius
    outside the foot of the target, which lies offset above it: 0 <= offset <= radius.
    stress: xx, yy, zz, xy, xz, yz with x along the target's rho.
    """
    n_modes = double_modes.shape[0]
    n_theta = grid_theta.size
    even = np.empty(n_theta)
    odd = np.empty(n_theta)
    sums = np.empty(10)
    amplitude = np.empty((n_modes, 3), np.complex128)
    rho_foot, normal_x, normal_z = foot
    # Target relative to the centre.
    hx = (offset - radius) * normal_x
    hz = (offset - radius) * normal_z
    cutoff = 10.0 ** (-2.0 * _DIGITS / max(order - 2, 1))
    for i in range(theta_nodes.size):
        theta = theta_nodes[i]
        s = math.sin(theta)
        rho, z, nr, nz, ds, dz = sources[i]
        polar_interpolation(theta, grid_theta, barycentric, cosine, even, odd)
        for m in range(n_modes):
            # The same rule as in `kernel.target_row`: z as sin^m, rho -+ phi / i as sin^(m -+ 1).
            along, across = (even, odd) if m % 2 == 0 else (odd, even)
            ar = complex(0.0, 0.0)
            ap = complex(0.0, 0.0)
            az = complex(0.0, 0.0)
            for j in range(n_theta):
                square = (s / math.sin(grid_theta[j])) ** 2 if cosine and m > 0 else 1.0
                same = 0.5 * (1.0 + square) * across[j]
                other = 0.5 * (1.0 - square) * across[j]
                ar += same * double_modes[m, 0, j] + other * double_modes[m, 1, j]
                ap += same * double_modes[m, 1, j] + other * double_modes[m, 0, j]
                az += along[j] * double_modes[m, 2, j]
            amplitude[m, 0] = ar
            amplitude[m, 1] = 1j * ap
            amplitude[m, 2] = az
        for j in range(phi_start[i], phi_stop[i]):
            for sign in (1.0, -1.0):
                phi = sign * phi_nodes[j]
                cp = math.cos(phi)
                sp = math.sin(phi)
                sh = math.sin(0.5 * phi)
                w = 0.5 * phi_weights[j] * theta_weights[i]
                # Density in Cartesian components.
                er = complex(1.0, 0.0)
                turn = complex(cp, sp)
                pr = 0.0
                pp = 0.0
                pz = 0.0
                for m in range(n_modes):
                    pr += (amplitude[m, 0] * er).real
                    pp += (amplitude[m, 1] * er).real
                    pz += (amplitude[m, 2] * er).real
                    er *= turn
                px = (pr * cp - pp * sp) * w
                py = (pr * sp + pp * cp) * w
                pz *= w
                nx = nr * cp
                ny = nr * sp
                # Single layer density.
                yx = rho * cp
                yy = rho * sp
                mw = w * s / (8.0 * math.pi)
                mx = mw * (force[0] + force[4] * z - force[5] * yy)
                my = mw * (force[1] + force[5] * yx - force[3] * z)
                mz = mw * (force[2] + force[3] * yy - force[4] * yx)
                # r = target - source, through the foot: exact however close they are.
                dx = ds * cp - rho_foot * 2.0 * sh * sh
                rx = offset * normal_x - dx
                ry = -yy
                rz = offset * normal_z - dz
                # Source relative to the centre. Far from it the terms left out are rounding, and
                # the plain kernel is the same number: X = 0, Y = -r/|r| and closed sums.
                vx = dx - radius * normal_x
                vz = dz - radius * normal_z
                v2 = vx * vx + yy * yy + vz * vz
                if order >= 0 and hx * hx + hz * hz > cutoff * v2:
                    inv = 1.0 / math.sqrt(v2)
                    ux = vx * inv
                    uy = yy * inv
                    uz = vz * inv
                    xx = hx * inv
                    xz = hz * inv
                    gegenbauer(order, xx * xx + xz * xz, xx * ux + xz * uz, sums)
                else:
                    inv = 1.0 / math.sqrt(rx * rx + ry * ry + rz * rz)
                    ux = -rx * inv
                    uy = -ry * inv
                    uz = -rz * inv
                    xx = 0.0
                    xz = 0.0
                    sums[0:3] = 1.0
                    sums[3:6] = 3.0
                    sums[6:10] = 15.0
                i2 = inv * inv
                i3 = i2 * inv
                i4 = i2 * i2
                ta = sums[1]
                tb = sums[2]
                t2a = sums[3]
                t2b = sums[4]
                t2c = sums[5]
                gx = i2 * (ux * ta - xx * tb)
                gy = i2 * uy * ta
                gz = i2 * (uz * ta - xz * tb)
                # Double layer: a = (r.n) psi + (r.psi) n, here (sx, sy, sz).
                rn = rx * nx + ry * ny + rz * nz
                rp = rx * px + ry * py + rz * pz
                sx = rn * px + rp * nx
                sy = rn * py + rp * ny
                sz = rn * pz + rp * nz
                ua = ux * sx + uy * sy + uz * sz
                xa = xx * sx + xz * sz
                e1 = i3 * (t2a * ua - t2b * xa)
                e2 = i3 * (t2c * xa - t2b * ua)
                e3 = -i3 * tb
                pg = px * gx + py * gy + pz * gz
                ng = nx * gx + ny * gy + nz * gz
                result[0] += nx * pg + px * ng - (ux * e1 + xx * e2 + sx * e3)
                result[1] += ny * pg + py * ng - (uy * e1 + sy * e3)
                result[2] += nz * pg + pz * ng - (uz * e1 + xz * e2 + sz * e3)
                un = ux * nx + uy * ny + uz * nz
                up = ux * px + uy * py + uz * pz
                xn = xx * nx + xz * nz
                xp = xx * px + xz * pz
                h = (
                    4.0
                    * i3
                    * (
                        t2a * un * up
                        - t2b * (un * xp + xn * up)
                        + t2c * xn * xp
                        - tb * (nx * px + ny * py + nz * pz)
                    )
                )
                mg = mx * gx + my * gy + mz * gz
                rm = rx * mx + ry * my + rz * mz
                result[3] += -h - 2.0 * mg
                trace = h + 2.0 * mg
                c1 = -2.0 * i4 * (sums[6] * ua - sums[7] * xa) - 2.0 * rm * i3 * t2a
                c2 = 2.0 * i4 * (sums[7] * ua - sums[8] * xa) + 2.0 * rm * i3 * t2b
                c3 = -2.0 * i4 * (sums[8] * ua - sums[9] * xa) - 2.0 * rm * i3 * t2c
                c4 = 2.0 * i4 * (t2b * ua - t2c * xa) + 2.0 * rm * i3 * tb + trace
                c5 = 2.0 * i4 * t2b
                c6 = -2.0 * i4 * t2c
                # velocity of the single layer
                sv = inv * sums[0]
                result[0] += sv * mx - rm * gx
                result[1] += sv * my - rm * gy
                result[2] += sv * mz - rm * gz
                # c1 YY + c2 (YX + XY) + c3 XX + c4 I + c5 (aY + Ya) + c6 (aX + Xa)
                result[4] += (
                    c1 * ux * ux
                    + 2 * c2 * ux * xx
                    + c3 * xx * xx
                    + c4
                    + 2 * sx * (c5 * ux + c6 * xx)
                )
                result[5] += c1 * uy * uy + c4 + 2 * c5 * sy * uy
                result[6] += (
                    c1 * uz * uz
                    + 2 * c2 * uz * xz
                    + c3 * xz * xz
                    + c4
                    + 2 * sz * (c5 * uz + c6 * xz)
                )
                result[7] += c1 * ux * uy + c2 * uy * xx + c5 * (sx * uy + sy * ux) + c6 * sy * xx
                result[8] += (
                    c1 * ux * uz
                    + c2 * (ux * xz + uz * xx)
                    + c3 * xx * xz
                    + c5 * (sx * uz + sz * ux)
                    + c6 * (sx * xz + sz * xx)
                )
                result[9] += c1 * uy * uz + c2 * uy * xz + c5 * (sy * uz + sz * uy) + c6 * sy * xz
                # Vorticity and pressure gradient, with h v = (grad grad S) v.
                p1 = i3 * (t2a * up - t2b * xp)
                p2 = i3 * (t2c * xp - t2b * up)
                n1 = i3 * (t2a * un - t2b * xn)
                n2 = i3 * (t2c * xn - t2b * un)
                hpx = ux * p1 + xx * p2 + px * e3
                hpy = uy * p1 + py * e3
                hpz = uz * p1 + xz * p2 + pz * e3
                hnx = ux * n1 + xx * n2 + nx * e3
                hny = uy * n1 + ny * e3
                hnz = uz * n1 + xz * n2 + nz * e3
                result[10] += 2.0 * (hpy * nz - hpz * ny + hny * pz - hnz * py + gy * mz - gz * my)
                result[11] += 2.0 * (hpz * nx - hpx * nz + hnz * px - hnx * pz + gz * mx - gx * mz)
                result[12] += 2.0 * (hpx * ny - hpy * nx + hnx * py - hny * px + gx * my - gy * mx)
                um = ux * mx + uy * my + uz * mz
                xm = xx * mx + xz * mz
                pn = px * nx + py * ny + pz * nz
                d1 = sums[6] * up - sums[7] * xp
                d2 = sums[7] * up - sums[8] * xp
                d3 = sums[8] * up - sums[9] * xp
                d4 = t2b * up - t2c * xp
                along = -4.0 * i4 * (d1 * un - d2 * xn - t2b * pn) - 2.0 * i3 * (
                    t2a * um - t2b * xm
                )
                aside = -4.0 * i4 * (d3 * xn - d2 * un + t2c * pn) - 2.0 * i3 * (
                    t2c * xm - t2b * um
                )
                d5 = 4.0 * i4 * (t2b * un - t2c * xn)
                d4 *= 4.0 * i4
                tm = 2.0 * i3 * tb
                result[13] += along * ux + aside * xx + d4 * nx + d5 * px + tm * mx
                result[14] += along * uy + d4 * ny + d5 * py + tm * my
                result[15] += along * uz + aside * xz + d4 * nz + d5 * pz + tm * mz
