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
    factor, slot = 1.0, 0
    for h in range(4):
        lam, top = h + 0.5, order - h
        total, last, now = 0.0, 0.0, 1.0
        for l in range(top + 1):
            total += now
            keep = top - l
            if keep <= h:
                sums[slot + keep] = factor * total
            after = (2.0 * (l + lam) * b * now - (l + 2.0 * lam - 1.0) * a2 * last) / (l + 1)
            last, now = now, after
        slot += h + 1
        factor *= 2 * h + 1


@njit(cache=compiled_are_kept())
def potentials(  # type: ignore[no-untyped-def]
    foot,
    offset,
    radius,
    order,
    sources,
    density,
    phi_start,
    phi_stop,
    phi_nodes,
    phi_weights,
    force,
    result,
):
    """Layer potentials at one target in the half plane phi = 0, added to result (16,).

    result: u, p, stress, vorticity and grad p. foot: of the target, distance from the axis and
    normal along rho and z. sources (n, 8): at the theta nodes rho, z, the normal times
    dS / (dtheta dphi) along rho and z, rho and z less those of the foot, half the weight, and
    sin(theta)/(8 pi). Source rule as in `panels`: azimuthal nodes on [0, pi] whose weights count
    both halves; the density is not symmetric and is summed over both. density (n, n_modes, 3,
    complex): psi as (rho, phi, z), turned so that the target is at phi = 0; the real part of the
    sum of its modes is meant. force (6,): the single layer's density is
    (force[:3] + force[3:] x y) sin(theta) dtheta dphi, with the factor 1/(8 pi).
    order < 0: the plain kernel. Otherwise an expansion about the centre at the distance radius
    outside the foot of the target, which lies offset above it: 0 <= offset <= radius.
    stress: xx, yy, zz, xy, xz, yz with x along the target's rho.
    """
    sums = np.empty(10)
    rho_foot, normal_x, normal_z = foot
    # Target relative to the centre.
    hx, hz = (offset - radius) * normal_x, (offset - radius) * normal_z
    cutoff = 10.0 ** (-2.0 * _DIGITS / max(order - 2, 1))
    for i in range(sources.shape[0]):
        rho, z, nr, nz, ds, dz, half, measure = sources[i]
        for j in range(phi_start[i], phi_stop[i]):
            w = half * phi_weights[j]
            mw = w * measure
            for sign in (1.0, -1.0):
                phi = sign * phi_nodes[j]
                cp, sp, sh = math.cos(phi), math.sin(phi), math.sin(0.5 * phi)
                # Density in Cartesian components.
                er, turn = complex(1.0, 0.0), complex(cp, sp)
                pr, pp, pz = 0.0, 0.0, 0.0
                for m in range(density.shape[1]):
                    pr += (density[i, m, 0] * er).real
                    pp += (density[i, m, 1] * er).real
                    pz += (density[i, m, 2] * er).real
                    er *= turn
                px, py, pz = (pr * cp - pp * sp) * w, (pr * sp + pp * cp) * w, pz * w
                nx, ny = nr * cp, nr * sp
                # Single layer density.
                yx, yy = rho * cp, rho * sp
                mx = mw * (force[0] + force[4] * z - force[5] * yy)
                my = mw * (force[1] + force[5] * yx - force[3] * z)
                mz = mw * (force[2] + force[3] * yy - force[4] * yx)
                # r = target - source, through the foot: exact however close they are.
                dx = ds * cp - rho_foot * 2.0 * sh * sh
                rx, ry, rz = offset * normal_x - dx, -yy, offset * normal_z - dz
                # Source relative to the centre. Far from it the terms left out are rounding, and
                # the plain kernel is the same number: X = 0, Y = -r/|r| and closed sums.
                vx, vz = dx - radius * normal_x, dz - radius * normal_z
                v2 = vx * vx + yy * yy + vz * vz
                if order >= 0 and hx * hx + hz * hz > cutoff * v2:
                    inv = 1.0 / math.sqrt(v2)
                    ux, uy, uz = vx * inv, yy * inv, vz * inv
                    xx, xz = hx * inv, hz * inv
                    gegenbauer(order, xx * xx + xz * xz, xx * ux + xz * uz, sums)
                else:
                    inv = 1.0 / math.sqrt(rx * rx + ry * ry + rz * rz)
                    ux, uy, uz = -rx * inv, -ry * inv, -rz * inv
                    xx, xz = 0.0, 0.0
                    sums[0:3], sums[3:6], sums[6:10] = 1.0, 3.0, 15.0
                i2 = inv * inv
                i3, i4 = i2 * inv, i2 * i2
                ta, tb, t2a, t2b, t2c = sums[1], sums[2], sums[3], sums[4], sums[5]
                t3a, t3b, t3c, t3d = sums[6], sums[7], sums[8], sums[9]
                gx, gy, gz = i2 * (ux * ta - xx * tb), i2 * uy * ta, i2 * (uz * ta - xz * tb)
                # Double layer: a = (r.n) psi + (r.psi) n, here (sx, sy, sz).
                rn, rp = rx * nx + ry * ny + rz * nz, rx * px + ry * py + rz * pz
                sx, sy, sz = rn * px + rp * nx, rn * py + rp * ny, rn * pz + rp * nz
                ua, xa = ux * sx + uy * sy + uz * sz, xx * sx + xz * sz
                e1, e2, e3 = i3 * (t2a * ua - t2b * xa), i3 * (t2c * xa - t2b * ua), -i3 * tb
                pg, ng = px * gx + py * gy + pz * gz, nx * gx + ny * gy + nz * gz
                result[0] += nx * pg + px * ng - (ux * e1 + xx * e2 + sx * e3)
                result[1] += ny * pg + py * ng - (uy * e1 + sy * e3)
                result[2] += nz * pg + pz * ng - (uz * e1 + xz * e2 + sz * e3)
                un, up = ux * nx + uy * ny + uz * nz, ux * px + uy * py + uz * pz
                xn, xp = xx * nx + xz * nz, xx * px + xz * pz
                pn = px * nx + py * ny + pz * nz
                h = t2a * un * up - t2b * (un * xp + xn * up) + t2c * xn * xp - tb * pn
                h *= 4.0 * i3
                # The single layer's velocity, and what both do to pressure and stress.
                mg, rm = mx * gx + my * gy + mz * gz, rx * mx + ry * my + rz * mz
                sv = inv * sums[0]
                result[0] += sv * mx - rm * gx
                result[1] += sv * my - rm * gy
                result[2] += sv * mz - rm * gz
                trace = h + 2.0 * mg
                result[3] -= trace
                c1 = -2.0 * i4 * (t3a * ua - t3b * xa) - 2.0 * rm * i3 * t2a
                c2 = 2.0 * i4 * (t3b * ua - t3c * xa) + 2.0 * rm * i3 * t2b
                c3 = -2.0 * i4 * (t3c * ua - t3d * xa) - 2.0 * rm * i3 * t2c
                c4 = 2.0 * i4 * (t2b * ua - t2c * xa) + 2.0 * rm * i3 * tb + trace
                c5, c6 = 2.0 * i4 * t2b, -2.0 * i4 * t2c
                # c1 YY + c2 (YX + XY) + c3 XX + c4 I + c5 (aY + Ya) + c6 (aX + Xa)
                kx, ky, kz = c5 * ux + c6 * xx, c5 * uy, c5 * uz + c6 * xz
                lx, ly, lz = c1 * ux + c2 * xx, c1 * uy, c1 * uz + c2 * xz
                qx, qz = c2 * ux + c3 * xx, c2 * uz + c3 * xz
                result[4] += lx * ux + qx * xx + c4 + 2.0 * sx * kx
                result[5] += ly * uy + c4 + 2.0 * sy * ky
                result[6] += lz * uz + qz * xz + c4 + 2.0 * sz * kz
                result[7] += lx * uy + sx * ky + sy * kx
                result[8] += lx * uz + qx * xz + sx * kz + sz * kx
                result[9] += lz * uy + sy * kz + sz * ky
                # Vorticity and pressure gradient, with h v = (grad grad S) v.
                p1, p2 = i3 * (t2a * up - t2b * xp), i3 * (t2c * xp - t2b * up)
                n1, n2 = i3 * (t2a * un - t2b * xn), i3 * (t2c * xn - t2b * un)
                hpx, hpy = ux * p1 + xx * p2 + px * e3, uy * p1 + py * e3
                hnx, hny = ux * n1 + xx * n2 + nx * e3, uy * n1 + ny * e3
                hpz, hnz = uz * p1 + xz * p2 + pz * e3, uz * n1 + xz * n2 + nz * e3
                result[10] += 2.0 * (hpy * nz - hpz * ny + hny * pz - hnz * py + gy * mz - gz * my)
                result[11] += 2.0 * (hpz * nx - hpx * nz + hnz * px - hnx * pz + gz * mx - gx * mz)
                result[12] += 2.0 * (hpx * ny - hpy * nx + hnx * py - hny * px + gx * my - gy * mx)
                um, xm = ux * mx + uy * my + uz * mz, xx * mx + xz * mz
                d1, d2, d3 = t3a * up - t3b * xp, t3b * up - t3c * xp, t3c * up - t3d * xp
                along = -4.0 * i4 * (d1 * un - d2 * xn - t2b * pn)
                along -= 2.0 * i3 * (t2a * um - t2b * xm)
                aside = -4.0 * i4 * (d3 * xn - d2 * un + t2c * pn)
                aside -= 2.0 * i3 * (t2c * xm - t2b * um)
                d4, d5 = 4.0 * i4 * (t2b * up - t2c * xp), 4.0 * i4 * (t2b * un - t2c * xn)
                tm = 2.0 * i3 * tb
                result[13] += along * ux + aside * xx + d4 * nx + d5 * px + tm * mx
                result[14] += along * uy + d4 * ny + d5 * py + tm * my
                result[15] += along * uz + aside * xz + d4 * nz + d5 * pz + tm * mz
