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
from qbxstokes.runs import block
from qbxstokes.runs.measure import Measurer
from qbxstokes.runs.parallel import HandOut
from qbxstokes.runs.progress import Clock
from qbxstokes.runs.sharing import Crew, Keeper, notes
from qbxstokes.runs.sweep_blocks import Scenes
from qbxstokes.runs.sweep_layout import Swept
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
    """

    blocks: list[int]
    mend: dict[int, list[int]] = field(default_factory=dict)
    done: int = 0
    failed: dict[int, dict[int, str]] = field(default_factory=dict)
    totals: dict[str, float] = field(default_factory=dict)
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


def todo_of(scenes: Swept, work: Work) -> Todo:
    """What is left to do of a sweep, by the parts of earlier runs."""
    todo = Todo(list(range(scenes.blocks)))
    for note in notes(work, BLOCKS):
        todo.learn(note)
    todo.blocks = [number for number in todo.blocks if number not in todo.failed]
    todo.mend = {number: sorted(failed) for number, failed in todo.failed.items() if failed}
    sizes = scenes.block_sizes()
    todo.done = sum(int(sizes[n]) - len(failed) for n, failed in todo.failed.items())
    return todo


def form_models(
    comm: Any, scenes: Swept, todo: Todo, no_cache: bool, speak: bool
) -> tuple[Cache, dict[int, QbxStokesError]]:
    """Form the bodies that this run needs, each by whichever rank is free, known to all.

    Returns what their operators give, and which could not be formed, with the error that their
    trajectories then report. speak: whether to say on standard error how far it is, where it takes
    more than a moment. Trajectories that are computed alone form their own.
    """
    from qbxstokes.petsc import session

    errors: dict[int, QbxStokesError] = {}
    if not isinstance(scenes, Scenes) or scenes.alone:
        return Cache(None), errors
    bodies, representatives = scenes.bodies
    needed = sorted({int(bodies[s]) for number in todo.numbers for s in scenes.scenes_of(number)})
    # Options of the solver want to be seen at work.
    no_cache = no_cache or bool(session.solver_options(session.start()))
    named = scenes.loaded.case.hydrodynamics.cache
    cache = Cache(open_cache(named, no_cache).folder, shared=True)
    counters, told = HandOut(comm), time.monotonic()
    while (place := counters.next(HandOut.NUMBERS)) < len(needed):
        number = needed[place]
        if speak and time.monotonic() > told + _PATIENCE:
            told = time.monotonic()
            text = f"qbxstokes: forming bodies, {place + 1} of {len(needed)}"
            print(text, file=sys.stderr, flush=True)
        try:
            scene = scenes.scene(representatives[number])
            with pointed(scene.loaded):
                simulation = scene.plan.simulation
                simulation.body.workshop = Workshop(cache=cache)
                hydrodynamics_of(simulation, pushed=scenes.pushed)
        except QbxStokesError as error:
            errors[number] = error
    counters.wait()
    counters.close()
    for entries, more, problems in comm.allgather((cache.entries, errors, cache.problems)):
        cache.entries |= entries
        errors.update(more)
        if comm.rank == 0:
            for problem in problems:
                print(f"qbxstokes: cache: {problem}", file=sys.stderr, flush=True)
    return cache, errors


def work_on_blocks(
    crew: Crew, scenes: Swept, todo: Todo, models: tuple[Cache, Any], clock: Clock
) -> None:
    """Compute blocks until none is left; raises Interrupted after what there is was made safe."""
    order, cost = _order(scenes, todo, crew.gathering.work)
    counters, total = crew.counters, float(cost.sum()) or 1.0
    computer: _Together | Measurer = Measurer(scenes, crew.poke)
    if isinstance(scenes, Scenes) and not scenes.alone:
        computer = _Together(scenes, *models, crew)
    for place in crew.numbers(len(order)):
        number = order[place]
        with clock.part("blocks"):
            result = computer.compute(number, todo.mend.get(number))
            rows, note = result.rows(scenes), result.note(number, number in todo.mend)
        crew.stop_if_asked()
        with clock.part("output"):
            crew.gathering.add(rows, note)
        crew.gathering.work.drop_state(str(number))
        counters.add(HandOut.FAILED, len(result.failed))
        counters.add(HandOut.DONE, len(result.index) - len(result.failed))
        counters.add(HandOut.SHARE, int(1e6 * cost[place] / total))
        crew.poke()


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


class _Together:
    """Computes blocks, keeping the bodies at hand from one to the next."""

    def __init__(
        self,
        scenes: Scenes,
        cache: Cache,
        errors: dict[int, QbxStokesError],
        crew: Crew,
    ) -> None:
        self._scenes, self._errors, self._crew = scenes, errors, crew
        self._workshop = Workshop(cache=cache)
        self._body, _ = scenes.bodies
        self._bodies: dict[int, Body] = {}

    def compute(self, number: int, only: list[int] | None) -> block.BlockResult:
        """A block, or what is to be mended of it; trajectories without a scene come last."""
        scenes = self._scenes
        sweep = scenes.loaded.case.sweep
        simulations: list[Simulation] = []
        sound: list[AnyArray] = []
        lost: dict[int, str] = {}
        times = np.full(scenes.samples, np.nan)
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
        result = block.BlockResult.empty(index, times, scenes)
        result.failed = dict(enumerate(lost.values(), len(index) - len(lost)))
        gathering, poke = self._crew.gathering, self._crew.poke
        keeper = Keeper(gathering, str(number), [] if only is None else index.tolist())
        common = sweep.discard, scenes.pushed, poke, keeper
        block.compute_block(simulations, result, *common)
        return result

    def _simulation(self, number: int, index: AnyArray) -> Simulation:
        """Some trajectories of a scene as the lanes of a simulation."""
        body = int(self._body[number])
        if body in self._errors:
            raise self._errors[body]
        if body not in self._bodies:
            self._bodies[body] = body_of(self._scenes.scene(number).loaded)
            self._bodies[body].workshop = self._workshop
        return block.lanes_of(self._scenes, number, index, self._bodies[body])
