"""Free motion from the flow's derivatives at the centre: bodies much smaller than its scale."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from qbxstokes.bie.functional import BodyModel
from qbxstokes.flows.base import Flow
from qbxstokes.geometry import rotation
from qbxstokes.motion.lanes import KERNELS, FreeMotion
from qbxstokes.motion.taylor import ROWS, pack_second, quaternion_rate_space
from qbxstokes.typing import Array

# Calls from one look at what is neglected to the next.
_EVERY = 50
# Bodies of a block that the compiled loop serves.
_FEW = 64


class PointMotion:
    """Free motion by the law of a flow of degree 1 or 2: velocity, gradient, second derivatives.

    whole: the free motion in the flow on the whole surface, against which some instants are held.
    `neglected` holds the largest differences so far, of U over |grad u| times the unit of length,
    and of Omega over |grad u|.
    """

    def __init__(self, model: BodyModel, flow: Flow, degree: int, whole: FreeMotion) -> None:
        self._kernels = KERNELS[model.faxen.symmetry]
        numbers = self._kernels.pack_body(model, False)
        self._law, _, _ = self._kernels.unpack_body(numbers)
        self._body = np.array(numbers[: self._kernels.ROWS[degree]], dtype=np.float64)
        self._flow, self._degree, self._whole = flow, degree, whole
        self._calls = 0
        self.neglected = 0.0, 0.0

    def free_motion(self, t: float, x: Array, q: Array) -> tuple[Array, Array]:
        """U and Omega (n, 3) in space at positions x (n, 3), orientations q (n, 4)."""
        u, gradient, second = self._flow.expansion(x, t, self._degree)
        numbers = [*u.T, *gradient.reshape(-1, 9).T, *q.T]
        if second is not None:
            numbers += list(pack_second(second).T)
        if len(x) == 1:  # plain arithmetic is fastest on floats
            numbers = [number.item() for number in numbers]
        zero = (0.0, 0.0, 0.0)
        flow = self._degree, numbers[:3], numbers[3:12], tuple(numbers[16:]), None, zero
        motion = self._kernels.free((*zero, *numbers[12:16]), flow, self._law)
        found = np.stack([np.broadcast_to(row, (len(x),)) for row in motion], axis=-1)
        self._look(t, x[:1], q[:1], found[:1], gradient[:1])
        return found[:, :3], found[:, 3:]

    def _look(self, t: float, x: Array, q: Array, found: Array, gradient: Array) -> None:
        """Hold one body now and then against the flow on its whole surface."""
        self._calls += 1
        if self._calls % _EVERY != 1:
            return
        whole = np.concatenate(self._whole.free_motion(t, x, q), axis=1)
        size = float(np.linalg.norm(gradient)) or 1.0
        off = np.linalg.norm((found - whole).reshape(2, 3), axis=1) / size
        self.neglected = max(self.neglected[0], off[0]), max(self.neglected[1], off[1])

    def rates(self, t: float, y: Array, out: Array) -> None:
        """dy/dt of massless bodies on which nothing else acts, (7, n)."""
        x, q = np.ascontiguousarray(y[:3].T), y[3:7] / np.linalg.norm(y[3:7], axis=0)
        if y.shape[1] < _FEW:
            u, omega = self.free_motion(t, x, q.T)
            rate: Any = *u.T, *quaternion_rate_space(y[3:7], omega.T)
            for row, value in zip(out, rate, strict=True):
                row[:] = value
            return
        flow = np.empty((ROWS[self._degree], y.shape[1]))
        flow[0], flow[1:4] = self._degree, y[:3]
        u, gradient, second = self._flow.expansion(x, t, self._degree)
        flow[4:7], flow[7:16] = u.T, gradient.reshape(-1, 9).T
        if second is not None:
            flow[16:34] = pack_second(second).T
        self._loop(y, out, flow, self._body, None, None, None, None)
        back = rotation.conjugate(q[:, :1].T) / np.linalg.norm(y[3:7, 0])
        omega = 2.0 * rotation.multiply(out[3:7, :1].T, back)[:, 1:]
        found = np.concatenate([out[:3, :1].T, omega], axis=1)
        self._look(t, x[:1], q.T[:1], found, gradient[:1])

    @cached_property
    def _loop(self) -> Any:
        from qbxstokes.motion.compiled import compiled_loops

        return compiled_loops(self._kernels, self._degree, True).by_name["rate_block"]
