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

# Logarithms: what the forward recurrence may lose before the backward one takes over; its accuracy.
_FORWARD_LOSS = math.log(50.0)
_LOG_PRECISION = 38.0


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
def all_ratios(orders, degree, gamma, alpha, e2, out):  # type: ignore[no-untyped-def]
    """out[m, n] = Q_n^(m) / Q_{n-1}^(m), m < orders, n = m..degree; out[0, 0] = Q_0.

    For thin bodies near their surface by forward recurrence; else the recurrence is run backwards
    from where its start no longer matters (Gautschi 1967, SIAM Rev. 9, 24), for
    b_n ~ (2n + 1)!! (1 / scale)^n Q_n^(m) / (n + m)!, which neither grows nor divides in its chain.
    """
    growth = _LOG_PRECISION
    if e2 != 0.0:
        growth = math.log((gamma + alpha) ** 2 / abs(e2))
    if (degree + 2) * growth < _FORWARD_LOSS:
        first = logarithm(gamma, alpha, e2)
        for m in range(min(orders, degree + 1)):
            out[m, m] = first
            for n in range(m, degree):
                c = max(n + m, 1)
                out[m, n + 1] = ((2 * n + 1) * gamma - c / out[m, n]) / ((n - m + 1) * e2)
            if m < degree:
                first = out[m, m] * ((2 * m + 1) - gamma * out[m, m + 1]) / max(2 * m, 1)
        return
    extra = int(_LOG_PRECISION / growth) + 2
    scale = 2.0 / (gamma + alpha)
    rise = gamma * scale
    fall = e2 * scale * scale
    for m in range(min(orders, degree + 1)):
        above = 1.0
        here = 1.0
        n1 = degree + extra + 1.0
        for _ in range(extra):
            below = rise * here - fall * (n1 * n1 - m * m) / (4.0 * n1 * n1 - 1.0) * above
            above = here
            here = below
            n1 -= 1.0
        for n in range(degree, m - 1, -1):
            below = rise * here - fall * (n1 * n1 - m * m) / (4.0 * n1 * n1 - 1.0) * above
            out[m, n] = scale * max(n + m, 1) * here / ((2 * n + 1) * below)
            above = here
            here = below
            n1 -= 1.0


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
def twice(d, gi, gj, hi, hj, gij, hij):  # type: ignore[no-untyped-def]
    """Second derivative ij of a function of gamma and eta with derivatives d: gg, gh, hh, g, h."""
    gg, gh, hh, g, h = d
    return gg * (gi * gj) + gh * (gi * hj + gj * hi) + hh * (hi * hj) + g * gij + h * hij


@njit(cache=compiled_are_kept())
def evaluate(  # type: ignore[no-untyped-def]
    points,
    k,
    coefficients,
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
    coefficients (orders, degree + 1, 8): those of B_x, B_y, B_z, C on the harmonics E_nm, real and
    imaginary part each; of their sum the real part is taken. inverse_ratio: 1 / ratio on the
    surface. rise, fall, diagonal: recurrence of p_n^m. amplitude (degree + 1): size of the terms of
    each degree on the surface; at a point, degrees whose sum stays below tolerance are left out.
    The pressure is -2 div B and the stress 2 I div B + 2 grad grad (C - x . B)
    (Papkovich and Neuber; Kim & Karrila 1991, sec. 4.2). stress: xx, yy, zz, xy, xz, yz.
    Points inside the surface by more than margin (in the sum of squares that is 1 on it) get NaN.
    Returns the sum over points of the degree used: a measure of the work.
    """
    e2 = (1.0 - k) * (1.0 + k)
    orders, top = coefficients.shape[0], coefficients.shape[1] - 1
    used = np.zeros((orders, top + 1), dtype=np.bool_)
    for m in range(orders):
        for n in range(m, top + 1):
            used[m, n] = np.any(coefficients[m, n] != 0.0)
    # Sums over n of c E_nm and of its derivatives in gamma (g) and eta (h): E, g, h, gg, gh, hh.
    parts = np.zeros((6, 8))
    sums = parts.view(np.complex128)
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

        ux, uy, uz, div = 0.0, 0.0, 0.0, 0.0
        fxx, fyy, fzz, fxy, fxz, fyz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        if with_stress:
            gxx, gyy, gzz, gxy, gxz, gyz, hxx, hyy, hzz, hxy, hxz, hyz = bends(
                x, y, gamma, eta, alpha2, sine2, e2, inv, (gx, gy, gz), (hx, hy, hz)
            )
        zk = complex(x, y) / k
        w, w1, w2 = complex(1.0, 0.0), complex(0.0, 0.0), complex(0.0, 0.0)
        start = 1.0  # (k / alpha)^(2 m)
        for m in range(n_orders):
            parts[:] = 0.0
            q = start
            p, pd, pdd = diagonal[m], 0.0, 0.0
            p_last, pd_last, pdd_last = 0.0, 0.0, 0.0
            for n in range(m, degree + 1):
                r = table[m, n]
                q *= r * inverse_ratio[m, n]
                if used[m, n]:
                    qg = q * ((n - m) * gamma - max(n + m, 1) / r) / alpha2
                    e, eg, eh = q * p, qg * p, q * pd
                    for j in range(8):
                        c = coefficients[m, n, j]
                        parts[0, j] += e * c
                        parts[1, j] += eg * c
                        parts[2, j] += eh * c
                    if with_stress:
                        qgg = (-2.0 * (m + 1) * gamma * qg + (n - m) * (n + m + 1) * q) / alpha2
                        egg, egh, ehh = qgg * p, qg * pd, q * pdd
                        for j in range(8):
                            c = coefficients[m, n, j]
                            parts[3, j] += egg * c
                            parts[4, j] += egh * c
                            parts[5, j] += ehh * c
                up, down = rise[m, n], fall[m, n]
                p_next = up * eta * p - down * p_last
                pd_next = up * (eta * pd + p) - down * pd_last
                pdd_next = up * (eta * pdd + 2.0 * pd) - down * pdd_last
                p_last, pd_last, pdd_last = p, pd, pdd
                p, pd, pdd = p_next, pd_next, pdd_next
            b0, b1, b2 = sums[0, 0], sums[0, 1], sums[0, 2]
            bg0, bg1, bg2 = sums[1, 0], sums[1, 1], sums[1, 2]
            bh0, bh1, bh2 = sums[2, 0], sums[2, 1], sums[2, 2]
            f = sums[0, 3] - x * b0 - y * b1 - z * b2
            fg = sums[1, 3] - x * bg0 - y * bg1 - z * bg2
            fh = sums[2, 3] - x * bh0 - y * bh1 - z * bh2
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
                fgg = sums[3, 3] - x * sums[3, 0] - y * sums[3, 1] - z * sums[3, 2]
                fgh = sums[4, 3] - x * sums[4, 0] - y * sums[4, 1] - z * sums[4, 2]
                fhh = sums[5, 3] - x * sums[5, 0] - y * sums[5, 1] - z * sums[5, 2]
                d = (fgg, fgh, fhh, fg, fh)
                fxx += (w * twice(d, gx, gx, hx, hx, gxx, hxx) + 2.0 * w1 * lx + w2 * f).real
                fyy += (w * twice(d, gy, gy, hy, hy, gyy, hyy) + 2j * w1 * ly - w2 * f).real
                fzz += (w * twice(d, gz, gz, hz, hz, gzz, hzz)).real
                turned = w1 * (ly + 1j * lx) + 1j * w2 * f
                fxy += (w * twice(d, gx, gy, hx, hy, gxy, hxy) + turned).real
                fxz += (w * twice(d, gx, gz, hx, hz, gxz, hxz) + w1 * lz).real
                fyz += (w * twice(d, gy, gz, hy, hz, gyz, hyz) + 1j * w1 * lz).real
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
