"""What the spacing of a series' samples leaves of a motion, by the same on every other sample."""

from __future__ import annotations

from copy import copy
from typing import TYPE_CHECKING

import numpy as np

from qbxstokes.flows import ChangingFlow
from qbxstokes.flows.interpolation import INTERPOLATIONS

if TYPE_CHECKING:
    from qbxstokes.simulation.assembly import Assembled


def left_by_samples(assembled: Assembled, end: float) -> dict[str, float]:
    """Error at the end that sampling leaves of a single axis and position, for smooth gradients.

    That of every other sample is 2^order times as large; where their number is even, up to the last
    but one of them. Empty where the flow is no series, or one of too few samples.
    """
    scene, flow = assembled.parts[0], assembled.parts[0].flow
    if len(assembled.initial) != 1 or not isinstance(flow, ChangingFlow):
        return {}
    series = flow.signal.series
    if series is None:
        return {}
    order = INTERPOLATIONS[series.interpolation]
    if len(series.times) < 2 * max(2, order) - 1:
        return {}
    thinned = series.thinned()
    other = copy(scene)
    other.flow = flow.of_series(thinned)
    again = assembled.again([other])
    last = end if series.outside != "error" else min(end, float(thinned.times[-1]))
    fine, rough = (each.trajectory(np.array([last])) for each in (assembled, again))
    share = 1.0 / max(1.0, 2.0**order - 1.0)
    found = [
        each.observe(run.times, run.states, ("axis", "position"))
        for each, run in ((assembled, fine), (again, rough))
    ]
    return {
        name: share * float(np.linalg.norm(found[0][name][-1, 0] - found[1][name][-1, 0]))
        for name in ("axis", "position")
    }
