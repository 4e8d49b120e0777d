"""Grids of bodies that share a fluid: how many nodes a background flow takes on each."""

from __future__ import annotations

import numpy as np

from qbxstokes.bie.coupling import MOST_NODES, Placed
from qbxstokes.bie.resolution import flow_nodes
from qbxstokes.errors import FlowError, SceneError
from qbxstokes.flows import Flow
from qbxstokes.flows.check import check_stokesian


def flow_nodes_on(b: int, place: Placed, flow: Flow, t: float, tolerance: float) -> int:
    """Polar nodes that resolve the flow on body number b, which it must surround.

    Raises SceneError for a flow that is none around the body, or that MOST_NODES do not resolve.
    """
    reach = place.size**2 * place.shape.extent(place.axis)
    for edge in flow.domain:
        if edge.gap(place.position, reach) <= 0.0:
            raise SceneError("position", f"has body {b} beyond {edge}", "the body inside")
    try:
        radius = 2.0 * place.size * place.shape.radius
        check_stokesian(flow, place.position, radius=radius, t=t)
        if flow.degree is not None and flow.degree <= 3:
            return 0
        if not flow.singular_points_known:
            raise FlowError("is a function, whose variation over the bodies nobody knows")
        points = place.to_body(np.asarray(flow.singular_points, dtype=np.float64))
        if place.shape.clearance(points, np.zeros(3), np.eye(3)[2]).min(initial=np.inf) <= 0.0:
            raise FlowError(f"is singular in body {b}")
        rate = float(place.shape.decay(points).max(initial=0.0))
        found = flow_nodes(rate, tolerance)[0]
    except FlowError as error:
        raise SceneError("flow", str(error), "nodes= as you judge, or another flow") from None
    if found > MOST_NODES:
        raise SceneError("flow", f"takes {found} nodes on body {b}", f"at most {MOST_NODES}")
    return found
