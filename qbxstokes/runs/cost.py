"""What a sweep costs: time, memory, and how it scales with the number of ranks.

    T(P) = models/min(P, bodies) + (integration + output)/P + hand-out + last block/2 + layout

with integration = blocks x fixed + trajectories x right-hand sides x time of one. Right-hand sides
are those that the integrator itself forecasts (motion/forecast.py) for the first trajectory of a
scene with the smallest Stokes number of its block, and a step more for each sample; steps of
implicit methods count as so many. Resistances are those of the closed forms.
One rank lays the file out and serves the hand-out, to one rank after another. Start-up is left out,
and so is what a file system shared by many nodes adds.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from qbxstokes.flows import Flow
from qbxstokes.flows.polynomial import PolynomialFlow
from qbxstokes.runs.scenes import BLOCK_BYTES, STOKES, Scenes
from qbxstokes.runs.sweep_layout import Swept
from qbxstokes.simulation.assembly import assemble
from qbxstokes.simulation.exact import exact_model
from qbxstokes.simulation.hydrodynamics import Hydrodynamic, Workshop
from qbxstokes.simulation.simulation import Simulation

# Bodies from which on some of a block need shorter steps than its first.
SEVERAL = 8
# About how many points of a surface a flow that is not polynomial is asked for.
SURFACE_POINTS = 72


@dataclass(frozen=True)
class Constants:
    """Processor times on one core (s), and steps over those that are forecast.

    rhs_*: per trajectory and right-hand side, massless and inertial, by degree of the polynomial
    flow (constant or linear, quadratic, cubic), and in any other flow, without what its own
    function takes (`flow_seconds`); centred: in a linear flow in which no body leaves its place.
    call: per right-hand side of a block, whatever it holds; call_general: in a flow that is not
    polynomial. steps_*: of a block of several bodies over the forecast for one.
    sample: per sample of a trajectory. block_sample: per sample of a block. block: case, plan,
    integrators and averages of a block. stored_byte: of the result. handout: of a block, one after
    another. layout: per trajectory, on one rank. model: of a body's hydrodynamics.
    """

    rhs_massless_centred: float = 4.5e-8
    rhs_massless_linear: float = 6e-8
    rhs_massless_quadratic: float = 1.0e-7
    rhs_massless_cubic: float = 1.3e-7
    rhs_inertial_centred: float = 6e-8
    rhs_inertial_linear: float = 1.3e-7
    rhs_inertial_quadratic: float = 1.5e-7
    rhs_inertial_cubic: float = 1.6e-7
    rhs_general: float = 3.5e-5
    call: float = 3e-6
    call_general: float = 7e-4
    steps_massless: float = 2.0
    steps_inertial: float = 1.6
    sample: float = 1e-6
    block_sample: float = 5e-5
    block: float = 5e-3
    stored_byte: float = 1.5e-9
    handout: float = 3e-6
    layout: float = 1.2e-6
    model: float = 0.2

    def rhs(self, inertial: bool, degree: int | None, centred: bool = False) -> float:
        """Seconds per trajectory and right-hand side in a flow of some degree (None: any flow)."""
        if degree is None or degree > 3:
            return self.rhs_general
        kind = "inertial" if inertial else "massless"
        linear = "centred" if centred else "linear"
        name = (linear, linear, "quadratic", "cubic")[degree]
        return float(getattr(self, f"rhs_{kind}_{name}"))

    def steps(self, inertial: bool) -> float:
        """Steps of a block of several bodies over the forecast for one."""
        return self.steps_inertial if inertial else self.steps_massless


# On a 2 GHz Intel Xeon (Sapphire Rapids); the benchmark table `sweep_constants` measures them.
XEON = Constants()
BASE_MEMORY = 220e6
# Start of MPI and PETSc, imports and loading of compiled kernels, which the model leaves out.
START_SECONDS = 2.0


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

    @property
    def work(self) -> float:
        """Seconds of one rank alone."""
        return self.seconds(1)

    def seconds(self, ranks: int) -> float:
        """Wall time on a number of ranks."""
        return sum(self.parts(ranks).values())

    def parts(self, ranks: int) -> dict[str, float]:
        """Seconds on a number of ranks by what takes them."""
        return {
            "models": self.models / min(ranks, max(self.bodies, 1)),
            "integration": self.integration / ranks,
            "output": self.output / ranks,
            "hand-out": self.handout,
            "last block": 0.0 if ranks == 1 else 0.5 * self.last_block,
            "layout": self.layout,
        }


def scene_weight(scenes: Scenes, number: int, constants: Constants = XEON) -> float:
    """Right-hand sides that one trajectory of a scene will take."""
    from qbxstokes.motion.forecast import STAGES, Forecast

    scene, members = scenes.scene(number), scenes.first_members(number)
    simulation, times = scene.plan.simulation, scene.plan.times
    values = scenes.space.values(members)
    stokes_number = float(np.min(values.get(STOKES, scene.loaded.case.body.stokes_number)))
    body = simulation.body.with_inertia(stokes_number, simulation.body.inertia)
    alone = Simulation(
        body,
        simulation.flow,
        position=simulation.position[0],
        orientation=simulation.quaternion[0],
        tolerance=simulation.tolerance,
    )
    assembled = assemble([alone], checked=True, maker=_exact)
    forecast = Forecast(
        assembled.equations, 0.0, assembled.initial, float(times[-1]), simulation.tolerance
    )
    method = forecast.method
    kind = "rk" if method in ("5dp", "8vr") else method
    crowd = constants.steps(stokes_number > 0) if len(members) >= SEVERAL else 1.0
    # The other formulas have an interpolant as good as their steps.
    sampled = STAGES * len(times) if method == "8vr" else 0
    return crowd * forecast.evaluations(kind) + sampled


def _exact(scene: Simulation, _: Workshop) -> Hydrodynamic:
    """The body by closed forms, and the flow about the start."""
    flow, place = scene.flow, scene.position[0]
    near = flow.polynomial or PolynomialFlow(
        flow.velocity(place), flow.gradient(place), origin=place
    )
    return Hydrodynamic(exact_model(scene.body.shape) or scene.body.model, near)


def weights(scenes: Scenes, constants: Constants = XEON, most: int = 200) -> np.ndarray:
    """Right-hand sides per trajectory of every scene; those of a sample where there are many."""
    from qbxstokes.errors import QbxStokesError

    known = np.unique(np.linspace(0, scenes.size - 1, min(scenes.size, most)).astype(int))
    values = []
    for number in known.tolist():
        try:
            values.append(scene_weight(scenes, number, constants))
        except QbxStokesError:  # told again, with its trajectories, when its turn comes
            values.append(1.0)
    return np.asarray(np.interp(np.arange(scenes.size), known, values))


def flow_seconds(flow: Flow, place: np.ndarray) -> float:
    """What a flow's own function takes for one body at a right-hand side, measured now (s)."""
    points = np.tile(place, (16 * SURFACE_POINTS, 1))
    best = float("inf")
    for _ in range(3):
        begin = time.perf_counter()
        flow.velocity(points, 0.0)
        best = min(best, time.perf_counter() - begin)
    return best / 16.0


def block_seconds(scenes: Swept, constants: Constants = XEON) -> np.ndarray:
    """Integration time of every block."""
    if not isinstance(scenes, Scenes):
        return np.full(scenes.blocks, scenes.turns * constants.model)
    case, flow = scenes.loaded.case, scenes.loaded.flow
    seconds = constants.rhs(case.body.stokes_number > 0, flow.degree, scenes.centred)
    call = constants.call
    if flow.degree is None or flow.degree > 3:
        call = constants.call_general
        seconds += flow_seconds(flow, scenes.scene(0).plan.simulation.position[0])
    calls = weights(scenes, constants)[scenes.scene_of_block()]
    fixed = constants.block + scenes.samples * constants.block_sample
    once = fixed + calls * (scenes.block_sizes() * seconds + call)
    return np.asarray(scenes.turns * once)


def estimate(scenes: Swept, row_bytes: int, constants: Constants = XEON) -> Estimate:
    """Cost of the whole sweep."""
    sizes, per_block = scenes.block_sizes(), block_seconds(scenes, constants)
    n = scenes.space.size
    # Where bodies are what is swept, forming them is all the work of a block.
    bodies = scenes.turns * len(scenes.bodies[1]) if isinstance(scenes, Scenes) else 0
    held = 8 * scenes.samples * int(sizes.max()) * 60
    return Estimate(
        models=bodies * constants.model,
        bodies=bodies,
        integration=float(per_block.sum()),
        output=n * (row_bytes * constants.stored_byte + scenes.samples * constants.sample),
        handout=scenes.blocks * constants.handout,
        last_block=float(per_block.max()),
        layout=n * constants.layout,
        memory=BASE_MEMORY + min(held, BLOCK_BYTES) + 24.0 * scenes.blocks,
    )
