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
    rise, fall = gamma * scale, e2 * scale * scale
    for m in range(min(orders, degree + 1)):
        above, here = 1.0, 1.0
        n1 = degree + extra + 1.0
        for _ in range(extra):
            below = rise * here - fall * (n1 * n1 - m * m) / (4.0 * n1 * n1 - 1.0) * above
            above, here = here, below
            n1 -= 1.0
        for n in range(degree, m - 1, -1):
            below = rise * here - fall * (n1 * n1 - m * m) / (4.0 * n1 * n1 - 1.0) * above
            out[m, n] = scale * max(n + m, 1) * here / ((2 * n + 1) * below)
            above, here = here, below
            n1 -= 1.0


@njit(cache=compiled_are_kept())
def slopes(x, y, eta, alpha2, gamma, sine2, inv):  # type: ignore[no-untyped-def]
    """First derivatives (x, y, z) of gamma and of eta; inv = 1/Delta."""
    return (
        (x * gamma * inv, y * gamma * inv, eta * alpha2 * inv),
        (-x * eta * inv, -y * eta * inv, gamma * sine2 * inv),
    )


@njit(cache=compiled_are_kept())
def bends(x, y, eta, alpha2, gamma, sine2, inv, e2, g, h):  # type: ignore[no-untyped-def]
    """Second derivatives of gamma and of eta, xx, yy, zz, xy, xz, yz each, from the first g and h.

    (d_j N_i - gamma_i d_j Delta)/Delta.
    """
    gx, gy, gz = g
    hx, hy, hz = h
    dx = 2.0 * (gamma * gx - e2 * eta * hx)
    dy = 2.0 * (gamma * gy - e2 * eta * hy)
    dz = 2.0 * (gamma * gz - e2 * eta * hz)
    of_gamma = (
        (gamma + x * gx - gx * dx) * inv,
        (gamma + y * gy - gy * dy) * inv,
        (hz * alpha2 + 2.0 * eta * gamma * gz - gz * dz) * inv,
        (x * gy - gx * dy) * inv,
        (x * gz - gx * dz) * inv,
        (y * gz - gy * dz) * inv,
    )
    of_eta = (
        (-eta - x * hx - hx * dx) * inv,
        (-eta - y * hy - hy * dy) * inv,
        (gz * sine2 - 2.0 * gamma * eta * hz - hz * dz) * inv,
        (-x * hy - hx * dy) * inv,
        (-x * hz - hx * dz) * inv,
        (-y * hz - hy * dz) * inv,
    )
    return of_gamma, of_eta


@njit(inline="always")
def second_derivatives(w, w1, w2, f, l, fg, fh, fgg, fgh, fhh, g, h, gg, hh):  # type: ignore[no-untyped-def]
    """xx, yy, zz, xy, xz, yz of w f, w = ((x + i y)/k)^m; l: first ones of f(gamma, eta)."""
    gx, gy, gz = g
    hx, hy, hz = h
    lx, ly, lz = l
    xx = fgg * (gx * gx) + fgh * (2.0 * gx * hx) + fhh * (hx * hx) + fg * gg[0] + fh * hh[0]
    yy = fgg * (gy * gy) + fgh * (2.0 * gy * hy) + fhh * (hy * hy) + fg * gg[1] + fh * hh[1]
    zz = fgg * (gz * gz) + fgh * (2.0 * gz * hz) + fhh * (hz * hz) + fg * gg[2] + fh * hh[2]
    xy = fgg * (gx * gy) + fgh * (gx * hy + gy * hx) + fhh * (hx * hy) + fg * gg[3] + fh * hh[3]
    xz = fgg * (gx * gz) + fgh * (gx * hz + gz * hx) + fhh * (hx * hz) + fg * gg[4] + fh * hh[4]
    yz = fgg * (gy * gz) + fgh * (gy * hz + gz * hy) + fhh * (hy * hz) + fg * gg[5] + fh * hh[5]
    return (
        w * xx + 2.0 * w1 * lx + w2 * f,
        w * yy + 2j * w1 * ly - w2 * f,
        w * zz,
        w * xy + w1 * (ly + 1j * lx) + 1j * w2 * f,
        w * xz + w1 * lz,
        w * yz + 1j * w1 * lz,
    )


@njit(inline="always")
def put(table, row, i, column, value):  # type: ignore[no-untyped-def]
    """Real part and minus the imaginary part of a value, in two columns."""
    table[row, i, column], table[row, i, column + 1] = value.real, -value.imag


@njit(cache=compiled_are_kept(), fastmath=True, inline="always")
def tabulate(points, k, degree, orders, start, recurrence, second, table):  # type: ignore[no-untyped-def]
    """Fill table (4 or 10, P, 2 K) at points (P, 3) of the body frame, outside the body.

    Rows: E, its three first derivatives and, if second, xx, yy, zz, xy, xz, yz. Columns: real part
    and minus the imaginary part of E_nm for n <= degree, m <= n, m < orders, m fastest, degree n
    from the harmonic start[n] on, so that Re(sum c E) is the product with the real and imaginary
    parts of c, interleaved.
    """
    inverse_ratio, rise, fall, diagonal = recurrence
    e2 = (1.0 - k) * (1.0 + k)
    ratio, nothing = np.zeros((orders, degree + 2)), complex(0.0, 0.0)
    for i in range(points.shape[0]):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        rho2 = x * x + y * y
        alpha2, gamma, delta = confocal(rho2, z, e2)
        alpha, eta, sine2, inv = math.sqrt(alpha2), z / gamma, rho2 / alpha2, 1.0 / delta
        all_ratios(orders, degree, gamma, alpha, e2, ratio)
        g, h = slopes(x, y, eta, alpha2, gamma, sine2, inv)
        gg, hh = bends(x, y, eta, alpha2, gamma, sine2, inv, e2, g, h)
        zk, w, w1, w2 = complex(x, y) / k, complex(1.0, 0.0), nothing, nothing
        first = 1.0
        for m in range(orders):
            q = first
            p, pd, pdd = diagonal[m], 0.0, 0.0
            p_last, pd_last, pdd_last = 0.0, 0.0, 0.0
            for n in range(m, degree + 1):
                column, before = 2 * (start[n] + m), q * inverse_ratio[m, n]
                q = before * ratio[m, n]
                qg = ((n - m) * gamma * q - max(n + m, 1) * before) / alpha2
                f, fg, fh = q * p, qg * p, q * pd
                l = fg * g[0] + fh * h[0], fg * g[1] + fh * h[1], fg * g[2] + fh * h[2]
                put(table, 0, i, column, w * f)
                put(table, 1, i, column, w * l[0] + w1 * f)
                put(table, 2, i, column, w * l[1] + w1 * 1j * f)
                put(table, 3, i, column, w * l[2])
                if second:
                    qgg = (-2.0 * (m + 1) * gamma * qg + (n - m) * (n + m + 1) * q) / alpha2
                    fgg, fgh, fhh = qgg * p, qg * pd, q * pdd
                    xx, yy, zz, xy, xz, yz = second_derivatives(
                        w, w1, w2, f, l, fg, fh, fgg, fgh, fhh, g, h, gg, hh
                    )
                    put(table, 4, i, column, xx)
                    put(table, 5, i, column, yy)
                    put(table, 6, i, column, zz)
                    put(table, 7, i, column, xy)
                    put(table, 8, i, column, xz)
                    put(table, 9, i, column, yz)
                up, down = rise[m, n], fall[m, n]
                p, p_last, pd, pd_last, pdd, pdd_last = (
                    *(up * eta * p - down * p_last, p),
                    *(up * (eta * pd + p) - down * pd_last, pd),
                    *(up * (eta * pdd + 2.0 * pd) - down * pdd_last, pdd),
                )
            w, w1, w2 = w * zk, (m + 1) / k * w, (m + 1) / k * w1
            first *= k * k / alpha2


@njit(cache=compiled_are_kept(), fastmath={"reassoc", "contract", "arcp", "nsz"})
def evaluate(  # type: ignore[no-untyped-def]
    points,
    k,
    c,
    orders,
    start,
    recurrence,
    amplitude,
    tolerance,
    margin,
    out,
):
    """Fill out (N, 4 or 16) at points (N, 3): u = B + grad(C - x . B), x held, p and the rest.

    c (4, 2 K): packed coefficients of B_x, B_y, B_z and C; k, orders, start, recurrence: as in
    `tabulate`. amplitude (degree + 1): size of the terms of each degree on the surface; at a point,
    degrees whose sum stays below tolerance are left out. The pressure is -2 div B and the gradient
    d_j u_i = d_i d_j (C - x . B) + d_j B_i - d_i B_j (Papkovich and Neuber; Kim & Karrila 1991,
    sec. 4.2). The rest: stress xx, yy, zz, xy, xz, yz, vorticity, and the pressure's gradient.
    Points inside the surface by more than margin (in the sum of squares that is 1 on it) get NaN.
    """
    e2, with_second, top = (1.0 - k) * (1.0 + k), out.shape[1] > 4, amplitude.shape[0] - 1
    table = np.empty((10 if with_second else 4, 1, c.shape[1]))
    for i in range(points.shape[0]):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        rho2 = x * x + y * y
        # NaN coordinates fail the comparison and are marked as well.
        if not (rho2 / (k * k) + z * z >= 1.0 - margin):
            out[i, :] = np.nan
            continue
        degree = top
        if tolerance > 0.0:
            alpha2, gamma, _ = confocal(rho2, z, e2)
            decay, tail = (1.0 + k) / (gamma + math.sqrt(alpha2)), 0.0
            power = decay ** (top + 1)
            while degree > 1:
                tail += amplitude[degree] * power
                if tail > tolerance:
                    break
                power /= decay
                degree -= 1
        few = min(orders, degree + 1)
        tabulate(points[i : i + 1], k, degree, few, start, recurrence, with_second, table)
        u, v, w, div = 0.0, 0.0, 0.0, 0.0
        xx, yy, zz, xy, xz, yz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        s0, s1, s2, p0, p1, p2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for j in range(2 * (start[degree] + few)):
            b0, b1, b2 = c[0, j], c[1, j], c[2, j]
            s = c[3, j] - x * b0 - y * b1 - z * b2
            e, g0, g1, g2 = table[0, 0, j], table[1, 0, j], table[2, 0, j], table[3, 0, j]
            u += e * b0 + g0 * s
            v += e * b1 + g1 * s
            w += e * b2 + g2 * s
            div += g0 * b0 + g1 * b1 + g2 * b2
            if with_second:
                h0, h1, h2 = table[4, 0, j], table[5, 0, j], table[6, 0, j]
                h3, h4, h5 = table[7, 0, j], table[8, 0, j], table[9, 0, j]
                xx, yy, zz = xx + h0 * s, yy + h1 * s, zz + h2 * s
                xy, xz, yz = xy + h3 * s, xz + h4 * s, yz + h5 * s
                s0 += b2 * g1 - b1 * g2
                s1 += b0 * g2 - b2 * g0
                s2 += b1 * g0 - b0 * g1
                p0 += h0 * b0 + h3 * b1 + h4 * b2
                p1 += h3 * b0 + h1 * b1 + h5 * b2
                p2 += h4 * b0 + h5 * b1 + h2 * b2
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = u, v, w, -2.0 * div
        if with_second:
            out[i, 4], out[i, 5], out[i, 6] = 2.0 * (xx + div), 2.0 * (yy + div), 2.0 * (zz + div)
            out[i, 7], out[i, 8], out[i, 9] = 2.0 * xy, 2.0 * xz, 2.0 * yz
            out[i, 10], out[i, 11], out[i, 12] = 2.0 * s0, 2.0 * s1, 2.0 * s2
            out[i, 13], out[i, 14], out[i, 15] = -2.0 * p0, -2.0 * p1, -2.0 * p2


@njit(cache=compiled_are_kept(), fastmath=True)
def exterior(velocity, inverse, moments, gain, start, out):  # type: ignore[no-untyped-def]
    """Add to out (4, 2 K), packed, the flow of velocities (T, n_phi, 3) on circles of the surface.

    inverse (modes, 3 S, 3 T): density from velocity, and moments (modes, degree + 1, 3 S): C from
    density, see `exterior.SurfaceToExterior`; gain, start: of the harmonics.
    """
    circles, n_phi = velocity.shape[0], velocity.shape[1]
    modes, size, degree = inverse.shape[0], inverse.shape[1] // 3, moments.shape[1] - 1
    angle = 2.0 * math.pi / n_phi * np.arange(n_phi)
    c, s = np.cos(angle), np.sin(angle)
    around = np.empty((3, circles, n_phi))
    for t in range(circles):
        for j in range(n_phi):
            x, y = velocity[t, j, 0] / n_phi, velocity[t, j, 1] / n_phi
            around[0, t, j], around[1, t, j] = c[j] * x + s[j] * y, c[j] * y - s[j] * x
            around[2, t, j] = velocity[t, j, 2] / n_phi
    re, im = np.empty(3 * circles), np.empty(3 * circles)
    density = np.empty((3 * size, 2))
    of_cosine, of_sine = np.empty(n_phi), np.empty(n_phi)
    for m in range(modes):
        for j in range(n_phi):
            of_cosine[j], of_sine[j] = c[m * j % n_phi], s[m * j % n_phi]
        for part in range(3):
            for t in range(circles):
                a, b = 0.0, 0.0
                for j in range(n_phi):
                    a += around[part, t, j] * of_cosine[j]
                    b -= around[part, t, j] * of_sine[j]
                # The part along phi is divided by i.
                row = part * circles + t
                re[row], im[row] = (b, -a) if part == 1 else (a, b)
        for i in range(3 * size):
            a, b = 0.0, 0.0
            for row in range(3 * circles):
                a += inverse[m, i, row] * re[row]
                b += inverse[m, i, row] * im[row]
            density[i, 0], density[i, 1] = a, b
        twice = 2.0 if m > 0 else 1.0
        for n in range(m, degree + 1):
            a, b = 0.0, 0.0
            for i in range(3 * size):
                a += moments[m, n, i] * density[i, 0]
                b += moments[m, n, i] * density[i, 1]
            column = 2 * (start[n] + m)
            out[3, column] += twice * a
            out[3, column + 1] += twice * b
        # B_x + i B_y of orders m + 1 and, from the conjugate modes, -(m - 1).
        for n in range(m + 1, size):
            a, b = gain[m + 1, n] * density[n, 0], gain[m + 1, n] * density[n, 1]
            column = 2 * (start[n] + m + 1)
            out[0, column] += a
            out[0, column + 1] += b
            out[1, column] += b
            out[1, column + 1] -= a
        for n in range(m - 1 if m > 0 else size, size):
            a, b = gain[m - 1, n] * density[size + n, 0], gain[m - 1, n] * density[size + n, 1]
            column = 2 * (start[n] + m - 1)
            out[0, column] += a
            out[0, column + 1] += b
            out[1, column] -= b
            out[1, column + 1] += a
        for n in range(m, size):
            column, g = 2 * (start[n] + m), twice * gain[m, n]
            out[2, column] += g * density[2 * size + n, 0]
            out[2, column + 1] += g * density[2 * size + n, 1]
