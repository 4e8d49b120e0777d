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
FORWARD_LOSS = math.log(50.0)
LOG_PRECISION = 38.0


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
    growth = LOG_PRECISION
    if e2 != 0.0:
        growth = math.log((gamma + alpha) ** 2 / abs(e2))
    if (degree + 2) * growth < FORWARD_LOSS:
        first = logarithm(gamma, alpha, e2)
        for m in range(min(orders, degree + 1)):
            out[m, m] = first
            for n in range(m, degree):
                c = max(n + m, 1)
                out[m, n + 1] = ((2 * n + 1) * gamma - c / out[m, n]) / ((n - m + 1) * e2)
            if m < degree:
                first = out[m, m] * ((2 * m + 1) - gamma * out[m, m + 1]) / max(2 * m, 1)
        return
    extra = int(LOG_PRECISION / growth) + 2
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
