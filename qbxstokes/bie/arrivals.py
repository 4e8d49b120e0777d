"""Flows of all bodies at the points that a process holds, by one compiled loop over pairs.

A block is what one body sends to points of another, or of itself by the wall: a table of its
harmonics there, and the turn from its frame to the other's. The tables of an instant lie one behind
the other in memory that the next instant takes over.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from qbxstokes.typing import Array, Integers

if TYPE_CHECKING:
    from qbxstokes.bie.multiple_scattering import Coupled

# Points of a grid at most whose harmonics are of one degree, and how much more closely they are
# summed on parts of one: high degrees are many. Relative errors of sums at mirrored points, in
# tolerances: second derivatives count.
_TOGETHER, _CLOSER, MIRRORED = 4096, 1e-3, 0.1
# Numbers of all tables together that are kept (8 bytes each) rather than made at every product.
KEPT_NUMBERS = 1.5e8


class Workspace:
    """Memory for the tables of one problem at a time."""

    def __init__(self) -> None:
        self.values = np.empty(0)
        self.owner: object = None

    def take(self, owner: object, count: int) -> Array:
        """At least so many numbers, lost to whoever had them before."""
        if count > len(self.values):
            self.values = np.empty(0)  # not both at once
            self.values = np.empty(count + count // 8)
        self.owner = owner
        return self.values


@dataclass(frozen=True)
class Pairs:
    """Blocks (M, 9) in kept tables (see `exterior_basis.add_arrivals`), and others' numbers."""

    kept: Integers
    made: list[int]


class Arrivals:
    """What arrives at the points that a process holds of a problem's bodies.

    of (2, M): bodies that blocks come from and go to. flows: packed, of all bodies, see `send`.
    """

    def __init__(self, problem: Coupled, workspace: Workspace) -> None:
        self._problem, self._workspace = problem, workspace
        self._widths = [one.shape_of_flows[1] for one in problem.maps]
        self._flows = np.cumsum([0] + [4 * width for width in self._widths])
        self.flows = np.zeros(int(self._flows[-1]))
        ends = np.cumsum([0] + [len(held) for held in problem.held.values()])
        self._first = dict(zip(problem.rows, ends.tolist(), strict=False))
        self._count = int(ends[-1])
        self._heights = np.zeros(self._count)
        if problem.wall is not None:
            for b, held in problem.held.items():
                begin = self._first[b]
                heights = problem.wall.height(problem.points[b][held])
                self._heights[begin : begin + len(held)] = heights
        self._lay()

    def _lay(self) -> None:
        """List the blocks, with the degrees of their harmonics."""
        problem, blocks, rows, turns = self._problem, [], [], []
        of: list[tuple[int, int]] = []
        table = point = 0
        for c, (one, source) in enumerate(zip(problem.maps, problem.bodies, strict=True)):
            for b in problem.rows:
                for mirrored in (False, True):
                    if (b == c and not mirrored) or (mirrored and problem.wall is None):
                        continue
                    for part, degree in self._parts(c, b, mirrored):
                        columns = one.harmonics.columns(degree)
                        size = (10 if mirrored else 4) * len(part) * columns
                        kept = table + size <= KEPT_NUMBERS
                        where = self._flows[c], self._widths[c], columns, degree
                        blocks.append(
                            [
                                *(int(mirrored), len(of), *where),
                                *(table if kept else -1, point, len(part)),
                            ]
                        )
                        rows.append(part + self._first[b])
                        of.append((c, b))
                        turns.append(problem.bodies[b].rotation.T @ source.rotation)
                        table += size if kept else 0
                        point += len(part)
        self._blocks = np.array(blocks, dtype=np.int64).reshape(-1, 9)
        self.of = np.array(of, dtype=np.int64).reshape(-1, 2).T
        self._turns = np.array(turns).reshape(-1, 3, 3)
        self._at = np.concatenate([np.zeros(0, dtype=np.int64), *rows])
        self._points, self._size = np.empty((point, 3)), table
        normal = np.zeros(3) if problem.wall is None else problem.wall.normal
        self._normals = np.array([problem.bodies[c].rotation.T @ normal for c, _ in of])
        self._normals = self._normals.reshape(-1, 3)
        self._sizes = np.array([problem.bodies[c].size for c, _ in of], dtype=float)
        self._above = self._heights[self._at]

    def _parts(self, c: int, b: int, mirrored: bool) -> list[tuple[Integers, int]]:
        """Parts of what is held of body b, with the degree of body c's harmonics there.

        In parts of the grid that are the same whoever holds them.
        """
        problem, held = self._problem, self._problem.held[b]
        points = problem.points[b]
        large = len(points) > _TOGETHER
        degrees, _ = problem.degrees(c, points, mirrored, _CLOSER if large else 1.0)
        if not large:
            return [(np.arange(len(held)), int(degrees.max()))] if len(held) else []
        order = np.argsort(-degrees, kind="stable")
        place = np.full(len(points), -1)
        place[held] = np.arange(len(held))
        found = []
        for part in np.array_split(order, 8 * len(points) // _TOGETHER):
            here = place[part]
            if np.any(here >= 0):
                found.append((here[here >= 0], int(degrees[part].max())))
        return found

    def _fill(self, block: Integers, values: Array, table: int) -> None:
        """Make the points and the table of a block."""
        from qbxstokes.qbx.exterior_basis import tabulate

        mirrored, number, _, _, columns, degree, _, first, count = block.tolist()
        problem, (c, b) = self._problem, self.of[:, number].tolist()
        harmonics, part = problem.maps[c].harmonics, slice(first, first + count)
        points = problem.points[b][problem.held[b][self._at[part] - self._first[b]]]
        if mirrored:
            assert problem.wall is not None
            points = problem.wall.mirrored(points)
        self._points[part] = problem.bodies[c].to_body(points)
        rows = 10 if mirrored else 4
        end = table + rows * count * columns
        tabulate(
            self._points[part],
            harmonics.ratio_of_axes,
            degree,
            min(degree + 1, harmonics.orders),
            harmonics.start,
            harmonics.recurrence,
            bool(mirrored),
            values[table:end].reshape(rows, count, columns),
        )

    def pairs(self, wanted: Any) -> Pairs:
        """The blocks that are wanted (M,), by the bodies that they are `of`."""
        kept = self._blocks[:, 6] >= 0
        return Pairs(self._blocks[wanted & kept], np.flatnonzero(wanted & ~kept).tolist())

    def send(self, flows: Mapping[int, Array]) -> None:
        """Let bodies have packed flows, perhaps of low degrees alone."""
        for c, flow in flows.items():
            whole = self.flows[self._flows[c] : self._flows[c + 1]].reshape(4, -1)
            width = flow.shape[1]
            whole[:, :width] = flow
            if width < whole.shape[1]:
                whole[:, width:] = 0.0

    def add(self, pairs: Pairs, velocity: Array, most: int = 1 << 40) -> None:
        """Add the flows to velocities (P, 3) of all points held here, in the frames of the bodies.

        most: columns of the tables that the flows have at most.
        """
        from qbxstokes.qbx.exterior_basis import add_arrivals

        if self._workspace.owner is not self:
            values = self._workspace.take(self, self._size)
            for block in self._blocks[self._blocks[:, 6] >= 0]:
                self._fill(block, values, int(block[6]))
        about = self._points, self.flows, self._turns, self._normals, self._sizes, self._above
        where = self._at, most, velocity, np.zeros(len(velocity))
        if len(pairs.kept):
            add_arrivals(pairs.kept, self._workspace.values, *about, *where)
        for number in pairs.made:
            block = self._blocks[number].copy()
            values = np.empty((10 if block[0] else 4) * int(block[4] * block[8]))
            self._fill(block, values, 0)
            block[6] = 0
            add_arrivals(block[None], values, *about, *where)
