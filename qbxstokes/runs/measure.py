"""One trajectory or body alone: computed once to warm up, then measured; its error and its cost.

What is measured is what a single motion does: its equations and its integrator, without what other
trajectories could share and without a cache. Without repeats (`task: body`) the first time counts.
A rank measures a body's set-up once, for the first trajectory that has this body.
"""

import json
import time
from collections.abc import Callable
from functools import partial
from statistics import median
from typing import Any

import numpy as np

from qbxstokes.case.document import plain
from qbxstokes.case.load import LoadedCase
from qbxstokes.errors import ConvergenceError, QbxStokesError
from qbxstokes.petsc.session import SOLVER_OPTIONS, own_options
from qbxstokes.quantities import BODY, MOTION
from qbxstokes.runs.block import BlockResult, check_whole, summarise
from qbxstokes.runs.body import computed
from qbxstokes.runs.plan import MotionPlan, make_plan, plan_body, plan_coupled
from qbxstokes.runs.sweep_layout import DRIVEN, columns_of_bodies
from qbxstokes.simulation.assembly import assemble
from qbxstokes.simulation.body import Body
from qbxstokes.simulation.compare import Comparison, compare_samples
from qbxstokes.simulation.from_case import body_of, simulation_of, start_of
from qbxstokes.simulation.hydrodynamics import Hydrodynamic, hydrodynamics_of
from qbxstokes.simulation.lanes import LaneRun
from qbxstokes.simulation.law import Law
from qbxstokes.simulation.simulation import Simulation

# Columns of a body that its report holds.
REPORTED = (
    *("error_estimate", "iterations", "true_residual"),
    *("n_theta", "n_phi", "expansion_order"),
)


class Stopped(Exception):
    """A signal has asked to stop: nothing of this trajectory is kept."""


def timed(spans: list[float], action: Callable[[], Any]) -> Any:
    """What the action returns; its time in seconds joins the others.

    Of several turns the median counts, without the first.
    """
    begin = time.perf_counter()
    result = action()
    spans.append(time.perf_counter() - begin)
    return result


class Measurer:
    """Measures the trajectories or bodies of a sweep.

    scenes: `Scenes` or `BodyScenes`. poke: called between the steps and the turns, says whether to
    stop.
    """

    def __init__(self, scenes: Any, poke: Callable[[], bool]) -> None:
        self._scenes, self._poke = scenes, poke
        self._known: dict[str, tuple[Body, float]] = {}  # with the time that their set-up takes

    def compute(self, number: int, only: list[int] | None) -> BlockResult:
        """The results of the one trajectory or body of a block, or why it has none."""
        scenes = self._scenes
        times = np.full(scenes.samples, np.nan)
        result = BlockResult.empty(scenes.block(number).index, times, scenes)
        try:
            points = np.unravel_index(number, scenes.space.shape)
            loaded = scenes.loaded.at([int(point) for point in points])
            swept = [str(c.key[1]) for _, c in scenes.space.columns if c.key[0] == "petsc"]
            with own_options({name: loaded.case.petsc[name] for name in swept}):
                if loaded.case.coupled:
                    found = _of_several(loaded, result)
                elif loaded.case.task == "body":
                    found = self._body(loaded)
                else:
                    found = self._motion(loaded, result)
        except Stopped:
            return result
        except (QbxStokesError, ArithmeticError) as error:
            result.failed[0] = " ".join(str(error).split())
            return result
        for name, value in found.items():
            result.summary[name][:] = value
        limit = loaded.case.compare.tolerance
        if limit is not None and found["error"] > limit:
            result.failed[0] = f"error {found['error']:.1e} exceeds compare.tolerance {limit:g}"
        return result

    def _body(self, loaded: LoadedCase) -> dict[str, float]:
        """The columns of a body."""
        plan_body(loaded)  # refuses what cannot be computed
        spans: list[float] = []
        in_flow = loaded.case.flow is not None
        for _ in range(self._scenes.turns):
            law = timed(spans, partial(Law, start_of(loaded), in_flow))
            if self._poke():
                raise Stopped
        arrays, formed = law.arrays, law.formed
        resistance = vars(formed.model.resistance)
        found = {f"resistance_{name}": value for name, value in resistance.items()}
        for name, values in arrays.items():
            if len(BODY[name].shape) < 2:
                columns = [column.name for column in BODY[name].columns()]
                found |= dict(zip(columns, np.ravel(values).tolist(), strict=True))
        report = formed.report()
        found |= {name: float(report[name]) for name in REPORTED}
        return found | {
            "error": _error(loaded, lambda: law.errors(arrays)),
            "setup_time": median(spans[1:] or spans),
            "nodes": float(report["n_theta"] * report["n_phi"]),
        }

    def _motion(self, loaded: LoadedCase, result: BlockResult) -> dict[str, float]:
        """Integrate, fill in samples and averages; returns the measured columns."""
        plan, turns = make_plan(loaded), self._scenes.turns
        setups, motions = list[float](), list[float]()
        result.times = times = plan.times
        # What bodies have in common of which one can stand for the other.
        options = {k: v for k, v in loaded.case.petsc.items() if k.startswith(SOLVER_OPTIONS)}
        alike = [loaded.case.body.outline.spec(), plain(loaded.case.hydrodynamics), options]
        alike += [loaded.flow.degree, plan.simulation.completion()]
        key = json.dumps(alike, sort_keys=True)
        known, setup = self._known.get(key, (None, None))

        def form(part: Simulation) -> Hydrodynamic:
            return timed(setups, partial(hydrodynamics_of, part))

        for _ in range(turns):
            body = known or body_of(loaded)
            assembled = assemble([simulation_of(loaded, body)], maker=form)
            run = LaneRun.of(assembled, times)
            trajectory = timed(motions, partial(run.go, interrupted=self._poke))
            if not trajectory.finished:
                raise Stopped
        check_whole(run, trajectory)
        setup = setup or median(setups[1:] or setups)
        if plan.simulation.kind == "table":
            self._known[key] = body, setup
        end, row = trajectory.checkpoint, np.zeros(1, dtype=np.intp)
        result.steps, result.evaluations = turns * end.steps, turns * end.evaluations
        samples = run.samples(tuple(MOTION))
        summarise(result, run, samples, row, self._scenes.loaded.case.sweep.discard)
        whole = int(np.searchsorted(times, result.summary["end"][0], "right"))
        alone = {name: array[:whole, 0] for name, array in samples.items()}
        return {
            "wall_time": median(motions[1:] or motions),
            "setup_time": setup,
            "rejected": float(end.rejections),
            "iterations": float(assembled.hydrodynamics[0].report()["iterations"]),
            "error": _error(loaded, lambda: compare_samples(assembled, times[:whole], alone)),
        }


def _error(loaded: LoadedCase, compared: Callable[[], Comparison]) -> float:
    """The largest error; NaN where nothing is known to compare with, or none is wanted.

    That of the resistance alone says nothing of a motion.
    """
    if loaded.case.compare.reference == "none":
        return np.nan
    comparison = compared()
    known = set(comparison.errors) - {"resistance"}
    return np.nan if comparison.largest is None or not known else comparison.largest


def _of_several(loaded: LoadedCase, result: BlockResult) -> dict[str, Any]:
    """Compute bodies that share a fluid; returns their columns, fills in samples of a motion."""
    begin, plan = time.perf_counter(), plan_coupled(loaded)
    bodies = len(loaded.case.members) if loaded.case.bodies is not None else 0
    if not isinstance(plan, MotionPlan):
        scene: Any = plan.simulation
        arrays, summary = computed(scene)
        found = {
            "gap": summary["gap"],
            "iterations": summary["iterations"],
            "error_estimate": summary["error_estimates"]["resistance"],
        }
        vectors = {name: arrays[name] for name in DRIVEN if name in arrays}
    else:
        result.times = times = plan.times
        motion: Any = plan.simulation.integrate(times)
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
            "error_estimate": told["expected_error"]["total"],
        }
        vectors = {"final_position": motion.position[-1], "final_axis": motion.axis[-1]}
    for name, values in vectors.items():
        names = columns_of_bodies(name, bodies)
        found |= dict(zip(names, np.ravel(values).tolist(), strict=True))
    if not np.isfinite(found["error_estimate"]):
        raise ConvergenceError("the result is not finite")
    return {**found, "wall_time": time.perf_counter() - begin}
