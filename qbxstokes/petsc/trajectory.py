"""What an integration starts from, hands over on the way and returns.

States are (columns, n_state) as in `motion.layout`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Checkpoint:
    """All that a run needs to go on, and its record so far; only `time` and `state` at the start.

    state (columns, n_state); step: the next one, 0 to choose; next_sample: index into the times.
    method, local_tolerance and reachable are those of the run from its start; see `Trajectory`.
    norm_drift: largest | |q| - 1 | that any cut met before it was removed.
    """

    time: float
    state: Array
    step: float = 0.0
    next_sample: int = 0
    method: str = ""
    local_tolerance: float = 0.0
    reachable: float = 0.0
    steps: int = 0
    rejections: int = 0
    evaluations: int = 0
    jacobians: int = 0
    norm_drift: float = 0.0


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
    last state it reached. The record of the integration is in `checkpoint`.
    """

    times: Array
    states: Array
    checkpoint: Checkpoint
    finished: bool
    stopped: bool = False
    refusal: str = ""
    failure: str = ""

    @property
    def method(self) -> str:
        """TS type, or the formula of a Runge-Kutta type."""
        return self.checkpoint.method

    @property
    def local_tolerance(self) -> float:
        """What the error of a step was held to."""
        return self.checkpoint.local_tolerance

    @property
    def reachable(self) -> float:
        """About the error at the end that rounding alone leaves, however fine the tolerance."""
        return self.checkpoint.reachable

    @property
    def steps(self) -> int:
        """Accepted steps."""
        return self.checkpoint.steps

    @property
    def rejections(self) -> int:
        """Rejected steps."""
        return self.checkpoint.rejections

    @property
    def evaluations(self) -> int:
        """Right-hand sides of the block."""
        return self.checkpoint.evaluations

    @property
    def jacobians(self) -> int:
        """Jacobians of the block."""
        return self.checkpoint.jacobians

    @property
    def norm_drift(self) -> float:
        """Largest | |q| - 1 | before it was removed."""
        return self.checkpoint.norm_drift


@dataclass(frozen=True)
class Step:
    """An accepted step for an observer: instants before and after, states (columns, n_state).

    state: the state at any instant between, as accurate as the steps.
    """

    before: float
    after: float
    start: Array
    end: Array
    state: Callable[[float], Array]
