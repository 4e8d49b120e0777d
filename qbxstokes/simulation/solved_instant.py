"""One instant of bodies that share a fluid: the grids that it takes, and what its solution holds.

Grids follow from the gaps and from the background flow.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from qbxstokes.bie.multiple_scattering import (
    LEAST_NODES,
    Coupled,
    Placed,
    Plane,
    closest,
    gaps_of,
    names_of,
)
from qbxstokes.bie.resolution import flow_nodes
from qbxstokes.errors import ContactError, FlowError, SceneError
from qbxstokes.flows import Flow
from qbxstokes.flows.check import check_stokesian
from qbxstokes.geometry.gaps import Gaps
from qbxstokes.typing import Array

if TYPE_CHECKING:
    from qbxstokes.simulation.suspension import Suspension

MOST_NODES = 64  # polar nodes of motions
# Measured error with n polar nodes: C exp(-2 a n) with the rate a of the gap, see `_factor`. Discs
# edge to edge fall slower, by exp(-1.3 a) a node.
_FACTOR = 400.0
_FIRST, _LAST = 40, 96  # polar nodes that are tried first, and last
_BEST = 0.02  # least factor of the law of errors that was met


def _factor(k: float, free: bool, wall: bool) -> float:
    """C of a body's error, relative: of velocities of free bodies, else of the resistance.

    Measured up to: resistance 300, 1900 (k = 1, 2); free, of the velocities that the loads give a
    body alone, in pairs that are pulled apart, turned against each other, or in a strain along
    their line 0.2, 4, 18, 51, 130 (k = 1/5, 1/2, 1, 2, 4); by a wall 8, 45, 340 (1/2, 1, 2).
    """
    if not free:
        return _FACTOR * k * k
    return 40.0 * max(k, k**3) if wall else 20.0 * k * k


def rooms(
    gaps: Gaps, bodies: Sequence[Placed], wall: Plane | None, tolerance: float, free: bool
) -> Array:
    """By how much every gap (P,) exceeds the one at which a body takes more than MOST_NODES.

    As gaps of spheres that osculate the bodies change with the rate, by cosh(rate) - 1.
    """
    factors = [_factor(body.ratio, free, wall is not None) for body in bodies]
    served = np.log(np.array(factors) / tolerance) / (2.0 * (MOST_NODES - 1))
    part = np.zeros(len(gaps.gap))  # of the gap that is not to be had
    for side in (0, 1):
        here = (gaps.pairs[:, side] >= 0) & (gaps.gap > 0.0)
        least, rates = served[gaps.pairs[here, side]], gaps.rates[here, side]
        part[here] = np.maximum(part[here], (np.sinh(0.5 * least) / np.sinh(0.5 * rates)) ** 2)
    return np.asarray(gaps.gap * (1.0 - part))


def _nodes_for(rate: float, tolerance: float, factor: float) -> int:
    """Polar nodes for the rate of decay of a gap (see `Gaps`) and a relative error."""
    if rate == np.inf:
        return LEAST_NODES
    wanted = math.log(factor / tolerance) / (2.0 * max(rate, 1e-6))
    # Even numbers, so that few different maps are formed.
    return max(LEAST_NODES, 2 * math.ceil(0.5 * wanted + 0.5))


def choose_nodes(
    bodies: Sequence[Placed], wall: Plane | None, tolerance: float, free: bool = False
) -> list[int]:
    """Polar nodes of each body that serve a tolerance for certain, perhaps above MOST_NODES.

    free: for velocities under given loads, which take fewer than forces of given motions. Raises
    ContactError for bodies that touch.
    """
    least, who, rates = closest(bodies, wall)
    if least <= 0.0:
        raise ContactError(names_of(*who), least, "they touch or overlap")
    return [
        _nodes_for(rate, tolerance, _factor(body.ratio, free, wall is not None))
        for body, rate in zip(bodies, rates, strict=True)
    ]


def _too_near(
    bodies: Sequence[Placed], wall: Plane | None, tolerance: float, n: int
) -> ContactError:
    """What is said of a gap that takes n polar nodes."""
    gap, (b, c), _ = closest(bodies, wall)
    text = f"the tolerance {tolerance:.0e} would take {n} polar nodes"
    return ContactError(names_of(b, c), gap, text)


def probed_nodes(scene: Suspension, places: Sequence[Placed], wanted: Sequence[int]) -> list[int]:
    """Polar nodes that serve a gap for which the law of errors, made for the worst, wants too many.

    By the estimated error of squeezing the least gap, relative to the largest resistance of a body.
    wanted: those of the law. More than a motion takes, and only on bodies that are near another;
    raises ContactError where they do not suffice.
    """
    _, who, rates = closest(places, scene.wall)
    if _nodes_for(float(rates.min()), scene.tolerance, _BEST) > _LAST:
        raise _too_near(places, scene.wall, scene.tolerance, max(wanted))
    found = gaps_of(places, scene.wall)
    direction = found.direction[np.argmin(found.gap)]
    motion = np.zeros((len(places), 6))
    motion[who[0], :3] = direction
    if who[1] >= 0:
        motion[who[1], :3] = -direction
    most = _FIRST
    while most <= _LAST:
        nodes = [min(n, most) for n in wanted]
        problem = scene.problem(places, nodes)
        estimate = scene.solved_held(problem, [(motion, None)])[0].error_estimate["force"]
        alone = [one.resistance.max() * p.size for one, p in zip(problem.maps, places, strict=True)]
        error = estimate / max(alone)
        if error <= scene.tolerance:
            return nodes
        # Errors fall by exp(-2 rate) a node.
        more = math.ceil(math.log(error / scene.tolerance) / (2.0 * float(rates.min())))
        most += max(4, more + more % 2)
    raise _too_near(places, scene.wall, scene.tolerance, most)


def flow_nodes_on(
    b: int, place: Placed, flow: Flow, t: float, tolerance: float, known: bool
) -> int:
    """Polar nodes that resolve the flow on body number b, which it must surround.

    known: whether it is known to be a Stokes flow. Raises SceneError for a flow that is none around
    the body, or that MOST_NODES do not resolve.
    """
    reach = place.size**2 * place.shape.extent(place.axis)
    for edge in flow.domain:
        if edge.gap(place.position, reach) <= 0.0:
            raise SceneError("position", f"has body {b} beyond {edge}", "the body inside")
    try:
        radius = 2.0 * place.size * place.shape.radius
        if not known:
            check_stokesian(flow, place.position, radius=radius, t=t)
        if flow.degree is not None and flow.degree <= 3:
            return 0
        if not flow.singular_points_known:
            raise FlowError("is a function, whose variation over the bodies nobody knows")
        points = place.to_body(np.asarray(flow.singular_points, dtype=np.float64))
        if place.shape.clearance(points, np.zeros(3), np.eye(3)[2]).min(initial=np.inf) <= 0.0:
            raise FlowError(f"is singular in body {b}")
        rate = float(place.shape.flow_decay(points).max(initial=0.0))
        found = flow_nodes(rate, tolerance)[0]
    except FlowError as error:
        right = "a named flow, or in Python nodes= as you judge"
        raise SceneError("flow", str(error), right) from None
    if found > MOST_NODES:
        raise SceneError("flow", f"takes {found} nodes on body {b}", f"at most {MOST_NODES}")
    return found


@dataclass
class Solution:
    """One solved instant: each body's exterior flow, motion and load, and what the solver did.

    velocity, angular_velocity, force, torque (N, 3), space frame; force and torque are exerted by
    the bodies ON the fluid. took: iterations of GMRES, and the relative residual they left. alone:
    largest speed of surfaces that given loads would give to each body alone.
    """

    problem: Coupled
    flows: list[Any]
    velocity: Array
    angular_velocity: Array
    force: Array
    torque: Array
    took: tuple[int, float]
    unknowns: Array = field(repr=False)
    _again: Callable[[list[int]], Solution] = field(repr=False)
    alone: float = 0.0

    @property
    def nodes(self) -> list[int]:
        """Polar nodes of each body's grid."""
        return list(self.problem.nodes)

    @property
    def iterations(self) -> int:
        """Iterations of GMRES."""
        return self.took[0]

    @property
    def stresslet(self) -> Array:
        """Stresslets (N, 3, 3), space frame, of the tractions on the bodies about their centres."""
        return np.stack([self.problem.stresslet(b, flow) for b, flow in enumerate(self.flows)])

    @cached_property
    def coarser(self) -> Solution:
        """The same with two polar nodes less and everything else ten times looser."""
        return self._again(self.problem.coarser)

    @cached_property
    def sizes(self) -> dict[str, float]:
        """What errors are relative to: the largest of a kind, velocities or loads, by the arm.

        Velocities of bodies under loads are made of those that the loads give each alone.
        """
        arm = max(body.size * body.shape.radius for body in self.problem.bodies)
        found: dict[str, float] = {}
        # Powers of the arm by which quantities of a kind are of one size: moments and forces.
        for least, kind in (
            (self.alone, {"velocity": 0, "angular_velocity": 1}),
            (0.0, {"force": 1, "torque": 0, "stresslet": 0}),
        ):
            whole = [np.abs(getattr(self, name)).max() * arm**p for name, p in kind.items()]
            found |= {name: float(max(least, *whole)) / arm**p for name, p in kind.items()}
        return found

    @cached_property
    def error_estimate(self) -> dict[str, float]:
        """Estimated largest errors of velocity, angular_velocity, force, torque and stresslet.

        Absolute, by what is `coarser` (`bie.multiple_scattering.estimated`); given parts of the
        motion or loads have none.
        """
        problem, coarse = self.problem, self.coarser
        return {
            name: problem.estimated(getattr(self, name), getattr(coarse, name), size)
            for name, size in self.sizes.items()
        }

    @property
    def relative_errors(self) -> dict[str, float]:
        """The same as shares of `sizes`."""
        return {name: e / self.sizes[name] for name, e in self.error_estimate.items() if e}
