"""One spheroid over a plane wall from a table: its motion depends on gap and tilt alone.

In the frame of the wall's normal N and the plane of N and the axis, the free body's velocities are
linear in its loads (a mobility) and in the flow. One that vanishes on the wall is, to degree 2,

    u = z (a + A x + b z) - 1/2 tr(A) z^2 N     (a, A, b tangential, about the foot of the centre)

Both are tabulated by Chebyshev polynomials in the logarithm of the gap, cell by cell of a factor
two, made as they are first visited, and in sigma, tan(sigma) = sqrt(k) tan(tilt), which keeps the
singularities of long and of flat bodies equally far away. The mobility is bounded at contact, where
the resistance is singular by lubrication.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numba import njit
from numpy.typing import NDArray

from qbxstokes.errors import ContactError, SceneError
from qbxstokes.flows import Flow
from qbxstokes.flows.polynomial import PolynomialFlow
from qbxstokes.simulation.body import Body
from qbxstokes.simulation.suspension import Suspension
from qbxstokes.simulation.wall import Wall

Array = NDArray[np.float64]

# Even and odd under reflection in the plane of axis and normal: velocities and loads alike.
_EVEN, _ODD = (0, 2, 4), (1, 3, 5)
# First and last cell, powers of two of the gap in polar radii, and the most polynomials of each.
FIRST, LAST, _MOST = -8, 6, 40
# Polar nodes of the solutions that a cell is made from, at most: a few minutes.
_FINEST = 28
# Modes of the flow (a1, A11, A22, b1; a2, A12, A21, b2): u = z f e1 or z f e2.
_MODES = ((0, ""), (0, "x"), (1, "y"), (0, "z"), (1, ""), (0, "y"), (1, "x"), (1, "z"))


class Cells(Protocol):
    """What keeps cells from run to run: `io.cache.Cache`."""

    def load(self, kind: str, key: Mapping[str, Any]) -> Mapping[str, Array] | None:
        """The arrays of a key."""

    def store(self, kind: str, key: Mapping[str, Any], arrays: Mapping[str, Array]) -> None:
        """Keep them."""


class OverWall:
    """The free motion of one body over a wall in a flow of degree 2, from a table.

    tolerance: of the table, relative to the largest response of a kind. error_estimate: the largest
    part, relative, that the cells so far leave out. cells: gaps they span, in polar radii.

    >>> import qbxstokes as qs
    >>> table = qs.OverWall(qs.Body(1.0), qs.Wall(), tolerance=1e-3)
    >>> u, _ = table.free_motion(qs.flow("shear"), [[0, 2.5, 0]], [[0, 0, 1]])
    >>> bool(2.3 < u[0, 0] < 2.5)  # slower than the flow there
    True
    """

    def __init__(
        self, body: Body, wall: Wall, *, tolerance: float = 1e-6, cache: Cells | None = None
    ) -> None:
        self.body, self.wall, self.tolerance, self.cache = body, wall, tolerance, cache
        self._scene = Suspension(
            [Body(shape=body.shape)], Wall(normal=(0.0, 0.0, 1.0)), tolerance=0.3 * tolerance
        )
        self.ratio = self._scene.placed([[0.0, 0.0, 9.0]])[0].ratio
        self._cells = np.zeros((LAST - FIRST, 1, 1, 42))
        # Per cell and polynomial of the gap: how many of the tilt are of account; 0: not made.
        self._reach = np.zeros((LAST - FIRST, 1), dtype=np.int64)
        plane = wall.plane
        self._plane = np.stack([plane.normal, plane.point, plane.velocity])
        self.error_estimate = 0.0

    # -- answers ------------------------------------------------------------------------------

    def free_motion(
        self, flow: Flow | None, position: Any, axis: Any, load: Any = None, t: float = 0.0
    ) -> tuple[Array, Array]:
        """Velocities and angular velocities (N, 3) of N bodies, each alone over the wall.

        position, axis (N, 3), load (N, 6): force and torque. Raises SceneError for a gap beyond
        the cells (1/256 to 64 polar radii) and for flows of higher degree.
        """
        return self.motion(self.flow_terms(flow, t), position, axis, load)

    def motion(
        self, terms: Array, position: Any, axis: Any, load: Any = None
    ) -> tuple[Array, Array]:
        """The same in a flow of which `flow_terms` were found before."""
        x, d = np.asarray(position, dtype=np.float64), np.asarray(axis, dtype=np.float64)
        loads = np.zeros((len(x), 6)) if load is None else np.asarray(load, dtype=np.float64)
        out = np.empty((len(x), 6))
        place = self._plane, self.ratio, self.body.size, terms
        while True:
            where = _evaluate(x, d, loads, *place, FIRST, self._reach, self._cells, out)
            if where == -1:
                return out[:, :3], out[:, 3:]
            if not FIRST <= where - 1000 < LAST:
                raise SceneError(
                    "position",
                    "has a gap to the wall that no table holds",
                    f"gaps from {2.0**FIRST:g} to {2.0**LAST:g} polar radii",
                )
            self._fill(where - 1000)

    def drag(self, terms: Array, position: Array, axis: Array, motion: Array) -> Array:
        """Force and torque (6,) of the fluid ON one body of given velocities (6,)."""
        x, d = np.repeat(position[None], 7, axis=0), np.repeat(axis[None], 7, axis=0)
        free = np.hstack(self.motion(terms, x, d, np.vstack([np.zeros(6), np.eye(6)])))
        return np.asarray(np.linalg.solve((free[1:] - free[0]).T, free[0] - motion))

    def flow_terms(self, flow: Flow | None, t: float = 0.0) -> Array:
        """a (3,), A (3, 3) and b (3,) of a flow about the wall's point, as the rows of (5, 3)."""
        if flow is None:
            return np.zeros((5, 3))
        if flow.degree is None or flow.degree > 2:
            raise SceneError("flow", "is no polynomial of degree 2", "one for a table by the wall")
        self.wall.check(flow, t)
        normal, point = self._plane[:2]
        across = np.linalg.svd(normal[None])[2][1:]
        at = np.stack([point, point + normal, *(point + across)])
        a, up, *sides = flow.gradient(at, t) @ normal
        matrix = sum(np.outer(side - a, e) for side, e in zip(sides, across, strict=True))
        flat = np.eye(3) - np.outer(normal, normal)
        return np.vstack([flat @ a, flat @ matrix, flat @ (0.5 * (up - a))])

    # -- cells --------------------------------------------------------------------------------

    def _fill(self, cell: int) -> None:
        """Make a cell, or take it from the cache. Raises ContactError too near to the wall."""
        near = self._scene.placed([[0.0, 0.0, 1.0 + 2.0**cell]])
        nodes = self._scene.grids(near, free=True)[0]
        if nodes > _FINEST:
            raise ContactError(
                "body 1 and the wall", 2.0**cell, f"{nodes} polar nodes are more than a table takes"
            )
        key = {"k": self.ratio, "tolerance": self.tolerance, "cell": cell}
        kept = None if self.cache is None else self.cache.load("over_wall", key)
        if kept is None:
            values, left = self._tabulated(cell)
            if self.cache is not None:
                self.cache.store("over_wall", key, {"values": values, "left": np.array(left)})
        else:
            values, left = kept["values"], float(kept["left"])
        shape = np.maximum(values.shape, self._cells.shape[1:])
        grown = np.zeros((len(self._cells), *shape))
        grown[:, : self._cells.shape[1], : self._cells.shape[2]] = self._cells
        grown[cell - FIRST, : values.shape[0], : values.shape[1]] = values
        self._cells = grown
        # What is left out of the sums adds a tenth to what the polynomials leave.
        small = (
            np.abs(values).max(axis=2)
            < 0.1 * self.tolerance / values[..., 0].size * _scale(values).min()
        )
        reach = np.zeros((len(self._cells), shape[0]), dtype=np.int64)
        reach[:, : self._reach.shape[1]] = self._reach
        last = values.shape[1] - np.argmin(small[:, ::-1], axis=1)
        reach[cell - FIRST, : len(values)] = np.where(small.all(axis=1), 0, last)
        self._reach = reach
        self.error_estimate = max(self.error_estimate, left)

    def _tabulated(self, cell: int) -> tuple[Array, float]:
        """Coefficients (gap, tilt, 42) of a cell and what they leave out, relative."""
        digits = -math.log(self.tolerance)
        # Decay of the polynomials: the logarithm is singular at i pi, the tilt at atanh sqrt k.
        thin = min(self.ratio, 1.0 / self.ratio)
        gaps = max(3, math.ceil(digits / math.log(18.0)) + 1)
        tilts = 1 if thin == 1.0 else max(5, math.ceil(digits / (1.2 + 1.2 * thin)) + 1)
        while True:
            values = self._coefficients(cell, gaps, tilts)
            relative = np.abs(values) / np.repeat(_scale(values), [18, 24])
            in_gap = float(relative[-1].sum(axis=0).max())
            in_tilt = float(relative[:, -1].sum(axis=0).max()) if tilts > 1 else 0.0
            left = in_gap + in_tilt
            if left <= self.tolerance or max(gaps, tilts) >= _MOST:
                return values, left + 0.3 * self.tolerance
            gaps += 2 * (in_gap > 0.5 * self.tolerance)
            tilts += 4 * (in_tilt > 0.5 * self.tolerance)

    def _coefficients(self, cell: int, gaps: int, tilts: int) -> Array:
        s, places = _nodes(gaps), _nodes(tilts)
        values = np.array(
            [
                [self._solved(2.0 ** (cell + 0.5 * (1.0 + p)), self._tilt(q)) for q in places]
                for p in s
            ]
        )
        return np.einsum("ip,jq,pqf->ijf", _transform(gaps), _transform(tilts), values)

    def _tilt(self, place: float) -> float:
        sigma = 0.25 * math.pi * (1.0 + place)
        return math.atan2(math.sin(sigma), math.sqrt(self.ratio) * math.cos(sigma))

    def _solved(self, gap: float, tilt: float) -> Array:
        """The 42 numbers at a gap and tilt: mobilities 3 x 3 and responses 3 x 4, even and odd."""
        scene, k = self._scene, self.ratio
        d = np.array([math.sin(tilt), 0.0, math.cos(tilt)])
        x = np.array([[0.0, 0.0, math.hypot(k * d[0], d[2]) + gap]])
        problem = scene.problem(scene.placed(x, d))
        columns = []
        for load in np.eye(6):
            found = scene.freed(problem, load[None], None, None)
            columns.append(np.concatenate([found.velocity[0], found.angular_velocity[0]]))
        for part, factor in _MODES:
            found = scene.freed(problem, np.zeros((1, 6)), _mode(part, factor).velocity, None)
            columns.append(np.concatenate([found.velocity[0], found.angular_velocity[0]]))
        m, flows = np.stack(columns[:6], 1), np.stack(columns[6:], 1)
        blocks = (
            m[np.ix_(_EVEN, _EVEN)],
            m[np.ix_(_ODD, _ODD)],
            flows[_EVEN, :4],
            flows[_ODD, 4:],
        )
        return np.concatenate([block.ravel() for block in blocks])


def _mode(part: int, factor: str) -> PolynomialFlow:
    """u = z f e_part, made solenoidal; f = 1, x, y or z."""
    gradient, hessian = np.zeros((3, 3)), np.zeros((3, 3, 3))
    if not factor:
        gradient[part, 2] = 1.0
    else:
        j = "xyz".index(factor)
        hessian[part, j, 2] += 1.0
        hessian[part, 2, j] += 1.0
        if j == part:
            hessian[2, 2, 2] = -1.0
    return PolynomialFlow(np.zeros(3), gradient, hessian)


def _scale(values: Array) -> Array:
    """The largest coefficient of the mobility and that of the responses to a flow."""
    largest = np.abs(values).max(axis=(0, 1))
    return np.array([largest[:18].max(), largest[18:].max()])


def _nodes(count: int) -> Array:
    return np.asarray(np.cos(np.pi * (np.arange(count) + 0.5) / count))


def _transform(count: int) -> Array:
    """From values at the nodes to coefficients of Chebyshev polynomials."""
    n = np.arange(count)
    matrix = 2.0 / count * np.cos(np.pi * n[:, None] * (n + 0.5) / count)
    matrix[0] *= 0.5
    return np.asarray(matrix)


@njit(cache=True, fastmath=True)
def _evaluate(  # type: ignore[no-untyped-def]
    x, d, loads, plane, k, size, terms, first, reach, cells, out
):
    """Fill velocities (N, 6); -1, or 1000 + the first cell that is not there, or -2: contact."""
    gaps, tilts = cells.shape[1], cells.shape[2]
    in_gap, in_tilt, value = np.empty(gaps), np.empty(tilts), np.empty(42)
    n, point, own = plane[0], plane[1], plane[2]
    e1, e2, even, odd = np.empty(3), np.empty(3), np.empty(7), np.empty(7)
    got = np.empty(6)
    for i in range(x.shape[0]):
        height, up, squared = 0.0, 0.0, 0.0
        for j in range(3):
            height += (x[i, j] - point[j]) * n[j]
            up += d[i, j] * n[j]
            squared += d[i, j] ** 2
        up /= math.sqrt(squared)
        sign = 1.0 if up >= 0.0 else -1.0
        across = math.sqrt(max(1.0 - up * up, 0.0))
        gap = height / size - math.sqrt(k * k * across * across + up * up)
        if not gap > 0.0:
            return -2
        place = math.log2(gap)
        cell = math.floor(place)
        if cell < first or cell - first >= len(reach) or reach[cell - first, 0] == 0:
            return 1000 + cell
        # e1 along the axis in the wall, e2 = N x e1.
        if across > 1e-8:
            for j in range(3):
                e1[j] = sign * (d[i, j] / math.sqrt(squared) - up * n[j]) / across
        else:
            least = 0
            for j in range(3):
                if abs(n[j]) < abs(n[least]):
                    least = j
            norm = math.sqrt(1.0 - n[least] ** 2)
            for j in range(3):
                e1[j] = ((1.0 if j == least else 0.0) - n[least] * n[j]) / norm
        e2[0] = n[1] * e1[2] - n[2] * e1[1]
        e2[1] = n[2] * e1[0] - n[0] * e1[2]
        e2[2] = n[0] * e1[1] - n[1] * e1[0]
        sigma = math.atan2(math.sqrt(k) * across, abs(up))
        _chebyshev(2.0 * (place - cell) - 1.0, in_gap)
        _chebyshev(4.0 * sigma / math.pi - 1.0, in_tilt)
        value[:] = 0.0
        for p in range(gaps):
            for q in range(reach[cell - first, p]):
                weight = in_gap[p] * in_tilt[q]
                for f in range(42):
                    value[f] += weight * cells[cell - first, p, q, f]
        even[:], odd[:] = 0.0, 0.0
        for j in range(3):
            fall, turn = loads[i, j] / size**2, loads[i, 3 + j] / size**3
            even[0] += fall * e1[j]
            even[1] += fall * n[j]
            even[2] += turn * e2[j]
            odd[0] += fall * e2[j]
            odd[1] += turn * e1[j]
            odd[2] += turn * n[j]
            a = terms[0, j]
            along, aside = 0.0, 0.0
            for c in range(3):
                away = x[i, c] - point[c] - height * n[c]
                a += terms[1 + j, c] * away
                along += terms[1 + j, c] * e1[c]
                aside += terms[1 + j, c] * e2[c]
            even[3] += a * e1[j]
            even[4] += size * along * e1[j]
            even[5] += size * aside * e2[j]
            even[6] += size * terms[4, j] * e1[j]
            odd[3] += a * e2[j]
            odd[4] += size * aside * e1[j]
            odd[5] += size * along * e2[j]
            odd[6] += size * terms[4, j] * e2[j]
        for row in range(3):
            up_, side = 0.0, 0.0
            for c in range(3):
                up_ += value[3 * row + c] * even[c]
                side += value[9 + 3 * row + c] * odd[c]
            for c in range(4):
                up_ += value[18 + 4 * row + c] * even[3 + c]
                side += value[30 + 4 * row + c] * odd[3 + c]
            got[row], got[3 + row] = up_, side
        for j in range(3):
            out[i, j] = size * (got[0] * e1[j] + got[1] * n[j] + got[3] * e2[j]) + own[j]
            out[i, 3 + j] = got[2] * e2[j] + got[4] * e1[j] + got[5] * n[j]
    return -1


@njit(cache=True, fastmath=True)
def _chebyshev(s, out):  # type: ignore[no-untyped-def]
    out[0] = 1.0
    if len(out) > 1:
        out[1] = s
    for j in range(2, len(out)):
        out[j] = 2.0 * s * out[j - 1] - out[j - 2]
