"""A case is one way to write down a simulation: from its sections to the objects."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from qbxstokes.case.bodies import BodyEntry
from qbxstokes.case.load import LoadedCase, case_of, from_document, load_case
from qbxstokes.case.running import Time
from qbxstokes.case.scene import FREE, LOCKED, WITH_FLOW, Start
from qbxstokes.case.values import Key
from qbxstokes.errors import CaseError, FlowError, SceneError
from qbxstokes.geometry import rotation
from qbxstokes.geometry.shape import Shape
from qbxstokes.motion.diagnostics import jeffery_period, orbit_axis
from qbxstokes.motion.equations import Constraints, Loads
from qbxstokes.simulation.arguments import timed
from qbxstokes.simulation.body import Body
from qbxstokes.simulation.simulation import Simulation
from qbxstokes.typing import Array, Indices

if TYPE_CHECKING:
    from qbxstokes.simulation.coupled import CoupledSimulation

# Instants stored where a case does not say how many: least and most, and the axis' turn between.
_SAMPLES, _TURN = (201, 20_001), 0.3  # radians
LOADS = ("force", "torque", "body_force", "body_torque")  # in the order of `Loads`


@contextmanager
def pointed(loaded: LoadedCase, key_of: Callable[[str], str] = str) -> Iterator[None]:
    """Within it what is wrong in a scene is told with the case's file and line.

    key_of: the key of the case by that of the scene, if they differ.
    """
    try:
        yield
    except SceneError as error:
        raise loaded.error(key_of(error.key), error.wrong, error.right) from None
    except FlowError as error:
        raise loaded.error(("flow", *error.key), str(error)) from None


def body_of(loaded: LoadedCase) -> Body:
    """The body of a case."""
    section = loaded.case.body
    return Body(
        shape=section.outline,
        stokes_number=section.stokes_number,
        inertia=section.inertia,
        hydrodynamics=loaded.case.hydrodynamics,
    )


def simulation_of(
    loaded: LoadedCase,
    body: Body | None = None,
    swept: Mapping[Key, Any] | None = None,
    numbers: Indices | None = None,
) -> Simulation:
    """The simulation that a case of `task: motion` of one body writes down.

    body: formed before, for another case with the same shape. swept: values (n, ...) of keys in the
    place of the case's own, of lanes that are the trajectories `numbers` (n,) of a sweep. Raises
    CaseError for tables and functions that cannot be used.
    """
    case, lanes = loaded.case, () if numbers is None else (len(numbers),)
    swept = swept or {}
    assert case.time is not None

    def below(name: str) -> dict[Key, Any]:
        return {key[2:]: values for key, values in swept.items() if key[:2] == ("start", name)}

    def vectors(name: str) -> Any:
        base, moving = getattr(case.start, name), below(name)
        if base == WITH_FLOW and not moving:
            return None
        return _filled((0.0, 0.0, 0.0) if base == WITH_FLOW else base, moving, lanes)

    stokes = swept.get(("body", "stokes_number"), case.body.stokes_number)
    turned = below("orientation")
    turn = start_quaternion(case.start, case.body.outline, turned, lanes if turned else ())
    loads, constraints = loads_and_constraints(loaded, end_of(loaded))
    simulation = Simulation(
        (body or body_of(loaded)).with_inertia(
            np.array(np.broadcast_to(stokes, lanes)), case.body.inertia
        ),
        loaded.flow,
        position=vectors("position"),
        orientation=np.broadcast_to(turn, (*lanes, 4)),
        velocity=vectors("velocity"),
        angular_velocity=vectors("angular_velocity"),
        loads=loads,
        constraints=constraints,
        events=case.events,
        brownian=case.brownian,
        tolerance=case.time.tolerance,
    )
    if numbers is not None:
        simulation.numbers = numbers.astype(np.uint64)
    return simulation


def start_of(loaded: LoadedCase) -> Simulation:
    """The body of a case where it starts, with nothing that acts on it."""
    start, body = loaded.case.start, body_of(loaded)
    turn = start_quaternion(start, body.shape)
    return Simulation(body, loaded.flow, position=start.position, orientation=turn)


def coupled_of(loaded: LoadedCase, comm: Any = None) -> CoupledSimulation:
    """The simulation of a case with several bodies or a wall.

    comm: of PETSc, over whose ranks the bodies are dealt. Raises CaseError for tables and functions
    that cannot be used, SceneError for a scene that cannot be.
    """
    from qbxstokes.simulation.coupled import CoupledSimulation
    from qbxstokes.simulation.surroundings import Repulsion, Wall

    case = loaded.case
    bodies = [
        Body(shape=body.outline, size=body.size, stokes_number=body.stokes_number)
        for body in case.members
    ]
    wall, push = case.wall, case.repulsion

    def moving(name: str) -> Array | None:
        given = [getattr(body.start, name) for body in case.members]
        return None if WITH_FLOW in given else np.array(given)

    return CoupledSimulation(
        bodies if case.bodies is not None else bodies[0],
        None if case.flow is None else loaded.flow,
        None if wall is None else Wall(wall.normal, wall.point, wall.velocity),
        position=np.array([body.start.position for body in case.members]),
        orientation=np.stack([start_quaternion(b.start, b.outline) for b in case.members]),
        velocity=moving("velocity"),
        angular_velocity=moving("angular_velocity"),
        loads=_loads_on_all(loaded),
        events=case.events,
        tolerance=case.hydrodynamics.tolerance if case.time is None else case.time.tolerance,
        resolution=case.hydrodynamics.tolerance,
        repulsion=None if push is None else Repulsion(push.strength, push.range),
        table=wall is not None and case.hydrodynamics.solve == "functional",
        comm=comm,
    )


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


def _filled(base: Sequence[float], swept: Mapping[Key, Any], lanes: tuple[int, ...]) -> Array:
    """Vectors (*lanes, size): the base, and what is swept of it, as a whole () or by place (i,)."""
    vectors = np.empty((*lanes, len(base)))
    vectors[...] = base
    for place, values in swept.items():
        vectors[(..., *place)] = values
    return vectors


def start_quaternion(
    start: Start, shape: Shape, swept: Mapping[Key, Any] | None = None, lanes: tuple[int, ...] = ()
) -> Array:
    """Unit quaternions (*lanes, 4) of the start, from whichever form the case gives.

    swept: values (n, ...) of what is below it in the place of the case's.
    """
    swept, given = swept or {}, start.orientation
    if () in swept:  # axes or rotations as a whole
        whole = np.asarray(swept[()])
        return rotation.from_axis(whole) if whole.shape[1] == 3 else whole
    # The schema lets exactly one form through.
    form = next(name for name in given.declared if getattr(given, name) is not None)
    base, moving = getattr(given, form), {key[1:]: values for key, values in swept.items()}
    if form in ("axis", "quaternion"):
        vectors = _filled(base, moving, lanes)
        return rotation.from_axis(vectors) if form == "axis" else rotation.normalize(vectors)
    parts = [
        np.broadcast_to(moving.get((name,), getattr(base, name)), lanes) for name in base.declared
    ]
    if form == "euler":
        return rotation.from_euler(*parts)
    return rotation.from_axis(orbit_axis(orbit_ratio(shape), *parts))


def orbit_ratio(shape: Shape) -> float:
    """k of Jeffery orbits. Raises SceneError where only the body's law tells them."""
    if shape.effective_ratio is None:
        wrong = f"is not known beforehand of a {shape}"
        raise SceneError("start.orientation.orbit", wrong, "give axis, euler or quaternion")
    return shape.effective_ratio


# -- time -----------------------------------------------------------------------------------------


def period_of(loaded: LoadedCase) -> float | None:
    """Jeffery's period in the gradient at the start, None where the axis comes to rest."""
    gradient = loaded.flow.gradient(np.array(loaded.case.start.position))
    return jeffery_period(gradient, body_of(loaded).effective_ratio)


def times_of(loaded: LoadedCase) -> Array:
    """The instants to store; the integration starts at 0 whether or not 0 is one of them.

    Raises CaseError for periods of a flow that turns no axis.
    """
    time = loaded.case.time
    assert time is not None
    if time.at is not None:
        return np.array(time.at)
    return np.linspace(0.0, end_of(loaded), samples_of(loaded))


def samples_of(loaded: LoadedCase) -> int:
    """How many instants are stored; in a sweep the most that an end of one of its axes needs."""
    time, space = loaded.case.time, loaded.space
    assert time is not None
    if time.at is not None or time.samples is not None:
        return len(time.at) if time.at is not None else int(time.samples or 0)
    found = [_needed_samples(loaded)]
    for axis, column in space.columns if space is not None else ():
        assert space is not None
        if column.key[0] in ("body", "flow", "time") or column.key[:2] == ("start", "position"):
            for point in column.ends():
                place = [point if other == axis else 0 for other in range(len(space.axes))]
                data = space.assign(loaded.document.data, place)
                found.append(
                    _needed_samples(from_document(replace(loaded.document, data=data), loaded.path))
                )
    return max(found)


def _needed_samples(loaded: LoadedCase) -> int:
    """Samples between which the axis turns at most by a part of a radian, as fast as it ever does.

    In the gradient at the start D3 turns at w/2 x D3 and lambda E D3 across, together at most
    |w|/2 + |lambda| |E| (Jeffery 1922).
    """
    if period_of(loaded) is None:
        return _SAMPLES[0]
    gradient = loaded.flow.gradient(np.array(loaded.case.start.position))
    k = body_of(loaded).effective_ratio
    shape = abs((1.0 - k * k) / (1.0 + k * k))
    spin = np.linalg.norm(gradient - gradient.T) / np.sqrt(8.0)
    fastest = spin + shape * np.linalg.norm(0.5 * (gradient + gradient.T), 2)
    needed = min(end_of(loaded) * fastest / _TURN, _SAMPLES[1])
    return int(np.clip(1 + np.ceil(needed), *_SAMPLES))


def end_of(loaded: LoadedCase) -> float:
    """End of the motion."""
    time: Time | None = loaded.case.time
    assert time is not None
    if time.at is not None:
        return float(time.at[-1])
    if time.end is not None:
        return float(time.end)
    period = period_of(loaded)
    if period is None:
        raise loaded.error(
            "time.periods",
            "the flow's gradient at the start turns no axis around, so there is no period",
            "give time.end instead",
        )
    assert time.periods is not None
    return float(time.periods * period)


# -- loads and constraints ------------------------------------------------------------------------


def loads_and_constraints(
    loaded: LoadedCase, end: float
) -> tuple[Loads | None, Constraints | None]:
    """Loads and constraints of the case, None where there are none; `end` of the motion.

    Raises CaseError for a table or function that cannot be used.
    """
    held = loaded.case.constraints
    loads = loads_on(loaded, loaded.case.members[0], ("forces",), end)
    constraints = None
    if held.given:
        constraints = Constraints(
            *(
                _bound(loaded, name, getattr(held, name), end)
                for name in ("translation", "rotation")
            )
        )
    return (Loads(**loads) if loads else None), constraints


def loads_on(
    loaded: LoadedCase, body: BodyEntry, key: tuple[str | int, ...], end: float
) -> dict[str, Any]:
    """What acts on a body: vectors (3,), or functions of time, by kind; key: of its `forces`.

    The weight less buoyancy, Theta G e, stands with the force (see `case.scene.Gravity`).
    """
    forces = loaded.case.forces if body.forces is None else body.forces
    found = {
        kind: _vector(loaded, (*key, kind), getattr(forces, kind), end)
        for kind in LOADS
        if getattr(forces, kind) is not None
    }
    if forces.gravity is not None:
        direction = np.array(forces.gravity.direction)
        net = forces.gravity.net(body.stokes_number) * body.outline.volume * body.size**3
        weight, given = net * direction / np.linalg.norm(direction), found.get("force", 0.0)
        turned = callable(given)
        found["force"] = (lambda t: np.asarray(given(t)) + weight) if turned else given + weight
    return found


def _bound(loaded: LoadedCase, name: str, value: Any, end: float) -> Any:
    if value == FREE:
        return None
    if value == LOCKED:
        return np.zeros(3)
    return _vector(loaded, ("constraints", name), value, end)


def _vector(loaded: LoadedCase, key: tuple[str | int, ...], value: Any, end: float) -> Any:
    try:
        return timed(value, loaded.path.parent, end)
    except (CaseError, FlowError) as error:
        raise loaded.error(key, str(error)) from None


def _loads_on_all(loaded: LoadedCase) -> Loads | None:
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
