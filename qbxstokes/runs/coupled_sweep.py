"""Sweeps over scenes of several bodies or a wall: each scene alone, by one rank."""

from __future__ import annotations

import time as clock
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from qbxstokes.case.load import LoadedCase
from qbxstokes.errors import ConvergenceError
from qbxstokes.quantities import COUPLED_COLUMNS, Quantity
from qbxstokes.runs.coupled import computed
from qbxstokes.runs.plan import CoupledPlan, plan_coupled
from qbxstokes.runs.sweep_blocks import Alone

if TYPE_CHECKING:
    from qbxstokes.runs.block import BlockResult

Array = NDArray[Any]

# What the table of a sweep holds of every body: of motions, and of `task: body`.
_MOVED = ("final_position", "final_axis")
_FOUND = ("free_velocity", "free_angular_velocity", "held_force", "held_torque")


class CoupledScenes(Alone):
    """All scenes of a sweep over several bodies or a wall."""

    def __init__(self, loaded: LoadedCase) -> None:
        super().__init__(loaded)
        assert loaded.case.sweep is not None
        if loaded.case.sweep.measure is not None:
            wrong = "has no meaning with a wall or several bodies"
            raise loaded.error("sweep.measure", wrong, "leave it out")
        plan = plan_coupled(loaded)
        self.skips = plan.skips
        self.bodies = len(loaded.case.members) if loaded.case.bodies is not None else 0
        moving = loaded.case.task == "motion"
        self.columns = dict(COUPLED_COLUMNS)
        for name in _MOVED if moving else _FOUND:
            self.columns |= {column: _about(name, column) for column in _columns(name, self.bodies)}
        if isinstance(plan, CoupledPlan):
            self.nouns, self.samples = ("trajectory", "trajectories"), len(plan.times)
            if loaded.case.sweep.store == "samples":
                self.quantities = plan.quantities
            if not any(column.key[0] == "time" for _, column in self.space.columns):
                self.common_times = plan.times


def _columns(name: str, bodies: int) -> list[str]:
    """Columns of a vector of every body: free_velocity_2_1 of the second; without, of one."""
    numbers = [f"_{body + 1}" for body in range(bodies)] or [""]
    return [f"{name}{number}_{part}" for number in numbers for part in (1, 2, 3)]


def _about(name: str, column: str) -> Quantity:
    return Quantity(column, "", "", f"{name.replace('_', ' ')}: body, component")


def fill(loaded: LoadedCase, result: BlockResult) -> dict[str, Any]:
    """Compute one scene; returns its columns, and fills in the samples of a motion."""
    begin, plan = clock.perf_counter(), plan_coupled(loaded)
    bodies = len(loaded.case.members) if loaded.case.bodies is not None else 0
    if not isinstance(plan, CoupledPlan):
        scene: Any = plan.simulation
        arrays, summary = computed(scene)
        found = {
            "gap": summary["gap"],
            "iterations": summary["iterations"],
            "error_estimate": summary["error_estimates"]["resistance"],
        }
        vectors = {name: arrays[name] for name in _FOUND if name in arrays}
    else:
        result.times = times = plan.times
        motion = plan.simulation.integrate(times)
        told = motion.summary
        if told["events"].get("ended_by"):
            result.endings[0] = f"{motion.ended_by} at t = {motion.time[-1]:.6g}: {motion.message}"
        whole = int(np.searchsorted(times, motion.time[-1], "right"))
        for name, array in result.quantities.items():
            values = motion.stresslet6 if name == "stresslet" else getattr(motion, name)
            array[0, :whole] = values[:whole]
        result.steps, result.evaluations = told["steps"], told["rhs_evaluations"]
        found = {
            "gap": float(motion.gap.min()),
            "end": float(motion.time[-1]),
            "steps": told["steps"],
            "rhs_evaluations": told["rhs_evaluations"],
            "iterations": told["iterations"],
            "error_estimate": told["velocity_errors"]["velocity"],
        }
        vectors = {"final_position": motion.position[-1], "final_axis": motion.axis[-1]}
    for name, values in vectors.items():
        names = _columns(name, bodies)
        found |= dict(zip(names, np.ravel(values).tolist(), strict=True))
    if not np.isfinite(found["error_estimate"]):
        raise ConvergenceError("the result is not finite")
    return {**found, "wall_time": clock.perf_counter() - begin}
