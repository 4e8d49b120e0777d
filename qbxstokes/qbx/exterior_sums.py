"""Sums of exterior spheroidal harmonics at points, many points at a time.

An exterior flow is u = B + grad(C - x . B), x held fixed under the gradient, with B and C real
parts of sums c E_nm (see `exterior_kernel`). Of E_nm = w f(gamma, eta), w = ((x + i y) / k)^m, a
table holds f and its derivatives in gamma and eta alone, real numbers; what is common to the
harmonics of one order, and to all of a point, follows when the degrees are summed.

Points are taken in groups of LANES, one instruction for several of them. What belongs to a group is
in rows of LANES numbers: of its place, and of each harmonic, order by order. Compiled by numba, and
imported only when a field has to be evaluated.
"""

import math

import numpy as np
from numba import njit

from qbxstokes.folders import compiled_are_kept
from qbxstokes.qbx.exterior_kernel import (
    FORWARD_LOSS,
    LOG_PRECISION,
    all_ratios,
    bends,
    confocal,
    second_derivatives,
    slopes,
)

LANES = 32
_FUSED = {"contract"}  # sums and products in one; the order of sums stays
# Rows of a place: x, y, z, the gradients of gamma and eta, (x + i y) / k, and if second derivatives
# are wanted, those of gamma and eta, six each. Rows of a harmonic: f, f_g, f_h, f_gg, f_gh, f_hh.
PLACE, HARMONIC = (11, 23), (3, 6)
# Rows of memory that filling and summing take.
OWN, _SUMS = 14, 70


@njit(inline="always")
def shrinking(n, m, e2):  # type: ignore[no-untyped-def]
    """Factor of b_n in the recurrence that gives b_(n - 2) from it and b_(n - 1)."""
    return (n * n - m * m) / (4.0 * n * n - 1.0) * e2


@njit(cache=compiled_are_kept(), fastmath=_FUSED, inline="always")
def fill(k, degree, orders, recurrence, second, place, table, q, own):  # type: ignore[no-untyped-def]
    """Fill the table of a group of points outside the body, whose x, y, z the place holds.

    orders: at most degree + 1. Memory: q (degree + 3, LANES), own (OWN * LANES,).
    """
    inverse_ratio, rise, fall, diagonal = recurrence
    e2, nearest = (1.0 - k) * (1.0 + k), np.inf
    for i in range(LANES):
        x, y, z = place[i], place[LANES + i], place[2 * LANES + i]
        rho2 = x * x + y * y
        alpha2, gamma, delta = confocal(rho2, z, e2)
        alpha, eta, sine2, inv = math.sqrt(alpha2), z / gamma, rho2 / alpha2, 1.0 / delta
        g, h = slopes(x, y, eta, alpha2, gamma, sine2, inv)
        place[3 * LANES + i], place[4 * LANES + i], place[5 * LANES + i] = g
        place[6 * LANES + i], place[7 * LANES + i], place[8 * LANES + i] = h
        place[9 * LANES + i], place[10 * LANES + i] = x / k, y / k
        if second:
            gg, hh = bends(x, y, eta, alpha2, gamma, sine2, inv, e2, g, h)
            for a in range(6):
                place[(11 + a) * LANES + i], place[(17 + a) * LANES + i] = gg[a], hh[a]
        own[i], own[LANES + i] = gamma, eta
        own[2 * LANES + i], own[3 * LANES + i] = 1.0 / alpha2, k * k / alpha2
        own[4 * LANES + i] = 1.0  # (k / alpha)^(2 m)
        own[5 * LANES + i] = 2.0 / (gamma + alpha)  # the scale of b_n
        nearest = min(nearest, gamma + alpha)
    growth = LOG_PRECISION
    if e2 != 0.0:
        growth = math.log(nearest * nearest / abs(e2))
    forward = (degree + 2) * growth < FORWARD_LOSS  # of some, near a thin body
    ratio = np.empty((LANES if forward else 0, orders, degree + 2))
    if forward:
        for i in range(LANES):
            all_ratios(orders, degree, own[i], math.sqrt(1.0 / own[2 * LANES + i]), e2, ratio[i])
    extra = 2 * int(0.5 * LOG_PRECISION / growth + 1.5)
    number, each = 0, HARMONIC[second]
    for m in range(orders):
        # b_n backwards as in `all_ratios`, at q[n + 1], or by these ratios Q_n^(m) itself.
        if forward:
            for i in range(LANES):
                q[m, i], own[5 * LANES + i] = own[4 * LANES + i], 1.0
                for n in range(m, degree + 1):
                    q[n + 1, i] = q[n, i] * inverse_ratio[m, n] * ratio[i, m, n]
        else:
            above, here = q[degree + 2], q[degree + 1]
            above[:], here[:] = 1.0, 1.0
            for n in range(degree + extra + 1, degree + 1, -2):
                one, two = shrinking(n, m, e2), shrinking(n - 1, m, e2)
                for i in range(LANES):
                    gamma, scale, last = own[i], own[5 * LANES + i], here[i]
                    next_ = scale * (gamma * last - one * scale * above[i])
                    above[i] = next_
                    here[i] = scale * (gamma * next_ - two * scale * last)
            for n in range(degree + 1, m, -1):
                part, below, here, above = shrinking(n, m, e2), q[n - 1], q[n], q[n + 1]
                for i in range(LANES):
                    scale = own[5 * LANES + i]
                    below[i] = scale * (own[i] * here[i] - part * scale * above[i])
        below = q[m]
        for i in range(LANES):
            own[6 * LANES + i] = own[4 * LANES + i] / below[i]
            own[7 * LANES + i] = own[4 * LANES + i]  # q_n = Q_n^(m) over that on the surface
            own[4 * LANES + i] *= own[3 * LANES + i]
        own[8 * LANES : 14 * LANES] = 0.0
        own[8 * LANES : 9 * LANES] = diagonal[m]
        for n in range(m, degree + 1):
            up, down, weight = rise[m, n], fall[m, n], max(n + m, 1) * inverse_ratio[m, n]
            along, across, twice = n - m, -2.0 * (m + 1), (n - m) * (n + m + 1)
            part = 1.0 if forward else weight / (2.0 * n + 1.0)
            rows, above = table[number * each * LANES : (number + 1) * each * LANES], q[n + 1]
            for i in range(LANES):
                gamma, eta, inv = own[i], own[LANES + i], own[2 * LANES + i]
                p, pd = own[8 * LANES + i], own[9 * LANES + i]
                own[6 * LANES + i] *= own[5 * LANES + i] * part
                f = own[6 * LANES + i] * above[i]
                fg = (along * gamma * f - weight * own[7 * LANES + i]) * inv
                own[7 * LANES + i] = f
                rows[i], rows[LANES + i], rows[2 * LANES + i] = f * p, fg * p, f * pd
                if second:
                    pdd = own[10 * LANES + i]
                    rows[3 * LANES + i] = (across * gamma * fg + twice * f) * inv * p
                    rows[4 * LANES + i], rows[5 * LANES + i] = fg * pd, f * pdd
                    own[10 * LANES + i] = up * (eta * pdd + 2.0 * pd) - down * own[13 * LANES + i]
                    own[13 * LANES + i] = pdd
                own[8 * LANES + i] = up * eta * p - down * own[11 * LANES + i]
                own[9 * LANES + i] = up * (eta * pd + p) - down * own[12 * LANES + i]
                own[11 * LANES + i], own[12 * LANES + i] = p, pd
            number += 1


@njit(inline="always")
def pair(rows, row, i):  # type: ignore[no-untyped-def]
    """The complex number of a point whose parts are in two rows."""
    return complex(rows[row * LANES + i], rows[(row + 1) * LANES + i])


@njit(inline="always")
def three(rows, row, i):  # type: ignore[no-untyped-def]
    """The numbers of a point in three rows."""
    return rows[row * LANES + i], rows[(row + 1) * LANES + i], rows[(row + 2) * LANES + i]


@njit(inline="always")
def six(rows, row, i):  # type: ignore[no-untyped-def]
    """The numbers of a point in six rows."""
    return three(rows, row, i) + three(rows, row + 3, i)


@njit(inline="always")
def slope(w, w1, f, fg, fh, g, h):  # type: ignore[no-untyped-def]
    """First derivatives (x, y, z) of the real part of w f(gamma, eta)."""
    return (
        (w * (fg * g[0] + fh * h[0]) + w1 * f).real,
        (w * (fg * g[1] + fh * h[1]) + 1j * w1 * f).real,
        (w * (fg * g[2] + fh * h[2])).real,
    )


@njit(inline="always")
def bend(w, w1, w2, f, fg, fh, fgg, fgh, fhh, g, h, gg, hh):  # type: ignore[no-untyped-def]
    """Second derivatives xx, yy, zz, xy, xz, yz of the real part of w f(gamma, eta)."""
    l = fg * g[0] + fh * h[0], fg * g[1] + fh * h[1], fg * g[2] + fh * h[2]
    xx, yy, zz, xy, xz, yz = second_derivatives(
        w, w1, w2, f, l, fg, fh, fgg, fgh, fhh, g, h, gg, hh
    )
    return xx.real, yy.real, zz.real, xy.real, xz.real, yz.real


@njit(cache=compiled_are_kept(), fastmath=_FUSED, inline="always")
def add_up(place, table, degree, orders, k, c, start, second, own):  # type: ignore[no-untyped-def]
    """Write u and p of a packed flow (4, 2 K) at a group of points to rows 0 to 3 of own.

    If second, stress, vorticity and the pressure's gradient to rows 4 to 15. Memory: own
    (_SUMS * LANES,).
    """
    # Rows: w and its derivatives w1, w2 from 16 on; from 22 on, of one order, the sums of f, f_g,
    # f_h, f_gg, f_gh, f_hh times B_x, B_y, B_z and C each.
    first, each = 0, HARMONIC[second]
    own[: 22 * LANES] = 0.0
    own[16 * LANES : 17 * LANES] = 1.0
    for m in range(orders):
        own[22 * LANES : (22 + 8 * each) * LANES] = 0.0
        for n in range(m, degree + 1, 2):
            after, counts = min(n + 1, degree), 1.0 if n < degree else 0.0
            j, rows = 2 * (start[n] + m), table[(first + n - m) * each * LANES :]
            j2, more = 2 * (start[after] + m), table[(first + after - m) * each * LANES :]
            x_re, y_re, z_re, s_re = c[0, j], c[1, j], c[2, j], c[3, j]
            x_im, y_im, z_im, s_im = c[0, j + 1], c[1, j + 1], c[2, j + 1], c[3, j + 1]
            x_re2, x_im2 = counts * c[0, j2], counts * c[0, j2 + 1]
            y_re2, y_im2 = counts * c[1, j2], counts * c[1, j2 + 1]
            z_re2, z_im2 = counts * c[2, j2], counts * c[2, j2 + 1]
            s_re2, s_im2 = counts * c[3, j2], counts * c[3, j2 + 1]
            for row in range(each):
                sums = own[(22 + 8 * row) * LANES : (30 + 8 * row) * LANES]
                here, there = rows[row * LANES :], more[row * LANES :]
                for i in range(LANES):
                    f, f2 = here[i], there[i]
                    sums[i] += f * x_re + f2 * x_re2
                    sums[LANES + i] += f * x_im + f2 * x_im2
                    sums[2 * LANES + i] += f * y_re + f2 * y_re2
                    sums[3 * LANES + i] += f * y_im + f2 * y_im2
                    sums[4 * LANES + i] += f * z_re + f2 * z_re2
                    sums[5 * LANES + i] += f * z_im + f2 * z_im2
                    sums[6 * LANES + i] += f * s_re + f2 * s_re2
                    sums[7 * LANES + i] += f * s_im + f2 * s_im2
        first += degree + 1 - m
        for i in range(LANES):
            x, y, z = place[i], place[LANES + i], place[2 * LANES + i]
            g, h = three(place, 3, i), three(place, 6, i)
            w, w1, w2 = pair(own, 16, i), pair(own, 18, i), pair(own, 20, i)
            a, b, e, s = pair(own, 22, i), pair(own, 24, i), pair(own, 26, i), pair(own, 28, i)
            ag, bg, eg, sg = pair(own, 30, i), pair(own, 32, i), pair(own, 34, i), pair(own, 36, i)
            ah, bh, eh, sh = pair(own, 38, i), pair(own, 40, i), pair(own, 42, i), pair(own, 44, i)
            s, sg = s - x * a - y * b - z * e, sg - x * ag - y * bg - z * eg
            sh = sh - x * ah - y * bh - z * eh
            of_a, of_b = slope(w, w1, a, ag, ah, g, h), slope(w, w1, b, bg, bh, g, h)
            of_e, of_s = slope(w, w1, e, eg, eh, g, h), slope(w, w1, s, sg, sh, g, h)
            own[i] += (w * a).real + of_s[0]
            own[LANES + i] += (w * b).real + of_s[1]
            own[2 * LANES + i] += (w * e).real + of_s[2]
            own[3 * LANES + i] -= 2.0 * (of_a[0] + of_b[1] + of_e[2])
            if second:
                gg, hh = six(place, 11, i), six(place, 17, i)
                r, t, v = pair(own, 46, i), pair(own, 54, i), pair(own, 62, i)
                xx, _, _, xy, xz, _ = bend(w, w1, w2, a, ag, ah, r, t, v, g, h, gg, hh)
                q0, q1, q2 = xx, xy, xz
                rr, tt, vv = x * r, x * t, x * v
                r, t, v = pair(own, 48, i), pair(own, 56, i), pair(own, 64, i)
                _, yy, _, xy, _, yz = bend(w, w1, w2, b, bg, bh, r, t, v, g, h, gg, hh)
                q0, q1, q2 = q0 + xy, q1 + yy, q2 + yz
                rr, tt, vv = rr + y * r, tt + y * t, vv + y * v
                r, t, v = pair(own, 50, i), pair(own, 58, i), pair(own, 66, i)
                _, _, zz, _, xz, yz = bend(w, w1, w2, e, eg, eh, r, t, v, g, h, gg, hh)
                q0, q1, q2 = q0 + xz, q1 + yz, q2 + zz
                rr, tt, vv = rr + z * r, tt + z * t, vv + z * v
                r, t, v = pair(own, 52, i) - rr, pair(own, 60, i) - tt, pair(own, 68, i) - vv
                xx, yy, zz, xy, xz, yz = bend(w, w1, w2, s, sg, sh, r, t, v, g, h, gg, hh)
                div = of_a[0] + of_b[1] + of_e[2]
                own[4 * LANES + i] += 2.0 * (xx + div)
                own[5 * LANES + i] += 2.0 * (yy + div)
                own[6 * LANES + i] += 2.0 * (zz + div)
                own[7 * LANES + i] += 2.0 * xy
                own[8 * LANES + i] += 2.0 * xz
                own[9 * LANES + i] += 2.0 * yz
                own[10 * LANES + i] += 2.0 * (of_e[1] - of_b[2])
                own[11 * LANES + i] += 2.0 * (of_a[2] - of_e[0])
                own[12 * LANES + i] += 2.0 * (of_b[0] - of_a[1])
                own[13 * LANES + i] -= 2.0 * q0
                own[14 * LANES + i] -= 2.0 * q1
                own[15 * LANES + i] -= 2.0 * q2
            rate = (m + 1) / k
            own[18 * LANES + i], own[19 * LANES + i] = rate * w.real, rate * w.imag
            own[20 * LANES + i], own[21 * LANES + i] = rate * w1.real, rate * w1.imag
            w = w * pair(place, 9, i)
            own[16 * LANES + i], own[17 * LANES + i] = w.real, w.imag


@njit(cache=compiled_are_kept(), fastmath=_FUSED, error_model="numpy")
def evaluate(  # type: ignore[no-untyped-def]
    points, k, c, orders, start, recurrence, amplitude, tolerance, margin, out
):
    """Fill out (N, 4 or 16) at points (N, 3) of the body frame: u, p and the rest.

    c (4, 2 K): packed coefficients of B_x, B_y, B_z and C; k, orders, start, recurrence: of
    `Harmonics`. amplitude (degree + 1): size of the terms of each degree on the surface; degrees
    whose sum stays below tolerance at all of a group are left out. The pressure is -2 div B and the
    gradient d_j u_i = d_i d_j (C - x . B) + d_j B_i - d_i B_j (Papkovich and Neuber; Kim & Karrila
    1991, sec. 4.2). The rest: stress (xx, yy, zz, xy, xz, yz), vorticity, grad p.
    Points inside the surface by more than margin (in the sum of squares that is 1 on it) get NaN.
    """
    second, top = 1 if out.shape[1] > 4 else 0, amplitude.shape[0] - 1
    harmonics = (top + 1) * min(orders, top + 1)
    place, table = np.empty(PLACE[second] * LANES), np.empty(HARMONIC[second] * harmonics * LANES)
    q = np.empty((top + 3, LANES))
    own, outside = np.empty(_SUMS * LANES), np.empty(LANES, dtype=np.bool_)
    e2 = (1.0 - k) * (1.0 + k)
    for begin in range(0, points.shape[0], LANES):
        nearest, count = np.inf, min(LANES, points.shape[0] - begin)
        for i in range(LANES):
            point = points[begin + min(i, count - 1)]
            rho2, z = point[0] * point[0] + point[1] * point[1], point[2]
            # NaN coordinates fail the comparison and are marked as well.
            outside[i] = rho2 / (k * k) + z * z >= 1.0 - margin
            if outside[i]:
                place[i], place[LANES + i], place[2 * LANES + i] = point[0], point[1], z
                alpha2, gamma, _ = confocal(rho2, z, e2)
                nearest = min(nearest, gamma + math.sqrt(alpha2))
            else:
                place[i], place[LANES + i], place[2 * LANES + i] = 0.0, 0.0, 2.0
        degree = top
        if tolerance > 0.0:
            decay = (1.0 + k) / nearest
            tail, power = 0.0, decay ** (top + 1)
            while degree > 1:
                tail += amplitude[degree] * power
                if tail > tolerance:
                    break
                power /= decay
                degree -= 1
        few = min(orders, degree + 1)
        fill(k, degree, few, recurrence, second, place, table, q, own)
        add_up(place, table, degree, few, k, c, start, second, own)
        for i in range(count):
            for row in range(out.shape[1]):
                out[begin + i, row] = own[row * LANES + i] if outside[i] else np.nan
