"""One velocity gradient A(t), for all paths of an ensemble or for axes alone, in pieces of time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from qbxstokes.errors import FlowError, SceneError
from qbxstokes.flows import ChangingFlow, Flow, build_flow
from qbxstokes.flows.series import GradientSeries
from qbxstokes.simulation import arguments as given
from qbxstokes.typing import Array, Integers

if TYPE_CHECKING:
    from qbxstokes.simulation.body import Body

# Pieces of a run at least; instants at most at which the flow is held against the pieces.
_PIECES, _CHECKED = 50, 1000


class SharedGradient:
    """The gradient of a linear flow, for `Ensemble` in the place of a series of many paths.

    times (T,): instants, of which axes are looked at between all but the last and the next;
    paths: how many bodies of each kind; accuracy: of the gradient, accepted (`Sampled`).
    Raises SceneError for flows that are not linear, FlowError for functions that fail.
    """

    trace = 0.0
    interpolation = "pieces"

    def __init__(self, flow: Flow, times: Array, paths: int, accuracy: float) -> None:
        if len(times) < 2:
            right = "two or more, between which axes are looked at"
            raise SceneError("times", f"hold {len(times)} instant", right)
        self.flow, self.times, self._paths = flow, times, paths
        ends, origins, scales, gradients = pieces_of(flow, float(times[-1]), accuracy)
        self.edges = np.union1d(ends[ends < times[-1]], times)
        first, lengths = self.edges[:-1], np.diff(self.edges)
        piece = np.clip(np.searchsorted(ends, first, "right") - 1, 0, len(origins) - 1)
        # Powers of x = (t - origin) scale become those of the time of the interval, 0 to 1.
        start, share = (first - origins[piece]) * scales[piece], lengths * scales[piece]
        powers = gradients[piece].reshape(len(piece), -1, 9)
        self.degrees = powers.shape[1]
        for k in range(self.degrees - 1):
            for j in range(self.degrees - 2, k - 1, -1):
                powers[:, j] += start[:, None] * powers[:, j + 1]
        powers *= (share[:, None] ** np.arange(self.degrees))[..., None]
        self.samples = np.broadcast_to(powers.reshape(-1, 9), (paths, powers.size // 9, 9))

    def __len__(self) -> int:
        return self._paths

    @property
    def intervals(self) -> tuple[Array, Integers, Array]:
        """Ends of intervals, first of their numbers in `read`, and what makes powers of these."""
        count, d = len(self.edges) - 1, self.degrees
        return self.edges, d * np.arange(count), np.broadcast_to(np.eye(d), (count, d, d))

    def read(self, first: int, stop: int, begin: int = 0, end: int | None = None) -> Array:
        """Coefficients of powers (stop - first, n, 9), those of one interval after another's."""
        return np.array(self.samples[first:stop, begin:end], order="C")

    def typical(self, paths: int) -> Array:
        """Gradients (n, 9) of which the size is typical: those at the instants."""
        return self.samples[0, :: self.degrees][np.searchsorted(self.edges, self.times[:-1])]

    def sampling(self) -> dict[str, Any]:
        """What sampling the flow in time took, and by how much it is off, of its largest size."""
        if not isinstance(self.flow, ChangingFlow):
            return {}
        instants = self.times[:-1][:: -(-len(self.times) // _CHECKED)]
        exact = np.array([self.flow.signal.at(t) for t in instants.tolist()])
        units, still = self.flow.gradient_terms
        exact = (np.tensordot(exact, units, 1) + still).reshape(-1, 9)
        places = self.degrees * np.searchsorted(self.edges, instants)
        begins = self.samples[0, :: self.degrees]
        off, size = np.abs(exact - self.samples[0, places]).max(), np.abs(begins).max()
        return {"intervals": len(self.edges) - 1, "gradient": float(off / size) if size else 0.0}


def pieces_of(flow: Flow, end: float, accuracy: float) -> tuple[Array, ...]:
    """The gradient of a linear flow up to an instant, in pieces of time.

    Their edges (m + 1,), origins and scales (m,) and coefficients (m, degree + 1, 3, 3) of powers
    of (t - origin) scale. Raises SceneError for other flows.
    """
    if flow.degree is None or flow.degree > 1:
        raise SceneError("flow", f"is {flow.type_name}", "a linear flow, or integrate")
    if not isinstance(flow, ChangingFlow):
        edges, steady = np.array([0.0, max(end, 1.0)]), flow.gradient(np.zeros(3))
        return edges, np.zeros(1), np.ones(1), steady[None, None]
    sampled = flow.signal.sampled(end, 0.01 * accuracy, min(flow.spacing, end / _PIECES))
    if sampled.cover(end, 0.0) < end:
        assert sampled.refusal is not None
        raise sampled.refusal
    units, still = flow.gradient_terms
    gradients = np.tensordot(sampled.coefficients, units, 1)
    gradients[:, 0] += still
    return sampled.edges, sampled.origins, sampled.scales, gradients


def linear_flow(flow: Any) -> Flow:
    """A flow of a gradient given as a series of one path, a function of t or numbers, or as it is.

    Raises SceneError for what is none.
    """
    if not isinstance(flow, Flow):
        if not (callable(flow) or np.shape(flow) == (3, 3)):
            right = "a qs.GradientSeries, a linear flow or a function A(t)"
            raise SceneError("flow", f"is {flow!r}", right)
        flow = build_flow({"type": "linear", "gradient": flow})
    return flow


def gradients_of(flow: Any, times: Any, paths: Any, axes: Array | None, accuracy: float) -> Any:
    """The gradients of an ensemble: a series of many paths as it is, a flow for all of them."""
    if isinstance(flow, GradientSeries):
        for name, value in (("times", times), ("paths", paths)):
            if value is not None:
                raise SceneError(name, "is given", f"the {name} of the series are taken")
        return flow
    flow = linear_flow(flow)
    if times is None:
        raise SceneError("times", "are missing", "instants (T,) at which axes are looked at")
    count = 1000 if paths is None else paths
    if axes is not None:
        count = 1 if axes.ndim == 1 else len(axes)
        if paths not in (None, count):
            raise SceneError("paths", f"are {paths}", f"{count}, as many as axes")
    if isinstance(count, bool) or not isinstance(count, (int, np.integer)) or count < 1:
        raise SceneError("paths", f"are {count!r}", "a whole number, at least 1")
    return SharedGradient(flow, given.instants(times), int(count), accuracy)


def axes_in(
    body: Body, flow: Flow | GradientSeries, times: ArrayLike, axes: ArrayLike, tolerance: float
) -> Array:
    """Axes alone of massless bodies in one linear flow, steady or not: see `Body.axes`."""
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
