"""One spheroid over a plane wall from a table: its motion depends on gap and tilt alone.

In the frame of the wall's normal N and the plane of N and the axis, the free body's velocities are
linear in its loads (a mobility) and in the flow. One that vanishes on the wall is, to degree 2,

    u = z (a + A x + b z) - 1/2 tr(A) z^2 N     (a, A, b tangential, about the foot of the centre)

Both are tabulated by Chebyshev polynomials in the logarithm of the gap, cell by cell of a factor
two, made as they are first visited, and in sigma, tan(sigma) = sqrt(k) tan(tilt), which keeps the
singularities of long and of flat bodies equally far away. The mobility is bounded at contact, where
the resistance is singular by lubrication. A cell is then cut into pieces with polynomials of low
degree, whose values take less.
"""

import math
from typing import Any

import numpy as np

from qbxstokes.errors import ContactError, SceneError
from qbxstokes.flows import Flow
from qbxstokes.flows.polynomial import PolynomialFlow
from qbxstokes.io.cache import Cache
from qbxstokes.motion.coupled import WallConstants
from qbxstokes.simulation.body import Body
from qbxstokes.simulation.surroundings import Wall
from qbxstokes.simulation.suspension import Suspension
from qbxstokes.typing import Array

# Even and odd under reflection in the plane of axis and normal: velocities and loads alike.
_EVEN, _ODD = (0, 2, 4), (1, 3, 5)
# First and last cell, powers of two of the gap in polar radii, and the most polynomials of each.
FIRST, LAST, _MOST = -8, 6, 40
# Degrees and pieces each way of a cut cell: the first that serve; else it is left as it is.
_CUTS = tuple((degree, 2**power) for power in range(5) for degree in (3, 4, 5, 6, 8))
# Polar nodes of the solutions that a cell is made from, at most: a few minutes.
_FINEST = 28
# Modes of the flow (a1, A11, A22, b1; a2, A12, A21, b2): u = z f e1 or z f e2.
_MODES = ((0, ""), (0, "x"), (1, "y"), (0, "z"), (1, ""), (0, "y"), (1, "x"), (1, "z"))


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
        self, body: Body, wall: Wall, *, tolerance: float = 1e-6, cache: Cache | None = None
    ) -> None:
        self.body, self.wall, self.tolerance, self.cache = body, wall, tolerance, cache
        self._scene = Suspension(
            [Body(shape=body.shape)], Wall(normal=(0.0, 0.0, 1.0)), tolerance=0.3 * tolerance
        )
        self.ratio = self._scene.placed([[0.0, 0.0, 9.0]])[0].ratio
        # Pieces of all cells, (pieces, 42, polynomials), and per cell: its first piece, how many
        # there are in gap and tilt, and their numbers of polynomials; 0: not made.
        self._pieces = np.zeros((0, 42, 1))
        self._where = np.zeros((LAST - FIRST, 5))
        self._plane = np.stack([wall.normal, wall.point, wall.velocity])
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
        from qbxstokes.motion.over_wall import evaluate

        while True:
            where = evaluate(x, d, loads, *place, FIRST, self._where, self._pieces, out)
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
        free, mobility = self.free_and_mobility(terms, position, axis)
        return np.asarray(np.linalg.solve(mobility, free - motion))

    def free_and_mobility(self, terms: Array, position: Array, axis: Array) -> tuple[Array, Array]:
        """Velocities (6,) of one body without loads, and its mobility (6, 6)."""
        x, d = np.repeat(position[None], 7, axis=0), np.repeat(axis[None], 7, axis=0)
        found = np.hstack(self.motion(terms, x, d, np.vstack([np.zeros(6), np.eye(6)])))
        return found[0], (found[1:] - found[0]).T

    def constants(self, terms: Array, load: Array) -> WallConstants:
        """What a compiled right-hand side takes of the table, as far as it is made, and a load."""
        place = self._plane, self.ratio, self.body.size, terms
        return WallConstants(load, *place, FIRST, self._where, self._pieces)

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
        pieces, layout, lost = _cut(values, 0.1 * self.tolerance)
        self._where[cell - FIRST] = len(self._pieces), *layout
        width = max(self._pieces.shape[2], pieces.shape[2])
        self._pieces = np.concatenate(
            [np.pad(p, ((0, 0), (0, 0), (0, width - p.shape[2]))) for p in (self._pieces, pieces)]
        )
        left += lost
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
        blocks = (m[np.ix_(_EVEN, _EVEN)], m[np.ix_(_ODD, _ODD)], flows[_EVEN, :4], flows[_ODD, 4:])
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


def _cut(values: Array, tolerance: float) -> tuple[Array, tuple[int, int, int, int], float]:
    """A cell (gap, tilt, 42) as pieces (pieces, 42, polynomials), their layout, and what is lost.

    Pieces in gap and tilt, polynomials of both; losses are relative, at points between the nodes.
    """
    gaps, tilts = values.shape[:2]
    scale = np.repeat(_scale(values), [18, 24])
    for degree, count in _CUTS:
        sizes = [min(degree + 1, gaps), 1 if tilts == 1 else degree + 1]
        counts = [count, 1 if tilts == 1 else count]
        if sizes[0] * sizes[1] >= gaps * tilts:
            break
        # Nodes of all pieces, and the points between, in the whole cell.
        fits, checks = [], []
        for size, number, whole in zip(sizes, counts, (gaps, tilts), strict=True):
            middle = (2.0 * np.arange(number)[:, None] + 1.0) / number - 1.0
            between = np.linspace(-1.0, 1.0, 2 * size + 1)
            at = [
                _polynomials(middle + points / number, whole) for points in (_nodes(size), between)
            ]
            fits.append(np.einsum("ip,npw->niw", _transform(size), at[0]))
            checks.append((at[1], _polynomials(between, size)))
        cut = np.einsum("aiw,bjv,wvf->abijf", fits[0], fits[1], values)
        exact = np.einsum("apw,bqv,wvf->abpqf", checks[0][0], checks[1][0], values)
        found = np.einsum("pi,qj,abijf->abpqf", checks[0][1], checks[1][1], cut)
        lost = float((np.abs(found - exact) / scale).max())
        if lost <= tolerance:
            pieces = np.moveaxis(cut, -1, 2).reshape(counts[0] * counts[1], 42, -1)
            return np.ascontiguousarray(pieces), (*counts, *sizes), lost
    whole_cell = np.moveaxis(values, -1, 0).reshape(1, 42, -1)
    return np.ascontiguousarray(whole_cell), (1, 1, gaps, tilts), 0.0


def _polynomials(points: Array, count: int) -> Array:
    """Chebyshev polynomials (..., count) at points."""
    return np.asarray(np.cos(np.arange(count) * np.arccos(np.clip(points, -1.0, 1.0))[..., None]))


def _nodes(count: int) -> Array:
    return np.asarray(np.cos(np.pi * (np.arange(count) + 0.5) / count))


def _transform(count: int) -> Array:
    """From values at the nodes to coefficients of Chebyshev polynomials."""
    n = np.arange(count)
    matrix = 2.0 / count * np.cos(np.pi * n[:, None] * (n + 0.5) / count)
    matrix[0] *= 0.5
    return np.asarray(matrix)
