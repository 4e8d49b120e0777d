"""Several spheroids, with or without a plane wall, by multiple scattering.

Each body owns its exterior map E (`scatterer`). The boundary velocity v_b that body b's own flow
must have solves, for given rigid motions and background u,

    v_b + sum_{c != b} (E_c v_c)|_b + sum_c (E_c v_c)^wall|_b = U_b + W_b x r - u|_b

identity plus compact, I + K. The bodies are put into a few stages, near ones into different ones:
with L that part of K which sends from earlier to later stages, v = (I + L)^-1 w is found stage
after stage, and w solves (I + (K - L) (I + L)^-1) w = data (multiplicative Schwarz). A product
takes every body's flow at every other once, as one with I + K does, and GMRES about half of them:
of two bodies the round trip alone is left.

For bodies under given loads E is replaced by its force-free part M_c v = E_c (v - w_c(v)), w_c(v)
the rigid motion of the body alone that carries the same force and torque; the data are then minus
the background and the flow of the loaded bodies each alone, and the motion of body b is its motion
alone less w_b(v_b).

The wall answers with Lorentz's reflection of a body's flow (Kim & Karrila 1991, sec. 12.1): with
the plane at height 0, the unit normal N, J = I - 2 N N^T and ^ the value at the mirrored point J x,

    u_wall = -u^ + 2 h J (grad u.N)^ + h^2 J (grad p)^
    p_wall = p^ - 2 h (N.grad p)^ - 4 (N.grad u.N)^

which asks for nothing but the body's own exterior flow at mirrored points. Forces and velocities
are those of the space frame; force and torque are exerted by the bodies ON the fluid (mu = 1).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from qbxstokes.bie.arrivals import MIRRORED, SHARED, Arrivals, Workspace
from qbxstokes.bie.scatterer import LOW, Scatterer, scatterer
from qbxstokes.geometry.gaps import Gaps, gaps_between
from qbxstokes.geometry.shape import Revolution
from qbxstokes.qbx.exterior import ExteriorFlow
from qbxstokes.typing import Array, Integers

SLOW = 1.3  # errors fall by exp(-SLOW a) a node, a the rate of the gap, or faster
LEAST_NODES = 8
STAGES = 4  # as good as one body after the other
# Polar nodes that the grids of an error estimate have less; relative error, in tolerances of the
# problem, that both solutions may share.
_LESS, _SHARED = 2, 0.1


@dataclass(frozen=True)
class Plane:
    """A plane wall: unit normal (3,) into the fluid, a point (3,) of it, its own velocity (3,)."""

    normal: Array
    point: Array
    velocity: Array

    def height(self, points: Array) -> Array:
        """Distance (...) of points (..., 3) above the wall."""
        return np.asarray((points - self.point) @ self.normal)

    def mirrored(self, points: Array) -> Array:
        """Points (..., 3) on the other side."""
        return np.asarray(points - 2.0 * self.height(points)[..., None] * self.normal)


@dataclass(frozen=True)
class Placed:
    """A body in the scene: its unit of length, centre (3,) and rotation (3, 3) body to space.

    shape: an ellipsoid of revolution, between which gaps are known.
    """

    shape: Revolution
    size: float
    position: Array
    rotation: Array

    @property
    def ratio(self) -> float:
        """k of its semi-axes (k, k, 1)."""
        assert self.shape.semi_axes is not None
        return self.shape.semi_axes[0]

    @property
    def axis(self) -> Array:
        """Symmetry axis D3 in space."""
        return self.rotation[:, 2]

    def to_body(self, points: Array) -> Array:
        """Points (N, 3) of space in the body frame, in polar radii."""
        return np.asarray((points - self.position) @ self.rotation / self.size)


def closest(bodies: Sequence[Placed], wall: Plane | None) -> tuple[float, tuple[int, int], Array]:
    """Least gap of the scene, its pair (-1: the wall), and each body's least rate (`Gaps`)."""
    found, rates = gaps_of(bodies, wall), np.full(len(bodies), np.inf)
    if not len(found.gap):
        return np.inf, (0, -1), rates
    for side in (0, 1):
        here = found.pairs[:, side] >= 0
        np.minimum.at(rates, found.pairs[here, side], found.rates[here, side])
    least = int(np.argmin(found.gap))
    b, c = found.pairs[least].tolist()
    return float(found.gap[least]), (b, c), rates


def gaps_of(bodies: Sequence[Placed], wall: Plane | None, known: Gaps | None = None) -> Gaps:
    """The gaps of all pairs; known: see `gaps_between`."""
    centres, axes = (np.stack([getattr(b, name) for b in bodies]) for name in ("position", "axis"))
    k, size = (np.array([getattr(b, name) for b in bodies]) for name in ("ratio", "size"))
    normal, heights = (None, None) if wall is None else (wall.normal, wall.height(centres))
    return gaps_between(centres, axes, k, size.astype(float), normal, heights, known)


@dataclass
class Coupled:
    """The linear problem of bodies at one instant.

    shares: of each process by body the circles of its grid that it holds; all by default. rank:
    of this process. tolerance: relative, to which far harmonics are left out. nodes: polar nodes
    of each body. workspace: memory that problems share.
    """

    bodies: Sequence[Placed]
    wall: Plane | None
    nodes: Sequence[int]
    tolerance: float = 1e-12
    shares: Sequence[Mapping[int, Integers]] | None = None
    rank: int = 0
    workspace: Workspace = SHARED

    @cached_property
    def circles(self) -> Mapping[int, Integers]:
        """Circles of the grids that this process holds, by body."""
        if self.shares is None:
            return {b: np.arange(n) for b, n in enumerate(self.nodes)}
        return self.shares[self.rank]

    @property
    def rows(self) -> Sequence[int]:
        """Bodies of this process."""
        return list(self.circles)

    @cached_property
    def held(self) -> dict[int, Integers]:
        """Points of each of them that it holds."""
        return {
            b: (2 * self.nodes[b] * circles[:, None] + np.arange(2 * self.nodes[b])).ravel()
            for b, circles in self.circles.items()
        }

    @cached_property
    def maps(self) -> list[Scatterer]:
        """The exterior map of each body."""
        return [scatterer(body.shape, n) for body, n in zip(self.bodies, self.nodes, strict=True)]

    @cached_property
    def _inverses(self) -> dict[int, Array]:
        """Parts of the maps that act on what this process holds."""
        return {b: self.maps[b].inverse_on(circles) for b, circles in self.circles.items()}

    @cached_property
    def points(self) -> dict[int, Array]:
        """Grid points (N, 3) in space of the bodies of this process."""
        return {
            b: self.bodies[b].position
            + self.bodies[b].size * self.maps[b].grid.points @ self.bodies[b].rotation.T
            for b in self.rows
        }

    @cached_property
    def slices(self) -> dict[int, slice]:
        """Rows of each own body among all points that are held."""
        ends = np.cumsum([0] + [len(points) for points in self.held.values()])
        return {b: slice(*ab) for b, ab in zip(self.rows, pairwise(ends.tolist()), strict=True)}

    @property
    def size(self) -> int:
        """Unknowns of this process."""
        return 3 * sum(len(points) for points in self.held.values())

    # -- how well it is solved ----------------------------------------------------------------

    @property
    def coarser(self) -> list[int]:
        """Polar nodes of grids that show, by what they miss, how well these resolve.

        The least grids lose one node only beside finer ones, whose gaps decide.
        """
        alike = max(self.nodes) <= LEAST_NODES
        less = [_LESS if n > LEAST_NODES or alike else 1 for n in self.nodes]
        return [max(n - few, min(n, 4)) for n, few in zip(self.nodes, less, strict=True)]

    def estimated(self, fine: Array, coarse: Array, size: float = 0.0) -> float:
        """Estimated largest error of what was found here, by what the coarser grids found.

        Errors fall by exp(-SLOW times the least rate) a node, or faster: near contact, where that
        is slow, the difference is taken times what remains of it. Besides a little of the
        tolerance, which both may share, of what was found or of a larger size it is made of.
        """
        change = float(np.abs(fine - coarse).max(initial=0.0))
        if change == 0.0:  # what is given, not found
            return 0.0
        rate = float(closest(self.bodies, self.wall)[2].min())
        left = math.exp(-_LESS * SLOW * rate)
        size = max(size, float(np.abs(fine).max(initial=0.0)))
        factor = max(1.0, 2.0 * left / max(1.0 - left, 1e-3))
        return change * factor + _SHARED * self.tolerance * size

    def split(self, x: Array) -> Array:
        """Velocities (P, 3) on all that is held, from the vector of unknowns."""
        return x.reshape(-1, 3) / self._roots

    def joined(self, velocities: Array) -> Array:
        """The vector of unknowns: velocities times the roots of the quadrature weights."""
        return (velocities * self._roots).ravel()

    @cached_property
    def _roots(self) -> Array:
        parts = [self.maps[b].root_weights[points] for b, points in self.held.items()]
        return np.concatenate([np.zeros((0, 1)), *parts])

    # -- what a body sends out ----------------------------------------------------------------

    @cached_property
    def gaps(self) -> Gaps:
        """The gaps of all pairs."""
        return gaps_of(self.bodies, self.wall)

    @cached_property
    def stages(self) -> list[list[int]]:
        """The bodies dealt to stages, those that feel each other most to different ones."""
        n, near = len(self.bodies), self.gaps
        felt, pairs = np.zeros((n, n)), near.pairs[:, 1] >= 0
        first, second = near.pairs[pairs].T
        felt[first, second] = felt[second, first] = np.exp(-2.0 * near.rates[pairs].min(axis=1))
        room = 1 if n <= STAGES else 2 * math.ceil(n / (2 * STAGES))  # even, for two ranks
        stages: list[list[int]] = [[] for _ in range(math.ceil(n / room))]
        for body in np.argsort(-felt.sum(axis=1), kind="stable").tolist():
            open_ = [stage for stage in stages if len(stage) < room]
            min(open_, key=lambda stage: (felt[body, stage].sum(), len(stage))).append(body)
        return stages

    def alone(self, b: int, v: Array) -> tuple[Array, Array]:
        """Flow of body b with velocities v on what is held of it, and its motion alone, free.

        The motion has the same force and torque. Both are parts of sums over all processes.
        """
        one = self.maps[b]
        c = one.packed(v, self._inverses[b])
        return c, one.loads(c) / one.resistance

    def flow(self, b: int, v: Array, free: bool) -> Array:
        """Exterior flow of body b, packed: E v, or M v of a free one; a part as in `alone`."""
        c, motion = self.alone(b, v)
        if free:
            c[:, :LOW] -= self.maps[b].moving(motion)
        return c

    # -- what arrives -------------------------------------------------------------------------

    def degrees(
        self, c: int, points: Array, mirrored: bool, closer: float = 1.0
    ) -> tuple[Integers, Array]:
        """Degrees of body c's harmonics that serve at points, and the points in its frame."""
        tolerance = closer * self.tolerance
        if mirrored:
            assert self.wall is not None
            points, tolerance = self.wall.mirrored(points), MIRRORED * tolerance
        x = self.bodies[c].to_body(points)
        return self.maps[c].degrees_for(x, tolerance), x

    def reflected(self, c: int, flow: ExteriorFlow, points: Array) -> tuple[Array, Array]:
        """Velocity (N, 3) and pressure (N,) of the wall's answer to body c's flow."""
        assert self.wall is not None
        body, tolerance = self.bodies[c], MIRRORED * self.tolerance * float(flow.amplitude.max())
        what = ("velocity", "gradient", "pressure", "pressure_gradient")
        found = flow.evaluate(body.to_body(self.wall.mirrored(points)), what, tolerance)
        normal, h = body.rotation.T @ self.wall.normal, self.wall.height(points) / body.size
        lift, push = normal @ found["gradient"], found["pressure_gradient"]
        u = h[:, None] * (2.0 * lift + h[:, None] * push)
        u -= found["velocity"] + 2.0 * (u @ normal)[:, None] * normal
        p = found["pressure"] - 2.0 * h * (push @ normal) - 4.0 * (lift @ normal)
        return u @ body.rotation.T, p / body.size

    @cached_property
    def arrivals(self) -> Arrivals:
        """What arrives at the points that this process holds."""
        return Arrivals(self, self.workspace)

    def arriving(self, flows: Mapping[int, Array]) -> Array:
        """Velocities (P, 3) on all that is held here, in the bodies' frames, of packed flows.

        flows: of all bodies, with the wall's answers.
        """
        total = np.zeros((self.size // 3, 3))
        self.arrivals.send(flows)
        sent = self.arrivals.pairs(np.isin(self.arrivals.of[0], list(flows)))
        self.arrivals.add(sent, total, max(flow.shape[1] for flow in flows.values()))
        return total

    # -- data and results ---------------------------------------------------------------------

    def background(self, velocity: Callable[[Array], Array] | None) -> Array:
        """A flow of space (P, 3), or none, on all that is held, in the bodies' frames."""
        if velocity is None:
            return np.zeros((self.size // 3, 3))
        points = [self.points[b][held] for b, held in self.held.items()]
        found = np.array(velocity(np.concatenate([np.zeros((0, 3)), *points])))
        for b, rows in self.slices.items():
            found[rows] = found[rows] @ self.bodies[b].rotation
        return found

    def to_body(self, b: int, motion: Array, forces: bool = False) -> Array:
        """Velocities (6,) of space, or force and torque, in the frame and units of body b's map."""
        body = self.bodies[b]
        linear, angular = body.rotation.T @ motion[:3], body.rotation.T @ motion[3:]
        if forces:
            return np.concatenate([linear / body.size, angular / body.size**2])
        return np.concatenate([linear, angular * body.size])

    def to_space(self, b: int, motion: Array, forces: bool = False) -> Array:
        """The inverse of `to_body`."""
        body = self.bodies[b]
        linear, angular = body.rotation @ motion[:3], body.rotation @ motion[3:]
        if forces:
            return np.concatenate([linear * body.size, angular * body.size**2])
        return np.concatenate([linear, angular / body.size])

    def rigid_data(self, motions: Array) -> Array:
        """Rigid motions (N, 6) of space on all that is held (P, 3), in the bodies' frames."""
        parts = [
            np.tensordot(self.to_body(b, motions[b]), self.maps[b].rigid[:, held], 1)
            for b, held in self.held.items()
        ]
        return np.concatenate([np.zeros((0, 3)), *parts])

    def force(self, b: int, flow: Array) -> Array:
        """Force and torque (6,) that body b with a packed flow exerts on the fluid, in space."""
        return self.to_space(b, self.maps[b].loads(flow), forces=True)

    def stresslet(self, b: int, flow: Array) -> Array:
        """Stresslet (3, 3) of body b in space: sym-traceless first moment of the traction on it."""
        body = self.bodies[b]
        d = -self.maps[b].harmonics.first_moment(flow) * body.size**2
        d = 0.5 * (d + d.T) - np.trace(d) / 3.0 * np.eye(3)
        return np.asarray(body.rotation @ d @ body.rotation.T)

    def loaded(self, b: int, load: Array) -> tuple[Array, Array]:
        """Motion alone (6,), map's units, of body b under a load (6,) of space; its `moving`."""
        motion = self.to_body(b, load, forces=True) / self.maps[b].resistance
        return motion, self.maps[b].moving(motion)


def names_of(b: int, c: int) -> str:
    """Who body b is next to: body c, or the wall (-1)."""
    return f"body {b + 1} and the wall" if c < 0 else f"bodies {c + 1} and {b + 1}"
