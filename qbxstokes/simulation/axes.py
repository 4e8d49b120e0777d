"""Axes alone of massless bodies in one linear flow, steady or not: one matrix serves all of them.

The axis is q/|q| of q' = L q with L of the body's law and the gradient (`motion.paths`), so that
q(t) = M(t) q(0) with one matrix M for all bodies. Over a piece of time M is found at the six nodes
of Gauss's quadrature from L there (collocation of order 12; Hairer, Norsett & Wanner, Solving
Ordinary Differential Equations I, II.7), by one linear system, for all pieces at once. How fast the
Legendre coefficients of L fall up to degree 5 tells what is left at degree 12; a piece for which it
is too much is halved. M becomes singular with the strain: it begins anew where it has grown.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import ArrayLike, NDArray

from qbxstokes.errors import FlowError, SceneError
from qbxstokes.flows import ChangingFlow, Flow, build_flow
from qbxstokes.flows.series import GradientSeries
from qbxstokes.simulation import arguments as given

if TYPE_CHECKING:
    from qbxstokes.simulation.body import Body

Array = NDArray[np.float64]

_STAGES = 6
_ROOTS, _WEIGHTS = legendre.leggauss(_STAGES)
_NODES, _SHARES, _POWERS = 0.5 * (_ROOTS + 1.0), 0.5 * _WEIGHTS, np.arange(_STAGES)
_INTEGRALS = (
    _NODES[:, None] ** (_POWERS + 1) / (_POWERS + 1) @ np.linalg.inv(_NODES[:, None] ** _POWERS)
)
# Legendre coefficients 5, 4 and 3 of values at the nodes.
_TAIL = np.linalg.inv(legendre.legvander(_ROOTS, _STAGES - 1))[:-4:-1]
# Pieces of a run at least, turn of a body in one at most, growth of M, and halvings at most.
_PIECES, _REACH, _GROWTH, _HALVINGS = 50, 1.5, 1e3, 40
_ROUNDING, _TINY = 1e-15, 1e-300


def axes_in(
    body: Body, flow: Flow | GradientSeries, times: ArrayLike, axes: ArrayLike, tolerance: float
) -> Array:
    """What `Body.axes` says."""
    instants = given.instants(times)
    start = np.asarray(axes, dtype=np.float64)
    if start.shape[-1:] != (3,) or not np.all(np.linalg.norm(start, axis=-1) > 0.0):
        raise SceneError("orientation", f"has shape {start.shape}", "axes (..., 3), not zero")
    if np.any(body.stokes_number):
        raise SceneError("body.stokes_number", "is not 0", "0, or integrate")
    if isinstance(flow, GradientSeries):
        flow = build_flow({"type": "linear", "gradient": flow})
    if flow.degree is None or flow.degree > 1:
        raise SceneError("flow", f"is {flow.type_name}", "a linear flow, or integrate")
    law = body.formed(1, None)[0].model
    ratio = law.effective_ratio
    end = float(instants[-1])
    accepted = tolerance / (max(ratio, 1.0 / ratio) * end) if end > 0.0 else tolerance
    p = start.reshape(-1, 3).T / np.linalg.norm(start.reshape(-1, 3).T, axis=0)
    found = np.empty((len(instants), *p.shape))
    gradients, edges = _gradients(flow, end, tolerance / max(ratio, 1.0 / ratio))
    cuts = np.concatenate([instants, edges])
    ends, matrices = _pieces(gradients, law.faxen.linear, law.faxen.rest, cuts, instants, accepted)
    whole, place = np.eye(3), int(np.searchsorted(instants, 0.0, "right"))
    found[:place] = p
    for t, matrix in zip(ends.tolist(), matrices, strict=True):
        whole = matrix @ whole
        wanted = place < len(instants) and t == instants[place]
        if wanted or np.vdot(whole, whole) > _GROWTH * _GROWTH:
            p = whole @ p
            p /= np.sqrt(np.einsum("in,in->n", p, p))
            whole = np.eye(3)
        if wanted:
            found[place] = p
            place += 1
    return np.moveaxis(found, (0, 1), (1, 2)).reshape(*start.shape[:-1], len(instants), 3)


def _pieces(
    gradients: Callable[[Array], Array],
    linear: float,
    rest: float,
    cuts: Array,
    instants: Array,
    accepted: float,
) -> tuple[Array, Array]:
    """Ends (m,) of pieces of time, in their order, and M over each of them (m, 3, 3)."""
    end = float(instants[-1])
    cuts = np.unique(cuts[(cuts >= 0.0) & (cuts <= end)])
    cuts = cuts[np.concatenate([[True], np.diff(cuts) > 1e-14 * end])] if end else cuts
    cuts = np.unique(np.concatenate([cuts, instants]))  # to the last bit
    first, last = cuts[:-1], cuts[1:]
    ends, turnings = [], []
    for _ in range(_HALVINGS):
        length = last - first
        a = gradients(first[:, None] + length[:, None] * _NODES)
        back = np.swapaxes(a, -1, -2)
        turning = rest * (a - back) + linear * (back if linear < 0.0 else a)
        turning *= length[:, None, None, None]
        parts = np.linalg.norm(np.einsum("cs,msij->cmij", _TAIL, turning), axis=(2, 3))
        late = np.maximum(parts[0], 0.1 * parts[1])  # either may vanish by symmetry
        fall = np.maximum(parts[0] / (parts[1] + _TINY), 0.5 * parts[1] / (parts[2] + _TINY))
        size = np.linalg.norm(turning, axis=(2, 3)).max(axis=1)
        error = late * np.minimum(1.0, fall) ** (_STAGES - 1)
        good = (size <= _REACH) & (error <= np.maximum(accepted * length, _ROUNDING * size))
        ends.append(last[good])
        turnings.append(turning[good])
        if good.all():
            break
        begin, stop = first[~good], last[~good]
        middle = 0.5 * (begin + stop)
        first, last = np.concatenate([begin, middle]), np.concatenate([middle, stop])
    else:
        raise FlowError(f"the gradient changes too fast near t = {first[0]:.6g}", ("gradient",))
    order = np.argsort(np.concatenate(ends), kind="stable")
    m = np.concatenate(turnings)[order]
    # Y_i - sum_j a_ij L_j Y_j = 1, and M = 1 + sum_i b_i L_i Y_i.
    system = -np.einsum("ij,mjab->miajb", _INTEGRALS, m).reshape(len(m), 3 * _STAGES, 3 * _STAGES)
    system += np.eye(3 * _STAGES)
    inside = np.linalg.solve(system, np.tile(np.eye(3), (len(m), _STAGES, 1)))
    inside = inside.reshape(len(m), _STAGES, 3, 3)
    matrices = np.eye(3) + np.einsum("s,msab->mab", _SHARES, m @ inside)
    return np.concatenate(ends)[order], matrices


def _gradients(flow: Flow, end: float, tolerance: float) -> tuple[Callable[[Array], Array], Array]:
    """Gradients (..., 3, 3) at instants (...), and instants between which they are smooth (n,)."""
    if end == 0.0 or not isinstance(flow, ChangingFlow):
        steady = flow.gradient(np.zeros(3))
        return lambda t: np.broadcast_to(steady, (*t.shape, 3, 3)), np.array([0.0, end])
    sampled = flow.signal.sampled(end, 0.01 * tolerance, min(flow.spacing, end / _PIECES))
    if sampled.cover(end, 0.0) < end:
        assert sampled.refusal is not None
        raise sampled.refusal
    units = np.stack([unit.gradient(np.zeros(3)) for unit in flow.units])
    still = 0.0 if flow.still is None else flow.still.gradient(np.zeros(3))
    return lambda t: np.tensordot(sampled.many(t), units, 1) + still, sampled.edges
