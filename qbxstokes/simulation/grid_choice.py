"""Grids of bodies that share a fluid: how many nodes near gaps and a background flow take."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from qbxstokes.bie.multiple_scattering import (
    MOST_NODES,
    Placed,
    closest,
    gaps_of,
    nodes_for,
    too_near,
)
from qbxstokes.bie.resolution import flow_nodes
from qbxstokes.errors import FlowError, SceneError
from qbxstokes.flows import Flow
from qbxstokes.flows.check import check_stokesian

if TYPE_CHECKING:
    from qbxstokes.simulation.suspension import Suspension

_FIRST = 40  # polar nodes that are tried first
_BEST = 0.02  # least factor of the law of errors that was met


def probed_nodes(scene: Suspension, places: Sequence[Placed], wanted: Sequence[int]) -> list[int]:
    """Polar nodes that serve a gap for which the law of errors, made for the worst, wants too many.

    By the estimated error of squeezing the least gap, relative to the largest resistance of a body.
    wanted: those of the law. Raises ContactError where MOST_NODES do not suffice.
    """
    _, who, rates = closest(places, scene.plane)
    if nodes_for(float(rates.min()), scene.tolerance, _BEST) > MOST_NODES:
        raise too_near(places, scene.plane, scene.tolerance, max(wanted))
    found = gaps_of(places, scene.plane)
    direction = found.direction[np.argmin(found.gap)]
    motion = np.zeros((len(places), 6))
    motion[who[0], :3] = direction
    if who[1] >= 0:
        motion[who[1], :3] = -direction
    most = _FIRST
    while most <= MOST_NODES:
        nodes = [min(n, most) for n in wanted]
        problem = scene.problem(places, nodes)
        estimate = scene.solved_held(problem, motion).error_estimate["force"]
        alone = [one.resistance.max() * p.size for one, p in zip(problem.maps, places, strict=True)]
        error = estimate / max(alone)
        if error <= scene.tolerance:
            return nodes
        # Errors fall by exp(-2 rate) a node.
        more = math.ceil(math.log(error / scene.tolerance) / (2.0 * float(rates.min())))
        most += max(4, more + more % 2)
    raise too_near(places, scene.plane, scene.tolerance, most)


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
        raise SceneError("flow", str(error), "nodes= as you judge, or another flow") from None
    if found > MOST_NODES:
        raise SceneError("flow", f"takes {found} nodes on body {b}", f"at most {MOST_NODES}")
    return found
