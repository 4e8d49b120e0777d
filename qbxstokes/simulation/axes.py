"""Axes alone of massless bodies in one linear flow, steady or not (`motion.linear_axes`)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.errors import FlowError, SceneError
from qbxstokes.flows import ChangingFlow, Flow, build_flow
from qbxstokes.flows.series import GradientSeries
from qbxstokes.simulation import arguments as given
from qbxstokes.typing import Array

if TYPE_CHECKING:
    from qbxstokes.simulation.body import Body


# Pieces of a run at least.
_PIECES = 50


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
    if isinstance(flow, GradientSeries):
        flow = build_flow({"type": "linear", "gradient": flow})
    if flow.degree is None or flow.degree > 1:
        raise SceneError("flow", f"is {flow.type_name}", "a linear flow, or integrate")
    law = body.formed(1, None)[0].model
    worst = max(law.effective_ratio, 1.0 / law.effective_ratio)
    end = float(instants[-1])
    p = start.reshape(-1, 3).T / np.linalg.norm(start.reshape(-1, 3).T, axis=0)
    found = np.empty((len(instants), *p.shape))
    found[:] = p
    if end > 0.0:
        numbers = law.faxen.linear, law.faxen.rest
        pieces = _pieces(flow, end, tolerance / worst)
        reached = follow(pieces, numbers, instants, tolerance / (worst * end), found)
        if reached < end:
            raise FlowError(f"the gradient turns too fast near t = {reached:.6g}", ("gradient",))
    return np.moveaxis(found, (0, 1), (1, 2)).reshape(*start.shape[:-1], len(instants), 3)


def _pieces(flow: Flow, end: float, tolerance: float) -> tuple[Array, ...]:
    """The gradient to a tolerance up to an instant, as `motion.linear_axes.follow` takes it."""
    if not isinstance(flow, ChangingFlow):
        edges, steady = np.array([0.0, max(end, 1.0)]), flow.gradient(np.zeros(3))
        return edges, np.zeros(1), np.ones(1), steady[None, None]
    sampled = flow.signal.sampled(end, 0.01 * tolerance, min(flow.spacing, end / _PIECES))
    if sampled.cover(end, 0.0) < end:
        assert sampled.refusal is not None
        raise sampled.refusal
    units, still = flow.gradient_terms
    gradients = np.tensordot(sampled.coefficients, units, 1)
    gradients[:, 0] += still
    return sampled.edges, sampled.origins, sampled.scales, gradients
