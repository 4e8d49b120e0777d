"""Compiled evaluation of exterior Stokes flows as sums of exterior spheroidal harmonics.

A point outside the spheroid lies on one confocal spheroid with semi-axes (alpha, alpha, gamma),
gamma^2 - alpha^2 = e2 = 1 - k^2 (of either sign), at eta = z / gamma. Exterior harmonics are

    E_nm = ((x + i y) / k)^m  Q_n^(m)(gamma) / Q_n^(m)(1)  p_n^m(eta)

with derivatives of order m of Legendre functions, Q_n(gamma / f) / f^(n+1) for f^2 = e2, and
orthonormal polynomials p_n^m: on the surface they are orthonormal spherical harmonics in the polar
parameter, and nothing is singular at the poles. The recurrences (DLMF 14.10.3 differentiated,
14.21.1) hold in this scaling for prolate, spherical and oblate bodies alike.

This module is compiled by numba and imported only when a field has to be evaluated.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from qbxstokes.folders import compiled_are_kept

# Forward recurrence loses this factor at most before the continued fraction takes over.
_FORWARD_LOSS = 50.0
_LOG_PRECISION = 40.0


@njit(cache=compiled_are_kept())
def confocal(rho2, z, e2):  # type: ignore[no-untyped-def]
    """alpha^2, gamma and Delta = gamma^2 - e2 eta^2 of a point, without cancellation."""
    s = rho2 + z * z - e2
    if e2 >= 0.0:
        delta = math.sqrt(s * s + 4.0 * e2 * rho2)
        alpha2 = 0.5 * (s + delta) if s >= 0.0 else 2.0 * e2 * rho2 / (delta - s)
        return alpha2, math.sqrt(alpha2 + e2), delta
    t = rho2 + z * z + e2
    delta = math.sqrt(t * t - 4.0 * e2 * z * z)
    gamma2 = 0.5 * (t + delta) if t >= 0.0 else -2.0 * e2 * z * z / (delta - t)
    return gamma2 - e2, math.sqrt(gamma2), delta


@njit(cache=compiled_are_kept())
def logarithm(gamma, alpha, e2):  # type: ignore[no-untyped-def]
    """Q_0: atanh(f / gamma) / f for prolate, arctan(f / gamma) / f for oblate bodies."""
    f = math.sqrt(abs(e2))
    if e2 > 0.0:
        return math.log((gamma + f) / alpha) / f
    return math.atan2(f, gamma) / f


@njit(cache=compiled_are_kept())
def ratios(m, degree, gamma, alpha, e2, first, out):  # type: ignore[no-untyped-def]
    """out[n] = Q_n^(m) / Q_{n-1}^(m) for n = m..degree; out[0] = Q_0 for m = 0.

    first is the ratio at n = m where it is known from order m - 1 (thin bodies near their
    surface, where the forward recurrence is stable enough), else 0: then the continued fraction
    is run backwards from where the ratio no longer matters (Gautschi 1967, SIAM Rev. 9, 24).
    """
    if first != 0.0:
        out[m] = first
        for n in range(m, degree):
            c = max(n + m, 1)
            out[n + 1] = ((2 * n + 1) * gamma - c / out[n]) / ((n - m + 1) * e2)
        return
    growth = (gamma + alpha) ** 2
    extra = 2
    if e2 != 0.0:
        growth = math.log(growth / abs(e2))
        extra = int(_LOG_PRECISION / growth) + 2
    r = 1.0 / (gamma + alpha)
    for n in range(degree + extra, m - 1, -1):
        r = max(n + m, 1) / ((2 * n + 1) * gamma - (n - m + 1) * e2 * r)
        if n <= degree:
            out[n] = r


@njit(cache=compiled_are_kept())
def all_ratios(orders, degree, gamma, alpha, e2, out):  # type: ignore[no-untyped-def]
    """`ratios` for the orders m = 0..orders - 1, into out (orders, degree + 1)."""
    forward = False
    if e2 != 0.0:
        forward = (degree + 2) * math.log((gamma + alpha) ** 2 / abs(e2)) < math.log(_FORWARD_LOSS)
    first = logarithm(gamma, alpha, e2) if forward else 0.0
    for m in range(orders):
        if m > degree:
            break
        ratios(m, degree, gamma, alpha, e2, first, out[m])
        if forward and m < degree:
            first = out[m, m] * ((2 * m + 1) - gamma * out[m, m + 1]) / max(2 * m, 1)


@njit(cache=compiled_are_kept())
def bends(x, y, gamma, eta, alpha2, sine2, e2, inv, g, h):  # type: ignore[no-untyped-def]
    """Second derivatives of gamma and of eta, xx, yy, zz, xy, xz, yz each, from the first g and h.

    (d_j N_i - gamma_i d_j delta) / delta.
    """
    gx, gy, gz = g
    hx, hy, hz = h
    dx = 2.0 * (gamma * gx - e2 * eta * hx)
    dy = 2.0 * (gamma * gy - e2 * eta * hy)
    dz = 2.0 * (gamma * gz - e2 * eta * hz)
    return (
        (gamma + x * gx - gx * dx) * inv,
        (gamma + y * gy - gy * dy) * inv,
        (hz * alpha2 + 2.0 * eta * gamma * gz - gz * dz) * inv,
        (x * gy - gx * dy) * inv,
        (x * gz - gx * dz) * inv,
        (y * gz - gy * dz) * inv,
        (-eta - x * hx - hx * dx) * inv,
        (-eta - y * hy - hy * dy) * inv,
        (gz * sine2 - 2.0 * gamma * eta * hz - hz * dz) * inv,
        (-x * hy - hx * dy) * inv,
        (-x * hz - hx * dz) * inv,
        (-y * hz - hy * dz) * inv,
    )


@njit(cache=compiled_are_kept())
def evaluate(  # type: ignore[no-untyped-def]
    points,
    k,
    real,
    imag,
    inverse_ratio,
    rise,
    fall,
    diagonal,
    amplitude,
    tolerance,
    margin,
    with_stress,
    velocity,
    pressure,
    stress,
):
    """Velocity, pressure and stress of u = B + grad(C - x . B), x held fixed, at points (N, 3).

    k: equatorial semi-axis, in units of the polar one.
    real, imag (orders, degree + 1, 4): coefficients of B_x, B_y, B_z, C on the harmonics E_nm, of
    which the real part is taken. inverse_ratio: 1 / ratio on the surface. rise, fall, diagonal:
    recurrence of p_n^m. amplitude (degree + 1): size of the terms of each degree on the surface;
    at a point, degrees whose sum stays below tolerance are left out.
    The pressure is -2 div B and the stress 2 I div B + 2 grad grad (C - x . B)
    (Papkovich and Neuber; Kim & Karrila 1991, sec. 4.2). stress: xx, yy, zz, xy, xz, yz.
    Points inside the surface by more than margin (in the sum of squares that is 1 on it) get NaN.
    Returns the sum over points of the degree used: a measure of the work.
    """
    e2 = (1.0 - k) * (1.0 + k)
    orders = real.shape[0]
    top = real.shape[1] - 1
    table = np.zeros((orders, top + 2))
    work = 0
    for i in range(points.shape[0]):
        x = points[i, 0]
        y = points[i, 1]
        z = points[i, 2]
        rho2 = x * x + y * y
        # NaN coordinates fail the comparison and are marked as well.
        if not (rho2 / (k * k) + z * z >= 1.0 - margin):
            velocity[i, :] = np.nan
            pressure[i] = np.nan
            if with_stress:
                stress[i, :] = np.nan
            continue
        alpha2, gamma, delta = confocal(rho2, z, e2)
        alpha = math.sqrt(alpha2)
        eta = z / gamma
        sine2 = rho2 / alpha2
        decay = (1.0 + k) / (gamma + alpha)
        degree = top
        if tolerance > 0.0:
            tail = 0.0
            power = decay ** (top + 1)
            while degree > 1:
                tail += amplitude[degree] * power
                if tail > tolerance:
                    break
                power /= decay
                degree -= 1
        work += degree
        n_orders = min(orders, degree + 1)
        all_ratios(n_orders, degree, gamma, alpha, e2, table)
        inv = 1.0 / delta
        gx = x * gamma * inv
        gy = y * gamma * inv
        gz = eta * alpha2 * inv
        hx = -x * eta * inv
        hy = -y * eta * inv
        hz = gamma * sine2 * inv

        ux = 0.0
        uy = 0.0
        uz = 0.0
        div = 0.0
        fxx = 0.0
        fyy = 0.0
        fzz = 0.0
        fxy = 0.0
        fxz = 0.0
        fyz = 0.0
        if with_stress:
            gxx, gyy, gzz, gxy, gxz, gyz, hxx, hyy, hzz, hxy, hxz, hyz = bends(
                x, y, gamma, eta, alpha2, sine2, e2, inv, (gx, gy, gz), (hx, hy, hz)
            )
        zk = complex(x, y) / k
        w = complex(1.0, 0.0)
        w1 = complex(0.0, 0.0)
        w2 = complex(0.0, 0.0)
        start = 1.0  # (k / alpha)^(2 m)
        for m in range(n_orders):
            b0 = complex(0.0, 0.0)
            b1 = complex(0.0, 0.0)
            b2 = complex(0.0, 0.0)
            bg0 = complex(0.0, 0.0)
            bg1 = complex(0.0, 0.0)
            bg2 = complex(0.0, 0.0)
            bh0 = complex(0.0, 0.0)
            bh1 = complex(0.0, 0.0)
            bh2 = complex(0.0, 0.0)
            f = complex(0.0, 0.0)
            fg = complex(0.0, 0.0)
            fh = complex(0.0, 0.0)
            fgg = complex(0.0, 0.0)
            fgh = complex(0.0, 0.0)
            fhh = complex(0.0, 0.0)
            q = start
            p = diagonal[m]
            pd = 0.0
            pdd = 0.0
            p_last = 0.0
            pd_last = 0.0
            pdd_last = 0.0
            for n in range(m, degree + 1):
                r = table[m, n]
                q *= r * inverse_ratio[m, n]
                qg = q * ((n - m) * gamma - max(n + m, 1) / r) / alpha2
                c0 = complex(real[m, n, 0], imag[m, n, 0])
                c1 = complex(real[m, n, 1], imag[m, n, 1])
                c2 = complex(real[m, n, 2], imag[m, n, 2])
                c = complex(real[m, n, 3], imag[m, n, 3]) - x * c0 - y * c1 - z * c2
                qp = q * p
                qgp = qg * p
                qpd = q * pd
                b0 += qp * c0
                b1 += qp * c1
                b2 += qp * c2
                f += qp * c
                fg += qgp * c
                fh += qpd * c
                bg0 += qgp * c0
                bg1 += qgp * c1
                bg2 += qgp * c2
                bh0 += qpd * c0
                bh1 += qpd * c1
                bh2 += qpd * c2
                if with_stress:
                    qgg = (-2.0 * (m + 1) * gamma * qg + (n - m) * (n + m + 1) * q) / alpha2
                    fgg += qgg * p * c
                    fgh += qg * pd * c
                    fhh += q * pdd * c
                up = rise[m, n]
                down = fall[m, n]
                p_next = up * eta * p - down * p_last
                pd_next = up * (eta * pd + p) - down * pd_last
                pdd_next = up * (eta * pdd + 2.0 * pd) - down * pdd_last
                p_last = p
                pd_last = pd
                pdd_last = pdd
                p = p_next
                pd = pd_next
                pdd = pdd_next
            lx = fg * gx + fh * hx
            ly = fg * gy + fh * hy
            lz = fg * gz + fh * hz
            ux += (w * (b0 + lx) + w1 * f).real
            uy += (w * (b1 + ly) + w1 * 1j * f).real
            uz += (w * (b2 + lz)).real
            div += (
                w * (bg0 * gx + bh0 * hx + bg1 * gy + bh1 * hy + bg2 * gz + bh2 * hz)
                + w1 * (b0 + 1j * b1)
            ).real
            if with_stress:
                fxx += (
                    w * (fgg * gx * gx + 2.0 * fgh * gx * hx + fhh * hx * hx + fg * gxx + fh * hxx)
                    + 2.0 * w1 * lx
                    + w2 * f
                ).real
                fyy += (
                    w * (fgg * gy * gy + 2.0 * fgh * gy * hy + fhh * hy * hy + fg * gyy + fh * hyy)
                    + 2j * w1 * ly
                    - w2 * f
                ).real
                fzz += (
                    w * (fgg * gz * gz + 2.0 * fgh * gz * hz + fhh * hz * hz + fg * gzz + fh * hzz)
                ).real
                fxy += (
                    w
                    * (
                        fgg * gx * gy
                        + fgh * (gx * hy + gy * hx)
                        + fhh * hx * hy
                        + fg * gxy
                        + fh * hxy
                    )
                    + w1 * (ly + 1j * lx)
                    + 1j * w2 * f
                ).real
                fxz += (
                    w
                    * (
                        fgg * gx * gz
                        + fgh * (gx * hz + gz * hx)
                        + fhh * hx * hz
                        + fg * gxz
                        + fh * hxz
                    )
                    + w1 * lz
                ).real
                fyz += (
                    w
                    * (
                        fgg * gy * gz
                        + fgh * (gy * hz + gz * hy)
                        + fhh * hy * hz
                        + fg * gyz
                        + fh * hyz
                    )
                    + 1j * w1 * lz
                ).real
            w2 = (m + 1) / k * w1
            w1 = (m + 1) / k * w
            w *= zk
            start *= k * k / alpha2
        velocity[i, 0] = ux
        velocity[i, 1] = uy
        velocity[i, 2] = uz
        pressure[i] = -2.0 * div
        if with_stress:
            stress[i, 0] = 2.0 * (div + fxx)
            stress[i, 1] = 2.0 * (div + fyy)
            stress[i, 2] = 2.0 * (div + fzz)
            stress[i, 3] = 2.0 * fxy
            stress[i, 4] = 2.0 * fxz
            stress[i, 5] = 2.0 * fyz
    return work
