"""Compiled tables of exterior spheroidal harmonics and their derivatives at points.

The same functions E_nm as in `exterior_kernel`, one number each, so that the field of any number of
coefficient sets at the same points is a product of matrices. Imported only when bodies couple.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from qbxstokes.qbx.exterior_kernel import all_ratios, bends, confocal


@njit(cache=True)
def tabulate(  # type: ignore[no-untyped-def]
    points, k, degree, orders, inverse_ratio, rise, fall, diagonal, second, table
):
    """Fill table (4 or 10, P, 2 K) at points (P, 3) of the body frame, outside the body.

    Rows: E, its three first derivatives and, if second, xx, yy, zz, xy, xz, yz. Columns: real part
    and minus the imaginary part of E_nm for m < orders, m <= n <= degree, n fastest, so that
    Re(sum c E) is the product with the real and imaginary parts of c, interleaved.
    """
    e2 = (1.0 - k) * (1.0 + k)
    ratios = np.zeros((orders, degree + 2))
    for i in range(points.shape[0]):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        rho2 = x * x + y * y
        alpha2, gamma, delta = confocal(rho2, z, e2)
        alpha = math.sqrt(alpha2)
        eta = z / gamma
        sine2 = rho2 / alpha2
        all_ratios(orders, degree, gamma, alpha, e2, ratios)
        inv = 1.0 / delta
        gx, gy, gz = x * gamma * inv, y * gamma * inv, eta * alpha2 * inv
        hx, hy, hz = -x * eta * inv, -y * eta * inv, gamma * sine2 * inv
        gxx, gyy, gzz, gxy, gxz, gyz, hxx, hyy, hzz, hxy, hxz, hyz = bends(
            x, y, gamma, eta, alpha2, sine2, e2, inv, (gx, gy, gz), (hx, hy, hz)
        )
        zk = complex(x, y) / k
        w, w1, w2 = complex(1.0, 0.0), complex(0.0, 0.0), complex(0.0, 0.0)
        start = 1.0
        column = 0
        for m in range(orders):
            q = start
            p, pd, pdd = diagonal[m], 0.0, 0.0
            p_last, pd_last, pdd_last = 0.0, 0.0, 0.0
            for n in range(m, degree + 1):
                r = ratios[m, n]
                q *= r * inverse_ratio[m, n]
                qg = q * ((n - m) * gamma - max(n + m, 1) / r) / alpha2
                f, fg, fh = q * p, qg * p, q * pd
                lx, ly, lz = fg * gx + fh * hx, fg * gy + fh * hy, fg * gz + fh * hz
                value = w * f
                table[0, i, column], table[0, i, column + 1] = value.real, -value.imag
                value = w * lx + w1 * f
                table[1, i, column], table[1, i, column + 1] = value.real, -value.imag
                value = w * ly + w1 * 1j * f
                table[2, i, column], table[2, i, column + 1] = value.real, -value.imag
                value = w * lz
                table[3, i, column], table[3, i, column + 1] = value.real, -value.imag
                if second:
                    qgg = (-2.0 * (m + 1) * gamma * qg + (n - m) * (n + m + 1) * q) / alpha2
                    fgg, fgh, fhh = qgg * p, qg * pd, q * pdd
                    xx = fgg * gx * gx + 2.0 * fgh * gx * hx + fhh * hx * hx + fg * gxx + fh * hxx
                    yy = fgg * gy * gy + 2.0 * fgh * gy * hy + fhh * hy * hy + fg * gyy + fh * hyy
                    zz = fgg * gz * gz + 2.0 * fgh * gz * hz + fhh * hz * hz + fg * gzz + fh * hzz
                    xy = fgg * gx * gy + fgh * (gx * hy + gy * hx) + fhh * hx * hy
                    xy += fg * gxy + fh * hxy
                    xz = fgg * gx * gz + fgh * (gx * hz + gz * hx) + fhh * hx * hz
                    xz += fg * gxz + fh * hxz
                    yz = fgg * gy * gz + fgh * (gy * hz + gz * hy) + fhh * hy * hz
                    yz += fg * gyz + fh * hyz
                    value = w * xx + 2.0 * w1 * lx + w2 * f
                    table[4, i, column], table[4, i, column + 1] = value.real, -value.imag
                    value = w * yy + 2j * w1 * ly - w2 * f
                    table[5, i, column], table[5, i, column + 1] = value.real, -value.imag
                    value = w * zz
                    table[6, i, column], table[6, i, column + 1] = value.real, -value.imag
                    value = w * xy + w1 * (ly + 1j * lx) + 1j * w2 * f
                    table[7, i, column], table[7, i, column + 1] = value.real, -value.imag
                    value = w * xz + w1 * lz
                    table[8, i, column], table[8, i, column + 1] = value.real, -value.imag
                    value = w * yz + 1j * w1 * lz
                    table[9, i, column], table[9, i, column + 1] = value.real, -value.imag
                column += 2
                up, down = rise[m, n], fall[m, n]
                p_next = up * eta * p - down * p_last
                pd_next = up * (eta * pd + p) - down * pd_last
                pdd_next = up * (eta * pdd + 2.0 * pd) - down * pdd_last
                p_last, pd_last, pdd_last = p, pd, pdd
                p, pd, pdd = p_next, pd_next, pdd_next
            w2 = (m + 1) / k * w1
            w1 = (m + 1) / k * w
            w *= zk
            start *= k * k / alpha2
