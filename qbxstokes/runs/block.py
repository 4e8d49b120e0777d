"""One block of a sweep: start states, integration, quantities and summaries of its trajectories."""

import time as clock
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Self

import numpy as np

from qbxstokes.errors import ConvergenceError, FlowError, SceneError
from qbxstokes.flows.check import check_singularities
from qbxstokes.flows.domain import outside
from qbxstokes.geometry import rotation
from qbxstokes.io.sweep_result import DONE, FAILED, REASON_LENGTH
from qbxstokes.motion.contacts import Contact
from qbxstokes.petsc.trajectory import Checkpoint, Trajectory
from qbxstokes.runs.sharing import Keeper
from qbxstokes.runs.sweep_blocks import Scenes
from qbxstokes.runs.sweep_layout import Swept
from qbxstokes.simulation.assembly import assemble
from qbxstokes.simulation.body import Body
from qbxstokes.simulation.from_case import simulation_of
from qbxstokes.simulation.hydrodynamics import hydrodynamics_of
from qbxstokes.simulation.lanes import LaneRun
from qbxstokes.simulation.simulation import Simulation
from qbxstokes.typing import AnyArray, Array, Indices


@dataclass
class BlockResult:
    """Of trajectories `index` (n,): summaries (n,) by column, quantities (n, T, ...), and more.

    failed, endings: why trajectories have no result, or ended before the last instant. nearest:
    least gap below a body length to an edge of the flow. steps, evaluations: what it cost.
    """

    index: AnyArray
    summary: dict[str, Array]
    quantities: dict[str, Array]
    times: Array
    failed: dict[int, str] = field(default_factory=dict)
    endings: dict[int, str] = field(default_factory=dict)
    nearest: float = np.inf
    steps: int = 0
    evaluations: int = 0

    @classmethod
    def empty(cls, index: AnyArray, times: Array, scenes: Swept) -> Self:
        """Results at times (T,) that are still to be filled in."""
        n, layout = len(index), scenes.layout
        shapes = {name: layout.about(name).shape for name in layout.quantities}
        return cls(
            index,
            {name: np.full(n, np.nan) for name in scenes.columns},
            {name: np.full((n, len(times), *shape), np.nan) for name, shape in shapes.items()},
            times,
        )

    def note(self, number: int, mended: bool) -> dict[str, Any]:
        """What is noted of the block of this number. mended: whether all else in it was there."""
        totals = {"steps": self.steps, "rhs_evaluations": self.evaluations}
        return {
            "block": number,
            "mended": self.index.tolist() if mended else [],
            "failed": {str(self.index[i]): reason for i, reason in self.failed.items()},
            "totals": {**totals, "ended": len(self.endings)},
            "nearest": self.nearest,
        }

    def rows(self, scenes: Swept) -> dict[str, AnyArray]:
        """The rows of the file."""
        layout = scenes.layout
        table = np.zeros(len(self.index), dtype=layout.dtype)
        for name in layout.dtype.names or ():
            if layout.dtype[name].kind == "f":
                table[name] = self.summary.get(name, np.nan)
        for name, column in scenes.coordinates(self.index).items():
            table[name] = column
        table["status"] = DONE
        table["status"][list(self.failed)] = FAILED
        for i, reason in (self.endings | self.failed).items():
            table["reason"][i] = reason.encode("ascii", "replace")[:REASON_LENGTH]
        rows: dict[str, AnyArray] = {"index": self.index, "table": table, **self.quantities}
        if layout.quantities and layout.times is None:
            rows["time"] = np.tile(self.times, (len(table), 1))
        return rows


def lanes_of(scenes: Scenes, number: int, index: Indices, body: Body | None = None) -> Simulation:
    """Some trajectories of a scene as the lanes of a simulation; body: formed before."""
    return simulation_of(scenes.scene(number).loaded, body, scenes.space.values(index), index)


# Some lanes of a simulation, by their numbers, and the rows of the block's result they fill.
Part = tuple[Simulation, Indices, Indices]


def compute_block(
    scenes: Sequence[Simulation],
    result: BlockResult,
    discard: float,
    pushed: bool,
    poke: Callable[[], bool],
    keeper: Keeper,
) -> None:
    """Integrate the lanes of all scenes together, and fill in the first of the results, in order.

    Those that fail are told and left out: a block that cannot be integrated is halved until what
    fails stands alone. pushed: form the resistance in any case. poke: called at every step; where
    it says stop, the state is saved, and the result is not whole.
    """
    parts: list[Part] = []
    first = 0
    for scene in scenes:
        lanes = _sound(scene, first, result)
        parts.append((scene, lanes, first + lanes))
        first += len(scene)
    integration = _Integration(result, discard, pushed, poke, keeper)
    integration.restore()
    integration.compute(parts)


def _sound(scene: Simulation, first: int, result: BlockResult) -> Indices:
    """Those that may start: not in a singularity of the flow, nor beyond its edge."""
    everyone = np.arange(len(scene))
    flow = scene.flow
    shape, axes = scene.body.shape, rotation.axis(scene.quaternion)
    failed = outside(flow.domain, scene.position, axes, shape)
    for i in everyone.tolist() if len(flow.singular_points) else ():
        try:
            check_singularities(flow, scene.position[i], axes[i], shape)
        except FlowError as error:
            failed[i] = str(error)
    result.failed |= {first + i: reason for i, reason in failed.items()}
    return np.setdiff1d(everyone, list(failed)).astype(np.intp)


@dataclass
class _Integration:
    """Fills the results of a block, attempt after attempt: all lanes, or halves of what failed.

    An attempt is known by its first and last row. ended: how attempts of this run and of the one
    that it goes on with ended, "done" or "halved". begun: the attempt that a state is kept of, with
    its run and seconds so far.
    """

    result: BlockResult
    discard: float
    pushed: bool
    poke: Callable[[], bool]
    keeper: Keeper
    ended: dict[str, str] = field(default_factory=dict)
    begun: tuple[str, LaneRun, float] | None = None
    stopped: bool = False

    def compute(self, parts: list[Part]) -> None:
        """Integrate and summarise some lanes, halving on failure."""
        parts = [part for part in parts if len(part[1])]
        if not parts or self.stopped:
            return
        rows = np.concatenate([row for _, _, row in parts])
        name = f"{rows[0]}-{rows[-1]}"
        if self.ended.get(name) == "done":
            return
        if self.ended.get(name) != "halved":
            try:
                self._attempt(name, parts, rows)
                return
            except (ConvergenceError, FlowError, SceneError, ArithmeticError) as error:
                if len(rows) == 1:
                    self.result.failed[int(rows[0])] = " ".join(str(error).split())
                    self.ended[name] = "done"
                    return
            self.ended[name] = "halved"
        for half in _halves(parts, len(rows) // 2):
            self.compute(half)

    def _attempt(self, name: str, parts: list[Part], rows: Indices) -> None:
        """One integration of all the lanes; raises what makes it fail."""
        begin = clock.perf_counter()
        assembled = assemble(
            [scene.at(lanes) for scene, lanes, _ in parts],
            maker=partial(hydrodynamics_of, pushed=self.pushed),
            evaluation="compiled",  # a sweep repays the import, however small its blocks
        )
        run, spent = LaneRun.of(assembled, self.result.times), 0.0
        if self.begun is not None and self.begun[0] == name:
            _, held, spent = self.begun
            run = replace(held, assembled=assembled)
        cut = clock.perf_counter()

        def receive() -> None:
            nonlocal cut
            now = clock.perf_counter()
            ahead, cut = now - cut, now
            self.begun = name, run, spent + now - begin
            assert run.checkpoint is not None
            if self.keeper.late(ahead) and run.checkpoint.next_sample < len(run.times):
                self.save()

        trajectory = run.go(receive, self.poke)
        if not trajectory.finished:
            self.stopped = True
            self.save()
            return
        check_whole(run, trajectory)
        self.result.steps += trajectory.checkpoint.steps * len(rows)
        self.result.evaluations += trajectory.checkpoint.evaluations * len(rows)
        self._summarise(run, rows)
        self.ended[name], self.begun = "done", None
        seconds = spent + clock.perf_counter() - begin
        self.result.summary["wall_time"][rows] = seconds / len(rows)

    def _summarise(self, run: LaneRun, rows: Indices) -> None:
        samples = run.samples(tuple(self.result.quantities))
        summarise(self.result, run, samples, rows, self.discard)

    # -- the state of a block in work ---------------------------------------------------------

    def save(self) -> None:
        """Keep what is finished of the block, and where the present attempt is."""
        begun = result = None
        if self.begun is not None:
            name, run, seconds = self.begun
            assert run.checkpoint is not None
            begun = {
                "name": name,
                "checkpoint": vars(run.checkpoint),
                "states": run.states[: run.checkpoint.next_sample],
                "active": run.active,
                "gone": [vars(contact) for contact in run.ended.values()],
                "nearest": run.nearest,
                "seconds": seconds,
            }
        if "done" in self.ended.values():
            result = vars(self.result).copy()
            for name in ("failed", "endings"):
                result[name] = list(result[name].items())
        self.keeper.save({"ended": self.ended, "begun": begun, "result": result})

    def restore(self) -> None:
        """Take up what an earlier run has kept."""
        kept = self.keeper.load()
        if kept is None:
            return
        self.ended = kept["ended"]
        if (begun := kept["begun"]) is not None:
            times = self.result.times
            states = np.full((len(times), *begun["states"].shape[1:]), np.nan)
            states[: len(begun["states"])] = begun["states"]
            checkpoint = Checkpoint(**begun["checkpoint"])
            ended = {int(contact["lane"]): Contact(**contact) for contact in begun["gone"]}
            run = LaneRun(None, times, states, begun["active"], checkpoint, ended)
            run.nearest = begun["nearest"]
            self.begun = begun["name"], run, begun["seconds"]
        if (result := kept["result"]) is not None:
            for name in ("failed", "endings"):
                result[name] = dict(result[name])
            vars(self.result).update(result)


def check_whole(run: LaneRun, trajectory: Trajectory) -> None:
    """Raise ConvergenceError for a run that came to no end."""
    if trajectory.refusal or trajectory.failure:
        raise ConvergenceError(trajectory.refusal or trajectory.failure)
    if not np.isfinite(run.states[:, run.active]).all():
        raise ConvergenceError("the state is not finite")


def summarise(
    result: BlockResult, run: LaneRun, samples: Mapping[str, Array], rows: Indices, discard: float
) -> None:
    """Fill in quantities, averages and final states of the lanes of a finished run.

    samples (T, n, ...): of the run. Lanes that ended before the others have averages up
    to there, and tell why in `result.endings`.
    """
    assembled, times, table = run.assembled, result.times, result.summary
    result.nearest = min(result.nearest, run.nearest)
    for name, array in result.quantities.items():
        array[rows] = samples[name].swapaxes(0, 1)
    last = {name: samples[name][-1].copy() for name in ("position", "velocity", "angular_velocity")}
    turn, end = np.full((len(rows), 4), np.nan), np.full(len(rows), float(times[-1]))
    turn[run.active] = rotation.normalize(run.states[-1, run.active, 3:7])
    averages = assembled.averages(times, samples, discard)
    for lane, contact in run.ended.items():
        alone, state = assembled.some(np.array([lane])), contact.state[None, None]
        there = alone.observe(np.array([contact.t]), state, tuple(last))
        for name, values in last.items():
            values[lane] = there[name][0, 0]
        turn[lane], end[lane] = rotation.normalize(contact.state[3:7]), contact.t
        count = max(1, int(np.searchsorted(times, contact.t, "right")))
        cut = {name: values[:count, lane : lane + 1] for name, values in samples.items()}
        for name, values in alone.averages(times[:count], cut, discard).items():
            averages[name][lane] = values[0]
        result.endings[int(rows[lane])] = f"{contact.name} at t = {contact.t:.6g}: {contact.reason}"
    for name in ("mean_velocity", "velocity_change"):
        averages |= {f"{name}_{i + 1}": averages[name][:, i] for i in range(3)}
        del averages[name]
    for name, values in averages.items():
        table[name][rows] = values
    for name, values in last.items():
        for i in range(3):
            table[f"final_{name}_{i + 1}"][rows] = values[:, i]
    for i in range(4):
        table[f"final_orientation_{i}"][rows] = turn[:, i]
    table["end"][rows] = end
    assert run.checkpoint is not None
    table["steps"][rows] = run.checkpoint.steps
    table["rhs_evaluations"][rows] = run.checkpoint.evaluations
    expected = assembled.expected_errors(float(times[-1]), run.checkpoint.reachable)
    for lanes, scene, error in zip(assembled.slices(), assembled.parts, expected, strict=True):
        table["error_estimate"][rows[lanes]] = error["total"]
        table["jeffery_period"][rows[lanes]] = np.nan if scene.period is None else scene.period


def _halves(parts: list[Part], count: int) -> tuple[list[Part], list[Part]]:
    """The first lanes, and the rest."""
    first: list[Part] = []
    rest: list[Part] = []
    for scene, lanes, rows in parts:
        take = min(count, len(lanes))
        first.append((scene, lanes[:take], rows[:take]))
        rest.append((scene, lanes[take:], rows[take:]))
        count -= take
    return first, rest
