"""Axes alone of massless bodies in one linear flow, steady or not (`motion.linear_axes`)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.errors import FlowError, SceneError
from qbxstokes.flows import Flow
from qbxstokes.flows.series import GradientSeries
from qbxstokes.simulation import arguments as given
from qbxstokes.simulation.shared_gradient import linear_flow, pieces_of
from qbxstokes.typing import Array

if TYPE_CHECKING:
    from qbxstokes.simulation.body import Body


def axes_in(
    body: Body, flow: Flow | GradientSeries, times: ArrayLike, axes: ArrayLike, tolerance: float
) -> Array:
    """What `Body.axes` says."""
    from qbxstokes.motion.linear_axes import follow

    instants = given.instants(times)
    tolerance = given.accepted(tolerance)
    start = given.numbers("orientation", axes, "axes (..., 3), not zero")
    if start.shape[-1:] != (3,) or not np.all(np.linalg.norm(start, axis=-1) > 0.0):
        raise SceneError("orientation", f"has shape {start.shape}", "axes (..., 3), not zero")
    if np.any(body.stokes_number):
        raise SceneError("body.stokes_number", "is not 0", "0, or integrate")
    flow = linear_flow(flow)
    law = body.formed(1, None)[0].model
    worst = max(law.effective_ratio, 1.0 / law.effective_ratio)
    end = float(instants[-1])
    p = start.reshape(-1, 3).T / np.linalg.norm(start.reshape(-1, 3).T, axis=0)
    found = np.empty((len(instants), *p.shape))
    found[:] = p
    if end > 0.0:
        numbers = law.faxen.linear, law.faxen.rest
        pieces = pieces_of(flow, end, tolerance / worst)
        reached = follow(pieces, numbers, instants, tolerance / (worst * end), found)
        if reached < end:
            raise FlowError(f"the gradient turns too fast near t = {reached:.6g}", ("gradient",))
    return np.moveaxis(found, (0, 1), (1, 2)).reshape(*start.shape[:-1], len(instants), 3)
