"""From a case with several bodies, or a wall, to the simulation that it writes down."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from qbxstokes.case.load import LoadedCase, case_of, load_case
from qbxstokes.case.scene import WITH_FLOW
from qbxstokes.motion.loads import Loads
from qbxstokes.simulation.body import Body
from qbxstokes.simulation.coupled import CoupledSimulation
from qbxstokes.simulation.from_case import (
    LOADS,
    end_of,
    loads_on,
    pointed,
    simulation_of,
    start_quaternion,
)
from qbxstokes.simulation.simulation import Simulation
from qbxstokes.simulation.surroundings import Repulsion, Wall
from qbxstokes.typing import Array


def coupled_of(loaded: LoadedCase, comm: Any = None) -> CoupledSimulation:
    """The simulation of a case with several bodies or a wall.

    comm: of PETSc, over whose ranks the bodies are dealt. Raises CaseError for tables and functions
    that cannot be used, SceneError for a scene that cannot be.
    """
    case = loaded.case
    bodies = [
        Body(shape=body.outline, size=body.size, stokes_number=body.stokes_number)
        for body in case.members
    ]
    wall, push = case.wall, case.repulsion
    return CoupledSimulation(
        bodies if case.bodies is not None else bodies[0],
        None if case.flow is None else loaded.flow,
        None if wall is None else Wall(wall.normal, wall.point, wall.velocity),
        position=np.array([body.start.position for body in case.members]),
        orientation=np.stack([start_quaternion(b.start, b.outline) for b in case.members]),
        velocity=_moving([body.start.velocity for body in case.members]),
        angular_velocity=_moving([body.start.angular_velocity for body in case.members]),
        loads=_loads_of(loaded),
        events=case.events,
        tolerance=case.hydrodynamics.tolerance if case.time is None else case.time.tolerance,
        resolution=case.hydrodynamics.tolerance,
        repulsion=None if push is None else Repulsion(push.strength, push.range),
        table=wall is not None and case.hydrodynamics.solve == "functional",
        comm=comm,
    )


def _moving(given: list[Any]) -> Array | None:
    return None if WITH_FLOW in given else np.array(given)


def _loads_of(loaded: LoadedCase) -> Loads | None:
    """What acts on the bodies: vectors (N, 3), or functions of time; None where nothing does."""
    case = loaded.case
    end = 0.0 if case.time is None else end_of(loaded)
    rows = [
        loads_on(loaded, body, key, end)
        for index, body in enumerate(case.members)
        for key in [("forces",) if body.forces is None else ("bodies", index, "forces")]
    ]
    if not any(rows):
        return None
    return Loads(*(_stacked([row.get(kind) for row in rows]) for kind in LOADS))


def _stacked(vectors: list[Any]) -> Array | Callable[[float], Array]:
    """Vectors of all bodies as one (N, 3), or a function of time."""
    whole = [np.zeros(3) if vector is None else vector for vector in vectors]
    if not any(callable(vector) for vector in whole):
        return np.stack(whole)
    return lambda t: np.stack([v(t) if callable(v) else v for v in whole])


def from_case(case: str | Path | Mapping[str, Any], overrides: Sequence[str] = ()) -> Simulation:
    """The simulation of a case file, or of its keys as a dictionary.

    overrides: "section.key=value" as after --set. Raises CaseError for a case that is wrong.
    """
    loaded = case_of(case) if isinstance(case, Mapping) else load_case(case, overrides)
    if loaded.case.task != "motion" or loaded.space is not None:
        raise loaded.error("task", "is no single motion", "a case of task: motion without a sweep")
    if loaded.case.coupled:
        with pointed(loaded):
            return coupled_of(loaded)
    return simulation_of(loaded)
