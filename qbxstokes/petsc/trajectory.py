"""What an integration starts from, hands over on the way and returns.

States are (columns, n_state) as in `motion.layout`.
"""

import math
from dataclasses import dataclass

from qbxstokes.geometry import rotation
from qbxstokes.motion.layout import ORIENTATION
from qbxstokes.typing import Array


class Watch:
    """What looks after the flow of a run: nothing here. States are (columns, n_state).

    looks: whether `accept` has anything to look at.
    """

    looks = False

    def begin(self, t: float, states: Array) -> None:
        """Before the first step from a start or a cut."""

    def until(self, t: float, since: float = -math.inf) -> None:
        """Let the equations be as before the break t, which is the next; inf: known for good.

        since: a break at which the step begins, at which they are as just after it.
        """

    def accept(self, t: float, states: Array) -> bool:
        """Whether the step that has ended so stands; if not it is taken again.

        May raise FlowFunctionError, which ends the run, or FlowError: the step is shortened.
        """
        return True

    def rest(self) -> None:
        """After the last step before a cut or the end."""


@dataclass(frozen=True)
class Checkpoint:
    """All that a run needs to go on, and its record so far; only `time` and `state` at the start.

    state (columns, n_state); step: the next one, 0 to choose; next_sample: index into the times.
    method: TS type, or the formula of a Runge-Kutta type; local_tolerance: what the error of a step
    is held to; reachable: about the error at the end that rounding alone leaves; expected:
    right-hand sides that are forecast, by which the rate is compiled or not; all four as at the
    start of the run. steps, rejections: accepted and rejected steps; evaluations, jacobians:
    right-hand sides and Jacobians of the block. norm_drift: largest | |q| - 1 | that any cut met
    before it was removed. changed: what the program changed of its choices on the way, in words.
    """

    time: float
    state: Array
    step: float = 0.0
    next_sample: int = 0
    method: str = ""
    local_tolerance: float = 0.0
    reachable: float = 0.0
    expected: float = 0.0
    steps: int = 0
    rejections: int = 0
    evaluations: int = 0
    jacobians: int = 0
    norm_drift: float = 0.0
    changed: str = ""


@dataclass(frozen=True)
class Chunk:
    """Samples since the last cut, and the checkpoint that follows them.

    times (c,); states (c, columns, n_state), quaternions of unit length. `first` is the index of
    the first sample in the whole run.
    """

    first: int
    times: Array
    states: Array
    checkpoint: Checkpoint


@dataclass(frozen=True)
class Trajectory:
    """Samples and the record of the integration.

    times (T,), states (T, columns, n_state); both empty when chunks were streamed instead.
    finished: False if `interrupted` said stop. stopped: whether the observer ended the run, whose
    last sample is then that instant. refusal: what the flow said where it let no step through, near
    a singular point; failure: why the integration cannot go on; both end the run as well, with the
    last state it reached. reached: the instant that the steps came to, beyond the last cut where it
    was interrupted. longest_step: the bound on the steps. flow_samples: instants
    at which functions of time were asked beforehand. The record of the integration is in
    `checkpoint`.
    """

    times: Array
    states: Array
    checkpoint: Checkpoint
    finished: bool
    stopped: bool = False
    refusal: str = ""
    failure: str = ""
    reached: float = 0.0
    longest_step: float | None = None
    flow_samples: int = 0


def of_unit_length(states: Array) -> Array:
    """The states (..., n_state), with their quaternions set to length 1."""
    states[..., ORIENTATION] = rotation.normalize(states[..., ORIENTATION])
    return states
