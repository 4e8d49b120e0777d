"""Motion of and flow around several bodies: what a `Suspension` does beyond one linear problem."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qbxstokes.bie.coupling import closest
from qbxstokes.errors import ContactError, ConvergenceError, SceneError
from qbxstokes.flows import Flow
from qbxstokes.geometry import rotation

if TYPE_CHECKING:
    from qbxstokes.simulation.solved import Solution
    from qbxstokes.simulation.suspension import Suspension

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SuspensionMotion:
    """Samples of a motion: time (T,), and by body (T, N, ...).

    position, axis (T, N, 3), quaternion (T, N, 4), velocity, angular_velocity (T, N, 3), gap (T,):
    the least of the scene. ended_by: None, `body_contact`, `wall_contact` or `clearance`, with what
    it says in message; the samples then stop before the last time asked for.
    evaluations, iterations: of the right side and of GMRES.
    """

    time: Array
    position: Array
    quaternion: Array
    velocity: Array
    angular_velocity: Array
    gap: Array
    ended_by: str | None
    message: str
    evaluations: int
    iterations: int

    @property
    def axis(self) -> Array:
        """Symmetry axes D3 in space (T, N, 3)."""
        return rotation.axis(self.quaternion)


class _RightSide:
    """dy/dt of the bodies' centres and quaternions; starts each solve from the one before."""

    def __init__(self, scene: Suspension, flow: Flow | None, loads: dict[str, Any]) -> None:
        self.scene, self.flow, self.loads = scene, flow, loads
        self.evaluations = self.iterations = 0
        self._guess: tuple[list[int], Array] | None = None

    def unpack(self, y: Array) -> tuple[Array, Array]:
        n = len(self.scene)
        return y[: 3 * n].reshape(n, 3), y[3 * n :].reshape(n, 4)

    def solve(self, t: float, y: Array) -> Solution:
        x, q = self.unpack(y)
        nodes = self.scene.grids(self.scene.placed(x, q), self.flow, t)
        guess = None
        if self._guess is not None and self._guess[0] == list(nodes):
            guess = self._guess[1]
        found = self.scene.free(self.flow, x, q, t=t, guess=guess, nodes=nodes, **self.loads)
        self._guess = (list(nodes), found.unknowns)
        self.evaluations += 1
        self.iterations += found.iterations
        return found

    def __call__(self, t: float, y: Array) -> Array:
        found = self.solve(t, y)
        _, q = self.unpack(y)
        spin = np.concatenate([np.zeros((len(q), 1)), found.angular_velocity], axis=1)
        turn = 0.5 * rotation.multiply(spin, q)
        # Draws the norm back to 1, along which nothing depends.
        turn += (1.0 - np.sum(q * q, axis=1))[:, None] * q
        return np.concatenate([found.velocity.ravel(), turn.ravel()])


def integrate(
    scene: Suspension,
    flow: Flow | None,
    times: ArrayLike,
    position: ArrayLike,
    orientation: ArrayLike | None,
    force: ArrayLike | None,
    torque: ArrayLike | None,
    tolerance: float,
    least_gap: float,
) -> SuspensionMotion:
    """See `Suspension.integrate`. Dormand and Prince's method of order 8 (Hairer et al. 1993)."""
    from scipy.integrate import DOP853

    sampled = np.asarray(times, dtype=np.float64)
    if sampled.ndim != 1 or len(sampled) < 2 or np.any(np.diff(sampled) <= 0.0):
        raise SceneError("times", "are not increasing", "at least two increasing times")
    places = scene.placed(position, orientation)
    x0 = np.stack([place.position for place in places])
    turn = np.asarray((0.0, 0.0, 1.0) if orientation is None else orientation, dtype=np.float64)
    q0 = rotation.normalize(turn) if turn.shape[-1] == 4 else rotation.from_axis(turn)
    q0 = np.broadcast_to(q0, (len(scene), 4))
    right = _RightSide(scene, flow, {"force": force, "torque": torque})
    start = np.concatenate([x0.ravel(), q0.ravel()])
    rows: list[tuple[float, Array, Array, Array, Array, float]] = []
    ended, message = None, ""

    def sample(t: float, y: Array) -> None:
        x, q = right.unpack(y)
        q = rotation.normalize(q)
        found = right.solve(t, np.concatenate([x.ravel(), q.ravel()]))
        gap = closest(scene.placed(x, q), scene.plane)[0]
        rows.append((t, x.copy(), q, found.velocity, found.angular_velocity, gap))

    sample(sampled[0], start)
    solver = DOP853(right, sampled[0], start, sampled[-1], rtol=tolerance, atol=tolerance)
    pending = list(sampled[1:])
    try:
        while pending:
            told = solver.step()
            if solver.status == "failed":
                raise ConvergenceError(f"the integration stopped at t = {solver.t:g}: {told}")
            x, q = right.unpack(solver.y)
            gap, (b, c), _ = closest(scene.placed(x, q), scene.plane)
            dense = solver.dense_output()
            end = solver.t
            if gap < least_gap:
                end = _crossing(scene, right, dense, solver.t_old, solver.t, least_gap)
                ended = "clearance"
                who = f"body {b + 1} and the wall" if c < 0 else f"bodies {c + 1} and {b + 1}"
                message = f"{who}: the gap fell to {least_gap:g} at t = {end:.9g}"
            while pending and pending[0] <= end:
                at = pending.pop(0)
                sample(at, dense(at))
            if ended:
                sample(end, dense(end))
                break
    except ContactError as error:
        ended = "wall_contact" if "wall" in error.who else "body_contact"
        message = f"{error} (after t = {solver.t:.9g})"
    t, x, q, v, omega, gaps = (np.array(column) for column in zip(*rows, strict=True))
    work = right.evaluations, right.iterations
    return SuspensionMotion(t, x, q, v, omega, gaps, ended, message, *work)


def _crossing(
    scene: Suspension, right: _RightSide, dense: Any, begin: float, end: float, bound: float
) -> float:
    """Time in a step at which the least gap falls below the bound, by bisection."""
    for _ in range(60):
        middle = 0.5 * (begin + end)
        x, q = right.unpack(dense(middle))
        if closest(scene.placed(x, rotation.normalize(q)), scene.plane)[0] < bound:
            end = middle
        else:
            begin = middle
    return end
