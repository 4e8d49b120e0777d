"""The flow among several bodies, or around one by a wall; `flow_around` is of one body alone."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from qbxstokes.bie.exterior import INSIDE, TABLE
from qbxstokes.bie.field import USUAL, in_blocks, on_surface, sizes
from qbxstokes.flows import Flow
from qbxstokes.geometry import rotation
from qbxstokes.geometry.symmetric import components, symmetric
from qbxstokes.motion.layout import ORIENTATION, POSITION
from qbxstokes.qbx.exterior import SURFACE_MARGIN, ExteriorFlow
from qbxstokes.simulation.flow_around import Instant
from qbxstokes.simulation.solved_instant import MOST_NODES
from qbxstokes.typing import AnyArray, Array, Booleans

if TYPE_CHECKING:
    from qbxstokes.simulation.coupled import CoupledSimulation
    from qbxstokes.simulation.solved_instant import Solution


# Points per block, and per block of differences: what is in memory at once.
_BLOCK, _FEW = 8192, 96
# Central differences of order six, and their step by the distance from the body whose flow is
# differentiated, below whose surface its singularities lie: relative errors of 2e-9 at most.
_SHIFTS = np.array([-3.0, -2.0, -1.0, 1.0, 2.0, 3.0])
_WEIGHTS, _STEP = np.array([-1.0, 9.0, -45.0, 45.0, -9.0, 1.0]) / 60.0, 0.02
# A hair outside the surface, by which rounding does not put its points into the body.
_HAIR = 2e-12


class FlowAmong:
    """The whole flow at one instant of a solved scene, in space: as `bie.field.FlowAround`."""

    def __init__(
        self,
        solution: Solution,
        flow: Flow | None,
        time: float = 0.0,
        shaped: Callable[[Array], Array] = np.asarray,
    ) -> None:
        self.solution, self.flow, self.time, self._shaped = solution, flow, time, shaped
        self.problem = solution.problem

    def inside(self, points: Array) -> Booleans:
        """Whether points (N, 3) are in a body or behind the wall."""
        found = np.zeros(len(points), dtype=bool)
        for body in self.problem.bodies:
            found |= body.shape.level(body.to_body(points)) < 1.0 - SURFACE_MARGIN
        if self.problem.wall is not None:
            scale = max(body.size for body in self.problem.bodies)
            found |= self.problem.wall.height(points) < -SURFACE_MARGIN * scale
        return found

    def carrying(self, points: Array) -> Array:
        """Velocity (N, 3) at points of all space: that of the bodies in them, of the wall behind.

        Continuous, so that a point which rounding puts into a body goes with it.
        """
        found = self.evaluate(points, ("velocity",), 0.0)["velocity"]
        solution, wall = self.solution, self.problem.wall
        for b, body in enumerate(self.problem.bodies):
            here = body.shape.level(body.to_body(points)) < 1.0
            arms = points[here] - body.position
            spin = np.cross(solution.angular_velocity[b], arms)
            found[here] = solution.velocity[b] + spin
        if wall is not None:
            found[wall.height(points) < 0.0] = wall.velocity
        return found

    def evaluate(
        self,
        points: Array,
        what: Collection[str] = USUAL,
        tolerance: float = 0.0,
        method: str = "auto",
    ) -> dict[str, AnyArray]:
        """Fields at points (N, 3): "disturbance_velocity" and any of WHAT, of the whole flow.

        Arrays as in `bie.field.FlowAround.evaluate`; NaN with source INSIDE in bodies and behind
        the wall. tolerance: error of velocities that may be made far from the bodies, relative to
        `scale`. method: harmonics, whatever it says.
        """
        tolerance = 0.1 * tolerance * self.scale if tolerance else 0.0
        return in_blocks(points, _BLOCK, lambda some: self._block(some, what, tolerance))

    def _block(self, points: Array, what: Collection[str], tolerance: float) -> dict[str, AnyArray]:
        inside, flow, t = self.inside(points), self.flow, self.time
        x = points[~inside]
        steep = bool({"gradient", "stress"} & set(what))
        asked = {"velocity", "pressure"} | {
            name for name in ("gradient", "pressure_gradient") if name in what
        }
        asked |= {"gradient"} if steep else set()
        own = self._disturbance(x, asked, tolerance)
        found = dict(own) | {"disturbance_velocity": own["velocity"]}
        if flow is not None:
            background: dict[str, Callable[..., Array]] = {
                "velocity": flow.velocity,
                "pressure": flow.pressure,
                "gradient": flow.gradient,
                "pressure_gradient": flow.laplacian,
            }
            for name in asked:
                found[name] = own[name] + background[name](x, t)
        if "stress" in what:
            slope = found["gradient"]
            found["stress"] = components(slope + slope.swapaxes(1, 2))
            found["stress"][:, :3] -= found["pressure"][:, None]
        whole: dict[str, AnyArray] = {"source": np.where(inside, INSIDE, TABLE)}
        for name in what:
            whole[name] = np.full((len(points), *found[name].shape[1:]), np.nan)
            whole[name][~inside] = found[name]
        return whole

    def _disturbance(self, x: Array, asked: set[str], tolerance: float) -> dict[str, Array]:
        """What all bodies and the wall's answers add to the flow, at points (N, 3) of the fluid."""
        shapes = {"velocity": (3,), "pressure": (), "gradient": (3, 3), "pressure_gradient": (3,)}
        total = {name: np.zeros((len(x), *shapes[name])) for name in asked}
        problem = self.problem
        for c, (body, sent) in enumerate(zip(problem.bodies, self.solution.flows, strict=True)):
            turn, size = body.rotation, body.size
            outside = ExteriorFlow(problem.maps[c].harmonics, sent)
            own = outside.evaluate(body.to_body(x), asked, tolerance)
            total["velocity"] += own["velocity"] @ turn.T
            total["pressure"] += own["pressure"] / size
            if "gradient" in asked:
                total["gradient"] += turn @ own["gradient"] @ turn.T / size
            if "pressure_gradient" in asked:
                total["pressure_gradient"] += own["pressure_gradient"] @ turn.T / size**2
            if problem.wall is None or not len(x):
                continue
            velocity, pressure = problem.reflected(c, outside, x)
            total["velocity"] += velocity
            total["pressure"] += pressure
            if len(asked) > 2:
                slopes = self._slopes(c, outside, x)
                for name in slopes.keys() & asked:
                    total[name] += slopes[name]
        return total

    def _slopes(self, c: int, sent: ExteriorFlow, x: Array) -> dict[str, Array]:
        """Gradients of the wall's answer to body c's flow, by differences."""
        problem = self.problem
        assert problem.wall is not None
        body = problem.bodies[c]
        mirrored = body.to_body(problem.wall.mirrored(x))
        away = body.size * body.shape.clearance(mirrored, np.zeros(3), np.eye(3)[2])
        step = _STEP * away[:, None]
        gradient, slope = np.empty((len(x), 3, 3)), np.empty((len(x), 3))
        for begin in range(0, len(x), _FEW):
            part = slice(begin, begin + _FEW)
            # All shifted points at once, so that one degree of the harmonics serves them.
            shifted = x[part] + _SHIFTS[:, None, None, None] * np.eye(3)[:, None] * step[part]
            u, p = problem.reflected(c, sent, shifted.reshape(-1, 3))
            shape = shifted.shape[:-1]
            gradient[part] = np.einsum("s,sjni->nij", _WEIGHTS, u.reshape(*shape, 3))
            slope[part] = np.einsum("s,sjn->nj", _WEIGHTS, p.reshape(shape))
        return {"gradient": gradient / step[:, :, None], "pressure_gradient": slope / step}

    def surface(self, theta: Array, phi: Array, b: int = 0) -> dict[str, Array]:
        """As `bie.field.FlowAround.surface`, of body b; one more is the wall, near the bodies."""
        if b == len(self.problem.bodies):
            return self._wall(len(theta), len(phi))
        body = self.problem.bodies[b]
        arms = body.size * body.shape.surface(theta[:, None], phi) @ body.rotation.T
        normals = body.shape.normal(theta[:, None], phi) @ body.rotation.T
        points = arms + body.position
        held = on_surface(self.evaluate, points, normals, points + _HAIR * arms)
        spin = np.cross(self.solution.angular_velocity[b], arms)
        return held | {"velocity": self.solution.velocity[b] + spin}

    def _wall(self, first: int, second: int) -> dict[str, Array]:
        """A square of the wall below the bodies, with what the fluid exerts on it."""
        wall, bodies = self.problem.wall, self.problem.bodies
        assert wall is not None
        centres = np.stack([body.position for body in bodies])
        middle = centres.mean(axis=0)
        reach = max(body.size * body.shape.radius for body in bodies)
        reach = 3.0 * reach + float(np.linalg.norm(centres - middle, axis=1).max())
        across = np.linalg.svd(wall.normal[None, :])[2][1:]
        sides = (np.linspace(-reach, reach, count) for count in (first, second))
        grid = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1)
        points = middle - wall.height(middle) * wall.normal + grid @ across
        values = self.evaluate(points.reshape(-1, 3), ("pressure", "stress", "velocity"))
        stress = symmetric(values["stress"]).reshape(*points.shape, 3)
        return {
            "points": points,
            "normals": np.broadcast_to(wall.normal, points.shape),
            "traction": stress @ wall.normal,
            "pressure": values["pressure"].reshape(points.shape[:-1]),
            "velocity": values["velocity"].reshape(points.shape),
        }

    # -- errors -------------------------------------------------------------------------------

    @cached_property
    def scale(self) -> float:
        """Largest speed that the bodies have relative to the background on their surfaces."""
        return max(float(np.linalg.norm(u, axis=-1).max()) for u in self._slips(np.zeros_like))

    @property
    def slip(self) -> float:
        """Largest slip on the surfaces, relative to `scale`: it bounds the error of velocities."""
        return float(self.slips.max())

    @cached_property
    def slips(self) -> Array:
        """Largest slip (N,) on each body between the nodes of its grid, relative to `scale`."""

        def disturbance(points: Array) -> Array:
            return self._disturbance(points, {"velocity", "pressure"}, 0.0)["velocity"]

        found = [np.linalg.norm(u, axis=-1).max() for u in self._slips(disturbance)]
        return np.array(found) / (self.scale or 1.0)

    def _slips(self, disturbance: Callable[[Array], Array]) -> list[Array]:
        """The bodies' velocities less background and a disturbance, between their nodes."""
        found = []
        for b, (body, n) in enumerate(zip(self.problem.bodies, self.problem.nodes, strict=True)):
            theta = np.pi * (np.arange(n + 1) + 0.5) / (n + 1)
            phi = 2.0 * np.pi * (np.arange(2 * n + 1) + 0.25) / (2 * n + 1)
            arms = body.size * body.shape.surface(theta[:, None], phi) @ body.rotation.T
            arms = (1.0 + _HAIR) * arms.reshape(-1, 3)
            points = arms + body.position
            u = self.solution.velocity[b] + np.cross(self.solution.angular_velocity[b], arms)
            if self.flow is not None:
                u = u - self.flow.velocity(points, self.time)
            found.append(u - disturbance(points))
        return found

    @property
    def state(self) -> dict[str, Array]:
        """Motion of the bodies, and force and torque ON them: as the scene shapes its bodies."""
        own, shaped = self.solution, self._shaped
        return {
            "velocity": shaped(own.velocity),
            "angular_velocity": shaped(own.angular_velocity),
            "force": shaped(0.0 - own.force),
            "torque": shaped(0.0 - own.torque),
        }

    @property
    def scales(self) -> dict[str, float]:
        """Sizes that velocity, force and torque are made of."""
        bodies = self.problem.bodies
        return sizes(self.scale, max(body.size * body.shape.radius for body in bodies))

    def check_points(self, count: int) -> Array:
        """Random points (count, 3) of the fluid, from the surfaces to ten body lengths away."""
        rng, found = np.random.default_rng(0), np.zeros((0, 3))
        while len(found) < count:
            body = self.problem.bodies[int(rng.integers(len(self.problem.bodies)))]
            theta, phi = np.arccos(rng.uniform(-1.0, 1.0)), rng.uniform(0.0, 2.0 * np.pi)
            away = body.shape.radius * 10.0 ** rng.uniform(-6.0, 1.3)
            local = body.shape.surface(theta, phi) + away * body.shape.normal(theta, phi)
            point = body.position + body.size * local @ body.rotation.T
            found = np.concatenate([found, point[None][~self.inside(point[None])]])
        return found

    def differences(self, points: Array) -> Array:
        """Difference (N,) of the velocity at points (N, 3) from that on coarser grids.

        Relative to `scale`; NaN in the bodies.
        """
        coarse = FlowAmong(self.solution.coarser, self.flow, self.time)
        one, other = (flow.evaluate(points, ("velocity",))["velocity"] for flow in (self, coarse))
        return np.asarray(np.linalg.norm(one - other, axis=-1) / (self.scale or 1.0))


def resolved(
    solve: Callable[[list[int]], FlowAmong], nodes: list[int], tolerance: float
) -> FlowAmong:
    """The flow on grids, at first of these nodes, whose slip is within a tolerance, or the finest.

    The grids that serve motions and loads do not: their errors are of the order of the slip
    squared.
    """
    while True:
        found = solve(nodes)
        wanting = (found.slips > tolerance) & (np.array(nodes) < MOST_NODES)
        if not wanting.any():
            return found
        for b in np.flatnonzero(wanting):
            slip = min(float(found.slips[b]), 0.1)
            more = max(2, math.ceil(nodes[b] * math.log(slip / tolerance) / -math.log(slip)))
            nodes[b] = min(nodes[b] + more + more % 2, MOST_NODES)


class AmongBodies:
    """Solves for the flow among the bodies of a scene at instants: as `around.AroundBody`.

    tolerance: relative error of the velocities, where it is less than that of the scene. held:
    whether the bodies do not move; else they are free under their loads. Bodies with inertia move
    as the instant says, where it says it.
    """

    def __init__(
        self, scene: CoupledSimulation, tolerance: float = 0.1, held: bool = False
    ) -> None:
        self.scene, self.held = scene, held
        scene.suspension.tolerance = min(scene.suspension.tolerance, tolerance)
        self.flow = scene.flow
        self._latest: tuple[Instant, FlowAmong] | None = None
        self._nodes: list[int] | None = None

    check = "coarser grids"

    def form(self, *_: Any) -> None:
        """Nothing is formed before it is known where the bodies are."""

    def at(self, instant: Instant) -> FlowAmong:
        """The flow at the instant; solved again only for another one."""
        if self._latest is None or self._latest[0] is not instant:
            self._latest = instant, self._resolved(instant)
        return self._latest[1]

    def _resolved(self, instant: Instant) -> FlowAmong:
        """The flow at the instant, see `resolved`."""
        suspension, x = self.scene.suspension, np.reshape(instant.position, (-1, 3))
        q, tolerance = np.reshape(instant.quaternion, (-1, 4)), suspension.tolerance
        places = suspension.placed(x, q)
        nodes = suspension.grids(places, self.flow, instant.time, clipped=True)
        if self._nodes is not None:
            nodes = np.maximum(nodes, self._nodes).tolist()

        def solve(nodes: list[int]) -> FlowAmong:
            solution = self._solved(instant, x, q, nodes)
            return FlowAmong(solution, self.flow, instant.time, self.scene.shaped)

        return resolved(solve, nodes, tolerance)

    def moving(self, equations: Any, t: float, y: Array) -> tuple[Array, FlowAmong]:
        """dy/dt of the states y (N, n_state) of a motion, and the flow then: one after the other.

        What the slip asked of the grids before is asked from the beginning.
        """
        x, q = y[:, POSITION], rotation.normalize(y[:, ORIENTATION])
        motion = () if equations.massless else equations.velocities(t, y)
        found = self._resolved(Instant(t, x, q, *motion))
        if equations.massless:
            equations.know(t, y, (found.solution.velocity, found.solution.angular_velocity))
        self._nodes = found.solution.nodes
        out = np.empty(y.T.shape)
        equations.rates(t, y.T, out)
        return out.T, found

    def _solved(self, instant: Instant, x: Array, q: Array, nodes: list[int]) -> Solution:
        scene, t = self.scene, instant.time
        if self.held:
            return scene.solved("held", t, x, q, nodes)
        if scene.massless or instant.velocity is None or instant.angular_velocity is None:
            return scene.solved("free", t, x, q, nodes)
        v, omega = (np.reshape(u, (-1, 3)) for u in (instant.velocity, instant.angular_velocity))
        return scene.solved("held", t, x, q, nodes, velocity=v, angular_velocity=omega)

    def facts(self, instant: Instant) -> dict[str, Any]:
        """Polar nodes of each body at an instant."""
        return {"nodes": self.at(instant).solution.nodes}

    def last_solve(self) -> tuple[int, float]:
        """Iterations of the latest solution, and the residual they were to reach."""
        assert self._latest is not None
        return self._latest[1].solution.took
