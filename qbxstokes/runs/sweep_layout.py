"""What a sweep is of, motions or bodies, and what its result holds: columns, quantities, scales."""

import json
from collections.abc import Iterator
from typing import Any

import numpy as np

from qbxstokes.case.load import LoadedCase
from qbxstokes.case.sweep import column_name
from qbxstokes.case.values import Key
from qbxstokes.io.sweep_result import REASON_LENGTH, Layout
from qbxstokes.quantities import BODY_COLUMNS, COUPLED_COLUMNS, PARAMETER, STATUS
from qbxstokes.quantity import Quantity
from qbxstokes.runs.plan import MotionPlan, plan_body, plan_coupled
from qbxstokes.runs.sweep_blocks import Alone, Scenes
from qbxstokes.typing import AnyArray

_COORDINATE_PIECE = 65_536
# Vectors of every body that shares a fluid, of `task: body` where something drives them.
DRIVEN = ("free_velocity", "free_angular_velocity", "held_force", "held_torque")


class BodyScenes(Alone):
    """All bodies of a sweep."""

    nouns = "body", "bodies"

    def __init__(self, loaded: LoadedCase) -> None:
        super().__init__(loaded)
        measure = loaded.case.sweep.measure
        self.turns = 1 if measure is None else 1 + measure.repeats
        # Without a flow a body neither moves nor has to be held.
        moving = loaded.case.flow is not None
        self.columns = {
            name: about
            for name, about in BODY_COLUMNS.items()
            if moving or not name.startswith(("free_", "held_"))
        }
        self.skips = plan_body(loaded).skips


class CoupledScenes(Alone):
    """All scenes of a sweep over several bodies or a wall."""

    def __init__(self, loaded: LoadedCase) -> None:
        super().__init__(loaded)
        if loaded.case.sweep.measure is not None:
            wrong = "has no meaning with a wall or several bodies"
            raise loaded.error("sweep.measure", wrong, "leave it out")
        self.first = plan = plan_coupled(loaded)
        self.skips = plan.skips
        self.bodies = len(loaded.case.members) if loaded.case.bodies is not None else 0
        moving = loaded.case.task == "motion"
        self.columns = dict(COUPLED_COLUMNS)
        for name in ("final_position", "final_axis") if moving else DRIVEN:
            told = f"{name.replace('_', ' ')}: body, component"
            for column in columns_of_bodies(name, self.bodies):
                self.columns[column] = Quantity(column, "", "", told)
        if isinstance(plan, MotionPlan):
            self.nouns, self.samples = ("trajectory", "trajectories"), len(plan.times)
            if loaded.case.sweep.store == "samples":
                self.quantities = plan.quantities
            if not any(column.key[0] == "time" for _, column in self.space.columns):
                self.common_times = plan.times


def columns_of_bodies(name: str, bodies: int) -> list[str]:
    """Columns of a vector of every body: free_velocity_2_1 of the second; without, of one."""
    numbers = [f"_{body + 1}" for body in range(bodies)] or [""]
    return [f"{name}{number}_{part}" for number in numbers for part in (1, 2, 3)]


Swept = Scenes | BodyScenes | CoupledScenes


def swept_scenes(loaded: LoadedCase) -> Swept:
    """The scenes of a sweep: of motions, of bodies, or of bodies that share a fluid."""
    if loaded.case.coupled:
        return CoupledScenes(loaded)
    if loaded.case.task == "body":
        return BodyScenes(loaded)
    return Scenes(loaded)


def layout_of(scenes: Swept) -> Layout:
    """What the result file holds."""
    coordinates = _coordinate_types(scenes)
    columns: list[tuple[str, Any]] = [*coordinates.items()]
    columns += [("status", "i1"), *((name, "f8") for name in scenes.columns)]
    columns += [("reason", f"S{REASON_LENGTH}")]
    swept = {
        name: PARAMETER.get(name) or Quantity(name, "", "", f"swept value {name}")
        for name in coordinates
    }
    return Layout(
        scenes.space.size,
        scenes.samples,
        np.dtype(columns),
        scenes.quantities,
        scenes.common_times,
        tuple(coordinates),
        {**swept, **STATUS, **scenes.columns},
        scenes.bodies if isinstance(scenes, CoupledScenes) else 0,
    )


def _coordinate_types(scenes: Swept) -> dict[str, Any]:
    """Columns of the swept values and their types; vectors one column per component."""
    types: dict[str, Any] = {}
    for _, column in scenes.space.columns:
        if column.numeric:
            sample = column.take(np.arange(min(column.size, 1)))
            types |= dict.fromkeys(_columns(column.key, sample), "f8")
        else:
            assert column.values is not None
            words = [_word(value) for value in column.values.tolist()]
            types[column_name(column.key)] = f"S{max(1, *(len(word) for word in words))}"
    return types


def _columns(key: Key, values: AnyArray) -> dict[str, AnyArray]:
    """Values (n,) of a key as a column, vectors as one per component; quaternions from 0 on."""
    name = column_name(key)
    if values.ndim == 1:
        return {name: values}
    first = 0 if values.shape[1] == 4 else 1
    return {f"{name}_{i + first}": values[:, i] for i in range(values.shape[1])}


def _word(value: Any) -> bytes:
    text = value if isinstance(value, str) else json.dumps(value)
    return text.encode("ascii", "backslashreplace")


def coordinates_of(scenes: Swept, index: AnyArray) -> dict[str, AnyArray]:
    """Swept values of some trajectories as columns."""
    columns: dict[str, AnyArray] = {}
    numeric = {column.key: column.numeric for _, column in scenes.space.columns}
    for key, values in scenes.space.values(index).items():
        words = values if numeric[key] else np.array([_word(value) for value in values.tolist()])
        columns |= _columns(key, words)
    return columns


def scales_of(scenes: Swept, layout: Layout) -> Iterator[tuple[int, dict[str, AnyArray]]]:
    """The scales of the file in pieces."""
    for first in range(0, layout.size, _COORDINATE_PIECE):
        index = np.arange(first, min(first + _COORDINATE_PIECE, layout.size))
        columns = coordinates_of(scenes, index)
        typed = {name: values.astype(layout.dtype[name]) for name, values in columns.items()}
        yield first, {"trajectory": index, **typed}
    if layout.quantities and layout.times is not None:
        yield 0, {"time": layout.times}
    elif layout.quantities:
        yield 0, {"sample": np.arange(layout.samples)}
