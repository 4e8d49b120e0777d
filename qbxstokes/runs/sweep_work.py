"""The work of a sweep on every rank: bodies, and blocks handed out as ranks become free.

Every rank runs the same loop: take the number of the next block, compute it, keep its rows. What a
block holds does not depend on who computes it, and neither do its numbers.
"""

import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from qbxstokes.errors import QbxStokesError
from qbxstokes.io.cache import Cache, open_cache
from qbxstokes.io.store import Work
from qbxstokes.io.sweep_result import DONE, FAILED, REASON_LENGTH, Layout
from qbxstokes.runs import block
from qbxstokes.runs.gathering import Gathering, Keeper, notes
from qbxstokes.runs.measure import Measurer
from qbxstokes.runs.parallel import HandOut, Interruption, interrupted
from qbxstokes.runs.progress import Clock, Progress
from qbxstokes.runs.sweep_blocks import Scenes
from qbxstokes.runs.sweep_layout import Swept, coordinates_of
from qbxstokes.simulation.body import Body
from qbxstokes.simulation.from_case import body_of, pointed
from qbxstokes.simulation.hydrodynamics import Workshop, hydrodynamics_of
from qbxstokes.simulation.simulation import Simulation
from qbxstokes.typing import AnyArray

BLOCKS = "blocks"  # the parts of a sweep
_PATIENCE = 1.0  # seconds between what is said of the bodies


@dataclass
class Todo:
    """What a run has to do: blocks by number, those of them that only mend failures.

    done: trajectories that are there already. failed: those that failed and why, by block. totals:
    steps and right-hand sides so far, and how many ended early. nearest: least gap to an edge.
    merges: whether the result is to hold all rows, rather than show the parts.
    """

    blocks: list[int]
    mend: dict[int, list[int]] = field(default_factory=dict)
    done: int = 0
    failed: dict[int, dict[int, str]] = field(default_factory=dict)
    totals: dict[str, float] = field(default_factory=dict)
    merges: bool = True
    nearest: float = np.inf

    @property
    def numbers(self) -> list[int]:
        """All blocks that something is to be done in."""
        return sorted({*self.blocks, *self.mend})

    def learn(self, note: Mapping[str, Any]) -> None:
        """Take up what the note of a block says."""
        number = note["block"]
        known = self.failed.setdefault(number, {}) if note["mended"] else {}
        for index in note["mended"]:
            known.pop(index, None)
        self.failed[number] = {**known, **{int(i): why for i, why in note["failed"].items()}}
        for name, value in note["totals"].items():
            self.totals[name] = self.totals.get(name, 0.0) + value
        self.nearest = min(self.nearest, note["nearest"])


def todo_of(scenes: Swept, work: Work, base: Todo | None) -> Todo:
    """What is left to do of a sweep, by the parts of earlier runs.

    base: what a finished result leaves to do, where failures of it are mended.
    """
    todo = base or Todo(list(range(scenes.blocks)))
    if not work.resumed:
        return todo
    for note in notes(work, BLOCKS):
        todo.learn(note)
    todo.blocks = [number for number in todo.blocks if number not in todo.failed]
    todo.mend = {number: sorted(failed) for number, failed in todo.failed.items() if failed}
    sizes = scenes.block_sizes()
    todo.done = sum(int(sizes[n]) - len(failed) for n, failed in todo.failed.items())
    return todo


@dataclass
class Models:
    """The bodies of the sweep: what their operators give, and which could not be formed."""

    cache: Cache
    errors: dict[int, QbxStokesError]


def form_models(
    comm: Any, scenes: Swept, todo: Todo, counters: HandOut, no_cache: bool, speak: bool
) -> Models:
    """Form the bodies that this run needs, each by whichever rank is free, known to all.

    speak: whether to say on standard error how far it is, where it takes more than a moment. A
    body that cannot be formed is noted with the error, which its trajectories then report.
    Trajectories that are computed alone form their own.
    """
    from qbxstokes.petsc import session

    if not isinstance(scenes, Scenes) or scenes.alone:
        return Models(Cache(None), {})
    bodies, representatives = scenes.bodies
    needed = sorted({int(bodies[s]) for number in todo.numbers for s in scenes.scenes_of(number)})
    # Options of the solver want to be seen at work.
    no_cache = no_cache or bool(session.solver_options(session.start()))
    named = scenes.loaded.case.hydrodynamics.cache
    models = Models(Cache(open_cache(named, no_cache).folder, shared=True), {})
    workshop = Workshop(cache=models.cache)
    told = time.monotonic()
    while (place := counters.next(HandOut.MODELS)) < len(needed):
        number = needed[place]
        if speak and time.monotonic() > told + _PATIENCE:
            told = time.monotonic()
            text = f"qbxstokes: forming bodies, {place + 1} of {len(needed)}"
            print(text, file=sys.stderr, flush=True)
        try:
            scene = scenes.scene(representatives[number])
            with pointed(scene.loaded):
                hydrodynamics_of(scene.plan.simulation, workshop, pushed=scenes.pushed)
        except QbxStokesError as error:
            models.errors[number] = error
    counters.wait()
    cache = models.cache
    for entries, errors, problems in comm.allgather((cache.entries, models.errors, cache.problems)):
        cache.entries |= entries
        models.errors.update(errors)
        if comm.rank == 0:
            for problem in problems:
                print(f"qbxstokes: cache: {problem}", file=sys.stderr, flush=True)
    return models


@dataclass
class Team:
    """What a rank shares with the others while it computes."""

    comm: Any
    counters: HandOut
    progress: Progress | None
    interruption: Interruption
    todo: Todo

    def poke(self) -> bool:
        """Between steps: serve MPI, tell the progress; whether a signal asks to stop."""
        if self.progress is None or not self.progress.due:
            self.counters.poke()
        else:
            done = self.todo.done + self.counters.read(HandOut.DONE)
            share = 1e-6 * self.counters.read(HandOut.WORK)
            self.progress.update(done, self.counters.read(HandOut.FAILED), share)
        return self.interruption.asked()


def work_on_blocks(
    team: Team, scenes: Swept, layout: Layout, models: Models, gathering: Gathering, clock: Clock
) -> None:
    """Compute blocks until none is left; raises Interrupted after what there is was made safe."""
    order, cost = _order(scenes, team.todo, gathering.work)
    counters, total = team.counters, float(cost.sum()) or 1.0
    computer: _Together | _Alone = _Alone(scenes, layout, team)
    if isinstance(scenes, Scenes) and not scenes.alone:
        computer = _Together(scenes, layout, models, team, gathering)
    while (place := counters.next(HandOut.BLOCKS)) < len(order):
        number = order[place]
        with clock.part("blocks"):
            mended = team.todo.mend.get(number)
            computed = computer.compute(number, mended)
            rows, note = computed.rows(scenes, layout), computed.note(number, mended)
        if team.interruption.asked():
            gathering.save()
            raise interrupted(gathering.work.folder, team.interruption.signal)
        with clock.part("output"):
            gathering.add(rows, note)
        gathering.work.drop_state(str(number))
        counters.add(HandOut.FAILED, len(note["failed"]))
        counters.add(HandOut.DONE, len(rows["table"]) - len(note["failed"]))
        counters.add(HandOut.WORK, int(1e6 * cost[place] / total))
        team.poke()


def _order(scenes: Swept, todo: Todo, work: Work) -> tuple[list[int], AnyArray]:
    """Blocks in the order of handing out, and what each costs.

    Those first that an earlier run was at work on, then the costliest, so that ranks end together.
    """
    from qbxstokes.runs.cost import block_weights

    numbers = todo.numbers
    if not numbers:
        return [], np.empty(0)
    cost = block_weights(scenes)[numbers]
    begun = {path.stem.removeprefix("state-") for path in work.parts("state")}
    fresh = np.array([str(number) not in begun for number in numbers])
    order = np.lexsort((-cost, fresh))
    return [numbers[i] for i in order], cost[order]


@dataclass
class _Computed:
    """What was computed of the trajectories `index` of a block, of which the last were lost."""

    index: AnyArray
    result: block.BlockResult
    lost: dict[int, str]

    def __post_init__(self) -> None:
        self.well = len(self.index) - len(self.lost)
        for i, reason in enumerate(self.lost.values()):
            self.result.failed[self.well + i] = reason

    def note(self, number: int, only: list[int] | None) -> dict[str, Any]:
        """What is noted of the block. only: trajectories that were to be mended, None for all."""
        result = self.result
        return {
            "block": number,
            "mended": [] if only is None else self.index.tolist(),
            "failed": {str(self.index[i]): reason for i, reason in result.failed.items()},
            "totals": {
                "steps": result.steps,
                "rhs_evaluations": result.evaluations,
                "ended": len(result.endings),
            },
            "nearest": result.nearest,
        }

    def rows(self, scenes: Swept, layout: Layout) -> dict[str, AnyArray]:
        """The rows of the file."""
        n, well, result = len(self.index), self.well, self.result
        table = np.zeros(n, dtype=layout.dtype)
        for name in layout.dtype.names or ():
            if layout.dtype[name].kind == "f":
                table[name] = np.nan
                table[name][:well] = result.summary.get(name, np.nan)
        for name, column in coordinates_of(scenes, self.index).items():
            table[name] = column
        table["status"] = DONE
        table["status"][list(result.failed)] = FAILED
        for i, reason in (result.endings | result.failed).items():
            table["reason"][i] = reason.encode("ascii", "replace")[:REASON_LENGTH]
        rows: dict[str, AnyArray] = {"index": self.index, "table": table}
        for name in layout.quantities:
            rows[name] = result.quantities[name]
            if well < n:
                lost = np.full((n - well, *rows[name].shape[1:]), np.nan)
                rows[name] = np.concatenate([rows[name], lost])
        if layout.quantities and layout.times is None:
            rows["time"] = np.tile(result.times, (n, 1))
        return rows


class _Alone:
    """Computes trajectories or bodies one by one, each for itself."""

    def __init__(self, scenes: Swept, layout: Layout, team: Team) -> None:
        self._scenes, self._layout = scenes, layout
        self._measurer = Measurer(scenes, team.poke)

    def compute(self, number: int, only: list[int] | None) -> _Computed:
        """The one trajectory of a block."""
        scenes, layout = self._scenes, self._layout
        index = scenes.block(number).index
        times = np.full(layout.samples, np.nan)
        result = block.empty_result(1, scenes.columns, layout.quantities, times, layout.about)
        self._measurer.measure(int(index[0]), result)
        return _Computed(index, result, {})


class _Together:
    """Computes blocks, keeping the bodies at hand from one to the next."""

    def __init__(
        self, scenes: Scenes, layout: Layout, models: Models, team: Team, gathering: Gathering
    ) -> None:
        self._scenes, self._layout, self._models, self._team = scenes, layout, models, team
        self._gathering = gathering
        self._workshop = Workshop(cache=models.cache)
        self._body, _ = scenes.bodies
        self._bodies: dict[int, Body] = {}

    def compute(self, number: int, only: list[int] | None) -> _Computed:
        """A block, or the trajectories in it that are to be mended."""
        scenes, layout = self._scenes, self._layout
        sweep = scenes.loaded.case.sweep
        assert sweep is not None
        simulations: list[Simulation] = []
        sound: list[AnyArray] = []
        lost: dict[int, str] = {}
        times = np.full(layout.samples, np.nan)
        for scene, members in scenes.block(number).pieces:
            chosen = members if only is None else members[np.isin(members, only)]
            if not len(chosen):
                continue
            try:
                simulations.append(self._simulation(scene, chosen))
                sound.append(chosen)
                times = scenes.scene(scene).plan.times
            except QbxStokesError as error:
                lost |= dict.fromkeys(chosen.tolist(), " ".join(str(error).split()))
        index = np.concatenate([*sound, np.array(list(lost), dtype=np.int64)]).astype(np.int64)
        keeper = Keeper(self._gathering, str(number), [] if only is None else index.tolist())
        result = block.compute_block(
            simulations,
            times,
            layout.quantities,
            sweep.discard,
            self._workshop,
            scenes.pushed,
            self._team.poke,
            keeper,
        )
        return _Computed(index, result, lost)

    def _simulation(self, number: int, index: AnyArray) -> Simulation:
        """Some trajectories of a scene as the lanes of a simulation."""
        body = int(self._body[number])
        if body in self._models.errors:
            raise self._models.errors[body]
        if body not in self._bodies:
            self._bodies[body] = body_of(self._scenes.scene(number).loaded)
        return block.lanes_of(self._scenes, number, index, self._bodies[body])
