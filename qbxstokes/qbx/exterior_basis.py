"""Compiled flows of several bodies, or of one by a wall, at the points of others, from tables.

Imported only when bodies couple.
"""

import math

import numpy as np
from numba import njit

from qbxstokes.folders import compiled_are_kept
from qbxstokes.qbx.exterior_kernel import confocal, second_derivatives
from qbxstokes.qbx.exterior_sums import HARMONIC, LANES, OWN, PLACE, fill, pair, six, three


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
    count, each = points.shape[0], HARMONIC[second] * LANES
    place, made = np.empty(PLACE[1] * LANES), np.empty((degree + 1) * orders * each)
    q, own = np.empty((degree + 3, LANES)), np.empty(OWN * LANES)
    power, first = np.zeros(orders + 2, dtype=np.complex128), np.zeros(orders, dtype=np.int64)
    for m in range(orders):
        first[m] = (m * (degree + 1) - m * (m - 1) // 2 - m) * each
    for group in range(0, count, LANES):
        few = min(LANES, count - group)
        for i in range(LANES):
            point = points[group + min(i, few - 1)]
            place[i], place[LANES + i], place[2 * LANES + i] = point[0], point[1], point[2]
        fill(k, degree, orders, recurrence, second, place, made, q, own)
        for i in range(few):
            at, of = group + i, made[i:]
            g, h = three(place, 3, i), three(place, 6, i)
            gg, hh = six(place, 11, i), six(place, 17, i)
            w = complex(1.0, 0.0)
            for m in range(orders):
                power[m + 2] = w
                w *= pair(place, 9, i)
            for n in range(degree + 1):
                for m in range(min(orders, n + 1)):
                    begin, column = first[m] + n * each, 2 * (start[n] + m)
                    f, fg, fh = of[begin], of[begin + LANES], of[begin + 2 * LANES]
                    w, w1 = power[m + 2], m / k * power[m + 1]
                    l = fg * g[0] + fh * h[0], fg * g[1] + fh * h[1], fg * g[2] + fh * h[2]
                    put(table, 0, at, column, w * f)
                    put(table, 1, at, column, w * l[0] + w1 * f)
                    put(table, 2, at, column, w * l[1] + w1 * 1j * f)
                    put(table, 3, at, column, w * l[2])
                    if second:
                        w2 = m * (m - 1) / (k * k) * power[m]
                        fgg, fgh = of[begin + 3 * LANES], of[begin + 4 * LANES]
                        fhh = of[begin + 5 * LANES]
                        xx, yy, zz, xy, xz, yz = second_derivatives(
                            w, w1, w2, f, l, fg, fh, fgg, fgh, fhh, g, h, gg, hh
                        )
                        put(table, 4, at, column, xx)
                        put(table, 5, at, column, yy)
                        put(table, 6, at, column, zz)
                        put(table, 7, at, column, xy)
                        put(table, 8, at, column, xz)
                        put(table, 9, at, column, yz)


@njit(cache=compiled_are_kept())
def reach(x, y, z, k):  # type: ignore[no-untyped-def]
    """Sum of the semi-axes of the confocal spheroid through a point: E_n falls as its power -n."""
    alpha2, gamma, _ = confocal(x * x + y * y, z, (1.0 - k) * (1.0 + k))
    return math.sqrt(max(alpha2, 0.0)) + gamma


@njit(cache=compiled_are_kept())
def degree_at(out, k, tolerance, most):  # type: ignore[no-untyped-def]
    """Degree, 3 to most, beyond which harmonics are below tolerance at a point of a reach."""
    decay = min((k + 1.0) / out, 1.0 - 1e-9)
    wanted = math.ceil(math.log(tolerance) / math.log(decay)) + 2.0
    return int(min(max(wanted, 3.0), most))


@njit(cache=compiled_are_kept())
def degrees_for(points, k, tolerance, most, degrees):  # type: ignore[no-untyped-def]
    """Fill degrees (P,) at points (P, 3), see `degree_at`."""
    for i in range(points.shape[0]):
        out = reach(points[i, 0], points[i, 1], points[i, 2], k)
        degrees[i] = degree_at(out, k, tolerance, most)


@njit(cache=compiled_are_kept())
def to_frame(point, centre, turn, size, out):  # type: ignore[no-untyped-def]
    """A point (3,) of space in the frame of a body, turned by turn, in units of its size."""
    x, y, z = point[0] - centre[0], point[1] - centre[1], point[2] - centre[2]
    for a in range(3):
        out[a] = (x * turn[0, a] + y * turn[1, a] + z * turn[2, a]) / size


@njit(cache=compiled_are_kept())
def highest_degrees(points, ends, centre, turn, size, k, tolerance, most, highest):  # type: ignore[no-untyped-def]
    """Fill highest (B,): of the degrees at points (P, 3) of space between two ends each, (B + 1,).

    centre, turn, size: of the body whose harmonics they are.
    """
    own = np.empty(3)
    for b in range(highest.shape[0]):
        least = np.inf
        for i in range(ends[b], ends[b + 1]):
            to_frame(points[i], centre, turn, size, own)
            least = min(least, reach(own[0], own[1], own[2], k))
        highest[b] = degree_at(least, k, tolerance, most)


@njit(cache=compiled_are_kept(), fastmath=True, error_model="numpy")
def tabulate_blocks(  # type: ignore[no-untyped-def]
    blocks, at, points, centre, turn, size, k, orders, start, recurrence, values, own
):
    """Fill the tables of blocks of one body, and their points in its frame, own.

    points (P, 3): of space, of which at tells those of a block; see `add_arrivals` for the rest.
    """
    for i in range(blocks.shape[0]):
        columns, degree, table, first, count = blocks[i, 4:]
        rows = 10 if blocks[i, 0] else 4
        for j in range(first, first + count):
            to_frame(points[at[j]], centre, turn, size, own[j])
        where = values[table : table + rows * count * columns].reshape((rows, count, columns))
        x, few = own[first : first + count], min(degree + 1, orders)
        tabulate(x, k, degree, few, start, recurrence, int(blocks[i, 0]), where)


@njit(cache=compiled_are_kept(), fastmath=True, inline="always")
def add_velocities(points, table, c, most, turn, at, total):  # type: ignore[no-untyped-def]
    """Add the turned velocities of u_i = E B_i + d_i E (C - x . B), summed over E, to total[at].

    table: of `tabulate`; c (4, 2 K): real and imaginary parts of B_x, B_y, B_z and C, interleaved;
    most: columns of both that are summed; turn (3, 3); at (P,).
    """
    for i in range(points.shape[0]):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        u, v, w = 0.0, 0.0, 0.0
        for j in range(most):
            s = c[3, j] - x * c[0, j] - y * c[1, j] - z * c[2, j]
            e = table[0, i, j]
            u += e * c[0, j] + table[1, i, j] * s
            v += e * c[1, j] + table[2, i, j] * s
            w += e * c[2, j] + table[3, i, j] * s
        for a in range(3):
            total[at[i], a] += turn[a, 0] * u + turn[a, 1] * v + turn[a, 2] * w


@njit(cache=compiled_are_kept(), fastmath=True, inline="always")
def add_answers(points, table, c, most, turn, normal, size, heights, at, velocity):  # type: ignore[no-untyped-def]
    """Add to velocity[at], turned, a wall's answer to the flow of table and c.

    points (P, 3): mirrored, in the body frame and in its unit of length, size; heights (P,) of the
    others above the wall; normal (3,): N of the wall, in the body frame; the rest as in
    `add_velocities`. See `bie.multiple_scattering`; with the second derivatives E_ij:
    grad(u . N)_i = E_i B_N - E_N B_i + E_iN (C - x . B), grad(p)_i = -2 E_ij B_j.
    """
    n0, n1, n2 = normal[0], normal[1], normal[2]
    for i in range(points.shape[0]):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        u0, u1, u2, g0, g1, g2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        q0, q1, q2 = 0.0, 0.0, 0.0
        for j in range(most):
            b0, b1, b2 = c[0, j], c[1, j], c[2, j]
            s = c[3, j] - x * b0 - y * b1 - z * b2
            e, e0, e1, e2 = table[0, i, j], table[1, i, j], table[2, i, j], table[3, i, j]
            xx, yy, zz = table[4, i, j], table[5, i, j], table[6, i, j]
            xy, xz, yz = table[7, i, j], table[8, i, j], table[9, i, j]
            along, slope = b0 * n0 + b1 * n1 + b2 * n2, e0 * n0 + e1 * n1 + e2 * n2
            u0 += e * b0 + e0 * s
            u1 += e * b1 + e1 * s
            u2 += e * b2 + e2 * s
            g0 += e0 * along - slope * b0 + (xx * n0 + xy * n1 + xz * n2) * s
            g1 += e1 * along - slope * b1 + (xy * n0 + yy * n1 + yz * n2) * s
            g2 += e2 * along - slope * b2 + (xz * n0 + yz * n1 + zz * n2) * s
            q0 += xx * b0 + xy * b1 + xz * b2
            q1 += xy * b0 + yy * b1 + yz * b2
            q2 += xz * b0 + yz * b1 + zz * b2
        h = heights[i] / size
        v0, v1, v2 = 2.0 * h * (g0 - h * q0), 2.0 * h * (g1 - h * q1), 2.0 * h * (g2 - h * q2)
        back = 2.0 * (v0 * n0 + v1 * n1 + v2 * n2)
        v0, v1, v2 = v0 - back * n0 - u0, v1 - back * n1 - u1, v2 - back * n2 - u2
        for a in range(3):
            velocity[at[i], a] += turn[a, 0] * v0 + turn[a, 1] * v1 + turn[a, 2] * v2


@njit(cache=compiled_are_kept(), fastmath=True)
def add_arrivals(  # type: ignore[no-untyped-def]
    blocks, values, points, flows, turns, normals, sizes, heights, at, most, velocity
):
    """Add to velocity (P, 3) what blocks (M, 9) say.

    A block: whether mirrored; its number, which turns, normals and sizes go by; where a packed flow
    begins in flows and its width; columns and degree of its table; where that begins in values;
    where its points begin in points, heights and at, and how many they are. most: columns that are
    summed at most. See `bie.arrivals`.
    """
    for i in range(blocks.shape[0]):
        mirrored, number, begin, width, columns = blocks[i, :5]
        table, first, count = blocks[i, 6:]
        c = flows[begin : begin + 4 * width].reshape((4, width))
        x, where = points[first : first + count], at[first : first + count]
        rows, few = (10 if mirrored else 4), min(columns, most)
        e = values[table : table + rows * count * columns].reshape((rows, count, columns))
        turn = turns[number]
        if mirrored:
            above, size = heights[first : first + count], sizes[number]
            add_answers(x, e, c, few, turn, normals[number], size, above, where, velocity)
        else:
            add_velocities(x, e, c, few, turn, where, velocity)
