"""The equations of bodies whose centres stay at rest: those of their rotation.

In a flow that is odd about a body's centre, as a linear flow is about every stagnation point, a
body that nothing pushes stays where it is. Of its state only q changes for St = 0, and q and W for
St > 0: 4 numbers of 7, and 7 of 13. They change as in the whole equations, to the last bit.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from qbxstokes.motion.equations import RigidBodyEquations
from qbxstokes.motion.layout import ORIENTATION, POSITION, SPIN, Layout
from qbxstokes.motion.loops import BlockConstants
from qbxstokes.typing import Array

Function = Callable[[float, Array, Array], None]

_TURNING = np.r_[ORIENTATION, SPIN]


class CentredEquations:
    """The part of the equations that turns the bodies, for an integrator.

    whole: equations that are `compiled` and whose bodies are `at_rest` in `states` (n_lanes,
    n_state). The methods are those of `RigidBodyEquations`, of states (n_lanes, 4 or 7).
    """

    def __init__(self, whole: RigidBodyEquations, states: Array) -> None:
        self._whole, self._states = whole, np.array(states)
        self._active = _TURNING[whole.n_state > _TURNING]
        self._still = np.ascontiguousarray(states[:, POSITION].T)
        self.n_lanes, self.n_state = whole.n_lanes, len(self._active)
        self.layout = Layout(self.n_state, self.n_lanes)

    def integrated(self, states: Array) -> Array:
        """The part of states (n_lanes, n_state of the whole) that changes."""
        return states[:, self._active]

    def completed(self, part: Array) -> Array:
        """The whole states to which a part (..., n_lanes, n_state) belongs, as a copy."""
        states = np.empty((*part.shape[:-1], self._whole.n_state))
        states[:] = self._states
        states[..., self._active] = part
        return states

    def rate_function(self, evaluations: float = 0.0) -> Function:
        """The function (t, y, out) that writes dy/dt for y (n_state, n_lanes), read-only."""
        return self._whole.rate_function(evaluations, self._still)

    def jacobian_function(self, evaluations: float = 0.0) -> Function:
        """The function (t, y, out) that writes the blocks (n_lanes, n_state, n_state)."""
        whole, active = self._whole.jacobian_function(evaluations), self._active
        blocks = np.empty((self.n_lanes, self._whole.n_state, self._whole.n_state))

        def function(t: float, y: Array, out: Array) -> None:
            states = self.completed(y.T).T
            states.flags.writeable = False  # the loop is compiled for such arrays
            whole(t, states, blocks)
            out[:] = blocks[:, active[:, None], active]

        return function

    def block_constants(self, evaluations: float = 0.0) -> BlockConstants | None:
        """All that the compiled loop takes, where nothing of it depends on time."""
        block = self._whole.block_constants(evaluations)
        return None if block is None else replace(block, still=self._still)
