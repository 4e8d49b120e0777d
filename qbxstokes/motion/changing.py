"""Free motion in a linear flow that changes in time: the law of a body, its flow taken at t."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from qbxstokes.flows.series import LinearInTime
from qbxstokes.motion.kernels import KERNELS

if TYPE_CHECKING:
    from qbxstokes.bie.functional import BodyModel

Array = NDArray[np.float64]


class ChangingMotion:
    """`FreeMotion` of bodies with one law in a flow A(t) x; no grid, the numbers of the table."""

    def __init__(self, model: BodyModel, flow: LinearInTime) -> None:
        self._flow, self._kernels = flow, KERNELS[model.faxen.symmetry]
        self._law = self._kernels.unpack_body(self._kernels.pack_body(model, False))[0]

    def free_motion(self, t: float, x: Array, q: Array) -> tuple[Array, Array]:
        """U and Omega, each (n, 3), at centres x (n, 3) and unit quaternions q (n, 4)."""
        zero = (0.0, 0.0, 0.0)
        flow = 1, zero, tuple(self._flow.at(t).ravel().tolist()), None, None, zero
        if len(x) == 1:  # plain arithmetic is fastest on floats
            found = self._kernels.free(x[0].tolist() + q[0].tolist(), flow, self._law)
            return np.array([found[:3]]), np.array([found[3:]])
        motion = np.stack(self._kernels.free((*x.T, *q.T), flow, self._law), axis=-1)
        return motion[:, :3], motion[:, 3:]
