"""Flows of all bodies at the points that a process holds, by one compiled loop over pairs.

A block is what one body sends to points of another, or of itself by the wall: a table of its
harmonics there, and the turn from its frame to the other's. The tables of an instant lie one behind
the other in memory that the next instant takes over.
"""

from __future__ import annotations

import threading
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


class Workspace(threading.local):
    """Memory for the tables of one problem of a thread at a time, a gigabyte at most."""

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


SHARED = Workspace()  # by the problems of all scenes


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
        parts = [np.zeros((0, 3)), *(problem.points[b][held] for b, held in problem.held.items())]
        self._places = [np.concatenate(parts)]  # and mirrored
        heights = np.zeros(len(self._places[0]))
        if problem.wall is not None:
            heights = problem.wall.height(self._places[0])
            self._places.append(problem.wall.mirrored(self._places[0]))
        self._lay()
        self._above = heights[self._at]

    def _lay(self) -> None:
        """List the blocks, with the degrees of their harmonics."""
        problem, points = self._problem, [np.zeros(0, dtype=np.int64)]
        rows = {b: np.arange(here.start, here.stop) for b, here in problem.slices.items()}
        # Of each whether mirrored, its source and target, degree, columns and number of points.
        blocks: list[tuple[int, ...]] = []
        for mirrored in range(len(self._places)):
            degrees = self._highest(bool(mirrored)).tolist()
            for c, one in enumerate(problem.maps):
                columns = one.harmonics.columns
                for (b, here), degree in zip(rows.items(), degrees[c], strict=True):
                    if b == c and not mirrored:
                        continue
                    parts = [(here, degree)]
                    if len(problem.points[b]) > _TOGETHER:
                        parts = self._parts(c, b, bool(mirrored))
                    for part, degree in parts:
                        points.append(part)
                        blocks.append((mirrored, c, b, degree, columns(degree), len(part)))
        found = np.array(blocks, dtype=np.int64).reshape(-1, 6).T
        mirrored, *of, degree, columns, count = found
        self.of, self._at = np.stack(of), np.concatenate(points)
        size = np.where(mirrored, 10, 4) * count * columns
        kept = np.cumsum(size) <= KEPT_NUMBERS
        self._size = int(size[kept].sum())
        begins = np.where(kept, np.cumsum(size) - size, -1), np.cumsum(count) - count, count
        flow = np.array([self._flows[:-1], self._widths])[:, self.of[0]]
        numbers = mirrored, np.arange(len(count)), *flow, columns, degree, *begins
        self._blocks = np.stack(numbers, axis=1)
        self._points = np.empty((len(self._at), 3))
        turns = np.stack([body.rotation for body in problem.bodies])
        source, target = turns[self.of]
        self._turns = np.swapaxes(target, 1, 2) @ source
        normal = np.zeros(3) if problem.wall is None else problem.wall.normal
        self._normals = normal @ source
        self._sizes = np.array([body.size for body in problem.bodies], dtype=float)[self.of[0]]

    def _highest(self, mirrored: bool) -> Integers:
        """Degrees (N, B) that harmonics of each body take at most on those that are held here."""
        from qbxstokes.qbx.exterior_basis import highest_degrees

        problem = self._problem
        ends = np.cumsum([0] + [len(points) for points in problem.points.values()])
        points, tolerance = np.concatenate([np.zeros((0, 3)), *problem.points.values()]), 1.0
        if mirrored and problem.wall is not None:
            points, tolerance = problem.wall.mirrored(points), MIRRORED
        tolerance *= problem.tolerance
        found = np.empty((len(problem.maps), len(ends) - 1), dtype=np.int64)
        for c, (one, body) in enumerate(zip(problem.maps, problem.bodies, strict=True)):
            k, most = one.harmonics.ratio_of_axes, one.harmonics.degree
            about = body.position, body.rotation, float(body.size), k, tolerance, most
            highest_degrees(points, ends, *about, found[c])
        return found

    def _parts(self, c: int, b: int, mirrored: bool) -> list[tuple[Integers, int]]:
        """Parts of what is held of body b, with the degree of body c's harmonics there.

        In parts of the grid that are the same whoever holds them.
        """
        problem, held, points = self._problem, self._problem.held[b], self._problem.points[b]
        degrees, _ = problem.degrees(c, points, mirrored, _CLOSER)
        order = np.argsort(-degrees, kind="stable")
        place = np.full(len(points), -1)
        place[held] = np.arange(len(held)) + problem.slices[b].start
        found = []
        for part in np.array_split(order, 8 * len(points) // _TOGETHER):
            here = place[part]
            if np.any(here >= 0):
                found.append((here[here >= 0], int(degrees[part].max())))
        return found

    def _fill(self, blocks: Integers, values: Array) -> None:
        """Make the points and the tables of blocks, one body after the other."""
        from qbxstokes.qbx.exterior_basis import tabulate_blocks

        source, problem = self.of[0, blocks[:, 1]], self._problem
        for mirrored, points in enumerate(self._places):
            for c in np.unique(source).tolist():
                some = blocks[(source == c) & (blocks[:, 0] == mirrored)]
                body, h = problem.bodies[c], problem.maps[c].harmonics
                about = body.position, body.rotation, float(body.size), h.ratio_of_axes
                by = *about, h.orders, h.start, h.recurrence
                tabulate_blocks(some, self._at, points, *by, values, self._points)

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
            self._fill(self._blocks[self._blocks[:, 6] >= 0], values)
        about = self._points, self.flows, self._turns, self._normals, self._sizes, self._above
        where = self._at, most, velocity
        if len(pairs.kept):
            add_arrivals(pairs.kept, self._workspace.values, *about, *where)
        for number in pairs.made:
            block = self._blocks[number : number + 1].copy()
            block[:, 6] = 0
            values = np.empty((10 if block[0, 0] else 4) * int(block[0, 4] * block[0, 8]))
            self._fill(block, values)
            add_arrivals(block, values, *about, *where)
