"""Events by TSSetEventHandler, to compare with those that are found between the steps (stepper)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qbxstokes.motion.equations import RigidBodyEquations
from qbxstokes.petsc.stepper import Run
from qbxstokes.petsc.trajectory import Checkpoint

Array = NDArray[np.float64]


@dataclass(frozen=True)
class HandledRun:
    """Instants of the events, the state (1, n_state) at the end, right-hand sides and steps."""

    instants: list[float]
    state: Array
    evaluations: int
    steps: int


def integrate_with_handler(
    equations: RigidBodyEquations,
    start: Array,
    end: float,
    tolerance: float,
    function: Callable[[float, list[float]], float],
    method: str,
    event_tolerance: float | None = None,
) -> HandledRun:
    """The motion of one body from t = 0 by TSSolve, with the sign changes of function(t, row).

    start (1, n_state). event_tolerance: of the function's values; None leaves PETSc's own.
    """
    run = Run(equations, Checkpoint(0.0, start), np.array([end]), tolerance, method, "", None)
    ts, instants = run.ts, []

    def value(_: Any, t: float, state: Any, values: Array) -> None:
        values[0] = function(t, state.getArray(readonly=1).tolist())

    def note(ts: Any, events: Any, t: float, *_: Any) -> None:
        instants.append(t)

    ts.setEventHandler([0], [False], value, note)
    if event_tolerance is not None:
        ts.setEventTolerances(vtol=[event_tolerance])
    try:
        ts.solve(ts.getSolution())
        state = ts.getSolution().getArray().reshape(1, -1).copy()
        return HandledRun(instants, state, run.counter.evaluations, ts.getStepNumber())
    finally:
        run.release()
