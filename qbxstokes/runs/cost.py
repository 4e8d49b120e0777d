"""What a run costs before it is begun: time, memory, and how a sweep scales with the ranks.

    T(P) = models/min(P, bodies) + (integration + output)/P + hand-out + last block/2 + layout

The integration is measured: a few blocks of the sweep are begun, each for a fraction of a second,
and what that took is carried on to their end. Between them the cost goes as the right-hand sides
that the integrator itself forecasts (motion/forecast.py) for the first trajectory of a scene with
the smallest Stokes number of its block. Flows are the user's own, functions included; bodies in
polynomial flows are those of closed forms. One rank lays the file out and serves the hand-out, to
one rank after another. Start-up is left out, and so is what a file system of many nodes adds.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from qbxstokes.case.load import LoadedCase
from qbxstokes.errors import QbxStokesError
from qbxstokes.flows.polynomial import PolynomialFlow
from qbxstokes.motion.forecast import Forecast
from qbxstokes.runs.block import lanes_of
from qbxstokes.runs.field_targets import instant_of, targets_of
from qbxstokes.runs.plan import MotionPlan, Plan
from qbxstokes.runs.sharing import MOST
from qbxstokes.runs.sweep_blocks import BLOCK_BYTES, STOKES, Scenes
from qbxstokes.runs.sweep_layout import Swept
from qbxstokes.simulation.assembly import assemble
from qbxstokes.simulation.hydrodynamics import Hydrodynamic, exact_model
from qbxstokes.simulation.lanes import LaneRun
from qbxstokes.simulation.simulation import Simulation
from qbxstokes.typing import Array

# Processor times on one core of a 2 GHz Xeon (s): of a body's hydrodynamics; of case, plan and
# integrators of a block; of a byte of the result; of handing out a block, one after another; of a
# trajectory in the layout, on one rank.
MODEL, BLOCK, STORED_BYTE, HANDOUT, LAYOUT = 0.2, 5e-3, 1.5e-9, 3e-6, 1.2e-6
# Start of MPI and PETSc, imports and loading of compiled kernels, which the model leaves out.
START_SECONDS = 2.0
HALF_TURN = 2e-4  # of an event of a single motion, which lanes do not watch for
BASE_MEMORY = 220e6
# A right-hand side of a block takes as long as those of so many trajectories, whatever it holds.
LANES_OF_A_CALL = 50
# Blocks that are begun, for how long each, and about how much work lies between looks at the clock
# (s); steps that tell how many are to come; samples and points that tell what each takes.
BEGUN, BUDGET, LOOK = 4, 0.25, 0.03
TELLING, SAMPLED, POINTS = 60, 50, 2000
WEIGHED = 200  # scenes that are forecast where there are many
# The same of motions of several bodies (s), and random axes of a suspension that are followed.
COUPLED_BUDGET, AXES = 1.0, 256


@dataclass(frozen=True)
class Estimate:
    """Seconds of the parts, and bytes of memory per rank."""

    models: float
    bodies: int
    integration: float
    output: float
    handout: float
    last_block: float
    layout: float
    memory: float

    def seconds(self, ranks: int) -> float:
        """Wall time on a number of ranks."""
        shared = (self.integration + self.output) / ranks
        models = self.models / min(ranks, max(self.bodies, 1))
        last = 0.0 if ranks == 1 else 0.5 * self.last_block
        return models + shared + self.handout + last + self.layout


# -- what is forecast -----------------------------------------------------------------------------


def forecast(scene: Simulation, times: Array, stokes_number: float) -> float:
    """Right-hand sides that the first lane of a scene will take with that Stokes number."""
    from qbxstokes.motion.forecast import STAGES, Forecast

    alone = Simulation(
        scene.body.with_inertia(stokes_number, scene.body.inertia),
        scene.flow,
        position=scene.position[0],
        orientation=scene.quaternion[0],
        tolerance=scene.tolerance,
    )
    assembled = assemble([alone], maker=_exact)
    end = float(times[-1])
    told = Forecast(assembled.equations, 0.0, assembled.initial, end, scene.tolerance)
    method = told.method
    # The other formulas have an interpolant as good as their steps.
    sampled = STAGES * len(times) if method == "8vr" else 0
    return told.evaluations("rk" if method in ("5dp", "8vr") else method) + sampled


def _exact(scene: Simulation) -> Hydrodynamic:
    """The body by closed forms, and the flow about the start."""
    flow, place = scene.carrier, scene.position[0]
    near = flow.polynomial or PolynomialFlow(
        flow.velocity(place), flow.gradient(place), origin=place
    )
    return Hydrodynamic(exact_model(scene.body.shape) or scene.body.model, near)


def weights(scenes: Scenes) -> Array:
    """Right-hand sides per trajectory of every scene; those of a sample where there are many."""
    known = np.unique(np.linspace(0, scenes.size - 1, min(scenes.size, WEIGHED)).astype(int))
    values = []
    for number in known.tolist():
        try:
            scene, members = scenes.scene(number), scenes.members(number)
            given = scenes.space.values(members).get(STOKES, scene.loaded.case.body.stokes_number)
            plan = scene.plan
            values.append(forecast(plan.simulation, plan.times, float(np.min(given))))
        except QbxStokesError:  # told again, with its trajectories, when its turn comes
            values.append(1.0)
    return np.asarray(np.interp(np.arange(scenes.size), known, values))


def block_weights(scenes: Swept) -> Array:
    """What every block costs, in right-hand sides of one trajectory."""
    if not isinstance(scenes, Scenes):
        return np.ones(scenes.blocks)
    calls = weights(scenes)[scenes.scene_of_block()]
    return np.asarray(calls * (scenes.block_sizes() + LANES_OF_A_CALL))


# -- what is measured -----------------------------------------------------------------------------


def begun(
    parts: Sequence[Simulation], times: Array, quantities: tuple[str, ...], **settings: Any
) -> float:
    """Seconds that an integration takes, from what its first steps and samples take.

    settings: of `assemble`.
    """
    settings |= {"maker": _exact} if parts[0].kind == "table" else {}
    assembled = assemble(parts, **settings)
    # In the first of two kernels are loaded, or compiled.
    return min(_carried_on(LaneRun.of(assembled, times), quantities) for _ in range(2))


def _carried_on(run: LaneRun, quantities: tuple[str, ...]) -> float:
    """Seconds of a whole run, of which the first are done here."""
    start, assembled, times = time.process_time(), run.assembled, run.times
    run.go(
        interrupted=lambda: run.checkpoint is not None and time.process_time() > start + BUDGET,
        chunk_steps=assembled.steps_of(LOOK),
        chunk_samples=len(times) + 1,
    )
    reached, spent = run.checkpoint, time.process_time() - start
    if reached is None or reached.time == 0.0:  # all have met an edge of their flow at once
        return spent
    if reached.time < times[-1] and reached.steps < TELLING:
        first = assembled.parts[0]
        expected = forecast(first, times, float(first.stokes_number.min()))
        return spent / reached.evaluations * expected
    return spent * float(times[-1]) / reached.time + _sampling(run, quantities)


def _sampling(run: LaneRun, quantities: tuple[str, ...]) -> float:
    """Seconds for the quantities and averages of all samples, from those of the first."""
    assert run.checkpoint is not None
    some = min(run.checkpoint.next_sample, SAMPLED)
    if some < 2:
        return 0.0
    first = replace(run, times=run.times[:some], states=run.states[:some], ended={})
    begin = time.process_time()
    run.assembled.averages(first.times, first.samples(quantities))
    return (time.process_time() - begin) * len(run.times) / some


def field_seconds(loaded: LoadedCase, plan: Plan) -> float:
    """What the points of `task: field` take after the start, from the set-up and some of them."""
    from qbxstokes.simulation.flow_around import AroundBody

    section, begin, body = loaded.case.field, time.process_time(), plan.simulation.body
    instant = instant_of(section, plan.simulation)
    solution = AroundBody(body.shape, loaded.flow, body.settings, section.tolerance)
    around, asked = solution.at(instant), (section.quantities, section.tolerance, section.method)
    assert around.disturbance.boundary_error >= 0.0  # forms the table
    seconds = time.process_time() - begin
    for target in targets_of(loaded, section):
        some = np.linspace(0, target.size - 1, min(target.size, POINTS)).astype(int)
        points = [target.in_space(i, i + 1, instant.position, instant.rotation) for i in some]
        begin = time.process_time()
        around.evaluate(np.concatenate(points), *asked)
        seconds += (time.process_time() - begin) * target.size / len(some)
    return seconds


def coupled_seconds(plan: MotionPlan) -> float:
    """What a motion of several bodies, or of one by a wall, takes after the start."""
    begin, scene = time.process_time(), plan.simulation
    assembled: Any = scene.assemble()
    watch = assembled.watch()
    watch.begin(0.0, assembled.initial)
    first = time.process_time()  # maps of the bodies have been made, and are there for the rest
    for _ in range(2):  # in the first kernels may be compiled, and take all there is after a step
        start, solves = time.process_time(), assembled.solves
        trajectory = assembled.trajectory(
            plan.times,
            observe=watch,
            interrupted=partial(_over, start + COUPLED_BUDGET),
            chunk_steps=1,
        )
        steps, share = time.process_time(), trajectory.reached / float(plan.times[-1])
        if share == 1.0 or trajectory.checkpoint.steps > 3:
            break
    # Samples take a solve each, and the estimates of errors, at both ends and between, two.
    sample = (steps - start) / (assembled.solves - solves) if assembled.solves > solves else 0.0
    assembled.estimate(0.0, assembled.initial)
    ends = first - begin + 3.0 * (time.process_time() - steps)
    whole = (steps - start) / max(share, 1e-6)
    if share < 1.0 and trajectory.checkpoint.method == "bdf":  # which begins by short steps
        about = assembled.equations, 0.0, assembled.initial, float(plan.times[-1])
        whole = sample * Forecast(*about, scene.tolerance).implicit
    return ends + whole + len(plan.times) * sample


def _over(instant: float) -> bool:
    return time.process_time() > instant


def suspension_seconds(loaded: LoadedCase, plan: Plan) -> float:
    """What `task: rheology` takes after the start, from some of its Peclet numbers, or axes."""
    from qbxstokes.runs.rheology import suspension_of

    section = loaded.case.rheology
    numbers, random = list(section.peclet_number), section.langevin

    def spent(some: list[float], axes: int) -> float:
        begin = time.process_time()
        suspension_of(loaded, plan.simulation, {"trajectories": axes, "paths": 0}, some)
        return time.process_time() - begin

    spent(numbers[:1], AXES)  # forms the body, loads kernels or compiles them
    one = spent(numbers[:1], AXES)
    if random is not None:
        each = (spent(numbers[:1], 2 * AXES) - one) / AXES
        return MODEL + len(numbers) * (one + max(each, 0.0) * (random.trajectories - AXES))
    some = numbers[:: max(1, len(numbers) // 3)]
    each = (spent(some, AXES) - one) / max(len(some) - 1, 1)
    return MODEL + one + max(each, 0.0) * (len(numbers) - 1)


def seconds_of(loaded: LoadedCase, plan: Plan) -> float | None:
    """What a single run takes after the start, None for tasks of which that is not told.

    That of a motion is without its comparison and its field.
    """
    if loaded.case.coupled:
        return coupled_seconds(plan) if isinstance(plan, MotionPlan) else None
    if loaded.case.task == "rheology":
        return suspension_seconds(loaded, plan)
    if isinstance(plan, MotionPlan):
        scene = plan.simulation
        turns = 2.0 * plan.times[-1] / (scene.period or np.inf) if scene.events.half_turns else 0.0
        return float(MODEL + begun([scene], plan.times, plan.quantities) + HALF_TURN * turns)
    return field_seconds(loaded, plan) if loaded.case.task == "field" else None


def block_seconds(scenes: Swept) -> Array:
    """Integration time of every block, carried over from a few that are begun."""
    if not isinstance(scenes, Scenes):
        first = getattr(scenes, "first", None)
        each = coupled_seconds(first) if isinstance(first, MotionPlan) else MODEL
        return np.full(scenes.blocks, scenes.turns * each)
    weight = block_weights(scenes)
    numbers, rates = [], []
    for number in np.unique(np.linspace(0, scenes.blocks - 1, BEGUN).astype(int)).tolist():
        pieces = scenes.block(number).pieces
        evaluation = "auto" if scenes.alone else "compiled"
        try:
            parts = [lanes_of(scenes, scene, members) for scene, members in pieces]
            times = scenes.scene(pieces[0][0]).plan.times
            seconds = begun(parts, times, scenes.quantities, evaluation=evaluation)
        except (QbxStokesError, ArithmeticError):  # told again when its turn comes
            continue
        numbers.append(number)
        rates.append(seconds / weight[number])
    rate = np.interp(np.arange(scenes.blocks), numbers, rates) if numbers else 0.0
    return np.asarray(scenes.turns * (BLOCK + weight * rate))


def estimate(scenes: Swept) -> Estimate:
    """Cost of the whole sweep; begins some of its blocks."""
    sizes, per_block = scenes.block_sizes(), block_seconds(scenes)
    n, row_bytes = scenes.space.size, scenes.layout.row_bytes
    # Where bodies are what is swept, forming them is all the work of a block.
    bodies = scenes.turns * len(scenes.bodies[1]) if isinstance(scenes, Scenes) else 0
    held = min(8 * scenes.samples * int(sizes.max()) * 60, BLOCK_BYTES)
    held += 2 * min(n * row_bytes, MOST)  # finished, and on its way to the result
    return Estimate(
        models=bodies * MODEL,
        bodies=bodies,
        integration=float(per_block.sum()),
        output=n * row_bytes * STORED_BYTE,
        handout=scenes.blocks * HANDOUT,
        last_block=float(per_block.max()),
        layout=n * LAYOUT,
        memory=BASE_MEMORY + held + 48.0 * scenes.blocks,
    )
