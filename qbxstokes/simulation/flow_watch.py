"""What looks after the flows of a run: their breaks, the grids that see them, users' functions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from qbxstokes.errors import FlowError, FlowFunctionError, SceneError
from qbxstokes.flows.check import check_stokesian, seems_stokesian
from qbxstokes.motion.layout import ORIENTATION, POSITION
from qbxstokes.petsc.trajectory import Watch
from qbxstokes.typing import Array

if TYPE_CHECKING:
    from qbxstokes.flows import Flow
    from qbxstokes.simulation.assembly import Assembled
    from qbxstokes.simulation.simulation import Simulation


# Accepted steps between looks at whether a flow is Stokesian, and how many of these in a run.
_STEPS_BETWEEN_CHECKS, _MOST_LOOKS = 10, 50.0
# Share of the tolerance of a run that the grid on the surface may take.
_SHARE = 0.1
# What the roughness of samples may come to in a step, in the error that falls to it: it changes its
# sign from sample to sample, and a step as long as it may be passes several of them.
_ROUGH = 2.0


def breaks_of(flows: Sequence[Flow], end: float, error: float) -> Array:
    """Instants at which some flow is not smooth: steps end there.

    error: that falls to a step over the longest one, as rough as which a gradient may be.
    """
    found = np.unique(np.concatenate([flow.breaks(end, _ROUGH * error) for flow in flows]))
    return np.asarray(found[(found > 0.0) & (found < end)])


def stops_of(flows: Sequence[Flow], end: float, accuracy: float, longest: float) -> Array:
    """Instants at which steps end that are to see functions of time which nobody follows.

    accuracy: to which they are sampled. Raises SceneError where one is not smooth to it.
    """
    found = [np.empty(0)]
    for signal in (signal for flow in flows for signal in flow.signals):
        try:
            found.append(signal.sampled(end, accuracy, longest).stops(longest))
        except FlowError as refusal:
            raise SceneError("flow", str(refusal)) from None
    return np.unique(np.concatenate(found))


class FlowWatch(Watch):
    """As `petsc.trajectory.Watch`, of all scenes that are integrated together up to `end`.

    Functions that were recognised as polynomials are held against these where a step has ended,
    and the others are to be Stokesian there: around one lane after another, every so many steps.
    A motion on grids (`bie.providers.MonitoredGridMotion`) may miss a share of the tolerance: an
    error of Omega grows with time, by max(k, 1/k)^2 besides where an axis lingers
    (`RigidBodyEquations.sensitivity`).
    """

    def __init__(self, assembled: Assembled, end: float) -> None:
        self._parts = list(zip(assembled.parts, assembled.slices(), strict=True))
        parts = assembled.parts
        flows = (flow for part in parts for flow in (part.flow, part.carrier))
        self._flows = list({id(flow): flow for flow in flows}.values())
        self._users = [entry for entry in self._parts if not entry[0].flow.singular_points_known]
        self._motions: list[tuple[Any, slice, tuple[float, float]]] = []
        for (part, lanes), formed in zip(self._parts, assembled.hydrodynamics, strict=True):
            if hasattr(formed.provider, "accept"):
                k = formed.model.effective_ratio
                allowed = _SHARE * part.tolerance / end
                slower = allowed / max(k, 1.0 / k) ** 2 if k > 0.0 else 0.0
                self._motions.append((formed.provider, lanes, (allowed, slower)))
        self._count, self._looks, self._looked, self._apart = 0, 0, 0.0, end / _MOST_LOOKS
        self.looks = bool(self._users or self._motions)

    def until(self, t: float, since: float = -math.inf) -> None:
        """Let all flows show themselves as before the break t, and after one at `since`."""
        for flow in self._flows:
            flow.until(t, since)

    def begin(self, t: float, states: Array) -> None:
        """Choose the grids of the steps to come."""
        for motion, lanes, allowed in self._motions:
            motion.begin(t, *_places(states[lanes]), allowed)

    def rest(self) -> None:
        """Let motions be found to the tolerance of the body's hydrodynamics again."""
        for motion, _, _ in self._motions:
            motion.rest()

    def accept(self, t: float, states: Array) -> bool:
        """Whether a step that has ended in states (n, n_state) stands; raises FlowError."""
        self._count += 1
        due = self._count >= _STEPS_BETWEEN_CHECKS and t > self._looked + self._apart
        if due:
            self._count, self._looked, self._looks = 0, t, self._looks + 1
        for part, lanes in self._users:
            places = states[lanes, POSITION]
            if part.recognised is not None:
                part.recognised.check(t, places, part.body.shape.radius)
            if due or part.recognised is not None:
                require_stokesian(part, places[self._looks % len(places)], t)
        stands = [m.accept(t, *_places(states[lanes])) for m, lanes, _ in self._motions]
        return all(stands)


def _places(states: Array) -> tuple[Array, Array]:
    return states[:, POSITION], states[:, ORIENTATION]


def require_stokesian(part: Simulation, place: Array, t: float) -> None:
    """Refuse a flow that is not Stokesian around a place at time t; raises SceneError.

    A function that fails is left to the equations, which tell when and where they needed it.
    """
    radius = 2.0 * part.body.shape.radius
    try:
        if part.recognised is not None:
            part.recognised.require_stokesian(t, radius)
            return
        local = part.body.settings.derivatives is not None
        if not seems_stokesian(part.flow, place, radius, t, local):
            check_stokesian(part.flow, place, radius=radius, t=t, local=local)
    except FlowFunctionError:
        return
    except FlowError as error:
        if part.flow.singular_points_known or "not Stokesian" in str(error):
            raise SceneError("flow", f"at t = {t:.6g}: {error}") from None
